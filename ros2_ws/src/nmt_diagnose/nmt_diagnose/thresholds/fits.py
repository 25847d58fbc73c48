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
        "",
    )  # fmt: skip
    most_steps: int = threshold(
        25, "1",
        "Steps of a fit; one that needs more is continued as a finalist.",
        "",
    )  # fmt: skip
    converged_cost_fall: float = threshold(
        0.2, "−2 ln p",
        "A promised fall of 0.2 is a step of √0.2 = 0.45 standard deviations.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.converged_cost_fall]",
    )  # fmt: skip
    largest_step: float = threshold(
        3.0, "prior deviations",
        "The first order holds for a few prior deviations at most.",
        "",
    )  # fmt: skip
    approach_shares: tuple[float, ...] = threshold(
        (0.1, 0.01, 0.001), "1",
        "Shares of the size of each row that are added to its noise one after the other, so that no group is "
        "given up early.",
        "",
    )  # fmt: skip
    approach_steps: int = threshold(
        10, "1",
        "Steps of each stage of an approach from afar; it only has to come near.",
        "",
    )  # fmt: skip
    broyden_least_gain_ratio: float = threshold(
        0.75, "1",
        "Actual over promised fall below which sensitivities are computed anew after a step.",
        "",
    )  # fmt: skip
    damping_gain_ratio: float = threshold(
        0.25, "1",
        "Actual over promised fall below which the next step is damped, as usual for Levenberg's method.",
        "",
    )  # fmt: skip
    most_reweightings: int = threshold(
        20, "1",
        "Reweightings of chain and scales for one prediction; near the optimum three suffice.",
        "",
    )  # fmt: skip
    continuations: int = threshold(
        3, "1",
        "Times that a fit which has not converged is continued.",
        "",
    )  # fmt: skip
    largest_log_ratio: float = threshold(
        3.0, "1",
        "Ln of a predicted over a measured line beyond which it is as good as anywhere: keeps trial steps finite.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[fits.largest_log_ratio]",
    )  # fmt: skip
    chain_rounds: int = threshold(
        2, "1",
        "Times that the measuring chain is taken anew about the model's fit: it is linear, and the second round "
        "starts near.",
        "",
    )  # fmt: skip
    refit_steps: int = threshold(
        8, "1",
        "Steps of a refit to a part of the rows, which starts at the optimum of all.",
        "",
    )  # fmt: skip
    refit_refreshes: int = threshold(
        2, "1",
        "Times that sensitivities are computed anew in a refit to a part of the rows.",
        "",
    )  # fmt: skip
    first_refreshes: int = threshold(
        3, "1",
        "Times that sensitivities are computed anew in the first fit of a candidate; finalists are fitted to the "
        "end.",
        "",
    )  # fmt: skip
    least_solved_share: float = threshold(
        0.3, "1",
        "Share of the rows below which a model without solutions cannot be compared.",
        "",
    )  # fmt: skip
    fine_harmonics: int = threshold(
        27, "1",
        "Order of the solution that shows what the harmonic balance leaves out: three times as many leave 2 % of "
        "it.",
        "",
    )  # fmt: skip
    random_lines: int = threshold(
        160, "1",
        "Most lines of a random test: neighbouring ones show the same.",
        "",
    )  # fmt: skip
    most_trials: int = threshold(
        6, "1",
        "Damped trials of one step before the fit ends.",
        "",
    )  # fmt: skip
    large_log_frequency: float = threshold(
        0.01, "1",
        "Change of ln frequency that is large: a bandwidth of 1 %.",
        "",
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
        "",
    )  # fmt: skip
    largest_log_shape: float = threshold(
        20.0, "ln",
        "Beyond this a shape is as good as anywhere: keeps trial steps of a fit finite.",
        "",
    )  # fmt: skip
