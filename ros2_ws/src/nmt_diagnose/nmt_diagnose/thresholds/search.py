"""The search for explanations: which candidates are fitted, and from where."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class SearchThresholds:
    """The search for explanations: which candidates are fitted, and from where."""

    first_effects: int = threshold(
        5, "1",
        "Effects that are fitted: to first order several laws do nearly the same.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.first_effects]",
    )  # fmt: skip
    first_locations: int = threshold(
        2, "1",
        "Locations of each effect that are fitted; others follow for the best.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.first_locations]",
    )  # fmt: skip
    missing_mode_fits: int = threshold(
        8, "1",
        "Places of a mode that the model lacks at which it is fitted, those first that come nearest as they begin.",
        "tests/diagnose/test_missing_mode.py::test_the_nearest_places_are_fitted",
    )  # fmt: skip
    least_cost_fall: float = threshold(
        6.0, "−2 ln p",
        "Promised fall of the cost below which nothing is fitted: less than the prior of one effect and its "
        "location costs.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[search.least_cost_fall]",
    )  # fmt: skip
    alike_cosine: float = threshold(
        0.98, "1",
        "Cosine between changes of the rows from which two effects count as one of those that are fitted.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[search.alike_cosine]",
    )  # fmt: skip
    pair_heads: int = threshold(
        2, "1",
        "Explanations that second effects are added to.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.pair_heads]",
    )  # fmt: skip
    second_effects: int = threshold(
        3, "1",
        "Second effects that are fitted to each head.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.second_effects]",
    )  # fmt: skip
    second_cost_fall: float = threshold(
        16.0, "−2 ln p",
        "Promised fall of the cost from which a second effect is fitted: the prior of a pair costs more than that "
        "of one.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.second_cost_fall]",
    )  # fmt: skip
    other_parameters: float = threshold(
        1.0, "σ of the prior",
        "Distance of a parameter of the model between two explanations from which the worse is fitted again from the "
        "better one's.",
        "tests/diagnose/test_what_is_asked.py::test_a_rival_is_fitted_again_from_the_parameters_of_the_leader",
    )  # fmt: skip
    weak_sigmas: float = threshold(
        3.0, "σ",
        "Strength below which a member of two effects contributes nothing.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.weak_sigmas]",
    )  # fmt: skip
    wider_strength: float = threshold(
        2.5, "prior deviations",
        "Strength over its prior deviation from which a wider part of the prior is tried.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[search.wider_strength]",
    )  # fmt: skip
    finalists: int = threshold(
        8, "1",
        "Explanations that are fitted again about the best one.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.finalists]",
    )  # fmt: skip
    far_behind_log_evidence: float = threshold(
        40.0, "ln evidence",
        "How far a finalist may lie behind: more than a fit to the end gains.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[search.far_behind_log_evidence]",
    )  # fmt: skip
    lost_cost_rise: float = threshold(
        20.0, "−2 ln p",
        "Rise of the cost over the fit without the effect from which a fit has diverged.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[search.lost_cost_rise]",
    )  # fmt: skip
    other_locations_share: float = threshold(
        0.1, "1",
        "Share of the best fall of the cost from which the best effect is fitted at its other locations, too.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.other_locations_share]",
    )  # fmt: skip
    noise_scale: float = threshold(
        2.0, "1",
        "Learnt scale of a group of rows from which an explanation is fitted again from the model as given.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[search.noise_scale]",
    )  # fmt: skip
    first_order_sigmas: float = threshold(
        1.0, "σ",
        "Change by a strength of one scale below which an effect shows at finite strength only.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[search.first_order_sigmas]",
    )  # fmt: skip
