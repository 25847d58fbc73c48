"""A locked window judged as a whole: is it at phase resonance, steady, free of drift and drop-outs, on one clock?

Each finding is one sentence with what it adds to the standard uncertainties. A finding far beyond what a result can
bear rejects the window.

**Phase.** Damping follows from the active power, which goes with the cosine of the phase between force and velocity.
Where a phase of φ is not that of the structure but a delay or a filter of one channel, δ̃ comes out too low by
1 − cos φ. At ``PHASE_LIMIT`` of 5° this is 0.4 %, which ordinary tolerances of the channels (1 % of gain) still cover;
beyond it, it is the largest part. A phase that is true moves the frequency instead: ω̃ is off by δ̃ tan φ. Beyond
``PHASE_REJECTED`` of 45° more power goes to and fro than into the structure: a degree then changes δ̃ by 1.7 % or more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_extract.judgement.uncertainty import slope_uncertainty

PHASE_LIMIT = math.radians(5.0)
"""Phase between force and velocity at the drive point beyond which a point is flagged, rad."""

PHASE_REJECTED = math.radians(45.0)
"""Phase beyond which it is rejected, rad."""

RESONANT_PHASE_LIMIT = math.radians(10.0)
"""Deviation of the resonant order's phase from which on a window in a secondary resonance is flagged, rad."""

LEAST_PBMIF = 0.5

_PHASE_NOTED = 5e-4  # relative error of damping by the phase, from which on it is part of the uncertainty
_SURE = 6.0  # standard deviations
_UNSTEADY = 0.01  # of the damping ratio: error by a level that still changes
_SELF_EXCITED = 0.05  # damping ratio that errors count by where it may be zero
_STEADY = 1e-3  # the same, from which on it is part of the uncertainty
_RUNNING = math.radians(3.0)  # phase over the window: half of it to each side makes 0.03 % of damping
_SILENT = 0.05  # rms over a period, of the median one
_BURST, _BURST_SHARE = 10.0, 0.01  # residual of a part over that of the others; of the rms of the channel


@dataclass(frozen=True)
class Remark:
    """One finding.

    Attributes:
        sentence: what was found, what may be the cause, what to do.
        parts: what it adds to standard uncertainties: by quantity of a point, in its unit.
        rejects: nothing of the window can be used.
        of_channel: what a single channel does, whatever the level does.
        moving: the level or the frequency of the loop still moves.
    """

    sentence: str
    parts: Mapping[str, float] = field(default_factory=dict)
    rejects: bool = False
    of_channel: bool = False
    moving: bool = False


def words_of(remarks: Sequence[Remark], values: Mapping[str, float]) -> str:
    """All sentences, each with its part in the uncertainty of damping, frequency and amplitude."""
    sentences = []
    for remark in remarks:
        told = [
            f"{100.0 * remark.parts[name] / abs(values[name]):.2g} % of the {word}"
            for name, word in (
                ("damping_ratio", "damping"),
                ("omega_rad_s", "frequency"),
                ("modal_amplitude", "amplitude"),
            )
            if remark.parts.get(name, 0.0) > 1e-7 * abs(values[name])
        ]
        sentences.append(remark.sentence + (f" It adds to the uncertainty: {', '.join(told)}." if told else ""))
    return " ".join(sentences)


def add_parts(fields: dict[str, float], remarks: Sequence[Remark]) -> None:
    """Put the parts of remarks into the standard uncertainties of a point, in place."""
    for remark in remarks:
        for name, part in remark.parts.items():
            if part > 0.0 and math.isfinite(part):
                own = fields[f"{name}_std"]
                fields[f"{name}_std"] = math.hypot(own, part) if math.isfinite(own) else part


def not_below(fields: dict[str, float], least: Mapping[str, float]) -> None:
    """Let no standard uncertainty of a point be below a least one, in place."""
    for name, floor in least.items():
        if fields[f"{name}_std"] < floor:
            fields[f"{name}_std"] = floor


# --- phase, power, harmonics -----------------------------------------------------------------------------------------


def phase_part(phase: float) -> float:
    """Relative standard uncertainty of damping by a phase (rad) that may be a channel's; 0 where it hardly matters."""
    low = 1.0 / math.cos(min(abs(phase), math.radians(80.0))) - 1.0 if math.isfinite(phase) else 0.0
    return low if low > _PHASE_NOTED else 0.0


