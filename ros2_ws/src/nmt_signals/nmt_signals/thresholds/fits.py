"""Fits of sines and of rational functions, and averages of frequency responses."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class SignalFitThresholds:
    """Fits of sines and of rational functions, and averages of frequency responses."""

    fewest_averages: int = threshold(
        3, "averages",
        "Fewer averages show no coherence.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[signals.fits.fewest_averages]",
    )  # fmt: skip
    rational_most_lines: int = threshold(
        3000, "lines",
        "More lines show the same and take longer.",
        "",
    )  # fmt: skip
    rational_steps: int = threshold(
        40, "1",
        "Steps of a rational fit at each precision.",
        "",
    )  # fmt: skip
    sine_first_periods: float = threshold(
        6.0, "periods",
        "First piece of a sine of unknown frequency: its guess is right to a small part of a turn there.",
        "",
    )  # fmt: skip
    sine_growth: float = threshold(
        4.0, "1",
        "Factor from piece to piece; the frequency is known to less than a turn of the next.",
        "",
    )  # fmt: skip
    sine_steps: int = threshold(
        30, "1",
        "Steps of a fit of frequency, amplitude and phase.",
        "",
    )  # fmt: skip
    local_resonance_gain: float = threshold(
        15.0, "ln likelihood",
        "A resonance is there where it raises the log-likelihood of the lines around it by so much.",
        "",
    )  # fmt: skip
    local_pole_steps: int = threshold(
        8, "1",
        "How often the place of such a resonance is improved.",
        "",
    )  # fmt: skip
    local_linear_steps: int = threshold(
        3, "1",
        "How many of these steps are linear.",
        "",
    )  # fmt: skip
    driven_share: float = threshold(
        0.25, "1",
        "Power of the drive over its largest from which a line is driven.",
        "",
    )  # fmt: skip
    highest_share: float = threshold(
        0.4, "sampling rates",
        "Above it anti-alias filters fall.",
        "",
    )  # fmt: skip
