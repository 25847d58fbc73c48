"""Uncertainty budget of modal points: every source that is known, propagated through the equations of the method.

After the Guide to the Expression of Uncertainty in Measurement (JCGM 100:2008, section 5 and annex G): independent
sources add in quadrature, the coverage factor follows from the effective degrees of freedom. A source is propagated by
evaluating the equations with its quantity changed by plus and minus one standard uncertainty; the root mean square of
both changes counts, which holds the second order where the first vanishes.

The equations are ``q = |Φ⁺ ψ̃₁|`` and ``δ̃ = P₁ / (ω̃³ q²)`` (method, eqs. 3 and 4).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus
from nmt_extract.judgement.student import two_sided_quantile
from nmt_extract.judgement.window_judge import phase_part
from nmt_record.exchange.sidecar.channel_tolerances import Tolerances

FORMAT = "nmt uncertainty budget 1"
COVERAGE = 0.95
UNITS = {"omega_rad_s": "rad/s", "damping_ratio": "1", "modal_amplitude": "m√kg", "force_n": "N"}
"""Quantities of the budget and their units."""

COLUMNS = ("level_index", "level", "quantity", "value", "source", "std")
"""Columns of ``uncertainty.csv``."""


class UncertaintySource(Enum):
    """Where an uncertainty comes from; the value is its name in reports."""

    NOISE = "noise"
    PHASE = "residual phase error"
    GAINS = "gains of the channels"
    PHASES = "phases of the channels"
    SHAPES = "linear shapes"
    CLOCK = "sampling clock"
    METHOD = "single-point excitation"
    REPEATS = "repeats of the level"


_WITHIN_WINDOW = (UncertaintySource.NOISE, UncertaintySource.PHASE)


@dataclass(frozen=True)
class MethodError:
    """By how much single-point phase resonance misses the nonlinear mode, as a run of the model shows.

    Attributes:
        modal_amplitude: m√kg, ascending, shape ``(n,)``.
        omega: relative deviation of ω̃, same shape.
        damping: relative deviation of δ̃, same shape.
    """

    modal_amplitude: FloatArray
    omega: FloatArray
    damping: FloatArray

    @classmethod
    def of(cls, points: Sequence[ModalPoint], expected: Callable[[float], tuple[float, float]]) -> MethodError | None:
        """From points of a simulated run and the nonlinear mode of the same rig.

        Args:
            points: of the run.
            expected: modal amplitude (m√kg) -> ω̃ (rad/s) and δ̃ of the mode; NaN outside.

        Returns:
            None where no point can be compared.
        """
        rows = []
        for point in points:
            if point.status is PointStatus.OK:
                omega, damping = expected(point.modal_amplitude)
                row = point.modal_amplitude, point.omega_rad_s / omega - 1.0, point.damping_ratio / damping - 1.0
                if all(math.isfinite(value) for value in row):
                    rows.append(row)
        if not rows:
            return None
        table = np.array(sorted(rows)).T
        return cls(table[0], np.abs(table[1]), np.abs(table[2]))

    def at(self, amplitude: float) -> tuple[float, float]:
        """Relative deviations of ω̃ and δ̃ at a modal amplitude (m√kg), without sign; the ends go on."""
        return (
            float(np.interp(amplitude, self.modal_amplitude, self.omega)),
            float(np.interp(amplitude, self.modal_amplitude, self.damping)),
        )


@dataclass(frozen=True)
class Budget:
    """Standard uncertainties of one quantity of a point, by source.

    Attributes:
        quantity: its name, see ``UNITS``.
        value: the estimate.
        parts: standard uncertainty by source, in the unit of the quantity; sources that are not known are absent.
        noise_degrees: degrees of freedom of the noise's estimate.
    """

    quantity: str
    value: float
    parts: Mapping[UncertaintySource, float]
    noise_degrees: float = 9.0

    @property
    def repeatability(self) -> float:
        """What a repeat of the window would scatter by."""
        return math.hypot(*(self.parts.get(source, 0.0) for source in _WITHIN_WINDOW))

    @property
    def total(self) -> float:
        """Combined standard uncertainty."""
        return math.hypot(*self.parts.values())

    @property
    def coverage_factor(self) -> float:
        """k for an interval of 95 %, Student's t at the effective degrees of freedom (Welch–Satterthwaite)."""
        noise, total = self.parts.get(UncertaintySource.NOISE, 0.0), self.total
        degrees = self.noise_degrees * (total / noise) ** 4 if noise > 0.0 and self.noise_degrees > 0.0 else math.inf
        return two_sided_quantile(max(degrees, 1.0), COVERAGE)

    @property
    def expanded(self) -> float:
        """Half of the interval of 95 %."""
        return self.coverage_factor * self.total


