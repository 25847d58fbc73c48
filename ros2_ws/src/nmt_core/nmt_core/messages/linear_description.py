"""What phase-locked loop and extraction need to know of the linear system, as plain numbers.

It comes from a model (simulated rigs) or from a linear modal test (any rig), travels as JSON in node parameters, in
the bag's start record and in ``linear.json``, and reads back to the same bits.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value
from nmt_core.numerics.arrays import FloatArray

TEST_KEYS = frozenset(
    (
        "uncertainties",
        "residuals",
        "target_residuals",
        "band_hz",
        "estimator",
        "fit",
        "mass_estimate",
        "quality",
    )
)
"""What ``linear.json`` of a linear modal test says beyond the description; passed over here."""


_LARGEST = {
    "frequencies_rad_s": 1e8,
    "damping_ratios": 10.0,
    "shapes": 1e6,
    "drive_point_shape": 1e6,
    "plant_frequency_rad_s": 1e8,
    "plant_damping_ratio": 10.0,
    "moving_mass_kg": 1e6,
    "force_per_volt": 1e12,
    "displacement_per_volt": 1e6,
}
"""What no structure on a shaker exceeds, in the units of the attributes."""
_FORMS = ("a number", "a list of numbers", "a list of lists of numbers, one for each point")
_DIMENSIONS = {"frequencies_rad_s": 1, "damping_ratios": 1, "shapes": 2}
_NOT_NEGATIVE = ("frequencies_rad_s", "plant_frequency_rad_s")


@dataclass(frozen=True)
class LinearDescription:
    """Linear modes at the response points, and the drive point with the exciter attached.

    Attributes:
        source: ``model`` or ``test``.
        drive_point: measurement point of the exciter.
        target_mode: index of the mode under test.
        points: response points, in the order of the rows of ``shapes``.
        frequencies_rad_s: linear modal frequencies of the structure without exciter, rad/s, ascending.
        damping_ratios: modal damping ratios of the structure, 1.
        shapes: mass-normalised mode shapes Φ, 1/√kg, ``shapes[point][mode]``.
        drive_point_shape: target mode at the drive point, 1/√kg.
        plant_frequency_rad_s: frequency of the target mode with the exciter attached, rad/s.
        plant_damping_ratio: its damping ratio, 1.
        moving_mass_kg: moving mass of the exciter, kg.
        force_per_volt: fundamental force at linear phase resonance, N/V; NaN if not known.
        displacement_per_volt: drive-point displacement there, m/V; NaN if not known.
        shape_stds: standard uncertainties of ``shapes``, 1/√kg; empty if not known.
        force_per_volt_rows: force per volt of drive over frequency as a test has measured it, rows of frequency (Hz),
            real and imaginary part (N/V), ascending; empty if not known.
        exciter_points: points of several exciters, the drive point first; empty = one.
        exciter_force_rows: force at every exciter per volt of every exciter, rows of frequency (Hz) and the matrix row
            by row as real and imaginary parts (N/V), ascending; for several exciters.
    """

    source: str
    drive_point: int
    target_mode: int
    points: tuple[int, ...]
    frequencies_rad_s: tuple[float, ...]
    damping_ratios: tuple[float, ...]
    shapes: tuple[tuple[float, ...], ...]
    drive_point_shape: float
    plant_frequency_rad_s: float
    plant_damping_ratio: float
    moving_mass_kg: float
    force_per_volt: float = math.nan
    displacement_per_volt: float = math.nan
    shape_stds: tuple[tuple[float, ...], ...] = ()
    force_per_volt_rows: tuple[tuple[float, float, float], ...] = ()
    exciter_points: tuple[int, ...] = ()
    exciter_force_rows: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        modes = len(self.frequencies_rad_s)
        if not self.points or not modes or len(self.damping_ratios) != modes:
            raise BenchError("The linear description needs at least one point and a damping ratio for every mode.")
        if len(self.shapes) != len(self.points) or any(len(row) != modes for row in self.shapes):
            raise BenchError(
                f"The linear description's shapes must have {len(self.points)} rows (points) of {modes} modes each."
            )
        if self.shape_stds and [len(row) for row in self.shape_stds] != [modes] * len(self.points):
            raise BenchError(
                f"The linear description's shape_stds must have {len(self.points)} rows (points) of {modes} modes each."
            )
        if self.exciter_points and self.exciter_points[0] != self.drive_point:
            raise BenchError(
                f"The linear description's exciter_points must begin with its drive point {self.drive_point}, got "
                f"{', '.join(map(str, self.exciter_points))}."
            )
        if not 0 <= self.target_mode < modes:
            raise BenchError(f"The linear description's target_mode must be below {modes}, got {self.target_mode}.")

    @property
    def shape_matrix(self) -> FloatArray:
        """Φ, shape ``(points, modes)``, 1/√kg."""
        return np.array(self.shapes, dtype=np.float64)

    @property
    def frequency_hz(self) -> float:
        """Frequency of the target mode, Hz."""
        return self.frequencies_rad_s[self.target_mode] / (2.0 * math.pi)

    def to_json(self) -> str:
        """JSON text; NaN becomes null."""
        values = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(self).items()}
        values["shape_stds"] = [[None if math.isnan(x) else x for x in row] for row in self.shape_stds]
        for name in ("force_per_volt_rows", "exciter_points", "exciter_force_rows"):
            if not values[name]:
                del values[name]
        return json.dumps(values)

    @classmethod
    def from_mapping(cls, values: dict[str, Any]) -> LinearDescription:
        """Build from parsed JSON, also of a whole ``linear.json`` (see ``TEST_KEYS``).

        Raises:
            BenchError: a key is missing, unknown or of the wrong kind.
        """
        try:
            data = {key: value for key, value in values.items() if key not in TEST_KEYS}
            for key in ("points", "frequencies_rad_s", "damping_ratios"):
                data[key] = tuple(data[key])
            data["shapes"] = tuple(tuple(float(x) for x in row) for row in data["shapes"])
            data["shape_stds"] = _stds(values)
            data["force_per_volt_rows"] = _force_rows(values.get("force_per_volt_rows") or ())
            data["exciter_points"] = tuple(values.get("exciter_points") or ())
            data["exciter_force_rows"] = _matrix_rows(values.get("exciter_force_rows") or (), data["exciter_points"])
            for key in ("force_per_volt", "displacement_per_volt"):
                if data.get(key) is None:
                    data[key] = math.nan
            _check_magnitudes(data)
            return cls(**data)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise BenchError(f"The linear description is not complete or not well-formed: {error}.") from error

    @classmethod
    def from_json(cls, text: str) -> LinearDescription:
        """Build from JSON text.

        Raises:
            BenchError: not JSON, or as :meth:`from_mapping`.
        """
        values = json_value(text, "The linear description")
        if not isinstance(values, dict):
            raise BenchError("The linear description must be a JSON object.")
        return cls.from_mapping(values)


def _stds(values: dict[str, Any]) -> tuple[tuple[float, ...], ...]:
    """Uncertainties of the shapes: those of a linear test stand in an entry of their own."""
    test = values.get("uncertainties")
    rows = values.get("shape_stds") or (test.get("shapes") if isinstance(test, dict) else None) or ()
    return tuple(tuple(math.nan if x is None else float(x) for x in row) for row in rows)


def _force_rows(rows: Any) -> tuple[tuple[float, float, float], ...]:
    """Rows of three finite numbers with ascending frequency; TypeError, ValueError or BenchError otherwise."""
    found = tuple((float(frequency), float(real), float(imag)) for frequency, real, imag in rows)
    largest = _LARGEST["force_per_volt"]
    if not all(abs(x) <= largest for row in found for x in row) or any(b[0] <= a[0] for a, b in pairwise(found)):
        raise BenchError(
            "The linear description's force_per_volt_rows must be rows of frequency, real and imaginary part with "
            "ascending frequency."
        )
    return found


def _matrix_rows(rows: Any, points: tuple[Any, ...]) -> tuple[tuple[float, ...], ...]:
    """Rows of 1 + 2 N² finite numbers with ascending frequency; TypeError, ValueError or BenchError otherwise."""
    if any(not isinstance(point, int) for point in points):
        raise TypeError("exciter_points must be whole numbers")
    found = tuple(tuple(float(value) for value in row) for row in rows)
    largest, length = _LARGEST["force_per_volt"], 1 + 2 * len(points) ** 2
    good = all(len(row) == length and all(abs(x) <= largest for x in row) for row in found)
    if not good or any(b[0] <= a[0] for a, b in pairwise(found)) or (len(points) > 1 and not found):
        raise BenchError(
            f"The linear description's exciter_force_rows must be rows of {length} numbers for {len(points)} exciters, "
            "with ascending frequency."
        )
    return found


def _check_magnitudes(values: dict[str, Any]) -> None:
    """Refuse numbers of no structure, and what is not a number; NaN only where it means that a value is not known."""
    for key, largest in _LARGEST.items():
        if key not in values:
            continue
        numbers = np.array(values[key])  # of lists of unequal lengths a ValueError
        dimensions = _DIMENSIONS.get(key, 0)
        if numbers.ndim != dimensions or (numbers.size and numbers.dtype.kind not in "iuf"):
            raise TypeError(f"{key} must be {_FORMS[dimensions]}")
        known = numbers[~np.isnan(numbers)] if key in ("force_per_volt", "displacement_per_volt") else numbers.ravel()
        bad = known[~(np.abs(known) <= largest)]
        if bad.size:
            raise BenchError(
                f"The linear description's {key} has the value {bad[0]:g}, beyond {largest:g}; is the file damaged or "
                "in other units?"
            )
        if key in _NOT_NEGATIVE and np.any(known < 0.0):
            raise BenchError(f"The linear description's {key} must not be negative, got {known.min():g}.")
    if any(not isinstance(point, int) for point in (*values["points"], values["drive_point"], values["target_mode"])):
        raise TypeError("points, drive_point and target_mode must be whole numbers")
