"""Tables of strengths: one file per rig, made once by ``./nmt blind strengths`` and kept with the program."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.whole_file import write_whole
from nmt_diagnose.blind.blind_rigs import BlindRig
from nmt_diagnose.blind.operating import Operating
from nmt_diagnose.blind.rig_edits import rig_yaml
from nmt_diagnose.blind.strength import Sensitivity, spot_key, value_at
from nmt_diagnose.blind.truths import TRUTHS, Spot, Truth

FORMAT = "nmt blind strengths 1"


@dataclass(frozen=True)
class StrengthTable:
    """Strengths of all truths of one rig.

    Attributes:
        rig: name of the rig.
        operating: motion of the rig that sizes refer to.
        curves: by `spot_key`: points (strength, standard deviations), and what stopped the search.
    """

    rig: str
    operating: Operating
    curves: dict[str, dict[str, Any]]

    def value(self, truth: Truth, spot: Spot, sigma: float) -> float | None:
        """Strength of so many standard deviations; None where the truth does not get there."""
        curve = self.curves.get(spot_key(truth, spot))
        return None if curve is None else value_at(curve, sigma)


def table_file(rig: BlindRig) -> Path:
    """Where the table of a rig lies."""
    return Path(__file__).resolve().parent / "strengths" / f"{rig.name}.json"


def fingerprint(rig: BlindRig) -> str:
    """What a table depends on: the rig file's content and the tests."""
    text = rig_yaml(rig.model()) + json.dumps(asdict(rig.bench), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def load_table(rig: BlindRig, path: Path | None = None) -> StrengthTable:
    """The table of a rig.

    Raises:
        BenchError: there is none, or it belongs to another version of the rig.
    """
    path = path or table_file(rig)
    values = _read(path)
    mend = f"make it with './nmt blind strengths --rig {rig.name}'"
    if values is None:
        raise BenchError(f"There is no table of strengths {path}; {mend}.")
    if values.get("fingerprint") != fingerprint(rig):
        raise BenchError(f"The table of strengths {path} belongs to another version of the rig or its tests; {mend}.")
    return StrengthTable(rig.name, Operating.from_mapping(values["operating"]), values["curves"])


def make_table(
    rig: BlindRig,
    names: Sequence[str] = (),
    jobs: int = 1,
    path: Path | None = None,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> StrengthTable:
    """Make or complete the table of a rig; curves that are there already are kept.

    Args:
        rig: the rig.
        names: truths to do; none = all.
        jobs: worker processes.
        path: the file; None = that of the program.
        progress: called with done, total and the newest curve.

    Raises:
        BenchError: a truth that does not exist.
    """
    from joblib import Parallel, delayed

    for name in names:
        if name not in TRUTHS:
            raise BenchError(f"There is no truth '{name}'; choose from {', '.join(TRUTHS)}.")
    path = path or table_file(rig)
    path.parent.mkdir(parents=True, exist_ok=True)
    mark = fingerprint(rig)
    found = _read(path)
    curves: dict[str, dict[str, Any]] = found["curves"] if found and found.get("fingerprint") == mark else {}
    sensitivity = Sensitivity(rig)
    todo = [
        (truth, spot)
        for truth in TRUTHS.values()
        if not names or truth.name in names
        for spot in truth.spots(sensitivity.model, sensitivity.operating)
        if spot_key(truth, spot) not in curves
    ]
    values = {
        "format": FORMAT,
        "rig": rig.name,
        "command": f"./nmt blind strengths --rig {rig.name}",
        "fingerprint": mark,
        "operating": sensitivity.operating.to_mapping(),
    }

    def keep() -> None:
        ordered = {key: curves[key] for key in sorted(curves)}
        write_whole(path, _text({**values, "curves": ordered}))

    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
    work = (delayed(_curve)(sensitivity, truth.name, spot) for truth, spot in todo)
    for done, (key, curve) in enumerate(parallel(work), start=1):
        curves[key] = curve
        keep()
        progress(done, len(todo), key)
    keep()
    return StrengthTable(rig.name, sensitivity.operating, curves)


def _curve(sensitivity: Sensitivity, name: str, spot: Spot) -> tuple[str, dict[str, Any]]:
    truth = TRUTHS[name]
    return spot_key(truth, spot), sensitivity.curve(truth, spot)


def _text(values: dict[str, Any]) -> str:
    """JSON with one curve a line."""
    curves = values.pop("curves")
    head = json.dumps(values, indent=1)[:-2]
    lines = ",\n".join(f"  {json.dumps(key)}: {json.dumps(curve)}" for key, curve in curves.items())
    return f'{head},\n "curves": {{\n{lines}\n }}\n}}\n'


def _read(path: Path) -> dict[str, Any] | None:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return values if isinstance(values, dict) and values.get("format") == FORMAT else None
