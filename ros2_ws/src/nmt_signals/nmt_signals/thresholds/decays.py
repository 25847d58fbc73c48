"""Frequency and damping of decays over their amplitude."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class DecayThresholds:
    """Frequency and damping of decays over their amplitude."""

    hum_fewest_beats: float = threshold(
        3.0, "beats",
        "Fewer beats do not separate mode and mains.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.hum_fewest_beats]",
    )  # fmt: skip
    hum_passing_share: float = threshold(
        0.2, "1",
        "Share of a decay that crosses the mains.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.hum_passing_share]",
    )  # fmt: skip
    hum_roughness: float = threshold(
        0.05, "1",
        "Relative error of the smooth amplitude.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.hum_roughness]",
    )  # fmt: skip
    hum_sigmas: float = threshold(
        6.0, "σ",
        "Significance from which hum is removed.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.hum_sigmas]",
    )  # fmt: skip
    node_sigmas: float = threshold(
        5.0, "σ",
        "Amplitude over the noise from which a decay is followed.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.node_sigmas]",
    )  # fmt: skip
    unsettled_ratio: float = threshold(
        3.0, "1",
        "Residual ratio that shows another component.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[signals.decays.unsettled_ratio]",
    )  # fmt: skip
    fast_log_fall: float = threshold(
        2.0, "ln amplitude",
        "A decay that falls faster leaves nothing to wait for.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[signals.decays.fast_log_fall]",
    )  # fmt: skip
    fewest_periods: int = threshold(
        12, "periods",
        "Fewer do not determine a changing amplitude.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.fewest_periods]",
    )  # fmt: skip
    fewest_samples_per_period: float = threshold(
        3.0, "samples",
        "The window's band and its image would overlap.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.fewest_samples_per_period]",
    )  # fmt: skip
    frame_fewest_samples: int = threshold(
        32, "samples",
        "Shorter frames have no spectrum.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.frame_fewest_samples]",
    )  # fmt: skip
    ridge_log_change: float = threshold(
        0.25, "1",
        "Relative frequency change between frames.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.ridge_log_change]",
    )  # fmt: skip
    other_ridge_share: float = threshold(
        0.01, "1",
        "Weaker ridges are ignored.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.other_ridge_share]",
    )  # fmt: skip
    ridge_peak_ratio: float = threshold(
        20.0, "1",
        "Power of a peak over the median around it.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.ridge_peak_ratio]",
    )  # fmt: skip
    turning_fewest_samples: int = threshold(
        10, "samples",
        "Samples a period that show the noise above order three.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.turning_fewest_samples]",
    )  # fmt: skip
    turning_interval_periods: tuple[float, ...] = threshold(
        (0.35, 0.7), "periods",
        "Expected time between turning points.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.turning_interval_periods]",
    )  # fmt: skip
    turning_sigmas: float = threshold(
        10.0, "σ",
        "Significance of a turning point.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.turning_sigmas]",
    )  # fmt: skip
    turning_smallest_share: float = threshold(
        0.02, "1",
        "Swing at which the decay has ended.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.turning_smallest_share]",
    )  # fmt: skip
    turning_fine_samples: int = threshold(
        40, "samples",
        "Interpolated samples a period.",
        "tests/extract/test_short_decays.py::test_ten_samples_a_period_are_enough",
    )  # fmt: skip
    turning_fewest_swings: int = threshold(
        3, "half swings",
        "Two give frequency and damping, the third confirms.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.turning_fewest_swings]",
    )  # fmt: skip
    switch_off_periods: int = threshold(
        1, "periods",
        "Periods within which the drive goes to zero.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.switch_off_periods]",
    )  # fmt: skip
    same_line: float = threshold(
        0.02, "1",
        "Relative distance of two frequencies that are one.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.decays.same_line]",
    )  # fmt: skip
    narrower_gain: float = threshold(
        0.5, "1",
        "Reduction of uncertainty that narrows the band.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.narrower_gain]",
    )  # fmt: skip
    largest_log_std: float = threshold(
        0.03, "1",
        "Uncertainty of ln ω beyond which an amplitude tells nothing.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[signals.decays.largest_log_std]",
    )  # fmt: skip
