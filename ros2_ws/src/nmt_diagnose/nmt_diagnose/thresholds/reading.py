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
        "Only a wrong unit exceeds this factor against other channels.",
        "tests/diagnose/test_threshold_numbers.py::test_a_channel_that_is_far_too_large_has_a_wrong_unit",
    )  # fmt: skip
    wrong_unit_ratio_force: float = threshold(
        30.0, "1",
        "The same of a force, less predictable near resonance.",
        "tests/diagnose/test_threshold_numbers.py::test_a_force_may_be_further_from_the_model",
    )  # fmt: skip
    wrong_frequency_ratio: float = threshold(
        1.6, "1",
        "Beyond it the model is another structure.",
        "tests/diagnose/test_threshold_numbers.py::test_a_frequency_that_is_far_from_all_modes_is_of_another_structure",
    )  # fmt: skip
    near_node_share: float = threshold(
        0.1, "1",
        "Response share below which a channel is near a node.",
        "tests/diagnose/test_threshold_numbers.py::test_a_channel_near_a_node_says_nothing_of_its_unit",
    )  # fmt: skip
    furthest_phase_rad: float = threshold(
        math.radians(60.0), "rad",
        "Phase at lock beyond which sign or lock is wrong.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.furthest_phase_rad]",
    )  # fmt: skip
    hum_sigmas: float = threshold(
        6.0, "σ",
        "Noise multiple from which the rarer mains line is observed.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.hum_sigmas]",
    )  # fmt: skip
    hidden_step_share: float = threshold(
        0.3, "σ",
        "Smaller converter steps add less than 1 % of noise.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.hidden_step_share]",
    )  # fmt: skip
    step_std_share: float = threshold(
        0.25, "1",
        "A step of one deviation hardly changes observables.",
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
        "Relative uncertainty of the share of repeated samples.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.repeats_std_share]",
    )  # fmt: skip
    random_fewest_lines: int = threshold(
        200, "lines",
        "Fewer lines carry no local fits.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.random_fewest_lines]",
    )  # fmt: skip
    record_decay_constants: float = threshold(
        5.0, "time constants",
        "Earlier motion has fallen to 0.7 % by then.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_decay_constants]",
    )  # fmt: skip
    record_hold_error: float = threshold(
        3e-3, "1",
        "Interpolation error of the drive between samples.",
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
        "Least number of independent samples of a record.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_fewest_rows]",
    )  # fmt: skip
    record_noise_quantile: float = threshold(
        0.05, "1",
        "Quantile of the spectrum that is its noise.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.record_noise_quantile]",
    )  # fmt: skip
    record_fewest_averages: int = threshold(
        8, "averages",
        "With fewer, coherence is mostly bias.",
        "tests/diagnose/test_records_as_they_are.py::test_a_short_record_tells_no_noise_of_its_input",
    )  # fmt: skip
    record_noise_lines: int = threshold(
        80, "lines",
        "Per side of a resonance: 18 a decade integrate within 1 %.",
        "tests/diagnose/test_records_as_they_are.py::test_noise_of_the_input_comes_through_a_sharp_resonance",
    )  # fmt: skip
    record_head_periods: float = threshold(
        2.0, "periods",
        "Samples that determine the initial displacement and velocity.",
        "tests/diagnose/test_records_as_they_are.py::test_the_begin_of_a_record_is_two_periods",
    )  # fmt: skip
    record_head_samples: int = threshold(
        24, "samples",
        "Samples that determine a state of several modes.",
        "tests/diagnose/test_records_as_they_are.py::test_the_begin_of_a_record_is_two_periods",
    )  # fmt: skip
    record_rest_share: float = threshold(
        0.1, "1",
        "First motion below which a record begins at rest.",
        "tests/diagnose/test_records_as_they_are.py::test_the_begin_of_a_record_is_two_periods",
    )  # fmt: skip
    imposed_fewest_samples: int = threshold(
        64, "samples",
        "Fewer samples have too few independent force values.",
        "tests/diagnose/test_imposed_motion.py::test_a_short_window_is_left_out",
    )  # fmt: skip
    imposed_fewest_periods: float = threshold(
        3.0, "periods",
        "Modes with fewer cycles in a record are ignored.",
        "tests/diagnose/test_imposed_motion.py::test_a_mode_swings_that_has_three_periods_in_the_record",
    )  # fmt: skip
    imposed_resonant_share: float = threshold(
        0.01, "1",
        "Below this power about modes motion is not vibration.",
        "tests/diagnose/test_imposed_motion.py::test_a_hundredth_of_the_power_at_a_mode_is_vibration",
    )  # fmt: skip
    imposed_rest_share: float = threshold(
        0.05, "1",
        "Relative speed below which friction holds any force.",
        "tests/diagnose/test_imposed_motion.py::test_a_force_at_rest_is_no_observable",
    )  # fmt: skip
    imposed_noise_ratio: float = threshold(
        4.0, "1",
        "Noise maxima of some averages reach two or three.",
        "tests/diagnose/test_imposed_motion.py::test_noise_of_the_motion_is_part_of_the_noise_of_the_force",
    )  # fmt: skip
    decay_slow_share: float = threshold(
        0.01, "1",
        "Damping error of the slow-decay model per d ln ω / d ln A.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.decay_slow_share]",
    )  # fmt: skip
    decay_few_nodes: int = threshold(
        3, "nodes",
        "Decays of fewer nodes are left out.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.decay_few_nodes]",
    )  # fmt: skip
    decay_other_mode_share: float = threshold(
        0.2, "1",
        "Beyond it a decay has two modes.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.decay_other_mode_share]",
    )  # fmt: skip
    decay_cross_shift: float = threshold(
        2.0, "1",
        "Shift by another mode over that by the mode, cubic spring.",
        "tests/diagnose/test_decay_of_two_masses.py::test_what_another_mode_shifts_is_part_of_the_uncertainty",
    )  # fmt: skip
    decay_few_spectral_periods: int = threshold(
        3, "1",
        "Up to this multiple turning points are tried.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.decay_few_spectral_periods]",
    )  # fmt: skip
    decay_largest_ratio_std: float = threshold(
        0.1, "1",
        "Less certain amplitude ratios are left out.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.decay_largest_ratio_std]",
    )  # fmt: skip
    decay_worst_damping_std: float = threshold(
        0.3, "1",
        "Beyond it ln of amplitudes is not Gaussian.",
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
        "Fewer locked levels get a note.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[reading.few_levels]",
    )  # fmt: skip
    stretch_fewest_samples: int = threshold(
        16, "samples",
        "Shorter stretches are left out.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[reading.stretch_fewest_samples]",
    )  # fmt: skip
