"""Joints that are meant to be alike, such as those of four legs: what they share, how they scatter, what is odd."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_rows
from nmt_diagnose.ledger.diagnosis import Value
from nmt_diagnose.units.unit_group import StatedValue, UnitGroup, grouped, of_explanations
from nmt_robots.verdict.joint_verdict import JointVerdict

COLUMNS = ("joint", "unit", "part")
_LABELS = {"as in the model": "none", "not known": "unknown"}


@dataclass(frozen=True)
class PlacedJoint:
    """A joint's unit, such as a leg, and the part that it is of it, such as the hip."""

    unit: str
    part: str


def read_joint_table(path: Path, joints: Sequence[str]) -> dict[str, PlacedJoint]:
    """Unit and part of each joint.

    Args:
        path: table with the columns joint, unit and part.
        joints: names that there are.

    Raises:
        BenchError: no such table, a joint that the log lacks or that stands there twice, or fewer than two units.
    """
    rows = [[cell.strip() for cell in row] for row in read_rows(path, "table of joints") if any(map(str.strip, row))]
    head = rows[0] if rows else []
    if sorted(head) != sorted(COLUMNS):
        raise BenchError(
            f"{path}: the first line must name the columns {', '.join(COLUMNS)}; of a robot they are those."
        )
    found: dict[str, PlacedJoint] = {}
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(head):
            raise BenchError(f"{path} line {line}: it has {len(row)} cells for {len(head)} columns.")
        cells = dict(zip(head, row, strict=True))
        if cells["joint"] not in joints:
            raise BenchError(
                f"{path} line {line}: the log has no joint '{cells['joint']}'; it has {', '.join(sorted(joints))}."
            )
        if cells["joint"] in found or not cells["unit"] or not cells["part"]:
            raise BenchError(f"{path} line {line}: a joint stands there once, with its unit and part.")
        found[cells["joint"]] = PlacedJoint(cells["unit"], cells["part"])
    if len({place.unit for place in found.values()}) < 2:
        raise BenchError(f"{path}: a group needs joints of two units or more.")
    return found


def joint_group(logs: Sequence[Sequence[JointVerdict]], places: Mapping[str, PlacedJoint]) -> UnitGroup:
    """Put the answers for joints of the same part together, each log a repeat; nothing is fitted again.

    Args:
        logs: the joints' answers by each log.
        places: of the joints that are compared.
    """
    several = len(logs) > 1
    stated: list[StatedValue] = []
    explanations: list[tuple[str, str, str]] = []
    first: list[tuple[str, str, str]] = []  # what further logs name stands in the table of the page
    for number, joints in enumerate(logs, start=1):
        repeat = f"repeat {number}" if several else ""
        for joint in joints:
            place = places.get(joint.joint.name)
            if place is None or joint.mechanics is None:
                continue
            setting = f"{place.part}{f', {repeat}' if several else ''}"
            label = _LABELS.get(joint.cause, joint.cause)
            explanations.append((place.unit, setting, label))
            if number == 1:
                first.append((place.unit, place.part, label))
            for term in joint.terms:
                value = Value(term.value, term.std, term.unit)
                name = f"{place.part}: {term.words}"
                stated.append(StatedValue(name, term.in_model == 0.0, term.in_model, place.unit, repeat, value))
    parts = dict.fromkeys(place.part for place in places.values())
    sentences = [
        f"{part}: {sentence[0].lower()}{sentence[1:]}"
        for part in parts
        for sentence in of_explanations([each for each in first if each[1] == part])
    ]
    found = grouped(explanations, sentences, stated, "repeat" if several else "")
    odd = sorted(
        {f"{each.unit} ({quantity.name})" for quantity in found.quantities for each in quantity.components.odd}
    )
    head = f"{len(found.units)} units of {len(parts)} part{'s' * (len(parts) > 1)}: " + (
        f"odd is {', '.join(odd)}." if odd else "none is odd."
    )
    return replace(found, sentences=(head, *found.sentences))
