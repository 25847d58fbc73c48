"""One test of a rig: what the run is asked for, and on what it is made."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, TypedDict

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import KindOfTest, PhaseResonanceTest
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.run_settings import RunSettings
from nmt_core.nodes.node_settings import PACINGS
from nmt_core.vocabulary import ControlKind
from nmt_plant.devices.guarded_device import LEAST_LEAD
from nmt_plant.devices.hardware_rig import HARDWARE_LEAD
from nmt_record.bag.bag_keys import SIMULATED_RIG, converter_name
from nmt_rig.device_sections import SIMULATED, SIMULATED_OR_CONVERTERS, SPECIMEN
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import Rig
from nmt_sequencer.level_plan import LevelLimits
from nmt_session.curve_loop import with_course

RAMP_WINDOW = 20
"""Whole periods of a window of the strategy ``ramp`` unless the test says otherwise."""
REAL_TIME_LEAD = 6
"""Blocks that wait at the output in real time unless the test says otherwise: a busy computer may be late by five."""


class PlanSettings(TypedDict, total=False):
    """Keyword arguments of a test: fields of `RunSettings` and of `TestPlan`, whose meanings are theirs; the others
    out or None is the rig's own."""

    run_id: str
    window_periods: int | None
    ramp: float | None
    timeout: float | None
    stop_on_lost_lock: bool
    control: str
    frequencies_hz: Sequence[float]
    levels_without: Sequence[int]
    pacing: str
    latency_blocks: int
    linear: LinearDescription | None
    node_values: Mapping[str, Mapping[str, Any]]
    device: str
    device_address: str
    linked: bool


