"""``./nmt rigs``: the rigs that can be given by name."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.options import option


@dataclass(frozen=True, kw_only=True)
class RigsOptions:
    """Lists the rigs that every command takes by name, with where their files are: those in the folders of the
    variable NMT_RIG_PATH, then those that come with the bench. Copy a file to make a rig of your own."""

    paths: bool = option(False, "also the path of each file")


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


def json_results(options: RigsOptions) -> list[dict[str, str]]:
    """What ``--json`` prints."""
    return rig_rows()


def run(options: RigsOptions) -> int:
    """Print the list.

    Raises:
        BenchError: a rig file cannot be read.
    """
    from rich.table import Table

    from nmt_bench.commands.console import make_console

    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for row in rig_rows():
        table.add_row(row["name"], row["description"], *([row["path"]] if options.paths else []))
    make_console().print(table)
    return 0
