"""Settings of the reading of observations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.observations.observables import Part
from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet


@dataclass(frozen=True)
class Floors:
    """Standard deviations that solver and estimators leave without noise, far below what recordings repeat to.

    Attributes:
        log_frequency: locked frequency, relative: transients of the lock.
        phase_error: F-v phase at lock against what the controller aims at, rad, for all levels of a run together: the
            floor of a row is √levels times this. Loops that have not settled show it by a drift, which counts extra.
        log_magnitude, force_log_magnitude: fundamental amplitudes of motions and force, relative.
        phase: phases of fundamentals, rad.
        harmonic: other harmonics over the fundamental, 1.
        frf: frequency responses, relative and rad, besides the estimator's bias that is computed line by line.
        stepped: frequency responses at a held amplitude, relative and rad: harmonics that the model leaves out.
        decay_log_frequency: instantaneous frequency of a ring-down, relative.
        decay_damping: its damping ratio, relative.
        decay_shape: amplitudes and phases of other channels during a ring-down, relative and rad.
        table_log_frequency: frequencies of reduced tables without a stated uncertainty, relative.
        table_damping: their damping ratios, relative.
        record: samples of a record, relative to the rms of their channel.
    """

    log_frequency: float = 1e-6
    phase_error: float = 0.0
    log_magnitude: float = 1e-5
    force_log_magnitude: float = 1e-5
    phase: float = 1e-5
    harmonic: float = 1e-6
    frf: float = 1e-5
    stepped: float = 1e-5
    decay_log_frequency: float = 1e-6
    decay_damping: float = 1e-3
    decay_shape: float = 1e-5
    table_log_frequency: float = 1e-3
    table_damping: float = 5e-2
    record: float = 1e-2

    def window(self, part: Part, quantity: Quantity = Quantity.UNKNOWN, levels: int = 1) -> float:
        """Floor of an observable of a locked window, one of ``levels`` of its run."""
        if part is Part.PHASE_ERROR:
            return self.phase_error * math.sqrt(levels)
        return {
            Part.LOG_FREQUENCY: self.log_frequency,
            Part.LOG_MAGNITUDE: self.force_log_magnitude if quantity is Quantity.FORCE else self.log_magnitude,
            Part.PHASE: self.phase,
        }.get(part, self.harmonic)


@dataclass(frozen=True)
class ObservationSettings:
    """How bags become observables.

    Attributes:
        harmonics: highest order among the observables of locked windows.
        sub_windows: sub-windows of a locked window, for its uncertainties.
        fewest_periods: locked windows of fewer whole periods are left out: their noise cannot be estimated.
        lines: most lines of a frequency response that become observables.
        stepped_lines: the same of one with a held amplitude, for each level and direction.
        largest_std: observables of a frequency response with a larger relative uncertainty are left out: the logarithm
            of so noisy an amplitude is not Gaussian.
        decay_points: amplitudes of a ring-down at which frequency and damping are observed.
        record_rows: most samples of a record, over all channels, that become observables.
        record_segments: segments into which a long record is cut, for held-out data.
        floors: uncertainties that no amount of data removes.
        calibration: sheet of the measuring chain; None = what the bags say, else ordinary tolerances.
    """

    harmonics: int = 5
    sub_windows: int = 10
    fewest_periods: int = 8
    lines: int = 160
    stepped_lines: int = 40
    largest_std: float = 0.2
    decay_points: int = 12
    record_rows: int = 4000
    record_segments: int = 20
    floors: Floors = field(default_factory=Floors)
    calibration: CalibrationSheet | None = None
