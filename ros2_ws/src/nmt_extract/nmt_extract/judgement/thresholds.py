"""Thresholds of the judgement of channels: value, unit, reason, and the test that fails when it moves."""

from __future__ import annotations

from dataclasses import dataclass, field

from nmt_core.threshold import threshold

_TEST = "tests/extract/test_channel_gain.py::test_a_threshold_decides"


@dataclass(frozen=True)
class GainThresholds:
    """What is asked of a gain before it is named, and what modes may do without one."""

    evidence: float = threshold(
        16.0, "1",
        "Misfit removed by the gain: four standard deviations.",
        _TEST + "[evidence]",
    )  # fmt: skip
    lead: float = threshold(
        9.0, "1",
        "Lead over any other channel: three standard deviations.",
        _TEST + "[lead]",
    )  # fmt: skip
    misfit: float = threshold(
        1.0, "1",
        "Remaining misfit over its degrees of freedom.",
        _TEST + "[misfit]",
    )  # fmt: skip
    smallest: float = threshold(
        0.05, "1",
        "Smallest named deviation, above ordinary calibration.",
        _TEST + "[smallest]",
    )  # fmt: skip
    model_shape: float = threshold(
        0.01, "1",
        "Relative error of an unqualified shape.",
        _TEST + "[model_shape]",
    )  # fmt: skip
    shape_floor: float = threshold(
        5e-4, "1",
        "The same of its largest value, for undescribed modes.",
        _TEST + "[shape_floor]",
    )  # fmt: skip
    mixing: float = threshold(
        3.0, "1",
        "Mode share over relative shift, by a local force.",
        _TEST + "[mixing]",
    )  # fmt: skip
    mixed: float = threshold(
        0.01, "1",
        "Unexplained mode share of a level, as drift.",
        _TEST + "[mixed]",
    )  # fmt: skip
    driven: float = threshold(
        0.2, "1",
        "Relative error of the driven share, by damping.",
        _TEST + "[driven]",
    )  # fmt: skip


_LINEAR = "tests/extract/test_linear_judge.py::test_a_threshold_decides"


@dataclass(frozen=True)
class LinearThresholds:
    """What is asked of a linear modal test before a channel is named."""

    active_phase_deg: float = threshold(
        2.0, "°",
        "Phase beyond ±90° of an active line.",
        _LINEAR + "[active_phase_deg]",
    )  # fmt: skip
    active_share: float = threshold(
        0.1, "1",
        "Share of active lines that names channels.",
        _LINEAR + "[active_share]",
    )  # fmt: skip
    deviations: float = threshold(
        4.0, "standard uncertainties",
        "Significance for a thousand lines.",
        _LINEAR + "[deviations]",
    )  # fmt: skip
    phase_deg: float = threshold(
        5.0, "°",
        "Residue phase that names a channel.",
        _LINEAR + "[phase_deg]",
    )  # fmt: skip
    strong_share: float = threshold(
        0.2, "1",
        "Smaller residues are turned by other modes.",
        _LINEAR + "[strong_share]",
    )  # fmt: skip
    fewest_lines: int = threshold(
        5, "lines",
        "Fewer lines near a mode show nothing.",
        _LINEAR + "[fewest_lines]",
    )  # fmt: skip
    hum_ratio: float = threshold(
        10.0, "1",
        "Line power over neighbours: 20 averages scatter by 2.",
        _LINEAR + "[hum_ratio]",
    )  # fmt: skip
    hum_share: float = threshold(
        1e-3, "1",
        "Relative rms that changes no fit.",
        _LINEAR + "[hum_share]",
    )  # fmt: skip
    hum_resolution_hz: float = threshold(
        1.0, "Hz",
        "Line spacing that identifies mains.",
        _LINEAR + "[hum_resolution_hz]",
    )  # fmt: skip


@dataclass(frozen=True)
class JudgementThresholds:
    """By what they judge."""

    gain: GainThresholds = field(default_factory=GainThresholds)
    linear: LinearThresholds = field(default_factory=LinearThresholds)


THRESHOLDS = JudgementThresholds()
