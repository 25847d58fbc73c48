"""``./nmt reference``: the computed backbone of a rig's model."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, replace_option, set_option
from nmt_core.errors import BenchError
from nmt_core.options import argument, option

if TYPE_CHECKING:
    from rich.table import Table

    from nmt_report.run_data import ReferenceCurve
    from nmt_rig.reference import Reference
    from nmt_rig.rig import Rig


CONVERGENCE_ORDERS = (1, 3, 5, 7, 20, 61)


def _band(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a band; give it in Hz as in 15:45") from None
    return low, high


@dataclass(frozen=True, kw_only=True)
class ReferenceOptions:
    """Computes modal frequency and damping over modal amplitude of a rig's model by the extended periodic motion
    concept (EPMC) with harmonic balance: what a perfect test of the mode would give. Give the file to './nmt
    extract --reference' to compare a test with it."""

    rig: str = argument("name of a rig (for example beam) or path of a rig file", metavar="RIG")
    out: Path = dated_folder_option("reference.csv, shapes.csv, report.html", "reference")
    force: bool = replace_option()
    set: tuple[str, ...] = set_option("local_elements.0.slip_force_n=2")
    harmonics: int = option(7, "highest harmonic order, 1 to 200 (default: 7)", metavar="H")
    amplitudes: str | None = option(
        None,
        "modal amplitudes, m√kg: n from q1 to q2 in geometric steps (default: 100 beyond the rig's levels)",
        metavar="q1:q2:n",
    )
    forces: str | None = option(
        None,
        "response curves at these forces (N), a,b,c or a:b:n, with folds and Floquet stability, instead of the "
        "backbone",
        metavar="PLAN",
    )
    band: tuple[float, float] | None = option(
        None,
        "with --forces: lowest and highest frequency, Hz (default: the loop's guard band, at least 0.5 to 1.5 of "
        "the mode's)",
        metavar="LOW:HIGH",
        parse=_band,
    )
    compare: Path | None = option(
        None,
        "table with the columns of reference.csv to compare with, at its own amplitudes unless --amplitudes is given",
        metavar="FILE",
    )
    convergence: bool = option(False, "also print how the result converges over 1, 3, 5, 7, 20, 61 harmonics")


