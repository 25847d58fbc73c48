"""Held levels as complex amplitudes: what locked windows, stepped sines, decays and tables say of force and motion.

Each line of a stepped sine is a steady state under a known force: lines about a resonance at several forces are levels.

A decay and a table give frequency and damping ratio over amplitude. They are levels of the fundamental alone at which
the modal force 2iζω²q would act: that of phase resonance, and of a decay to first order in the damping.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.backbone_table.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.measurements.recorded_decay.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses.stepped_responses import SteppedResponses
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part, Rows

_MOST_NODES = 12
"""Amplitudes of a decay or a table: more say the same again."""
_LINES = 6
"""Lines of a response at one force: half of the motion of its peak and more, evenly over its logarithm."""
_BAND = 0.15
"""Of a mode, relative: a peak that moves further is not that of one level."""


@dataclass(frozen=True)
class HeldLevels:
    """Levels of one test, ascending motion.

    Attributes:
        test: the test.
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

    test: LockedWindows | RecordedDecay | BackboneTable | SteppedResponses
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
        return HeldLevels(
            self.test, tuple(self.numbers[k] for k in kept), self.omega[kept], self.force[:, kept],
            self.force_std[:, kept], self.channels, self.motion[kept], self.motion_std[kept], self.chain,
            None if self.ratio is None else self.ratio[kept],
            None if self.ratio_std is None else self.ratio_std[kept],
        )  # fmt: skip


def held_levels(observations: Observations, number: int) -> HeldLevels | None:
    """The levels of a test of the observations; None where it has no motion, or an exciter without a force.

    Args:
        observations: the real side.
        number: of the test.
    """
    test = observations.tests[number]
    if isinstance(test, RecordedDecay | BackboneTable):
        return _nodes(observations, number, test)
    if isinstance(test, SteppedResponses):
        return _lines(observations, number, test)
    if not isinstance(test, LockedWindows) or test.held == "response":
        return None
    rows, here = observations.rows, observations.rows.test == number
    sensors = {c.point: k for k, c in reversed(list(enumerate(test.channels))) if c.quantity is Quantity.FORCE}
    forces = [sensors[point] for point in test.drive_points if point in sensors]
    moved = [k for k, channel in enumerate(test.channels) if channel.quantity in MOTIONS]
    single = test.held == "force" and len(test.drive_points) == 1
    if not moved or (len(forces) < len(test.drive_points) and not single):
        return None
    values, std = _amplitudes(observations, rows, here, len(test.levels), len(test.channels), test.harmonics)
    omega = np.full(len(test.levels), np.nan)
    frequency = here & (rows.part == Part.LOG_FREQUENCY)
    omega[rows.level[frequency]] = np.exp(observations.values[frequency])
    force = np.zeros((len(test.drive_points), len(test.levels), test.harmonics + 1), complex)
    force_std = np.zeros(force.shape[:2])
    if single:
        for k, level in enumerate(test.levels):
            terms = np.array(level.terms[0][: test.harmonics])
            force[0, k, 1 : 1 + terms.size] = level.force_n * terms
    else:
        force = np.nan_to_num(np.moveaxis(values[:, forces], 1, 0))
        force_std = np.nan_to_num(np.moveaxis(std[:, forces, 1], 1, 0))
    orders = np.maximum(np.arange(test.harmonics + 1), 1)
    powers = np.array([MOTIONS[test.channels[k].quantity] for k in moved])
    scale = (1j * omega[:, None, None] * orders) ** powers[None, :, None]
    motion, motion_std = values[:, moved] / scale, std[:, moved] / np.abs(scale)
    size = np.nanmax(np.abs(motion[:, :, 1]), axis=1, initial=0.0)
    usable = np.isfinite(omega) & (np.abs(force[:, :, 1]).max(axis=0) > 0.0) & (size > 0.0)
    order = [int(k) for k in np.argsort(size, kind="stable") if usable[k]]
    chain = observations.chains[number] if observations.chains else None
    channels = tuple(test.channels[k] for k in moved)
    found = HeldLevels(
        test, tuple(level.index for level in test.levels), omega, force, force_std, channels, motion, motion_std, chain
    )
    return found.take(order) if order else None


def _nodes(observations: Observations, number: int, test: RecordedDecay | BackboneTable) -> HeldLevels | None:
    """Amplitudes of a decay or a table as levels, spread evenly over the logarithm of the amplitude."""
    if test.channel.quantity not in MOTIONS:
        return None
    channels = test.channels if isinstance(test, RecordedDecay) else (test.channel,)
    rows, here, count = observations.rows, observations.rows.test == number, len(test.amplitudes)
    found = {part: (np.full(count, np.nan), np.full(count, np.nan)) for part in (Part.LOG_FREQUENCY, Part.DAMPING)}
    for part, (value, std) in found.items():
        where = here & (rows.part == part)
        value[rows.level[where]], std[rows.level[where]] = observations.values[where], observations.sigma[where]
    (log_omega, log_std), (ratio, ratio_std) = found[Part.LOG_FREQUENCY], found[Part.DAMPING]
    values, std = np.full((count, len(channels), 2), np.nan, complex), np.full((count, len(channels), 2), np.nan)
    values[:, 0, 1], std[:, 0, 1] = test.amplitudes, 0.0
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
    usable = np.flatnonzero(np.isfinite(omega) & np.isfinite(ratio) & (np.asarray(test.amplitudes) > 0.0))
    if not usable.size:
        return None
    order = usable[np.argsort(np.asarray(test.amplitudes)[usable], kind="stable")]
    spots = np.linspace(0, order.size - 1, min(order.size, _MOST_NODES)).round().astype(int)
    chain = observations.chains[number] if observations.chains else None
    chosen = [int(k) for k in order[spots]]
    complete = np.flatnonzero(np.isfinite(values[chosen]).all(axis=(0, 2)))
    levels = HeldLevels(
        test, tuple(range(count)), omega, np.zeros((1, count, 2), complex), np.zeros((1, count)),
        tuple(channels[int(k)] for k in complete), (values / scale)[:, complete], (std / np.abs(scale))[:, complete],
        chain, ratio, np.hypot(log_std, ratio_std),
    )  # fmt: skip
    return levels.take(chosen)


