"""``./nmt import``: data measured elsewhere becomes a bag of the bench."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, replace_option
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.options import option, optional_argument
from nmt_core.vocabulary import TestKind

if TYPE_CHECKING:
    from rich.table import Table

    from nmt_record.exchange.imports.imported_run import ImportedRun

_DATA = (".csv", ".txt", ".tsv", ".dat", ".asc", ".npz", ".mat", ".h5", ".hdf5", ".uff", ".unv", ".58", ".lvm",
         ".tdms", ".mcap", ".db3", ".nc", ".nc4")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Reads time data, frequency responses and backbones measured elsewhere, and any ROS 2 bag, as a sidecar describes
    them, checks them, and writes a bag that './nmt extract' and './nmt diagnose' take. What cannot be right is
    refused with one sentence; what was fixed is said and kept in the bag."""

    sidecar: Path | None = optional_argument(
        None, "YAML file that says what the columns of the data are", metavar="SIDECAR", exclusive=True
    )
    init: Path | None = option(
        None,
        "look into a data file or ROS 2 bag and write its sidecar (.yaml) into the same folder; one for each "
        "recording or topic",
        metavar="FILE",
        exclusive=True,
    )
    robot: Path | None = option(
        None, "with --init: MJCF or URDF file of the robot whose joints FILE is a log of", metavar="ROBOT.xml"
    )
    out: Path = dated_folder_option("bag/", "import")
    force: bool = replace_option()


def run(options: ImportOptions) -> int:
    """Read, check, write the bag, print what was found.

    Raises:
        BenchError: the sidecar or the data is wrong, or the bag cannot be written.
    """
    if options.init is not None and options.robot is not None:
        from nmt_bench.commands.robot_diagnosis import propose_robot_sidecar

        return propose_robot_sidecar(options.init, options.robot, options.force)
    if options.robot is not None:
        raise BenchError("--robot goes with --init: ./nmt import --init LOG --robot ROBOT.xml.")
    if options.init is not None:
        return _init(options.init, options.force)
    sidecar = options.sidecar
    assert sidecar is not None  # the parser takes exactly one of the two
    check_output(options.out, options.force)
    from nmt_record.exchange.templates.sidecar_template import no_sidecar

    if not sidecar.is_file() or sidecar.suffix.lower() in _DATA:
        raise no_sidecar(sidecar)
    if re.search(r"^robot_log\s*:", read_text(sidecar, "sidecar"), re.M):
        raise BenchError(
            f"{sidecar} is the sidecar of a robot's log, which needs no import: "
            f"./nmt diagnose --model ROBOT.xml --real {sidecar} --out DIR."
        )

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_bench.data_import import read_data, write_data

    console = make_console()
    with WorkDisplay(console, ("reading the data", "writing the bag")) as display:
        imported, rig = read_data(sidecar)
        display.step()
        with OutputFolder(options.out, options.force) as folder:
            write_data(imported, rig, folder / "bag")
    if imported.channels:
        console.print(_channel_table(imported))
    if imported.segments or imported.tables:
        console.print(_segment_table(imported))
    for note in imported.notes:
        console.print(note, style="yellow", soft_wrap=True)
    if imported.channels and imported.linear is None:
        decays = imported.segments and all(segment.section.test is TestKind.RING_DOWN for segment in imported.segments)
        without = "gives frequency and damping of each channel" if decays else "will need --linear FILE"
        console.print(f"No linear modes: './nmt extract' {without}.")
    console.print(f"Results in {options.out}: bag")
    if rig.text:
        model = sidecar.parent / str(imported.sidecar.rig)
        name = model if model.is_file() else imported.sidecar.rig
        console.print(f"What the model lacks: ./nmt diagnose --model {name} --real {options.out}", soft_wrap=True)
    return 0


def _init(data: Path, force: bool) -> int:
    """Write a sidecar to start from.

    Raises:
        BenchError: the data cannot be read, or there is a sidecar already.
    """
    from nmt_core.files.whole_file import write_whole, writing
    from nmt_record.exchange.templates.sidecar_template import sidecar_templates

    texts = sidecar_templates(data)
    stems = [data.stem] if len(texts) == 1 else [f"{data.stem}-{number + 1}" for number in range(len(texts))]
    targets = [data.with_name(f"{stem}.yaml") for stem in stems]
    there = next((target for target in targets if target.exists() and not force), None)
    if there is not None:
        raise BenchError(f"{there} exists already; move it away or give --force to write it anew.")
    for target, text in zip(targets, texts, strict=True):
        with writing(target):
            write_whole(target, text)
        asks = "Answer what has a question mark and check" if "'?'" in text else "Check"
        sys.stdout.write(f"{text}\nWritten to {target}. {asks} it, then: ./nmt import {target} --out DIR\n")
    return 0


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
        unit, words = channel.section.si_unit, channel.section.quantity.replace("_", " ")
        table.add_row(
            channel.name,
            channel.source,
            words if channel.section.force_factor is None else f"{words} as force",
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
