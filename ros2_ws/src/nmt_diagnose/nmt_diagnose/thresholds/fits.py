"""Fits of one explanation: steps, convergence, priors of dimensionless parameters."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class FitThresholds:
    """Fits of one explanation: steps, convergence, priors of dimensionless parameters."""

    scale_degrees_of_freedom: float = threshold(
        6.0, "1",
        "Prior of a noise scale: a factor of 1.5.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[fits.scale_degrees_of_freedom]",
    )  # fmt: skip
    converged_cost_fall: float = threshold(
        0.2, "−2 ln p",
        "Equals a step of 0.45 standard deviations.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.converged_cost_fall]",
    )  # fmt: skip
    largest_log_ratio: float = threshold(
        3.0, "1",
        "Bounds trial steps at far-off lines.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.largest_log_ratio]",
    )  # fmt: skip
    least_solved_share: float = threshold(
        0.3, "1",
        "With fewer solved rows models cannot be compared.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[fits.least_solved_share]",
    )  # fmt: skip
    strength_std: float = threshold(
        3.0, "scales",
        "A strength of three scales is still ordinary.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.strength_std]",
    )  # fmt: skip
    strength_spreads: tuple[float, ...] = threshold(
        (1.0, 10.0, 100.0), "1",
        "Wider, less probable priors of a nonlinear strength.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.strength_spreads]",
    )  # fmt: skip
    shape_std: float = threshold(
        1.0, "ln",
        "A shape parameter is known to a factor of three.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[fits.shape_std]",
    )  # fmt: skip
