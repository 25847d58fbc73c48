"""Uncertainties of observables from the recordings."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class NoiseThresholds:
    """Uncertainties of observables from the recordings."""

    drift_sigmas: float = threshold(
        4.0, "σ",
        "Noise makes such a drift once in 16 000 windows.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[noise.drift_sigmas]",
    )  # fmt: skip
    lean_ratio: float = threshold(
        2.0, "1",
        "Mean of a transient over its change: 1.8 measured.",
        "tests/diagnose/test_threshold_numbers.py::test_a_phase_that_drifts_leans_by_twice_its_change",
    )  # fmt: skip
    stepped_default_std: float = threshold(
        0.02, "1",
        "Relative noise of a table that shows none.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[noise.stepped_default_std]",
    )  # fmt: skip
    stepped_fewest_for_scatter: int = threshold(
        12, "lines",
        "Fewer lines do not show their scatter.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[noise.stepped_fewest_for_scatter]",
    )  # fmt: skip
    stepped_floor_log_likelihood: float = threshold(
        5.0, "1",
        "Likelihood that a noise common to all lines has to gain.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[noise.stepped_floor_log_likelihood]",
    )  # fmt: skip
    median_relative_std: float = threshold(
        1.7, "1",
        "Relative error of a median-based scatter, times √n (simulated).",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[noise.median_relative_std]",
    )  # fmt: skip
    table_default_std: float = threshold(
        0.02, "1",
        "The same of a backbone or linear response.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[noise.table_default_std]",
    )  # fmt: skip
    table_fewest_for_scatter: int = threshold(
        7, "points",
        "Fewer points do not show their scatter.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[noise.table_fewest_for_scatter]",
    )  # fmt: skip
    cubic_relative_std: float = threshold(
        1.3, "1",
        "Relative error of the scatter about local cubics, times √n.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[noise.cubic_relative_std]",
    )  # fmt: skip
    scatter_fewest_rows: int = threshold(
        3, "rows",
        "Rows with neighbours that a scatter estimate needs.",
        "tests/diagnose/test_row_scatter.py::test_a_threshold_of_the_scatter_decides[scatter_fewest_rows]",
    )  # fmt: skip
    scatter_probability: float = threshold(
        0.05, "1",
        "Probability of so little scatter at the largest allowed noise.",
        "tests/diagnose/test_row_scatter.py::test_a_threshold_of_the_scatter_decides[scatter_probability]",
    )  # fmt: skip
    floor_fewest_pairs: int = threshold(
        6, "pairs",
        "Fewer repeats do not show what a test repeats to.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[noise.floor_fewest_pairs]",
    )  # fmt: skip
    moderated_fewest: int = threshold(
        3, "variances",
        "Fewer variances do not show how they spread.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[noise.moderated_fewest]",
    )  # fmt: skip
    most_degrees_of_freedom: float = threshold(
        1e4, "1",
        "A variance with more is known.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[noise.most_degrees_of_freedom]",
    )  # fmt: skip
    settling_fewest: int = threshold(
        6, "sub-windows",
        "Fewer sub-windows show no transient.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[noise.settling_fewest]",
    )  # fmt: skip
    settling_sigmas: float = threshold(
        4.0, "σ",
        "Noise shows such a transient once in 250.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[noise.settling_sigmas]",
    )  # fmt: skip
    settling_inexact: float = threshold(
        0.02, "1",
        "Deviation of a transient from an exponential.",
        "tests/diagnose/test_threshold_numbers.py::test_the_form_of_a_transient_is_known_to_two_per_cent",
    )  # fmt: skip
