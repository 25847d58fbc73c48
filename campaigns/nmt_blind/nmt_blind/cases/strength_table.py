"""Tables of strengths: one file per rig, made once by ``./nmt blind strengths`` and kept with the program."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from nmt_blind.cases.blind_rigs import BlindRig
from nmt_blind.cases.injected_effects import INJECTED_EFFECTS, InjectedEffect, Spot
from nmt_blind.cases.operating import Operating
from nmt_blind.cases.strength import (
    FREQUENCY,
    FUNDAMENTAL,
    HARMONIC,
    LABORATORY_PHASE_AT_LOCK,
    LABORATORY_PHASE_LEAN,
    PHASE_AT_LOCK,
    PHASE_LEAN,
    Sensitivity,
)
from nmt_blind.cases.strength_curve import curve, spot_key, value_at
from nmt_blind.cases.tolerances import check_tolerances
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import write_whole
from nmt_core.numerics.arrays import FloatArray
from nmt_core.tolerances import TOLERANCES
from nmt_rig.rig import Rig

FORMAT = "nmt blind strengths 1"
_TWIN = 0.95
"""Cosine from which two signatures are hardly different."""


@dataclass(frozen=True)
class StrengthTable:
    """Strengths of all truths of one rig.

    Attributes:
        rig: name of the rig.
        operating: motion of the rig that sizes refer to.
        curves: by `spot_key`: points (strength, standard deviations), what stopped the search, and competing: by effect
            the largest cosine between this signature and one of that effect, as far as it is above a half; compared:
            strength at which that signature was taken, and the shifts of the model that imitate the effect there best.
    """

    rig: str
    operating: Operating
    curves: dict[str, dict[str, Any]]

    def value(self, effect: InjectedEffect, spot: Spot, sigma: float) -> float | None:
        """Strength of so many standard deviations; None where the effect does not get there."""
        curve = self.curves.get(spot_key(effect, spot))
        return None if curve is None else value_at(curve, sigma)

    def missing(self, model: Rig) -> tuple[str, ...]:
        """Keys of what the table lacks: curves of truths at places of the rig, or what they have in common."""
        keys = [spot_key(t, spot) for t in INJECTED_EFFECTS.values() for spot in t.spots(model)]
        return tuple(key for key in keys if "competing" not in self.curves.get(key, {}))

    def twins(self, effect: InjectedEffect, spot: Spot) -> tuple[str, ...]:
        """Known effects whose signature is hardly another: with one of them in the library nothing is unnamed."""
        competing = self.curves.get(spot_key(effect, spot), {}).get("competing", {})
        return tuple(
            name
            for name, cosine in competing.items()
            if cosine >= _TWIN and INJECTED_EFFECTS[name].known and name != effect.name
        )

    def alone(self, effect: InjectedEffect, spot: Spot, without: Collection[str] = ()) -> float:
        """Share of a signature that no other known effect can imitate, beside the model's parameters.

        Args:
            effect, spot: the injected effect and its place.
            without: truths that do not compete.
        """
        competing = self.curves.get(spot_key(effect, spot), {}).get("competing", {})
        known = (
            name for name in competing if INJECTED_EFFECTS[name].known and name != effect.name and name not in without
        )
        closest = max((float(competing[name]) for name in known), default=0.0)
        return math.sqrt(max(0.0, 1.0 - closest**2))


def table_file(rig: BlindRig, tolerances: str = "none") -> Path:
    """Where the table of a rig lies."""
    ending = "" if check_tolerances(tolerances) == "none" else f"_{tolerances}"
    return Path(__file__).resolve().parent / "strengths" / f"{rig.name}{ending}.json"


def chain_values() -> list[float]:
    """Tolerances that the strengths of a new table are counted with."""
    return [
        TOLERANCES.gain, TOLERANCES.phase_deg, TOLERANCES.delay_s, TOLERANCES.shared_delay_s, TOLERANCES.clock,
        TOLERANCES.mains,
    ]  # fmt: skip


def fingerprint(rig: BlindRig, tolerances: str = "none", chain: Sequence[float] = ()) -> str:
    """What a table depends on: the rig file's content, the tests, what they repeat to and the measuring chain.

    Keys at their defaults do not count: a new key of rig files leaves the tables valid.

    Args:
        rig: the rig.
        tolerances: name of the tolerances.
        chain: those that the table states; empty = today's.
    """
    noise = [FREQUENCY, FUNDAMENTAL, HARMONIC, PHASE_AT_LOCK, PHASE_LEAN]
    if tolerances != "none":
        noise += [LABORATORY_PHASE_AT_LOCK, LABORATORY_PHASE_LEAN]
        noise += list(chain) or chain_values()
        # A delay for the sensors of each kind.
        noise += [float(len({sensor.quantity for sensor in rig.model().sensors}))]
    values = rig.model().model_dump(mode="json", exclude_defaults=True)
    values["structure"].pop("shape_std", None)  # what a diagnosis may assume changes no test
    text = json.dumps([values, asdict(rig.bench), noise], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _command(rig: BlindRig, tolerances: str) -> str:
    more = "" if tolerances == "none" else f" --tolerances {tolerances}"
    return f"./nmt blind strengths --rig {rig.name}{more}"


def load_table(rig: BlindRig, tolerances: str = "none", path: Path | None = None) -> StrengthTable:
    """The table of a rig under tolerances of the measuring chain.

    Raises:
        BenchError: there is none, or it belongs to another version of the rig.
    """
    path = path or table_file(rig, tolerances)
    values = _read(path)
    fix = f"make it with '{_command(rig, tolerances)}'"
    if values is None:
        raise BenchError(f"There is no table of strengths {path}; {fix}.")
    # A σ is one under the chain that the table states, whatever chains are drawn from later.
    if values.get("fingerprint") != fingerprint(rig, tolerances, values.get("chain", ())):
        raise BenchError(f"The table of strengths {path} belongs to another version of the rig or its tests; {fix}.")
    return StrengthTable(rig.name, Operating.from_mapping(values["operating"]), values["curves"])


def make_table(
    rig: BlindRig,
    names: Sequence[str] = (),
    jobs: int = 1,
    path: Path | None = None,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
    tolerances: str = "none",
) -> StrengthTable:
    """Make or complete the table of a rig; curves that are there already are kept.

    Curves of another version of the rig, or of its table without tolerances, are where the search for the new ones
    starts.

    Args:
        rig: the rig.
        names: truths to do; none = all.
        jobs: worker processes.
        path: the file; None = that of the program.
        progress: called with done, total and the newest curve.
        tolerances: of the measuring chain.

    Raises:
        BenchError: an effect that does not exist.
    """
    for name in names:
        if name not in INJECTED_EFFECTS:
            raise BenchError(f"There is no injected effect '{name}'; choose from {', '.join(INJECTED_EFFECTS)}.")
    path = path or table_file(rig, tolerances)
    path.parent.mkdir(parents=True, exist_ok=True)
    expected = fingerprint(rig, tolerances)
    found = _read(path)
    plain = _read(table_file(rig)) or {"curves": {}}
    former: dict[str, dict[str, Any]] = {**plain["curves"], **(found["curves"] if found else {})}
    curves = found["curves"] if found and found.get("fingerprint") == expected else {}
    sensitivity = Sensitivity(rig, tolerances)
    # The first place of every effect, then the second of every one: a table that is not complete has something of each.
    todo = [
        (effect, spot)
        for _, effect, spot in sorted(
            (
                (rank, effect, spot)
                for effect in INJECTED_EFFECTS.values()
                if not names or effect.name in names
                for rank, spot in enumerate(effect.spots(sensitivity.model))
            ),
            key=lambda item: item[0],
        )
        if spot_key(effect, spot) not in curves
    ]
    values = {
        "format": FORMAT,
        "rig": rig.name,
        "command": _command(rig, tolerances),
        "tolerances": tolerances,
        "chain": chain_values() if tolerances != "none" else [],
        "fingerprint": expected,
        "operating": sensitivity.operating.to_mapping(),
    }

    def keep() -> None:
        ordered = {key: curves[key] for key in sorted(curves)}
        write_whole(path, _text({**values, "curves": ordered}))

    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
    work = (
        delayed(_curve)(sensitivity, effect.name, spot, former.get(spot_key(effect, spot))) for effect, spot in todo
    )
    signatures: dict[str, FloatArray] = {}
    for done, (key, found_curve, signature) in enumerate(parallel(work), start=1):
        curves[key] = found_curve
        if signature is not None:
            signatures[key] = signature
        keep()
        progress(done, len(todo), key)
    if todo or any("competing" not in curve for curve in curves.values()):
        _add_competing(sensitivity, curves, signatures, parallel, progress)
    keep()
    return StrengthTable(rig.name, sensitivity.operating, curves)


def _add_competing(
    sensitivity: Sensitivity,
    curves: dict[str, dict[str, Any]],
    signatures: dict[str, FloatArray],
    parallel: Any,
    progress: Callable[[int, int, str], None],
) -> None:
    """Cosines between all signatures, the model's parameters projected out; ``signatures`` has some already."""
    reached = [
        (spot_key(effect, spot), effect, spot)
        for effect in INJECTED_EFFECTS.values()
        for spot in effect.spots(sensitivity.model)
        if "compared" in curves.get(spot_key(effect, spot), {})
    ]
    missing = [item for item in reached if item[0] not in signatures]
    work = (
        delayed(_signature)(sensitivity, key, effect.name, spot, curves[key]["compared"])
        for key, effect, spot in missing
    )
    for done, (key, signature) in enumerate(parallel(work), start=1):
        signatures[key] = signature
        progress(done, len(missing), f"effects that compete with {key}")
    keys = [key for key, *_ in reached]
    stacked = np.stack([signatures[key] for key in keys], axis=1)
    gram = stacked.T @ stacked
    sizes = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    cosines = np.abs(gram) / sizes[:, np.newaxis] / sizes
    for row, key in enumerate(keys):
        found: dict[str, float] = {}
        for column, (_, effect, _) in enumerate(reached):
            if column != row and cosines[row, column] > 0.5:
                found[effect.name] = max(found.get(effect.name, 0.0), round(min(1.0, float(cosines[row, column])), 4))
        curves[key]["competing"] = dict(sorted(found.items(), key=lambda item: -item[1]))
    for key in set(curves) - set(keys):
        curves[key]["competing"] = {}


def _signature(
    sensitivity: Sensitivity, key: str, name: str, spot: Spot, compared: dict[str, Any]
) -> tuple[str, FloatArray]:
    edits = INJECTED_EFFECTS[name].edits(sensitivity.model, sensitivity.operating, spot, compared["value"])
    return key, sensitivity.signature(sensitivity.played(edits), np.array(compared["shifts"]))


def _curve(
    sensitivity: Sensitivity, name: str, spot: Spot, former: dict[str, Any] | None
) -> tuple[str, dict[str, Any], FloatArray | None]:
    effect = INJECTED_EFFECTS[name]
    return spot_key(effect, spot), *curve(sensitivity, effect, spot, former)


def _text(values: dict[str, Any]) -> str:
    """JSON with one curve a line."""
    curves = values.pop("curves")
    head = json.dumps(values, indent=1)[:-2]
    lines = ",\n".join(f"  {json.dumps(key)}: {json.dumps(curve)}" for key, curve in curves.items())
    return f'{head},\n "curves": {{\n{lines}\n }}\n}}\n'


def _read(path: Path) -> dict[str, Any] | None:
    try:
        values = read_json(path, "table of strengths")
    except BenchError:
        return None
    return values if values.get("format") == FORMAT else None
