"""Frequency responses that a measured backbone predicts, next to measured sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json as read_json_file
from nmt_core.files.whole_file import csv_text
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.curves.response_curve import ResponseCurve, is_of_curve, response_curves
from nmt_extract.curves.response_table import read_response_csv
from nmt_extract.curves.swept_response import FrequencyResponseTable
from nmt_extract.modal.table import read_json
from nmt_extract.synthesis.single_mode import (
    OtherModes,
    ResonanceError,
    Synthesis,
    SynthesisedBackbone,
    covers,
    resonance_error,
)

POINTS = 801
"""Frequencies of ``synthesis.csv`` where nothing else is asked for."""


@dataclass(frozen=True, eq=False)
class CurveError:
    """How far a synthesis lies from a measured response curve, at the measured amplitudes and lags.

    There the synthesis is explicit, on every branch and at folds: Ω from tan ϑ = 2 Ω ω̃ δ̃ / (ω̃² − Ω²), and the force
    from the modulus of its equation.

    Attributes:
        curve: the measured one.
        frequency_error: relative error of the synthesised frequency, NaN beyond the backbone, (points,).
        force_error: of the force, (points,).
    """

    curve: ResponseCurve
    frequency_error: FloatArray
    force_error: FloatArray

    @property
    def sentence(self) -> str:
        """What it is, for table and report."""
        known = np.isfinite(self.frequency_error)
        where = f"Response curve at {self.curve.level:g} {self.curve.level_unit}: "
        if not known.any():
            return f"{where}no point lies within the measured amplitudes of the backbone."
        unstable = int(np.count_nonzero(self.curve.stable[known] == 0.0))
        return (
            f"{where}{int(known.sum())} of {known.size} points lie within the backbone, {unstable} of them not stable; "
            f"the synthesis has their frequency within {100.0 * np.abs(self.frequency_error[known]).max():.2g} % and "
            f"their force within {100.0 * np.abs(self.force_error[known]).max():.2g} %."
        )


def compare_curve(backbone: SynthesisedBackbone, drive_point: int, curve: ResponseCurve) -> CurveError:
    """Errors of a synthesis along a measured response curve; see `CurveError`."""
    amplitude = np.array([point.modal_amplitude for point in curve.points])
    omega, damping, shape = backbone.at(amplitude)
    cotangent = 1.0 / np.tan(curve.lag)
    found = omega * (np.sqrt(1.0 + (damping * cotangent) ** 2) - damping * cotangent)
    drive = np.abs(shape[:, backbone.points.index(drive_point)])
    force = amplitude / drive * np.abs(omega**2 - found**2 + 2j * found * omega * damping)
    measured = 2.0 * math.pi * curve.frequency_hz
    return CurveError(curve, np.asarray(found / measured - 1.0), np.asarray(force / curve.force - 1.0))


@dataclass(frozen=True, eq=False)
class SynthesisResult:
    """What a backbone predicts.

    Attributes:
        backbone: the measured one.
        others: what the other linear modes add.
        inputs: the run's description of itself.
        synthesised: the synthesis by force, N.
        low_hz, high_hz: frequencies that were asked for, Hz.
        channels: responses shown: those measured at points of the backbone, else the acceleration of every point.
        tables: measured sweeps.
        comparisons: how far the synthesis of each channel lies from its sweep around the resonance.
        remarks: sentences on stretches for which the backbone says nothing.
        measured_curves: response curves of a run that it was compared with.
    """

    backbone: SynthesisedBackbone
    others: OtherModes
    inputs: Mapping[str, Any]
    synthesised: Mapping[float, Synthesis]
    low_hz: float
    high_hz: float
    channels: tuple[str, ...]
    tables: tuple[FrequencyResponseTable, ...]
    comparisons: tuple[tuple[FrequencyResponseTable, ResonanceError], ...]
    remarks: tuple[str, ...]
    measured_curves: tuple[CurveError, ...] = ()

    def curves(self, force: float) -> list[tuple[FloatArray, ComplexArray]]:
        """Frequency (Hz), shape ``(k,)``, and responses (SI units), ``(channels, k)``, of every curve at a force."""
        return _curves(self.synthesised[force], self.channels, self.low_hz, self.high_hz)

    def csv(self, points: int = POINTS) -> str:
        """Text of ``synthesis.csv``: one row a solution at evenly spaced frequencies, largest amplitude first.

        Raises:
            BenchError: fewer than 2 or more than 100,000 frequencies.
        """
        if not 2 <= points <= 100_000:
            raise BenchError(f"The number of frequencies (--points) must be 2 to 100000, got {points}.")
        parts = [f"a{point}_{part}" for point in self.backbone.points for part in ("real", "imag")]
        rows: list[list[object]] = [["force_n", "frequency_hz", "solution", "modal_amplitude", *parts]]
        for force, s in self.synthesised.items():
            for hertz in np.linspace(self.low_hz, self.high_hz, points):
                omega = 2.0 * math.pi * float(hertz)
                for number, (q, displacement) in enumerate(s.solutions(omega)):
                    values = -(omega**2) * displacement
                    parts = [repr(float(x)) for value in values for x in (value.real, value.imag)]
                    rows.append([repr(float(force)), repr(float(hertz)), number, repr(float(q)), *parts])
        return csv_text(rows)


def synthesise(
    backbone: Path | str,
    *,
    sweeps: Sequence[Path | str] = (),
    curves: Sequence[Path | str] = (),
    linear: Path | str | None = None,
    forces: Sequence[float] | None = None,
    low_hz: float | None = None,
    high_hz: float | None = None,
) -> SynthesisResult:
    """Frequency responses at held forces by single-nonlinear-mode theory, from a measured backbone.

    Args:
        backbone: ``modal.json`` of a run or an extraction, or its folder.
        sweeps: ``frf.csv`` of sweeps at held force to compare with, or their folders.
        curves: ``modal.json`` of runs along response curves at held force to compare with, or their folders.
        linear: ``linear.json`` for the other modes, or its folder; None = the linear modes that the run names.
        forces: N; None = those of sweeps and curves.
        low_hz, high_hz: frequencies, Hz; None = those of sweeps and curves.

    Raises:
        BenchError: files that are missing or do not go together, no force or no frequencies.

    Examples:
        >>> result = nmt.synthesise("out/demo", forces=[0.1, 0.5], low_hz=20.5, high_hz=22.5)
        >>> list(result.synthesised)
        [0.1, 0.5]
        >>> nmt.synthesise("out/demo", forces=[0.1])
        Traceback (most recent call last):
        nmt_core.errors.BenchError: Without a sweep (--sweep) the frequencies must be given: --from f1 --to f2 in Hz.
    """
    points, inputs = _backbone(Path(backbone))
    description, others = _others(None if linear is None else Path(linear), inputs, _points(points))
    measured = SynthesisedBackbone.from_points(points, others)
    tables = [table for path in sweeps for table in read_response_csv(_file(Path(path), "frf.csv"))]
    for table in tables:
        if table.level_unit != "N":
            raise BenchError(
                f"The sweep at {table.level:g} {table.level_unit} held no force, so it cannot be compared; sweep with "
                "'--control force'."
            )
    followed = [curve for path in curves for curve in _curves_of(Path(path))]
    levels = [table.level for table in tables] + [curve.level for curve in followed]
    held = list(dict.fromkeys(levels)) if forces is None else list(forces)
    if not held:
        raise BenchError(
            "Nothing says at which force to synthesise; give a sweep (--sweep SWEEP_OUT) or forces (--levels F)."
        )
    low, high = _frequencies(
        low_hz, high_hz, [*(table.frequency_hz for table in tables), *(curve.frequency_hz for curve in followed)]
    )
    synthesised = {force: Synthesis(measured, description.drive_point, others, force) for force in held}
    remarks = [line for s in synthesised.values() for line in s.gaps(2 * math.pi * low, 2 * math.pi * high)]
    channels = _channels(tables, measured.points)
    return SynthesisResult(
        measured,
        others,
        inputs,
        synthesised,
        low,
        high,
        tuple(channels),
        tuple(tables),
        tuple(_compare(tables, synthesised, channels)),
        tuple(remarks),
        tuple(compare_curve(measured, description.drive_point, curve) for curve in followed),
    )


def _curves_of(path: Path) -> tuple[ResponseCurve, ...]:
    """Response curves at held force of a results folder.

    Raises:
        BenchError: there are none.
    """
    points, _ = read_json(_file(path, "modal.json"))
    found = tuple(curve for curve in response_curves(points) if curve.holds_force) if is_of_curve(points) else ()
    if not found:
        raise BenchError(
            f"{path} holds no response curve at a held force; give the results of "
            "'./nmt run RIG --kind response_curve'."
        )
    return found


def _backbone(path: Path) -> tuple[list[ModalPoint], dict[str, Any]]:
    """Points and inputs of ``modal.json``, once the run next to it has been asked what drove it.

    Raises:
        BenchError: a damaged file, or a test of which nothing can be synthesised.
    """
    file = _file(path, "modal.json")
    run_file = file.with_name("run.json")
    if run_file.is_file():
        run = read_json_file(run_file, "run record")
        refusal = covers(DrivenTest.of_run(run if isinstance(run, dict) else None, None))
        if refusal:
            raise BenchError(f"{file} is not a backbone: {refusal}")
    return read_json(file)


def backbone_of_run(backbone: Path, linear: Path | None = None) -> tuple[SynthesisedBackbone, LinearDescription]:
    """The backbone of a results folder (or ``modal.json``) as it was measured, and the linear description it used.

    Raises:
        BenchError: files that are missing or do not go together, or fewer than two levels that locked.
    """
    points, inputs = _backbone(backbone)
    description, _ = _others(linear, inputs, _points(points))
    return SynthesisedBackbone.from_points([point for point in points if not point.force_order]), description


def _frequencies(low: float | None, high: float | None, of: Sequence[FloatArray]) -> tuple[float, float]:
    measured = [float(f) for hertz in of for f in (hertz.min(), hertz.max())]
    low = low if low is not None else min(measured, default=math.nan)
    high = high if high is not None else max(measured, default=math.nan)
    if math.isnan(low) or math.isnan(high):
        raise BenchError("Without a sweep (--sweep) the frequencies must be given: --from f1 --to f2 in Hz.")
    if not 0 < low < high < math.inf:
        raise BenchError(
            f"The lower frequency (--from) must be below the upper one (--to) and both positive, got {low:g} and "
            f"{high:g} Hz."
        )
    return low, high


def _file(path: Path, name: str) -> Path:
    return path / name if path.is_dir() else path


def _points(points: Sequence[Any]) -> tuple[int, ...]:
    for point in points:
        if point.points:
            return tuple(point.points)
    raise BenchError("This run has no locked level, so a backbone is missing.")


def _others(path: Path | None, inputs: dict[str, Any], points: Sequence[int]) -> tuple[LinearDescription, OtherModes]:
    """Linear description and what the other modes add."""
    if path is None:
        known = inputs.get("linear")
        if not isinstance(known, dict):
            raise BenchError("The run does not say which linear modes it used; give --linear FILE.")
        linear = LinearDescription.from_mapping(known)
        return linear, OtherModes.from_modes(linear, points)
    values = read_json_file(_file(path, "linear.json"), "linear description")
    return LinearDescription.from_mapping(values), OtherModes.from_file(values, points)


def _channels(tables: Sequence[FrequencyResponseTable], points: Sequence[int]) -> list[str]:
    """Response channels to show: those measured at points of the backbone, else acceleration everywhere."""
    measured = [name for table in tables[:1] for name in table.channels if int(name[1:]) in points]
    return measured or [f"a{point}" for point in points]


def _factor(channel: str, omega: Any) -> Any:
    return {"a": -(omega**2), "v": 1j * omega, "x": 1.0 + 0.0 * omega}[channel[0]]


def _curves(s: Synthesis, channels: Sequence[str], low: float, high: float) -> list[tuple[FloatArray, ComplexArray]]:
    """Frequency (Hz) and responses (channels, k) of every curve within the frequencies."""
    found = []
    for curve in s.curves:
        hertz = curve.omega_rad_s / (2.0 * math.pi)
        inside = (hertz >= low) & (hertz <= high)
        rows = [
            _factor(name, curve.omega_rad_s) * curve.displacement[:, s.backbone.points.index(int(name[1:]))]
            for name in channels
        ]
        if np.any(inside):
            found.append((hertz[inside], np.stack(rows)[:, inside]))
    return found


def _compare(
    tables: Sequence[FrequencyResponseTable], synthesised: dict[float, Synthesis], channels: Sequence[str]
) -> list[tuple[FrequencyResponseTable, ResonanceError]]:
    found = []
    for table in tables:
        s = synthesised.get(table.level)
        if s is None or not s.curves:
            continue
        omega = 2.0 * math.pi * table.frequency_hz
        values = s.response(omega, "sweep")
        low, high = float(table.frequency_hz.min()), float(table.frequency_hz.max())
        curves = _curves(s, channels, low, high)
        if not curves:
            reach = [float(f) / (2.0 * math.pi) for curve in s.curves for f in curve.omega_rad_s]
            raise BenchError(
                f"The sweep at {table.level:g} N goes from {low:.4g} to {high:.4g} Hz, where the backbone gives no "
                f"response: its own goes from {min(reach):.4g} to {max(reach):.4g} Hz; sweep through that."
            )
        for row, channel in enumerate(channels):
            if channel not in table.channels:
                continue
            column = s.backbone.points.index(int(channel[1:]))
            measured = table.frf[table.channels.index(channel)] * table.force_n
            hertz = np.concatenate([curve[0] for curve in curves])
            modulus = np.abs(np.concatenate([curve[1][row] for curve in curves]))
            computed = _factor(channel, omega) * values[:, column]
            error = resonance_error(channel, table.frequency_hz, measured, computed, (hertz, modulus))
            found.append((table, error))
    return found
