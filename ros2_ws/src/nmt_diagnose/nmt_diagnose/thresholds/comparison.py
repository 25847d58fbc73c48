"""Probabilities of explanations, of none and of something unnamed."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class ComparisonThresholds:
    """Probabilities of explanations, of none and of something unnamed."""

    prior_none: float = threshold(
        0.6, "1",
        "Most tested models lack nothing.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.prior_none]",
    )  # fmt: skip
    prior_one_effect: float = threshold(
        0.25, "1",
        "Prior probability that one effect of the library is missing.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.prior_one_effect]",
    )  # fmt: skip
    prior_two_effects: float = threshold(
        0.05, "1",
        "Prior probability that two effects of the library are missing.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.prior_two_effects]",
    )  # fmt: skip
    prior_unnamed: float = threshold(
        0.1, "1",
        "Prior probability that something is missing which the library lacks.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.prior_unnamed]",
    )  # fmt: skip
    noise_probability: float = threshold(
        0.05, "1",
        "Significance of noise against an unnamed cause.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.noise_probability]",
    )  # fmt: skip
    too_weak_share: float = threshold(
        0.16, "1",
        "Tests with an effect too weak to show: 4 of 25 in laboratories.",
        "tests/diagnose/test_hidden_effects.py::test_what_the_next_test_adds_is_its_share_of_the_range_of_strengths",
    )  # fmt: skip
    partial_named_share: float = threshold(
        0.44, "1",
        "Partial explanations with a true library effect: 7 of 16.",
        "tests/diagnose/test_credible_answers.py::test_a_partial_explanation_leaves_room_for_what_the_library_lacks",
    )  # fmt: skip
    credible_probability: float = threshold(
        0.95, "1",
        "Probability of the stated set of answers.",
        "tests/diagnose/test_credible_answers.py::test_the_fewest_answers_hold_95_per_cent",
    )  # fmt: skip
    fewest_levels_of_trend: int = threshold(
        5, "levels",
        "Levels that a comparison of the ends needs.",
        "tests/diagnose/test_trend_over_levels.py::test_few_levels_have_no_trend",
    )  # fmt: skip
    place_form_std: float = threshold(
        0.02, "1",
        "Shape error of an ordinary model at a point.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.place_form_std]",
    )  # fmt: skip
    equivalent_sigmas: float = threshold(
        3.0, "σ",
        "Distance below which recordings do not distinguish two explanations.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[comparison.equivalent_sigmas]",
    )  # fmt: skip
    source_sizes: tuple[float, ...] = threshold(
        (0.003, 0.03, 0.3, 3.0), "% of force or response",
        "Sizes that an unnamed source may have, a decade apart.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[comparison.source_sizes]",
    )  # fmt: skip
    credible_sigmas: float = threshold(
        3.0, "prior deviations",
        "A parameter further from its prior is implausible.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.credible_sigmas]",
    )  # fmt: skip
    limit_std: float = threshold(
        0.5, "1",
        "Relative spread of a physical limit.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[comparison.limit_std]",
    )  # fmt: skip
    incredible_probability: float = threshold(
        0.01, "1",
        "Significance of the furthest parameter.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[comparison.incredible_probability]",
    )  # fmt: skip
    source_level_length: float = threshold(
        1.5, "ln level",
        "Range of ln level with a constant unnamed source.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[comparison.source_level_length]",
    )  # fmt: skip
    source_line_length: float = threshold(
        0.7, "ln frequency",
        "Range of ln frequency with a constant unnamed source.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[comparison.source_line_length]",
    )  # fmt: skip
    source_least_eigenvalue: float = threshold(
        0.01, "1",
        "Smaller eigenvalues add nothing.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[comparison.source_least_eigenvalue]",
    )  # fmt: skip