def run(options: ReferenceOptions) -> int:
    """Compute the backbone, write its tables and report.

    Raises:
        BenchError: a wrong rig, option or folder, or no solution.
    """
    check_output(options.out, options.force)
    if not 1 <= options.harmonics <= 200:
        raise BenchError(f"--harmonics must be a whole number from 1 to 200, got {options.harmonics}.")

    if options.forces is not None:
        return _response_curves(options, options.forces)
    if options.band is not None:
        raise BenchError("--band belongs to --forces; give forces, or leave it out.")
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_report.reference_report import reference_page
    from nmt_report.run_data import read_reference
    from nmt_rig.reference import (
        compute_reference,
        default_amplitudes,
        point_shapes,
        write_reference_csv,
        write_shapes_csv,
    )
    from nmt_rig.rig import load_rig

    amplitudes = _amplitudes(options.amplitudes) if options.amplitudes else None
    given = read_reference(options.compare) if options.compare is not None else None
    if given is not None and amplitudes is None:
        amplitudes = [float(q) for q in given.modal_amplitude]
    rig = load_rig(options.rig, options.set)
    if amplitudes is None:
        amplitudes = [float(q) for q in default_amplitudes(rig)]
    console = make_console()
    steps = "compiling", f"computing {len(amplitudes)} points of the backbone", "writing the report"
    with WorkDisplay(console, steps) as display, OutputFolder(options.out, options.force) as folder:
        compute_reference(rig, options.harmonics, amplitudes[:: max(1, len(amplitudes) // 4)])
        display.step()
        began = time.perf_counter()
        reference = compute_reference(rig, options.harmonics, amplitudes)
        elapsed = time.perf_counter() - began
        display.step()
        shapes = point_shapes(rig, reference)
        write_reference_csv(reference, folder / "reference.csv")
        write_shapes_csv(reference, shapes, folder / "shapes.csv")
        (folder / "report.html").write_text(reference_page(rig, reference, shapes, given), encoding="utf-8")
    for line in _summary(reference):
        console.print(line)
    console.print(f"solved in {elapsed:.3f} s once compiled")
    if given is not None and options.compare is not None:
        console.print(_comparison(reference, given, options.compare), soft_wrap=True)
    if options.convergence:
        console.print(_convergence(rig, reference))
    console.print(f"Results in {options.out}: reference.csv, shapes.csv, report.html")
    return 0


def _response_curves(options: ReferenceOptions, forces: str) -> int:
    """Compute response curves, write their tables and report.

    Raises:
        BenchError: as :func:`run`, or an option of the backbone is given.
    """
    if options.amplitudes or options.compare or options.convergence:
        raise BenchError(
            "--amplitudes, --compare and --convergence belong to the backbone; leave them out, or leave out --forces."
        )
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_report.curve_figures import reference_curve_page, reference_sentences
    from nmt_rig.response_reference import reference_responses, write_reference_responses
    from nmt_rig.rig import load_rig
    from nmt_sequencer.level_plan import parse_levels

    rig, levels = load_rig(options.rig, options.set), parse_levels(forces)
    console = make_console()
    steps = f"computing {len(levels)} response curves", "writing the report"
    with WorkDisplay(console, steps) as display, OutputFolder(options.out, options.force) as folder:
        responses = reference_responses(rig, levels, options.harmonics, options.band)
        display.step()
        write_reference_responses(responses, folder)
        (folder / "report.html").write_text(reference_curve_page(rig, responses), encoding="utf-8")
    for line in reference_sentences(responses):
        console.print(line, soft_wrap=True)
    console.print(f"Results in {options.out}: response_curve.csv, response_folds.csv, report.html")
    return 0


def _comparison(reference: Reference, given: ReferenceCurve, path: Path) -> str:
    """Largest relative distances to a table, at its own amplitudes or those within both curves."""
    import numpy as np

    errors = []
    for q, omega, damping in zip(
        reference.modal_amplitude, reference.omega_rad_s, reference.damping_ratio, strict=True
    ):
        expected = given.at(float(q))
        errors.append((abs(omega / expected[0] - 1.0), abs(damping / expected[1] - 1.0)))
    inside = np.array([pair for pair in errors if np.all(np.isfinite(pair))])
    if not inside.size:
        return f"{path} has no modal amplitude in common with the reference."
    worst = inside.max(axis=0)
    return (
        f"against {path} at {len(inside)} amplitudes: largest relative error of modal frequency {worst[0]:.1e}, "
        f"of damping ratio {worst[1]:.1e}"
    )


def _convergence(rig: Rig, reference: Reference) -> Table:
    """Distance of truncated series to the finest."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from nmt_rig.reference import convergence_table

    table = Table(title="Convergence over harmonics", title_justify="left", box=SIMPLE_HEAD)
    for head in ("harmonics", "modal frequency", "damping ratio"):
        table.add_column(head, justify="right")
    rows = convergence_table(rig, CONVERGENCE_ORDERS, reference.modal_amplitude)
    for row in rows[:-1]:
        table.add_row(str(row.harmonics), f"{row.omega_error:.1e}", f"{row.damping_error:.1e}")
    table.caption = f"largest relative distance to {rows[-1].harmonics} harmonics over the backbone"
    return table


def _summary(reference: Reference) -> list[str]:
    from math import pi

    from nmt_report.quantity_format import significant

    q, omega, damping = reference.modal_amplitude, reference.omega_rad_s, reference.damping_ratio
    lines = [
        f"{q.size} points with {reference.harmonics} harmonics, q from {significant(q[0], 3)} to "
        f"{significant(q[-1], 3)} m√kg",
        f"modal frequency {omega.min() / (2 * pi):.4f} to {omega.max() / (2 * pi):.4f} Hz, modal damping "
        f"ratio {100 * damping.min():.3f} to {100 * damping.max():.3f} %, highest at q = "
        f"{significant(float(q[damping.argmax()]), 3)} m√kg",
    ]
    if not reference.single_valued:
        lines.append("The backbone folds over q; the first crossing is given.")
    return lines


def _amplitudes(text: str) -> list[float]:
    import numpy as np

    parts = text.split(":")
    try:
        low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
        good = len(parts) == 3 and 0.0 < low < high < float("inf") and 2 <= count <= 100_000
    except (ValueError, IndexError):
        good = False
    if not good:
        raise BenchError(
            f"--amplitudes must be q1:q2:n with 0 < q1 < q2 (m√kg) and n ≥ 2 as in 1e-5:1e-2:100, got '{text}'."
        )
    return [float(value) for value in np.geomspace(low, high, count)]