@dataclass(frozen=True)
class PointBudget:
    """Budgets of one point.

    Attributes:
        level_index, level, level_unit: of the point.
        budgets: by quantity.
    """

    level_index: int
    level: float
    level_unit: str
    budgets: Mapping[str, Budget]


@dataclass(frozen=True)
class BudgetInputs:
    """What is known of the measurement beyond its points.

    Attributes:
        linear: linear modes that were used.
        tolerances: of the channels.
        quantity: what the response sensors measure.
        method: None = not known.
        sub_windows: of the extraction, for the degrees of freedom of the noise.
    """

    linear: LinearDescription
    tolerances: Tolerances
    quantity: Quantity
    method: MethodError | None = None
    sub_windows: int = 10


def uncertainty_budget(points: Sequence[ModalPoint], inputs: BudgetInputs) -> list[PointBudget]:
    """Budgets of all points that have values, in their order."""
    repeats = _repeats(points)
    return [
        PointBudget(
            point.level_index, point.level, point.level_unit, _point_budgets(point, inputs, repeats.get(id(point), {}))
        )
        for point in points
        if point.status is PointStatus.OK
    ]


def _point_budgets(point: ModalPoint, inputs: BudgetInputs, repeats: Mapping[str, float]) -> dict[str, Budget]:
    parts = {name: {UncertaintySource.NOISE: float(getattr(point, f"{name}_std"))} for name in UNITS}
    damping = abs(point.damping_ratio)
    for name, phase in (
        ("damping_ratio", phase_part(point.phase_error) * damping),
        ("omega_rad_s", damping * point.omega_rad_s * math.hypot(point.phase_error, point.phase_error_std)),
    ):
        stated = parts[name][UncertaintySource.NOISE]
        # A balance of power corrects the frequency for the phase: nothing of it is in its uncertainty.
        if 0.0 < phase <= stated:
            parts[name] = {
                UncertaintySource.NOISE: math.sqrt(stated**2 - phase**2),
                UncertaintySource.PHASE: phase,
            }
    for source, changes in _changes(point, inputs):
        for name, change in changes.items():
            parts[name][source] = math.hypot(parts[name].get(source, 0.0), change)
    if inputs.method is not None:
        omega, damping = inputs.method.at(point.modal_amplitude)
        parts["omega_rad_s"][UncertaintySource.METHOD] = omega * point.omega_rad_s
        parts["damping_ratio"][UncertaintySource.METHOD] = damping * abs(point.damping_ratio)
    for name, spread in repeats.items():
        parts[name][UncertaintySource.REPEATS] = spread
    degrees = max(1, min(inputs.sub_windows, point.window_periods // 2) - 1)
    return {
        name: Budget(
            name, getattr(point, name), {s: v for s, v in own.items() if math.isfinite(v)}, float(degrees)
        )
        for name, own in parts.items()
    }  # fmt: skip


@dataclass(frozen=True)
class _Measured:
    """Arguments of the equations: P₁ over its value, ψ̃₁ (m) and Φ (1/√kg)."""

    power: float
    shape: Any
    linear: FloatArray

    def values(self, point: ModalPoint) -> dict[str, float]:
        """δ̃ and q."""
        amplitude = float(np.linalg.norm(np.linalg.pinv(self.linear) @ self.shape))
        damping = self.power * point.active_power / (point.omega_rad_s**3 * amplitude**2)
        return {"damping_ratio": damping, "modal_amplitude": amplitude}


def _changes(point: ModalPoint, inputs: BudgetInputs) -> Iterator[tuple[UncertaintySource, dict[str, float]]]:
    """Each source's changes of the quantities."""
    linear = inputs.linear
    matrix = linear.shape_matrix
    shape = np.asarray(point.shape_harmonics)[1]
    plain = _Measured(1.0, shape, matrix)
    base = plain.values(point)

    def spread(changed: Callable[[float], _Measured]) -> dict[str, float]:
        ends = [changed(sign).values(point) for sign in (1.0, -1.0)]
        return {name: math.sqrt(sum((end[name] - value) ** 2 for end in ends) / 2.0) for name, value in base.items()}

    together = linear.source == "test" and inputs.tolerances.same_sensors
    for kind, index in _channels(linear):
        place = linear.drive_point if index is None or kind is Quantity.FORCE else linear.points[index]
        tolerance = inputs.tolerances.of(kind or inputs.quantity, place)

        def gained(
            sign: float, kind: Quantity | None = kind, index: int | None = index, g: float = tolerance.gain
        ) -> Any:
            return _with_gain(plain, linear, kind, index, 1.0 + sign * g, together)

        changes = spread(gained)
        if kind is Quantity.FORCE:
            changes["force_n"] = tolerance.gain * point.force_n
        yield UncertaintySource.GAINS, changes
        angle = tolerance.phase_at(point.omega_rad_s)

        def turned(sign: float, kind: Quantity | None = kind, index: int | None = index, angle: float = angle) -> Any:
            return _with_phase(plain, linear, kind, index, sign * angle, point.phase_error)

        changes = spread(turned)
        if kind is Quantity.FORCE or _at_drive(linear, index):
            changes["omega_rad_s"] = abs(point.damping_ratio) * point.omega_rad_s * angle
        yield UncertaintySource.PHASES, changes
    for (row, mode), std in np.ndenumerate(np.array(linear.shape_stds or np.zeros_like(matrix))):
        if std > 0.0:

            def moved(sign: float, row: int = row, mode: int = mode, std: float = std) -> Any:
                other = matrix.copy()
                other[row, mode] += sign * std
                return _Measured(1.0, shape, other)

            yield UncertaintySource.SHAPES, spread(moved)
    clock = inputs.tolerances.clock
    if clock > 0.0:
        # A displacement from an acceleration takes the frequency's error twice.
        twice = {name: 2.0 * clock * abs(value) for name, value in base.items()}
        yield UncertaintySource.CLOCK, {"omega_rad_s": clock * point.omega_rad_s, **twice}


def _channels(linear: LinearDescription) -> Iterator[tuple[Quantity | None, int | None]]:
    """The force, every response of the shape by its row, and the drive-point response where it is none of them."""
    yield Quantity.FORCE, None
    for index in range(len(linear.points)):
        yield None, index
    if linear.drive_point not in linear.points:
        yield None, None


def _at_drive(linear: LinearDescription, index: int | None) -> bool:
    return index is None or linear.points[index] == linear.drive_point


def _with_gain(
    plain: _Measured, linear: LinearDescription, kind: Quantity | None, index: int | None, gain: float, together: bool
) -> _Measured:
    """The equations' arguments with one channel's gain changed.

    Shapes that the same sensors measured change too: a row by the gain of its sensor, their scale by the roots of the
    gains of drive-point response and force. Damping then hardly depends on gains, since both errors cancel.
    """
    force, drive = kind is Quantity.FORCE, kind is not Quantity.FORCE and _at_drive(linear, index)
    power = gain if force or drive else 1.0
    shape, matrix = plain.shape.copy(), plain.linear.copy()
    if index is not None and not force:
        shape[index] *= gain
        if together:
            matrix[index] *= gain
    if together and (force or drive):
        matrix /= math.sqrt(gain)
    return _Measured(power, shape, matrix)


def _with_phase(
    plain: _Measured, linear: LinearDescription, kind: Quantity | None, index: int | None, angle: float, error: float
) -> _Measured:
    """The equations' arguments with one channel's phase changed; the power goes with the cosine."""
    force, drive = kind is Quantity.FORCE, kind is not Quantity.FORCE and _at_drive(linear, index)
    power = math.cos(error + angle) / math.cos(error) if force or drive else 1.0
    shape = plain.shape.copy()
    if index is not None and not force:
        shape[index] *= complex(math.cos(angle), math.sin(angle))
    return _Measured(power, shape, plain.linear)


def _repeats(points: Sequence[ModalPoint]) -> dict[int, dict[str, float]]:
    """Scatter beyond the noise of levels that were visited more than once, by point."""
    groups: dict[tuple[str, str], list[ModalPoint]] = {}
    for point in points:
        if point.status is PointStatus.OK:
            groups.setdefault((f"{point.level:.9g}", point.level_unit), []).append(point)
    found: dict[int, dict[str, float]] = {}
    for group in groups.values():
        if len(group) < 2:
            continue
        for name in UNITS:
            values = [getattr(point, name) for point in group]
            noise = [getattr(point, f"{name}_std") for point in group]
            known = [value for value in noise if math.isfinite(value)]
            beyond = float(np.var(values, ddof=1)) - float(np.mean(np.square(known))) if known else 0.0
            for point in group:
                found.setdefault(id(point), {})[name] = math.sqrt(max(0.0, beyond))
    return found


def write_budget(budgets: Sequence[PointBudget], folder: Path | str, inputs: BudgetInputs) -> None:
    """Write ``uncertainty.csv`` (a line for each source) and ``uncertainty.json`` (everything).

    Raises:
        BenchError: a file cannot be written.
    """
    table: list[Sequence[object]] = [COLUMNS]
    for point in budgets:
        for name, budget in point.budgets.items():
            rows = [(source.name.lower(), std) for source, std in budget.parts.items()]
            rows += [("repeatability", budget.repeatability), ("total", budget.total), ("expanded_95", budget.expanded)]
            for source, std in rows:
                table.append([point.level_index, repr(point.level), name, repr(budget.value), source, repr(float(std))])
    document = {
        "format": FORMAT,
        "coverage": COVERAGE,
        "channels": _channel_list(inputs),
        "clock_std": inputs.tolerances.clock,
        "not_included": list(left_out(inputs)),
        "points": [_mapping(point) for point in budgets],
    }
    write_result(Path(folder) / "uncertainty.csv", csv_text(table))
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    write_result(Path(folder) / "uncertainty.json", text)


def read_totals(path: Path | str) -> dict[int, dict[str, float]]:
    """Total standard uncertainties of ``uncertainty.json``: number of the level -> name of the quantity -> total.

    Raises:
        BenchError: it cannot be read or is not such a file.
    """
    document = read_json(Path(path), "uncertainty budget")
    try:
        if document["format"] != FORMAT:
            raise ValueError(f"its format is '{document['format']}'")
        totals = {
            int(point["level_index"]): {name: float(it["total"]) for name, it in point["quantities"].items()}
            for point in document["points"]
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BenchError(f"{path} is not an uncertainty budget ('{FORMAT}'): {error}.") from error
    for of_level in totals.values():
        if "omega_rad_s" in of_level:
            of_level["frequency_hz"] = of_level["omega_rad_s"] / (2.0 * math.pi)
    return totals


def left_out(inputs: BudgetInputs) -> Iterator[str]:
    """Sentences on sources that the budget does not know."""
    if not any(gain or phase for _, gain, phase, _ in channel_tolerances_used(inputs)):
        yield "± does not include the calibration of the sensors: no tolerance of a channel is stated."
    if inputs.linear.source == "test" and not inputs.linear.shape_stds:
        yield "± does not include the uncertainty of the linear shapes: the bag was recorded without it."
    if inputs.method is None:
        points = len(inputs.linear.exciter_points)
        where = f"excitation at {points} points" if points > 1 else "single-point excitation"
        yield f"± does not include the error of {where}; './nmt extract --model-run DIR' adds it."


def channel_tolerances_used(inputs: BudgetInputs) -> list[tuple[str, float, float, str]]:
    """Channel, gain (relative), phase at the mode's frequency (rad) and source of each channel that counts."""
    linear, rows = inputs.linear, []
    omega = linear.frequencies_rad_s[linear.target_mode]
    for kind, index in _channels(linear):
        place = linear.drive_point if index is None else linear.points[index]
        quantity = kind or inputs.quantity
        own = inputs.tolerances.of(quantity, place)
        rows.append((f"{quantity.topic} {place}", own.gain, own.phase_at(omega), own.source))
    return rows


def _channel_list(inputs: BudgetInputs) -> list[dict[str, Any]]:
    return [
        {"channel": name, "gain_std": gain, "phase_std_rad": phase, "source": source}
        for name, gain, phase, source in channel_tolerances_used(inputs)
    ]


def _mapping(point: PointBudget) -> dict[str, Any]:
    return {
        "level_index": point.level_index,
        "level": point.level,
        "level_unit": point.level_unit,
        "quantities": {
            name: {
                "value": budget.value,
                "unit": UNITS[name],
                "sources": {source.name.lower(): std for source, std in budget.parts.items()},
                "repeatability": budget.repeatability,
                "total": budget.total,
                "coverage_factor": budget.coverage_factor,
                "expanded_95": budget.expanded,
            }
            for name, budget in point.budgets.items()
        },
    }
