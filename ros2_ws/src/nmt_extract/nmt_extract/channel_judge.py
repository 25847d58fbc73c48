"""Each channel of a window judged by what the others say: dead, flat-topped, off its shape, noisy.

A fault is told from a nonlinear shape by where it sits. A structure that changes its shape changes it at many points;
without a faulty channel the rest of the shape fits its neighbour, or the linear modes, much better than with it. Where
other modes lie near the frequency, and where the shape moved from level to level before, it may move on by them: what
fits is then the span of all of these. Where there are too few points for that, a shape that moves as it did before is
none that a fault makes; any other leaves open which of both it is, and nothing is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_signals.harmonics import Moments

_ISOLATED, _ISOLATED_LINEAR = 10.0, 15.0  # a channel's deviation over that of all others together
_OFF_OWN = 0.05  # of a channel's own value
_OFF_LINEAR = 0.35  # of the largest value of the shape: linear modes have errors of their own
_OFF_CLEAR, _CLEAR = 0.1, 50.0  # the same where the deviation is so much larger than that of all others
_LEAST = 0.02  # of the largest value: smaller deviations do not matter
_SURE = 5.0  # standard deviations
_NOISE_JUMP, _NOISE_SHARE = 10.0, 0.05  # over the level before; of the channel's rms
_GAIN = 0.25  # logarithm of the force over what voltage and response say of it
_GAIN_SUSPECT = 0.1  # the same where it was off at the level before
_EXCITER = 1e-3  # of the blocked force: what no linear exciter explains
_PRIOR = {"model": 0.1, "test": 0.2}  # of the exciter's impedance, by the source of the linear description
_SURE_FORCE = 3.0  # standard deviations; the gain must be off by _GAIN, too
_CLEAN, _ALIKE = 20.0, 0.15  # harmonics: over their standard deviation; of the factor that they have in common
_STRANGE = 0.5  # correlation with all that the linear modes can do
_CLOSE = 0.1  # distance of modes near the frequency, of it
_ALIKE_DOUBT = 3.0  # isolation of the worst deviation over that of another one that may be a fault as well
_LEAST_DOUBT = 0.002  # of the largest value
_FASTER, _ADDED = 5.0, 0.01  # how much faster over ln q than before a near mode may come in; of the target's share
_MIXED = 3.0  # share of a near mode over the shift of the frequency beside its distance
_APART, _KEPT = 0.2, 0.2  # ln q between levels that tell; change of a share that stays, of it


class DriveState(NamedTuple):
    """Force and motion at the drive point in one window.

    Attributes:
        omega: rad/s.
        voltage: fundamental of the drive, V; NaN = not measured.
        force: harmonics 0..H, N.
        velocity: harmonics 0..H at the drive point, m/s.
        force_std, velocity_std: their standard uncertainties; NaN = not known.
        driven: whether the drive has harmonics as well.
    """

    omega: float
    voltage: complex
    force: ComplexArray
    velocity: ComplexArray
    force_std: FloatArray
    velocity_std: FloatArray
    driven: bool = False


class Course(NamedTuple):
    """Where a level lies on the way of a shape.

    Attributes:
        place: ln of the modal amplitude (m√kg).
        shares: participation of the near modes beside the target's, shape ``(modes,)``.
        shift: of the frequency from the target's linear one, of the distance to the nearest near mode.
    """

    place: float
    shares: ComplexArray
    shift: float


class Doubt(NamedTuple):
    """A channel that may be off, or the shape moves: measured over expected, at which level, and whether it stays."""

    ratio: complex
    course: Course
    stays: bool = False


@dataclass
class ChannelHistory:
    """What the last level without a fault looked like.

    Attributes:
        names: of the channels.
        level_index: of that level; -1 = none yet.
        shape: its fundamental at the points of the linear modes, in any unit, shape ``(points,)``.
        noise: rms of each channel that no harmonic explains, in the channel's unit.
        faulty: channels that were faulty at the level before, by row.
        drives: force and motion at the drive point at each level without a fault.
        driven: levels in which the drive has harmonics, and up to which those of the force are controlled.
        shapes: those of all levels without a fault, of unit size and common phase.
        course: where they lie on the way of the shape.
        doubts: channels that may be off, by row: measured over expected, where that was, and whether it has stayed
            while the amplitude changed.
    """

    names: tuple[str, ...] = ()
    level_index: int = -1
    shape: ComplexArray = field(default_factory=lambda: np.empty(0, dtype=np.complex128))
    noise: FloatArray = field(default_factory=lambda: np.empty(0))
    faulty: frozenset[int] = frozenset()
    drives: list[DriveState] = field(default_factory=list)
    driven: dict[int, int] = field(default_factory=dict)
    shapes: list[ComplexArray] = field(default_factory=list)
    course: list[Course] = field(default_factory=list)
    doubts: dict[int, Doubt] = field(default_factory=dict)

    def doubt(self, found: Mapping[int, Deviation], course: Course) -> Mapping[int, Doubt]:
        """Channels that may be off at a level.

        Args:
            found: deviations that the points do not tell from a shape that moves, by row.
            course: of the level.
        """
        for row, before in list(self.doubts.items()):
            if not before.stays and stays(before.course, course):
                self.doubts[row] = before._replace(stays=True)
        self.doubts = {row: doubt for row, doubt in self.doubts.items() if doubt.stays}
        if not moves_on(self.course, course):
            for row, each in found.items():
                self.doubts.setdefault(row, Doubt(each.ratio, course))
        return self.doubts

    def knows(self, names: Sequence[str]) -> bool:
        """Whether there is a level of the same channels."""
        return self.level_index >= 0 and self.names == tuple(names)

    def take(
        self,
        names: Sequence[str],
        level_index: int,
        shape: ComplexArray,
        noise: FloatArray,
        drive: DriveState,
        course: Course,
    ) -> None:
        """Take a level without a fault."""
        if self.names != tuple(names):
            self.drives, self.shapes, self.course = [], [], []
        self.drives.append(drive)
        self.course.append(course)
        self.shapes.append(shape / np.linalg.norm(shape) * np.exp(-1j * np.angle(shape.sum())))
        self.names, self.level_index, self.shape, self.noise = tuple(names), level_index, shape, noise
        self.faulty = frozenset()


def noise_rms(data: FloatArray, moments: Moments, amplitudes: ComplexArray) -> FloatArray:
    """What no harmonic explains.

    Args:
        data: shape ``(channels, samples)``.
        moments: of the parts of the window; a level that still changes from part to part is no noise.
        amplitudes: harmonics 0..H of each part, shape ``(parts, channels, H + 1)``.

    Returns:
        rms, shape ``(channels,)``.
    """
    total = np.einsum("ij,ij->i", data, data)
    explained = (amplitudes * moments.projections).real.sum(axis=(0, 2))
    return np.asarray(np.sqrt(np.maximum(total - explained, 0.0) / data.shape[1]))


@dataclass(frozen=True)
class Deviation:
    """A channel beside what the others predict of it.

    Attributes:
        index: of the point in the shape.
        ratio: measured over predicted.
        share: of the deviation in the largest value of the shape.
        isolation: the deviation over that of all others together when this one is left out.
    """

    index: int
    ratio: complex
    share: float
    isolation: float

    @property
    def own(self) -> float:
        """Deviation in terms of the larger one of measured and predicted."""
        return abs(self.ratio - 1.0) / max(abs(self.ratio), 1.0)

    @property
    def words(self) -> str:
        """For people."""
        size, turn = abs(self.ratio), math.degrees(np.angle(self.ratio))
        if size < 0.05:
            return "does not follow the excitation"
        if abs(turn) > 150.0:
            turned = "with the wrong sign"
        else:
            turned = f"{abs(turn):.0f}° {'early' if turn > 0 else 'late'}" if abs(turn) >= 2.0 else "in phase"
        return f"measures {size:.2f} times what the other channels say, {turned}"


def predicted(basis: ComplexArray, shape: ComplexArray, kept: Sequence[int]) -> ComplexArray:
    """The shape that a basis makes of the kept points.

    Args:
        basis: shape ``(points, columns)``.
        shape: shape ``(..., points)``.
        kept: points that are fitted.

    Returns:
        Shape ``(..., points)``.
    """
    rows = list(kept)
    return np.asarray(shape[..., rows] @ np.linalg.pinv(basis[rows]).T @ basis.T)


def deviations(basis: ComplexArray, shape: ComplexArray, kept: Sequence[int]) -> list[Deviation]:
    """Each of the kept points left out in turn; empty where the basis leaves nothing to compare.

    Args:
        basis: shape ``(points, columns)``.
        shape: shape ``(points,)``.
        kept: points that are judged.
    """
    if len(kept) - 1 <= basis.shape[1]:
        return []
    found = []
    for index in kept:
        others = [k for k in kept if k != index]
        guess = predicted(basis, shape, others)
        scale = max(float(np.abs(shape[others]).max()), abs(guess[index]))
        rest = max(float(np.linalg.norm((shape - guess)[others])), 1e-9 * scale)
        away = abs(shape[index] - guess[index])
        ratio = complex(shape[index] / guess[index]) if guess[index] != 0.0 else complex(math.inf, 0.0)
        found.append(Deviation(index, ratio, float(away / scale), float(away / rest)))
    return found


def linear_basis(shapes: FloatArray, target: int, points: int) -> ComplexArray:
    """The linear modes, or the target mode where so many points do not determine them with something to spare."""
    chosen = shapes if points > shapes.shape[1] else shapes[:, [target]]
    return chosen.astype(np.complex128)


class ShapeFaults(NamedTuple):
    """What does not fit, by point.

    Attributes:
        off: the words why, and whether it was the neighbouring level.
        doubtful: words on channels that may be off, or the shape moves: there are too few points to tell.
    """

    off: dict[int, tuple[str, bool]]
    doubtful: dict[int, Deviation]


def near_modes(linear: LinearDescription, omega: float) -> list[int]:
    """Linear modes besides the target near a frequency (rad/s)."""
    return [
        mode
        for mode, own in enumerate(linear.frequencies_rad_s)
        if mode != linear.target_mode and abs(own - omega) < _CLOSE * omega
    ]


def mode_words(linear: LinearDescription, mode: int) -> str:
    """For people: number from 1 and frequency."""
    return f"mode {mode + 1} at {linear.frequencies_rad_s[mode] / (2.0 * math.pi):.5g} Hz"


def off_its_shape(
    shape: ComplexArray,
    std: FloatArray,
    linear: ComplexArray,
    neighbour: ComplexArray | None,
    points: Sequence[int],
    suspects: Sequence[int] = (),
    near: ComplexArray | None = None,
    trend: ComplexArray | None = None,
) -> ShapeFaults:
    """Points whose channel alone does not fit the neighbouring level or the linear modes.

    Linear modes have errors of their own: a small deviation from them counts where the neighbouring level had none.

    Args:
        shape: fundamental, shape ``(points,)``.
        std: its standard uncertainty, same unit and shape; NaN = not known.
        linear: see :func:`linear_basis`.
        neighbour: shape of a level before without a fault, same shape; None = there is none.
        points: that are judged.
        suspects: that were faulty at the level before; no sensor mends itself.
        near: modes near the frequency, shape ``(points, modes)``: the shape may move by them.
        trend: by what it moved over the levels before, shape ``(points,)``; None = nothing to speak of.
    """
    kept = list(points)
    found: dict[int, tuple[str, bool]] = {}
    bases = [linear] if neighbour is None else [neighbour[:, np.newaxis], linear]
    before = [] if neighbour is None else deviations(linear, neighbour, range(shape.size))
    fitted = {each.index for each in before if each.share < _LEAST}
    largest = float(np.abs(shape).max())

    def is_off(each: Deviation, to_linear: bool, *, doubt: bool = False) -> bool:
        turned = each.ratio.real < 0.0 or abs(each.ratio) < 0.05
        clear = each.isolation > _CLEAR and (doubt or each.share > _OFF_CLEAR)
        plain = each.share > _OFF_LINEAR or clear
        needed = _ISOLATED
        if to_linear and not (turned or plain):
            if each.index not in fitted:
                return False
            needed = _ISOLATED_LINEAR
        if each.index in suspects:
            needed *= 0.25
        sure = not each.share * largest <= _SURE * std[each.index]
        least = _LEAST_DOUBT if doubt else _LEAST
        return sure and each.own > _OFF_OWN and each.share > least and each.isolation > needed

    while True:
        off: list[tuple[Deviation, bool]] = []
        doubtful: dict[int, Deviation] = {}
        for basis in bases:
            wide = basis if near is None else np.concatenate([basis, near], axis=1)
            if trend is not None and len(kept) - 1 > wide.shape[1] + 1:
                wide = np.concatenate([wide, trend[:, np.newaxis]], axis=1)
            to_linear = basis is linear
            off += [(each, not to_linear) for each in deviations(wide, shape, kept) if is_off(each, to_linear)]
            if len(kept) - 1 <= wide.shape[1]:
                for each in deviations(basis, shape, kept):
                    before_it = doubtful.get(each.index, each)
                    if is_off(each, to_linear, doubt=True) and each.isolation >= before_it.isolation:
                        doubtful[each.index] = each
        if not off:
            clearest = max((each.isolation for each in doubtful.values()), default=0.0)
            return ShapeFaults(
                found, {k: each for k, each in doubtful.items() if _ALIKE_DOUBT * each.isolation > clearest}
            )
        worst, by_neighbour = max(off, key=lambda item: item[0].isolation)
        found[worst.index] = worst.words, by_neighbour
        kept.remove(worst.index)


def shape_trend(shapes: Sequence[ComplexArray]) -> ComplexArray | None:
    """By what a shape moved over the last two levels; None where it hardly did.

    Args:
        shapes: of the levels, of unit size and phase, each of shape ``(points,)``.
    """
    if len(shapes) < 2:
        return None
    change = np.asarray(shapes[-1] - shapes[-2])
    return change if float(np.linalg.norm(change)) > _LEAST else None


def course_of(shape: ComplexArray, near: Sequence[int], linear: LinearDescription, omega: float) -> Course:
    """Course of a shape (displacements in m, shape ``(points,)``) at a frequency (rad/s)."""
    coordinates = np.linalg.pinv(linear.shape_matrix) @ shape
    target, own = coordinates[linear.target_mode], linear.frequencies_rad_s[linear.target_mode]
    gap = min((abs(linear.frequencies_rad_s[mode] - own) for mode in near), default=math.inf)
    shares = coordinates[list(near)] / target if target != 0.0 else np.full(len(near), complex(math.nan))
    place = math.log(max(float(np.linalg.norm(coordinates)), 1e-300))
    return Course(place, np.asarray(shares), abs(omega - own) / max(gap, 1e-300))


def moves_on(before: Sequence[Course], here: Course) -> bool:
    """Whether near modes come in as a nonlinear force lets them, and no gain does.

    As they did over the levels before; where there are fewer than two of these, in proportion to the frequency: a force
    that shifts it by a share of the distance between two modes mixes them by about that share.

    Args:
        before: levels before, any order.
        here: this level.
    """
    if len({course.place for course in before}) < 2:
        return bool(np.abs(here.shares).max() < _MIXED * here.shift + _ADDED)
    one, two = sorted(before, key=lambda course: abs(course.place - here.place))[:2]
    rate = float(np.abs(one.shares - two.shares).max()) / max(abs(one.place - two.place), 1e-9)
    return bool(np.abs(here.shares - one.shares).max() < _FASTER * rate * abs(here.place - one.place) + _ADDED)


def stays(then: Course, now: Course) -> bool:
    """Whether near modes keep their share while the amplitude changes: what a gain makes of a shape."""
    change = float(np.abs(now.shares - then.shares).max())
    return abs(now.place - then.place) > _APART and change < _KEPT * float(np.abs(then.shares).max())


def strange_shape(shape: ComplexArray, shapes: FloatArray) -> bool:
    """Whether a shape is neither one of the linear modes nor, where there are more points than modes, made of them."""
    size = float(np.linalg.norm(shape))
    if size == 0.0:
        return True
    each = np.abs(shapes.T @ shape) / (np.linalg.norm(shapes, axis=0) * size)
    best = float(each.max()) ** 2
    if shapes.shape[0] > shapes.shape[1]:
        whole = predicted(shapes.astype(np.complex128), shape, range(shape.size))
        best = max(best, float(np.linalg.norm(whole) / size) ** 2)
    return best < _STRANGE


def unrepeated_rms(residual: FloatArray, samples_per_period: float) -> float:
    """What of a residual does not come again a period later, rms: noise, but no harmonic of however high an order.

    Args:
        residual: of one channel, shape ``(samples,)``, more than one period.
        samples_per_period: need not be whole.
    """
    place = np.arange(residual.size - int(np.ceil(samples_per_period)), dtype=np.float64)
    later = np.interp(place + samples_per_period, np.arange(residual.size), residual)
    return float(np.sqrt(0.5 * np.mean((later - residual[: place.size]) ** 2)))


def noise_jumps(
    noise: FloatArray, rms: FloatArray, before: FloatArray, rows: Sequence[int], unrepeated: Callable[[int], float]
) -> Mapping[int, str]:
    """Rows whose noise alone has risen since the level before, with the words why.

    Args:
        noise, rms, before: of each row: what no harmonic explains, all, and the noise of the level before.
        rows: that are judged.
        unrepeated: rms of what does not come again a period later, by row: slip has harmonics beyond those fitted.
    """
    rise = {row: noise[row] / max(before[row], 1e-6 * rms[row], 1e-300) for row in rows}
    found = {}
    for row in rows:
        usual = float(np.median([rise[other] for other in rows if other != row] or [1.0]))
        jumped = rise[row] > _NOISE_JUMP * max(usual, 1.0) and noise[row] > _NOISE_SHARE * rms[row]
        if jumped and unrepeated(row) > 0.5 * noise[row]:
            found[row] = f"has {100.0 * noise[row] / rms[row]:.0f} % of noise, much more than at the level before"
    return found


def force_gain(
    drive: DriveState, before: Sequence[DriveState], linear: LinearDescription, suspect: bool = False
) -> float | None:
    """By which factor the gain of the force has changed, if the change is clear.

    Whatever the structure does, an exciter obeys F + Z v = K u: K is its blocked force per volt and
    Z = c + i (ω m - k/ω) its impedance. The levels before determine K, c and k, from the linear modes with and without
    the exciter as a start;
    K u - Z v is the force that this level must have. Where damping is so strong, or the exciter so much stronger, that
    this says nothing, the harmonics may: without voltage they have F/v = -Z(nω), level after level.

    Args:
        drive: the window that is judged.
        before: those of the run without a fault.
        linear: modes, moving mass and the mode with the exciter attached.
        suspect: the gain had changed at the level before; no sensor mends itself.

    Returns:
        Measured over expected force, off by more than a quarter; None = no such change.
    """
    if not before:
        return None
    gains = [
        _fundamental_gain(drive, before, linear, 0.0 if suspect else _SURE_FORCE),
        _harmonic_gain(drive, before[-1]),
    ]
    least = _GAIN_SUSPECT if suspect else _GAIN
    return next((gain for gain in gains if gain is not None and abs(math.log(gain)) > least), None)


def _fundamental_gain(
    drive: DriveState, before: Sequence[DriveState], linear: LinearDescription, sure: float
) -> float | None:
    """Force over K u - Z v; None where voltage and response do not determine it."""
    known = [state for state in before if math.isfinite(abs(state.voltage))]
    if not known or not math.isfinite(abs(drive.voltage)) or linear.drive_point_shape == 0.0:
        return None
    mass, moving = linear.drive_point_shape**-2, linear.moving_mass_kg
    omega, plant = linear.frequencies_rad_s[linear.target_mode], linear.plant_frequency_rad_s
    damping = 2.0 * linear.plant_damping_ratio * plant * (mass + moving)
    damping -= 2.0 * linear.damping_ratios[linear.target_mode] * omega * mass
    stiffness = plant**2 * (mass + moving) - omega**2 * mass
    size = abs(complex(damping, omega * moving - stiffness / omega))
    open_z = _PRIOR.get(linear.source, 0.2) * size + (plant / omega - 1.0) ** 2 * omega * (mass + moving)
    open_z = max(open_z, 1e-3 * 2.0 * linear.damping_ratios[linear.target_mode] * omega * mass)

    def fundamental(state: DriveState) -> tuple[complex, complex, float, float]:
        return (
            complex(state.force[1]),
            complex(state.velocity[1]),
            float(state.force_std[1]),
            float(state.velocity_std[1]),
        )

    def rows(states: Sequence[DriveState]) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Factors of K, and of what c and k/ω₀ have beyond the start; what F is with the start; its deviation."""
        force, speed, force_std, speed_std = (np.array(each) for each in zip(*map(fundamental, states), strict=True))
        voltage, at = np.array([state.voltage for state in states]), np.array([state.omega for state in states])
        factors = np.stack([voltage, 1j * voltage, -speed * open_z, 1j * speed * open_z * omega / at], axis=1)
        impedance = damping + 1j * (at * moving - stiffness / at)
        value = force + impedance * speed
        # F is often the small difference of K u and Z v: the noise of v counts as well.
        std = _EXCITER * np.abs(value) + np.hypot(
            np.nan_to_num(force_std), np.abs(impedance) * np.nan_to_num(speed_std)
        )
        return factors, value, std

    def parts(values: ComplexArray) -> FloatArray:
        """Real and imaginary part of each row below each other."""
        return np.stack([values.real, values.imag], axis=1).reshape(2 * len(values), *values.shape[1:])

    factors, value, std = rows(known)
    matrix = np.concatenate([[[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], parts(factors / std[:, None])])
    scale = np.abs(matrix).max(axis=0)
    covariance = np.linalg.pinv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)
    solution = covariance @ (matrix.T @ np.concatenate([np.zeros(2), parts(value / std)]))
    (factors,), (value,), (std,) = rows([drive])
    two = np.array([factors.real, factors.imag])
    spread = math.hypot(std, math.sqrt(max(float(np.trace(two @ covariance @ two.T)), 0.0)))
    expected = complex(drive.force[1]) - (value - complex(factors @ solution))
    if abs(drive.force[1] - expected) < sure * spread or abs(expected) == 0.0:
        return None
    return float(abs(drive.force[1]) / abs(expected))


def _harmonic_gain(drive: DriveState, before: DriveState) -> float | None:
    """The factor that F/v has in common over the harmonics, against the level before; None where they do not agree.

    Nothing is known where the drive has harmonics itself.
    """
    if drive.driven or before.driven:
        return None
    count = min(drive.force.size, before.force.size)
    ratios = []
    for n in range(2, count):
        pairs = [
            (abs(values[n]), std[n])
            for state in (drive, before)
            for values, std in ((state.force, state.force_std), (state.velocity, state.velocity_std))
        ]
        if all(value > _CLEAN * std for value, std in pairs):
            ratios.append(drive.force[n] / drive.velocity[n] / (before.force[n] / before.velocity[n]))
    if len(ratios) < 2:
        return None
    gain = float(np.median(np.abs(ratios)))
    agree = all(abs(ratio / gain - 1.0) < _ALIKE for ratio in ratios)
    return gain if agree and abs(drive.omega / before.omega - 1.0) < _ALIKE else None
