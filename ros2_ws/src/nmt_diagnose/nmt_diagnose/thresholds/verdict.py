"""Verdict, held-out data, warnings and what is reported."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class VerdictThresholds:
    """Verdict, held-out data, warnings and what is reported."""

    alarm_log_odds: float = threshold(
        1.5, "ln odds",
        "Odds that report a gap: four and a half to one.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.alarm_log_odds]",
    )  # fmt: skip
    sure_log_evidence: float = threshold(
        30.0, "ln evidence",
        "Reports an effect that parameters absorb: healthy at most 21, 4 g on a beam 1860.",
        "tests/diagnose/test_what_is_asked.py::"
        "test_evidence_demands_an_effect_although_re_fitted_parameters_leave_less_than_matters",
    )  # fmt: skip
    credible_noise_scale: float = threshold(
        10.0, "1",
        "Noise scale of lines that a missing mode cannot hide.",
        "tests/diagnose/test_what_is_asked.py::test_what_lines_leave_is_no_noise_however_much_they_scatter",
    )  # fmt: skip
    chance_sigmas: float = threshold(
        3.0, "σ",
        "Allowance for chance: once in 700 recordings.",
        "tests/diagnose/test_what_is_asked.py::test_the_weakest_that_would_show_is_reported",
    )  # fmt: skip
    largest_strength: float = threshold(
        1000.0, "scales",
        "No rig has a stronger effect; listed ones show from 0.0001 to 20.",
        "tests/diagnose/test_measured_noise.py::test_the_weakest_that_would_show_is_sure",
    )  # fmt: skip
    recalibration_cost_fall: float = threshold(
        25.0, "−2 ln p",
        "Fall by the model's parameters alone: five standard deviations.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.recalibration_cost_fall]",
    )  # fmt: skip
    partial_closed_share: float = threshold(
        0.8, "1",
        "Share of the gap that a partial effect must close.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.partial_closed_share]",
    )  # fmt: skip
    partial_closed_share_of_two: float = threshold(
        0.95, "1",
        "The same of two effects, which imitate others up to 85 %.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.partial_closed_share_of_two]",
    )  # fmt: skip
    partial_pulled_sigmas: float = threshold(
        10.0, "1",
        "Parameter deviation allowed to a partial effect: true 5.7, false 14.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.partial_pulled_sigmas]",
    )  # fmt: skip
    nearest_closed_share: float = threshold(
        1.0 / 3.0, "1",
        "The nearest explanation must close this share.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.nearest_closed_share]",
    )  # fmt: skip
    worse_prediction_sigmas: float = threshold(
        1.0, "σ",
        "Significance of a worse held-out prediction.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.worse_prediction_sigmas]",
    )  # fmt: skip
    judged_explanations: int = threshold(
        3, "1",
        "Explanations judged on held-out data.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.judged_explanations]",
    )  # fmt: skip
    as_likely_share: float = threshold(
        1.0 / 3.0, "1",
        "Relative probability from which another place is named.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.as_likely_share]",
    )  # fmt: skip
    open_prediction_share: float = threshold(
        0.3, "1",
        "Prediction uncertainty over change that still judges.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[verdict.open_prediction_share]",
    )  # fmt: skip
    left_over_scale: float = threshold(
        2.0, "1",
        "Residual over the floor that exceeds noise.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.left_over_scale]",
    )  # fmt: skip
    small_left_share: float = threshold(
        0.15, "1",
        "Residual share that gives a warning.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.small_left_share]",
    )  # fmt: skip
    visible_sigmas: float = threshold(
        5.0, "σ",
        "Chance 1 in 1.7 million, for up to a thousand candidates.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.visible_sigmas]",
    )  # fmt: skip
    excess_sigmas: float = threshold(
        3.0, "σ",
        "Significance of a residual's size in a level or band.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.excess_sigmas]",
    )  # fmt: skip
    cause_probability: float = threshold(
        0.9, "1",
        "From it the cause is stated, not the most probable one.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.cause_probability]",
    )  # fmt: skip
    least_remainder: float = threshold(
        0.01, "1",
        "A gap of which less is left is closed.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.least_remainder]",
    )  # fmt: skip
    remainder_third_share: float = threshold(
        0.5, "1",
        "Share of squares in one third of the levels.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.remainder_third_share]",
    )  # fmt: skip
    remainder_fewest_levels: int = threshold(
        3, "1",
        "Fewer levels have no thirds.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.remainder_fewest_levels]",
    )  # fmt: skip
    course_fewest_levels: int = threshold(
        5, "1",
        "A quadratic through fewer levels leaves too little to test.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.course_fewest_levels]",
    )  # fmt: skip
    held_out_fewest_levels: int = threshold(
        4, "1",
        "With fewer, every second leaves too few.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.held_out_fewest_levels]",
    )  # fmt: skip
    held_out_fewest_responses: int = threshold(
        3, "1",
        "Levels of responses that allow hold-out.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.held_out_fewest_responses]",
    )  # fmt: skip
    held_out_fewest_for_two: int = threshold(
        5, "1",
        "Levels of responses that allow two held out.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.held_out_fewest_for_two]",
    )  # fmt: skip
    least_location_probability: float = threshold(
        0.005, "1",
        "Less probable locations would read 0 %.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.least_location_probability]",
    )  # fmt: skip
    other_location_probability: float = threshold(
        0.05, "1",
        "Probability from which a sentence names another location, too.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.other_location_probability]",
    )  # fmt: skip
    least_gap_ratio: float = threshold(
        1.02, "1",
        "Smaller gaps over the floor cannot be closed.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.least_gap_ratio]",
    )  # fmt: skip
    many_lines: int = threshold(
        60, "lines",
        "From it lines are resampled by tenths.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.many_lines]",
    )  # fmt: skip
    many_levels: int = threshold(
        20, "levels",
        "From it levels are resampled by tenths.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.many_levels]",
    )  # fmt: skip
    factor_ratio: float = threshold(
        2.5, "1",
        "Larger factors are wrong units.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_ratio]",
    )  # fmt: skip
    factor_spread: float = threshold(
        0.2, "1",
        "Median spread of ln factor and phase of a constant factor.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_spread]",
    )  # fmt: skip
    factor_correlation: float = threshold(
        0.9, "1",
        "Correlation that shows a mere factor.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_correlation]",
    )  # fmt: skip
    factor_fewest_rows: int = threshold(
        3, "rows",
        "Fewer rows of a channel show no factor.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_fewest_rows]",
    )  # fmt: skip
    unexplained_share: float = threshold(
        0.5, "1",
        "Larger unexplained shares are never noise.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[unexplained_share]",
    )  # fmt: skip
    unexplained_noises: float = threshold(
        5.0, "1",
        "Up to it a channel is mostly noise.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[unexplained_noises]",
    )  # fmt: skip
