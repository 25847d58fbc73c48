"""Linear modal test with several exciters that are driven by uncorrelated noise at once.

Frequency responses are the least-squares solution over averaged spectra, H = S_xf S_ff⁻¹ (Bendat and Piersol), with
the partial coherence of every response and input. Modes are fitted to the whole record without window, so that leakage
does not widen close resonances: with the forces as inputs,

    X_i = Σ_j H_ij F_j + T_i,   H_ij = Σ_k R_ijk / D_k + U_ij − L_ij / Ω²,   D_k = ω_k² − Ω² + 2 i ζ_k ω_k Ω,

where T_i = Σ_k (a_ik + i Ω b_ik) / D_k + c_i + d_i Ω is what the motion before and after the record leaves. For given
poles all else is linear; the poles are found by least squares on what the linear rest cannot explain. Residues of a
mode have rank one, R_ijk = φ_ik φ_jk, which scales the shapes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_extract.stabilisation import order_poles, stable_poles
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Signals, read_signals, segments
from nmt_signals.frequency_responses import AveragedSpectra, averaged_spectra

SEGMENTS = 10
"""Segments without overlap into which the record is cut for the averages."""
WIDTH = 0.15
"""Half width of the band of the fit, of the target's frequency."""
_APART = 0.01  # of the frequency, half the distance at which one pole begins as several
_MOST_ROWS = 400  # lines of force per volt that a description keeps


@dataclass(frozen=True, eq=False)
class InputModes:
    """Modes at a band of lines.

    Attributes:
        frequencies_hz, damping_ratios: of the modes, ascending, shape ``(modes,)``.
        frequency_stds, damping_stds: their standard uncertainties.
        residues: R_ijk of displacements, shape ``(outputs, inputs, modes)``; complex ones at their pole.
        misfit: rms of what is not explained over the rms of each output.
    """

    frequencies_hz: FloatArray
    damping_ratios: FloatArray
    frequency_stds: FloatArray
    damping_stds: FloatArray
    residues: ComplexArray
    misfit: FloatArray


