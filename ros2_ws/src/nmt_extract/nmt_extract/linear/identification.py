"""Linear modal test: from one record of random excitation to modes, residuals and the plant with its exciters.

Averaged spectra (:mod:`nmt_signals.frequency_responses`) give the frequency responses, the coherence and, through the
stabilisation diagram (:mod:`nmt_extract.linear.stabilisation`), the modes to look for. Every mode is then fitted
to the whole record without window (:mod:`nmt_signals.rational_fit`) and scaled by the drive points. No model of the
structure enters. Exciters that drive at once, each with a noise of its own, are as many inputs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.linear.judge import drive_points, hum_findings, phase_findings, with_phase_error
from nmt_extract.linear.plant import plant_estimate
from nmt_extract.linear.residuals import fit_residuals
from nmt_extract.linear.results import LinearMode, LinearTest, LinearTestSettings, modal_term, receptance_of
from nmt_extract.linear.stabilisation import (
    HIGHEST_DAMPING,
    SAME_POLE,
    OrderPoles,
    StablePole,
    order_poles,
    stable_poles,
)
from nmt_record.windows.segments import Signals
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.frequency_responses import AveragedSpectra, FrfEstimate, averaged_spectra, frf_estimate
from nmt_signals.rational_fit import RATIONAL_MOST_LINES, RationalFit, StructureMode, fit_rational, structure_mode

LOWEST_COHERENCE = 0.8
"""Share of a response's power around a mode that the fit must explain, in the best channel."""
LINES_PER_HALF_POWER = 3.0
"""Length of the record in inverse half-power bandwidths of the narrowest kept mode, at least."""
DAMPING_SCATTER = 0.3
"""Relative standard uncertainty of damping above which a mode is dropped."""
SAME_BANDWIDTH_SHARE = 0.02
"""Distance of two fitted poles over the half-power half-width below which they are one mode."""
SAME_SHAPE = 0.95
"""MAC of two modes above which they may be one."""
_ORDER = 3  # degree of the polynomials next to the poles
_INVERTED = 0.1  # of the largest driving-point residue, from which on a negative one is not noise
SEGMENTS = 10
"""Segments without overlap into which the record is cut for the averages, where nothing else is asked for."""


