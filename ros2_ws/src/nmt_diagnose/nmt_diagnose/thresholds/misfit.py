"""What a model that lacks nothing may still be off by, and what it leaves out."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class MisfitThresholds:
    """What a model that lacks nothing may still be off by, and what it leaves out."""

    shared_share: float = threshold(
        0.2, "size that matters",
        "Shared misfit of neighbours in a complete model.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[misfit.shared_share]",
    )  # fmt: skip
    independent_share: float = threshold(
        0.02, "size that matters",
        "Misfit that each level and line has for itself.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[misfit.independent_share]",
    )  # fmt: skip
    level_length: float = threshold(
        1.0, "ln level",
        "Change of level over which the misfit stays the same.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[misfit.level_length]",
    )  # fmt: skip
    line_length: float = threshold(
        0.3, "ln frequency",
        "Change of frequency over which the misfit stays the same.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[misfit.line_length]",
    )  # fmt: skip
    static_share_above: float = threshold(
        0.2, "1",
        "Static flexibility of modes above the band over that modelled.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[misfit.static_share_above]",
    )  # fmt: skip
    static_share_below: float = threshold(
        0.05, "1",
        "The same of modes below, such as a suspension.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[misfit.static_share_below]",
    )  # fmt: skip
    static_frequency_ratio: float = threshold(
        0.1, "1",
        "Frequency, over the resonance, of the static flexibility.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[misfit.static_frequency_ratio]",
    )  # fmt: skip
    large_log_ratio: float = threshold(
        1.0, "ln",
        "Ratio of magnitudes beyond which they have no common mean.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[misfit.large_log_ratio]",
    )  # fmt: skip
    shape_reach: float = threshold(
        2.0, "1",
        "Modes beyond this frequency ratio add a constant.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[misfit.shape_reach]",
    )  # fmt: skip
    largest_mesh_change: float = threshold(
        0.2, "1",
        "Beyond it mesh changes are not linear.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[misfit.largest_mesh_change]",
    )  # fmt: skip
    least_chain_error: float = threshold(
        1e-3, "1",
        "Weaker chain errors keep their prior variance and are left out.",
        "tests/diagnose/test_measured_noise.py::test_errors_of_the_chain_that_no_row_shows_are_left_out",
    )  # fmt: skip
