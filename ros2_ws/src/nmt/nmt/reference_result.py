"""Results of a reference: the curve of the nonlinear mode and its shapes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt.results import _LABELS, _TAU, Results, _axes, _xarray
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.numerics.arrays import FloatArray
from nmt_report.run_data import ReferenceCurve, read_reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nmt_rig.reference import PointShapes


@dataclass(frozen=True, repr=False)
class ReferenceResult(Results):
    """A computed backbone.

    Attributes:
        curve: ω̃ and δ̃ over q.
        shapes: φ̃ₙ next to it; None where there is no ``shapes.csv``.
    """

    curve: ReferenceCurve
    shapes: PointShapes | None = None

    @classmethod
    def read(cls, folder: Path) -> ReferenceResult:
        """Read ``reference.csv``, and ``shapes.csv`` where there is one.

        Raises:
            BenchError: damaged, or the two files have other amplitudes.
        """
        curve = read_reference(folder / "reference.csv")
        table = folder / "shapes.csv"
        return cls(folder, curve, _read_shapes(table, curve.modal_amplitude) if table.is_file() else None)

    def rows(self) -> list[dict[str, Any]]:
        """One row a point of the curve."""
        curve = self.curve
        return [
            {
                "modal_amplitude": float(q),
                "omega_rad_s": float(omega),
                "frequency_hz": float(omega) / _TAU,
                "damping_ratio": float(damping),
            }
            for q, omega, damping in zip(curve.modal_amplitude, curve.omega_rad_s, curve.damping_ratio, strict=True)
        ]

    def to_xarray(self) -> Any:
        """The curve as an ``xarray.Dataset`` over ``modal_amplitude``; shapes over it, ``order`` and ``point``.

        Raises:
            BenchError: xarray is not installed.
        """
        curve = self.curve
        data: dict[str, Any] = {
            "omega_rad_s": ("modal_amplitude", curve.omega_rad_s),
            "frequency_hz": ("modal_amplitude", curve.omega_rad_s / _TAU),
            "damping_ratio": ("modal_amplitude", curve.damping_ratio),
        }
        coordinates: dict[str, Any] = {"modal_amplitude": curve.modal_amplitude}
        if self.shapes is not None:
            data["shape_harmonics"] = (("modal_amplitude", "order", "point"), self.shapes.shape)
            coordinates |= {"order": list(self.shapes.orders), "point": list(self.shapes.points)}
        return _xarray().Dataset(data, coordinates, {"folder": str(self.folder)})

    def plot(self, y: str = "frequency_hz", axes: Axes | None = None, **style: Any) -> Axes:
        """The curve over modal amplitude; ``y``: ``frequency_hz``, ``omega_rad_s`` or ``damping_ratio``.

        Raises:
            BenchError: no such property exists.
        """
        rows = self.rows()
        if y not in rows[0]:
            raise BenchError(f"A reference has no property '{y}'; it has {', '.join(rows[0])}.")
        drawn = _axes(axes)
        values = [row[y] for row in rows]
        drawn.semilogx(self.curve.modal_amplitude, values, **{"color": "black", "label": self.curve.label, **style})
        drawn.set_xlabel(_LABELS["modal_amplitude"])
        drawn.set_ylabel(_LABELS.get(y, y))
        return drawn


def _read_shapes(path: Path, amplitudes: FloatArray) -> PointShapes:
    """The shapes of ``shapes.csv`` at the amplitudes of the curve, shape ``(k,)``."""
    from nmt_rig.reference import PointShapes

    table = _shapes_table(path)
    orders, points = np.unique(table["order"]), np.unique(table["point"])
    rows = np.lexsort((table["point"], table["order"], table["modal_amplitude"]))
    expected = np.repeat(amplitudes, orders.size * points.size)
    if expected.size != rows.size or not np.allclose(table["modal_amplitude"][rows], expected, rtol=1e-9, atol=0.0):
        raise BenchError(f"{path} does not fit reference.csv next to it; compute both again with './nmt reference'.")
    values = (table["real"] + 1j * table["imaginary"])[rows].reshape(amplitudes.size, orders.size, points.size)
    return PointShapes(tuple(map(int, points)), tuple(map(int, orders)), values)


def _shapes_table(path: Path) -> dict[str, FloatArray]:
    """Columns of a table of numbers."""
    names = ("modal_amplitude", "order", "point", "real", "imaginary")
    lines = read_text(path, "table of shapes").splitlines()
    try:
        if tuple(lines[0].split(",")) != names:
            raise ValueError
        values = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]]).reshape(-1, len(names))
    except (ValueError, IndexError) as error:
        raise BenchError(f"{path} is not a table with the columns {', '.join(names)}.") from error
    return dict(zip(names, values.T, strict=True))