def judge_phase(values: Mapping[str, float]) -> list[Remark]:
    """Remarks on phase, sign of the power and PBMIF.

    Args:
        values: of the point, by name: frequency_hz, omega_rad_s, damping_ratio, pbmif, phase_error, phase_error_std.
    """
    phase, std = values["phase_error"], values["phase_error_std"]
    sure = 2.0 * std if math.isfinite(std) else 0.0
    damping, omega = values["damping_ratio"], values["omega_rad_s"]
    told = f"Force and velocity at the drive point are {math.degrees(phase):.1f}° apart, at phase resonance they are 0°"
    if not damping > 0.0 or abs(phase) - sure > PHASE_REJECTED:
        limit = math.degrees(PHASE_REJECTED)
        what = (
            f"beyond {limit:.0f}° the damping ratio cannot be determined (mode indicator PBMIF {values['pbmif']:.2f})"
        )
        if abs(phase) > 0.5 * math.pi:
            what = "the structure would feed the exciter, with a negative damping ratio"
        return [Remark(f"{told}: {what}; {_likely(phase, values['frequency_hz'])}.", rejects=True)]
    low = phase_part(phase)
    parts = {"damping_ratio": low * damping, "self_excitation": low * values["self_excitation"]}
    if abs(phase) > max(PHASE_LIMIT, sure):
        parts["omega_rad_s"] = damping * math.tan(min(abs(phase), math.radians(80.0))) * omega
        remarks = [
            Remark(f"{told} (limit {math.degrees(PHASE_LIMIT):.0f}°): {_likely(phase, values['frequency_hz'])}.", parts)
        ]
    else:
        remarks = [Remark("", parts)] if low > 0.0 else []
    if values["pbmif"] < LEAST_PBMIF and not any(remark.sentence for remark in remarks):
        remarks.append(
            Remark(
                f"PBMIF is {values['pbmif']:.2f}: of force and velocity less than half is power at the excitation "
                "frequency; look at harmonics of the force and at noise, and drive more gently or closer to the "
                "structure."
            )
        )
    return remarks


def judge_held_phase(values: Mapping[str, float], held: float) -> list[Remark]:
    """Remark on the phase of a point of a response curve: it is where it was measured, and not where it was asked for.

    Args:
        values: of the point: phase_error, phase_error_std.
        held: phase that the loop was to hold, rad.
    """
    away, std = math.remainder(values["phase_error"] - held, 2.0 * math.pi), values["phase_error_std"]
    if abs(away) <= max(PHASE_LIMIT, 2.0 * std if math.isfinite(std) else 0.0):
        return []
    return [
        Remark(
            f"The lag is {math.degrees(abs(away)):.1f}° off the one that was held (limit "
            f"{math.degrees(PHASE_LIMIT):.0f}°), so the channels of the loop are not those of the recording, or the "
            "window began too early; wait longer before the window, or look at delays of the channels."
        )
    ]


_SETTLED = 0.01  # of the response, which a point that counts as settled may still have to go
_SETTLED_BANDWIDTH = 0.1  # of the damping ratio, which its frequency may still have to go
_STILL = 1e-4  # of the response that is left to go, with which the mean of a nonlinear motion moves visibly
_FOLLOWING = 0.1  # of the damping ratio, by which the frequency follows what the response is away


def is_settled(response_left: float, frequency_left: float, damping_ratio: float) -> bool:
    """Whether a point of a response curve is a steady state.

    Args:
        response_left: share of the response that is still to go.
        frequency_left: the same of the frequency.
        damping_ratio: of the point.
    """
    return abs(response_left) <= _SETTLED and abs(frequency_left) <= _SETTLED_BANDWIDTH * abs(damping_ratio)


def settling_part(values: Mapping[str, float], growth: float, frequency_rate: float) -> Remark:
    """What a point of a response curve still has to go: what settles with the decay δ at a rate r is r / δ away.

    A sentence says so where it is more than a settled point may have.

    The frequency follows the response along the curve, also while its own rate passes through zero: it is not told
    better than by a tenth of the damping ratio times what the response is away.

    Args:
        values: of the point: damping_ratio, omega_rad_s, modal_amplitude.
        growth: rate of ln of the response, 1/s.
        frequency_rate: of the frequency, rad/s².
    """
    decay = abs(values["damping_ratio"]) * values["omega_rad_s"]
    response_left, frequency_left = growth / decay, frequency_rate / decay / values["omega_rad_s"]
    settled = is_settled(response_left, frequency_left, values["damping_ratio"])
    sentence = (
        f"The point has not settled: at its present rate its response is {100.0 * abs(response_left):.2g} % and its "
        f"frequency {100.0 * abs(frequency_left):.2g} % from where they go; give longer windows or a longer ramp."
    )
    return Remark(
        "" if settled else sentence,
        {
            "omega_rad_s": math.hypot(frequency_rate / decay, _FOLLOWING * growth),
            "modal_amplitude": abs(growth) / decay * values["modal_amplitude"],
        },
        moving=abs(response_left) > _STILL,
    )


