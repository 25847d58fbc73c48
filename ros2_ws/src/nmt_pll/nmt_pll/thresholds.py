"""Thresholds of the loops: value, unit, reason, and the test that fails when it moves.

Numbers that a decision or a rate of the loops hangs on; steps of quadratures and tolerances of solvers stand beside
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
        "Bandwidth of the amplitude controller over that which the dead time allows the phase loop, which it follows.",
        "",
    )  # fmt: skip
    dead_time_blocks: float = threshold(
        1.5, "blocks",
        "Mean delay from measurement to effect besides the latency: a block until a command acts, and half of one.",
        "",
    )  # fmt: skip
    swing_tolerances: float = threshold(
        5.0, "1",
        "Scatter of the phase error of a decaying swing at lock, in phase tolerances; the mean is judged besides.",
        "",
    )  # fmt: skip
    lowest_frequency_ratio: float = threshold(
        0.05, "1",
        "Frequency over the centre at which the paper's integrator stops: an oscillator cannot turn backwards.",
        "",
    )  # fmt: skip


@dataclass(frozen=True)
class AmplitudeThresholds:
    """Amplitudes that are held."""

    feedback_gain_share: float = threshold(
        0.5, "1",
        "Share of the gain that is critically damped, so that a wrong estimate of the plant does not swing.",
        "",
    )  # fmt: skip
    slow_correction_share: float = threshold(
        0.05, "1",
        "Share of the logarithmic error that a block takes back whatever the estimates say.",
        "",
    )  # fmt: skip
    largest_log_step: float = threshold(
        0.3, "1",
        "Of ln u in a block: a third more drive, which a filter of a few blocks still sees coming.",
        "",
    )  # fmt: skip
    noise_blocks: int = threshold(
        5, "blocks",
        "Newest blocks at rest that noise is taken from: fewer scatter, more wait.",
        "",
    )  # fmt: skip
    start_noise_ratio: float = threshold(
        10.0, "1",
        "Force over its noise from which on exciter and structure are estimated: a tenth of it is noise.",
        "",
    )  # fmt: skip
    largest_proportional_log: float = threshold(
        math.log(3.0), "1",
        "Proportional part of ln u: the drive is at most three times what the integral part says.",
        "",
    )  # fmt: skip
    largest_rate_ratio: float = threshold(
        20.0, "1",
        "Bandwidth over decay rate: noise of the amplitude stays small in the drive.",
        "",
    )  # fmt: skip
    largest_integrated_error: float = threshold(
        0.2, "1",
        "Error that the integral part takes in: it does not run ahead while an amplitude rings up.",
        "",
    )  # fmt: skip
    waiting_error: float = threshold(
        0.1, "1",
        "Logarithm of target over amplitude, and phase error in rad, beyond which the target waits.",
        "",
    )  # fmt: skip


@dataclass(frozen=True)
class HarmonicsThresholds:
    """Harmonics of the force, of one exciter or several."""

    phase_margin_rad: float = threshold(
        0.35, "rad",
        "Integral rate times filter and dead time: phase margin of 70°, gain margin of 4.5.",
        "",
    )  # fmt: skip
    automatic_highest: int = threshold(
        15, "1",
        "Highest harmonic that auto takes where sample rate and filter would allow more.",
        "",
    )  # fmt: skip
    settled_share: float = threshold(
        0.003, "1",
        "Settled deviation of a harmonic from its target, of the fundamental: less than calibration leaves open.",
        "",
    )  # fmt: skip
    newest_value_ratio: float = threshold(
        2.0, "1",
        "Newest value over what the mean of the dwell may be off by: it has the noise of one block.",
        "",
    )  # fmt: skip
    noise_sigmas: float = threshold(
        3.0, "σ",
        "Standard deviations by which noise may pass the tolerance: once in 10,000, with many harmonics to wait for.",
        "",
    )  # fmt: skip
    lowest_gain_share: float = threshold(
        0.1, "1",
        "Share of the gain that is left in noise: less would never settle.",
        "",
    )  # fmt: skip
    largest_step_share: float = threshold(
        0.1, "1",
        "Step of a term in a block over the amplitude of the drive: a wrong gain is found out before it does harm.",
        "",
    )  # fmt: skip
    largest_voltage_share: float = threshold(
        1.0, "1",
        "Voltage of a harmonic over the amplitude of the drive: more is a gain of nearly nothing.",
        "",
    )  # fmt: skip
    voltage_limit_share: float = threshold(
        0.98, "1",
        "Share of the limits of voltage and slew that all terms together may take: the guard behind is exact.",
        "",
    )  # fmt: skip
    initial_gain_std: float = threshold(
        0.3, "1",
        "Standard deviation of the force per volt at first, over it, as a model has it far from the mode.",
        "",
    )  # fmt: skip
    largest_gain_std: float = threshold(
        0.5, "1",
        "The same at most, when nothing has been learnt for long.",
        "",
    )  # fmt: skip
    noise_doubling_dwells: float = threshold(
        5.0, "1",
        "Dwells in which an estimate of noise may double: what looks like noise may be a transient.",
        "",
    )  # fmt: skip
    variance_doubling_time_constants: float = threshold(
        20.0, "1",
        "Time constants of the loop in which the variance of the force per volt doubles.",
        "",
    )  # fmt: skip
    motion_disturbance_ratio: float = threshold(
        3.0, "1",
        "A disturbance with the n-th power of the motion changes n times as much; so many times this is allowed.",
        "",
    )  # fmt: skip
    unexplained_share: float = threshold(
        3e-4, "1",
        "Of the fundamental, what the force per volt never explains of a change.",
        "",
    )  # fmt: skip
    lowest_gain_correction: float = threshold(
        0.01, "1",
        "Of the force per volt over what was known at first: a gain of zero could not be learnt away from.",
        "",
    )  # fmt: skip
    probe_share: float = threshold(
        0.02, "1",
        "Voltage that probes an unknown force per volt, over the amplitude of the drive.",
        "",
    )  # fmt: skip
    review_time_constants: float = threshold(
        5.0, "1",
        "Time constants of the loop between two looks at whether a harmonic gets nearer to its target.",
        "",
    )  # fmt: skip
    steady_motion_change: float = threshold(
        0.005, "1",
        "Change of the motion within the time constant of the filter that counts as none.",
        "",
    )  # fmt: skip
    progress_share: float = threshold(
        0.7, "1",
        "Deviation over that of the look before which counts as progress.",
        "",
    )  # fmt: skip
    reviews_without_progress: int = threshold(
        3, "1",
        "Looks without progress before a harmonic is given up: what was learnt is doubted at the first.",
        "",
    )  # fmt: skip
    limited_time_constants: float = threshold(
        10.0, "1",
        "Time constants of the loop at the largest voltage before a harmonic is given up.",
        "",
    )  # fmt: skip
    fade_per_block: float = threshold(
        0.7, "1",
        "Share of the voltage of a harmonic that was given up which is left after a block.",
        "",
    )  # fmt: skip
    modal_target_modes: int = threshold(
        3, "1",
        "Linear modes that the modal target needs: harmonics move in others than the first.",
        "",
    )  # fmt: skip
    largest_target_ratio: float = threshold(
        0.3, "1",
        "Target of a harmonic over the fundamental: a force with more is far from a sine.",
        "",
    )  # fmt: skip
    resonance_band_ratio: float = threshold(
        1.4, "1",
        "Frequency over that of the target mode up to which the force per volt of the fundamental is looked at.",
        "",
    )  # fmt: skip
    shape_following_ratio: float = threshold(
        0.08, "1",
        "Rate by which targets follow the shape, over the distance |δ + i Δω| of the nearest other mode.",
        "",
    )  # fmt: skip


@dataclass(frozen=True)
class SecondaryThresholds:
    """Secondary resonances."""

    release_ratios: tuple[float, ...] = threshold(
        (1.0, 1.2, 0.85, 1.4, 0.7, 1.6), "1",
        "Amplitudes of the releases of a level over the stated one, in order, until one meets the isola.",
        "",
    )  # fmt: skip
    filter_cutoff_ratio: float = threshold(
        0.3, "1",
        "Cut-off of the filter over the base frequency: strongly nonlinear amplitude and frequency move together.",
        "",
    )  # fmt: skip
    isola_left_ratio: float = threshold(
        0.15, "1",
        "Response over the amplitude of the release below which it has left the isola.",
        "",
    )  # fmt: skip
    release_phase_rad: float = threshold(
        math.radians(15.0), "rad",
        "Deviation of the lag from that of the resonance at which a release is begun.",
        "",
    )  # fmt: skip
    release_wait_s: float = threshold(
        3.0, "s",
        "Time after which any lag is taken for the release.",
        "",
    )  # fmt: skip
    response_floor_ratio: float = threshold(
        0.02, "1",
        "Response over the amplitude of the release below which it is no signal.",
        "",
    )  # fmt: skip
    switch_periods: float = threshold(
        2.0, "periods",
        "Half-cosine from the voltage of the release to that of the level: a step would excite other modes.",
        "",
    )  # fmt: skip
    resonant_share: float = threshold(
        0.05, "1",
        "Amplitude of the resonant order over that of the order of the force in the response, at lock.",
        "",
    )  # fmt: skip
    isola_resonant_share: float = threshold(
        0.3, "1",
        "The same on an isola, which the response would have left below.",
        "",
    )  # fmt: skip


@dataclass(frozen=True)
class SelfExcitedThresholds:
    """Motions that the structure feeds."""

    amplitude_rate: float = threshold(
        0.35, "1",
        "Rate of the amplitude law, and of damping feedback, times the dead time: a phase margin of 70°.",
        "",
    )  # fmt: skip
    largest_damping_rate: float = threshold(
        0.6, "1",
        "Rate of damping that is asked for, times the dead time: one in full would make the motion swing.",
        "",
    )  # fmt: skip
    largest_feeding_rate: float = threshold(
        3.0, "1",
        "Rate that feeds the motion, times the dead time.",
        "",
    )  # fmt: skip
    held_growth: float = threshold(
        0.15, "1",
        "Growth at rest times the dead time up to which the amplitude is held; beyond, the motion is released instead.",
        "",
    )  # fmt: skip
    phase_tracking_rate: float = threshold(
        0.25, "1",
        "Rate at which the oscillator follows the phase, times the dead time.",
        "",
    )  # fmt: skip
    quadrature_rate: float = threshold(
        0.25, "1",
        "Rate at which the force at right angles to the velocity is taken back, times the dead time.",
        "",
    )  # fmt: skip
    integral_rate_ratio: float = threshold(
        0.25, "1",
        "Rate of the integral part over that of the proportional one: a quarter is aperiodic.",
        "",
    )  # fmt: skip
    largest_integrated_log_error: float = threshold(
        0.2, "1",
        "Error of ln a beyond which the integral winds up no faster.",
        "",
    )  # fmt: skip
    feedback_adaption_rate: float = threshold(
        0.3, "1",
        "Rate at which the gain of velocity feedback is adapted, times the dead time.",
        "",
    )  # fmt: skip
    response_limit_share: float = threshold(
        0.85, "1",
        "Share of the limit of the response at which control is given up for damping.",
        "",
    )  # fmt: skip
    voltage_limit_share: float = threshold(
        0.9, "1",
        "Share of the voltage limit that feedback may use.",
        "",
    )  # fmt: skip
    filter_cutoff_ratio: float = threshold(
        0.3, "1",
        "Cut-off of the filter over the frequency of the mode.",
        "",
    )  # fmt: skip
    decayed_ratio: float = threshold(
        0.1, "1",
        "Response over the lowest level at which it counts as down.",
        "",
    )  # fmt: skip
    phase_amplitude_ratio: float = threshold(
        0.1, "1",
        "Amplitude over a level from which the phase of the response is followed.",
        "",
    )  # fmt: skip
    target_rate_ratio: float = threshold(
        0.3, "1",
        "Rate of the logarithm of a target over that of the law: the law follows.",
        "",
    )  # fmt: skip
    first_target_ratio: float = threshold(
        2.0, "1",
        "First target over the amplitude from which the response is followed.",
        "",
    )  # fmt: skip
    phase_engaged_ratio: float = threshold(
        1.3, "1",
        "Response over the amplitude from which its phase is followed, at which following begins.",
        "",
    )  # fmt: skip
    phase_released_ratio: float = threshold(
        0.6, "1",
        "The same, at which following ends: the two are apart, so that noise does not switch.",
        "",
    )  # fmt: skip
    lost_control_ratio: float = threshold(
        1.5, "1",
        "Response over its target at which control is lost.",
        "",
    )  # fmt: skip
    largest_detuning: float = threshold(
        1.0e-4, "1",
        "Of the frequency, by the force at right angles to the velocity, at lock.",
        "",
    )  # fmt: skip
    lost_lock_change: float = threshold(
        0.1, "1",
        "Of a locked amplitude, or over a hundred of the frequency, that loses the lock.",
        "",
    )  # fmt: skip
    shortest_free_window_periods: float = threshold(
        6.0, "periods",
        "Shortest window of a free motion, in periods of the mode.",
        "",
    )  # fmt: skip
    release_log_lead: float = threshold(
        0.6, "1",
        "Of ln a, beside the amplitude to be passed, at which a motion is released.",
        "",
    )  # fmt: skip
    shortest_log_lead: float = threshold(
        0.15, "1",
        "The same where the drive carries no further.",
        "",
    )  # fmt: skip
    settled_growth_ratio: float = threshold(
        5e-4, "1",
        "Growth over frequency that counts as none.",
        "",
    )  # fmt: skip
    limit_cycle_log_distance: float = threshold(
        0.02, "1",
        "Of ln a: a level that is the amplitude of a settled motion.",
        "",
    )  # fmt: skip
    free_window_log_span: float = threshold(
        0.8, "1",
        "Of ln a within a window of a free motion.",
        "",
    )  # fmt: skip
    release_log_tolerance: float = threshold(
        0.05, "1",
        "Of ln a short of the amplitude at which a motion is to be released.",
        "",
    )  # fmt: skip
    growth_periods: float = threshold(
        2.0, "periods",
        "Periods over which the growth of a free motion is measured.",
        "",
    )  # fmt: skip


@dataclass(frozen=True)
class SweepThresholds:
    """Sweeps and stepped sines."""

    filter_cutoff_ratio: float = threshold(
        0.15, "1",
        "Cut-off of the filter over the frequency of the drive.",
        "",
    )  # fmt: skip
    probe_voltage_v: float = threshold(
        1.0e-4, "V",
        "First voltage where nothing is known of the exciter: small beside what any amplifier puts out.",
        "",
    )  # fmt: skip
    probe_log_growth: float = threshold(
        0.25, "1",
        "Of ln u in a block while the amplitude is within its noise.",
        "",
    )  # fmt: skip
    probe_noise_ratio: float = threshold(
        20.0, "1",
        "Amplitude over its noise from which on the controller works.",
        "",
    )  # fmt: skip
    shortest_dwell_s: float = threshold(
        0.2, "s",
        "Shortest time over which amplitudes are judged stationary.",
        "",
    )  # fmt: skip
    longest_rest_s: float = threshold(
        10.0, "s",
        "Longest time until a structure rests after a fade.",
        "",
    )  # fmt: skip
    lost_log_deviation: float = threshold(
        math.log(2.0), "1",
        "Logarithm of the held amplitude over its target that ends a sweep if it lasts: a factor of two.",
        "",
    )  # fmt: skip
    lost_duration_s: float = threshold(
        1.0, "s",
        "How long that deviation must last.",
        "",
    )  # fmt: skip
    glide_frequency_step: float = threshold(
        0.05, "1",
        "Relative change of frequency up to which a stepped sine glides on instead of stopping.",
        "",
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
    """

    phase: PhaseThresholds = field(default_factory=PhaseThresholds)
    amplitude: AmplitudeThresholds = field(default_factory=AmplitudeThresholds)
    harmonics: HarmonicsThresholds = field(default_factory=HarmonicsThresholds)
    secondary: SecondaryThresholds = field(default_factory=SecondaryThresholds)
    self_excited: SelfExcitedThresholds = field(default_factory=SelfExcitedThresholds)
    sweeps: SweepThresholds = field(default_factory=SweepThresholds)


THRESHOLDS = LoopThresholds()
"""The values that are in force."""
PHASE, AMPLITUDE, HARMONICS, SECONDARY, SELF_EXCITED, SWEEPS = (
    THRESHOLDS.phase,
    THRESHOLDS.amplitude,
    THRESHOLDS.harmonics,
    THRESHOLDS.secondary,
    THRESHOLDS.self_excited,
    THRESHOLDS.sweeps,
)
"""Their themes."""
