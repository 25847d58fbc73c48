"""``./nmt diagnose --group``: each unit's diagnosis, and what they say together."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.command_parser import EXIT_DONE
from nmt_bench.commands.output_folder import OutputFolder
from nmt_core.errors import BenchError

if TYPE_CHECKING:
    from rich.console import Console

    from nmt_bench.commands.diagnose_command import DiagnoseOptions, DiagnosisProgress
    from nmt_diagnose.diagnosis_settings import DiagnosisSettings
    from nmt_rig.rig import Rig


def diagnose_group(
    options: DiagnoseOptions, rig: Rig, settings: DiagnosisSettings, console: Console, progress: DiagnosisProgress
) -> int:
    """Diagnose several units, write a folder for each and what they say together, print the verdict.

    Raises:
        BenchError: the table or a recording cannot be used.
    """
    from nmt_core.files.whole_file import write_whole
    from nmt_diagnose.diagnose import diagnose_bags
    from nmt_diagnose.units.unit_group import UnitDiagnosis, unit_group
    from nmt_diagnose.units.unit_table import read_unit_table
    from nmt_report.diagnosis_files import write_diagnosis
    from nmt_report.group_report import group_page

    assert options.group is not None
    if options.floor:
        raise BenchError("--floor belongs to one unit; give its repeats in the table of --group, column repeat.")
    rows, varied = read_unit_table(options.group)
    diagnoses, folders = [], []
    with OutputFolder(options.out, options.force) as folder:
        for number, row in enumerate(rows, start=1):
            name = f"{row.unit}{f', {row.setting}' if row.setting else ''}"
            progress.update(f"{name} ({number} of {len(rows)})")
            outcome = diagnose_bags(rig, row.recordings, (), settings, progress.update)
            place = Path(folder) / f"{number}-{re.sub(r'[^A-Za-z0-9]+', '-', name).strip('-')}"
            place.mkdir()
            write_diagnosis(outcome, place, options.model, options.set)
            diagnoses.append(UnitDiagnosis(row.unit, row.setting, outcome.diagnosis))
            folders.append((name, f"{place.name}/report.html"))
        group = unit_group(diagnoses, varied)
        content = {"format": "nmt units 1", "model": str(options.model), "group": group.to_mapping()}
        write_whole(Path(folder) / "diagnosis.json", json.dumps(content, indent=2, ensure_ascii=False) + "\n")
        write_whole(Path(folder) / "report.html", group_page(rig.name, rig.description, group, folders))
    console.print()
    for sentence in group.sentences:
        console.print(sentence, markup=False, highlight=False, soft_wrap=True)
    console.print(f"Report: {(options.out / 'report.html').resolve()}", soft_wrap=True)
    return EXIT_DONE
