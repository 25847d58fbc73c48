"""Which further test would tell explanations apart."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class NextTestThresholds:
    """Which further test would tell explanations apart."""

    least_sigmas: float = threshold(
        3.0, "σ",
        "Weaker tests are not proposed.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[next_test.least_sigmas]",
    )  # fmt: skip
    least_asked_sigmas: float = threshold(
        1.0, "σ",
        "Weaker tests between rivals are not made.",
        "tests/diagnose/test_investigation.py::test_levels_that_tell_rivals_little_apart_are_not_made",
    )  # fmt: skip
    least_information: float = threshold(
        1e-3, "nat",
        "Less informative tests between rivals are not made.",
        "tests/diagnose/test_investigation.py::test_a_test_that_tells_next_to_nothing_is_not_made",
    )  # fmt: skip
    doubtful_probability: float = threshold(
        0.05, "1",
        "Probability of no effect at all from which that competes.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[next_test.doubtful_probability]",
    )  # fmt: skip
    random_seconds: float = threshold(
        123.0, "s",
        "Bench time of './nmt linear' with its defaults.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[next_test.random_seconds]",
    )  # fmt: skip
    typical_response_std: float = threshold(
        5e-3, "1",
        "Uncertainty of an unmeasured random line.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[next_test.typical_response_std]",
    )  # fmt: skip
    second_class_share: float = threshold(
        0.02, "1",
        "Relative probability of the second class that asks a test.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[next_test.second_class_share]",
    )  # fmt: skip
    strength_decades: float = threshold(
        3.0, "decades",
        "Range of strengths, from hidden to obvious.",
        "tests/diagnose/test_hidden_effects.py::test_what_the_next_test_adds_is_its_share_of_the_range_of_strengths",
    )  # fmt: skip
