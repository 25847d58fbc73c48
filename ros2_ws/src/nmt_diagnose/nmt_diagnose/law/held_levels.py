"""Held levels as complex amplitudes: what locked windows, stepped sines, decays and tables say of force and motion.

Each line of a stepped sine is a steady state under a known force: lines about a resonance at several forces are levels.

A decay and a table give frequency and damping ratio over amplitude. They are levels of the fundamental alone at which
the modal force 2iζω²q would act: that of phase resonance, and of a decay to first order in the damping.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import FUNDAMENTAL, HARMONICS, Observations, Part, Rows

_MOST_NODES = 12
"""Amplitudes of a decay or a table: more say the same again."""


@dataclass(frozen=True)
class HeldLevels:
    """Levels of one test, ascending motion.

    Attributes:
        name: of the test.
        drive_points: measurement point of each exciter.
        over_base: the force is the acceleration of a base.
        alone: fundamentals alone tell a law, whatever shaker stays attached.
        recorded: channels of the test, where forces are among them.
        numbers: of each level in the plan of the test, (L,).
        omega: angular frequency, rad/s, (L,).
        force: harmonics 0 … H of the measured force of each exciter, N, or of the acceleration of the base, m/s²,
            (E, L, H + 1); order 0 is 0.
        force_std: standard uncertainties of their fundamentals, N, (E, L).
        ratio, ratio_std: damping ratio of each level in the place of the force, and what frequency and damping are
            uncertain by together, (L,); None where the force is measured.
        channels: of the responses, C.
        motion: harmonics of the displacements, m, (L, C, H + 1); order 0 is 0, NaN where a channel was not used.
        motion_std: their standard uncertainties, m, (L, C, H + 1).
        chain: tolerances of the measuring chain; None = it measures as the rig file says.
    """

    name: str
    drive_points: tuple[int, ...]
    numbers: tuple[int, ...]
    omega: FloatArray
    force: ComplexArray
    force_std: FloatArray
    channels: tuple[MeasuredChannel, ...]
    motion: ComplexArray
    motion_std: FloatArray
    chain: MeasuringChain | None
    ratio: FloatArray | None = None
    ratio_std: FloatArray | None = None
    over_base: bool = False
    alone: bool = False
    recorded: tuple[MeasuredChannel, ...] = ()

    @property
    def count(self) -> int:
        """Number of levels L."""
        return int(self.omega.size)

    @property
    def harmonics(self) -> int:
        """Highest order H."""
        return int(self.motion.shape[2]) - 1

    def take(self, kept: list[int]) -> HeldLevels:
        """Some of the levels."""
        return replace(
            self, numbers=tuple(self.numbers[k] for k in kept), omega=self.omega[kept], force=self.force[:, kept],
            force_std=self.force_std[:, kept], motion=self.motion[kept], motion_std=self.motion_std[kept],
            ratio=None if self.ratio is None else self.ratio[kept],
            ratio_std=None if self.ratio_std is None else self.ratio_std[kept],
        )  # fmt: skip


def levels_over_amplitude(
    drive_points: tuple[int, ...],
    channels: tuple[MeasuredChannel, ...],
    amplitudes: FloatArray,
    observations: Observations,
    number: int,
) -> HeldLevels | None:
    """Amplitudes of a decay or a table as levels, spread evenly over the logarithm of the amplitude.

    Args:
        drive_points: measurement point of each exciter.
        channels: the first is the one of the amplitudes.
        amplitudes: in its unit, (k,).
        observations: the real side.
        number: of the measurement.
    """
    if channels[0].quantity not in MOTIONS:
        return None
    rows, here, count = observations.rows, observations.rows.test == number, len(amplitudes)
    found = {part: (np.full(count, np.nan), np.full(count, np.nan)) for part in (Part.LOG_FREQUENCY, Part.DAMPING)}
    for part, (value, std) in found.items():
        where = here & (rows.part == part)
        value[rows.level[where]], std[rows.level[where]] = observations.values[where], observations.sigma[where]
    (log_omega, log_std), (ratio, ratio_std) = found[Part.LOG_FREQUENCY], found[Part.DAMPING]
    values, std = np.full((count, len(channels), 2), np.nan, complex), np.full((count, len(channels), 2), np.nan)
    values[:, 0, 1], std[:, 0, 1] = amplitudes, 0.0
    for channel in range(1, len(channels)):
        for part in (Part.LOG_MAGNITUDE, Part.PHASE):
            where = here & (rows.part == part) & (rows.channel == channel)
            level, value = rows.level[where], observations.values[where]
            known = values[level, channel, 1] if part is Part.PHASE else 1.0
            values[level, channel, 1] = known * np.exp(value if part is Part.LOG_MAGNITUDE else 1j * value)
            std[level, channel, 1] = np.abs(values[level, channel, 1]) * observations.sigma[where]
    omega = np.exp(log_omega)
    scale = (1j * omega[:, None, None]) ** np.array([MOTIONS[c.quantity] for c in channels])[None, :, None]
    values[:, :, 0], std[:, :, 0] = 0.0, 0.0
    usable = np.flatnonzero(np.isfinite(omega) & np.isfinite(ratio) & (np.asarray(amplitudes) > 0.0))
    if not usable.size:
        return None
    order = usable[np.argsort(np.asarray(amplitudes)[usable], kind="stable")]
    spots = np.linspace(0, order.size - 1, min(order.size, _MOST_NODES)).round().astype(int)
    chain = observations.chains[number] if observations.chains else None
    chosen = [int(k) for k in order[spots]]
    complete = np.flatnonzero(np.isfinite(values[chosen]).all(axis=(0, 2)))
    with np.errstate(invalid="ignore"):  # amplitudes that are held out have no frequency
        values, std = (values / scale)[:, complete], (std / np.abs(scale))[:, complete]
    levels = HeldLevels(
        observations.tests[number].name, drive_points, tuple(range(count)), omega,
        np.zeros((1, count, 2), complex), np.zeros((1, count)),
        tuple(channels[int(k)] for k in complete), values, std,
        chain, ratio, np.hypot(log_std, ratio_std),
    )  # fmt: skip
    return levels.take(chosen)


def complex_amplitudes(
    observations: Observations, rows: Rows, here: np.ndarray, levels: int, channels: int, harmonics: int
) -> tuple[ComplexArray, FloatArray]:
    """Complex amplitudes (levels, channels, harmonics + 1) in the units of the channels, and their uncertainties."""
    parts = {part: np.full((levels, channels, harmonics + 1), np.nan) for part in (0, 1)}
    spread = {part: np.full((levels, channels, harmonics + 1), np.nan) for part in (0, 1)}
    for kind in (*FUNDAMENTAL, *HARMONICS):
        part = int(kind.facts.half == "im")
        where = np.flatnonzero(here & (rows.part == kind) & (rows.harmonic > 0))
        at = (rows.level[where], rows.channel[where], rows.harmonic[where])
        parts[part][at] = observations.values[where]
        spread[part][at] = observations.sigma[where]
    size = np.exp(parts[0][:, :, 1:2])
    values = size * (parts[0] + 1j * parts[1])
    values[:, :, 1] = size[:, :, 0] * np.exp(1j * parts[1][:, :, 1])
    values[:, :, 0] = 0.0
    return values, size * np.sqrt(0.5 * (spread[0] ** 2 + spread[1] ** 2))
