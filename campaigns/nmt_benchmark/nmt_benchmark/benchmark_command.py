"""``./nmt benchmark``: speed of this machine against limits and peers measured in the same run."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_core.errors import BenchError
from nmt_core.options import option

if TYPE_CHECKING:
    from rich.table import Table

    from nmt_benchmark.benchmark_figures import Figure

PARTS = ("plant", "reference", "bag", "levels", "diagnosis", "ramp", "command", "bench", "channels", "scheduler")


SUMMARY = "speed of this machine against limits and peers"


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Measures the plant's time integration, the harmonic-balance reference, the work per block of each node, reading
    and extracting bags, runs of very many levels, a diagnosis, ramped levels, whole commands, and the whole bench
    with its nodes in one process and in one process each, also with many channels, and what a Dask scheduler leaves
    of its workers' time. Each figure is printed against its limit, or a peer measured in the same run, and
    the limits that were missed are named at the end. Takes some minutes on two idle cores."""

    json: Path | None = option(None, "also write the figures to this JSON file", metavar="FILE")
    part: tuple[str, ...] = option((), "measure this part only; may be repeated (default: all parts)", choices=PARTS)
    seconds: float = option(20.0, "bench time of each timed run, s (default: 20); longer is steadier", metavar="S")
    check: bool = option(False, "exit with code 1 if a limit is missed")


def run(options: BenchmarkOptions) -> int:
    """Measure and print.

    Returns:
        0; with ``--check`` 1 if a limit is missed.

    Raises:
        BenchError: a wrong option.
    """
    if not 1.0 <= options.seconds <= 3600.0:
        raise BenchError(f"--seconds must be between 1 and 3600, got {options.seconds:g}.")
    if options.json is not None and not options.json.absolute().parent.is_dir():
        raise BenchError(f"The folder of {options.json} does not exist; make it or give another --json file.")

    from nmt_bench.commands.console import make_console
    from nmt_benchmark import benchmark_figures, channel_figures, scheduler_figures

    console = make_console()
    parts: dict[str, Callable[[float], list[Figure]]] = {
        "plant": benchmark_figures.plant_figures,
        "reference": benchmark_figures.reference_figures,
        "bag": benchmark_figures.bag_figures,
        "levels": benchmark_figures.level_figures,
        "diagnosis": benchmark_figures.diagnosis_figures,
        "ramp": benchmark_figures.ramp_figures,
        "command": channel_figures.command_figures,
        "bench": channel_figures.bench_figures,
        "channels": channel_figures.channel_figures,
        "scheduler": scheduler_figures.scheduler_figures,
    }
    figures: list[Figure] = []
    for name in options.part or PARTS:
        with console.status(f"measuring: {name}"):
            figures += parts[name](options.seconds)
    console.print(figure_table(figures))
    if options.json is not None:
        text = json.dumps({"figures": [asdict(figure) for figure in figures]}, indent=1, ensure_ascii=False)
        options.json.write_text(text + "\n", encoding="utf-8")
        console.print(f"Figures in {options.json}")
    missed = [figure for figure in figures if figure.met is False]
    if missed:
        console.print(f"Missed: {'; '.join(figure.name for figure in missed)}.")
    return 1 if options.check and missed else 0


def figure_table(figures: Sequence[Figure]) -> Table:
    """The figures against their limits and peers."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    from nmt_report.quantity_format import significant

    table = Table(box=SIMPLE_HEAD, header_style="bold")
    table.add_column("figure")
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("limit or peer", justify="right", no_wrap=True)
    table.add_column("limit or peer")
    table.add_column("")
    for figure in figures:
        if figure.value is None:
            table.add_row(figure.name, "—", "", Text(figure.note, style="yellow"), "")
            continue
        verdict = {True: Text("met", style="green"), False: Text("missed", style="red"), None: Text("")}[figure.met]
        compared = "" if figure.compared is None else f"{significant(figure.compared, 3)} {figure.unit}"
        table.add_row(figure.name, f"{significant(figure.value, 3)} {figure.unit}", compared, figure.note, verdict)
    return table
