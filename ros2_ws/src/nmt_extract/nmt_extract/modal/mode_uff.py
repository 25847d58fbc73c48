"""Modes and geometry as a universal file: data sets 15 (nodes), 82 (trace line) and 55 (mode shapes).

Numbers have six digits, as the format asks. A linear mode is a normal mode (analysis type 2) of modal mass 1 kg. A
level of a nonlinear test is a complex mode (type 3) with the eigenvalue −δ̃ω̃ ± iω̃√(1 − δ̃²) and the shape φ̃₁ of modal
mass 1 kg, hence modal a = 2iω̃√(1 − δ̃²).
"""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import writing
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus

_DISPLACEMENT = 8
_STRUCTURAL, _THREE_TRANSLATIONS = 1, 2


def linear_modes(linear: LinearDescription) -> list[dict[str, Any]]:
    """Data sets 55 of the modes of a linear description.

    Args:
        linear: points and mass-normalised shapes.
    """
    return [
        {
            **_common(f"mode {number + 1}, {omega / (2 * math.pi):.6g} Hz", number + 1, linear.points),
            "analysis_type": 2,
            "freq": omega / (2.0 * math.pi),
            "modal_m": 1.0,
            "modal_damp_vis": damping,
            "modal_damp_his": 0.0,
            **_along_z(np.array([row[number] for row in linear.shapes])),
        }
        for number, (omega, damping) in enumerate(zip(linear.frequencies_rad_s, linear.damping_ratios, strict=True))
    ]


def level_modes(points: Sequence[ModalPoint]) -> list[dict[str, Any]]:
    """Data sets 55 of the levels of a nonlinear test; levels without values are left out.

    Args:
        points: of the test.
    """
    sets = []
    for number, point in enumerate(points):
        if point.status != PointStatus.OK:
            continue
        oscillation = 1j * point.omega_rad_s * math.sqrt(1.0 - point.damping_ratio**2)
        text = f"level {point.level:.6g} {point.level_unit}, modal amplitude {point.modal_amplitude:.6g} m sqrt(kg)"
        sets.append(
            {
                **_common(text, number + 1, point.points),
                "analysis_type": 3,
                "eig": -point.damping_ratio * point.omega_rad_s + oscillation,
                "modal_a": 2.0 * oscillation,
                "modal_b": 0.0j,
                **_along_z(np.asarray(point.normalised_shape, dtype=np.complex128)),
            }
        )
    return sets


def write_mode_uff(
    path: Path, modes: Sequence[Mapping[str, Any]], positions: Mapping[int, float] | None = None
) -> None:
    """Write nodes, a line through them and the modes.

    Args:
        path: the file.
        modes: of :func:`linear_modes` or :func:`level_modes`.
        positions: x of points, m; a point without one gets its number.

    Raises:
        BenchError: no mode exists, or the file cannot be written.
    """
    if not modes:
        raise BenchError("The test has no mode to export.")
    import pyuff

    nodes = sorted({int(number) for mode in modes for number in mode["node_nums"]})
    places = positions or {}
    x = [float(places.get(node, node)) for node in nodes]
    still = [0.0] * len(nodes)
    geometry = [
        {
            "type": 15,
            "node_nums": nodes,
            "def_cs": [0] * len(nodes),
            "disp_cs": [0] * len(nodes),
            "color": [1] * len(nodes),
            "x": x,
            "y": still,
            "z": still,
        },
        {
            "type": 82,
            "trace_num": 1,
            "n_nodes": len(nodes),
            "color": 1,
            "id": "points in order",
            "nodes": np.array(nodes),
        },
    ]
    with writing(path), contextlib.redirect_stdout(io.StringIO()):  # pyuff prints what it does
        path.unlink(missing_ok=True)
        pyuff.UFF(str(path)).write_sets([*geometry, *(dict(mode) for mode in modes)], "overwrite")


def _common(text: str, number: int, points: Sequence[int]) -> dict[str, Any]:
    return {
        "type": 55,
        "id1": text,
        "model_type": _STRUCTURAL,
        "data_ch": _THREE_TRANSLATIONS,
        "spec_data_type": _DISPLACEMENT,
        "load_case": 1,
        "mode_n": number,
        "node_nums": [int(point) for point in points],
    }


def _along_z(shape: np.ndarray[Any, np.dtype[Any]]) -> dict[str, Any]:
    """Lateral displacement is along z, as for the channels of a time record."""
    still = np.zeros_like(shape)
    return {"r1": still, "r2": still, "r3": shape}
