"""Laws of local forces that are read from held levels."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class LawThresholds:
    """Laws of local forces that are read from held levels."""

    force_share: float = threshold(
        0.002, "1",
        "Force repeatability of cells and loops: 0.15 to 0.3 %.",

        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    shape_share: float = threshold(
        1e-4, "1",
        "Repeatability of accelerometer shapes between levels.",

        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    harmonic_share: float = threshold(
        1e-5, "1",
        "Harmonics made by sensors: 1 % of one that matters.",

        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    mode_frequency_std: float = threshold(
        0.01, "1", "Natural frequency of an unfitted model.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    mode_damping_std: float = threshold(
        0.3, "1", "Damping ratio of a model, as its prior.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    least_damping_std: float = threshold(
        2e-4, "1", "Damping missing in an undamped model: a welded structure.",
        "tests/diagnose/test_law_thresholds.py::test_the_damping_that_a_model_without_any_may_lack_is_stated",
    )  # fmt: skip
    transfer_std: float = threshold(
        0.02, "1", "Response to a local force: gain, shape and modal mass.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    form_std: float = threshold(
        0.01, "1", "Shape of the tested mode at a sensor.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    least_resolution: float = threshold(
        0.1, "1", "Smallest singular value of near shapes: 1 % becomes 10 % of q.",
        "tests/diagnose/test_law_near_modes.py::test_sensors_that_do_not_tell_near_modes_apart_are_no_reading",
    )  # fmt: skip
    fewest_levels: int = threshold(
        4, "1", "Levels that allow one to be held out inside.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    least_motion_share: float = threshold(
        0.03, "1", "Forces at smaller motion do not show.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    open_motion_share: float = threshold(
        0.2, "1", "Motion uncertainty of a place: 4 % loss in shape.",
        "tests/diagnose/test_driven_law.py::test_a_place_whose_motion_no_channel_tells_is_not_named",
    )  # fmt: skip
    largest_slip_share: float = threshold(
        0.7, "1", "A larger slip displacement is a spring.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    alike_score_ratio: float = threshold(
        1.12, "1", "Among scores within it the fewest elements win.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    place_score_ratio: float = threshold(
        1.3, "1", "Score ratio up to which places are indistinguishable.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    told_score_ratio: float = threshold(
        0.5, "1", "Score ratio, with over without the law, that reports it.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    second_score_ratio: float = threshold(
        0.75, "1", "Score ratio, two laws over one, that reports the second.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    least_null_score: float = threshold(
        1.0, "1", "Smaller scores without a law are noise.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    pull_sigmas: float = threshold(
        3.0, "1", "Larger errors of chain and model refuse the law.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    second_from_score: float = threshold(
        0.5, "1", "Healthy structures leave 0.2 to 0.5.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    single_closure: float = threshold(
        0.95, "1", "Beyond it a second law must halve the remainder.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    clear_score_ratio: float = threshold(
        0.5, "1",
        "Score ratio for a second law after near closure, or a delayed force.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    start_score_ratio: float = threshold(
        0.8, "1", "Score ratio from which the search starts at the law.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    dry_stick_share: float = threshold(
        0.2, "1", "The same over the smallest level's motion.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    dry_slip_share: float = threshold(
        0.02, "1", "Slip displacement share below which friction is dry.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
