"""A window of periodic motion on its way to a modal point: harmonics, judgement, quantities, point."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ANGLES, EVALUATED, ModalPoint
from nmt_core.messages.secondary_resonance import resonance_of
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, PointStatus, TestKind
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.judgement import signal_faults, window_judge
from nmt_extract.judgement.channel_history import ChannelHistory
from nmt_extract.judgement.uncertainty import jackknife
from nmt_extract.judgement.window_judge import Remark
from nmt_extract.modal.channel_findings import ChannelFindings
from nmt_extract.modal.channels import WindowRows, derived, row_of
from nmt_extract.modal.evaluated_window import resonance_std
from nmt_extract.modal.floquet_exponents import floquet_exponents
from nmt_extract.modal.hysteresis import HysteresisLayout, hysteresis_loop
from nmt_extract.modal.mode_identity import mode_sentence
from nmt_extract.modal.periodic_motion import PeriodicMotion
from nmt_extract.modal.power_balance import BalancedMode, balance, part_count
from nmt_extract.modal.quantities import ModalQuantities, modal_quantities
from nmt_extract.modal.secondary_quantities import secondary_quantities
from nmt_extract.modal.window import Window
from nmt_signals.harmonics import segment_moments, solve_moments, whole_period_bounds


class WindowEvaluation:
    """One window; set 0 is the whole window, set k lacks sub-window k.

    Args:
        window: of a motion that repeats: phase resonance with one exciter or several, a secondary resonance, a level
            of a self-excited structure that is held.
        linear: linear modes.
        settings: of the extraction.
        history: levels before.

    Raises:
        BenchError: the window cannot be evaluated.
    """

    def __init__(
        self, window: Window, linear: LinearDescription, settings: ExtractionSettings, history: ChannelHistory
    ) -> None:
        self.linear, self.settings, self.history = linear, settings, history
        lock = window.lock
        self.resonance = resonance_of(lock.response_order, lock.force_order) if lock.force_order else None
        self.self_excited = lock.test is TestKind.SELF_EXCITED
        self.on_curve = kind_class(lock.test).is_curve
        orders = self.resonance[:2] if self.resonance else (1, 1)
        self.data = window.data
        self.motion = PeriodicMotion(window, WindowRows.of(window, linear), settings, orders)
        self.channels = ChannelFindings(self.motion, linear, history)
        self.rows = self.channels.rows
        self.order = orders[0]

    def displacements(self, amplitudes: ComplexArray) -> ComplexArray:
        """At the points of the modes, m, shape ``(sets, points, H + 1)``."""
        rows = self.rows
        return derived(amplitudes[:, list(rows.shape)], rows.shape_quantity, self.motion.omega, 0)

    def values(self, amplitudes: ComplexArray, shape: ComplexArray | None = None) -> ModalQuantities:
        """Quantities of harmonics.

        Args:
            amplitudes: of all channels, shape ``(sets, channels, H + 1)``.
            shape: of the resonant order, m, shape ``(sets, points)``; None = as it was measured.
        """
        rows, linear, omega = self.rows, self.linear, self.motion.omega
        force = amplitudes[:, list(rows.forces)]
        pairs = zip(rows.motions, rows.motion_quantities, strict=True)
        drive = np.stack([derived(amplitudes[:, row], quantity, omega, 0) for row, quantity in pairs], axis=1)
        gamma = derived(amplitudes[:, rows.gamma], rows.gamma_quantity, omega, 2)
        shapes = self.displacements(amplitudes)
        if self.resonance is not None:
            shapes = shapes if shape is None else _with_order(shapes, shape, self.order)
            return secondary_quantities(
                self.resonance, omega, force, drive, gamma, shapes, linear.shape_matrix, linear.target_mode
            )
        shape = shapes[:, :, 1] if shape is None else shape
        found = modal_quantities(omega, force, drive, gamma, shape, linear.shape_matrix, linear.target_mode)
        if self.self_excited:  # the force may work either way: its phase counts from the line of the velocity
            vars(found)["phase_error"] = found.phase_error - np.pi * np.rint(found.phase_error / np.pi)
        return found

    def change(self, other: ModalQuantities, fields: dict[str, float], place: int = 0) -> dict[str, float]:
        """By how much other quantities differ from the point's, by name."""
        away = {name: float(getattr(other, name)[place]) - fields[name] for name in EVALUATED}
        turn = math.pi if self.self_excited else 2.0 * math.pi
        away["phase_error"] = math.remainder(away["phase_error"], turn)
        return {name: abs(value) for name, value in away.items()}

    def point(self) -> ModalPoint:
        """The point.

        Raises:
            BenchError: nothing of the window can be used.
        """
        motion, linear, rows, channels = self.motion, self.linear, self.rows, self.channels
        omega = self.order * motion.omega
        values = self.values(motion.amplitudes)
        shape = self.displacements(motion.amplitudes)
        force = motion.amplitudes[:, rows.force]
        measured = {name: getattr(values, name) for name in EVALUATED}
        if self.settings.hysteresis is not None and not channels.faults and self.resonance is None:
            measured["hysteresis_damping"] = self._hysteresis(self.settings.hysteresis, force)
        fields = {name: float(value[0]) for name, value in measured.items()}
        fields.update({f"{name}_std": self._uncertainty(name, value) for name, value in measured.items()})
        for other in channels.other_shapes:
            metres = other * (1j * omega[:, np.newaxis]) ** -MOTIONS[rows.shape_quantity]
            for name, change in self.change(self.values(motion.amplitudes, metres), fields).items():
                fields[f"{name}_std"] = math.hypot(fields[f"{name}_std"], change)
        for amplitudes in channels.other_amplitudes:
            for name, change in self.change(self.values(amplitudes), fields).items():
                fields[f"{name}_std"] = math.hypot(fields[f"{name}_std"], change)
        fields["omega_rad_s"] = float(omega[0])
        fields["frequency_hz"] = self.order * float(motion.frequency_hz[0])
        off_resonance = 0.0 if self.on_curve else math.hypot(fields["phase_error"], fields["phase_error_std"])
        excitation = 2.0 * math.pi * self.order * motion.frequency_std
        fields["omega_rad_s_std"] = resonance_std(excitation, fields["damping_ratio"] * float(omega[0]), off_resonance)
        remarks = self._remarks(fields)
        refusals = [remark.sentence for remark in remarks if remark.rejects]
        if refusals:
            raise BenchError(" ".join(refusals))
        least = least_uncertainties(self, fields)
        window_judge.add_parts(fields, remarks)
        window_judge.not_below(fields, least)
        exponents, doubt = self._floquet()
        sentences = (
            doubt,
            f"Left out: {channels.fault_words}" if channels.faults else "",
            channels.gain or channels.doubt,
            mode_sentence(values.shape[0], linear, float(omega[0])),
            window_judge.words_of([remark for remark in remarks if remark.sentence], fields),
        )
        if self.settings.power_balance and self.resonance is None:
            fields.update(vars(self._balance()))
            fields["frequency_hz"] = fields["omega_rad_s"] / (2.0 * math.pi)
            window_judge.add_parts(fields, [remark for remark in remarks if remark.of_channel])
            # Both are parts of one complex number: what resolution leaves open of one it leaves open of the other.
            least["omega_rad_s"] = max(least["omega_rad_s"], least["damping_ratio"] * float(omega[0]))
            window_judge.not_below(fields, least)
        fields["frequency_hz_std"] = fields["omega_rad_s_std"] / (2.0 * math.pi)
        # Harmonic n turns by n times the angle that makes the target mode's participation real in its order.
        reference = values.participation[0, linear.target_mode]
        turn = np.conj(reference) / abs(reference) if abs(reference) > 0.0 else 1.0 + 0.0j
        base = turn if self.order == 1 else np.exp(-1j * np.angle(reference) / self.order)
        turns = base ** np.arange(motion.harmonics + 1)
        lock = motion.window.lock
        several = rows.forces if len(rows.forces) > 1 else ()
        return ModalPoint(
            level_index=lock.level_index,
            status=PointStatus.OK,
            reason=" ".join(filter(None, sentences)),
            level=lock.level,
            level_unit=lock.level_unit,
            time_ns=bench_time_ns(lock.window_end - 1, motion.window.sample_rate),
            window_first_sample=lock.window_first_sample,
            window_samples=lock.window_samples,
            window_periods=motion.orders[1] * motion.periods,
            harmonics=motion.harmonics,
            points=linear.points,
            force_harmonics=force[0] * turns,
            shape_harmonics=(shape[0] * turns).T,
            normalised_shape=values.normalised_shape[0] * turn,
            participation=values.participation[0] * turn,
            harmonics_control=self.history.driven.get(lock.level_index, 0),
            response_order=lock.response_order if self.resonance else 0,
            force_order=lock.force_order,
            held_phase=lock.held_phase,
            parameter=lock.parameter,
            **exponents,
            exciter_points=linear.exciter_points if several else (),
            exciter_forces=np.array([motion.amplitudes[0, row] * turns for row in several]).ravel(),
            **fields,
        )

    def _remarks(self, fields: dict[str, float]) -> list[Remark]:
        """What is found of the window as a whole, with what it adds to the uncertainties."""
        motion, rows = self.motion, self.rows
        remarks: list[Remark] = []
        if self.resonance is not None:
            remarks += window_judge.judge_resonant_phase(fields)
        else:
            drive = derived(motion.amplitudes[:, rows.drive], rows.motion_quantities[0], motion.omega, 0)
            velocity = 1j * motion.omega[0] * np.arange(drive.shape[1]) * drive[0]
            if self.on_curve:
                remarks += window_judge.judge_held_phase(fields, motion.window.lock.held_phase)
                remarks.append(self._settling(fields))
            elif not self.self_excited:
                remarks += window_judge.judge_phase(fields)
            remarks += window_judge.judge_harmonics(
                fields, motion.amplitudes[0, rows.force], velocity, motion.amplitudes[0, rows.drive]
            )
        steady = self._steadiness(fields) if motion.parts and not self.settings.power_balance else []
        moving = any(remark.moving for remark in (*remarks, *steady))
        remarks += remarks_on_drift(self, fields, moving)
        remarks += steady
        remarks += remarks_on_bursts(self, fields) if motion.parts else []
        return remarks

    def _steadiness(self, fields: dict[str, float]) -> list[Remark]:
        motion, rows, (k, nu) = self.motion, self.rows, self.motion.orders
        rate = motion.window.sample_rate
        bounds = motion.part_bounds
        middle: FloatArray = np.asarray(0.5 * (bounds[1:] + bounds[:-1]) / rate, dtype=np.float64)
        power = 1 - MOTIONS[rows.motion_quantities[0]]
        velocity = motion.part_amplitudes[:, rows.drive, k] * (1j * k * motion.omega[0]) ** power
        force = motion.part_amplitudes[:, rows.force, nu]
        if k > 1 or nu > 1:  # the phase between the two orders, for the signs of two harmonics of the same order
            force, velocity = force**k, np.abs(velocity) * np.exp(1j * nu * np.angle(velocity))
        return window_judge.judge_steadiness(
            middle, force, velocity, fields, motion.window.samples / rate, of_damping=not self.self_excited
        )

    def _settling(self, fields: dict[str, float]) -> Remark:
        """What a point of a response curve still has to go, by its halves."""
        motion = self.motion
        middle, rate = motion.cycles.size // 2, motion.window.sample_rate
        halves = np.diff([motion.cycles[0], motion.cycles[middle], motion.cycles[0] + motion.advance])
        lengths = np.array([middle, motion.cycles.size - middle]) / rate
        turning = 2.0 * np.pi * halves / lengths
        sizes = np.abs(motion.part_amplitudes[:, self.rows.drive, 1]) if motion.parts else np.ones(2)
        growth = math.log(sizes[-1] / sizes[0]) * sizes.size / (sizes.size - 1) / lengths.sum()
        return window_judge.settling_part(fields, growth, float(turning[1] - turning[0]) / (0.5 * lengths.sum()))

    def _floquet(self) -> tuple[dict[str, float], str]:
        """Exponents of an orbit whose drive was perturbed, or why there are none."""
        motion, rows = self.motion, self.rows
        if not motion.window.lock.perturbation > 0.0:
            return {}, ""
        force, drive = self.data[rows.force], self.data[rows.drive]
        duration = motion.window.samples / motion.window.sample_rate
        try:
            found = floquet_exponents(force, drive, motion.cycles, motion.advance, duration)
        except BenchError as error:
            return {}, str(error)
        return found.fields, ""

    def _balance(self) -> BalancedMode:
        """Balance of power over parts of the window."""
        motion, linear, rows = self.motion, self.linear, self.rows
        window = motion.window
        bounds = whole_period_bounds(motion.cycles, motion.periods, max(1, part_count(motion.periods)))
        edges = np.append(motion.cycles, motion.cycles[0] + motion.advance)[bounds]
        omega: FloatArray = np.asarray(
            2.0 * np.pi * np.diff(edges) / (np.diff(bounds) / window.sample_rate), dtype=np.float64
        )
        # A low order is enough for the fundamental of a few periods and costs less noise.
        moments = segment_moments(motion.cycles, window.data, min(3, motion.harmonics), bounds)
        amplitudes = solve_moments(moments)
        force = amplitudes[:, list(rows.forces)]
        pairs = list(zip(rows.motions, rows.motion_quantities, strict=True))
        drive = np.stack([derived(amplitudes[:, row], quantity, omega, 0) for row, quantity in pairs], axis=1)
        shape = derived(amplitudes[:, list(rows.shape)], rows.shape_quantity, omega, 0)[:, :, 1]
        values = modal_quantities(omega, force, drive, drive[:, 0], shape, linear.shape_matrix, linear.target_mode)
        return balance(
            np.asarray(0.5 * (bounds[1:] + bounds[:-1]) / window.sample_rate, dtype=np.float64),
            window.samples / window.sample_rate,
            omega,
            values.modal_amplitude,
            values.active_power,
            np.asarray((force[:, :, 1] * drive[:, :, 1].conj()).real.sum(axis=1), dtype=np.float64),
            np.unwrap(np.angle(drive[:, 0, 1])),
        )

    def _uncertainty(self, name: str, value: FloatArray) -> float:
        if not self.motion.parts:
            return math.nan
        if name in ANGLES:
            return jackknife(np.angle(np.exp(1j * (value[1:] - value[0]))), 0.0)
        return jackknife(value[1:], float(value[0]))

    def _hysteresis(self, layout: HysteresisLayout, force: ComplexArray) -> FloatArray:
        motion, omega = self.motion, self.motion.omega
        accelerations = []
        for point in (layout.excited_point, layout.middle_point, layout.free_point):
            for quantity in reversed(MOTIONS):
                row = row_of(motion.window, quantity, point)
                if row is not None:
                    accelerations.append(derived(motion.amplitudes[:, row], quantity, omega, 2))
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


