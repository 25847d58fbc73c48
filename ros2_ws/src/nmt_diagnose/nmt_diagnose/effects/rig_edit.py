"""Changes of rigs: a rig is frozen, so every change is a new rig that shares what stays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

from nmt_core.errors import BenchError
from nmt_rig.model.local_elements import AnyElement
from nmt_rig.rig import AnyExciter, Rig, SensorSection

Path: TypeAlias = tuple[str | int, ...]


def value_at(rig: Rig, path: Path) -> Any:
    """Value of a key, for example ``("structure", "springs_n_m", 0)``; a missing entry of a dict is None."""
    node: Any = rig
    for part in path:
        if isinstance(node, dict):
            node = node.get(part)
        else:
            node = node[part] if isinstance(part, int) else getattr(node, part)
    return node


def with_value(rig: Rig, path: Path, value: Any) -> Rig:
    """The rig with one key changed."""
    changed: Rig = _changed(rig, path, value)
    if changed.exciters is not None and changed.exciters[0] is not changed.exciter:
        return with_exciters(changed, changed.exciters)
    return changed


def with_exciters(rig: Rig, exciters: Sequence[AnyExciter]) -> Rig:
    """The rig with other exciters."""
    several = list(exciters) if len(exciters) > 1 else None
    return rig.model_copy(update={"exciter": exciters[0], "exciters": several})


def with_exciters_at(rig: Rig, points: Sequence[int]) -> Rig:
    """The rig as it was for a test with exciters at these points.

    Of several exciters those that were not there are taken off with their sensors; a single one is moved, and what sits
    on its side goes with it.

    Raises:
        BenchError: the structure has no such point, or the rig has fewer exciters.
    """
    points = tuple(points)
    if points == rig.exciter_points:
        return rig
    lacking = [point for point in points if point not in rig.structure.points]
    if lacking:
        raise BenchError(
            f"a test was driven at point {lacking[0]}, but the structure of rig {rig.name} has points 1 to "
            f"{rig.structure.points[-1]}; give the model of this rig."
        )
    by_point = {exciter.point: number for number, exciter in enumerate(rig.all_exciters)}
    if all(point in by_point for point in points):
        kept = [by_point[point] for point in points]
        sensors = [
            sensor.model_copy(update={"exciter": kept.index((sensor.exciter or 1) - 1) + 1})
            if _has_exciter(sensor)
            else sensor
            for sensor in rig.sensors
            if (
                (sensor.exciter or 1) - 1 in kept
                if _has_exciter(sensor)
                else sensor.quantity != "force" or rig.sensor_point(sensor) in points
            )
        ]
        return with_exciters(rig.model_copy(update={"sensors": sensors}), [rig.all_exciters[number] for number in kept])
    if len(points) > 1:
        raise BenchError(
            f"a test was driven at points {', '.join(map(str, points))}, but the exciters of rig {rig.name} are at "
            f"{', '.join(map(str, rig.exciter_points))}; give the model of this rig."
        )
    point = points[0]
    moved = [
        element.model_copy(update={"point": point}) if element.side == "exciter" else element
        for element in rig.local_elements
    ]
    exciter = rig.exciter.model_copy(update={"point": point})
    return with_exciters(rig.model_copy(update={"local_elements": moved}), [exciter])


def _has_exciter(sensor: SensorSection) -> bool:
    return sensor.quantity in ("voltage", "current")


def _changed(node: Any, path: Path, value: Any) -> Any:
    if not path:
        return value
    part, remaining = path[0], path[1:]
    if isinstance(node, dict):
        return {**node, part: _changed(node.get(part), remaining, value)}
    if isinstance(node, list):
        return [_changed(entry, remaining, value) if index == part else entry for index, entry in enumerate(node)]
    return node.model_copy(update={part: _changed(getattr(node, str(part)), remaining, value)})


def with_element(rig: Rig, element: AnyElement) -> Rig:
    """The rig with one more local element."""
    return rig.model_copy(update={"local_elements": [*rig.local_elements, element]})
