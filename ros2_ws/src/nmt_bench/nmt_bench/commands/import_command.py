"""``./nmt import``: data measured elsewhere becomes a bag of the bench."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, add_output_options, check_output
from nmt_core.errors import BenchError

if TYPE_CHECKING:
    from rich.table import Table

    from nmt_core.linear_description import LinearDescription
    from nmt_record.import_sidecar import Sidecar
    from nmt_record.imported_run import ImportedRun

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "import",
        help="data measured elsewhere (CSV, NPZ, UFF58, tables) as a bag",
        description=(
            "Reads time data, frequency responses and backbones measured elsewhere as a sidecar describes them, "
            "checks them, and writes a bag that './nmt extract' and './nmt diagnose' take. What cannot be right "
            "is refused with one sentence; what was mended is said and kept in the bag."
        ),
    )
    parser.add_argument(
        "sidecar", metavar="SIDECAR", type=Path, help="YAML file that says what the columns of the data are"
    )
    add_output_options(parser, "bag/")


def run(arguments: argparse.Namespace) -> int:
    """Read, check, write the bag, print what was found.

    Raises:
        BenchError: the sidecar or the data is wrong, or the bag cannot be written.
    """
    check_output(arguments.out, arguments.force)

    from nmt_bench.commands.terminal import make_console
    from nmt_record.imported_run import read_import, write_import
    from nmt_session.node_plan import versions

    rig = _RigOfImport(arguments.sidecar)
    imported = read_import(arguments.sidecar, rig.describe)
    rig.resolve(imported.sidecar)
    imported.notes += rig.notes
    _check_extraction(imported.sidecar)
    with OutputFolder(arguments.out, arguments.force) as folder:
        write_import(imported, folder / "bag", rig.name, rig.text, versions())
    console = make_console()
    if imported.channels:
        console.print(_channel_table(imported))
    if imported.segments or imported.tables:
        console.print(_segment_table(imported))
    for note in imported.notes:
        console.print(note, style="yellow", markup=False, soft_wrap=True)
    if imported.channels and imported.linear is None:
        console.print("No linear modes: './nmt extract' will need --linear FILE.", markup=False)
    console.print(f"Results in {arguments.out}: bag", markup=False)
    sys.stdout.flush()
    return 0


class _RigOfImport:
    """The rig that a sidecar names, if there is a file for it."""

    def __init__(self, sidecar: Path) -> None:
        self._folder = sidecar.parent
        self._resolved = False
        self._linear: LinearDescription | None = None
        self.name = ""
        self.text = ""
        self.notes: list[str] = []

    def describe(self, sidecar: Sidecar) -> LinearDescription | None:
        """Linear modes of the rig's model at the points that were measured."""
        self.resolve(sidecar)
        return self._linear

    def resolve(self, sidecar: Sidecar) -> None:
        """Find and load the rig file.

        Raises:
            BenchError: a path that leads nowhere, or a rig file with a mistake.
        """
        if self._resolved or sidecar.rig is None:
            return
        self._resolved = True
        path = self._find(sidecar.rig)
        if path is None:
            self.name = sidecar.rig
            self.notes.append(f"There is no rig file '{sidecar.rig}'; the bag names the rig and holds no file of it.")
            return
        from nmt_rig.rig import load_rig
        from nmt_rig.rig_snapshot import rig_text

        rig = load_rig(path)
        overrides = []
        points = {channel.point for channel in sidecar.channels if channel.quantity == "force" and channel.point}
        if len(points) == 1 and points != {rig.drive_point}:
            overrides = [f"exciter.point={points.pop()}"]
            rig = load_rig(path, overrides)
            self.notes.append(f"The force was measured at point {rig.drive_point}; the rig's exciter was put there.")
        self.name, self.text = rig.name, rig_text(rig, path, overrides)
        if sidecar.linear is None and sidecar.channels:
            from nmt_rig.linear_description import linear_description

            self._linear = self._measured(linear_description(rig), sidecar)

    def _find(self, name: str) -> Path | None:
        from nmt_rig.rig import find_rig

        beside = self._folder / name
        if beside.is_file():
            return beside
        if "/" in name or name.endswith((".yaml", ".yml")):
            raise BenchError(
                f"The sidecar names the rig file {name}, which is not beside it ({beside}); correct 'rig'."
            )
        try:
            return find_rig(name)
        except BenchError:
            return None

    def _measured(self, linear: LinearDescription, sidecar: Sidecar) -> LinearDescription | None:
        """The description restricted to the points that one kind of sensor covers."""
        best: list[int] = []
        for quantity in ("displacement", "velocity", "acceleration"):
            points = {channel.point for channel in sidecar.channels if channel.quantity == quantity}
            rows = [row for row, point in enumerate(linear.points) if point in points]
            best = rows if len(rows) > len(best) else best
        if len(best) == len(linear.points):
            return linear
        if not best or len(best) <= linear.target_mode:
            self.notes.append("The rig's model has no modes at the measured points, so the bag holds no linear modes.")
            return None
        modes = min(len(best), len(linear.frequencies_rad_s))
        kept = tuple(linear.points[row] for row in best)
        self.notes.append(
            f"The rig's linear modes were restricted to the measured points {', '.join(map(str, kept))} "
            f"({modes} mode{'s' if modes > 1 else ''})."
        )
        return dataclasses.replace(
            linear,
            points=kept,
            frequencies_rad_s=linear.frequencies_rad_s[:modes],
            damping_ratios=linear.damping_ratios[:modes],
            shapes=tuple(linear.shapes[row][:modes] for row in best),
        )


def _check_extraction(sidecar: Sidecar) -> None:
    if sidecar.extraction is not None:
        from nmt_extract.settings import ExtractionSettings

        ExtractionSettings.from_mapping(sidecar.extraction)


def _channel_table(imported: ImportedRun) -> Table:
    import numpy as np
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    seconds = imported.samples / imported.sample_rate
    table = Table(
        title=f"{imported.samples} samples at {imported.sample_rate:.10g} Hz ({seconds:.6g} s)",
        title_justify="left",
        box=SIMPLE_HEAD,
    )
    for head in ("channel", "column", "quantity", "point", "lowest", "highest", "missing"):
        table.add_column(head, justify="left" if head in ("channel", "column", "quantity") else "right")
    for channel in imported.channels:
        unit = channel.quantity.unit
        table.add_row(
            channel.name,
            channel.source,
            channel.quantity.name.lower(),
            str(channel.point or ""),
            f"{np.nanmin(channel.data):.4g} {unit}",
            f"{np.nanmax(channel.data):.4g} {unit}",
            str(int(np.isnan(channel.data).sum()) or ""),
        )
    return table


def _segment_table(imported: ImportedRun) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD)
    for head in ("segment", "level", "from", "to", "window"):
        table.add_column(head, justify="left" if head == "segment" else "right")
    for segment in imported.segments:
        section = segment.section
        level = "" if section.level is None else f"{section.level:g} {section.level_unit}"
        begin, end = segment.first_sample / imported.sample_rate, segment.stop_sample / imported.sample_rate
        window = "not locked"
        if segment.window is not None:
            window = " to ".join(f"{sample / imported.sample_rate:.6g} s" for sample in segment.window)
        table.add_row(section.kind, level, f"{begin:.6g} s", f"{end:.6g} s", window)
    for number in imported.tables:
        rows = number.columns["frequency_hz"]
        table.add_row(
            f"{number.kind} {number.name}".strip(),
            "",
            f"{rows.min():.6g} Hz",
            f"{rows.max():.6g} Hz",
            f"{number.rows} rows: {', '.join(number.columns)}",
        )
    return table
