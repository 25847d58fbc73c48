"""What cannot be right in a linear modal test: phases of channels, and lines that no force makes. Each a sentence.

A passive structure takes power at every frequency: its mobility at a drive point has a positive real part at every line
(Ewins, Modal Testing (2000), section 3.5). Between resonances of low damping the phase is near ±90°, so that a delay, a
high or a low pass of force or response shows there by some degrees. Residues say by how much at a mode: those of real
modes are real, and damping of any distribution turns them no further than it couples the modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.text.number_words import significant
from nmt_extract.judgement.thresholds import THRESHOLDS
from nmt_extract.linear.results import LinearMode
from nmt_signals.channel_faults.mains_lines import MAINS_HZ
from nmt_signals.frequency_responses import FrfEstimate

_LARGEST_PHASE = math.radians(80.0)  # up to which the uncertainty of a shape grows; it is then some times the shape


@dataclass(frozen=True, eq=False)
class DrivePoint:
    """Mobility at one exciter.

    Attributes:
        force, response: names of the channels.
        index: of the exciter.
        row: of the response among the outputs.
        frequency_hz: lines, Hz, shape ``(lines,)``.
        mobility: m/s/N, shape ``(lines,)``.
        phase_std: standard uncertainty of its phase, rad, shape ``(lines,)``.
    """

    force: str
    response: str
    index: int
    row: int
    frequency_hz: FloatArray
    mobility: ComplexArray
    phase_std: FloatArray

    @property
    def limit(self) -> FloatArray:
        """Of a phase beyond ±90°, from which the structure would give power, rad, shape ``(lines,)``."""
        return math.radians(THRESHOLDS.linear.active_phase_deg) + THRESHOLDS.linear.deviations * self.phase_std

    def near(self, frequency_hz: float) -> DrivePoint:
        """The lines within an octave of a mode at which 45° would be told."""
        use = np.abs(np.log2(self.frequency_hz / frequency_hz)) <= 1.0
        use &= self.limit < 0.25 * math.pi
        return replace(
            self,
            frequency_hz=self.frequency_hz[use],
            mobility=self.mobility[use],
            phase_std=self.phase_std[use],
        )

    def active_share(self, factor: ComplexArray | float = 1.0) -> float:
        """Share of the lines at which the structure would give power, after division by a factor of each line."""
        beyond = np.abs(np.angle(self.mobility / factor)) - 0.5 * math.pi
        return float(np.mean(beyond > self.limit)) if beyond.size else 0.0


def drive_points(
    frfs: Sequence[FrfEstimate], responses: Sequence[str], outputs: Sequence[str], powers: Sequence[int]
) -> list[DrivePoint]:
    """Mobilities at the exciters.

    Args:
        frfs: each force to the outputs.
        responses: channel at each exciter's point.
        outputs: names of the outputs.
        powers: of s from displacement to these channels.
    """
    points = []
    for index, (frf, name, power) in enumerate(zip(frfs, responses, powers, strict=True)):
        row = frf.outputs.index(name)
        coherence = np.clip(frf.coherence[row], 1e-6, 1.0 - 1e-9)
        std = np.sqrt((1.0 - coherence) / (2.0 * coherence * frf.independent_averages))
        mobility = frf.best[row] * (2j * np.pi * frf.frequency_hz) ** (1 - power)
        points.append(DrivePoint(frf.input, name, index, outputs.index(name), frf.frequency_hz, mobility, std))
    return points


def coupled_phases(mode: LinearMode, modes: Sequence[LinearMode]) -> FloatArray:
    """How far damping of any distribution may turn the residues of a mode, rad, shape ``(outputs, exciters)``.

    To first order mode s has the share i ω_r c_rs / (ω_r² − ω_s²) in mode r, and a damping matrix that is nowhere
    negative has |c_rs| ≤ 2 √(ζ_r ω_r ζ_s ω_s).
    """
    share = np.zeros(mode.products.shape)
    at_responses, at_forces = _sizes(mode)
    for other in modes:
        if other is mode:
            continue
        coupling = 2.0 * math.sqrt(mode.damping_ratio * mode.omega * other.damping_ratio * other.omega)
        mixing = coupling * mode.omega / max(abs(mode.omega**2 - other.omega**2), 1e-12 * mode.omega**2)
        responses, forces = _sizes(other)
        share += mixing * np.add.outer(responses / at_responses, forces / at_forces)
    return np.minimum(share, 0.5 * math.pi)


def _sizes(mode: LinearMode) -> tuple[FloatArray, FloatArray]:
    """Magnitudes of the shape at the outputs and at the forces, 1/√kg."""
    forces = np.maximum(np.abs(mode.drive_shapes), 1e-300)
    strongest = int(np.argmax(forces))
    return np.maximum(np.abs(mode.products[:, strongest]) / forces[strongest], 1e-300), forces


def residue_phases(mode: LinearMode) -> tuple[FloatArray, FloatArray]:
    """Phases of the residues against ±1, and their standard uncertainties, rad, shape ``(outputs, exciters)``."""
    phase = np.angle(mode.products)
    phase = phase - math.pi * np.round(phase / math.pi)
    return phase, mode.product_stds / np.maximum(np.abs(mode.products), 1e-300)


def with_phase_error(mode: LinearMode, modes: Sequence[LinearMode], drives: Sequence[int]) -> LinearMode:
    """Uncertainties of the shape widened by what its phases may hide.

    A channel that turns the phase by α takes nothing from the amplitude if it is late, and 1 − cos α if it is a high or
    low pass of first order; the shape in phase loses another 1 − cos of its phase.
    """
    phase = np.abs(residue_phases(mode)[0])
    beyond = np.clip(phase - coupled_phases(mode, modes), 0.0, _LARGEST_PHASE)
    lost = 1.0 / np.cos(beyond) - 1.0
    at_drives = np.array([lost[row, index] for index, row in enumerate(drives)])
    points = len(mode.shape)
    # φ_p is R_pd / √R_dd: it has the whole error of the one and half of the other.
    errors = np.hypot(lost[:points].max(axis=1), 0.5 * at_drives.max())
    # The drive point's value is √R_dd, in phase.
    return replace(
        mode,
        shape_std=np.hypot(mode.shape_std, errors * np.abs(mode.shape)),
        drive_shape_stds=np.hypot(mode.drive_shape_stds, at_drives * np.abs(mode.drive_shapes)),
    )


def phase_findings(
    modes: Sequence[LinearMode],
    kept: Sequence[LinearMode],
    left_out_hz: Sequence[float],
    points: Sequence[DrivePoint],
    outputs: Sequence[str],
) -> list[str]:
    """Sentences on channels whose phase no passive structure has.

    Args:
        modes: all that were found.
        kept: those to judge.
        left_out_hz: stable poles without a mode: within an octave of one damping may turn a residue as far as it likes.
        points: drive points.
        outputs: names of the outputs.
    """
    sentences = []
    named: set[str] = set()
    for point in points:
        for mode in sorted(kept, key=lambda mode: -abs(mode.products[point.row, point.index])):
            near = point.near(mode.frequency_hz)
            phase, std = residue_phases(mode)
            strong = (
                np.abs(mode.products[:, point.index]) > THRESHOLDS.linear.strong_share * np.abs(mode.products).max()
            )
            limit = (
                math.radians(THRESHOLDS.linear.phase_deg)
                + THRESHOLDS.linear.deviations * std
                + coupled_phases(mode, modes)
            )
            off = (np.abs(phase) > limit)[:, point.index] & strong
            angles = phase[:, point.index]
            enough = near.frequency_hz.size >= THRESHOLDS.linear.fewest_lines
            active = enough and near.active_share() > THRESHOLDS.linear.active_share
            if active and point.force not in named:
                angle = float(angles[point.row])
                together = [row for row in np.flatnonzero(strong) if abs(angles[row] - angle) < 0.3 * abs(angle)]
                count = int(np.count_nonzero(strong))
                shared = len(together) > 1 and len(together) > 0.5 * count
                alone = count > 1 and not shared
                sentences.append(_active_sentence(near, mode, angle, shared, alone))
                named |= {point.force, point.response}
            elif not active and all(abs(math.log2(left / mode.frequency_hz)) > 1.0 for left in left_out_hz):
                for row in map(int, np.flatnonzero(off)):
                    if row != point.row and outputs[row] not in named and point.force not in named:
                        named.add(outputs[row])
                        sentences.append(_turned_sentence(outputs[row], point, mode, float(angles[row])))
    return sentences


def _active_sentence(near: DrivePoint, mode: LinearMode, angle: float, shared: bool, alone: bool) -> str:
    share = near.active_share()
    causes = _causes(near, mode.frequency_hz, angle, "" if not (shared or alone) else "force" if shared else "response")
    return (
        f"Channels {near.force} and {near.response} at the drive point contradict each other: their mobility has a "
        f"negative real part at {100.0 * share:.0f} % of the lines around {mode.frequency_hz:.4g} Hz, as if the "
        f"structure gave power, and the mode there a phase of {math.degrees(angle):.3g}°; {causes}. Shapes are "
        "uncertain by that."
    )


def _causes(near: DrivePoint, frequency: float, angle: float, side: str) -> str:
    """What turns the phase so at the mode and leaves the fewest lines at which the structure would give power."""
    lead, late = (near.response, near.force) if angle > 0.0 else (near.force, near.response)
    size = max(abs(angle), 1e-6)
    delay = size / (2.0 * math.pi * frequency)
    high = frequency * math.tan(min(size, 1.55))
    low = frequency / math.tan(min(size, 1.55))
    f = near.frequency_hz
    turn = 1.0 if angle > 0.0 else -1.0
    shapes: list[tuple[str, str, Callable[[], FloatArray]]] = [
        (
            late,
            f"{late} is late by {significant(1e3 * delay, 3)} ms (delay_s: {significant(delay, 3)})",
            lambda: 2.0 * np.pi * f * delay,
        ),
        (
            lead,
            f"{lead} passes a high pass (AC coupling) at {significant(high, 3)} Hz (record it coupled to DC)",
            lambda: np.arctan(high / f),
        ),
        (
            late,
            f"{late} passes a low pass at {significant(low, 3)} Hz (record it with the filter of the others)",
            lambda: np.arctan(f / low),
        ),
    ]
    left = [near.active_share(np.exp(1j * turn * phase())) for _, _, phase in shapes]
    best = min(left)
    channel = {"force": near.force, "response": near.response}.get(side)
    likely = [
        (name, text)
        for (name, text, _), share in zip(shapes, left, strict=True)
        if share <= best + THRESHOLDS.linear.active_share
    ]
    chosen = [text for name, text in likely if channel in (None, name)] or [text for _, text in likely]
    return "either " + ", or ".join(chosen) if len(chosen) > 1 else chosen[0]


def _turned_sentence(name: str, point: DrivePoint, mode: LinearMode, angle: float) -> str:
    delay = abs(angle) / (2.0 * math.pi * mode.frequency_hz)
    if angle < 0.0:
        cause = f"late by {significant(1e3 * delay, 3)} ms (delay_s: {significant(delay, 3)}) or low-pass filtered"
    else:
        corner = significant(mode.frequency_hz * math.tan(min(angle, 1.55)), 3)
        cause = (
            f"early by {significant(1e3 * delay, 3)} ms (delay_s: {significant(-delay, 3)}) or AC coupled at {corner} "
            "Hz"
        )
    return (
        f"Channel {name} is turned by {math.degrees(angle):.3g}° against {point.response} at the drive point in the "
        f"mode at {mode.frequency_hz:.5g} Hz, more than damping can turn it: it is {cause}. The shape is uncertain by "
        "that."
    )


def hum_findings(frfs: Sequence[FrfEstimate], powers: FloatArray, modes: Sequence[LinearMode]) -> list[str]:
    """Sentences on lines of the mains in responses.

    Args:
        frfs: the forces to the outputs.
        powers: mean squares of the outputs by line, shape ``(outputs, lines)``.
        modes: those that were found.
    """
    frequency = frfs[0].frequency_hz
    spacing = float(frequency[1] - frequency[0])
    sentences = []
    for row, name in enumerate(frfs[0].outputs):
        coherent = np.max([frf.coherence[row] for frf in frfs], axis=0)
        apart = (1.0 - coherent) * powers[row]
        for mains in MAINS_HZ:
            near = np.abs(frequency - mains)
            if not frequency[0] < mains < frequency[-1] or spacing > THRESHOLDS.linear.hum_resolution_hz:
                continue
            clear = min(abs(mode.frequency_hz - mains) / (mode.damping_ratio * mains + spacing) for mode in modes)
            around = apart[(near > 4.0 * spacing) & (near < 16.0 * spacing)]
            line = float(apart[near < 1.5 * spacing].max())
            total = float(powers[row].sum())
            if (
                clear < 4.0
                or around.size < THRESHOLDS.linear.fewest_lines
                or line < THRESHOLDS.linear.hum_ratio * float(around.max())
            ):
                continue
            share = math.sqrt(line / total)
            if share > THRESHOLDS.linear.hum_share:
                sentences.append(
                    f"Channel {name} has a line at {mains:g} Hz that no force makes, about {100.0 * share:.2g} % of "
                    "its rms: hum of the mains; check shields and ground loops, and keep modes near it out."
                )
    return sentences
