"""What the levels before a window looked like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.judgement.channel_gain import ShapeLevel
from nmt_extract.judgement.force_judge import DriveState
from nmt_extract.judgement.moving_shape import Doubt, ShapeCourse, moves_on, stays
from nmt_extract.judgement.shape_judge import Deviation


@dataclass
class ChannelHistory:
    """What the last level without a fault looked like.

    Attributes:
        names: of the channels.
        level_index: of that level; -1 = none yet.
        shape: its fundamental at the points of the linear modes, in any unit, shape ``(points,)``.
        noise: rms of each channel that no harmonic explains, in the channel's unit.
        faulty: channels that were faulty at the level before, by row.
        drives: force and motion at the drive point at each level without a fault.
        driven: levels in which the drive has harmonics, and up to which those of the force are controlled.
        shapes: those of all levels without a fault, of unit size and common phase.
        course: where they lie on the way of the shape.
        levels: those at which the shape is near the target's, as the fit of a gain needs them.
        doubts: channels that may be off, by row: measured over expected, where that was, and whether it has stayed
            while the amplitude changed.
    """

    names: tuple[str, ...] = ()
    level_index: int = -1
    shape: ComplexArray = field(default_factory=lambda: np.empty(0, dtype=np.complex128))
    noise: FloatArray = field(default_factory=lambda: np.empty(0))
    faulty: frozenset[int] = frozenset()
    drives: list[DriveState] = field(default_factory=list)
    driven: dict[int, int] = field(default_factory=dict)
    shapes: list[ComplexArray] = field(default_factory=list)
    course: list[ShapeCourse] = field(default_factory=list)
    levels: list[ShapeLevel] = field(default_factory=list)
    doubts: dict[int, Doubt] = field(default_factory=dict)

    def doubt(self, found: Mapping[int, Deviation], course: ShapeCourse) -> Mapping[int, Doubt]:
        """Channels that may be off at a level.

        Args:
            found: deviations that the points do not tell from a shape that moves, by row.
            course: of the level.
        """
        for row, before in list(self.doubts.items()):
            if not before.stays and stays(before.course, course):
                self.doubts[row] = before._replace(stays=True)
        self.doubts = {row: doubt for row, doubt in self.doubts.items() if doubt.stays}
        if not moves_on(self.course, course):
            for row, each in found.items():
                self.doubts.setdefault(row, Doubt(each.ratio, course))
        return self.doubts

    def knows(self, names: Sequence[str]) -> bool:
        """Whether there is a level of the same channels."""
        return self.level_index >= 0 and self.names == tuple(names)

    def take(
        self,
        names: Sequence[str],
        level_index: int,
        shape: ComplexArray,
        noise: FloatArray,
        drive: DriveState,
        course: ShapeCourse,
        level: ShapeLevel | None,
    ) -> None:
        """Take a level without a fault, as it was measured."""
        if self.names != tuple(names):
            self.drives, self.shapes, self.course, self.levels = [], [], [], []
        self.levels += [] if level is None else [level]
        self.drives.append(drive)
        self.course.append(course)
        self.shapes.append(shape / np.linalg.norm(shape) * np.exp(-1j * np.angle(shape.sum())))
        self.names, self.level_index, self.shape, self.noise = tuple(names), level_index, shape, noise
        self.faulty = frozenset()