def _with_order(shapes: ComplexArray, shape: ComplexArray, order: int) -> ComplexArray:
    """Displacements with another shape of one order."""
    changed = shapes.copy()
    changed[:, :, order] = shape
    return changed


def remarks_on_drift(evaluation: WindowEvaluation, fields: dict[str, float], moving: bool) -> list[Remark]:
    """Channels whose mean moves over the window.

    Args:
        evaluation: of the window.
        fields: values of the point by name.
        moving: whether level or frequency move as well: then the mean of a nonlinear motion moves with them.
    """
    motion = evaluation.motion
    if motion.other_amplitudes is None:
        return []
    channels = motion.window.channels
    names = ", ".join(
        f"{channels[row].name} drifts by {height:.2g} {channels[row].unit}" for row, height in motion.drifted.items()
    )
    order = signal_faults.drift_orders(motion.periods)[0]
    what = (
        "Level or frequency of the loop still move, and the mean of the motion too; wait longer before the window."
        if moving
        else "Let the sensor warm up, or couple it over a high-pass that all channels share."
    )
    return [
        Remark(
            f"{names} over the window; a polynomial of order {order} was taken out. {what}",
            evaluation.change(evaluation.values(motion.other_amplitudes), fields),
            of_channel=True,
        )
    ]


def remarks_on_bursts(evaluation: WindowEvaluation, fields: dict[str, float]) -> list[Remark]:
    """Parts of the window in which a channel departs from its harmonics."""
    motion, bounds = evaluation.motion, evaluation.motion.part_bounds
    window = motion.window
    residuals = window_judge.part_residuals(
        window.data, motion.part_moments.projections, motion.part_amplitudes, bounds
    )
    rows = evaluation.rows
    remarks = []
    for row in sorted({*rows.forces, *rows.motions, *rows.shape} - set(evaluation.channels.faults)):
        part = window_judge.burst_part(residuals[:, row], float(window.data[row].std()))
        if part is None:
            continue
        first, end = int(bounds[part]), int(bounds[part + 1])
        others = np.delete(motion.part_amplitudes[:, row], part, axis=0).mean(axis=0)
        begin, stop = window_judge.burst_span(window.data[row, first:end] - motion.model(others, first, end))
        remarks.append(
            Remark(
                f"{window.channels[row].name} departs from its periodic course between "
                f"{motion.second(first + begin):.6g} and {motion.second(first + stop):.6g} s (drop-out, hit or "
                "step); choose a window next to it.",
                evaluation.change(evaluation.values(motion.amplitudes), fields, 1 + part),
                of_channel=True,
            )
        )
    return remarks


def least_uncertainties(evaluation: WindowEvaluation, fields: dict[str, float]) -> dict[str, float]:
    """What the resolution of the channels leaves open, by quantity of the point."""
    motion, rows, data = evaluation.motion, evaluation.rows, evaluation.motion.window.data
    places = signal_faults.places_of_period(motion.cycles)
    sound = [row for row in rows.shape if row not in evaluation.channels.faults]
    least = {
        row: signal_faults.resolution_floor(data[row], places, float(motion.noise[row]))
        for row in {rows.force, rows.drive, *sound}
    }
    shape = math.hypot(*(least[row] for row in sound)) / math.hypot(*motion.size_of(sound))
    force, drive = (least[row] / float(motion.size_of([row])[0]) for row in (rows.force, rows.drive))
    return signal_faults.floors(force, drive, shape, fields, motion.periods, motion.fitted)