def judge_resonant_phase(values: Mapping[str, float]) -> list[Remark]:
    """Remark on the phase of the resonant order of a secondary resonance.

    Args:
        values: of the point: phase_error.
    """
    if abs(values["phase_error"]) <= RESONANT_PHASE_LIMIT:
        return []
    return [
        Remark(
            f"The resonant order is {math.degrees(values['phase_error']):.1f}° off its phase at resonance "
            f"(limit {math.degrees(RESONANT_PHASE_LIMIT):.0f}°)."
        )
    ]


def _likely(phase: float, frequency_hz: float) -> str:
    """Likely causes of a phase, and what to do."""
    size = abs(math.degrees(phase))
    delay = 1e3 * abs(phase) / (2.0 * math.pi * frequency_hz)
    late = "response" if phase > 0.0 else "force"
    if size > 135.0:
        return (
            "likely the sign of a sensor, force and response exchanged, or an acceleration called a displacement; give "
            "one channel 'scale: -1' or correct its 'quantity'"
        )
    causes = (
        f"the {late} is late by {delay:.3g} ms (filter, or channels sampled one after another), or the loop was not at "
        "resonance"
    )
    if size < 60.0:
        return f"likely {causes}; measure both on one clock with equal filters, or lock again"
    return (
        f"likely a quantity is not what is stated (a velocity called a displacement turns it by 90°), {causes}; "
        "correct 'quantity' and 'unit' of the channel, or measure both on one clock with equal filters"
    )


def judge_harmonics(
    values: Mapping[str, float], force: ComplexArray, velocity: ComplexArray, response: ComplexArray
) -> list[Remark]:
    """Remarks on harmonics that exceed the fundamental.

    Args:
        values: of the point: damping_ratio, active_power.
        force: F_0..F_H, N.
        velocity: at the drive point, m/s, same shape.
        response: the channel at the drive point as it was measured, in its unit, same shape.
    """
    names = [
        word
        for harmonics, word in ((force, "force"), (response, "response at the drive point"))
        if np.linalg.norm(harmonics[2:]) > abs(harmonics[1])
    ]
    if not names:
        return []
    beyond = float((velocity[2:] * force[2:].conj()).real.sum()) * 0.5
    share = abs(beyond / values["active_power"])
    return [
        Remark(
            f"The harmonics of the {' and of the '.join(names)} exceed the fundamental, so one sine hardly describes "
            "the vibration; drive more gently, choose another place, or hold the harmonics of the force.",
            {"damping_ratio": share * values["damping_ratio"]},
        )
    ]


# --- steadiness and clocks -------------------------------------------------------------------------------------------


