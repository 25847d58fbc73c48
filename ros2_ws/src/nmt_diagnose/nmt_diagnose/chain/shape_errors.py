"""What errors of the mode shapes of a modal model do to its responses.

A shape that a modal test has measured is right to about a hundredth of its largest value: sensors that were moved or
changed, cables, modes nearby. A gain of a channel does not stand for that, because it is the same in all modes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.chain.chain_tests import ChainTests
from nmt_diagnose.prediction.forward import Prediction
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import ModalSection, Rig, ShakingTableSection

# Of a standard deviation; frequencies of modes over those of the rows, beyond which a mode adds a constant at most.
_STEP = 0.05


class ShapeErrors:
    """Errors of the shapes in the model of some tests.

    Args:
        chain: the tests.
    """

    def __init__(self, chain: ChainTests) -> None:
        self.chain = chain

    def columns(self, base: Prediction) -> list[FloatArray]:
        """What one standard deviation of each shape value that matters adds to the rows, (rows,) each.

        Args:
            base: prediction of the chain's tests.
        """
        chain, structure = self.chain, self.chain.rig.structure
        if not isinstance(structure, ModalSection) or len(structure.points) < 2 or structure.shape_std == 0.0:
            return []
        measured = {channel.point for channel in chain.channels.values()} & set(structure.points)
        ruling = self._ruling() & set(structure.points)
        found = []
        for mode in self.modes_near(structure):
            for point in sorted(ruling):
                found.append(self._change(base, mode, [point]))
            others = sorted(measured - ruling)
            if others:
                # A point that is only measured moves no other: all of them at once.
                change = self._change(base, mode, others)
                found += [np.where(self._rows_at(point), change, 0.0) for point in others]
        return [column for column in found if column.any()]

    def modes_near(self, structure: ModalSection) -> list[int]:
        """Modes about the frequencies of the rows."""
        frequency = self.chain.frequencies_hz
        if not frequency.size:
            return []
        low, high = (
            float(frequency.min()) / THRESHOLDS.misfit.shape_reach,
            float(frequency.max()) * THRESHOLDS.misfit.shape_reach,
        )
        return [number for number, mode in enumerate(structure.modes) if low <= mode.frequency_hz <= high]

    def _ruling(self) -> set[int]:
        """Points whose shape values change more than what is measured there."""
        chain = self.chain
        table = isinstance(chain.rig.exciter, ShakingTableSection)
        points = set() if table else {test.drive_point for test in chain.tests}
        for element in chain.rig.local_elements:
            points |= {element.point, element.other_point or element.point}
        for test in chain.tests:
            if test.given_channel is not None:
                points.add(test.given_channel.point)
        return points

    def _rows_at(self, point: int) -> NDArray[np.bool_]:
        rows = np.zeros(len(self.chain.rows), dtype=bool)
        for name, channel in self.chain.channels.items():
            if channel.point == point:
                rows |= self.chain.rows_of(name)
        return rows

    def _change(self, base: Prediction, mode: int, points: list[int]) -> FloatArray:
        forward = self.chain.forward
        moved = forward.predict(_shaped(self.chain.rig, mode, points), base)
        change = forward.difference(moved.values, base.values) / _STEP
        return np.nan_to_num(change, posinf=0.0, neginf=0.0)


def _shaped(rig: Rig, mode: int, points: list[int]) -> Rig:
    """The rig with a mode's shape at some points off by `_STEP` of its standard deviation."""
    structure = rig.structure
    assert isinstance(structure, ModalSection)
    shape = list(structure.shape(mode))
    step = _STEP * structure.shape_std * max(abs(value) for value in shape)
    for point in points:
        shape[structure.points.index(point)] += step
    modes = list(structure.modes)
    modes[mode] = modes[mode].model_copy(update={"shape": shape})
    return rig.model_copy(update={"structure": structure.model_copy(update={"modes": modes})})