@dataclass(frozen=True)
class TestPlan:
    """One test of a rig.

    Attributes:
        rig: the rig with all overrides applied.
        rig_yaml: its text, kept in the bag.
        asked: what the run is asked for; nothing of it is left open.
        pacing: ``lockstep`` or ``realtime``; a converter is always in real time.
        latency_blocks: blocks of buffering between command and excitation. In real time as many wait at the output; 0
            stands for `REAL_TIME_LEAD` there.
        linear: linear description for loop and extraction; None = from the rig's model, for tests that need one. Only
            kinds that control a phase use one.
        node_values: further parameters by node name.
        device: what is driven: empty or ``simulated``, or a kind of converter, see `nmt_rig.device_sections`.
        device_address: of NI's device server.
        linked: whether plant, loop and sequencer are on one host, so that in lockstep they may hand on the sample path
            past the middleware.
        tick_blocks: blocks between two decisions of the sequencer.
        block_reason: why blocks are as long as they are, where that was chosen; see `nmt_session.block_length`.

    Raises:
        BenchError: the rig, the levels or a setting is refused.
    """

    __test__ = False

    rig: Rig
    rig_yaml: str
    asked: RunSettings
    pacing: str = "lockstep"
    latency_blocks: int = 0
    linear: LinearDescription | None = None
    node_values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    device: str = ""
    device_address: str = ""
    linked: bool = True
    tick_blocks: int = 5
    block_reason: str = ""

    @classmethod
    def of(
        cls, rig: Rig, rig_yaml: str, levels: Sequence[float], kind: KindOfTest | None = None, **settings: Any
    ) -> TestPlan:
        """A plan with the rig's own values for unstated ones; numbers of numpy become Python's.

        Args:
            rig: the rig with all overrides applied.
            rig_yaml: its text.
            levels: amplitudes in order, in the unit of ``control``.
            kind: kind of test with its settings, see :mod:`nmt_core.kinds`; None = phase resonance.
            settings: those of :class:`PlanSettings`, ``tick_blocks`` and ``block_reason``. The name of the run is from
                the clock unless it is stated; of frequencies there may be one for all levels.

        Raises:
            BenchError: the rig, the levels or a setting is refused.
        """
        chosen = {name: as_plain(value) for name, value in settings.items() if value is not None}
        run = {item.name: chosen.pop(item.name) for item in fields(RunSettings) if item.name in chosen}
        kind = kind or PhaseResonanceTest()
        test, linear = rig.test, chosen.get("linear")
        if _ramps(kind):
            run.setdefault("window_periods", RAMP_WINDOW)
            if "ramp" not in run:
                run["ramp"] = run["window_periods"] / (linear or linear_description(rig)).frequency_hz
        amplitudes = tuple(float(level) for level in levels)
        frequencies = tuple(float(frequency) for frequency in run.get("frequencies_hz", ()))
        asked = {
            "window_periods": int(test.window_periods),
            "ramp": float(test.ramp_s),
            "timeout": float(test.lock_timeout_s),
            **run,
            "run_id": run.get("run_id") or time.strftime(f"{rig.name}-%Y%m%d-%H%M%S"),
            "control": ControlKind.named(run.get("control", "voltage")),
            "frequencies_hz": frequencies * (len(amplitudes) if len(frequencies) == 1 else 1),
            "levels_without": frozenset(run.get("levels_without", ())),
            "kind": with_course(kind, lambda: linear or linear_description(rig)),
        }
        return cls(rig, rig_yaml, RunSettings(levels=amplitudes, **asked), **chosen)

    def __post_init__(self) -> None:
        for what, value, known in (
            ("Pacing", self.pacing, PACINGS),
            ("Device", self.device or SIMULATED, SIMULATED_OR_CONVERTERS),
        ):
            if value not in known:
                raise BenchError(f"{what} '{value}' is not known; use {' or '.join(known)}.")
        if self.is_on_hardware and self.pacing != "realtime":
            raise BenchError("A test on hardware is in real time; leave out --pacing lockstep.")
        asked, kind = self.asked, self.kind
        level_limits(self.rig).check(asked.levels, self.control, kind, f"The test of rig {self.rig.name}")
        if self.latency_blocks < 0:
            raise BenchError(f"latency_blocks must not be negative, got {self.latency_blocks}.")
        if asked.window_periods < kind.least_periods:
            raise BenchError(f"A window needs at least {kind.least_periods} periods, got {asked.window_periods}.")
        for name, duration in (("ramp", asked.ramp), ("timeout", asked.timeout)):
            if not 0 < duration < 1e6:
                raise BenchError(f"The {name} must be positive and below 1e6 s, got {duration:g}.")
        kind.check(asked.frequencies_hz, len(asked.levels), self.control, float(self.rig.sample_rate_hz))

    @property
    def kind(self) -> KindOfTest:
        """Kind of test with its settings."""
        return self.asked.kind

    @property
    def control(self) -> ControlKind:
        """What the levels are."""
        return ControlKind(self.asked.control)

    @property
    def lead_blocks(self) -> int:
        """Blocks between command and excitation that the nodes have to reckon with."""
        if self.pacing != "realtime":
            return self.latency_blocks
        usual = HARDWARE_LEAD if self.is_on_hardware else REAL_TIME_LEAD
        return max(self.latency_blocks or usual, LEAST_LEAD)

    @property
    def is_on_hardware(self) -> bool:
        """Whether a converter is driven."""
        return self.device not in ("", SIMULATED)

    @property
    def device_name(self) -> str:
        """What the bag says of the device."""
        if not self.is_on_hardware:
            return SIMULATED_RIG
        in_rig = self.rig.device is not None and self.rig.device.kind == self.device
        return converter_name(self.device, "" if in_rig else SPECIMEN)

    @property
    def ramps(self) -> bool:
        """Whether windows lie in slow ramps from level to level."""
        return _ramps(self.kind)

    @property
    def driven(self) -> DrivenTest:
        """What drives the test, for those who say whether they take it."""
        return DrivenTest.of(self.asked, tuple(exciter.kind for exciter in self.rig.all_exciters))

    @property
    def used_linear(self) -> LinearDescription | None:
        """Linear description that loop and extraction get; the model's only where the test needs one."""
        if self.linear is None and self.kind.closes_phase_loop:
            return linear_description(self.rig)
        return self.linear

    @property
    def level_unit(self) -> str:
        """Unit of the levels."""
        if self.control is not ControlKind.RESPONSE:
            return self.control.level_unit()
        return self.control.level_unit(Quantity[response_topic(self.rig).upper()])


def _ramps(kind: KindOfTest) -> bool:
    return isinstance(kind, PhaseResonanceTest) and kind.strategy == "ramp"


def as_plain(value: Any) -> Any:
    """Numbers and arrays of numpy as Python's, at any depth: neither JSON nor YAML takes the former."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: as_plain(item) for name, item in value.items()}
    return [as_plain(item) for item in value] if isinstance(value, list | tuple) else value


def level_limits(rig: Rig) -> LevelLimits:
    """Largest levels that the limits of a rig allow."""
    limits = rig.limits
    response = {
        Quantity.ACCELERATION: limits.acceleration_m_s2,
        Quantity.VELOCITY: limits.velocity_m_s,
        Quantity.DISPLACEMENT: limits.displacement_m,
    }[next(quantity for quantity in Quantity if quantity.topic == response_topic(rig))]
    return LevelLimits(*(float(limit or 0.0) for limit in (limits.voltage_v, limits.force_n, response)))


def response_topic(rig: Rig) -> str:
    """Topic of the response that the loop controls.

    Raises:
        BenchError: the rig has no response sensor at its drive point.
    """
    for quantity in (Quantity[rig.extraction.quantity.upper()], Quantity.DISPLACEMENT, Quantity.ACCELERATION):
        if rig.drive_point in rig.response_points(quantity):
            return quantity.topic
    raise BenchError(
        f"Rig {rig.name} has no displacement or acceleration sensor at its drive point {rig.drive_point}; "
        "phase resonance needs one: add {quantity: acceleration, point: drive} to its sensors."
    )
