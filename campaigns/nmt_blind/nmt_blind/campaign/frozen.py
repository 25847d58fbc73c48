"""That a sealed campaign is diagnosed by one program from first case to last, however many sittings it takes."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import write_whole

FROZEN_FILE = "frozen.json"
PACKAGES = ("nmt_core", "nmt_signals", "nmt_rig", "nmt_record", "nmt_extract", "nmt_diagnose", "nmt_robots")
"""What a diagnosis is made of."""
_ENDINGS = (".py", ".json", ".yaml", ".msg")


def diagnosis_digest() -> str:
    """SHA-256 over the files of the diagnosis: code, rigs and calibration, by name and content."""
    digest = hashlib.sha256()
    for name in PACKAGES:
        found = importlib.util.find_spec(name)
        assert found is not None
        for folder in found.submodule_search_locations or ():
            root = Path(folder)
            for path in sorted(path for path in root.rglob("*") if path.suffix in _ENDINGS):
                digest.update(f"{name}/{path.relative_to(root).as_posix()}\0".encode())
                digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()


def check_frozen(folder: Path, results: Path, sealed: bool, anew: bool) -> None:
    """Note which program diagnoses a campaign; refuse another one to go on with a sealed campaign.

    Args:
        folder: the campaign's folder, for the message.
        results: where the note is kept, next to the results.
        sealed: the campaign is sealed.
        anew: all cases are diagnosed from the beginning.

    Raises:
        BenchError: some cases of a sealed campaign were diagnosed by another program.
    """
    current, path = diagnosis_digest(), results / FROZEN_FILE
    if sealed and not anew and path.is_file():
        before = read_json(path, "note of the program").get("sha256")
        if before != current:
            raise BenchError(
                f"The first cases of {folder} were diagnosed by another version of the program (sha256 {before}, now "
                f"{current}); go on with that one, or diagnose all of them anew with --again."
            )
    write_whole(path, json.dumps({"sha256": current}) + "\n")


def frozen_digest(results: Path) -> str:
    """SHA-256 of the program that diagnosed a campaign; empty if it was not noted."""
    path = results / FROZEN_FILE
    return str(read_json(path, "note of the program").get("sha256", "")) if path.is_file() else ""
