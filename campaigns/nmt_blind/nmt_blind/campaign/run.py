"""Diagnoses all cases of a blind check; the sealed file is never opened here."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_blind.campaign.frozen import check_frozen
from nmt_blind.cases.make import bag_hash
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import write_whole
from nmt_core.processes.workers import worked

RESULT_FORMAT = "nmt blind result 1"
_PUBLIC_FILE = "public.json"

Diagnose = Callable[[Path, Sequence[Path], str], dict[str, Any]]
"""From model, bags and the withheld effects (joined by commas, empty = none) to what ``diagnosis.json`` holds."""


@dataclass(frozen=True)
class CampaignRun:
    """What a run of a campaign came to.

    Attributes:
        results: folder of the results.
        cases: cases of the campaign.
        done: of those, with a result now.
        new: diagnosed this time.
        failed: diagnosed this time, without a verdict.
        waiting: cases whose bags have not been made yet.
        seconds: median computing time of a diagnosis, s; NaN if none was made.
    """

    results: Path
    cases: int
    done: int
    new: int
    failed: int
    seconds: float
    waiting: int = 0


def diagnose_case(model: Path, bags: Sequence[Path], withheld: str, sizes: str = "none") -> dict[str, Any]:
    """The diagnosis that ``./nmt diagnose`` makes, without looking for the next test, and a baseline's answer.

    Args:
        model, bags, withheld: of the case.
        sizes: from which size on a difference matters: ``none``, every one that is seen, or ``usual``.
    """
    from nmt_blind.campaign.ensemble_sindy import sparse_terms
    from nmt_diagnose.diagnose import diagnose_bags
    from nmt_diagnose.diagnosis_settings import MATTERS, DiagnosisSettings

    settings = DiagnosisSettings(
        withheld=tuple(withheld.split(",")) if withheld else (),
        look_ahead=False,
        matters=MATTERS if sizes == "usual" else {},
    )
    result = diagnose_bags(model, bags, settings=settings).diagnosis.to_mapping()
    with contextlib.suppress(BenchError, ArithmeticError, np.linalg.LinAlgError):
        result["sindy"] = sparse_terms(model, bags)
    return result


def run_campaign(
    folder: Path,
    results: Path | None = None,
    jobs: int = 1,
    scheduler: str = "",
    discard_bags: bool = False,
    again: bool = False,
    diagnose: Diagnose = diagnose_case,
    progress: Callable[[int, int, str], None] = lambda done, total, case: None,
) -> CampaignRun:
    """Diagnose all cases that have bags and no result yet.

    Args:
        folder: the campaign's folder.
        results: folder for the results, one JSON file a case; None = ``results`` in the campaign's folder.
        jobs: worker processes on this machine.
        scheduler: address of a Dask scheduler in place of them; its workers must see the same folders.
        discard_bags: remove the bags of a case once it is diagnosed; their hashes stay.
        again: diagnose cases with a result too.
        diagnose: makes one diagnosis.
        progress: called with cases done, cases in all and the newest case.

    Raises:
        BenchError: the folder holds no campaign, the first cases of a sealed one were diagnosed by another version of
            the program, or the scheduler does not answer.
    """
    public = read_public(folder)
    results = results or folder / "results"
    results.mkdir(parents=True, exist_ok=True)
    check_frozen(folder, results, public.get("purpose") == "sealed", again)
    cases = list(public["cases"])
    made = [case for case in cases if (folder / "cases" / str(case["case"]) / "bags.json").is_file()]
    todo = [case for case in made if again or read_result(results, str(case["case"])) is None]
    done, failed, spent = len(made) - len(todo), 0, []
    progress(done, len(cases), "")
    work = [
        (folder.absolute(), results.absolute(), str(case["case"]), str(case["withheld"]), discard_bags, diagnose)
        for case in todo
    ]
    for result in worked(run_case, work, jobs, scheduler):
        done += 1
        failed += "error" in result
        spent.append(float(result["seconds"]))
        progress(done, len(cases), str(result["case"]))
    middle = sorted(spent)[len(spent) // 2] if spent else float("nan")
    return CampaignRun(results, len(cases), done, len(todo), failed, middle, len(cases) - len(made))


def run_case(
    folder: Path, results: Path, case: str, withheld: str, discard_bags: bool, diagnose: Diagnose
) -> dict[str, Any]:
    """Diagnose one case from the tests that gave a bag, and keep the result; a failure is a result too.

    Returns:
        What was written, without the diagnosis.
    """
    case_folder = folder / "cases" / case
    bags = [case_folder / test for test in read_public(folder)["tests"]]
    begin, wall = time.process_time(), time.monotonic()
    result: dict[str, Any] = {"format": RESULT_FORMAT, "case": case, "withheld": withheld}
    result["bags"] = {bag.name: bag_hash(bag) for bag in bags}
    try:
        result["diagnosis"] = diagnose(
            case_folder / "model.yaml", [bag for bag in bags if any(bag.glob("*.mcap"))], withheld
        )
    except BenchError as error:
        result["error"] = str(error)
    except Exception as error:
        # One case that fails must not take the others with it.
        result["error"] = f"{type(error).__name__}: {error}"
    result["seconds"] = round(time.process_time() - begin, 3)
    result["wall_seconds"] = round(time.monotonic() - wall, 3)
    write_whole(results / f"{case}.json", json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    if discard_bags:
        for bag in bags:
            shutil.rmtree(bag, ignore_errors=True)
    return {key: value for key, value in result.items() if key != "diagnosis"}


def read_public(folder: Path) -> dict[str, Any]:
    """What everybody may know of a campaign.

    Raises:
        BenchError: the folder holds no campaign.
    """
    try:
        values = read_json(folder / _PUBLIC_FILE, "description of the cases")
    except BenchError as error:
        raise BenchError(f"The folder {folder} holds no blind cases; make them with './nmt blind make'.") from error
    if "cases" not in values:
        raise BenchError(f"The folder {folder} holds no blind cases; make them with './nmt blind make'.")
    return values


def read_result(results: Path, case: str) -> dict[str, Any] | None:
    """Result of a case; None if there is none."""
    try:
        values = read_json(results / f"{case}.json", "result")
    except BenchError:
        return None
    return values if values.get("format") == RESULT_FORMAT else None
