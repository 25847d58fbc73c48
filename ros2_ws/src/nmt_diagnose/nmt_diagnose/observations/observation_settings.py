"""Settings of the reading of observations."""

from __future__ import annotations

from dataclasses import dataclass, field

from nmt_diagnose.observations.noise.floors import Floors
from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet


@dataclass(frozen=True)
class ObservationSettings:
    """How bags become observables.

    Attributes:
        harmonics: highest order among the observables of locked windows.
        sub_windows: sub-windows of a locked window, for its uncertainties.
        fewest_periods: locked windows of fewer whole periods are left out: nothing in them tells their noise.
        lines: most lines of a frequency response that become observables.
        stepped_lines: the same of one with a held amplitude, for each level and direction.
        largest_std: observables of a frequency response with a larger relative uncertainty are left out: the logarithm
            of a noisy amplitude is no longer Gaussian there.
        decay_points: amplitudes of a ring-down at which frequency and damping are observed.
        record_rows: most samples of a record, over all channels, that become observables.
        record_segments: segments into which a long record is cut, for what is held out.
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
    floors: Floors = field(default_factory=lambda: Floors())
    calibration: CalibrationSheet | None = None
