"""Thresholds of the loops: value, unit, reason, and the test that fails when it moves.

Numbers that a decision or a rate of the loops hangs on; steps of quadratures and tolerances of solvers stand next to
their loops, settings of users in :mod:`nmt_pll.loop_settings`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class PhaseThresholds:
    """Phase loop and lock."""

    amplitude_bandwidth_share: float = threshold(
        0.3, "1",
        "Amplitude bandwidth over the phase loop's limit.",
        "tests/pll/test_controller.py::test_a_held_force_settles",
    )  # fmt: skip
    dead_time_blocks: float = threshold(
        1.5, "blocks",
        "Mean delay without latency: one and a half blocks.",
        "tests/pll/test_held_phase.py::test_adaptive_loop_holds_the_phase_it_is_told",
    )  # fmt: skip
    swing_tolerances: float = threshold(
        5.0, "1",
        "Allowed scatter of a decaying swing at lock.",
        "tests/pll/test_closed_loop.py::test_locks_over_the_whole_range_of_a_drive_point",
    )  # fmt: skip
    lowest_frequency_ratio: float = threshold(
        0.05, "1",
        "The paper's integrator stops there.",
        "tests/pll/test_paper_loop.py::test_an_oscillator_does_not_turn_backwards",
    )  # fmt: skip


@dataclass(frozen=True)
class AmplitudeThresholds:
    """Amplitudes that are held."""

    feedback_gain_share: float = threshold(
        0.5, "1",
        "Share of critical gain, for robustness.",
        "tests/pll/test_held_amplitude.py::test_a_reckless_controller_is_found_out",
    )  # fmt: skip
    slow_correction_share: float = threshold(
        0.05, "1",
        "Share of the error corrected whatever the estimates.",
        "tests/pll/test_held_amplitude.py::test_a_reckless_controller_is_found_out",
    )  # fmt: skip
    largest_log_step: float = threshold(
        0.3, "1",
        "Change of ln u in a block.",
        "tests/pll/test_held_amplitude.py::test_no_block_changes_the_drive_by_more_than_a_third",
    )  # fmt: skip
    noise_blocks: int = threshold(
        5, "blocks",
        "Blocks at rest that measure noise.",
        "tests/pll/test_held_amplitude.py::test_noise_is_that_of_the_last_tenth_of_a_second_at_rest",
    )  # fmt: skip
    start_noise_ratio: float = threshold(
        10.0, "1",
        "Force over noise that starts the estimation.",
        "tests/pll/test_held_amplitude.py::test_estimate_waits_until_the_force_stands_out_of_what_was_heard_at_rest",
    )  # fmt: skip
    largest_proportional_log: float = threshold(
        math.log(3.0), "1",
        "Proportional part of ln u: a factor of three.",
        "tests/pll/test_response_control.py::test_an_amplitude_is_held_also_where_the_force_falls",
    )  # fmt: skip
    largest_rate_ratio: float = threshold(
        20.0, "1",
        "Bandwidth over decay rate that limits noise.",
        "tests/pll/test_response_control.py::test_an_amplitude_is_held_also_where_the_force_falls",
    )  # fmt: skip
    largest_integrated_error: float = threshold(
        0.2, "1",
        "Bounds wind-up while an amplitude rings up.",
        "tests/pll/test_response_control.py::test_latency_and_noise_leave_the_levels_stable",
    )  # fmt: skip
    waiting_error: float = threshold(
        0.1, "1",
        "Log error and phase error at which the target waits.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.amplitude.waiting_error]",
    )  # fmt: skip


@dataclass(frozen=True)
class HarmonicsThresholds:
    """Harmonics of the force, of one exciter or several."""

    phase_margin_rad: float = threshold(
        0.35, "rad",
        "Gives a phase margin of 70°, a gain margin of 4.5.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.phase_margin_rad]",
    )  # fmt: skip
    automatic_highest: int = threshold(
        15, "1",
        "Highest harmonic of auto.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.automatic_highest]",
    )  # fmt: skip
    settled_share: float = threshold(
        0.003, "1",
        "Settled deviation over the fundamental.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.settled_share]",
    )  # fmt: skip
    newest_value_ratio: float = threshold(
        2.0, "1",
        "Newest value over the tolerance of the mean.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.newest_value_ratio]",
    )  # fmt: skip
    noise_sigmas: float = threshold(
        3.0, "σ",
        "Noise passes once in 10,000.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.noise_sigmas]",
    )  # fmt: skip
    lowest_gain_share: float = threshold(
        0.1, "1",
        "Smallest gain in noise that still settles.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.lowest_gain_share]",
    )  # fmt: skip
    largest_step_share: float = threshold(
        0.1, "1",
        "Step of a term a block over the drive.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.largest_step_share]",
    )  # fmt: skip
    largest_voltage_share: float = threshold(
        1.0, "1",
        "A larger harmonic voltage means no gain.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.largest_voltage_share]",
    )  # fmt: skip
    voltage_limit_share: float = threshold(
        0.98, "1",
        "Share of the limits for all terms.",
        "tests/pll/test_force_controller.py::test_the_voltage_limit_is_never_passed_and_what_it_stops_is_named",
    )  # fmt: skip
    initial_gain_std: float = threshold(
        0.3, "1",
        "Relative prior of a modelled force per volt.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.initial_gain_std]",
    )  # fmt: skip
    largest_gain_std: float = threshold(
        0.5, "1",
        "Its largest value without learning.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.largest_gain_std]",
    )  # fmt: skip
    noise_doubling_dwells: float = threshold(
        5.0, "1",
        "Dwells in which estimated noise may double.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.noise_doubling_dwells]",
    )  # fmt: skip
    variance_doubling_time_constants: float = threshold(
        20.0, "1",
        "Time constants in which the variance doubles.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.variance_doubling_time_constants]",
    )  # fmt: skip
    motion_disturbance_ratio: float = threshold(
        3.0, "1",
        "Allowed disturbance over the n-fold relative motion.",
        "tests/pll/test_force_controller.py::test_amplitudes_that_come_up_slowly_do_not_mislead_it",
    )  # fmt: skip
    unexplained_share: float = threshold(
        3e-4, "1",
        "Change never explained, over the fundamental.",
        "tests/pll/test_force_controller.py::test_a_wrong_force_per_volt_is_put_right",
    )  # fmt: skip
    lowest_gain_correction: float = threshold(
        0.01, "1",
        "A zero gain could not be corrected.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.lowest_gain_correction]",
    )  # fmt: skip
    probe_share: float = threshold(
        0.02, "1",
        "Probing voltage over the drive.",
        "tests/pll/test_force_controller.py::test_what_nobody_knows_is_probed_one_harmonic_at_a_time",
    )  # fmt: skip
    review_time_constants: float = threshold(
        5.0, "1",
        "Time constants between two reviews.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.review_time_constants]",
    )  # fmt: skip
    steady_motion_change: float = threshold(
        0.005, "1",
        "Change of motion that counts as none.",
        "tests/pll/test_force_controller.py::test_amplitudes_that_come_up_slowly_do_not_mislead_it",
    )  # fmt: skip
    progress_share: float = threshold(
        0.7, "1",
        "Deviation ratio that counts as progress.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.progress_share]",
    )  # fmt: skip
    reviews_without_progress: int = threshold(
        3, "1",
        "Reviews before a harmonic is given up.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.reviews_without_progress]",
    )  # fmt: skip
    limited_time_constants: float = threshold(
        10.0, "1",
        "Time at the largest voltage before giving up.",
        "tests/pll/test_force_controller.py::test_a_dead_harmonic_is_given_up_by_name_and_the_rest_goes_on",
    )  # fmt: skip
    fade_per_block: float = threshold(
        0.7, "1",
        "Remaining voltage share of a faded harmonic a block.",
        "tests/pll/test_force_controller.py::test_a_dead_harmonic_is_given_up_by_name_and_the_rest_goes_on",
    )  # fmt: skip
    modal_target_modes: int = threshold(
        3, "1",
        "Modes that the modal target needs.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.modal_target_modes]",
    )  # fmt: skip
    largest_target_ratio: float = threshold(
        0.3, "1",
        "Largest target over the fundamental.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.largest_target_ratio]",
    )  # fmt: skip
    resonance_band_ratio: float = threshold(
        1.4, "1",
        "Range of the fundamental's force per volt.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.resonance_band_ratio]",
    )  # fmt: skip
    shape_following_ratio: float = threshold(
        0.08, "1",
        "Rate of targets over |δ + i Δω| of the nearest mode.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.harmonics.shape_following_ratio]",
    )  # fmt: skip


@dataclass(frozen=True)
class SecondaryThresholds:
    """Secondary resonances."""

    release_ratios: tuple[float, ...] = threshold(
        (1.0, 1.2, 0.85, 1.4, 0.7, 1.6), "1",
        "Amplitudes of successive releases over the stated one.",
        "tests/pll/test_secondary_loop.py::test_a_release_reaches_the_tip_of_the_isola",
    )  # fmt: skip
    filter_cutoff_ratio: float = threshold(
        0.3, "1",
        "Over the base frequency: amplitude and frequency move together.",
        "tests/pll/test_secondary_loop.py::test_the_superharmonic_resonance_is_tracked_from_each_start",
    )  # fmt: skip
    isola_left_ratio: float = threshold(
        0.15, "1",
        "Relative response that has left the isola.",
        "tests/pll/test_secondary_loop.py::test_a_release_reaches_the_tip_of_the_isola",
    )  # fmt: skip
    release_phase_rad: float = threshold(
        math.radians(15.0), "rad",
        "Lag deviation that starts a release.",
        "tests/pll/test_secondary_loop.py::test_on_the_isola_the_force_can_be_stepped_on",
    )  # fmt: skip
    release_wait_s: float = threshold(
        3.0, "s",
        "Time after which any lag is taken for the release.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.secondary.release_wait_s]",
    )  # fmt: skip
    response_floor_ratio: float = threshold(
        0.02, "1",
        "Relative response without a signal.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.secondary.response_floor_ratio]",
    )  # fmt: skip
    switch_periods: float = threshold(
        2.0, "periods",
        "Half-cosine between the voltages of release and level.",
        "tests/pll/test_secondary_loop.py::test_a_release_reaches_the_tip_of_the_isola",
    )  # fmt: skip
    resonant_share: float = threshold(
        0.05, "1",
        "Resonant order over the force's order at lock.",
        "tests/pll/test_secondary_loop.py::test_a_softening_spring_has_the_opposite_lag",
    )  # fmt: skip
    isola_resonant_share: float = threshold(
        0.3, "1",
        "The same on an isola.",
        "tests/pll/test_secondary_loop.py::test_without_a_release_rest_is_left_for_no_isola",
    )  # fmt: skip


@dataclass(frozen=True)
class SelfExcitedThresholds:
    """Motions that the structure feeds."""

    amplitude_rate: float = threshold(
        0.35, "1",
        "Times the dead time: a phase margin of 70°.",
        "tests/pll/test_self_excited_control.py::test_amplitudes_are_held_where_the_free_motion_is_stable_and_where_it_is_not",
    )  # fmt: skip
    largest_damping_rate: float = threshold(
        0.6, "1",
        "Largest requested damping rate times the dead time.",
        "tests/pll/test_self_excited_control.py::test_amplitudes_are_held_where_the_free_motion_is_stable_and_where_it_is_not",
    )  # fmt: skip
    largest_feeding_rate: float = threshold(
        3.0, "1",
        "Rate that feeds the motion, times the dead time.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.largest_feeding_rate]",
    )  # fmt: skip
    held_growth: float = threshold(
        0.15, "1",
        "Growth times the dead time that can be held.",
        "tests/pll/test_self_excited_control.py::test_a_dead_time_as_long_as_the_growth_lets_the_motion_go",
    )  # fmt: skip
    phase_tracking_rate: float = threshold(
        0.25, "1",
        "Phase tracking rate times the dead time.",
        "tests/pll/test_self_excited_loop.py::test_silence_would_not_have_stopped_it",
    )  # fmt: skip
    quadrature_rate: float = threshold(
        0.25, "1",
        "Rate against the quadrature force times the dead time.",
        "tests/pll/test_self_excited_loop.py::test_an_unstable_rig_never_passes_its_limits_at_a_start",
    )  # fmt: skip
    integral_rate_ratio: float = threshold(
        0.25, "1",
        "Integral over proportional rate: aperiodic.",
        "tests/pll/test_self_excited_control.py::test_amplitudes_are_held_where_the_free_motion_is_stable_and_where_it_is_not",
    )  # fmt: skip
    largest_integrated_log_error: float = threshold(
        0.2, "1",
        "Bounds the wind-up of the integral part.",
        "tests/pll/test_self_excited_loop.py::test_silence_would_not_have_stopped_it",
    )  # fmt: skip
    feedback_adaption_rate: float = threshold(
        0.3, "1",
        "Adaptation rate times the dead time.",
        "tests/pll/test_self_excited_control.py::test_without_the_proportional_part_only_stable_amplitudes_are_held",
    )  # fmt: skip
    response_limit_share: float = threshold(
        0.85, "1",
        "Limit share at which control becomes damping.",
        "tests/pll/test_self_excited_loop.py::test_a_motion_near_its_limit_is_damped_before_the_guard_trips",
    )  # fmt: skip
    voltage_limit_share: float = threshold(
        0.9, "1",
        "Share of the voltage limit that feedback may use.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.voltage_limit_share]",
    )  # fmt: skip
    filter_cutoff_ratio: float = threshold(
        0.3, "1",
        "Cut-off of the filter over the frequency of the mode.",
        "tests/pll/test_self_excited_loop.py::test_loss_of_control_is_damped_and_the_drive_then_goes_to_zero_by_a_ramp",
    )  # fmt: skip
    decayed_ratio: float = threshold(
        0.1, "1",
        "Response over the lowest level that ends damping.",
        "tests/pll/test_self_excited_loop.py::test_loss_of_control_is_damped_and_the_drive_then_goes_to_zero_by_a_ramp",
    )  # fmt: skip
    phase_amplitude_ratio: float = threshold(
        0.1, "1",
        "Amplitude over a level that has a phase.",
        "tests/pll/test_self_excited_loop.py::test_silence_would_not_have_stopped_it",
    )  # fmt: skip
    target_rate_ratio: float = threshold(
        0.3, "1",
        "Rate of the target over that of the law.",
        "tests/pll/test_self_excited_loop.py::test_an_unstable_rig_never_passes_its_limits_at_a_start",
    )  # fmt: skip
    first_target_ratio: float = threshold(
        2.0, "1",
        "First target over the tracking amplitude.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.first_target_ratio]",
    )  # fmt: skip
    phase_engaged_ratio: float = threshold(
        1.3, "1",
        "Response at which tracking begins.",
        "tests/pll/test_self_excited_loop.py::test_silence_would_not_have_stopped_it",
    )  # fmt: skip
    phase_released_ratio: float = threshold(
        0.6, "1",
        "Response at which tracking ends (hysteresis).",
        "tests/pll/test_self_excited_loop.py::test_silence_would_not_have_stopped_it",
    )  # fmt: skip
    lost_control_ratio: float = threshold(
        1.5, "1",
        "Response over its target at which control is lost.",
        "tests/pll/test_self_excited_loop.py::test_silence_would_not_have_stopped_it",
    )  # fmt: skip
    largest_detuning: float = threshold(
        1.0e-4, "1",
        "Relative, by the quadrature force at lock.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.largest_detuning]",
    )  # fmt: skip
    lost_lock_change: float = threshold(
        0.1, "1",
        "Relative amplitude, or 100 times frequency, that loses lock.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.lost_lock_change]",
    )  # fmt: skip
    shortest_free_window_periods: float = threshold(
        6.0, "periods",
        "Shortest window of free motion.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.shortest_free_window_periods]",
    )  # fmt: skip
    release_log_lead: float = threshold(
        0.6, "1",
        "Distance in ln a at release.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.release_log_lead]",
    )  # fmt: skip
    shortest_log_lead: float = threshold(
        0.15, "1",
        "The same where the drive carries no further.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.shortest_log_lead]",
    )  # fmt: skip
    settled_growth_ratio: float = threshold(
        5e-4, "1",
        "Growth over frequency that counts as none.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.settled_growth_ratio]",
    )  # fmt: skip
    limit_cycle_log_distance: float = threshold(
        0.02, "1",
        "Level this near in ln a to a settled motion.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.limit_cycle_log_distance]",
    )  # fmt: skip
    free_window_log_span: float = threshold(
        0.8, "1",
        "Of ln a within a window of a free motion.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.free_window_log_span]",
    )  # fmt: skip
    release_log_tolerance: float = threshold(
        0.05, "1",
        "Tolerance in ln a of the release.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.release_log_tolerance]",
    )  # fmt: skip
    growth_periods: float = threshold(
        2.0, "periods",
        "Periods that measure free growth.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.self_excited.growth_periods]",
    )  # fmt: skip


@dataclass(frozen=True)
class SweepThresholds:
    """Sweeps and stepped sines."""

    filter_cutoff_ratio: float = threshold(
        0.15, "1",
        "Cut-off of the filter over the frequency of the drive.",
        "tests/pll/test_sweep_loop.py::test_two_sweeps_one_after_the_other_start_at_the_same_frequency",
    )  # fmt: skip
    probe_voltage_v: float = threshold(
        1.0e-4, "V",
        "First voltage of an unknown exciter.",
        "tests/pll/test_sweep_loop.py::test_a_probe_begins_at_a_tenth_of_a_millivolt_and_grows_by_a_quarter_a_block",
    )  # fmt: skip
    probe_log_growth: float = threshold(
        0.25, "1",
        "Growth of ln u a block within noise.",
        "tests/pll/test_sweep_loop.py::test_a_probe_begins_at_a_tenth_of_a_millivolt_and_grows_by_a_quarter_a_block",
    )  # fmt: skip
    probe_noise_ratio: float = threshold(
        20.0, "1",
        "Amplitude over its noise from which on the controller works.",
        "tests/pll/test_sweep_loop.py::test_what_still_rings_after_a_sweep_teaches_nothing_of_the_exciter",
    )  # fmt: skip
    shortest_dwell_s: float = threshold(
        0.2, "s",
        "Shortest time over which amplitudes are judged stationary.",
        "tests/pll/test_sweep_loop.py::test_an_amplitude_is_judged_over_a_fifth_of_a_second_at_least",
    )  # fmt: skip
    longest_rest_s: float = threshold(
        10.0, "s",
        "Longest time until a structure rests after a fade.",
        "tests/pll/test_sweep_loop.py::test_levels_that_cannot_be_held_are_given_up_with_a_reason",
    )  # fmt: skip
    lost_log_deviation: float = threshold(
        math.log(2.0), "1",
        "A factor of two off ends a sweep.",
        "tests/pll/test_sweep_loop.py::test_a_held_amplitude_may_be_off_by_a_factor_of_two_for_a_second",
    )  # fmt: skip
    lost_duration_s: float = threshold(
        1.0, "s",
        "How long that deviation must last.",
        "tests/pll/test_sweep_loop.py::test_a_held_amplitude_may_be_off_by_a_factor_of_two_for_a_second",
    )  # fmt: skip
    glide_frequency_step: float = threshold(
        0.05, "1",
        "Relative step that a stepped sine glides over.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.sweeps.glide_frequency_step]",
    )  # fmt: skip


@dataclass(frozen=True)
class CurveThresholds:
    """Response curves past their folds."""

    cutoff_share: float = threshold(
        0.7, "1",
        "Cut-off over the mode: fast enough between folds, still selective.",
        "tests/session/test_response_curve.py::test_a_hardening_curve_is_followed_through_both_folds",
    )  # fmt: skip
    phase_tolerance: float = threshold(
        math.radians(0.5), "rad",
        "Points only have to be steady in lag.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.curve.phase_tolerance]",
    )  # fmt: skip
    free_decays: float = threshold(
        3.0, "1",
        "Time constants that a start from rest waits.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.curve.free_decays]",
    )  # fmt: skip
    largest_gain: float = threshold(
        1.5, "1",
        "Factor of the proportional gain between the folds.",
        "tests/pll/test_gains.py::test_on_a_slope_the_gains_grow_within_their_bounds",
    )  # fmt: skip
    frequency_steadiness: float = threshold(
        1.0e-3, "1",
        "Remaining relative motion in frequency at lock.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.curve.frequency_steadiness]",
    )  # fmt: skip
    steadiness: float = threshold(
        2.0e-3, "1",
        "Remaining relative motion in response at lock.",
        "tests/session/test_response_curve.py::test_a_hardening_curve_is_followed_through_both_folds",
    )  # fmt: skip
    held_steadiness: float = threshold(
        6.0e-4, "1",
        "The same at held response, whose growth enters the force.",
        "tests/session/test_isola.py::test_a_branch_that_rest_does_not_lead_to_is_foretold_reached_and_measured",
    )  # fmt: skip
    least_tolerance: float = threshold(
        5.0e-5, "1",
        "Smallest drift tolerance, at light damping.",
        "tests/session/test_response_curve.py::test_light_damping_does_not_ask_for_endless_patience",
    )  # fmt: skip
    gentle_share: float = threshold(
        0.3, "1",
        "Reduced loop speed for difficult points and damping exciters.",
        "tests/session/test_response_curve.py::test_with_a_shaker_and_friction_the_curve_goes_to_its_other_side",
    )  # fmt: skip
    exciter_decay_ratio: float = threshold(
        1.5, "1",
        "Decay ratio from which the exciter damps.",
        "tests/session/test_response_curve.py::test_with_a_shaker_and_friction_the_curve_goes_to_its_other_side",
    )  # fmt: skip
    release_block_s: float = threshold(
        0.02, "s",
        "Assumed block of a release, which limits bandwidth.",
        "tests/session/test_isola.py::test_a_branch_that_rest_does_not_lead_to_is_foretold_reached_and_measured",
    )  # fmt: skip
    perturbed_lines: float = threshold(
        8.0, "1",
        "Lines of the multisine, for two exponents.",
        "tests/pll/test_multisine.py::test_over_its_window_it_has_its_rms_no_mean_and_eight_lines",
    )  # fmt: skip
    perturbed_frequency_share: float = threshold(
        0.05, "1",
        "Frequency perturbation over that of amplitude.",
        "tests/session/test_response_curve.py::"
        "test_a_perturbed_drive_tells_the_floquet_exponents_on_both_sides_of_a_fold",
    )  # fmt: skip
    slow_share: float = threshold(
        0.15, "1",
        "Loop speed next to another mode, above fold instability.",
        "tests/pll/test_threshold_edges.py::test_a_threshold_decides[pll.curve.slow_share]",
    )  # fmt: skip
    way_decays: float = threshold(
        2.0, "1",
        "Time constants on the way to a new lag.",
        "tests/session/test_folding_lag.py::test_a_curve_that_turns_back_over_the_lag_is_followed_to_its_end",
    )  # fmt: skip
    secant_decays: float = threshold(
        1.0, "1",
        "Time constants before a secant's lock is judged.",
        "tests/session/test_folding_lag.py::test_a_curve_that_turns_back_over_the_lag_is_followed_to_its_end",
    )  # fmt: skip
    neighbour_share: float = threshold(
        0.05, "1",
        "Relative shape of another mode that the loop feels.",
        "tests/session/test_folding_lag.py::test_a_neighbouring_mode_is_one_within_the_filter_at_the_drive_point",
    )  # fmt: skip
    branch_distance: float = threshold(
        0.15, "1",
        "Distance, in lag or ln response, that is another branch.",
        "tests/pll/test_curve_parameters.py::test_an_orbit_of_another_branch_is_no_lock",
    )  # fmt: skip
    prospect_decays: float = threshold(
        4.0, "1",
        "Averaging span beyond a dwell, in time constants.",
        "tests/pll/test_prospect.py::test_a_threshold_decides",
    )  # fmt: skip
    prospect_spans: float = threshold(
        3.0, "spans",
        "Spans of a trend.",
        "tests/pll/test_prospect.py::test_a_threshold_decides",
    )  # fmt: skip
    prospect_fall: float = threshold(
        0.3, "1",
        "Logarithmic fall a span that is progress.",
        "tests/pll/test_prospect.py::test_a_threshold_decides",
    )  # fmt: skip
    prospect_near: float = threshold(
        0.7, "1",
        "Logarithmic distance to the limits that noise explains.",
        "tests/pll/test_prospect.py::test_a_threshold_decides",
    )  # fmt: skip
    largest_boost: float = threshold(
        2.5, "1",
        "Factor of the integral gain along a curve.",
        "tests/pll/test_gains.py::test_on_a_slope_the_gains_grow_within_their_bounds",
    )  # fmt: skip


@dataclass(frozen=True)
class LoopThresholds:
    """Thresholds by theme; what a field means stands with it (:mod:`nmt_core.threshold`).

    Attributes:
        phase: phase loop and lock.
        amplitude: amplitudes that are held.
        harmonics: harmonics of the force, of one exciter or several.
        secondary: secondary resonances.
        self_excited: motions that the structure feeds.
        sweeps: sweeps and stepped sines.
        curve: response curves.
    """

    phase: PhaseThresholds = field(default_factory=PhaseThresholds)
    amplitude: AmplitudeThresholds = field(default_factory=AmplitudeThresholds)
    harmonics: HarmonicsThresholds = field(default_factory=HarmonicsThresholds)
    secondary: SecondaryThresholds = field(default_factory=SecondaryThresholds)
    self_excited: SelfExcitedThresholds = field(default_factory=SelfExcitedThresholds)
    sweeps: SweepThresholds = field(default_factory=SweepThresholds)
    curve: CurveThresholds = field(default_factory=CurveThresholds)


THRESHOLDS = LoopThresholds()
"""The values that are in force."""
PHASE, AMPLITUDE, HARMONICS, SECONDARY, SELF_EXCITED, SWEEPS, CURVE = (
    THRESHOLDS.phase,
    THRESHOLDS.amplitude,
    THRESHOLDS.harmonics,
    THRESHOLDS.secondary,
    THRESHOLDS.self_excited,
    THRESHOLDS.sweeps,
    THRESHOLDS.curve,
)
"""Their themes."""