def judge_steadiness(
    time: FloatArray,
    force: ComplexArray,
    velocity: ComplexArray,
    values: Mapping[str, float],
    seconds: float,
    *,
    of_damping: bool = True,
) -> list[Remark]:
    """Remarks on a level and on a phase that change over the window.

    A structure that still gains or loses energy takes more or less power than it dissipates: δ̃ is off by q̇/(ω̃ q).

    Args:
        time: middle of each part, s, shape ``(parts,)``.
        force, velocity: fundamental in each part, same shape.
        values: of the point: damping_ratio, omega_rad_s, modal_amplitude, frequency_hz.
        seconds: length of the window.
        of_damping: errors count by the damping ratio; else, where it may be zero, by `_SELF_EXCITED`, and the phase of
            a force that may vanish says nothing of clocks.
    """
    if time.size < 3:
        return []
    remarks = []
    growth, std = _slope(time, np.log(np.abs(velocity)))
    error = abs(growth) / values["omega_rad_s"]
    size = values["damping_ratio"] if of_damping else _SELF_EXCITED
    if error > _STEADY * size and abs(growth) > _SURE * std:
        change = 100.0 * math.expm1(growth * seconds)
        sentence = (
            f"The level was not steady: the response at the drive point changes by {change:.2g} % over the window; "
            "wait longer before the window, or extract with 'power_balance: true'."
        )
        parts = {"damping_ratio": error, "self_excitation": 2.0 * values["omega_rad_s"] * error}
        remarks.append(Remark(sentence if error > _UNSTEADY * size else "", parts, moving=True))
    if not of_damping:
        return remarks
    angles = force * velocity.conj()
    angles = np.angle(angles * np.conj(angles.sum()))
    slope, std = _slope(time, angles)
    run = abs(slope) * seconds
    if run > _RUNNING and abs(slope) > _SURE * std:
        rate = slope / (2.0 * math.pi * values["frequency_hz"])
        low = 1.0 / math.cos(min(0.5 * run, math.radians(80.0))) - 1.0
        remarks.append(
            Remark(
                f"The phase between force and response runs by {math.degrees(run):.2g}° over the window, as on two "
                f"clocks that are {1e6 * abs(rate):.3g} ppm apart, or at a frequency that has not settled; record both "
                "on one clock, or use a shorter window.",
                {
                    "damping_ratio": low * values["damping_ratio"],
                    "omega_rad_s": abs(rate) * values["omega_rad_s"],
                    "modal_amplitude": run**2 / 24.0 * values["modal_amplitude"],
                },
                moving=True,
            )
        )
    return remarks


def _slope(time: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Slope of a straight line, and its standard uncertainty."""
    centred = time - time.mean()
    slope = float((centred * values).sum() / (centred * centred).sum())
    return slope, slope_uncertainty(time, values)


# --- drop-outs -------------------------------------------------------------------------------------------------------


def silent_stretch(signal: FloatArray, samples_per_period: float) -> tuple[int, int] | None:
    """Longest stretch in which a signal of steady vibration is off, at least about a period long.

    Args:
        signal: shape ``(samples,)``.
        samples_per_period: of the fundamental.

    Returns:
        First sample and sample after the last one; None if it is never off.
    """
    length = max(4, round(samples_per_period))
    if signal.size < 4 * length:
        return None
    centred = signal - np.median(signal)
    sums = np.concatenate(([0.0], np.cumsum(centred * centred)))
    power = np.maximum(sums[length:] - sums[:-length], 0.0)
    off = power < _SILENT**2 * np.median(power)
    if not off.any():
        return None
    edges = np.flatnonzero(np.diff(np.concatenate(([0], off.astype(np.int8), [0]))))
    starts, ends = edges[0::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest]) - 1 + length


def burst_part(residuals: FloatArray, rms: float) -> int | None:
    """The part of a window in which a channel departs from its harmonics far more than in the others.

    Args:
        residuals: rms without the harmonics in each part, shape ``(parts,)``.
        rms: of the channel.
    """
    worst = int(np.argmax(residuals))
    others = float(np.median(np.delete(residuals, worst)))
    return worst if residuals[worst] > max(_BURST * others, _BURST_SHARE * rms) else None


def burst_parts(residuals: FloatArray, amplitudes: FloatArray) -> NDArray[np.bool_]:
    """Which of many overlapping parts a channel departs in from what is fitted.

    Args:
        residuals: rms of the residual of each part, shape ``(parts,)``.
        amplitudes: of the channel in each part, same shape.
    """
    share = residuals / np.maximum(amplitudes, 1e-300)
    return np.asarray((share > max(_BURST * float(np.median(share)), _BURST_SHARE)) & (amplitudes > 0.0))


def burst_span(residual: FloatArray) -> tuple[int, int]:
    """Where in a part the residual stands out: first sample and sample after the last one."""
    out = np.flatnonzero(np.abs(residual) > 0.3 * np.abs(residual).max())
    return int(out[0]), int(out[-1]) + 1


def part_residuals(data: FloatArray, moments_projections: ComplexArray, amplitudes: ComplexArray,
                   bounds: IntArray) -> FloatArray:  # fmt: skip
    """rms of each part without its harmonics, shape ``(parts, channels)``."""
    squares = np.stack([np.einsum("cs,cs->c", *(data[:, first:end],) * 2) for first, end in _pairs(bounds)])
    explained = (amplitudes * moments_projections).real.sum(axis=2)
    return np.asarray(np.sqrt(np.maximum(squares - explained, 0.0) / np.diff(bounds)[:, np.newaxis]))


def _pairs(bounds: IntArray) -> list[tuple[int, int]]:
    return list(zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True))
