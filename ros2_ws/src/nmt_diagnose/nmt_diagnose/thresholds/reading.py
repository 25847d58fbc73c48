"""What of a recording becomes an observable."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class ReadingThresholds:
    """What of a recording becomes an observable."""

    wrong_unit_ratio: float = threshold(
        5.0, "1",
        "No sensor's error makes a channel this many times too large beside the others; a wrong unit does.",
        "tests/diagnose/test_threshold_numbers.py::test_a_channel_that_is_far_too_large_has_a_wrong_unit",
    )  # fmt: skip
    wrong_unit_ratio_force: float = threshold(
        30.0, "1",
        "The same of a force, which follows the model less closely near a resonance.",
        "tests/diagnose/test_threshold_numbers.py::test_a_force_may_be_further_from_the_model",
    )  # fmt: skip
    wrong_frequency_ratio: float = threshold(
        1.6, "1",
        "Frequency over the nearest of the model from which the model is of another structure.",
        "tests/diagnose/test_threshold_numbers.py::test_a_frequency_that_is_far_from_all_modes_is_of_another_structure",
    )  # fmt: skip
    near_node_share: float = threshold(
        0.1, "1",
        "Response over the largest of its quantity below which a channel is near a node of the model.",
        "tests/diagnose/test_threshold_numbers.py::test_a_channel_near_a_node_says_nothing_of_its_unit",
    )  # fmt: skip
    furthest_phase_rad: float = threshold(
        math.radians(60.0), "rad",
        "Error of the phase at lock from which a channel's sign is wrong or the loop held something else.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.furthest_phase_rad]",
    )  # fmt: skip
    hum_sigmas: float = threshold(
        6.0, "σ",
        "Amplitude over the noise from which the line of the less common mains is observed.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.hum_sigmas]",
    )  # fmt: skip
    hidden_step_share: float = threshold(
        0.3, "σ",
        "A step of the converter below this share of the noise adds less than 1 % to it.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.hidden_step_share]",
    )  # fmt: skip
    step_std_share: float = threshold(
        0.25, "1",
        "A step of a whole deviation of the noise changes hardly any observable: its weight is that of four "
        "deviations.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.step_std_share]",
    )  # fmt: skip
    limit_std_share: float = threshold(
        0.1, "1",
        "Standard deviation of a clipping level over it.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.limit_std_share]",
    )  # fmt: skip
    same_limit_share: float = threshold(
        0.01, "1",
        "Clipping levels that differ by less are one.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.same_limit_share]",
    )  # fmt: skip
    repeats_std_share: float = threshold(
        0.1, "1",
        "By how much of it the share of repeated samples may be off, all levels together.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.repeats_std_share]",
    )  # fmt: skip
    random_fewest_lines: int = threshold(
        200, "lines",
        "Fewer lines carry no local fits.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.random_fewest_lines]",
    )  # fmt: skip
    record_decay_constants: float = threshold(
        5.0, "time constants",
        "What was before the record has fallen to 0.7 % by then.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_decay_constants]",
    )  # fmt: skip
    record_hold_error: float = threshold(
        3e-3, "1",
        "Error of a straight line between samples of the drive that steps between them keep below.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[reading.record_hold_error]",
    )  # fmt: skip
    record_finest_steps: int = threshold(
        32, "1",
        "Steps between samples of the drive.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[reading.record_finest_steps]",
    )  # fmt: skip
    record_longest_start: float = threshold(
        0.1, "1",
        "Share of a record that its start may take.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_longest_start]",
    )  # fmt: skip
    record_fewest_samples: int = threshold(
        200, "samples",
        "Shorter records tell nothing.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_fewest_samples]",
    )  # fmt: skip
    record_fewest_rows: int = threshold(
        50, "samples",
        "Samples of a record that count as independent at the least.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_fewest_rows]",
    )  # fmt: skip
    record_noise_quantile: float = threshold(
        0.05, "1",
        "Quantile of the spectrum that is its noise.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_noise_quantile]",
    )  # fmt: skip
    record_fewest_averages: int = threshold(
        8, "averages",
        "A coherence of fewer is known to a third only, and most of it is bias.",
        "tests/diagnose/test_records_as_they_are.py::test_a_short_record_tells_no_noise_of_its_input",
    )  # fmt: skip
    record_noise_lines: int = threshold(
        80, "lines",
        "On either side of a resonance, down to 1e-5 of its frequency: 18 a decade carry the integral within 1 %.",
        "tests/diagnose/test_records_as_they_are.py::test_noise_of_the_input_comes_through_a_sharp_resonance",
    )  # fmt: skip
    record_head_periods: float = threshold(
        2.0, "periods",
        "First samples that tell displacement and velocity: over more of them a model that lacks something is off.",
        "tests/diagnose/test_records_as_they_are.py::test_the_begin_of_a_record_is_two_periods",
    )  # fmt: skip
    record_head_samples: int = threshold(
        24, "samples",
        "A state of several modes takes as many, and the first of them show whether anything moves.",
        "tests/diagnose/test_records_as_they_are.py::test_the_begin_of_a_record_is_two_periods",
    )  # fmt: skip
    record_rest_share: float = threshold(
        0.1, "1",
        "First motion over that of the record below which it begins at rest: noise and a bias are less.",
        "tests/diagnose/test_records_as_they_are.py::test_the_begin_of_a_record_is_two_periods",
    )  # fmt: skip
    imposed_fewest_samples: int = threshold(
        64, "samples",
        "Windows of fewer samples hold too few independent values of a force.",
        "tests/diagnose/test_imposed_motion.py::test_a_short_window_is_left_out",
    )  # fmt: skip
    imposed_fewest_periods: float = threshold(
        3.0, "periods",
        "A mode that swings fewer times within a record takes no part in it.",
        "tests/diagnose/test_imposed_motion.py::test_a_drive_without_restoring_force_is_moved_as_measured",
    )  # fmt: skip
    imposed_resonant_share: float = threshold(
        0.01, "1",
        "Share of a motion's power about the model's modes below which it is no vibration of the model.",
        "tests/diagnose/test_imposed_motion.py::test_a_hundredth_of_the_power_at_a_mode_is_vibration",
    )  # fmt: skip
    imposed_rest_share: float = threshold(
        0.05, "1",
        "Speed over the largest below which the drive point stands still as far as a smoothed motion tells, and "
        "friction holds any force.",
        "tests/diagnose/test_imposed_motion.py::test_a_force_at_rest_is_no_observable",
    )  # fmt: skip
    imposed_noise_ratio: float = threshold(
        4.0, "1",
        "Density of a measured motion over that of its noise from which it is motion: the noise is told by the lowest "
        "lines, and the highest of some averages reaches two or three times as much.",
        "tests/diagnose/test_imposed_motion.py::test_noise_of_the_motion_is_part_of_the_noise_of_the_force",
    )  # fmt: skip
    decay_slow_share: float = threshold(
        0.01, "1",
        "Part of the damping for each d ln ω / d ln A that a model of a slow decay is wrong by.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.decay_slow_share]",
    )  # fmt: skip
    decay_few_nodes: int = threshold(
        3, "nodes",
        "Decays of fewer nodes are left out.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.decay_few_nodes]",
    )  # fmt: skip
    decay_other_mode_share: float = threshold(
        0.2, "1",
        "Motion in another mode from which a decay is not of one mode.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.decay_other_mode_share]",
    )  # fmt: skip
    decay_cross_shift: float = threshold(
        2.0, "1",
        "Shift by the motion in another mode over that by as much motion of its own, of a cubic spring.",
        "tests/diagnose/test_decay_of_two_masses.py::test_what_another_mode_shifts_is_part_of_the_uncertainty",
    )  # fmt: skip
    decay_few_spectral_periods: int = threshold(
        3, "1",
        "Times the periods that spectra need, up to which turning points are tried.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.decay_few_spectral_periods]",
    )  # fmt: skip
    decay_largest_ratio_std: float = threshold(
        0.1, "1",
        "Uncertainty of a ratio of amplitudes beyond which it tells nothing.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.decay_largest_ratio_std]",
    )  # fmt: skip
    decay_worst_damping_std: float = threshold(
        0.3, "1",
        "Relative uncertainty of a damping beyond which ln of amplitudes is no longer Gaussian.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.decay_worst_damping_std]",
    )  # fmt: skip
    stepped_fewest_lines: int = threshold(
        5, "lines",
        "Fewer windows are no frequency response.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.stepped_fewest_lines]",
    )  # fmt: skip
    stepped_same_level: float = threshold(
        1e-3, "1",
        "Levels that differ by less are one.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[reading.stepped_same_level]",
    )  # fmt: skip
    stepped_jump: float = threshold(
        0.5, "ln H",
        "Step from line to line that is a jump.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[reading.stepped_jump]",
    )  # fmt: skip
    stepped_jump_ratio: float = threshold(
        4.0, "1",
        "A jump's step over those of its neighbours.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[reading.stepped_jump_ratio]",
    )  # fmt: skip
    few_levels: int = threshold(
        3, "levels",
        "Fewer locked levels are worth a note.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.few_levels]",
    )  # fmt: skip
    stretch_fewest_samples: int = threshold(
        16, "samples",
        "Shorter stretches are left out.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.stretch_fewest_samples]",
    )  # fmt: skip
