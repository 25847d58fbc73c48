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
    local_resonance_gain: float = threshold(
        15.0, "ln likelihood",
        "Gain in log-likelihood that shows a resonance.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.fits.local_resonance_gain]",
    )  # fmt: skip
    driven_share: float = threshold(
        0.25, "1",
        "Relative drive power of a driven line.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.fits.driven_share]",
    )  # fmt: skip
    highest_share: float = threshold(
        0.4, "sampling rates",
        "Above it anti-alias filters fall.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.fits.highest_share]",
    )  # fmt: skip
