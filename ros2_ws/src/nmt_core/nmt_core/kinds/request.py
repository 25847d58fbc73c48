"""A test that is asked for, as a value: inspected and checked before anybody carries it out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds import KindOfTest, PhaseResonanceTest, RandomTest, kind_named
from nmt_core.vocabulary import ControlKind


@dataclass(frozen=True)
class PlacedSensor:
    """A sensor where the rig file has none.

    Attributes:
        quantity: what it measures, as in a rig file.
        point: measurement point.
        channel: of the sensor of the rig that goes there; empty = it is one more.
    """

    quantity: str
    point: int
    channel: str = ""


@dataclass(frozen=True, kw_only=True)
class TestRequest:
    """What is to be tested, and how the rig is changed for it; who carries it out knows how.

    Attributes:
        kind: kind of test with its settings; zeros of a duration or a band leave them to the bench.
        levels: amplitudes; empty = those of the rig.
        control: what they are; UNKNOWN becomes what levels of the kind are.
        frequencies_hz: one for each level where the kind needs them.
        direction: ``given``: the levels come in their order; or ``up``, ``down``, ``both``: up and down again.
        periods: whole periods of a window; 0 = as many as the rig says.
        exciters: measurement point of each exciter; empty = where the rig has them.
        changes: values of the rig file that are others for this test, by their keys.
        sensors: sensors where the rig has none.
        rig: rig file of the specimen; empty = it is not known, and a person tests it.
        linear: file of the linear description; empty = that of the rig's model.
        name: what its folder may be called.
    """

    __test__: ClassVar[bool] = False

    kind: KindOfTest = field(default_factory=PhaseResonanceTest)
    levels: tuple[float, ...] = ()
    control: ControlKind = ControlKind.UNKNOWN
    frequencies_hz: tuple[float, ...] = ()
    direction: str = "given"
    periods: int = 0
    exciters: tuple[int, ...] = ()
    changes: tuple[tuple[str, Any], ...] = ()
    sensors: tuple[PlacedSensor, ...] = ()
    rig: str = ""
    linear: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "control", self.control or self.kind.CONTROL)

    @property
    def top(self) -> float:
        """Highest level; 0 where they are the rig's."""
        return max(self.levels, default=0.0)

    def check(self, sample_rate: float) -> None:
        """Refuse what no bench with this sample rate can do.

        Args:
            sample_rate: Hz.

        Raises:
            BenchError: a level, a point or a setting is missing or out of range.
        """
        what = f"The {self.kind.words()} test that is asked for"
        if not all(0.0 < level < math.inf for level in self.levels):
            raise BenchError(f"{what} has a level that is not positive and finite: {self.levels}.")
        if self.periods < 0:
            raise BenchError(f"{what} has windows of {self.periods} periods; give a positive number, or 0.")
        points = (*self.exciters, *(sensor.point for sensor in self.sensors))
        if any(point < 1 for point in points) or len(set(self.exciters)) < len(self.exciters):
            raise BenchError(f"{what} has exciters or sensors at points {points}; points count from 1, one each.")
        if self.kind.one_exciter and len(self.exciters) > 1:
            raise BenchError(f"{self.kind.one_exciter} one exciter, got {len(self.exciters)}.")
        if isinstance(self.kind, RandomTest) and not (self.kind.band_high_hz and self.kind.duration):
            return  # the bench's own band or duration
        frequencies = self.frequencies_hz * (len(self.levels) if len(self.frequencies_hz) == 1 else 1)
        self.kind.check(frequencies, len(self.levels), self.control, sample_rate)

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "kind": self.kind.label(), "settings": asdict(self.kind), "control": self.control.label}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> TestRequest:
        """The request that `to_mapping` wrote.

        Raises:
            BenchError: it has no such kind or control.
            KeyError, TypeError, ValueError: a value is missing or of another type.
        """
        known = {key: value for key, value in values.items() if key != "settings"}
        known |= {key: tuple(values[key]) for key in ("levels", "frequencies_hz", "exciters")}
        known["changes"] = tuple((str(key), value) for key, value in values["changes"])
        known["sensors"] = tuple(PlacedSensor(**sensor) for sensor in values["sensors"])
        known["kind"] = kind_named(values["kind"])(**values["settings"])
        known["control"] = ControlKind.named(values["control"])
        return cls(**known)
