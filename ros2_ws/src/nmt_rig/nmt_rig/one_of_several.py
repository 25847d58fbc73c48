"""A rig with several exciters as a rig with one of them: the others are taken off."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from nmt_core.errors import BenchError
from nmt_rig.rig_file import RigDocument

_KEY = "exciter.point"
_OWN = ("voltage", "current")


@contextmanager
def named_as_exciter(point: int | None) -> Iterator[None]:
    """Errors speak of ``--exciter N`` where that is what somebody gave, and not of the override that it becomes."""
    try:
        yield
    except BenchError as error:
        if point is None:
            raise
        raise BenchError(str(error).replace(f"--set {_KEY}={point}", f"--exciter {point}")) from error


def with_one_exciter(document: RigDocument, overrides: Sequence[str]) -> tuple[RigDocument, list[str]]:
    """The file with the exciter that ``exciter.point=N`` names alone, and the overrides that are left to apply.

    Forces at the points of the other exciters, and their voltages and currents, are not measured then.

    Raises:
        BenchError: none of the exciters is at that point.
    """
    exciters = document.values.get("exciters")
    named = [text.partition("=")[2].strip() for text in overrides if text.partition("=")[0].strip() == _KEY]
    if not named or not isinstance(exciters, list) or not all(isinstance(entry, dict) for entry in exciters):
        return document, list(overrides)
    points = [entry.get("point") for entry in exciters]
    if named[-1] not in map(str, points):
        raise BenchError(
            f"--set {_KEY}={named[-1]}: the exciters of {document.name} are at points "
            f"{', '.join(map(str, points))}; name one of them, or change exciters.0.point."
        )
    chosen = [str(point) for point in points].index(named[-1])
    sensors = document.values.get("sensors")
    values = {key: value for key, value in document.values.items() if key != "exciters"}
    values["exciter"] = exciters[chosen]
    if isinstance(sensors, list):
        values["sensors"] = [
            _of_the_only(sensor) for sensor in sensors if _is_kept(sensor, chosen, points[chosen], points[0])
        ]
    places = {
        ("exciter", *path[2:]) if path[:2] == ("exciters", chosen) else path: place
        for path, place in document.places.items()
    }
    kept = [text for text in overrides if text.partition("=")[0].strip() != _KEY]
    return RigDocument(document.name, values, places), kept


def _is_kept(sensor: Any, chosen: int, point: Any, first: Any) -> bool:
    if not isinstance(sensor, dict):
        return True
    if sensor.get("quantity") in _OWN:
        return bool((sensor.get("exciter") or 1) - 1 == chosen)
    at = sensor.get("point", "drive")
    return sensor.get("quantity") != "force" or (first if at == "drive" else at) == point


def _of_the_only(sensor: Any) -> Any:
    return {key: value for key, value in sensor.items() if key != "exciter"} if isinstance(sensor, dict) else sensor
