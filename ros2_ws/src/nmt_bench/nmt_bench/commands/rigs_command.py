"""``./nmt rigs``: the rigs that can be given by name, and what a file of matrices says of a structure."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_core.options import option

if TYPE_CHECKING:
    from nmt_rig.model_figures import ModelFigures


@dataclass(frozen=True, kw_only=True)
class RigsOptions:
    """Lists the rigs that every command takes by name, with where their files are: those in the folders of the
    variable NMT_RIG_PATH, then those that come with the bench. Copy a file to make a rig of your own. With --check it
    says what a file of a finite-element program holds: nodes, directions, mass, first frequencies; of a rig file,
    whether it loads, and its structure, frequencies and channels."""

    paths: bool = option(False, "also the path of each file")
    check: tuple[Path, ...] = option(
        (),
        "rig file, or file of matrices to look into; mass and stiffness may be given one after the other",
        metavar="FILE",
    )
    units: str = option("m-kg-N", "length, mass and force of these files, such as mm-t-N", metavar="UNITS")
    nodes: Path | None = option(None, "file with the coordinates of their nodes", metavar="FILE")
    rows: Path | None = option(None, "file with node.direction of each row", metavar="FILE")


def rig_rows() -> list[dict[str, str]]:
    """Name, description and path of each rig, in the order of the names.

    Raises:
        BenchError: a rig file cannot be read.
    """
    from nmt_core.files.yaml_document import read_document
    from nmt_rig.rig_places import find_rig, rig_names

    rows = []
    for name in rig_names():
        path = find_rig(name)
        values = read_document(path).values
        description = values.get("description", "") if isinstance(values, dict) else ""
        rows.append({"name": name, "description": str(description or ""), "path": str(path)})
    return rows


def checked_model(options: RigsOptions) -> ModelFigures:
    """What the files of ``--check`` hold.

    Raises:
        BenchError: a file cannot be read, or two of them hold the same.
    """
    from nmt_core.errors import BenchError
    from nmt_rig.model_figures import model_figures
    from nmt_rig.superelement_texts import quantity_of

    keys = ["file"] if len(options.check) == 1 else [f"{quantity_of(path)}_file" for path in options.check]
    if "None_file" in keys or len(set(keys)) < len(keys):
        names = " and ".join(path.name for path in options.check)
        raise BenchError(f"Which matrices {names} hold does not follow from their names; name them as K.mtx and M.mtx.")
    paths = dict(zip(keys, options.check, strict=True))
    more = {"nodes_file": options.nodes, "rows_file": options.rows}
    return model_figures(paths | {key: path for key, path in more.items() if path is not None}, options.units)


def rig_figures(path: Path) -> dict[str, Any]:
    """What a rig file holds, as words by heading.

    Raises:
        BenchError: what is wrong with it, with the line.
    """
    from nmt_rig.linear_description import linear_description
    from nmt_rig.rig import load_rig
    from nmt_rig.structure_sections import point_words

    rig = load_rig(path)
    modes = linear_description(rig)
    hertz = ", ".join(f"{omega / 6.283185307179586:.6g}" for omega in modes.frequencies_rad_s)
    ratios = ", ".join(f"{100.0 * ratio:.4g}" for ratio in modes.damping_ratios)
    source = getattr(rig.structure, "source", "")
    return {
        "rig": rig.name,
        "structure": f"{rig.structure.kind}, {point_words(rig.structure.points)}{f', from {source}' if source else ''}",
        "frequencies": f"{hertz} Hz, damping ratios {ratios} %",
        "exciters": ", ".join(f"{exciter.kind} at point {exciter.point}" for exciter in rig.all_exciters),
        "channels": ", ".join(rig.sensor_channel(sensor) for sensor in rig.sensors),
    }


def _are_rigs(options: RigsOptions) -> bool:
    return bool(options.check) and all(path.suffix.lower() in (".yaml", ".yml") for path in options.check)


def json_results(options: RigsOptions) -> list[dict[str, Any]] | dict[str, Any]:
    """What ``--json`` prints."""
    if _are_rigs(options):
        return [rig_figures(path) for path in options.check]
    return asdict(checked_model(options)) if options.check else rig_rows()


def run(options: RigsOptions) -> int:
    """Print the list, or what files of matrices hold.

    Raises:
        BenchError: a rig file or a file of matrices cannot be read.
    """
    from rich.table import Table

    from nmt_bench.commands.console import make_console

    if options.check:
        if _are_rigs(options):
            lines = [f"{name}: {words}" for path in options.check for name, words in rig_figures(path).items()]
        else:
            lines = checked_model(options).lines(options.units)
        for line in lines:
            make_console().print(line, markup=False, highlight=False, soft_wrap=True)
        return 0
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for row in rig_rows():
        table.add_row(row["name"], row["description"], *([row["path"]] if options.paths else []))
    make_console().print(table)
    return 0
