"""Fits of one explanation: steps, convergence, priors of dimensionless parameters."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class FitThresholds:
    """Fits of one explanation: steps, convergence, priors of dimensionless parameters."""

    scale_degrees_of_freedom: float = threshold(
        6.0, "1",
        "Stated noise is right to a factor of about 1.5; degrees of freedom of the prior of a scale.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[fits.scale_degrees_of_freedom]",
    )  # fmt: skip
    converged_cost_fall: float = threshold(
        0.2, "−2 ln p",
        "A promised fall of 0.2 is a step of √0.2 = 0.45 standard deviations.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.converged_cost_fall]",
    )  # fmt: skip
    largest_log_ratio: float = threshold(
        3.0, "1",
        "Ln of a predicted over a measured line beyond which it is as good as anywhere: keeps trial steps finite.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.largest_log_ratio]",
    )  # fmt: skip
    least_solved_share: float = threshold(
        0.3, "1",
        "Share of the rows below which a model without solutions cannot be compared.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[fits.least_solved_share]",
    )  # fmt: skip
    strength_std: float = threshold(
        3.0, "scales",
        "A strength of three scales is still ordinary.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.strength_std]",
    )  # fmt: skip
    strength_spreads: tuple[float, ...] = threshold(
        (1.0, 10.0, 100.0), "1",
        "A nonlinear force may be many times the linear one: so many times the prior, each less probable.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.strength_spreads]",
    )  # fmt: skip
    shape_std: float = threshold(
        1.0, "ln",
        "A shape parameter is known to a factor of three.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[fits.shape_std]",
    )  # fmt: skip
