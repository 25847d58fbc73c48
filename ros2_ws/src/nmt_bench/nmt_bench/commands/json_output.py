"""``--json``: what a command did, as one JSON document on standard output; all else goes to standard error."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from types import ModuleType
from typing import Any

_RESULTS = {
    "demo": "modal.json",
    "run": "modal.json",
    "extract": "modal.json",
    "linear": "linear.json",
    "sweep": "frf.csv",
    "synthesis": "synthesis.csv",
    "reference": "reference.csv",
    "diagnose": "diagnosis.json",
    "repair": "repair.json",
    "study": "study.csv",
    "check": "check.json",
}
"""The file in the results folder that holds a command's results."""


def json_document(command: str, options: Any, module: ModuleType, status: int) -> str:
    """The document of a command that ended.

    Args:
        command: its name.
        options: its options; the results folder is their ``results_folder`` or, without one, their ``out``.
        module: of the command; its function ``json_results(options)``, where it has one, gives the results.
        status: exit code.

    Returns:
        ``command``, ``exit_code``, ``out`` (the results folder), ``files`` (in it) and ``results``: the contents of the
        command's main file; None where there is none.
    """
    out: Path | None = getattr(options, "results_folder", None) or getattr(options, "out", None)
    files = sorted(item.name for item in out.iterdir()) if out is not None and out.is_dir() else []
    results: Any = None
    if hasattr(module, "json_results"):
        results = module.json_results(options)
    elif out is not None and _RESULTS.get(command) in files:
        results = contents_of(out / _RESULTS[command])
    document = {
        "command": command,
        "exit_code": status,
        "out": None if out is None else str(out),
        "files": files,
        "results": results,
    }
    return json.dumps(document, ensure_ascii=False, indent=1) + "\n"


def json_refusal(command: str | None, status: int, sentence: str | None) -> str:
    """The document of a command that was refused or failed."""
    return json.dumps({"command": command, "exit_code": status, "error": sentence}, ensure_ascii=False, indent=1) + "\n"


def contents_of(path: Path) -> Any:
    """Content of a result file for JSON: rows of a table as mappings."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return json.loads(text)
    lines = (line for line in text.splitlines() if not line.startswith("#"))
    return [{name: _value(cell) for name, cell in row.items()} for row in csv.DictReader(lines)]


def _value(cell: str) -> float | int | str | None:
    """A cell as a number where it is one; None where it is empty or no finite number."""
    for kind in (int, float):
        try:
            value = kind(cell)
        except ValueError:
            continue
        return value if abs(value) < float("inf") else None
    return cell or None
