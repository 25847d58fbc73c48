"""Modal properties of a window: paper, section 2; method, eqs. 2 to 8."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_extract import channel_judge, window_judge
from nmt_extract.channel_judge import ChannelHistory
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.hysteresis import HysteresisLayout, hysteresis_loop
from nmt_extract.modal_point import EVALUATED, ModalPoint, Status, bench_time_ns, rejected_point
from nmt_extract.mode_identity import mode_sentence, other_mode
from nmt_extract.power_balance import BalancedMode, balance, part_count
from nmt_extract.uncertainty import jackknife, slope_uncertainty, sub_window_count
from nmt_extract.window import Window
from nmt_extract.window_judge import Remark
from nmt_signals.channel_faults import clipping
from nmt_signals.harmonics import Moments, resolvable_harmonics, segment_moments, solve_moments, whole_period_bounds
from nmt_signals.sine_fit import fit_frequency
from nmt_signals.spectral_lines import strongest_line

_SINE = 0.005  # harmonics over the fundamental of a force that is held to a sine


__all__ = ["ModalPoint", "ModalQuantities", "Status", "estimated_mass", "modal_point", "modal_quantities"]


def estimated_mass(shapes: FloatArray) -> FloatArray:
    """Mass matrix from linear mode shapes: M_exp = (Φᵀ)⁺ Φ⁺ (paper, eq. for M_exp; method, eq. 4).

    Args:
        shapes: mass-normalised Φ, 1/√kg, shape ``(points, modes)``.

    Returns:
        kg, shape ``(points, points)``; symmetric, of the rank of Φ.

    Examples:
        Two masses of 2 and 0.5 kg, whose shapes are known completely; of one mode alone the rank is one:

        >>> shapes = np.array([[0.5, 0.5], [1.0, -1.0]])
        >>> estimated_mass(shapes).diagonal().round(9)
        array([2. , 0.5])
        >>> int(np.linalg.matrix_rank(estimated_mass(shapes[:, :1])))
        1
    """
    inverse = np.linalg.pinv(shapes)
    return np.asarray(inverse.T @ inverse, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class ModalQuantities:
    """What follows from harmonics; every array leads with the axis ``sets``: the window and its variants.

    Each quantity of :data:`nmt_core.messages.modal_point.EVALUATED` is a property of its name, SI units, shape
    ``(sets,)`` (method, eqs. 3 to 7). Powers are positive when the exciter feeds the structure, so ``force`` is the
    force of the exciter on the structure.

    Attributes:
        omega: ω̃, rad/s, shape ``(sets,)``.
        force: F_n without n = 0, N, shape ``(sets, H)``.
        velocity: iωnψ̃_k,n at the drive point without n = 0, m/s, same shape.
        drive_acceleration: acceleration harmonics at the drive point without n = 0, m/s², same shape.
        shape: fundamental ψ̃₁ at the points of Φ, m, shape ``(sets, points)``.
        linear_shape: of the mode under test, 1/√kg, shape ``(points,)``.
        coordinates: modal coordinates Φ⁺ψ̃₁, m√kg, shape ``(sets, modes)``.
        further_force, further_velocity: of exciters besides the first at their points, shape
            ``(sets, exciters - 1, H)``; powers are those of all exciters, S is the sum of each one's. |P|/S is 1 where
            each exciter is in phase resonance at its own point.
    """

    omega: FloatArray
    force: ComplexArray
    velocity: ComplexArray
    drive_acceleration: ComplexArray
    shape: ComplexArray
    linear_shape: FloatArray
    coordinates: ComplexArray
    further_force: ComplexArray | None = field(default=None, kw_only=True)
    further_velocity: ComplexArray | None = field(default=None, kw_only=True)

    @cached_property
    def modal_amplitude(self) -> FloatArray:
        """q = |Φ⁺ψ̃₁|, m√kg."""
        return np.asarray(np.sqrt(_energy(self.coordinates)))

    @cached_property
    def force_n(self) -> FloatArray:
        """|F₁|, N."""
        return np.asarray(np.abs(self.force[:, 0]))

    @cached_property
    def _power(self) -> FloatArray:
        """P_n, W, shape ``(sets, H)``."""
        first = np.asarray(0.5 * (self.velocity * self.force.conj()).real)
        if self.further_force is None or self.further_velocity is None:
            return first
        return np.asarray(first + 0.5 * (self.further_velocity * self.further_force.conj()).real.sum(axis=1))

    @cached_property
    def active_power(self) -> FloatArray:
        """P₁, W."""
        return self._power[:, 0]

    @cached_property
    def apparent_power(self) -> FloatArray:
        """S over all harmonics, W."""
        first = np.asarray(np.sqrt(_energy(self.velocity) * _energy(self.force)) * 0.5)
        if self.further_force is None or self.further_velocity is None:
            return first
        further = np.sqrt(_energy(self.further_velocity) * _energy(self.further_force)).sum(axis=1)
        return np.asarray(first + 0.5 * further)

    @cached_property
    def self_excitation(self) -> FloatArray:
        """ξ = 2 P₁ / (ω̃ q)², rad/s."""
        return np.asarray(2.0 * self.active_power / (self.omega * self.modal_amplitude) ** 2)

    @cached_property
    def damping_ratio(self) -> FloatArray:
        """δ̃ = ξ / (2 ω̃)."""
        return np.asarray(self.self_excitation / (2.0 * self.omega))

    @cached_property
    def pbmif(self) -> FloatArray:
        """|P| / S over all harmonics."""
        return np.asarray(np.abs(self._power.sum(axis=1)) / self.apparent_power)

    @cached_property
    def gamma_force(self) -> FloatArray:
        """Fundamental over rms of all harmonics of the force, of all exciters together."""
        if self.further_force is not None:
            fundamental = self.force_n**2 + _energy(self.further_force[:, :, 0])
            return np.asarray(np.sqrt(fundamental / (_energy(self.force) + _energy(self.further_force).sum(axis=1))))
        return np.asarray(self.force_n / np.sqrt(_energy(self.force)))

    @cached_property
    def gamma_acceleration(self) -> FloatArray:
        """Fundamental over rms of all harmonics of the drive-point acceleration."""
        acceleration = self.drive_acceleration
        return np.asarray(np.abs(acceleration[:, 0]) / np.sqrt(_energy(acceleration)))

    @cached_property
    def mac(self) -> FloatArray:
        """|φᵀψ̃₁|² / (φᵀφ · |ψ̃₁|²)."""
        linear = self.linear_shape
        return np.asarray(
            np.abs((linear * self.shape).sum(axis=1)) ** 2 / ((linear * linear).sum() * _energy(self.shape))
        )

    @cached_property
    def phase_error(self) -> FloatArray:
        """Phase of force before velocity at the drive point, rad."""
        return np.asarray(np.angle(self.force[:, 0] * self.velocity[:, 0].conj()))

    @cached_property
    def normalised_shape(self) -> ComplexArray:
        """φ̃₁ = ψ̃₁ / q, 1/√kg, shape ``(sets, points)``."""
        return np.asarray(self.shape / self.modal_amplitude[:, np.newaxis])

    @cached_property
    def participation(self) -> ComplexArray:
        """Γ = Φ⁺φ̃₁, shape ``(sets, modes)``."""
        return np.asarray(self.coordinates / self.modal_amplitude[:, np.newaxis])


def modal_quantities(
    omega: FloatArray,
    force: ComplexArray,
    drive_displacement: ComplexArray,
    drive_acceleration: ComplexArray,
    shape: ComplexArray,
    linear_shapes: FloatArray,
    target_mode: int,
) -> ModalQuantities:
    """Powers, damping, amplitude and mode indicators of harmonics.

    Args:
        omega: ω̃, rad/s, shape ``(sets,)``.
        force: F_n, N, shape ``(sets, H + 1)``.
        drive_displacement: ψ̃_k,n at the drive point, m, shape ``(sets, H + 1)``.
        drive_acceleration: acceleration harmonics at the drive point, m/s², shape ``(sets, H + 1)``.
        shape: fundamental ψ̃₁ at the points of Φ, m, shape ``(sets, points)``.
        linear_shapes: mass-normalised Φ, 1/√kg, shape ``(points, modes)``.
        target_mode: index of the mode under test.

    Returns:
        The quantities, SI units.

    Raises:
        BenchError: force or response vanish.
    """
    orders = np.arange(1, force.shape[1])
    values = ModalQuantities(
        omega=omega,
        force=force[:, 1:],
        velocity=1j * orders * omega[:, np.newaxis] * drive_displacement[:, 1:],
        drive_acceleration=drive_acceleration[:, 1:],
        shape=shape,
        linear_shape=linear_shapes[:, target_mode],
        coordinates=(np.linalg.pinv(linear_shapes) * shape[:, np.newaxis, :]).sum(axis=2),
    )
    # Phase and amplitude of nothing are meaningless; rounding of zero signals stays far below.
    drive = np.abs(values.velocity[:, 0])
    if not (np.all(values.modal_amplitude > 0.0) and np.all(values.force_n > 0.0) and np.all(drive > 0.0)):
        raise BenchError("There is no force or no response at the excitation frequency; check sensors and drive.")
    return values


def modal_point(
    window: Window,
    linear: LinearDescription,
    settings: ExtractionSettings | None = None,
    history: ChannelHistory | None = None,
) -> ModalPoint:
    """Modal properties of a window with their standard uncertainties.

    Displacements come from displacement sensors if all points of the linear modes have one, else from
    velocity sensors, else from accelerometers. If the window's excitation phase is not known, the frequency
    is fitted to the force.

    Uncertainties: delete-one jackknife over sub-windows of whole periods (see
        :mod:`nmt_extract.uncertainty`).
    ``frequency_hz_std`` is the scatter of the oscillator's mean frequency over the sub-windows or, for a
    fitted frequency, the uncertainty of the slope of the force's phase over them. ``omega_rad_s_std`` adds
    that phase resonance is met to the phase error only: Δω ≈ δ̃ ω̃ Δφ. The uncertainty of the linear shapes
    is not included.

    Every channel is judged, see :mod:`nmt_extract.channel_judge`. One that is faulty is left out: what its point does
    is taken from the shape of the last level without a fault, fitted to the other channels. How badly it fits them, and
    how much the result differs with the linear modes in its place, is part of each uncertainty. Without such a level,
    without a force or without a response at the drive point the window is rejected.

    The window as a whole is judged, see :mod:`nmt_extract.window_judge`: phase, sign of the power, harmonics, drift (a
    slow polynomial is taken out), steadiness, clocks that run apart, drop-outs. No standard uncertainty is below what
    the resolution of the channels allows.

    Args:
        window: from :class:`nmt_extract.window.WindowAssembler`.
        linear: linear modes Φ at the response points.
        settings: None = defaults.
        history: last level without a fault, which a window without one replaces; None = there is none.

    Returns:
        The point; with status ``REJECTED`` and the reason if the window cannot be evaluated. A point with values names
        the channels that were left out, and what was found of the window, as its reason.
    """
    settings = settings or ExtractionSettings()
    try:
        return WindowEvaluation(window, linear, settings, history or ChannelHistory()).point()
    except BenchError as error:
        return rejected_point(window.lock, window.sample_rate, str(error))


class WindowEvaluation:
    """One window on its way to a modal point; set 0 is the whole window, set k lacks sub-window k."""

    def __init__(
        self, window: Window, linear: LinearDescription, settings: ExtractionSettings, history: ChannelHistory
    ) -> None:
        self.window = window
        self.linear = linear
        self.settings = settings
        self.history = history
        self.faults: dict[int, str] = {}  # by row of the window
        self.doubt_words = ""
        self.other_shapes: list[ComplexArray] = []  # with what else could be in the place of what is left out
        self.other_amplitudes: ComplexArray | None = None  # with another polynomial in the place of the drift
        self.drifted: dict[int, float] = {}  # height of the drift by row
        self.self_excited = window.lock.test is TestKind.SELF_EXCITED
        self._find_rows()
        self._find_phase()
        self._find_harmonics()
        self.noise = channel_judge.noise_rms(self.window.data, self.part_moments, self.part_amplitudes)
        self._take_out_drift()
        self._judge_channels()

    def _find_rows(self) -> None:
        self.force_row = self._row(Quantity.FORCE, self.linear.drive_point)
        if self.force_row is None:
            forces = [row for row, channel in enumerate(self.window.channels) if channel.quantity is Quantity.FORCE]
            if len(forces) != 1:
                raise BenchError(
                    f"There is no force channel at drive point {self.linear.drive_point}; "
                    f"force channels measure at {self._points_of(Quantity.FORCE)}."
                )
            if self.window.channels[forces[0]].point != 0:
                raise BenchError(
                    f"The force is measured at point {self.window.channels[forces[0]].point}, but the linear "
                    f"description names point {self.linear.drive_point} as drive point."
                )
            self.force_row = forces[0]
        for quantity in MOTIONS:
            rows = [self._row(quantity, point) for point in self.linear.points]
            if all(row is not None for row in rows):
                self.shape_rows = [row for row in rows if row is not None]
                self.shape_quantity = quantity
                break
        else:
            raise BenchError(
                "No kind of response sensor covers all points "
                f"({', '.join(map(str, self.linear.points))}) of the linear modes."
            )
        self._find_drive_rows()
        self.exciter_rows = self._find_exciters()

    def _find_exciters(self) -> list[tuple[int, int]]:
        """Rows of force and response of every exciter, where there are several."""
        rows = []
        for point in self.linear.exciter_points:
            force, motion = self._row(Quantity.FORCE, point), self._row(self.shape_quantity, point)
            if force is None or motion is None:
                raise BenchError(
                    f"Force and {self.shape_quantity.topic} are not both measured at exciter point {point}."
                )
            rows.append((force, motion))
        return rows if len(rows) > 1 else []

    def _find_drive_rows(self) -> None:
        candidates = (self.shape_quantity, *MOTIONS)
        self.drive_row, self.drive_quantity = self._first_row(candidates)
        self.gamma_row, self.gamma_quantity = self._first_row((Quantity.ACCELERATION, *candidates))

    def _row(self, quantity: Quantity, point: int) -> int | None:
        for row, channel in enumerate(self.window.channels):
            if channel.quantity is quantity and channel.point == point:
                return row
        return None

    def _first_row(self, quantities: tuple[Quantity, ...]) -> tuple[int, Quantity]:
        for quantity in quantities:
            row = self._row(quantity, self.linear.drive_point)
            if row is not None and row not in self.faults:
                return row, quantity
        faulty = f": {self.fault_words}" if self.faults else "."
        raise BenchError(f"No response is measured at drive point {self.linear.drive_point}{faulty}")

    def _points_of(self, quantity: Quantity) -> str:
        points = [str(c.point) for c in self.window.channels if c.quantity is quantity]
        return "point " + ", ".join(points) if points else "no point"

    def _find_phase(self) -> None:
        window = self.window
        self.fitted = window.cycles is None
        if window.cycles is None:
            force = window.data[self.force_row]
            try:
                frequency = fit_frequency(force, window.sample_rate, window.lock.frequency_hz)
            except BenchError:
                self._refuse_silence(window.sample_rate / strongest_line(force, window.sample_rate))
                raise
            samples: FloatArray = np.arange(window.samples, dtype=np.float64)
            self.cycles: FloatArray = samples * (frequency / window.sample_rate)
            end = window.samples * (frequency / window.sample_rate)
        else:
            self.cycles = window.cycles
            end = window.end_cycles
        self.advance = end - float(self.cycles[0])
        self.periods = round(self.advance)
        if self.periods < self.settings.minimum_periods:
            raise BenchError(
                f"The window holds {self.periods} whole periods; at least {self.settings.minimum_periods} are needed."
            )
        self._refuse_silence(window.samples / self.advance)

    def _refuse_silence(self, samples_per_period: float) -> None:
        window = self.window
        assert self.force_row is not None
        for row in dict.fromkeys((self.force_row, self.drive_row)):
            off = window_judge.silent_stretch(window.data[row], samples_per_period)
            if off is not None:
                what = "force" if row == self.force_row else "response at the drive point"
                raise BenchError(
                    f"The {what} ({window.channels[row].name}) was off from {self._second(off[0]):.6g} to "
                    f"{self._second(off[1]):.6g} s, within the window; choose a window beside it, or look at the cable."
                )

    def _second(self, sample: int) -> float:
        """Time of a sample of the window on the clock of the recording, s."""
        return (self.window.lock.window_first_sample + sample) / self.window.sample_rate

    def _take_out_drift(self) -> None:
        """Take slow polynomials out of channels whose mean changes over the window."""
        window, parts = self.window, self.part_amplitudes
        if not self.parts or self.settings.power_balance:
            return
        assert self.force_row is not None
        rows = sorted({self.force_row, self.drive_row, self.gamma_row, *self.shape_rows})
        found = window_judge.drifting(
            parts[:, rows, 0].real,
            np.abs(self.amplitudes[0, rows, 1]),
            self.noise[rows],
            window.samples,
            self.periods,
        )
        if not found:
            return
        self.drifted = {rows[k]: float(np.ptp(parts[:, rows[k], 0].real)) for k in found}
        chosen = list(self.drifted)
        for order in window_judge.drift_orders(self.periods)[::-1]:  # the one that stays last
            data = window.data.copy()
            data[chosen] = window_judge.without_drift(self.cycles, window.data[chosen], self.harmonics, order)
            self.window = replace(window, data=data)
            if self.fitted and self.force_row in chosen:
                self._find_phase()
            self._find_harmonics()
            if self.other_amplitudes is None:
                self.other_amplitudes = self.amplitudes
        self.noise = channel_judge.noise_rms(self.window.data, self.part_moments, self.part_amplitudes)

    def _find_harmonics(self) -> None:
        window = self.window
        samples_per_period = window.samples / self.advance
        self.harmonics = resolvable_harmonics(self.settings.harmonics, samples_per_period)
        if self.harmonics < 1:
            raise BenchError(
                f"{samples_per_period:.2g} samples a period do not resolve the fundamental; sample faster."
            )
        self.parts = sub_window_count(self.periods, self.settings.sub_windows)
        bounds = whole_period_bounds(self.cycles, self.periods, max(1, self.parts))
        moments = segment_moments(self.cycles, window.data, self.harmonics, bounds)
        total = moments.total()
        sets = total
        if self.parts:
            rest = moments.leave_one_out()
            sets = Moments(
                np.concatenate((total.basis, rest.basis)),
                np.concatenate((total.projections, rest.projections)),
            )
        self.amplitudes = solve_moments(sets)
        self.part_amplitudes = solve_moments(moments)
        self.part_moments, self.part_bounds = moments, bounds
        self._find_frequency(bounds)

    def _find_frequency(self, bounds: Any) -> None:
        rate = self.window.sample_rate
        frequency = self.advance / (self.window.samples / rate)
        self.frequency_hz = np.full(1 + self.parts, frequency)
        self.frequency_std = math.nan
        if not self.parts:
            return
        edges = np.append(self.cycles[bounds[:-1]], self.cycles[0] + self.advance)
        if self.fitted:
            fundamental = self.part_amplitudes[:, self.force_row, 1]
            middle = 0.5 * (bounds[1:] + bounds[:-1]) / rate
            # About their mean phase, so that no jump of 2π comes between.
            phases = np.angle(fundamental * np.conj(fundamental.sum())) / (2.0 * np.pi)
            self.frequency_std = slope_uncertainty(middle, phases)
        else:
            rest_advance = self.advance - np.diff(edges)
            rest_time = (self.window.samples - np.diff(bounds)) / rate
            self.frequency_hz[1:] = rest_advance / rest_time
            self.frequency_std = jackknife(self.frequency_hz[1:], frequency)

    def _judge_channels(self) -> None:
        """Find the faulty channels of those in use; BenchError where too little is left without them."""
        window, linear, faults = self.window, self.linear, self.faults
        assert self.force_row is not None
        exciter_rows = {row for pair in self.exciter_rows for row in pair}
        rows = sorted({self.force_row, self.drive_row, self.gamma_row, *self.shape_rows, *exciter_rows})
        for row in rows:
            if np.ptp(window.data[row]) == 0.0:
                faults[row] = "is dead: it does not move"
                continue
            if row == self.force_row and self._is_held_to_a_sine:
                continue
            flat = clipping.flat_top(window.data[row], window.samples / self.advance)
            if flat is not None:
                faults[row] = f"is flat-topped at {flat:.4g} {window.channels[row].quantity.unit}"
        noise = self.noise
        names = tuple(channel.name for channel in window.channels)
        history = self.history if self.history.knows(names) else None
        shape = self.amplitudes[:, self.shape_rows, 1]
        sound = [k for k, row in enumerate(self.shape_rows) if row not in faults]
        basis = channel_judge.linear_basis(linear.shape_matrix, linear.target_mode, len(sound) - 1)
        suspects = [k for k in sound if history is not None and self.shape_rows[k] in history.faulty]
        neighbour = None if history is None else history.shape
        near = channel_judge.near_modes(linear, 2.0 * math.pi * float(self.frequency_hz[0]))
        found = channel_judge.off_its_shape(
            shape[0],
            self._shape_std(shape),
            basis,
            neighbour,
            sound,
            suspects,
            linear.shape_matrix[:, near].astype(np.complex128) if near else None,
            None if history is None else channel_judge.shape_trend(history.shapes),
        )
        for index, (words, by_neighbour) in found.off.items():
            of = f"of level {self.history.level_index + 1}" if by_neighbour else "that the linear modes have"
            faults[self.shape_rows[index]] = f"{words}, by the shape {of}"
        metres = self._integrated(
            self.amplitudes[:1, self.shape_rows], self.shape_quantity, 2.0 * np.pi * self.frequency_hz[:1], 0
        )
        course = channel_judge.course_of(metres[0, :, 1], near, linear, 2.0 * math.pi * float(self.frequency_hz[0]))
        if near and not faults:
            doubtful = {self.shape_rows[index]: each for index, each in found.doubtful.items()}
            self._note_doubts(self.history.doubt(doubtful, course), near)
        if history is not None:
            rms = window.data.std(axis=1)
            judged = [row for row in rows if row not in faults]
            faults.update(channel_judge.noise_jumps(noise, rms, history.noise, judged, self._unrepeated))
        drive = self._drive_state()
        # What the exciter is expected to do at resonance holds for the target mode.
        right_mode = other_mode(shape[0], linear) is None
        if history is not None and right_mode and self.force_row not in faults and self.drive_row not in faults:
            suspect = self.force_row in history.faulty
            gain = channel_judge.force_gain(drive, history.drives, linear, suspect)
            if gain is not None:
                faults[self.force_row] = (
                    f"measures {gain:.2f} times what voltage and response say by the levels up to level "
                    f"{history.level_index + 1}: its gain, or that of the amplifier, has changed"
                )
        if not faults:
            if channel_judge.strange_shape(shape[0], linear.shape_matrix):
                raise BenchError(
                    "The shape is not one that the linear modes can have: look at the channels, at the points of the "
                    "linear description, and at which mode was locked."
                )
            self.history.take(names, window.lock.level_index, shape[0], noise, drive, course)
            return
        self.history.faulty = frozenset(faults)
        self._leave_out(history)

    def _note_doubts(self, doubts: Mapping[int, channel_judge.Doubt], near: Sequence[int]) -> None:
        """Put channels that may be off into words, and what follows without their deviation into the uncertainty."""
        if not doubts:
            return
        names = " or ".join(
            f"{self.window.channels[row].name} measures {abs(doubt.ratio):.2f} times" for row, doubt in doubts.items()
        )
        modes = " and ".join(channel_judge.mode_words(self.linear, mode) for mode in near)
        self.doubt_words = (
            f"{names} what the other channels say, or {modes} takes part: {len(self.shape_rows)} points do not tell "
            "which, and nothing is left out. Look at the gain, or measure at more points."
        )
        for row, doubt in doubts.items():
            other = self.amplitudes[:, self.shape_rows, 1].copy()
            other[:, self.shape_rows.index(row)] /= doubt.ratio
            self.other_shapes.append(other)

    def _unrepeated(self, row: int) -> float:
        orders = np.arange(self.harmonics + 1)
        residual = np.concatenate(
            [
                self.window.data[row, first:end]
                - (amplitudes[row] @ np.exp(2j * np.pi * np.outer(orders, self.cycles[first:end]))).real
                for first, end, amplitudes in zip(
                    self.part_bounds[:-1], self.part_bounds[1:], self.part_amplitudes, strict=True
                )
            ]
        )
        return channel_judge.unrepeated_rms(residual, self.window.samples / self.advance)

    def _drive_state(self) -> channel_judge.DriveState:
        omega = 2.0 * np.pi * self.frequency_hz
        assert self.force_row is not None
        force = self.amplitudes[:, self.force_row]
        position = self._integrated(self.amplitudes[:, self.drive_row], self.drive_quantity, omega, 0)
        velocity = 1j * np.multiply.outer(omega, np.arange(force.shape[1])) * position
        voltages = [row for row, channel in enumerate(self.window.channels) if channel.quantity is Quantity.VOLTAGE]
        voltage = complex(self.amplitudes[0, voltages[0], 1]) if len(voltages) == 1 else complex(math.nan)
        return channel_judge.DriveState(
            float(omega[0]), voltage, force[0], velocity[0], self._shape_std(force), self._shape_std(velocity),
            self.window.lock.level_index in self.history.driven,
        )  # fmt: skip

    @property
    def _is_held_to_a_sine(self) -> bool:
        """Whether the force is controlled to be a sine, and is: what could be cut off of it is less than its harmonics.

        The little that harmonics beyond the controlled ones make of its crest may look like a cut.
        """
        if self.window.lock.level_index not in self.history.driven:
            return False
        size = np.abs(self.amplitudes[0, self.force_row])
        return bool(np.linalg.norm(size[2:]) < _SINE * size[1])

    def _leave_out(self, history: ChannelHistory | None) -> None:
        """Put the shape of the level before in the place of faulty channels; BenchError where that cannot be done."""
        linear = self.linear
        if self.force_row in self.faults:
            raise BenchError(f"The force is not measured: {self.fault_words}")
        if any(row in self.faults for pair in self.exciter_rows for row in pair):
            raise BenchError(f"Force or response of an exciter is not measured: {self.fault_words}")
        self._find_drive_rows()
        gone = [k for k, row in enumerate(self.shape_rows) if row in self.faults]
        kept = [k for k in range(len(self.shape_rows)) if k not in gone]
        if gone and (history is None or len(kept) < 2 or self.settings.power_balance):
            raise BenchError(f"A channel is faulty, and no level without it says what it should be: {self.fault_words}")
        if not gone or history is None:
            return
        shape = self.amplitudes[:, self.shape_rows, 1]
        neighbour = history.shape[:, np.newaxis]
        filled = channel_judge.predicted(neighbour, shape, kept)
        # As badly as the others predict one of the channels that are left, they may predict the one that is not.
        others = [[other for other in kept if other != k] for k in kept]
        guesses = [channel_judge.predicted(neighbour, shape[0], rest)[k] for k, rest in zip(kept, others, strict=True)]
        misfit = float(np.abs(shape[0, kept] - guesses).max())
        away = filled * (1.0 + misfit / np.maximum(np.abs(filled), 1e-300))
        modes = channel_judge.linear_basis(linear.shape_matrix, linear.target_mode, len(kept))
        for guess in (away, channel_judge.predicted(modes, shape, kept)):
            other = shape.copy()
            other[:, gone] = guess[:, gone]
            self.other_shapes.append(other)
        rows = [self.shape_rows[k] for k in gone]
        self.amplitudes[:, rows] = complex(math.nan, math.nan)
        self.amplitudes[:, rows, 1] = filled[:, gone]

    @property
    def fault_words(self) -> str:
        """What is wrong with which channel, one sentence."""
        return "; ".join(f"{self.window.channels[row].name} {why}" for row, why in sorted(self.faults.items())) + "."

    def _shape_std(self, shape: ComplexArray) -> FloatArray:
        """Standard uncertainty of the magnitudes of a shape, from the sets without one sub-window."""
        if not self.parts:
            return np.full(shape.shape[1], math.nan)
        away = np.abs(shape[1:] - shape[1:].mean(axis=0)) ** 2
        return np.asarray(np.sqrt((self.parts - 1) / self.parts * away.sum(axis=0)))

    def _values(self, omega: FloatArray, shape: ComplexArray) -> ModalQuantities:
        values = self._first_exciter(omega, shape)
        if not self.exciter_rows:
            return values
        forces, motions = zip(*self.exciter_rows[1:], strict=True)
        orders = np.arange(1, self.harmonics + 1)
        motion = self._integrated(self.amplitudes[:, list(motions)], self.shape_quantity, omega, 0)
        return replace(
            values,
            further_force=self.amplitudes[:, list(forces), 1:],
            further_velocity=1j * orders * omega[:, None, None] * motion[:, :, 1:],
        )

    def _first_exciter(self, omega: FloatArray, shape: ComplexArray) -> ModalQuantities:
        return modal_quantities(
            omega,
            self.amplitudes[:, self.force_row],
            self._integrated(self.amplitudes[:, self.drive_row], self.drive_quantity, omega, 0),
            self._integrated(self.amplitudes[:, self.gamma_row], self.gamma_quantity, omega, 2),
            shape,
            self.linear.shape_matrix,
            self.linear.target_mode,
        )

    def point(self) -> ModalPoint:
        linear = self.linear
        omega = 2.0 * np.pi * self.frequency_hz
        force = self.amplitudes[:, self.force_row]
        shape = self._integrated(self.amplitudes[:, self.shape_rows], self.shape_quantity, omega, 0)
        values = self._values(omega, shape[:, :, 1])
        measured = {name: getattr(values, name) for name in EVALUATED}
        if self.settings.hysteresis is not None and not self.faults:
            measured["hysteresis_damping"] = self._hysteresis(self.settings.hysteresis, omega, force)
        fields = {name: float(value[0]) for name, value in measured.items()}
        fields.update({f"{name}_std": self._uncertainty(name, value) for name, value in measured.items()})
        for other in self.other_shapes:
            changed = self._values(omega, other * (1j * omega[:, np.newaxis]) ** -MOTIONS[self.shape_quantity])
            for name in EVALUATED:
                change = float(getattr(changed, name)[0]) - fields[name]
                fields[f"{name}_std"] = math.hypot(fields[f"{name}_std"], change)
        fields["frequency_hz"] = float(self.frequency_hz[0])
        fields["frequency_hz_std"] = self.frequency_std
        fields["omega_rad_s"] = float(omega[0])
        if self.self_excited:  # the force may work either way: its phase counts from the line of the velocity
            fields["phase_error"] = math.remainder(fields["phase_error"], math.pi)
        fields["omega_rad_s_std"] = math.hypot(
            2.0 * math.pi * self.frequency_std,
            fields["damping_ratio"] * omega[0] * math.hypot(fields["phase_error"], fields["phase_error_std"]),
        )
        remarks = self._remarks(omega, fields)
        refusals = [remark.sentence for remark in remarks if remark.rejects]
        if refusals:
            raise BenchError(" ".join(refusals))
        self._widen(fields, remarks, omega)
        told = window_judge.words_of([remark for remark in remarks if remark.sentence], fields)
        left_out = f"Left out: {self.fault_words}" if self.faults else ""
        if self.settings.power_balance:
            fields.update(vars(self._balance()))
        # Harmonic n turns by n times the angle that makes the target mode's participation real.
        reference = values.participation[0, linear.target_mode]
        turn = np.conj(reference) / abs(reference) if abs(reference) > 0.0 else 1.0 + 0.0j
        turns = turn ** np.arange(self.harmonics + 1)
        lock, window = self.window.lock, self.window
        return ModalPoint(
            level_index=lock.level_index,
            status=Status.OK,
            reason=" ".join(
                filter(None, (left_out, self.doubt_words, mode_sentence(values.shape[0], linear, omega[0]), told))
            ),
            level=lock.level,
            level_unit=lock.level_unit,
            time_ns=bench_time_ns(lock.window_end - 1, window.sample_rate),
            window_first_sample=lock.window_first_sample,
            window_samples=lock.window_samples,
            window_periods=self.periods,
            harmonics=self.harmonics,
            points=linear.points,
            force_harmonics=force[0] * turns,
            shape_harmonics=(shape[0] * turns).T,
            normalised_shape=values.normalised_shape[0] * turn,
            participation=values.participation[0] * turn,
            harmonics_control=self.history.driven.get(lock.level_index, 0),
            response_order=0,
            force_order=0,
            exciter_points=linear.exciter_points if self.exciter_rows else (),
            exciter_forces=np.array([self.amplitudes[0, row] * turns for row, _ in self.exciter_rows]).ravel(),
            **fields,
        )

    def _remarks(self, omega: FloatArray, fields: dict[str, float]) -> list[Remark]:
        """What is found of the window as a whole, with what it adds to the uncertainties."""
        window, rate = self.window, self.window.sample_rate
        assert self.force_row is not None
        drive = self._integrated(self.amplitudes[:, self.drive_row], self.drive_quantity, omega, 0)
        velocity = 1j * omega[0] * np.arange(drive.shape[1]) * drive[0]
        force = self.amplitudes[0, self.force_row]
        remarks = [] if self.self_excited else window_judge.judge_phase(fields)
        remarks += window_judge.judge_harmonics(fields, force, velocity, self.amplitudes[0, self.drive_row])
        remarks += self._drift_remarks(omega, fields)
        if self.parts:
            parts = self.part_amplitudes[:, [self.force_row, self.drive_row], 1]
            middle: FloatArray = np.asarray(
                0.5 * (self.part_bounds[1:] + self.part_bounds[:-1]) / rate, dtype=np.float64
            )
            turned = parts[:, 1] * (1j * omega[0]) ** (1 - MOTIONS[self.drive_quantity])
            if not self.settings.power_balance:
                seconds = window.samples / rate
                remarks += window_judge.judge_steadiness(
                    middle, parts[:, 0], turned, fields, seconds, of_damping=not self.self_excited
                )
            remarks += self._burst_remarks(omega, fields)
        return remarks

    def _drift_remarks(self, omega: FloatArray, fields: dict[str, float]) -> list[Remark]:
        if self.other_amplitudes is None:
            return []
        own = self.amplitudes
        self.amplitudes = self.other_amplitudes
        shape = self._integrated(self.amplitudes[:, self.shape_rows], self.shape_quantity, omega, 0)
        other = self._values(omega, shape[:, :, 1])
        self.amplitudes = own
        channels = self.window.channels
        names = ", ".join(
            f"{channels[row].name} drifts by {height:.2g} {channels[row].quantity.unit}"
            for row, height in self.drifted.items()
        )
        order = window_judge.drift_orders(self.periods)[0]
        return [
            Remark(
                f"{names} over the window; a polynomial of order {order} was taken out. Let the sensor warm up, "
                "or couple it over a high-pass that all channels share.",
                {name: abs(float(getattr(other, name)[0]) - fields[name]) for name in EVALUATED},
            )
        ]

    def _burst_remarks(self, omega: FloatArray, fields: dict[str, float]) -> list[Remark]:
        """Parts of the window in which a channel departs from its harmonics."""
        assert self.force_row is not None
        window, bounds = self.window, self.part_bounds
        residuals = window_judge.part_residuals(
            window.data, self.part_moments.projections, self.part_amplitudes, bounds
        )
        remarks = []
        for row in sorted({self.force_row, self.drive_row, *self.shape_rows} - set(self.faults)):
            part = window_judge.burst_part(residuals[:, row], float(window.data[row].std()))
            if part is None:
                continue
            first, end = int(bounds[part]), int(bounds[part + 1])
            orders = np.arange(self.harmonics + 1)
            others = np.delete(self.part_amplitudes[:, row], part, axis=0).mean(axis=0)
            model = (others @ np.exp(2j * np.pi * np.outer(orders, self.cycles[first:end]))).real
            begin, stop = window_judge.burst_span(window.data[row, first:end] - model)
            shape = self._integrated(self.amplitudes[:, self.shape_rows], self.shape_quantity, omega, 0)
            without = self._values(omega, shape[:, :, 1])
            remarks.append(
                Remark(
                    f"{window.channels[row].name} departs from its periodic course between "
                    f"{self._second(first + begin):.6g} and {self._second(first + stop):.6g} s (drop-out, hit or "
                    "step); choose a window beside it.",
                    {name: abs(float(getattr(without, name)[1 + part]) - fields[name]) for name in EVALUATED},
                )
            )
        return remarks

    def _widen(self, fields: dict[str, float], remarks: list[Remark], omega: FloatArray) -> None:
        """Put the parts of the remarks into the standard uncertainties, and none below the resolution."""
        for remark in remarks:
            for name, part in remark.parts.items():
                if part > 0.0 and math.isfinite(part):
                    own = fields[f"{name}_std"]
                    fields[f"{name}_std"] = math.hypot(own, part) if math.isfinite(own) else part
        assert self.force_row is not None
        places = window_judge.places_of_period(self.cycles)
        sound = [row for row in self.shape_rows if row not in self.faults]
        least = {
            row: window_judge.resolution_floor(self.window.data[row], places, float(self.noise[row]))
            for row in {self.force_row, self.drive_row, *sound}
        }
        size = np.abs(self.amplitudes[0, :, 1])
        shape = math.hypot(*(least[row] for row in sound)) / math.hypot(*size[sound])
        force, drive = (least[row] / float(size[row]) for row in (self.force_row, self.drive_row))
        bounds = window_judge.floors(force, drive, shape, fields, self.periods, self.fitted)
        for name, floor in bounds.items():
            if fields[f"{name}_std"] < floor:
                fields[f"{name}_std"] = floor

    def _balance(self) -> BalancedMode:
        """Balance of power over parts of the window."""
        window, linear = self.window, self.linear
        bounds = whole_period_bounds(self.cycles, self.periods, max(1, part_count(self.periods)))
        edges = np.append(self.cycles, self.cycles[0] + self.advance)[bounds]
        omega: FloatArray = np.asarray(
            2.0 * np.pi * np.diff(edges) / (np.diff(bounds) / window.sample_rate), dtype=np.float64
        )
        # A low order is enough for the fundamental of a few periods and costs less noise.
        moments = segment_moments(self.cycles, window.data, min(3, self.harmonics), bounds)
        amplitudes = solve_moments(moments)
        force = amplitudes[:, self.force_row]
        drive = self._integrated(amplitudes[:, self.drive_row], self.drive_quantity, omega, 0)
        shape = self._integrated(amplitudes[:, self.shape_rows], self.shape_quantity, omega, 0)[:, :, 1]
        values = modal_quantities(omega, force, drive, drive, shape, linear.shape_matrix, linear.target_mode)
        return balance(
            np.asarray(0.5 * (bounds[1:] + bounds[:-1]) / window.sample_rate, dtype=np.float64),
            window.samples / window.sample_rate,
            omega,
            values.modal_amplitude,
            values.active_power,
            np.asarray((force[:, 1] * drive[:, 1].conj()).real, dtype=np.float64),
            np.unwrap(np.angle(drive[:, 1])),
        )

    def _uncertainty(self, name: str, value: FloatArray) -> float:
        if not self.parts:
            return math.nan
        if name == "phase_error":
            return jackknife(np.angle(np.exp(1j * (value[1:] - value[0]))), 0.0)
        return jackknife(value[1:], float(value[0]))

    @staticmethod
    def _integrated(amplitudes: ComplexArray, quantity: Quantity, omega: FloatArray, derivative: int) -> ComplexArray:
        """The ``derivative``-th time derivative of the displacement; n = 0 is NaN where unknown."""
        power = derivative - MOTIONS[quantity]
        if power == 0:
            return amplitudes
        orders = np.arange(amplitudes.shape[-1])
        factor = 1j * np.multiply.outer(omega, orders)
        if amplitudes.ndim == 3:
            factor = factor[:, np.newaxis, :]
        result = np.empty_like(amplitudes)
        result[..., 1:] = amplitudes[..., 1:] * factor[..., 1:] ** power
        result[..., 0] = 0.0 if power > 0 else complex(math.nan, math.nan)
        return result

    def _hysteresis(self, layout: HysteresisLayout, omega: FloatArray, force: ComplexArray) -> FloatArray:
        accelerations = []
        for point in (layout.excited_point, layout.middle_point, layout.free_point):
            for quantity in (Quantity.ACCELERATION, Quantity.VELOCITY, Quantity.DISPLACEMENT):
                row = self._row(quantity, point)
                if row is not None:
                    accelerations.append(self._integrated(self.amplitudes[:, row], quantity, omega, 2))
                    break
            else:
                raise BenchError(f"No response is measured at point {point}, which the hysteresis layout names.")
        first, middle, free = accelerations
        return np.array(
            [
                hysteresis_loop(layout, float(omega[k]), (first[k], middle[k], free[k]), force[k]).damping_ratio
                for k in range(omega.shape[0])
            ]
        )


def _energy(values: ComplexArray) -> FloatArray:
    """Σ |x|² over the last axis."""
    return np.asarray((values.real**2 + values.imag**2).sum(axis=-1), dtype=np.float64)
