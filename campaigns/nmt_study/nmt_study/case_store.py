"""Finished cases on disk: one JSON file each, so that an interrupted study goes on where it stopped."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import write_whole
from nmt_study.case import StudyCase

FORMAT = "nmt study case 1"
_MARKER = "study.json"


class CaseStore:
    """The results folder of a study.

    Args:
        folder: the folder; made if it does not exist.
        study: name of the study.
        force: start over, without the cases that are there.

    Raises:
        BenchError: the folder holds something else, or cannot be written.
    """

    def __init__(self, folder: Path, study: str, force: bool = False) -> None:
        self.folder = folder
        self.study = study
        self._cases = folder / "cases"
        if folder.exists() and not folder.is_dir():
            raise BenchError(f"The results folder {folder} is a file; choose another with --out.")
        marker = folder / _MARKER
        if folder.is_dir() and any(folder.iterdir()):
            found = _read_json(marker).get("study") if marker.is_file() else None
            if found != study and not force:
                what = f"the study {found}" if found else "something else"
                raise BenchError(
                    f"The results folder {folder} holds {what}; choose another with --out, or add --force."
                )
            if force:
                shutil.rmtree(self._cases, ignore_errors=True)
        try:
            self._cases.mkdir(parents=True, exist_ok=True)
            write_whole(marker, json.dumps({"study": study}) + "\n")
        except OSError as error:
            raise BenchError(
                f"The results folder {folder} cannot be written ({error.strerror}); choose another with --out."
            ) from error

    def load(self, case: StudyCase) -> dict[str, Any] | None:
        """The case's result, None if it has none or was made under other conditions."""
        path = self._path(case)
        if not path.is_file():
            return None
        values = _read_json(path)
        if values.get("format") != FORMAT or values.get("fingerprint") != case.fingerprint:
            return None
        values["case"] = case.to_mapping()
        return values

    def save(self, case: StudyCase, result: dict[str, Any]) -> None:
        """Keep a result; the file is whole or not there."""
        document = {
            "format": FORMAT,
            "fingerprint": case.fingerprint,
            **result,
            "case": case.to_mapping(),
        }
        write_whole(self._path(case), json.dumps(document, indent=1) + "\n")

    def missing(self, cases: Iterable[StudyCase]) -> list[StudyCase]:
        """Cases without a result, in their order."""
        return [case for case in cases if self.load(case) is None]

    def _path(self, case: StudyCase) -> Path:
        return self._cases / f"{case.name}.json"


def _read_json(path: Path) -> dict[str, Any]:
    try:
        return read_json(path, "result")
    except BenchError:
        return {}
