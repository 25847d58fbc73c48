"""Generic sources at every place of a rig: what an unnamed effect there could do to the observables.

A source has an amplitude for every level, order and quadrature. Physical effects change smoothly from level to level
(and from line to line), and most act on some orders only: odd ones, even ones, the fundamental alone, or linearly on
everything. Each of these families competes on its own; a place's evidence is their mean.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_diagnose.evidence.observables import Evidence
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.generic_source import SourceScore, source_score
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.residual_map import channels_of
from nmt_diagnose.twin.forward import Forward, Prediction
from nmt_rig.rig import ElementSection, Rig

_NAME = re.compile(r"(?P<kind>level|line) (?P<number>\d+)(?: order (?P<order>\d+))?(?: (?P<part>re|im))?(?P<rest>.*)$")
# Range of ln(level) and ln(line) over which a source keeps its size.
_LEVEL_LENGTH, _LINE_LENGTH = 1.5, 0.7
_KEPT = 0.01
_FAMILIES: tuple[tuple[str, tuple[int, ...], bool], ...] = (
    ("fundamental", (1,), False),
    ("odd orders", (1, 3, 5), False),
    ("even orders", (0, 2, 4), False),
    ("linear", (1,), True),
)


@dataclass(frozen=True)
class Place:
    """A place with the smooth responses to sources there.

    Attributes:
        place: place of the verdict.
        detail: point, channel or coordinate.
        families: name and whitened columns (m, s) of each family of sources.
    """

    place: str
    detail: str
    families: tuple[tuple[str, FloatArray], ...]


def places(forward: Forward, rig: Rig, prediction: Prediction, problem: Problem) -> list[Place]:
    """Places where an unnamed source may sit, with what it could do.

    Args:
        forward: the model.
        rig: rig of ``prediction``.
        prediction: solution about which the sources are small.
        problem: evidence and how it is whitened.
    """
    evidence = problem.evidence
    channels = {c.name for test in evidence.tests for c in channels_of(test)}
    forces = {c.name for test in evidence.tests for c in channels_of(test) if c.quantity.name == "FORCE"}
    wanted = [("structure", str(point), f"structure:{point}") for point in rig.structure.points]
    wanted += [("joint", element.name or f"element {k + 1}", f"joint:{k}") for k, element in _joints(rig)]
    wanted += [("boundary", "clamp", "clamp"), ("exciter", "", "exciter"), ("force_sensor", "", "force_sensor")]
    wanted += [("response_sensor", name, f"response_sensor:{name}") for name in sorted(channels - forces)]
    wanted += [("controller", "", "controller"), ("time", "", "time")]
    result = []
    for place, detail, key in wanted:
        columns, names = forward.influence(rig, prediction, key)
        whitened = np.nan_to_num(problem.whitened(columns), posinf=0.0, neginf=0.0)
        families = _families(whitened, names, evidence) if place != "time" else (("drift", whitened),)
        families = tuple((name, block) for name, block in families if block.shape[1] and np.any(block))
        if families:
            result.append(Place(place, detail, families))
    return result


def generic_sources(fit: Fit, found: Sequence[Place], calibrated: int | None = None) -> list[SourceScore]:
    """Evidence for a source at each place, on top of a fitted model.

    Args:
        fit: the fit.
        found: places.
        calibrated: its parameters that the model has; None = all.
    """
    result = []
    for item in found:
        scored = [source_score(fit, block, item.place, item.detail, calibrated) for _, block in item.families]
        gains = np.array([score.gain for score in scored])
        mean = float(np.logaddexp.reduce(gains) - np.log(gains.size))
        best = scored[int(np.argmax(gains))]
        result.append(SourceScore(item.place, item.detail, mean, best.explained, best.freedom))
    return result


def _joints(rig: Rig) -> list[tuple[int, ElementSection]]:
    """Local elements with friction, numbered as the nonlinear coordinates that they act on."""
    friction = ("jenkins", "iwan", "tanh_friction")
    return [(k, element) for k, element in enumerate(rig.local_elements) if element.kind in friction]


def _families(columns: FloatArray, names: Sequence[str], evidence: Evidence) -> tuple[tuple[str, FloatArray], ...]:
    """Columns of single levels and lines, combined to smooth courses."""
    level_groups: dict[tuple[str, int], list[tuple[int, int]]] = {}
    line_groups: dict[str, list[tuple[int, int]]] = {}
    for position, name in enumerate(names):
        match = _NAME.search(name)
        if match is None:
            continue
        key = name[: match.start()] + str(match["part"]) + match["rest"]
        if match["kind"] == "level":
            order = int(match["order"] or 1)
            level_groups.setdefault((key, order), []).append((int(match["number"]), position))
        else:
            line_groups.setdefault(key, []).append((int(match["number"]), position))
    drive = {key: _logs(evidence, [n for n, _ in members], True) for key, members in level_groups.items()}
    smooth = {
        key: _smooth(columns[:, [p for _, p in members]], drive[key], _LEVEL_LENGTH)
        for key, members in level_groups.items()
    }
    shared = {key: columns[:, [p for _, p in members]].sum(axis=1)[:, None] for key, members in level_groups.items()}
    lines = [
        _smooth(columns[:, [p for _, p in members]], _logs(evidence, [n for n, _ in members], False), _LINE_LENGTH)
        for members in line_groups.values()
    ]
    result = []
    for name, orders, linear in _FAMILIES:
        chosen = [block for (_, order), block in (shared if linear else smooth).items() if order in orders]
        chosen += lines if linear else []
        if chosen:
            result.append((name, np.hstack(chosen)))
    return tuple(result)


def _logs(evidence: Evidence, numbers: Sequence[int], levels: bool) -> FloatArray:
    """ln of the drive of each level, or of the frequency of each line."""
    rows = evidence.rows
    own = rows.harmonic >= 0
    values = rows.amplitude if levels else rows.frequency_hz
    result = np.empty(len(numbers))
    for k, number in enumerate(numbers):
        mine = values[own & (rows.level == number)]
        result[k] = np.log(max(float(np.median(mine)), 1e-300)) if mine.size else 0.0
    return result


def _smooth(columns: FloatArray, x: FloatArray, length: float) -> FloatArray:
    """Columns of smooth courses: principal functions of a Gaussian process over x, scaled by their size."""
    kernel = np.exp(-0.5 * ((x[:, None] - x[None, :]) / length) ** 2)
    values, vectors = np.linalg.eigh(kernel)
    keep = values > _KEPT * values[-1]
    result: FloatArray = columns @ (vectors[:, keep] * np.sqrt(values[keep]))
    return result