@dataclass(frozen=True, eq=False)
class SeveralInputsTest:
    """Result of the test.

    Attributes:
        exciter_points, points: of the inputs and of the responses.
        frequency_hz: lines of the averaged responses, shape ``(lines,)``.
        accelerance: H of accelerations, m/s²/N, shape ``(points, exciters, lines)``.
        coherence: partial coherence of response and input, the other inputs removed, same shape.
        force_per_volt: N/V, shape ``(lines, exciters, exciters)``.
        modes: of the structure, by the forces.
        shapes: mass-normalised, 1/√kg, shape ``(points, modes)``.
        plant: of structure and exciters, by the voltages.
        target: index of the target mode.
        displacement_per_volt: of the first exciter's point by every voltage at the target's frequency, m/V.
    """

    exciter_points: tuple[int, ...]
    points: tuple[int, ...]
    frequency_hz: FloatArray
    accelerance: ComplexArray
    coherence: FloatArray
    force_per_volt: ComplexArray
    modes: InputModes
    shapes: FloatArray
    plant: InputModes
    target: int
    displacement_per_volt: ComplexArray

    def description(self, moving_mass_kg: float = 0.0) -> LinearDescription:
        """What loop and extraction need.

        Args:
            moving_mass_kg: of the first exciter.
        """
        drive = self.points.index(self.exciter_points[0])
        frequency = self.modes.frequencies_hz[self.target]
        nearest = int(np.argmin(np.abs(self.plant.frequencies_hz - frequency)))
        step = max(1, self.frequency_hz.size // _MOST_ROWS)
        near = np.abs(self.frequency_hz / frequency - 1.0) < 0.1
        kept = np.flatnonzero(near | (np.arange(self.frequency_hz.size) % step == 0))
        rows = []
        for line in kept:
            parts = self.force_per_volt[line].ravel()
            values = np.column_stack([parts.real, parts.imag]).ravel()
            rows.append((float(self.frequency_hz[line]), *(float(f"{value:.6g}") for value in values)))
        # Of the first exciter, with all of them in the ratio that isolates the mode.
        at = int(np.argmin(np.abs(self.frequency_hz - frequency)))
        excited = self.shapes[[self.points.index(point) for point in self.exciter_points]]
        wanted = np.linalg.pinv(excited.T)[:, self.target]
        voltages = np.linalg.solve(self.force_per_volt[at], wanted.astype(complex))
        first = abs(voltages[0]) or 1.0
        return LinearDescription(
            source="test",
            drive_point=self.exciter_points[0],
            target_mode=self.target,
            points=self.points,
            frequencies_rad_s=tuple((2.0 * math.pi * self.modes.frequencies_hz).tolist()),
            damping_ratios=tuple(self.modes.damping_ratios.tolist()),
            shapes=tuple(map(tuple, self.shapes.tolist())),
            drive_point_shape=float(self.shapes[drive, self.target]),
            plant_frequency_rad_s=float(2.0 * math.pi * self.plant.frequencies_hz[nearest]),
            plant_damping_ratio=float(self.plant.damping_ratios[nearest]),
            moving_mass_kg=moving_mass_kg,
            force_per_volt=float(abs(wanted[0]) / first),
            displacement_per_volt=float(abs(self.displacement_per_volt @ voltages) / first),
            exciter_points=self.exciter_points,
            exciter_force_rows=tuple(rows),
        )


def responses_of_inputs(spectra: AveragedSpectra, outputs: Sequence[str], inputs: Sequence[str]) -> ComplexArray:
    """H = S_xf S_ff⁻¹, shape ``(outputs, inputs, lines)``.

    Raises:
        BenchError: the inputs are not independent at a line.
    """
    rows = [spectra.channels.index(name) for name in outputs]
    columns = [spectra.channels.index(name) for name in inputs]
    cross = spectra.matrix[np.ix_(rows, columns)].transpose(2, 0, 1)
    auto = spectra.matrix[np.ix_(columns, columns)].transpose(2, 0, 1)
    scale = np.sqrt(np.einsum("lii->li", auto).real)
    normalised = auto / (scale[:, :, None] * scale[:, None, :])
    if not np.isfinite(normalised).all() or np.linalg.cond(normalised).max() > 1e6:
        raise BenchError("The inputs are not independent of each other; drive every exciter with a noise of its own.")
    solved = np.linalg.solve(auto.transpose(0, 2, 1), cross.transpose(0, 2, 1)).transpose(1, 2, 0)
    return np.asarray(solved.transpose(1, 0, 2), dtype=np.complex128)


def partial_coherence(spectra: AveragedSpectra, outputs: Sequence[str], inputs: Sequence[str]) -> FloatArray:
    """γ² of every output and input with the other inputs removed, shape ``(outputs, inputs, lines)``."""
    result = np.empty((len(outputs), len(inputs), spectra.frequency_hz.size))
    columns = [spectra.channels.index(name) for name in inputs]
    for i, name in enumerate(outputs):
        chosen = [*columns, spectra.channels.index(name)]
        matrix = spectra.matrix[np.ix_(chosen, chosen)].transpose(2, 0, 1)
        scale = np.sqrt(np.einsum("lii->li", matrix).real)
        matrix = matrix / (scale[:, :, None] * scale[:, None, :])
        inverse = np.linalg.inv(matrix + 1e-12 * np.eye(len(chosen)))
        diagonal = np.einsum("lii->li", inverse).real
        result[i] = np.minimum((np.abs(inverse[:, -1, :-1]) ** 2 / (diagonal[:, -1:] * diagonal[:, :-1])).T, 1.0)
    return result


def fit_modes(
    inputs: ComplexArray,
    outputs: ComplexArray,
    frequency_hz: FloatArray,
    start: Sequence[tuple[float, float]],
    powers: Sequence[int],
    complex_residues: bool,
) -> InputModes:
    """Poles and residues of a band; see the module's text.

    Args:
        inputs: spectra, shape ``(inputs, lines)``.
        outputs: spectra, shape ``(outputs, lines)``.
        frequency_hz: lines, shape ``(lines,)``.
        start: frequency (Hz) and damping ratio of each mode.
        powers: derivative of the displacement that each output is.
        complex_residues: residues R + i Ω Q as of damped modes that are not real.
    """
    from scipy.optimize import least_squares

    s = 2j * np.pi * frequency_hz
    middle = float(np.mean(np.abs(s)))
    weight = 1.0 / np.sqrt((np.abs(outputs) ** 2).mean(axis=1))
    count = len(start)

    def columns(poles: FloatArray, power: int) -> ComplexArray:
        omega, zeta = np.exp(poles[:count]), poles[count:]
        resonances = [w * w + s * s + 2.0 * z * w * s for w, z in zip(omega, zeta, strict=True)]
        found = []
        for signal in inputs:
            for resonance in resonances:
                found.append(s**power * signal / resonance)
                if complex_residues:
                    found.append(s**power * signal * s / middle / resonance)
            found += [s**power * signal, s**power * signal / s**2]
        for resonance in resonances:
            found += [1.0 / resonance, s / middle / resonance]
        place = (np.abs(s) - middle) / middle
        found += [np.ones_like(s), 1j * np.ones_like(s), place + 0j, 1j * place]
        return np.array(found)

    def solved(poles: FloatArray) -> tuple[list[FloatArray], FloatArray]:
        answers, left = [], []
        for row, power in enumerate(powers):
            basis = columns(poles, power)
            scale = np.sqrt((np.abs(basis) ** 2).mean(axis=1))
            matrix = np.concatenate([basis.real, basis.imag], axis=1).T / scale
            target = weight[row] * np.concatenate([outputs[row].real, outputs[row].imag])
            answer, *_ = np.linalg.lstsq(matrix, target, rcond=None)
            answers.append(answer / scale / weight[row])
            left.append(target - matrix @ answer)
        return answers, np.concatenate(left)

    first = np.concatenate([np.log([2.0 * np.pi * f for f, _ in start]), [z for _, z in start]])
    found = least_squares(lambda poles: solved(poles)[1], first, x_scale=np.r_[np.full(count, 1e-3), first[count:]])
    answers, left = solved(found.x)
    freedom = max(1, left.size - len(powers) * len(answers[0]) - 2 * count)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * float(left @ left) / freedom
    deviations = np.sqrt(np.diag(covariance))
    omega, zeta = np.exp(found.x[:count]), found.x[count:]
    each = 2 if complex_residues else 1
    residues = np.zeros((len(powers), len(inputs), count), complex)
    for row, answer in enumerate(answers):
        for j in range(len(inputs)):
            at = j * (each * count + 2)
            for k in range(count):
                residues[row, j, k] = answer[at + each * k]
                if complex_residues:
                    residues[row, j, k] += 1j * omega[k] / middle * answer[at + each * k + 1]
    order = np.argsort(omega)
    misfit = np.sqrt((left.reshape(len(powers), -1) ** 2).mean(axis=1) * 2.0)
    return InputModes(
        np.asarray(omega[order] / (2.0 * np.pi)), np.asarray(zeta[order]),
        np.asarray((deviations[:count] * omega)[order] / (2.0 * np.pi)), np.asarray(deviations[count:][order]),
        residues[:, :, order], misfit,
    )  # fmt: skip


def _best_fit(
    inputs: ComplexArray,
    outputs: ComplexArray,
    frequency_hz: FloatArray,
    starts: Sequence[Sequence[tuple[float, float]]],
    powers: Sequence[int],
    complex_residues: bool,
) -> InputModes:
    """`fit_modes` from every start, the one with the least misfit whose poles are damped and in the band."""
    found = [fit_modes(inputs, outputs, frequency_hz, start, powers, complex_residues) for start in starts if start]
    low, high = frequency_hz[0], frequency_hz[-1]
    good = [
        fit
        for fit in found
        if fit.damping_ratios.min() > 0.0 and low < fit.frequencies_hz.min() and fit.frequencies_hz.max() < high
    ]
    if not good:
        raise BenchError(
            f"The modes between {low:.5g} and {high:.5g} Hz could not be fitted; record longer, or ask for other modes."
        )
    return min(good, key=lambda fit: float(np.linalg.norm(fit.misfit)))


def shapes_of(residues: FloatArray, at: Sequence[int]) -> FloatArray:
    """Mass-normalised shapes of residues of rank one, R_ij = φ_i φ_j.

    Args:
        residues: real, shape ``(points, inputs, modes)``.
        at: row of each input's point.

    Returns:
        φ, 1/√kg, shape ``(points, modes)``; the largest entry of each is positive.

    Raises:
        BenchError: a driving-point residue is negative: force or response are inverted there, or it is no mode.
    """
    shapes = np.empty((residues.shape[0], residues.shape[2]))
    for k in range(residues.shape[2]):
        driving = 0.5 * (residues[list(at), :, k] + residues[list(at), :, k].T)
        values, vectors = np.linalg.eigh(driving)
        if not values[-1] > 0.0:
            raise BenchError("The residues at the exciters have the wrong sign: a force or a response is inverted.")
        driven = math.sqrt(values[-1]) * vectors[:, -1]
        shape = residues[:, :, k] @ driven / float(driven @ driven)
        shapes[:, k] = shape * np.sign(shape[int(np.argmax(np.abs(shape)))])
    return shapes


def several_inputs_test(
    signals: Signals,
    exciter_points: Sequence[int],
    band_hz: tuple[float, float],
    starts: Sequence[Sequence[tuple[float, float]]],
    target: int | float,
    quantity: Quantity,
) -> SeveralInputsTest:
    """Evaluate a record in which every exciter was driven by a noise of its own.

    Args:
        signals: the record, with a force and a voltage of every exciter.
        exciter_points: points of the exciters, in the order of their voltages.
        band_hz: band of the excitation.
        starts: frequency (Hz) and damping ratio of the modes to fit, as of a stabilisation diagram or a model; of
            several starts the one that fits best counts.
        target: index of the target among them, or the frequency (Hz) that it is nearest to.
        quantity: responses that give the shapes.

    Raises:
        BenchError: a channel is missing, the inputs are not independent, or a sign is wrong.
    """
    responses = signals.named(quantity)
    points = tuple(signals.points[name] for name in responses)
    voltages = signals.named(Quantity.VOLTAGE)
    forces = []
    for point in exciter_points:
        found = signals.named(Quantity.FORCE, point)
        if len(found) != 1 or point not in points:
            raise BenchError(f"The record needs one force and one {quantity.name.lower()} channel at point {point}.")
        forces.append(found[0])
    if len(voltages) != len(exciter_points):
        raise BenchError(f"The record has {len(voltages)} voltages for {len(exciter_points)} exciters.")
    names = [*forces, *responses, *voltages]
    segment = signals.samples // SEGMENTS
    spectra = averaged_spectra({name: signals.channels[name] for name in names}, signals.sample_rate, segment, band_hz)
    power = MOTIONS[quantity]
    s = 2j * np.pi * spectra.frequency_hz
    by_force = responses_of_inputs(spectra, responses, forces) * s ** (2 - power)
    force_per_volt = responses_of_inputs(spectra, forces, voltages).transpose(2, 0, 1)

    record_lines = np.fft.rfftfreq(signals.samples, 1.0 / signals.sample_rate)
    middle: float = float(target) if isinstance(target, float) else starts[-1][min(int(target), len(starts[-1]) - 1)][0]
    use = np.flatnonzero(np.abs(record_lines / middle - 1.0) < WIDTH)
    lines: FloatArray = np.asarray(record_lines[use], dtype=np.float64)

    def spectrum(name: str) -> ComplexArray:
        values = signals.channels[name]
        return np.asarray(np.fft.rfft(values - values.mean())[use])

    motion = np.array([spectrum(name) for name in responses])
    powers = [power] * len(responses)
    by_forces, by_voltages = (np.array([spectrum(name) for name in names]) for names in (forces, voltages))
    modes = _best_fit(by_forces, motion, lines, starts, powers, False)
    heavier = list(
        zip(modes.frequencies_hz.tolist(), np.maximum(0.02, 3.0 * modes.damping_ratios).tolist(), strict=True)
    )
    plant = _best_fit(by_voltages, motion, lines, [heavier], powers, True)
    if isinstance(target, float):
        target = int(np.argmin(np.abs(modes.frequencies_hz - target)))
    if not 0 <= target < modes.frequencies_hz.size:
        listed = ", ".join(f"{frequency:.5g}" for frequency in modes.frequencies_hz)
        raise BenchError(f"There is no such mode among those fitted ({listed} Hz); choose with --mode or --near.")
    at = [points.index(point) for point in exciter_points]
    shapes = shapes_of(np.asarray(modes.residues.real), at)
    by_voltage = responses_of_inputs(spectra, responses, voltages) / s**power
    line = int(np.argmin(np.abs(spectra.frequency_hz - modes.frequencies_hz[target])))
    return SeveralInputsTest(
        tuple(exciter_points), points, spectra.frequency_hz, by_force, partial_coherence(spectra, responses, forces),
        force_per_volt, modes, shapes, plant, target, by_voltage[at[0], :, line],
    )  # fmt: skip


def evaluate_several_inputs(
    bag: Bag,
    exciter_points: Sequence[int],
    quantity: Quantity,
    mode: int = 1,
    near_hz: float | None = None,
    modes: int = 2,
) -> SeveralInputsTest:
    """Evaluate the highest level of a recording of random excitation by several exciters.

    Args:
        bag: the recording.
        exciter_points: points of the exciters, in the order of their voltages.
        quantity: responses that give the shapes.
        mode: number of the target among the lowest modes of the band, from 1.
        near_hz: the target is the stable pole nearest to this frequency; goes before ``mode``.
        modes: modes to keep: the target and those nearest to it.

    Raises:
        BenchError: no whole window of random excitation, too few stable poles, or as :func:`several_inputs_test`.
    """
    windows = [item for item in segments(bag) if item.kind is TestKind.RANDOM and not item.fault]
    if not windows:
        raise BenchError(
            f"The bag {bag.path} has no whole window of random excitation; record one with './nmt linear'."
        )
    main = max(windows, key=lambda item: item.level)
    signals = read_signals(bag, main.first_sample, main.samples)
    plan = (bag.run_start or {}).get("plan") or {}
    band = float(plan.get("band_low_hz") or 10.0), float(plan.get("band_high_hz") or 0.25 * signals.sample_rate)
    responses = signals.named(quantity)
    forces = [name for point in exciter_points for name in signals.named(Quantity.FORCE, point)]
    names = {name: signals.channels[name] for name in [*forces, *responses]}
    spectra = averaged_spectra(names, signals.sample_rate, signals.samples // SEGMENTS, band)
    s = 2j * np.pi * spectra.frequency_hz
    accelerance = responses_of_inputs(spectra, responses, forces) * s ** (2 - MOTIONS[quantity])
    rows = accelerance.reshape(-1, accelerance.shape[2])
    diagrams = [order_poles(rows, spectra.frequency_hz, band)]
    if near_hz is not None:
        diagrams.append(order_poles(rows, spectra.frequency_hz, (0.7 * near_hz, 1.4 * near_hz)))
    poles = sorted(stable_poles(*diagrams), key=lambda pole: pole.frequency_hz)
    if not poles:
        raise BenchError("No stable mode was found; raise the level, record longer or change the band.")
    if near_hz is None and mode > modes:
        raise BenchError(
            f"Mode {mode} is beyond the {modes} lowest, which are fitted; choose it by its frequency (--near)."
        )
    target = poles[0]
    if near_hz is not None:
        target = min(poles, key=lambda pole: abs(pole.frequency_hz - near_hz))
    kept = sorted(poles, key=lambda pole: abs(pole.frequency_hz - target.frequency_hz))[:modes]
    kept.sort(key=lambda pole: pole.frequency_hz)
    found = [(pole.frequency_hz, pole.damping_ratio) for pole in kept]
    # Averaged spectra may show close modes as one: the fit of the whole record also begins with that one as several.
    apart = target.frequency_hz * (1.0 + _APART * np.linspace(-1.0, 1.0, modes))
    split = [(float(frequency), target.damping_ratio) for frequency in apart]
    wanted = near_hz if near_hz is not None else mode - 1
    return several_inputs_test(signals, exciter_points, band, [found, split], wanted, quantity)


def table_rows(test: SeveralInputsTest) -> list[dict[str, Any]]:
    """Rows of ``frf.csv``: line, response point, exciter point, accelerance (m/s²/N) and partial coherence."""
    return [
        {
            "frequency_hz": float(frequency),
            "point": point,
            "exciter_point": exciter,
            "accelerance_real": float(test.accelerance[i, j, line].real),
            "accelerance_imag": float(test.accelerance[i, j, line].imag),
            "partial_coherence": float(test.coherence[i, j, line]),
        }
        for i, point in enumerate(test.points)
        for j, exciter in enumerate(test.exciter_points)
        for line, frequency in enumerate(test.frequency_hz)
    ]
