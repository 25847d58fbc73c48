"""Frequency and damping of decays over their amplitude."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class DecayThresholds:
    """Frequency and damping of decays over their amplitude."""

    hum_orders: tuple[int, ...] = threshold(
        (1, 2, 3), "1",
        "Orders of the mains that are taken out of a decay: supplies make the first three.",
        "",
    )  # fmt: skip
    hum_band_ratios: tuple[float, ...] = threshold(
        (0.5, 1.5), "1",
        "Over the mode's frequency, the widest band of the demodulation.",
        "",
    )  # fmt: skip
    hum_most_degree: int = threshold(
        7, "1",
        "Degree of the smooth course of the mode beside the hum.",
        "",
    )  # fmt: skip
    hum_fewest_beats: float = threshold(
        3.0, "beats",
        "Fewer beats between mode and mains do not tell them apart.",
        "",
    )  # fmt: skip
    hum_passing_share: float = threshold(
        0.05, "1",
        "Share of a decay in which the mode may pass the line of the mains.",
        "",
    )  # fmt: skip
    hum_roughness: float = threshold(
        0.05, "1",
        "Share of the mode's amplitude by which the smooth course may be wrong.",
        "",
    )  # fmt: skip
    hum_passes: int = threshold(
        4, "1",
        "Passes between hum and mode.",
        "",
    )  # fmt: skip
    hum_sigmas: float = threshold(
        6.0, "σ",
        "Amplitude over its uncertainty from which a hum is taken out.",
        "",
    )  # fmt: skip
    segment_degrees: tuple[int, ...] = threshold(
        (1, 3, 5), "1",
        "Degrees of the phase over a segment: odd ones, so that the middle is a frequency.",
        "",
    )  # fmt: skip
    segment_fewest_periods: int = threshold(
        4, "periods",
        "Periods of a segment where the decay is fast.",
        "",
    )  # fmt: skip
    segment_most_periods: int = threshold(
        7, "periods",
        "Periods of a segment elsewhere.",
        "",
    )  # fmt: skip
    segment_log_step: float = threshold(
        1.2, "ln amplitude",
        "Fall of the amplitude in a segment that is shorter.",
        "",
    )  # fmt: skip
    node_sigmas: float = threshold(
        5.0, "σ",
        "Amplitude over the noise from which a decay is followed.",
        "",
    )  # fmt: skip
    periods_per_degree: int = threshold(
        2, "periods",
        "Periods that a degree of the polynomial takes.",
        "",
    )  # fmt: skip
    settling_periods: tuple[int, ...] = threshold(
        (0, 1, 2, 3, 4, 6, 8, 10), "periods",
        "What rings beside the mode may take so long to fade.",
        "",
    )  # fmt: skip
    unsettled_ratio: float = threshold(
        3.0, "1",
        "Residual of a segment over that of the last from which something else rings in it.",
        "",
    )  # fmt: skip
    fast_log_fall: float = threshold(
        2.0, "ln amplitude",
        "A decay that falls faster leaves nothing to wait for.",
        "",
    )  # fmt: skip
    large_log_range: float = threshold(
        1.0, "ln amplitude",
        "Range below the largest amplitude in which segments are half as long.",
        "",
    )  # fmt: skip
    fewest_periods: int = threshold(
        12, "periods",
        "Fewer periods do not carry an amplitude and a frequency that change.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.fewest_periods]",
    )  # fmt: skip
    fewest_samples_per_period: float = threshold(
        3.0, "samples",
        "The window's band and its image would overlap.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.fewest_samples_per_period]",
    )  # fmt: skip
    window_boxcars: int = threshold(
        4, "1",
        "Boxcars that are folded to the window: side lobes fall with the fourth power.",
        "",
    )  # fmt: skip
    frame_fewest_samples: int = threshold(
        32, "samples",
        "Shorter frames have no spectrum.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.frame_fewest_samples]",
    )  # fmt: skip
    most_frames: int = threshold(
        256, "frames",
        "Frames without overlap into which a decay is cut.",
        "",
    )  # fmt: skip
    ridge_log_change: float = threshold(
        0.25, "1",
        "Relative change of frequency from frame to frame that is followed.",
        "",
    )  # fmt: skip
    ridge_half_width_bins: int = threshold(
        2, "bins",
        "Bins on either side of a peak that belong to it: the window's main lobe.",
        "",
    )  # fmt: skip
    fewest_bins: int = threshold(
        3, "bins",
        "Lower bins are the mean and its leakage.",
        "",
    )  # fmt: skip
    other_ridge_share: float = threshold(
        0.01, "1",
        "Share of the strongest ridge's energy below which another is none.",
        "",
    )  # fmt: skip
    most_ridges: int = threshold(
        3, "1",
        "Ridges that are followed.",
        "",
    )  # fmt: skip
    ridge_peak_ratio: float = threshold(
        20.0, "1",
        "Power of a peak over the median around it.",
        "",
    )  # fmt: skip
    demodulation_passes: int = threshold(
        3, "1",
        "Passes between phase and demodulated signal.",
        "",
    )  # fmt: skip
    smoothed_values: int = threshold(
        5, "values",
        "Values of the filter that smooths the frequency between passes.",
        "",
    )  # fmt: skip
    most_values: int = threshold(
        3000, "values",
        "Values of a slow signal that are kept.",
        "",
    )  # fmt: skip
    turning_smoothing_periods: float = threshold(
        0.2, "periods",
        "Smoothing before turning points are looked for.",
        "",
    )  # fmt: skip
    vertex_half_width_periods: float = threshold(
        0.1, "periods",
        "Either side of a turning point that the parabola is fitted to: a sine is one there within 0.4 %.",
        "",
    )  # fmt: skip
    turning_fewest_samples: int = threshold(
        10, "samples",
        "Samples of a period that turning points need: fewer leave nothing above the third harmonic to tell noise by.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.turning_fewest_samples]",
    )  # fmt: skip
    turning_interval_periods: tuple[float, ...] = threshold(
        (0.35, 0.7), "periods",
        "Time between turning points, half a period of a motion that changes.",
        "",
    )  # fmt: skip
    turning_sigmas: float = threshold(
        10.0, "σ",
        "Swing over the noise from which a turning point is one.",
        "",
    )  # fmt: skip
    turning_smallest_share: float = threshold(
        0.02, "1",
        "Share of the largest swing below which the decay has ended.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.turning_smallest_share]",
    )  # fmt: skip
    turning_fine_samples: int = threshold(
        40, "samples",
        "Samples of a period to which coarser ones are interpolated: eight on the fitted piece.",
        "tests/extract/test_short_decays.py::test_ten_samples_a_period_are_enough",
    )  # fmt: skip
    turning_fewest_swings: int = threshold(
        3, "half swings",
        "Two of them make a frequency and a damping, the third shows that the second was no end.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.decays.turning_fewest_swings]",
    )  # fmt: skip
    vertex_passes: int = threshold(
        3, "1",
        "Times that the piece is centred on its vertex.",
        "",
    )  # fmt: skip
    switch_off_periods: int = threshold(
        1, "periods",
        "Periods within which the drive goes to zero.",
        "",
    )  # fmt: skip
    widths: tuple[int, ...] = threshold(
        (1, 2, 4), "1",
        "Widths of the demodulation that are tried.",
        "",
    )  # fmt: skip
    same_line: float = threshold(
        0.02, "1",
        "Relative distance of two frequencies that are one.",
        "",
    )  # fmt: skip
    narrower_gain: float = threshold(
        0.5, "1",
        "Share of the uncertainty from which a narrower band is taken.",
        "",
    )  # fmt: skip
    compared_amplitudes: int = threshold(
        60, "1",
        "Amplitudes at which two widths are compared.",
        "",
    )  # fmt: skip
    largest_log_std: float = threshold(
        0.03, "1",
        "Uncertainty of ln ω beyond which an amplitude tells nothing.",
        "",
    )  # fmt: skip