def _lines(observations: Observations, number: int, first: SteppedResponses) -> HeldLevels | None:
    """Lines of all responses to a held force or base over the same channels as levels; None but for the first test."""
    same = [other for other, test in enumerate(observations.tests) if _alike(first, test)]
    same = [other for other in same if np.any(observations.rows.test == other)]
    if not same or same[0] != number or first.held != first.reference or first.reference not in ("force", "base"):
        return None
    tests = [_with_channels_of(first, observations.tests[other]) for other in same]
    if any(channel.quantity not in MOTIONS for channel in first.channels):
        return None
    forces = {round(float(np.log(np.max(test.levels))), 2) for test in tests}
    powers = np.array([MOTIONS[channel.quantity] for channel in first.channels])
    size = [np.abs(test.measured[:, 0]) * test.levels / (2.0 * np.pi * test.lines_hz) ** powers[0] for test in tests]
    if len(forces) < 2:  # what does not change with the amplitude is no law
        return None
    loudest = max(range(len(tests)), key=lambda k: float(size[k].max()))
    peak = tests[loudest].lines_hz[int(np.argmax(size[loudest]))]
    parts: list[tuple[FloatArray, ...]] = []
    for test, moved in zip(tests, size, strict=True):
        near = np.flatnonzero(np.abs(np.log(test.lines_hz / peak)) < _BAND)
        near = near[moved[near] >= 0.5 * moved[near].max()] if near.size else near
        order = near[np.argsort(moved[near], kind="stable")]
        chosen = order[np.unique(np.linspace(0, order.size - 1, min(order.size, _LINES)).round().astype(int))]
        if order.size:
            force = test.levels[chosen]
            amplitude = test.measured[chosen] * force[:, np.newaxis]
            parts.append((test.lines_hz[chosen], force, amplitude, test.noise[chosen], moved[chosen]))
    lines, force, amplitude, noise, moved = (np.concatenate(part) for part in zip(*parts, strict=True))
    omega = 2.0 * np.pi * lines
    motion = np.zeros((*amplitude.shape, 2), complex)
    motion[:, :, 1] = first.scale * amplitude / (1j * omega[:, np.newaxis]) ** powers
    driven = np.zeros((1, lines.size, 2), complex)
    driven[0, :, 1] = force
    chain = observations.chains[number] if observations.chains else None
    more = f" and {len(tests) - 1} more" if len(tests) > 1 else ""
    test = replace(first, name=f"{first.name}{more}")
    found = HeldLevels(
        test, tuple(range(lines.size)), omega, driven, np.zeros((1, lines.size)), tuple(first.channels), motion,
        np.abs(motion) * noise[:, np.newaxis, np.newaxis], chain,
    )  # fmt: skip
    return found.take([int(k) for k in np.argsort(moved, kind="stable")])


def _alike(first: SteppedResponses, test: object) -> bool:
    """Whether a test is another response at the same drive and channels as the first, with phases."""
    if not isinstance(test, SteppedResponses) or set(test.channels) != set(first.channels):
        return False
    kinds = [(it.drive_point, it.held, it.reference, it.phase_known, it.imposed) for it in (first, test)]
    return kinds[0] == kinds[1] and test.phase_known and not test.imposed


def _with_channels_of(first: SteppedResponses, test: object) -> SteppedResponses:
    assert isinstance(test, SteppedResponses)
    order = [test.channels.index(channel) for channel in first.channels]
    return replace(test, channels=first.channels, measured=test.measured[:, order])


def _amplitudes(
    observations: Observations, rows: Rows, here: np.ndarray, levels: int, channels: int, harmonics: int
) -> tuple[ComplexArray, FloatArray]:
    """Complex amplitudes (levels, channels, harmonics + 1) in the units of the channels, and their uncertainties."""
    parts = {part: np.full((levels, channels, harmonics + 1), np.nan) for part in (0, 1)}
    spread = {part: np.full((levels, channels, harmonics + 1), np.nan) for part in (0, 1)}
    names = {Part.LOG_MAGNITUDE: 0, Part.REAL: 0, Part.PHASE: 1, Part.IMAG: 1}
    for kind, part in names.items():
        where = np.flatnonzero(here & (rows.part == kind) & (rows.harmonic > 0))
        at = (rows.level[where], rows.channel[where], rows.harmonic[where])
        parts[part][at] = observations.values[where]
        spread[part][at] = observations.sigma[where]
    size = np.exp(parts[0][:, :, 1:2])
    values = size * (parts[0] + 1j * parts[1])
    values[:, :, 1] = size[:, :, 0] * np.exp(1j * parts[1][:, :, 1])
    values[:, :, 0] = 0.0
    return values, size * np.sqrt(0.5 * (spread[0] ** 2 + spread[1] ** 2))
