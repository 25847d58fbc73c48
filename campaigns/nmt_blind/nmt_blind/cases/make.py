"""Makes the cases of a blind check: first the sealed file, then bags that say nothing of it."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from nmt_blind.cases.blind_rigs import BlindRig, blind_rig
from nmt_blind.cases.draw import Case, check_kinds, draw_cases
from nmt_blind.cases.laboratory import record_backbone, record_random
from nmt_blind.cases.operating import Operating, operating_point
from nmt_blind.cases.reduced_tests import record_ring_down, record_tables
from nmt_blind.cases.rig_edits import with_edits
from nmt_core.errors import BenchError
from nmt_core.files import hardened
from nmt_core.files.whole_file import write_whole
from nmt_core.processes.workers import worked

TRUTH_FILE = "truth.sealed"
SEAL_FILE = "seal.json"
PUBLIC_FILE = "public.json"
HASH_FILE = "hashes.json"
FORMAT = "nmt blind campaign 2"
RESERVED = (3918,)
"""Even seeds that are kept for sealed campaigns, as odd ones are."""
RECORDERS = {
    "backbone": record_backbone,
    "random": record_random,
    "tables": record_tables,
    "ring_down": record_ring_down,
}
"""How each test of a case is made."""


@dataclass(frozen=True)
class Made:
    """A campaign on disk.

    Attributes:
        folder: its folder.
        seal: sha256 of the sealed file.
        trail: sha256 of the list of all bags' hashes; empty while some are to be made.
        cases: number of cases; new: of those, made this time; left: still to be made.
        seconds: computing time of the new ones, s in all.
        megabytes: size of all bags that are there.
    """

    folder: Path
    seal: str
    trail: str
    cases: int
    new: int
    seconds: float
    megabytes: float
    left: int = 0


@dataclass(frozen=True, kw_only=True)
class CampaignPlan:
    """What a campaign is to hold.

    Attributes:
        rig_name: name of the blind rig.
        count: number of cases.
        seed: even for development, odd for sealed campaigns.
        kinds: kinds of case; none = all.
        sealed: a sealed campaign is meant.
        tolerances: of the measuring chain, ``laboratory`` or ``none``.
        rig, operating: in place of the program's own, and of how far it moves.
    """

    rig_name: str
    count: int
    seed: int
    kinds: Sequence[str] = ()
    sealed: bool = False
    tolerances: str = "none"
    rig: BlindRig | None = None
    operating: Operating | None = None

    def check(self) -> None:
        """Refuse what no campaign can be.

        Raises:
            BenchError: with the reason.
        """
        _check_seed(self.seed, self.sealed)
        if self.count < 1:
            raise BenchError(f"A campaign needs at least one case, got {self.count}.")
        check_kinds(self.kinds)


def make_campaign(
    folder: Path,
    plan: CampaignPlan,
    jobs: int = 1,
    scheduler: str = "",
    on_seal: Callable[[str], None] = lambda digest: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    batch: int = 0,
) -> Made:
    """Draw cases, seal their truth, then make their bags; what is there already is kept.

    Args:
        folder: the campaign's folder.
        plan: what it is to hold.
        jobs: worker processes.
        scheduler: address of a Dask scheduler in place of worker processes; its workers must see the same folder.
        on_seal: called with the seal before any bag is made.
        progress: called with cases done and in all.
        batch: most cases to make this time; 0 = all. The truth of all of them is sealed at once.

    Raises:
        BenchError: a batch below 0, a seed of the wrong kind, a folder with another campaign, what `draw_cases`
            refuses, or a scheduler that does not answer.
    """
    plan.check()
    if batch < 0:
        raise BenchError(f"A batch needs at least one case, got {batch}; leave it out to make all of them.")
    rig = plan.rig or blind_rig(plan.rig_name)
    model, sealed = rig.model(), plan.sealed
    cases = draw_cases(
        model,
        plan.operating or operating_point(model, rig.bench),
        plan.count,
        plan.seed,
        plan.kinds,
        plan.tolerances,
        lambda truth_rig: operating_point(truth_rig, rig.bench),
    )
    truth = json.dumps({
        "format": FORMAT, "rig": rig.name, "seed": plan.seed, "tolerances": plan.tolerances,
        "cases": [case.to_mapping() for case in cases],
    }, indent=1) + "\n"  # fmt: skip
    digest = hashlib.sha256(truth.encode()).hexdigest()
    _claim(folder, digest, sealed)
    public = {
        "format": FORMAT,
        "rig": rig.name,
        "purpose": _purpose(sealed),
        "model": "model.yaml",
        "tests": list(rig.tests),
        "tolerances": plan.tolerances,
        "cases": [{"case": case.name, "withheld": case.withheld} for case in cases],
    }
    write_whole(folder / SEAL_FILE, json.dumps({
        "format": FORMAT, "purpose": _purpose(sealed), "rig": rig.name, "cases": plan.count, "sha256": digest,
    }, indent=1) + "\n")  # fmt: skip
    on_seal(digest)
    if not (folder / TRUTH_FILE).exists():
        write_whole(folder / TRUTH_FILE, truth)
    write_whole(folder / PUBLIC_FILE, json.dumps(public, indent=1) + "\n")
    (folder / "cases").mkdir(exist_ok=True)
    todo = [case for case in cases if not (_case_folder(folder, case) / "bags.json").is_file()]
    now = todo[:batch] if batch else todo
    seconds = _make_bags(folder, rig, now, len(cases) - len(todo), len(cases), jobs, scheduler, progress)
    left = len(todo) - len(now)
    trail = "" if left else _hash_trail(folder, rig, cases)
    size = sum(path.stat().st_size for path in (folder / "cases").rglob("*.mcap"))
    return Made(folder, digest, trail, len(cases), len(now), seconds, size / 1e6, left)


def _purpose(sealed: bool) -> str:
    return "sealed" if sealed else "development"


def _check_seed(seed: int, sealed: bool) -> None:
    if seed < 0:
        raise BenchError(f"A seed must not be negative, got {seed}.")
    kept = seed % 2 == 1 or seed in RESERVED
    if sealed and not kept:
        raise BenchError(
            f"Seed {seed} is even: even seeds are for development, odd ones for sealed campaigns; choose an odd one."
        )
    if not sealed and kept:
        why = "odd: odd seeds are" if seed % 2 else "reserved: it is"
        raise BenchError(
            f"Seed {seed} is {why} kept for sealed campaigns; choose another even one for development, or add --sealed."
        )


def _claim(folder: Path, digest: str, sealed: bool) -> None:
    """Make the folder, or find that it holds the same campaign."""
    seal = folder / SEAL_FILE
    if not seal.is_file():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise BenchError(f"The folder {folder} holds something that is not a campaign; choose another with --out.")
        folder.mkdir(parents=True, exist_ok=True)
        return
    found = read_json(seal)
    if found.get("purpose") != _purpose(sealed):
        raise BenchError(
            f"The folder {folder} holds a {found.get('purpose')} campaign; development and sealed cases do not mix: "
            "choose another with --out."
        )
    if found.get("sha256") != digest:
        raise BenchError(
            f"The folder {folder} holds another campaign (rig, seed, kinds or number of cases differ); choose "
            "another with --out."
        )


def _case_folder(folder: Path, case: Case) -> Path:
    return folder / "cases" / case.name


def _make_bags(
    folder: Path,
    rig: BlindRig,
    todo: Sequence[Case],
    done: int,
    total: int,
    jobs: int,
    scheduler: str,
    progress: Callable[[int, int], None],
) -> float:
    seconds = 0.0
    progress(done, total)
    for spent in worked(make_case, [(folder.absolute(), rig, case) for case in todo], jobs, scheduler):
        seconds += spent
        done += 1
        progress(done, total)
    return seconds


def make_case(folder: Path, rig: BlindRig, case: Case) -> float:
    """Make the bags of a case; a case that was begun is made anew.

    Returns:
        Computing time, s.
    """
    import time

    begin = time.process_time()
    model = rig.model()
    case_folder = _case_folder(folder, case)
    shutil.rmtree(case_folder, ignore_errors=True)
    case_folder.mkdir(parents=True)
    (case_folder / "model.yaml").write_text(rig.file.read_text(encoding="utf-8"), encoding="utf-8")
    truth = with_edits(model, case.edits)
    bags: dict[str, Any] = {}
    for test in rig.tests:
        outcome = RECORDERS[test](case_folder / test, truth, model, rig.bench, case.noise_seed, case.converters)
        bags[test] = {**asdict(outcome), "sha256": bag_hash(case_folder / test)}
    write_whole(case_folder / "bags.json", json.dumps(bags, indent=1) + "\n")
    return time.process_time() - begin


def bag_hash(bag: Path) -> str:
    """sha256 over the data files of a bag, in the order of their names."""
    digest = hashlib.sha256()
    for path in sorted(bag.glob("*.mcap")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _hash_trail(folder: Path, rig: BlindRig, cases: Sequence[Case]) -> str:
    """Write the hashes of all bags into one file; its own hash is the end of the trail."""
    hashes = {}
    for case in cases:
        bags = read_json(_case_folder(folder, case) / "bags.json")
        hashes[case.name] = {test: bags[test]["sha256"] for test in rig.tests}
    seal = read_json(folder / SEAL_FILE)["sha256"]
    text = json.dumps({"format": FORMAT, "truth": seal, "bags": hashes}, indent=1) + "\n"
    write_whole(folder / HASH_FILE, text)
    return hashlib.sha256(text.encode()).hexdigest()


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object.

    Raises:
        BenchError: the file is not there or is not a JSON object.
    """
    try:
        return hardened.read_json(path, "file")
    except BenchError as error:
        raise BenchError(f"The file {path} cannot be read; make the campaign again.") from error
