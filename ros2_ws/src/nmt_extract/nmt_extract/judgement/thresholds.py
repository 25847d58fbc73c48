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
        "Misfit that the gain takes away: four standard deviations, as every window asks this of every channel anew.",
        _TEST + "[evidence]",
    )  # fmt: skip
    lead: float = threshold(
        9.0, "1",
        "Misfit that the gain of any other channel leaves beyond that of the one named: three standard deviations.",
        _TEST + "[lead]",
    )  # fmt: skip
    misfit: float = threshold(
        1.0, "1",
        "Misfit over the degrees of freedom that a gain may leave; with more, something else happens than a gain.",
        _TEST + "[misfit]",
    )  # fmt: skip
    smallest: float = threshold(
        0.05, "1",
        "Deviation of a gain that is named: calibration, cables and mounting together stay below it.",
        _TEST + "[smallest]",
    )  # fmt: skip
    model_shape: float = threshold(
        0.01, "1",
        "Standard deviation of a shape's value, of it, where the description states none: as of ordinary gains.",
        _TEST + "[model_shape]",
    )  # fmt: skip
    shape_floor: float = threshold(
        5e-4, "1",
        "The same of its largest value: modes beyond those described, and what matters to no result near a node.",
        _TEST + "[shape_floor]",
    )  # fmt: skip
    mixing: float = threshold(
        3.0, "1",
        "Share of a near mode over the shift of the frequency beside its distance: a force at one place mixes so.",
        _TEST + "[mixing]",
    )  # fmt: skip
    mixed: float = threshold(
        0.01, "1",
        "Share of a near mode that a level may have for no reason that is known: drift from level to level.",
        _TEST + "[mixed]",
    )  # fmt: skip
    driven: float = threshold(
        0.2, "1",
        "Error of the share that the exciters drive, of it: damping of a near mode is known to that.",
        _TEST + "[driven]",
    )  # fmt: skip


_LINEAR = "tests/extract/test_linear_judge.py::test_a_threshold_decides"


@dataclass(frozen=True)
class LinearThresholds:
    """What is asked of a linear modal test before a channel is named."""

    active_phase_deg: float = threshold(
        2.0, "°",
        "Phase of a mobility beyond ±90° from which a line counts as one at which the structure would give power.",
        _LINEAR + "[active_phase_deg]",
    )  # fmt: skip
    active_share: float = threshold(
        0.1, "1",
        "Share of such lines within an octave of a mode from which the channels at the drive point are named.",
        _LINEAR + "[active_share]",
    )  # fmt: skip
    deviations: float = threshold(
        4.0, "standard uncertainties",
        "By so many a phase must lie beyond its limit: some thousand lines are looked at.",
        _LINEAR + "[deviations]",
    )  # fmt: skip
    phase_deg: float = threshold(
        5.0, "°",
        "Phase of a residue from which a channel is named, as of a window's force and velocity.",
        _LINEAR + "[phase_deg]",
    )  # fmt: skip
    strong_share: float = threshold(
        0.2, "1",
        "Residue over the mode's largest from which its phase is looked at: near a node other modes turn it.",
        _LINEAR + "[strong_share]",
    )  # fmt: skip
    fewest_lines: int = threshold(
        5, "lines",
        "Fewer lines near a mode show nothing.",
        _LINEAR + "[fewest_lines]",
    )  # fmt: skip
    hum_ratio: float = threshold(
        10.0, "1",
        "Power of a line that no force makes over the largest of its neighbours: 20 averages scatter by a factor of 2.",
        _LINEAR + "[hum_ratio]",
    )  # fmt: skip
    hum_share: float = threshold(
        1e-3, "1",
        "Rms of such a line over the channel's from which it is named: less changes no fit.",
        _LINEAR + "[hum_share]",
    )  # fmt: skip
    hum_resolution_hz: float = threshold(
        1.0, "Hz",
        "Distance of the lines up to which one of them can be told to be the mains.",
        _LINEAR + "[hum_resolution_hz]",
    )  # fmt: skip


@dataclass(frozen=True)
class JudgementThresholds:
    """By what they judge."""

    gain: GainThresholds = field(default_factory=GainThresholds)
    linear: LinearThresholds = field(default_factory=LinearThresholds)


THRESHOLDS = JudgementThresholds()
