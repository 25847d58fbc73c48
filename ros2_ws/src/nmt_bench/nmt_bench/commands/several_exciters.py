"""What ``./nmt linear`` does with a recording of several exciters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_core.files.whole_file import csv_text, write_whole
from nmt_core.messages.blocks import Quantity
from nmt_extract.several_inputs import SeveralInputsTest, evaluate_several_inputs, table_rows
from nmt_rig.rig_model import build_shaker

if TYPE_CHECKING:
    from nmt_bench.commands.linear_command import LinearOptions
    from nmt_record.bag.bag_reader import Bag
    from nmt_rig.rig import Rig


def evaluate_several(bag: Bag, rig: Rig, options: LinearOptions) -> SeveralInputsTest:
    """Modes of a recording in which every exciter of the rig had a noise of its own.

    Raises:
        BenchError: as :func:`nmt_extract.several_inputs.evaluate_several_inputs`.
    """
    return evaluate_several_inputs(
        bag,
        rig.exciter_points,
        Quantity[rig.extraction.quantity.upper()],
        mode=options.mode or rig.test.mode,
        near_hz=options.near,
        modes=options.modes or rig.extraction.linear_modes,
    )


def write_several(test: SeveralInputsTest, rig: Rig, folder: Path, run: Mapping[str, Any] | None = None) -> None:
    """``linear.json``, ``frf.csv`` and ``report.html`` of the results folder; ``run`` describes the recording's run."""
    from nmt_report.several_inputs_report import several_inputs_page

    shaker = build_shaker(rig)
    described = test.description(0.0 if shaker is None else shaker.moving_mass)
    write_whole(folder / "linear.json", json.dumps(json.loads(described.to_json()), indent=1) + "\n")
    rows = table_rows(test)
    write_whole(
        folder / "frf.csv", csv_text([list(rows[0]), *([repr(value) for value in row.values()] for row in rows)])
    )
    write_whole(folder / "report.html", several_inputs_page(test, rig, run))


def show_several(test: SeveralInputsTest, out: Path, console: Any) -> None:
    """The modes, on the screen."""
    for index, frequency in enumerate(test.modes.frequencies_hz):
        target = " (target)" if index == test.target else ""
        console.print(
            f"Mode {index + 1}{target}: {frequency:.4f} ± {test.modes.frequency_stds[index]:.4f} Hz, damping ratio "
            f"{100 * test.modes.damping_ratios[index]:.4f} ± {100 * test.modes.damping_stds[index]:.4f} %",
            soft_wrap=True,
        )
    nearest = abs(test.frequency_hz - test.modes.frequencies_hz[test.target]).argmin()
    for j, point in enumerate(test.exciter_points):
        console.print(
            f"Exciter at point {point}: {abs(test.force_per_volt[nearest, j, j]):.4g} N/V at the target, partial "
            f"coherence {test.coherence[:, j].mean():.3f} in the mean.",
            soft_wrap=True,
        )
    console.print(f"Results in {out}: linear.json, frf.csv, report.html", soft_wrap=True)
