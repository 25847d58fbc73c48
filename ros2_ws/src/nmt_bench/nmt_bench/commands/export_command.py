"""``./nmt export``: a recording as UFF58, CSV or NPZ, with the sidecar that imports it again."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, add_output_options, check_output
from nmt_core.errors import BenchError

if TYPE_CHECKING:
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
    from nmt_record.exported_run import export_run

    with OutputFolder(arguments.out, arguments.force) as folder:
        exported = export_run(
            arguments.source, folder, arguments.format, ascii_uff=arguments.ascii, only=arguments.segment
        )
    console = make_console()
    if exported.loss:
        console.print(exported.loss, style="yellow", markup=False)
    console.print(f"Results in {arguments.out}: {', '.join(exported.files)}", markup=False, soft_wrap=True)
    sys.stdout.flush()
    return 0