@dataclass(frozen=True)
class _Channels:
    forces: tuple[str, ...]
    responses: tuple[str, ...]
    points: tuple[int, ...]
    drives: tuple[str, ...]
    voltages: tuple[str, ...]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Responses and what is measured at the exciters next to them."""
        return _unique(*self.responses, *self.drives)

    @property
    def names(self) -> tuple[str, ...]:
        return _unique(*self.forces, *self.outputs, *self.voltages)


def linear_test(signals: Signals, settings: LinearTestSettings) -> LinearTest:
    """Evaluate a record of random excitation.

    Args:
        signals: the record, see :func:`nmt_record.windows.segments.read_signals`.
        settings: what to look for.

    Raises:
        BenchError: gaps, overload, a missing or dead channel, a record too short, low coherence, no stable mode, or no
            such target mode.
    """
    channels = _channels(signals, settings)
    _check_samples(signals, channels)
    duration = signals.samples / signals.sample_rate
    spectra = _averages(signals, channels, settings)
    force_frfs = _responses(spectra, channels.forces, channels.outputs, channels.voltages)
    voltage_frfs = _responses(spectra, channels.voltages, (*channels.forces, *channels.outputs))
    rows = slice(0, len(channels.responses))
    diagrams = _diagrams(force_frfs, settings, rows)
    stable = stable_poles(*diagrams)
    if not stable:
        raise BenchError(
            f"No stable mode was found between {settings.band_hz[0]:g} and {settings.band_hz[1]:g} Hz"
            f"{_coherence_hint(force_frfs, rows)}; raise the level, record longer or change the band."
        )
    whole = _Record(signals, channels, settings)
    stable = _apart(whole, stable)
    found, remarks = _refine(whole, stable, force_frfs, rows)
    drive_rows = [channels.outputs.index(name) for name in channels.drives]
    found = [with_phase_error(mode, found, drive_rows) for mode in found]
    drive = channels.drives[0]
    suspension = _has_mass_line(force_frfs[0], drive, MOTIONS[signals.quantities[drive]], found)
    target = target_of(found, settings, suspension)
    kept = _kept(found, target, min(settings.modes, len(channels.points)))
    further = tuple(mode for mode in found if mode not in kept)
    narrowest = min(kept, key=lambda mode: mode.damping_ratio * mode.frequency_hz)
    half_power = 2.0 * narrowest.damping_ratio * narrowest.frequency_hz
    if duration * half_power < LINES_PER_HALF_POWER:
        raise BenchError(
            f"The record of {duration:.3g} s is too short for the mode at {narrowest.frequency_hz:.5g} Hz, whose "
            f"half-power bandwidth is {half_power:.2g} Hz; record at least {LINES_PER_HALF_POWER / half_power:.0f} s."
        )
    index = kept.index(target)
    motions = [MOTIONS[signals.quantities[name]] for name in channels.drives]
    at_drives = drive_points(force_frfs, channels.drives, channels.outputs, motions)
    taken = [mode.averaged for mode in found]
    left_out = [pole.frequency_hz for pole in stable if pole not in taken]
    findings = phase_findings(found, kept, left_out, at_drives, channels.outputs)
    powers = np.array([spectra.cross(name, name).real for name in channels.outputs])
    findings += hum_findings(force_frfs, powers, found)
    receptance = np.vstack([receptance_of(frf, settings.quantity)[rows] for frf in force_frfs])
    variance = np.vstack([_variance(frf, settings.quantity)[rows] for frf in force_frfs])
    frequency = force_frfs[0].frequency_hz
    terms = [modal_term(mode) for mode in kept]
    lumped = fit_residuals(frequency, receptance, variance, terms, _overall_band(kept, settings))
    neighbours = [mode for mode in found if mode is not target]
    band = _target_band(target, neighbours, settings, float(frequency[1] - frequency[0]))
    alone = fit_residuals(frequency, receptance, variance, [modal_term(target)], band)
    return LinearTest(
        points=channels.points,
        forces=channels.forces,
        outputs=channels.outputs,
        modes=kept,
        further_modes=further,
        target=index,
        plant=plant_estimate(whole, kept, index, voltage_frfs),
        residuals=lumped,
        target_residuals=alone,
        force_frfs=force_frfs,
        voltage_frfs=voltage_frfs,
        diagrams=tuple(tuple(diagram) for diagram in diagrams),
        stable=tuple(stable),
        remarks=(*findings, *remarks),
        suspension_below_band=suspension,
        settings=settings,
        duration_s=duration,
        quantity=settings.quantity,
        reference="voltage" if channels.voltages else "force",
    )


# -- channels and samples ---------------------------------------------------------------------------------------------


def _channels(signals: Signals, settings: LinearTestSettings) -> _Channels:
    responses = signals.named(settings.quantity)
    forces, drives = [], []
    for point in settings.exciter_points:
        at_point = [name for name in signals.named(Quantity.FORCE) if signals.points[name] in (0, point)]
        if len(at_point) != 1:
            raise BenchError(f"The record has {len(at_point)} force channels at drive point {point}; one is needed.")
        if not responses:
            name = settings.quantity.name.lower()
            raise BenchError(f"The record has no {name} channel; choose another response quantity.")
        drive = signals.named(settings.quantity, point)
        for quantity in (Quantity.ACCELERATION, Quantity.DISPLACEMENT, Quantity.VELOCITY):
            drive = drive or signals.named(quantity, point)
        if not drive:
            raise BenchError(f"No response is measured at drive point {point}; without it shapes cannot be scaled.")
        forces.append(at_point[0])
        drives.append(drive[0])
    voltages = signals.named(Quantity.VOLTAGE)
    if voltages and len(voltages) < len(forces):
        raise BenchError(
            f"The record has {len(voltages)} voltages for {len(forces)} exciters; record that of every exciter."
        )
    points = tuple(signals.points[name] for name in responses)
    return _Channels(tuple(forces), tuple(responses), points, tuple(drives), tuple(voltages[: len(forces)]))


def _unique(*names: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _check_samples(signals: Signals, channels: _Channels) -> None:
    if signals.gaps:
        topic, first, count = signals.gaps[0]
        raise BenchError(f"{count} samples of {topic} are missing from sample {first} on; record again.")
    if signals.flags & BlockFlag.OVERLOAD:
        raise BenchError("A converter was driven beyond its range (overload); lower the level or widen the range.")
    if signals.flags & (BlockFlag.LIMIT | BlockFlag.WATCHDOG):
        raise BenchError("A limit or the watchdog took the drive to zero within the record; lower the level.")
    if signals.flags & BlockFlag.STOP:
        raise BenchError("The drive was stopped within the record; record again.")
    for name in channels.names:
        values = signals.channels[name]
        if not np.all(np.isfinite(values)):
            raise BenchError(f"Channel {name} has values that are not numbers; record again.")
        peak = float(np.max(np.abs(values)))
        if peak == 0.0 or float(np.ptp(values)) == 0.0:
            raise BenchError(f"Channel {name} shows no signal; check its sensor and the drive.")
        clipped_at = clipping_level(values)
        if clipped_at:
            raise BenchError(f"Channel {name} is clipped at {clipped_at:.4g} {signals.units[name]}; lower the level.")


def _averages(signals: Signals, channels: _Channels, settings: LinearTestSettings) -> AveragedSpectra:
    length = signals.samples
    segment = length // SEGMENTS if settings.segment_s is None else round(settings.segment_s * signals.sample_rate)
    low, high = settings.band_hz
    if not 0.0 < low < high < 0.5 * signals.sample_rate:
        raise BenchError(
            f"The band {low:g} to {high:g} Hz must lie between 0 and half the sample rate, "
            f"{signals.sample_rate / 2:g} Hz."
        )
    recorded = {name: signals.channels[name] for name in channels.names}
    return averaged_spectra(recorded, signals.sample_rate, segment, (low, high))


def _responses(
    spectra: AveragedSpectra, inputs: tuple[str, ...], outputs: tuple[str, ...], voltages: tuple[str, ...] = ()
) -> tuple[FrfEstimate, ...]:
    """Every input to the outputs, the other inputs at zero."""
    found = []
    for number, name in enumerate(inputs):
        others, others_voltages = ((*names[:number], *names[number + 1 :]) for names in (inputs, voltages))
        voltage = voltages[number] if voltages else None
        found.append(frf_estimate(spectra, name, outputs, voltage, others, others_voltages))
    return tuple(found)


def _s(frequency_hz: FloatArray | float) -> ComplexArray:
    return np.asarray(2j * np.pi * np.asarray(frequency_hz))


def _variance(frf: FrfEstimate, quantity: Quantity) -> FloatArray:
    """Variance of the receptance from coherence and averages (Bendat and Piersol)."""
    coherence = np.clip(frf.coherence, 1e-6, 1.0 - 1e-9)
    relative = (1.0 - coherence) / (2.0 * coherence * frf.independent_averages)
    return np.asarray(np.abs(receptance_of(frf, quantity)) ** 2 * relative)


def _diagrams(frfs: tuple[FrfEstimate, ...], settings: LinearTestSettings, rows: slice) -> list[list[OrderPoles]]:
    """Of the whole band and of its lower parts, where few lines hold low modes."""
    frequency = frfs[0].frequency_hz
    factor = _s(frequency) ** (2 - MOTIONS[settings.quantity])
    accelerance = np.vstack([frf.best[rows] * factor for frf in frfs])
    low, high = settings.band_hz
    diagrams = [order_poles(accelerance, frequency, settings.band_hz)]
    for part in (4.0, 16.0):
        if high / part > 2.0 * low:
            try:
                diagrams.append(order_poles(accelerance, frequency, (low, high / part)))
            except BenchError:  # too few lines there; the whole band stands
                break
    return diagrams


def _coherence_hint(frfs: tuple[FrfEstimate, ...], rows: slice) -> str:
    median = float(np.median(np.max([frf.coherence[rows].max(axis=0) for frf in frfs], axis=0)))
    return f" (median coherence {median:.2f})" if median < LOWEST_COHERENCE else ""


# -- modes ------------------------------------------------------------------------------------------------------------


class _Record:
    """Spectra of the whole record without window."""

    def __init__(self, signals: Signals, channels: _Channels, settings: LinearTestSettings) -> None:
        self.channels = channels
        self.settings = settings
        self.quantities = signals.quantities
        self.sample_rate = signals.sample_rate
        self.frequency: FloatArray = np.fft.rfftfreq(signals.samples, 1.0 / signals.sample_rate).astype(np.float64)
        low, high = settings.band_hz
        use = np.flatnonzero((self.frequency >= low) & (self.frequency <= high))
        self.frequency = np.asarray(self.frequency[use], dtype=np.float64)
        self.force_rows = range(len(channels.forces) if channels.voltages else 0)
        self.outputs = (*(channels.forces[row] for row in self.force_rows), *channels.outputs)
        self.drive_rows = [self.outputs.index(name) for name in channels.drives]

        def spectrum(name: str) -> ComplexArray:
            values = signals.channels[name]
            return np.asarray(np.fft.rfft(values - values.mean())[use])

        self.references = np.array([spectrum(name) for name in channels.voltages or channels.forces])
        self.spectra = np.array([spectrum(name) for name in self.outputs])
        self.forces = self.spectra[list(self.force_rows)] if channels.voltages else self.references
        self.response_rows = slice(len(self.force_rows), None)

    def fit(
        self, pole: StablePole, others: list[StablePole], order: int = _ORDER, start: RationalFit | None = None
    ) -> RationalFit:
        """Around one pole, with those others that lie in its band."""
        width = self.half_width(pole, others)
        within = sum(abs(other.frequency_hz - pole.frequency_hz) < width for other in others)
        count = 1 + min(within, max(2, len(self.references) - 1))
        return fit_rational(
            self.references, self.spectra, self.frequency, pole.frequency_hz, width, count, order, start
        )

    def structure_poles(self, pole: StablePole, others: list[StablePole]) -> ComplexArray:
        """As many poles as inputs around one pole, with the forces as inputs, Hz (f + i ζ f)."""
        responses, width = self.spectra[self.response_rows], self.half_width(pole, others)
        fit = fit_rational(
            self.forces, responses, self.frequency, pole.frequency_hz, width, len(self.references), _ORDER
        )
        magnitude = np.abs(fit.eigenvalues)
        return np.asarray((magnitude - 1j * fit.eigenvalues.real) / (2.0 * np.pi))

    def half_width(self, pole: StablePole, others: list[StablePole]) -> float:
        """Of the band of a fit, Hz: wide next to the resonance and the plant's, narrow next to the next mode.

        So many inputs tell as many close modes apart, which are then fitted together.
        """
        low, high = self.settings.band_hz
        frequency = pole.frequency_hz
        spacing = float(self.frequency[1] - self.frequency[0])
        resonance = 8.0 * pole.damping_ratio * frequency
        width = max(0.1 * frequency, resonance, 40.0 * (self.frequency[1] - self.frequency[0]))
        gaps = [abs(other.frequency_hz - frequency) for other in others]
        room = min(sorted(0.7 * gap for gap in gaps if gap > 0.0)[len(self.references) - 1 :], default=math.inf)
        width = min(width, max(room, 3.0 * pole.damping_ratio * frequency))
        width = min(width, max(frequency - low, 0.02 * frequency), max(high - frequency, 0.02 * frequency))
        return float(min(width, max(resonance, 0.5 * RATIONAL_MOST_LINES * spacing)))


def _apart(record: _Record, stable: list[StablePole]) -> list[StablePole]:
    """With several inputs the poles of modes so close that the averages show them as one."""
    if len(record.references) == 1:
        return stable
    result: list[StablePole] = []
    for pole in stable:
        others = [other for other in stable if other is not pole]
        near = min(
            [2.0 * SAME_POLE * pole.frequency_hz, *(0.5 * abs(o.frequency_hz - pole.frequency_hz) for o in others)]
        )
        try:
            poles = record.structure_poles(pole, others)
        except (BenchError, np.linalg.LinAlgError):  # the fit of the mode itself says what is wrong
            poles = np.empty(0, dtype=np.complex128)
        damping = poles.imag / poles.real
        use = (np.abs(poles.real - pole.frequency_hz) < near) & (damping > 0.0) & (damping < HIGHEST_DAMPING)
        if np.count_nonzero(use) > 1:
            result += [
                replace(pole, frequency_hz=float(found.real), damping_ratio=float(found.imag / found.real))
                for found in poles[use]
            ]
        else:
            result.append(pole)
    return sorted(result, key=lambda pole: pole.frequency_hz)


def _refine(
    record: _Record, stable: list[StablePole], frfs: tuple[FrfEstimate, ...], rows: slice
) -> tuple[list[LinearMode], list[str]]:
    modes: list[LinearMode] = []
    remarks: list[str] = []
    reasons: list[str] = []
    lines = frfs[0].frequency_hz
    for pole in stable:
        others = [other for other in stable if other is not pole]
        name = f"The pole at {pole.frequency_hz:.5g} Hz"
        near = np.abs(lines - pole.frequency_hz) <= max(
            4.0 * pole.damping_ratio * pole.frequency_hz, 3.0 * (lines[1] - lines[0])
        )
        averaged = float(np.max([np.median(frf.coherence[rows][:, near], axis=1) for frf in frfs]))
        try:
            fit = record.fit(pole, others)
            coherence = float(np.max(1.0 - fit.misfit[record.response_rows] ** 2))
            if coherence < LOWEST_COHERENCE:
                reasons.append(f"{name} is left out: coherence there is {coherence:.2f}, below {LOWEST_COHERENCE}")
                continue
            start = pole.frequency_hz * (1.0 + 1j * pole.damping_ratio)
            mode = scaled_mode(record, structure_mode(fit, start, record.force_rows), pole, (coherence, averaged), fit)
            mode = _with_model_error(record, mode, others)
        except (BenchError, np.linalg.LinAlgError) as error:
            reasons.append(f"{name} is left out: {str(error).rstrip('.')}")
            continue
        moved = abs(mode.frequency_hz / pole.frequency_hz - 1.0)
        if moved > 0.02 + pole.damping_ratio or not 0.0 < mode.damping_ratio < 1.0:
            reasons.append(f"{name} is left out: the fit of the whole record does not confirm it")
        elif mode.damping_std > DAMPING_SCATTER * mode.damping_ratio:
            reasons.append(f"{name} is left out: its damping is uncertain by more than {100 * DAMPING_SCATTER:.0f} %")
        else:
            modes.append(mode)
    if not modes:
        raise BenchError(f"No mode could be fitted. {reasons[0]}; raise the level or record longer.")
    remarks += [f"{reason}." for reason in reasons]
    return _different(modes), remarks


def _different(modes: list[LinearMode]) -> list[LinearMode]:
    """The modes without those that two poles of the averages led to twice, by frequency."""
    result: list[LinearMode] = []
    for mode in sorted(modes, key=lambda it: abs(it.frequency_hz - it.averaged.frequency_hz)):
        pole = complex(mode.frequency_hz, mode.frequency_hz * mode.damping_ratio)
        for other in result:
            apart = abs(pole - complex(other.frequency_hz, other.frequency_hz * other.damping_ratio))
            scatter = 3.0 * math.hypot(mode.frequency_std, other.frequency_std)
            squares = float(np.vdot(mode.complex_shape, mode.complex_shape).real)
            squares *= float(np.vdot(other.complex_shape, other.complex_shape).real)
            alike = abs(np.vdot(mode.complex_shape, other.complex_shape)) ** 2 > SAME_SHAPE * squares
            if alike and apart < max(scatter, SAME_BANDWIDTH_SHARE * pole.imag):
                break
        else:
            result.append(mode)
    return sorted(result, key=lambda mode: mode.frequency_hz)


def scaled_mode(
    record: _Record, mode: StructureMode, pole: StablePole, coherence: tuple[float, float], fit: RationalFit
) -> LinearMode:
    """Mass-normalised shape from the residues: φ_p φ_d = 2 i ω_d A_pd, displacement from any quantity by powers of λ.

    Residues of a mode have rank one: with the inputs weighted by their part in the mode, w_d, the columns become one,
    φ_p Σ w_d φ_d, which the drive points scale by (Σ w_d φ_d)².
    """
    outputs = record.channels.outputs
    eigenvalue = mode.eigenvalue
    omega = abs(eigenvalue)
    damped = eigenvalue.imag
    powers = np.array([MOTIONS[record.quantities[name]] for name in outputs])
    factor = 2j * damped / eigenvalue**powers
    products = factor[:, np.newaxis] * mode.residues
    drives = [outputs.index(name) for name in record.channels.drives]
    driving = np.diagonal(products[drives]).real
    strongest = int(np.argmax(np.abs(driving)))
    part = products[drives][strongest].real / driving[strongest]
    weights = part / (part @ part)
    column = products @ weights
    square = weights @ column[drives]
    if square.real <= 0.0 or damped <= 0.0 or driving.min() < -_INVERTED * driving.max():
        raise BenchError(
            "its drive-point residue has the wrong sign: the force or the response at the drive point is inverted, or "
            "it is not a mode"
        )
    scale = np.sqrt(square)
    shapes = column / scale
    count = len(record.channels.responses)
    # Signs as of models: the largest entry is positive.
    sign = 1.0 if shapes[:count].real[np.argmax(np.abs(shapes[:count].real))] > 0.0 else -1.0
    # First-order propagation: the real parts have half the variance of the complex circular quantities.
    covariance = mode.covariance
    lambda_std = math.sqrt(max(covariance[0, 0].real, 0.0) / 2.0)
    slopes = np.zeros((len(outputs), len(covariance)), dtype=np.complex128)
    for row in range(len(outputs)):
        for number, weight in enumerate(weights):
            slopes[row, 1 + row * weights.size + number] += factor[row] * weight / scale
            for drive, other in zip(drives, weights, strict=True):
                by_residue = 0.5 * shapes[row] / square * factor[drive] * weight * other
                slopes[row, 1 + drive * weights.size + number] -= by_residue
        slopes[row, 0] += shapes[row] * (0.5 - powers[row] + 0.5 * powers[drives[strongest]]) / eigenvalue
    shape_std = np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", slopes, covariance, slopes.conj()).real, 0.0) / 2.0)
    product_stds = np.abs(factor)[:, np.newaxis] * np.sqrt(
        np.maximum(np.diagonal(covariance).real[1:].reshape(mode.residues.shape), 0.0) / 2.0
    )
    return LinearMode(
        frequency_hz=omega / (2.0 * math.pi),
        damping_ratio=-eigenvalue.real / omega,
        frequency_std=lambda_std / (2.0 * math.pi),
        damping_std=lambda_std / omega,
        complex_shape=sign * shapes[:count],
        shape=sign * shapes[:count].real,
        shape_std=shape_std[:count],
        drive_shapes=sign * shapes[drives].real,
        drive_shape_stds=shape_std[drives],
        products=products,
        product_stds=product_stds,
        averaged=pole,
        coherence=coherence[0],
        averaged_coherence=coherence[1],
        fit=fit,
    )


def _with_model_error(record: _Record, mode: LinearMode, others: list[StablePole]) -> LinearMode:
    """Uncertainties widened by what a polynomial of one degree more changes, the model's own error, and by the bias.

    Noise of a force that is the input takes its share of the power off the response (Bendat and Piersol, ch. 6), most
    where the force drops out: off the residues, and off the resonance as if it were damped more.
    """
    fit = record.fit(mode.averaged, others, _ORDER + 1, mode.fit)
    start = mode.frequency_hz * (1.0 + 1j * mode.damping_ratio)
    found = structure_mode(fit, start, record.force_rows)
    other = scaled_mode(record, found, mode.averaged, (mode.coherence, mode.averaged_coherence), fit)
    bias = 0.0 if record.force_rows else float(mode.fit.input_noise.max())
    return replace(
        mode,
        frequency_std=math.hypot(mode.frequency_std, other.frequency_hz - mode.frequency_hz),
        damping_std=math.hypot(mode.damping_std, other.damping_ratio - mode.damping_ratio, bias * mode.damping_ratio),
        shape_std=np.hypot(np.hypot(mode.shape_std, other.shape - mode.shape), 0.5 * bias * np.abs(mode.shape)),
        drive_shape_stds=np.hypot(
            np.hypot(mode.drive_shape_stds, other.drive_shapes - mode.drive_shapes),
            0.5 * bias * np.abs(mode.drive_shapes),
        ),
    )


def _has_mass_line(frf: FrfEstimate, drive: str, power: int, modes: list[LinearMode]) -> bool:
    """Whether the drive-point receptance below the first mode is that of a mass: a body on a suspension below the band.

    There the receptance of a structure held firmly is that of a spring, positive; of a free body, −1/(m ω²).
    """
    frequency, low, first = frf.frequency_hz, float(frf.frequency_hz[0]), modes[0].frequency_hz
    use = (frequency >= 1.2 * low) & (frequency <= min(3.0 * low, 0.5 * first))
    if np.count_nonzero(use) < 5:
        use = frequency <= 0.7 * first
    if np.count_nonzero(use) < 5:
        return False
    receptance = frf.best[frf.outputs.index(drive)] / _s(frequency) ** power
    return bool(np.median(receptance.real[use] * frequency[use] ** 2) < 0.0)


def target_of(modes: list[LinearMode], settings: LinearTestSettings, suspension: bool) -> LinearMode:
    """The mode that the settings name, else the lowest one above those of the suspension.

    Raises:
        BenchError: there is none.
    """
    listed = ", ".join(f"{mode.frequency_hz:.5g}" for mode in modes)
    if settings.near_hz is not None:
        near = settings.near_hz
        nearest = min(modes, key=lambda mode: abs(mode.frequency_hz - near))
        if abs(nearest.frequency_hz / near - 1.0) > 0.1:
            raise BenchError(f"No mode lies within 10 % of {near:g} Hz; fitted modes are at {listed} Hz.")
        return nearest
    number = settings.mode if settings.mode is not None else max(1, settings.rig_mode - int(suspension))
    if not 1 <= number <= len(modes):
        raise BenchError(
            f"Mode {number} is asked for, but the band has {len(modes)} fitted modes ({listed} Hz); choose with --mode "
            "or --near."
        )
    return modes[number - 1]


def _kept(modes: list[LinearMode], target: LinearMode, count: int) -> tuple[LinearMode, ...]:
    """The lowest modes, the target among them."""
    lowest = modes[:count]
    if target not in lowest:
        lowest = [*lowest[: count - 1], target]
    return tuple(sorted(lowest, key=lambda mode: mode.frequency_hz))


# -- residuals and plant ----------------------------------------------------------------------------------------------


def _overall_band(modes: tuple[LinearMode, ...], settings: LinearTestSettings) -> tuple[float, float]:
    return max(settings.band_hz[0], 0.6 * modes[0].frequency_hz), min(settings.band_hz[1], 1.2 * modes[-1].frequency_hz)


def _target_band(
    target: LinearMode, others: list[LinearMode], settings: LinearTestSettings, spacing: float
) -> tuple[float, float]:
    """A quarter below and above the target, at most halfway to the next mode, but some lines."""
    frequency = target.frequency_hz
    width = min([0.25 * frequency, *(0.5 * abs(mode.frequency_hz - frequency) for mode in others)])
    width = max(width, 3.0 * spacing)
    return max(settings.band_hz[0], frequency - width), min(settings.band_hz[1], frequency + width)
