"""``./nmt reference``: the computed backbone of a rig's model."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from nmt_bench.output_folder import OutputFolder, add_output_options, check_output
from nmt_core.errors import BenchError

if TYPE_CHECKING:
    from nmt_plant.reference import Reference

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "reference",
        help="computed backbone of a rig's model (EPMC, harmonic balance)",
        description=(
            "Computes modal frequency and damping over modal amplitude of a rig's model by the extended "
            "periodic motion concept (EPMC) with harmonic balance: what a perfect test of the mode would "
            "give. Give the file to './nmt extract --reference' to compare a test with it."
        ),
    )
    parser.add_argument("rig", metavar="RIG", help="name of a rig (for example beam) or path of a rig file")
    add_output_options(parser, "reference.csv")
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change a value of the rig file, for example local_elements.0.slip_force_n=2; may be repeated",
    )
    parser.add_argument(
        "--harmonics", metavar="H", type=int, default=7, help="highest harmonic order, 1 to 200 (default: 7)"
    )
    parser.add_argument(
        "--amplitudes",
        metavar="q1:q2:n",
        help=(
            "modal amplitudes in m√kg: n values from q1 to q2 in geometric steps (default: 100 values that "
            "cover the rig's levels generously)"
        ),
    )


def run(arguments: argparse.Namespace) -> int:
    """Compute and write ``reference.csv``.

    Raises:
        BenchError: a wrong rig, option or folder, or no solution.
    """
    check_output(arguments.out, arguments.force)
    if not 1 <= arguments.harmonics <= 200:
        raise BenchError(f"--harmonics must be a whole number from 1 to 200, got {arguments.harmonics}.")

    from nmt_bench.terminal import make_console
    from nmt_plant.reference import compute_reference, write_reference_csv
    from nmt_plant.rig import load_rig

    amplitudes = _amplitudes(arguments.amplitudes) if arguments.amplitudes else None
    rig = load_rig(arguments.rig, arguments.set)
    reference = compute_reference(rig, arguments.harmonics, amplitudes)
    with OutputFolder(arguments.out, arguments.force) as folder:
        write_reference_csv(reference, folder / "reference.csv")
    console = make_console()
    for line in _summary(reference):
        console.print(line, markup=False)
    console.print(f"Results in {arguments.out}: reference.csv", markup=False)
    sys.stdout.flush()
    return 0


def _summary(reference: Reference) -> list[str]:
    from math import pi

    from nmt_bench.quantity_format import significant

    q, omega, damping = reference.modal_amplitude, reference.omega_rad_s, reference.damping_ratio
    lines = [
        f"{q.size} points with {reference.harmonics} harmonics, q from {significant(q[0], 3)} to "
        f"{significant(q[-1], 3)} m√kg",
        f"modal frequency {omega.min() / (2 * pi):.4f} to {omega.max() / (2 * pi):.4f} Hz, modal damping "
        f"ratio {100 * damping.min():.3f} to {100 * damping.max():.3f} %, highest at q = "
        f"{significant(float(q[damping.argmax()]), 3)} m√kg",
    ]
    if not reference.single_valued:
        lines.append("The backbone folds over q; the first passage is given.")
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
            "--amplitudes must be q1:q2:n with 0 < q1 < q2 (m√kg) and n ≥ 2 as in 1e-5:1e-2:100, got "
            f"'{text}'."
        )
    return [float(value) for value in np.geomspace(low, high, count)]
