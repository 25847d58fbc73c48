"""``./nmt export``: a recording as UFF58, CSV or NPZ, with the sidecar that imports it again."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, add_output_options, check_output
from nmt_core.errors import BenchError
from nmt_core.hardened import read_text

if TYPE_CHECKING:
    from nmt_record.bag_reader import Bag

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

FORMATS = ("uff", "csv", "npz")


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "export",
        help="a recording as UFF58, CSV or NPZ, ready for './nmt import'",
        description=(
            "Writes the samples of a bag, and the frequency responses beside it, for other tools, together with "
            "a sidecar: './nmt import' of that gives a bag from which './nmt extract' computes the same results."
        ),
    )
    parser.add_argument(
        "source",
        metavar="BAG",
        type=Path,
        help="rosbag2 folder, .mcap or .db3 file, or the results folder of a run, linear test or sweep",
    )
    parser.add_argument(
        "--format",
        choices=FORMATS,
        default="uff",
        help="uff: one dataset 58 a channel, binary (58b); csv; npz (default: uff)",
    )
    add_output_options(parser, "data.FORMAT, sidecar.yaml, oscillator.csv, loop.csv, linear.json, rig.yaml, frf.uff")
    parser.add_argument("--ascii", action="store_true", help="UFF in ASCII: 13 digits instead of every bit")
    parser.add_argument(
        "--segment",
        metavar="N",
        type=int,
        action="append",
        default=[],
        help="only the N-th segment (level) of the recording, into a folder segment-N; may be repeated",
    )


def run(arguments: argparse.Namespace) -> int:
    """Export, print what was written.

    Raises:
        BenchError: nothing to export, no such segment, or the files cannot be written.
    """
    check_output(arguments.out, arguments.force)
    if arguments.ascii and arguments.format != "uff":
        raise BenchError(f"--ascii is a form of UFF; leave it out for --format {arguments.format}.")

    from nmt_bench.commands.terminal import make_console
    from nmt_record.bag_reader import Bag
    from nmt_record.exported_run import linear_text

    responses = arguments.source / "frf.csv" if arguments.source.is_dir() else None
    responses = responses if responses is not None and responses.is_file() and arguments.format == "uff" else None
    bag = None
    if responses is None or (arguments.source / "bag").exists():
        bag = Bag.open(arguments.source)
    linear = linear_text(bag) if bag is not None else ""
    beside = arguments.source / "linear.json"
    if not linear and arguments.source.is_dir() and beside.is_file():
        linear = read_text(beside, "linear description")
    with OutputFolder(arguments.out, arguments.force) as folder:
        files = [] if bag is None else _export_samples(bag, folder, arguments, linear)
        if responses is not None:
            files += _export_responses(responses, folder, linear, not arguments.ascii)
    console = make_console()
    if bag is not None and bag.loss:
        console.print(bag.loss, style="yellow", markup=False)
    console.print(f"Results in {arguments.out}: {', '.join(files)}", markup=False, soft_wrap=True)
    sys.stdout.flush()
    return 0


def _export_samples(bag: Bag, folder: Path, arguments: argparse.Namespace, linear: str) -> list[str]:
    from nmt_record.exported_run import Extent, export_bag, level_spans, recorded_extent

    whole = recorded_extent(bag)
    rig = bag.rig_yaml or ""
    if not arguments.segment:
        return export_bag(bag, folder, arguments.format, whole, arguments.ascii, rig, linear)
    spans = level_spans(bag, whole)
    files = []
    for number in dict.fromkeys(arguments.segment):
        if not 1 <= number <= len(spans):
            has = f"segments 1 to {len(spans)}" if spans else "no segments"
            raise BenchError(f"The bag {arguments.source} has {has}, so there is no segment {number} to export.")
        span = spans[number - 1]
        part = folder / f"segment-{number}"
        part.mkdir()
        extent = Extent(span.first, span.stop)
        names = export_bag(bag, part, arguments.format, extent, arguments.ascii, rig, linear)
        files += [f"{part.name}/{name}" for name in names]
    return files


def _export_responses(table: Path, folder: Path, linear: str, binary: bool) -> list[str]:
    from nmt_core.linear_description import LinearDescription
    from nmt_record.exported_run import export_frf

    drive_point = 0
    if linear:
        drive_point = LinearDescription.from_json(linear).drive_point
    export_frf(table, folder / "frf.uff", drive_point, binary)
    return ["frf.uff"]
