"""What is found of a window beyond its channels, and what findings and resolution add to the uncertainties."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from nmt_extract.judgement import signal_faults, window_judge
from nmt_extract.judgement.window_judge import Remark

if TYPE_CHECKING:
    from nmt_extract.modal.evaluation import WindowEvaluation


def remarks_on_drift(evaluation: WindowEvaluation, fields: dict[str, float], moving: bool) -> list[Remark]:
    """Channels whose mean moves over the window.

    Args:
        evaluation: of the window.
        fields: values of the point by name.
        moving: whether level or frequency move as well: then the mean of a nonlinear motion moves with them.
    """
    motion = evaluation.motion
    if motion.other_amplitudes is None:
        return []
    channels = motion.window.channels
    names = ", ".join(
        f"{channels[row].name} drifts by {height:.2g} {channels[row].unit}" for row, height in motion.drifted.items()
    )
    order = signal_faults.drift_orders(motion.periods)[0]
    what = (
        "Level or frequency of the loop still move, and the mean of the motion too; wait longer before the window."
        if moving
        else "Let the sensor warm up, or couple it over a high-pass that all channels share."
    )
    return [
        Remark(
            f"{names} over the window; a polynomial of order {order} was taken out. {what}",
            evaluation.change(evaluation.values(motion.other_amplitudes), fields),
            of_channel=True,
        )
    ]


def remarks_on_bursts(evaluation: WindowEvaluation, fields: dict[str, float]) -> list[Remark]:
    """Parts of the window in which a channel departs from its harmonics."""
    motion, bounds = evaluation.motion, evaluation.motion.part_bounds
    window = motion.window
    residuals = window_judge.part_residuals(
        window.data, motion.part_moments.projections, motion.part_amplitudes, bounds
    )
    rows = evaluation.rows
    remarks = []
    for row in sorted({*rows.forces, *rows.motions, *rows.shape} - set(evaluation.channels.faults)):
        part = window_judge.burst_part(residuals[:, row], float(window.data[row].std()))
        if part is None:
            continue
        first, end = int(bounds[part]), int(bounds[part + 1])
        others = np.delete(motion.part_amplitudes[:, row], part, axis=0).mean(axis=0)
        begin, stop = window_judge.burst_span(window.data[row, first:end] - motion.model(others, first, end))
        remarks.append(
            Remark(
                f"{window.channels[row].name} departs from its periodic course between "
                f"{motion.second(first + begin):.6g} and {motion.second(first + stop):.6g} s (drop-out, hit or "
                "step); choose a window beside it.",
                evaluation.change(evaluation.values(motion.amplitudes), fields, 1 + part),
                of_channel=True,
            )
        )
    return remarks


def least_uncertainties(evaluation: WindowEvaluation, fields: dict[str, float]) -> dict[str, float]:
    """What the resolution of the channels leaves open, by quantity of the point."""
    motion, rows, data = evaluation.motion, evaluation.rows, evaluation.motion.window.data
    places = signal_faults.places_of_period(motion.cycles)
    sound = [row for row in rows.shape if row not in evaluation.channels.faults]
    least = {
        row: signal_faults.resolution_floor(data[row], places, float(motion.noise[row]))
        for row in {rows.force, rows.drive, *sound}
    }
    shape = math.hypot(*(least[row] for row in sound)) / math.hypot(*motion.size_of(sound))
    force, drive = (least[row] / float(motion.size_of([row])[0]) for row in (rows.force, rows.drive))
    return signal_faults.floors(force, drive, shape, fields, motion.periods, motion.fitted)
