"""Laws of local forces that are read from held levels."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class LawThresholds:
    """Laws of local forces that are read from held levels."""

    force_share: float = threshold(
        0.002, "1",
        "Force residual over the modal force that acts: what ordinary cells and loops repeat within, 0.15 to 0.3 %.",

        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    shape_share: float = threshold(
        1e-4, "1",
        "Shape of a level over the response: how well ordinary accelerometers repeat from level to level.",

        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    harmonic_share: float = threshold(
        1e-5, "1",
        "Harmonics over the fundamental that sensors make of their own: a hundredth of the harmonic that matters.",

        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    mode_frequency_std: float = threshold(
        0.01, "1", "Natural frequencies of a model that was not fitted: two moduli of 1 % each, half of their sum.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    mode_damping_std: float = threshold(
        0.3, "1", "Damping ratios of a model, as in the table of model priors.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    least_damping_std: float = threshold(
        2e-4, "1", "Damping ratio that a model without damping may lack: that of a welded structure.",
        "tests/diagnose/test_law_thresholds.py::test_the_damping_that_a_model_without_any_may_lack_is_stated",
    )  # fmt: skip
    transfer_std: float = threshold(
        0.02, "1", "Response far from its modes to a local force: gain of the sensor, form and mass of the modes.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    form_std: float = threshold(
        0.01, "1", "Form of the mode under test at a sensor: as a gain, 1 %.",
        "tests/diagnose/test_law_thresholds.py::test_rows_and_errors_are_as_uncertain_as_stated",
    )  # fmt: skip
    least_resolution: float = threshold(
        0.1, "1", "Least singular value of shapes of near modes at the sensors: below it 1 % of form is 10 % of q.",
        "tests/diagnose/test_law_near_modes.py::test_sensors_that_do_not_tell_near_modes_apart_are_no_reading",
    )  # fmt: skip
    fewest_levels: int = threshold(
        4, "1", "Levels from which one can be left out between the lowest and the highest.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    least_motion_share: float = threshold(
        0.03, "1", "Motion of a place over the largest: forces where nothing moves are not seen.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    open_motion_share: float = threshold(
        0.2, "1", "What noise leaves open of the motion of a place of a driven record, over it: forms lose 4 % by it.",
        "tests/diagnose/test_driven_law.py::test_a_place_whose_motion_no_channel_tells_is_not_named",
    )  # fmt: skip
    largest_slip_share: float = threshold(
        0.7, "1", "Largest slip displacement over the largest motion: what hardly slips is a spring.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    alike_score_ratio: float = threshold(
        1.12, "1", "Score over the best up to which the law of fewest elements is taken.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    shape_score_ratio: float = threshold(
        1.01, "1", "Score over that of a longer law of the same family up to which a record's law is the shorter one.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    place_score_ratio: float = threshold(
        1.3, "1", "Score over the best up to which places are not told apart.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    told_score_ratio: float = threshold(
        0.5, "1", "Score with the law over that without it from which on it is told.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    second_score_ratio: float = threshold(
        0.75, "1", "Score with a second law over that of the first alone from which on it is told.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    least_null_score: float = threshold(
        1.0, "1", "Score of the model without a law below which nothing is read: that is noise and tolerances.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    pull_sigmas: float = threshold(
        3.0, "1", "Errors of chain and model beyond so many of their standard deviations: the law is not told.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    second_from_score: float = threshold(
        0.5, "1", "Score from which on a second law is looked for: healthy structures leave 0.2 to 0.5 of tolerances.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    single_closure: float = threshold(
        0.95, "1", "Share of the gap closed by a law from which on a second must halve the rest: grids leave 1 to 5 %.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    clear_score_ratio: float = threshold(
        0.5, "1",
        "Score with a second law over that of a first that closes nearly all from which on it is told; of a record "
        "also that of the law beside a late force over that of the law in step.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    start_score_ratio: float = threshold(
        0.8, "1", "Score with the law over that without it from which on the search begins at it, too.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    dry_stick_share: float = threshold(
        0.2, "1", "The same over the motion of the smallest level, at most.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
    dry_slip_share: float = threshold(
        0.02, "1", "Slip displacement over the largest motion with which a slider stands for dry friction.",
        "tests/diagnose/test_law_thresholds.py::test_a_threshold_decides",
    )  # fmt: skip
