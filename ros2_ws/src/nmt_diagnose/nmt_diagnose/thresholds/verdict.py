"""Verdict, held-out data, warnings and what is reported."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class VerdictThresholds:
    """Verdict, held-out data, warnings and what is reported."""

    alarm_log_odds: float = threshold(
        1.5, "ln odds",
        "Ln of the odds against no gap from which a gap is claimed: four and a half to one.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.alarm_log_odds]",
    )  # fmt: skip
    sure_log_evidence: float = threshold(
        30.0, "ln evidence",
        "Ln evidence of an effect over the model without it from which it is reported although re-fitted parameters "
        "leave less than what matters: 21 was the most of a healthy recording, 1860 that of 4 g on the demo's beam.",
        "tests/diagnose/test_what_is_asked.py::"
        "test_evidence_demands_an_effect_although_re_fitted_parameters_leave_less_than_matters",
    )  # fmt: skip
    credible_noise_scale: float = threshold(
        10.0, "1",
        "Scale of the noise of a random test's lines up to which what a model leaves of them may be noise, whatever "
        "neighbours scatter: a mode that the model lacks makes them scatter, too.",
        "tests/diagnose/test_what_is_asked.py::test_what_lines_leave_is_no_noise_however_much_they_scatter",
    )  # fmt: skip
    chance_sigmas: float = threshold(
        3.0, "σ",
        "Standard deviations that chance may take off an effect which the weakest that would show allows for: one in "
        "700 recordings has more against it.",
        "tests/diagnose/test_what_is_asked.py::test_the_weakest_that_would_show_is_reported",
    )  # fmt: skip
    recalibration_cost_fall: float = threshold(
        25.0, "−2 ln p",
        "Fall of the cost by the model's parameters alone from which that is a calibration: five standard "
        "deviations.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.recalibration_cost_fall]",
    )  # fmt: skip
    partial_closed_share: float = threshold(
        0.8, "1",
        "Share of the gap that an effect which leaves more than noise has to close to be named.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.partial_closed_share]",
    )  # fmt: skip
    partial_closed_share_of_two: float = threshold(
        0.95, "1",
        "The same of two effects, which together imitate a third: source impedance and preload loss close 85 % of the "
        "crossover distortion of an amplifier.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.partial_closed_share_of_two]",
    )  # fmt: skip
    partial_pulled_sigmas: float = threshold(
        10.0, "1",
        "Standard deviations from what is believed of a parameter of the model up to which an effect that leaves a "
        "part is named: 5.7 beside known causes of real recordings, 14 and 19 beside an amplifier's crossover "
        "distortion.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.partial_pulled_sigmas]",
    )  # fmt: skip
    nearest_closed_share: float = threshold(
        1.0 / 3.0, "1",
        "Share of the gap below which the nearest explanation is no part of the answer.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.nearest_closed_share]",
    )  # fmt: skip
    worse_prediction_sigmas: float = threshold(
        1.0, "σ",
        "Standard deviations by which held-out rows must be predicted worse for an explanation to be refused.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.worse_prediction_sigmas]",
    )  # fmt: skip
    judged_explanations: int = threshold(
        3, "1",
        "Explanations whose predictions of held-out rows are judged; each takes a fit for each split.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.judged_explanations]",
    )  # fmt: skip
    as_likely_share: float = threshold(
        1.0 / 3.0, "1",
        "Share of the likeliest detail's probability from which another is named beside it.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.as_likely_share]",
    )  # fmt: skip
    open_prediction_share: float = threshold(
        0.3, "1",
        "Uncertainty of a prediction over the change by the explanation, both rms, up to which held-out rows "
        "judge it.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[verdict.open_prediction_share]",
    )  # fmt: skip
    left_over_scale: float = threshold(
        2.0, "1",
        "What is left over the floor from which it is more than noise.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.left_over_scale]",
    )  # fmt: skip
    small_left_share: float = threshold(
        0.15, "1",
        "Share of the gap from which what is left is a warning.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.small_left_share]",
    )  # fmt: skip
    visible_sigmas: float = threshold(
        5.0, "σ",
        "Standard deviations at which an effect is visible: chance gets there once in 1.7 million, and candidates "
        "are up to a thousand.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.visible_sigmas]",
    )  # fmt: skip
    excess_sigmas: float = threshold(
        3.0, "σ",
        "Standard deviations by which the squares of a level or band must exceed noise for a size of what is left "
        "to be reported.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.excess_sigmas]",
    )  # fmt: skip
    cause_probability: float = threshold(
        0.9, "1",
        "Probability from which a sentence says the cause, not the most probable cause.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.cause_probability]",
    )  # fmt: skip
    least_remainder: float = threshold(
        0.01, "1",
        "A gap of which less is left is closed.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.least_remainder]",
    )  # fmt: skip
    remainder_third_share: float = threshold(
        0.5, "1",
        "Share of the squares in one third of the levels from which most of what is left lies there.",
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
        "Of fewer levels every second one leaves too few to fit.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[verdict.held_out_fewest_levels]",
    )  # fmt: skip
    held_out_fewest_responses: int = threshold(
        3, "1",
        "Levels of a frequency response from which they are held out by level.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.held_out_fewest_responses]",
    )  # fmt: skip
    held_out_fewest_for_two: int = threshold(
        5, "1",
        "Levels of a frequency response from which the highest two are held out, not the highest one.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[verdict.held_out_fewest_for_two]",
    )  # fmt: skip
    least_location_probability: float = threshold(
        0.005, "1",
        "A location below it is not listed: it would read 0 %.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.least_location_probability]",
    )  # fmt: skip
    other_location_probability: float = threshold(
        0.05, "1",
        "Probability from which a sentence names another location, too.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.other_location_probability]",
    )  # fmt: skip
    least_gap_ratio: float = threshold(
        1.02, "1",
        "Rms over the floor below which there is no gap to close.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.least_gap_ratio]",
    )  # fmt: skip
    many_lines: int = threshold(
        60, "lines",
        "More lines of a test stand or fall by tenths, fewer one by one.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[verdict.many_lines]",
    )  # fmt: skip
    many_levels: int = threshold(
        20, "levels",
        "More levels or lines count by tenths in the size of a change.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[verdict.many_levels]",
    )  # fmt: skip
    factor_ratio: float = threshold(
        2.5, "1",
        "Recorded over predicted from which a channel has another unit: a gain that effects explain is smaller.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_ratio]",
    )  # fmt: skip
    factor_spread: float = threshold(
        0.2, "1",
        "Median spread of ln of a factor over the rows of a channel, and of its phase (rad), up to which it is one.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_spread]",
    )  # fmt: skip
    factor_correlation: float = threshold(
        0.9, "1",
        "Correlation of samples with the model's from which they differ by a factor.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_correlation]",
    )  # fmt: skip
    factor_fewest_rows: int = threshold(
        3, "rows",
        "Fewer rows of a channel show no factor.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[factor_fewest_rows]",
    )  # fmt: skip
    unexplained_share: float = threshold(
        0.5, "1",
        "Share of the signal of a channel beyond which what is left is no noise, whatever scale was learnt.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[unexplained_share]",
    )  # fmt: skip
    unexplained_noises: float = threshold(
        5.0, "1",
        "What is left over the noise that the recording shows, up to which a channel is mostly noise.",
        "tests/diagnose/test_plain_look.py::test_a_threshold_of_the_plain_look_decides[unexplained_noises]",
    )  # fmt: skip
