"""``./nmt export``: a recording as UFF58, CSV, NPZ, HDF5 or MATLAB, with the sidecar that imports it again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, replace_option
from nmt_core.errors import BenchError
from nmt_core.options import argument, option
from nmt_record.exchange import FORMATS

_OTHER_NAMES = {"hdf5": "h5", "hdf": "h5", "matlab": "mat", "uff58": "uff", "unv": "uff"}


def _format(word: str) -> str:
    return _OTHER_NAMES.get(word.lower(), word.lower())


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Writes the samples of a bag, and the frequency responses next to it, for other tools, together with a sidecar:
    './nmt import' of that gives a bag from which './nmt extract' computes the same results. With UFF the modes of a
    linear test, or of the levels of a run, come too: modes.uff with nodes, trace line and shapes (data sets 15, 82,
    55)."""

    source: Path = argument(
        "rosbag2 folder, .mcap or .db3 file, or the results folder of a run, linear test or sweep", metavar="BAG"
    )
    format: str = option(
        "uff",
        "uff: one dataset 58 a channel, binary (58b); csv; npz; h5: HDF5; mat: MATLAB 5 (default: uff)",
        choices=FORMATS,
        parse=_format,
    )
    out: Path = dated_folder_option(
        "data.FORMAT, sidecar.yaml, oscillator.csv, loop.csv, linear.json, rig.yaml, frf.uff, modes.uff", "export"
    )
    force: bool = replace_option()
    ascii: bool = option(False, "UFF in ASCII: 13 digits instead of every bit")
    segment: tuple[int, ...] = option(
        (), "only the N-th segment (level) of the recording, into a folder segment-N; may be repeated", metavar="N"
    )


def run(options: ExportOptions) -> int:
    """Export, print what was written.

    Raises:
        BenchError: nothing to export, no such segment, or the files cannot be written.
    """
    check_output(options.out, options.force)
    if options.ascii and options.format != "uff":
        raise BenchError(f"--ascii is a form of UFF; leave it out for --format {options.format}.")

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_record.exchange.export.exported_run import export_run

    console = make_console()
    with WorkDisplay(console, ("exporting",)), OutputFolder(options.out, options.force) as folder:
        exported = export_run(options.source, folder, options.format, ascii_uff=options.ascii, only=options.segment)
        files = list(exported.files)
        if options.format == "uff" and _export_modes(options.source, folder):
            files.append("modes.uff")
    if exported.loss:
        console.print(exported.loss, style="yellow")
    console.print(f"Results in {options.out}: {', '.join(files)}", soft_wrap=True)
    return 0


def _export_modes(source: Path, folder: Path) -> bool:
    """Write ``modes.uff`` where the results folder has modes; returns whether it has.

    Raises:
        BenchError: the results are damaged, or the file cannot be written.
    """
    from nmt_core.files.hardened import read_text
    from nmt_core.messages.linear_description import LinearDescription
    from nmt_extract.modal.mode_uff import level_modes, linear_modes, write_mode_uff
    from nmt_extract.modal.table import read_json

    if (source / "modal.json").is_file():
        modes = level_modes(read_json(source / "modal.json")[0])
    elif (source / "linear.json").is_file():
        modes = linear_modes(LinearDescription.from_json(read_text(source / "linear.json", "linear description")))
    else:
        return False
    if not modes:
        return False
    write_mode_uff(folder / "modes.uff", modes, _positions(folder / "rig.yaml"))
    return True


def _positions(rig_file: Path) -> dict[int, float]:
    """x of the points of a beam, m; empty for any other structure, whose points get their numbers."""
    from nmt_rig.rig import load_rig

    if not rig_file.is_file():
        return {}
    structure = load_rig(rig_file).structure
    if structure.kind != "beam":
        return {}
    spacing = structure.length_m / structure.elements
    offset = 1 if structure.boundary == "free-free" else 0  # its point 1 is the left end
    return {point: (point - offset) * spacing for point in structure.points}
