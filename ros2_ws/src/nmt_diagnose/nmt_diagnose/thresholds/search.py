"""The search for explanations: which candidates are fitted, and from where."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class SearchThresholds:
    """The search for explanations: which candidates are fitted, and from where."""

    first_effects: int = threshold(
        5, "1",
        "Effects fitted, since laws agree to first order.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.first_effects]",
    )  # fmt: skip
    first_locations: int = threshold(
        2, "1",
        "Locations fitted of each effect at first.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.first_locations]",
    )  # fmt: skip
    missing_mode_fits: int = threshold(
        8, "1",
        "Places at which a missing mode is fitted.",
        "tests/diagnose/test_missing_mode.py::test_the_nearest_places_are_fitted",
    )  # fmt: skip
    least_cost_fall: float = threshold(
        6.0, "−2 ln p",
        "Below it the prior of an effect costs more.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[search.least_cost_fall]",
    )  # fmt: skip
    alike_cosine: float = threshold(
        0.98, "1",
        "Effects with more similar changes count once.",
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
        "Promised fall that justifies a second effect's prior.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.second_cost_fall]",
    )  # fmt: skip
    other_parameters: float = threshold(
        1.0, "σ of the prior",
        "Parameter distance that triggers a refit from the better one.",
        "tests/diagnose/test_what_is_asked.py::test_a_rival_is_fitted_again_from_the_parameters_of_the_leader",
    )  # fmt: skip
    weak_sigmas: float = threshold(
        3.0, "σ",
        "Strength below which a member of two effects contributes nothing.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.weak_sigmas]",
    )  # fmt: skip
    wider_strength: float = threshold(
        2.5, "prior deviations",
        "Strength from which a wider prior is tried.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[search.wider_strength]",
    )  # fmt: skip
    finalists: int = threshold(
        8, "1",
        "Explanations that are fitted again about the best one.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.finalists]",
    )  # fmt: skip
    far_behind_log_evidence: float = threshold(
        40.0, "ln evidence",
        "More than a converged fit gains.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[search.far_behind_log_evidence]",
    )  # fmt: skip
    lost_cost_rise: float = threshold(
        20.0, "−2 ln p",
        "Rise of the cost that means divergence.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[search.lost_cost_rise]",
    )  # fmt: skip
    other_locations_share: float = threshold(
        0.1, "1",
        "Share of the best fall that admits other locations.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[search.other_locations_share]",
    )  # fmt: skip
    noise_scale: float = threshold(
        2.0, "1",
        "Learnt scale that triggers a refit from the given model.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[search.noise_scale]",
    )  # fmt: skip
    first_order_sigmas: float = threshold(
        1.0, "σ",
        "Smaller effects show at finite strength only.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[search.first_order_sigmas]",
    )  # fmt: skip
