"""How large the motion of a set of tests is, from the model: typical sizes of effects follow from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class LackingMode:
    """A mode that responses show and the model lacks.

    Attributes:
        pole: of the responses, with positive imaginary part, rad/s.
        band_hz: first and last line of the responses.
        receptance: of the model at the pole, of each point by a force there, m/N.
    """

    pole: complex
    band_hz: tuple[float, float]
    receptance: Mapping[int, complex]


@dataclass(frozen=True)
class OperatingRange:
    """Largest amplitudes over all tests.

    Attributes:
        omega: frequency of the largest motion, rad/s.
        displacement: amplitude of each point, m.
        rotation: amplitude of the cross-section at each point of a beam, rad (empty for a chain).
        effective_mass: mass of the resonant mode as seen from each point, 1/φ², kg.
        effective_inertia: the same seen from the rotation of each point, kg m² (empty for a chain).
        pairs: amplitude (m) and effective mass (kg) across two points that an element may join.
        coil_displacement: amplitude of the coil (of the drive point without a shaker), m.
        total_mass: of the structure, kg.
        voltage: largest drive, V.
        force: fundamental of the force at the drive point, N.
        channels: largest fundamental amplitude of each channel by name, before its gain.
        channels_low: the same at the lowest level.
        steps: converter step of each channel whose samples were looked at, recorded units; 0 = they show none, or that
            of the model.
        limits: level at which the samples of a channel are clipped, recorded units.
        unclipped: channels whose samples were all looked at and stay at no level.
        delays: lateness of each channel against the model by the phases of all its lines, s.
        duration_s: bench time from the first to the last window, s.
        cycles: drive periods in that time.
        lacking: modes that responses show and the model lacks.
    """

    omega: float
    displacement: Mapping[int, float]
    rotation: Mapping[int, float]
    effective_mass: Mapping[int, float]
    effective_inertia: Mapping[int, float]
    pairs: Mapping[tuple[int, int], tuple[float, float]]
    coil_displacement: float
    total_mass: float
    voltage: float
    force: float
    channels: Mapping[str, float]
    channels_low: Mapping[str, float]
    duration_s: float
    cycles: float
    steps: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    unclipped: frozenset[str] = frozenset()
    delays: Mapping[str, float] = field(default_factory=dict)
    lacking: tuple[LackingMode, ...] = ()

    def typical_mass(self, point: int) -> float:
        """1 % of the moving mass at a point, kg: of the mode's mass there or of the structure, whichever is less."""
        return 0.01 * min(self.effective_mass[point], self.total_mass)

    def effective_stiffness(self, point: int) -> float:
        """ω² times the effective mass, N/m."""
        return self.omega**2 * self.effective_mass[point]
