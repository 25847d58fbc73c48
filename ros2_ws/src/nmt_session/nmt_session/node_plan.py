"""From a rig and a test to the parameters of every node; free of ROS, so that it can be looked at and tested."""

from __future__ import annotations

import datetime
import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypedDict, TypeVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.yaml_text import yaml_text
from nmt_core.kinds import (
    KindOfTest,
    PhaseResonanceTest,
    SecondaryResonanceTest,
    SelfExcitedTest,
)
from nmt_core.messages.blocks import SAMPLE_TOPICS, Quantity
from nmt_core.messages.bundle import LOOP_INPUT, MOST_BYTES, PLANT_BUNDLE, PLL_BUNDLE
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.run_settings import RunSettings
from nmt_core.nodes.node_settings import PACINGS, NodeSettings
from nmt_core.nodes.parameters import ParameterValue
from nmt_core.settings import parameters_of, values_of, with_values
from nmt_core.vocabulary import AUTOMATIC, MOTIONS, ControlKind, HarmonicsTarget
from nmt_extract.extraction_settings import ExtractionSettings, ExtractSettings
from nmt_extract.modal.hysteresis import HysteresisLayout
from nmt_plant.devices.guarded_device import LEAST_LEAD
from nmt_plant.devices.hardware_rig import HARDWARE_LEAD
from nmt_plant.plant_settings import PlantSettings
from nmt_plant.safety.output_guard import default_slew
from nmt_pll.coverage import covers_linear
from nmt_pll.force_control.modal_power_ratio import check_modes
from nmt_pll.loop_settings import settings_from
from nmt_pll.phase_loop.paper_settings import PaperSettings
from nmt_pll.pll_settings import PAPER_PREFIX, PllSettings
from nmt_pll.thresholds import HARMONICS
from nmt_record.bag.bag_keys import SIMULATED_RIG, converter_name
from nmt_record.bag.recorder_settings import RecorderSettings
from nmt_rig.device_sections import SIMULATED, SIMULATED_OR_CONVERTERS, SPECIMEN
from nmt_rig.linear_description import force_per_volt, linear_description
from nmt_rig.rig import Rig
from nmt_sequencer.level_plan import LevelLimits
from nmt_sequencer.sequencer_settings import SequencerSettings
from nmt_session.coverage import covers
from nmt_session.curve_loop import curve_values, with_course
from nmt_session.versions import versions

S = TypeVar("S", bound=NodeSettings)
LOOP_TOPICS = ("drive", "frequency")
"""Topics of the loop with a message for every block."""
_FORCE_ROWS = 500  # of the force per volt over frequency
_MESSAGE_BYTES = 200  # of a block besides its samples
MOST_WAITING = 64e6
"""Bytes of samples by which the plant may be ahead of the bag in lockstep."""
READER_LEADS = (2.0, 20.0)
"""Least and most bench time that it may be ahead, s; the recorder tells every second of it how far the bag is."""
RAMP_WINDOW = 20
"""Whole periods of a window of the strategy ``ramp`` unless the test says otherwise."""
RAMP_DELAY = 1.0
"""Periods from the start of a level to its window in the strategy ``ramp``."""
REAL_TIME_LEAD = 6
"""Blocks that wait at the output in real time unless the test says otherwise: a busy computer may be late by five."""
OUTPUT_RECORD = "output.jsonl"
"""File beside the bag, in real time, in which the process that owns the output says what the output does."""

# Where each node's class and executable are found.
NODES: dict[str, tuple[str, str, str]] = {
    "plant": ("nmt_plant", "plant", "nmt_plant.plant_node:PlantNode"),
    "pll": ("nmt_pll", "pll", "nmt_pll.pll_node:PllNode"),
    "sequencer": ("nmt_sequencer", "sequencer", "nmt_sequencer.sequencer_node:SequencerNode"),
    "extract": ("nmt_extract", "extract", "nmt_extract.extract_node:ExtractNode"),
    "recorder": ("nmt_record", "recorder", "nmt_record.bag.recorder_node:RecorderNode"),
}


class PlanSettings(TypedDict, total=False):
    """Keyword arguments of a test; meanings and defaults are those of the fields of `TestPlan`."""

    run_id: str
    pacing: str
    latency_blocks: int
    window_periods: int | None
    ramp: float | None
    timeout: float | None
    stop_on_lost_lock: bool
    linear: LinearDescription | None
    node_values: Mapping[str, Mapping[str, Any]]
    control: str
    frequencies_hz: Sequence[float]
    device: str
    device_address: str
    linked: bool
    levels_without: Sequence[int]


@dataclass(frozen=True)
class TestPlan:
    """One test of a rig; numbers of numpy become Python's.

    Attributes:
        rig: the rig with all overrides applied.
        rig_yaml: its text, kept in the bag.
        levels: amplitudes in order, in the unit of ``control``.
        run_id: name of the run; empty = from the clock.
        pacing: ``lockstep`` or ``realtime``; a converter is always in real time.
        latency_blocks: blocks of buffering between command and excitation. In real time as many wait at the output; 0
            stands for `REAL_TIME_LEAD` there.
        window_periods, ramp, timeout: periods, s, s; None = the rig's own.
        stop_on_lost_lock: end the test at the first level that does not lock.
        linear: linear description for loop and extraction; None = from the rig's model, for tests that need one.
        node_values: further parameters by node name.
        control: what the levels are: ``voltage`` (V), ``response`` (amplitude at the drive point, m or m/s²) or
            ``force`` (N).
        kind: kind of test with its settings, see :mod:`nmt_core.kinds`. Only kinds that control a phase use a linear
            description.
        frequencies_hz: start of the sweep or frequency of the stepped sine, one for all levels or one a level.
        device: what is driven: empty or ``simulated``, or a kind of converter, see `nmt_rig.device_sections`.
        device_address: of NI's device server.
        linked: whether plant, loop and sequencer are on one host, so that in lockstep they may hand on the sample path
            past the middleware.
        levels_without: indices of levels without control of the force's harmonics, for comparison.
        tick_blocks: blocks between two decisions of the sequencer.
        block_reason: why blocks are as long as they are, where that was chosen; see `nmt_session.block_length`.

    Raises:
        BenchError: the rig, the levels or a setting is refused.
    """

    __test__ = False

    rig: Rig
    rig_yaml: str
    levels: Sequence[float]
    run_id: str = ""
    pacing: str = "lockstep"
    latency_blocks: int = 0
    window_periods: int | None = None
    ramp: float | None = None
    timeout: float | None = None
    stop_on_lost_lock: bool = False
    linear: LinearDescription | None = None
    node_values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    control: str = "voltage"
    kind: KindOfTest = field(default_factory=PhaseResonanceTest)
    frequencies_hz: Sequence[float] = ()
    device: str = ""
    device_address: str = ""
    linked: bool = True
    levels_without: Sequence[int] = ()
    tick_blocks: int = 5
    block_reason: str = ""

    def __post_init__(self) -> None:
        plain = {item.name: as_plain(getattr(self, item.name)) for item in fields(self)}
        plain["run_id"] = self.run_id or time.strftime(f"{self.rig.name}-%Y%m%d-%H%M%S")
        plain["node_values"] = plain["node_values"] or {}
        for name in ("levels", "frequencies_hz", "levels_without"):
            plain[name] = tuple(plain[name])
        for name, value in plain.items():
            object.__setattr__(self, name, value)
        for what, value, known in (
            ("Pacing", self.pacing, PACINGS),
            ("Device", self.device or SIMULATED, SIMULATED_OR_CONVERTERS),
        ):
            if value not in known:
                raise BenchError(f"{what} '{value}' is not known; use {' or '.join(known)}.")
        if self.is_on_hardware and self.pacing != "realtime":
            raise BenchError("A test on hardware is in real time; leave out --pacing lockstep.")
        control = ControlKind.named(self.control)
        level_limits(self.rig).check(self.levels, control, self.kind, f"The test of rig {self.rig.name}")
        if self.latency_blocks < 0:
            raise BenchError(f"latency_blocks must not be negative, got {self.latency_blocks}.")
        least, window = self.kind.least_periods, self.window_periods
        if window is not None and window < least:
            raise BenchError(f"A window needs at least {least} periods, got {window}.")
        for name in ("ramp", "timeout"):
            value = getattr(self, name)
            if value is not None and not 0 < value < 1e6:
                raise BenchError(f"The {name} must be positive and below 1e6 s, got {value:g}.")
        self.kind.check(self.level_frequencies_hz, len(self.levels), control, float(self.rig.sample_rate_hz))

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
        own = self.rig.device is not None and self.rig.device.kind == self.device
        return converter_name(self.device, "" if own else SPECIMEN)

    @property
    def ramps(self) -> bool:
        """Whether windows lie in slow ramps from level to level."""
        return isinstance(self.kind, PhaseResonanceTest) and self.kind.strategy == "ramp"

    @property
    def driven(self) -> DrivenTest:
        """What drives the test, for those who say whether they take it."""
        return DrivenTest.of(self.run_settings, tuple(exciter.kind for exciter in self.rig.all_exciters))

    @property
    def level_frequencies_hz(self) -> tuple[float, ...]:
        """Frequency of each level, Hz; empty = none given."""
        one_for_all = len(self.frequencies_hz) == 1
        return tuple(map(float, self.frequencies_hz)) * (len(self.levels) if one_for_all else 1)

    @property
    def used_linear(self) -> LinearDescription | None:
        """Linear description that loop and extraction get; the model's only where the test needs one."""
        if self.linear is None and self.kind.closes_phase_loop:
            return linear_description(self.rig)
        return self.linear

    @property
    def level_unit(self) -> str:
        """Unit of the levels."""
        control = ControlKind.named(self.control)
        if control is not ControlKind.RESPONSE:
            return control.level_unit()
        return control.level_unit(Quantity[_response_topic(self.rig).upper()])

    @property
    def run_settings(self) -> RunSettings:
        """What the run is asked for; what the test leaves open is the rig's."""
        test = self.rig.test
        window, ramp = self.window_periods, self.ramp
        if self.ramps:
            window = RAMP_WINDOW if window is None else window
            linear = self.linear or linear_description(self.rig)
            ramp = window / linear.frequency_hz if ramp is None else ramp
        return RunSettings(
            run_id=self.run_id,
            levels=tuple(float(level) for level in self.levels),
            control=ControlKind.named(self.control),
            ramp=float(test.ramp_s if ramp is None else ramp),
            window_periods=int(test.window_periods if window is None else window),
            timeout=float(test.lock_timeout_s if self.timeout is None else self.timeout),
            stop_on_lost_lock=self.stop_on_lost_lock,
            kind=with_course(self.kind, lambda: self.used_linear),
            frequencies_hz=self.level_frequencies_hz,
            levels_without=frozenset(self.levels_without),
        )


@dataclass(frozen=True)
class NodePlan:
    """Settings of every node of a test, and the run's self-description.

    Attributes:
        plant, pll, sequencer, extract, recorder: settings of the node of that name.
        run: content of ``run.json``.
        asked: what the run is asked for.
    """

    plant: PlantSettings
    pll: PllSettings
    sequencer: SequencerSettings
    extract: ExtractSettings
    recorder: RecorderSettings
    run: dict[str, Any]
    asked: RunSettings

    @property
    def goal(self) -> dict[str, Any]:
        """Fields of the action goal."""
        return self.asked.goal

    @property
    def settings(self) -> dict[str, NodeSettings]:
        """Settings by node name."""
        return {name: getattr(self, name) for name in NODES}

    @property
    def values(self) -> dict[str, dict[str, ParameterValue]]:
        """Parameters by node name, as ROS takes them; complete."""
        return {name: values_of(settings) for name, settings in self.settings.items()}

    def write_parameters(self, path: Path) -> None:
        """Write a parameter file that ``ros2 run … --ros-args --params-file`` takes for any of the nodes.

        It holds in every namespace.
        """
        content = {f"/**/{name}": {"ros__parameters": values} for name, values in self.values.items()}
        path.write_text(yaml_text(content, sort_keys=True), encoding="utf-8")


def plan_nodes(test: TestPlan, bag: Path, rig_file: Path, device: str = "") -> NodePlan:
    """Parameters for all nodes.

    Args:
        test: the test.
        bag: folder of the bag to be recorded.
        rig_file: where the rig's text has been written for the plant node.
        device: what the plant drives, as the bag names it; empty = not known here.

    Raises:
        BenchError: the rig has no response sensor at the drive point, or a setting is refused.
    """
    rig = test.rig
    linear = test.used_linear
    linear_json = "" if linear is None else linear.to_json()
    response = _response_topic(rig)
    topics = _sample_topics(rig)
    limits = level_limits(rig)
    extraction = ExtractionSettings(
        harmonics=_extracted_harmonics(test, linear),
        topics=_extraction_topics(rig, topics),
        power_balance=test.ramps,
        hysteresis=_hysteresis_layout(rig),
    )
    layout = extraction.hysteresis
    bundle = _bundle_blocks(test, len(topics))
    linked = _is_linked(test)
    wants_shape = _wants_shape(test)
    if wants_shape and linear is not None and len(linear.exciter_points) < 2:
        check_modes(linear, f"The test of rig {rig.name}")
    joined = linked or (not wants_shape and _joins_loop_input(test, response))
    for name in test.node_values:
        if name not in NODES:
            raise BenchError(f"Node '{name}' is not part of the bench; there are {', '.join(NODES)}.")
    peers = expected_peers(topics, extraction.topics, response, bundle > 0, joined)
    plant = PlantSettings(
        rig_file=str(rig_file),
        pacing=test.pacing,
        latency_blocks=test.lead_blocks,
        watched_nodes=("pll", "sequencer"),
        reader_lead=_reader_lead(rig) if test.pacing == "lockstep" else 0.0,
        device=test.device if test.is_on_hardware else "",
        device_address=test.device_address if test.is_on_hardware else "",
        output_record=str(bag.absolute().parent / OUTPUT_RECORD) if test.pacing == "realtime" else "",
        bundle_blocks=bundle,
        linked=linked,
    )
    if joined:
        point = 0 if wants_shape else int(rig.drive_point)
        plant = replace(plant, loop_topics=("force", response), drive_point=point)
    pll = PllSettings(
        sample_rate=float(rig.sample_rate_hz),
        block_samples=int(rig.block_samples),
        pacing=test.pacing,
        linear_json=linear_json,
        drive_point=int(rig.drive_point),
        exciters=len(rig.all_exciters),
        response_topic=response,
        watched_nodes=("plant", "sequencer"),
        force_per_volt_json=_known_force(test, linear),
        bundle_blocks=bundle,
        linked=linked,
        joined_input=joined,
    )
    if isinstance(test.kind, SelfExcitedTest):
        pll = replace(pll, self_excited_method=test.kind.method, response_limit=limits.largest_response)
    sequencer = SequencerSettings(
        sample_rate=float(rig.sample_rate_hz),
        block_samples=int(rig.block_samples),
        pacing=test.pacing,
        latency_blocks=test.lead_blocks,
        tick_blocks=test.tick_blocks,
        watched_nodes=("plant", "pll", "extract", "recorder"),
        limits=limits,
        linked=linked,
    )
    extract = ExtractSettings(
        pacing=test.pacing,
        rig=rig.name,
        linear_json=linear_json,
        extraction=replace(extraction, hysteresis=None),
        hysteresis_json="" if layout is None else json.dumps(layout.to_mapping()),
        bundled=(*extraction.topics, "frequency") if bundle else ("",),
        linked=linked and bundle > 0,
    )
    recorder = RecorderSettings(
        pacing=test.pacing,
        output=str(bag),
        chunk_messages=_chunk_messages(rig, len(topics)),
        bundled=(*topics, "monitor", *LOOP_TOPICS) if bundle else ("",),
        linked=linked and bundle > 0,
    )
    if rig.recording is not None:
        recorder = replace(recorder, compression=rig.recording.compression)
    plant = _given(plant, test, "plant", peers)
    pll = _given(_with_loops(pll, test, linear, response), test, "pll", peers)
    sequencer = _given(sequencer, test, "sequencer", peers)
    extract = _given(extract, test, "extract", peers)
    recorder = _given(recorder, test, "recorder", peers)
    refusal = covers(test.driven, pll.loop, test.ramps, test.device)
    if not refusal and linear is not None:
        refusal = covers_linear(test.driven, linear)
    if refusal:
        raise BenchError(refusal)
    nodes = {"plant": plant, "pll": pll, "sequencer": sequencer, "extract": extract, "recorder": recorder}
    asked = test.run_settings
    run = {
        "run_id": test.run_id,
        "rig": rig.name,
        "seed": rig.seed,
        "plan": {
            **asked.description,
            "pacing": test.pacing,
            **vars(limits),
        },
        "block": {"samples": int(rig.block_samples), "reason": test.block_reason},
        "device": device,
        "exciter_point": rig.drive_point,
        **({"exciter_points": list(rig.exciter_points)} if len(rig.all_exciters) > 1 else {}),
        "linear": None if linear is None else json.loads(linear_json),
        "extraction": extraction.to_mapping(),
        "parameters": {name: values_of(settings) for name, settings in nodes.items()},
        "versions": versions(),
        "started": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
    }
    recorder = replace(recorder, run_json=json.dumps(run), rig_yaml=test.rig_yaml)
    return NodePlan(plant, pll, sequencer, extract, recorder, run, asked)


def _given(settings: S, test: TestPlan, name: str, peers: Mapping[str, Sequence[str]]) -> S:
    """The settings of a node with what the test says of them, and with the peers that it waits for.

    Raises:
        BenchError: the node has no such setting, or refuses its value.
    """
    return replace(with_values(settings, test.node_values.get(name, {}), name), expected_peers=tuple(peers[name]))


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
    }[next(quantity for quantity in Quantity if quantity.topic == _response_topic(rig))]
    return LevelLimits(*(float(limit or 0.0) for limit in (limits.voltage_v, limits.force_n, response)))


def _bundle_blocks(test: TestPlan, topics: int) -> int:
    """Blocks of a bundle for recorder and extraction; 0 = they take the messages as they are.

    In real time a dead plant would take the blocks that wait with it, and large blocks gain nothing.
    """
    block = 8 * int(test.rig.block_samples) * len(test.rig.sensors) + _MESSAGE_BYTES * topics
    blocks = min(test.tick_blocks, MOST_BYTES // block)
    return blocks if test.pacing == "lockstep" and blocks > 1 else 0


def _reader_lead(rig: Rig) -> float:
    """Bench time by which the plant may be ahead of recorder and extraction, s: what waits for them is in memory."""
    bytes_a_second = 8.0 * rig.sample_rate_hz * len(rig.sensors)
    return float(np.clip(MOST_WAITING / bytes_a_second, *READER_LEADS))


def _joins_loop_input(test: TestPlan, response: str) -> bool:
    """Whether the loop gets force and response at the drive point as one message instead of all their channels.

    It does so where it would else take many channels.
    """
    channels = sum(sensor.quantity == response for sensor in test.rig.sensors)
    return 8 * int(test.rig.block_samples) * channels > MOST_BYTES


def _wants_shape(test: TestPlan) -> bool:
    """Whether the loop takes all channels: for the modal target, and for several exciters."""
    is_modal = getattr(test.kind, "harmonics_target", HarmonicsTarget.ZERO) == HarmonicsTarget.MODAL
    return is_modal or len(test.rig.all_exciters) > 1


def _is_linked(test: TestPlan) -> bool:
    """Whether the nodes hand on the sample path past the middleware."""
    channels = 2
    if _wants_shape(test):
        channels = 1 + len(test.rig.sensors)
    return test.linked and test.pacing == "lockstep" and 8 * channels * int(test.rig.block_samples) <= MOST_BYTES


def expected_peers(
    topics: Sequence[str], extracted: Sequence[str], response: str, bundled: bool = False, joined: bool = False
) -> dict[str, list[str]]:
    """For every node the ``topic:count`` list of connections it waits for before it calls itself ready.

    Args:
        topics: sample topics of the rig.
        extracted: those that the extraction reads.
        response: topic of the response that the loop controls.
        bundled: whether recorder and extraction take samples, drive and frequency in bundles.
        joined: whether the loop takes force and response at the drive point joined.
    """
    subscribers: dict[str, list[str]] = {
        topic: [] if bundled else ["recorder", *(["extract"] if topic in extracted else [])] for topic in topics
    }
    if joined:
        subscribers[LOOP_INPUT] = ["pll"]
    else:
        subscribers["force"].append("pll")
        subscribers[response].append("pll")
    subscribers.update(
        drive=["plant"] if bundled else ["plant", "recorder"],
        frequency=["sequencer"] if bundled else ["sequencer", "extract", "recorder"],
        level=["pll", "extract", "recorder"],
        lock=["sequencer", "extract", "recorder"],
        modal_point=["sequencer", "recorder"],
        steering=["recorder"],
        run_state=["plant", "recorder"],
        monitor=[] if bundled else ["recorder"],
    )
    if bundled:
        subscribers[PLANT_BUNDLE] = subscribers[PLL_BUNDLE] = ["extract", "recorder"]
    publisher = dict.fromkeys(topics, "plant")
    publisher.update(
        drive="pll",
        frequency="pll",
        lock="pll",
        level="sequencer",
        run_state="sequencer",
        steering="sequencer",
        modal_point="extract",
        monitor="plant",
        **{PLANT_BUNDLE: "plant", PLL_BUNDLE: "pll", LOOP_INPUT: "plant"},
    )
    peers: dict[str, list[str]] = {name: [] for name in NODES}
    for topic, names in subscribers.items():
        if names:
            peers[publisher[topic]].append(f"{topic}:{len(names)}")
        for name in names:
            peers[name].append(f"{topic}:1")
    return peers


def _extracted_harmonics(test: TestPlan, linear: LinearDescription | None) -> int:
    """Harmonics of the extraction: those that are controlled, too, as far as they are below half the sample rate."""
    harmonics = int(test.rig.extraction.harmonics)
    controlled = test.kind.controlled_harmonics
    if not controlled or linear is None:
        return harmonics
    wanted = HARMONICS.automatic_highest if controlled == AUTOMATIC else controlled
    below_nyquist = int(0.45 * float(test.rig.sample_rate_hz) / linear.frequency_hz)
    return max(harmonics, min(wanted, below_nyquist))


def _known_force(test: TestPlan, linear: LinearDescription | None) -> str:
    """JSON of the force per volt at controlled harmonics: of the linear test, beside it of the model.

    On hardware nothing but the test is believed; what it does not cover is probed.
    """
    if not test.kind.controlled_harmonics or linear is None:
        return ""
    rows = [list(row) for row in linear.force_per_volt_rows]
    low, high = (rows[0][0], rows[-1][0]) if rows else (math.inf, math.inf)
    if not test.is_on_hardware:
        frequencies = np.geomspace(0.5 * linear.frequency_hz, 0.5 * float(test.rig.sample_rate_hz), _FORCE_ROWS)
        beside = frequencies[(frequencies < low) | (frequencies > high)]
        for frequency, value in zip(beside, force_per_volt(test.rig, beside.tolist()), strict=True):
            rows.append([float(f"{x:.6g}") for x in (frequency, value.real, value.imag)])
    return json.dumps(sorted(rows)) if rows else ""


def _hysteresis_layout(rig: Rig) -> HysteresisLayout | None:
    """Points and masses of the hysteresis evaluation; none where the exciter was moved away from its mass."""
    section = rig.extraction.hysteresis
    if section is None or section.excited_point != rig.drive_point:
        return None
    return HysteresisLayout.from_mapping(section.model_dump())


def _sample_topics(rig: Rig) -> list[str]:
    present = {str(sensor.quantity) for sensor in rig.sensors}
    return [topic for topic in SAMPLE_TOPICS if topic in present]


def _chunk_messages(rig: Rig, sample_topics: int) -> int:
    """Messages of half a second of bench time: what a killed recorder loses is less than twice that."""
    blocks = 0.5 * rig.sample_rate_hz / rig.block_samples
    return max(10, int(blocks * (sample_topics + 2)))


def _extraction_topics(rig: Rig, topics: Sequence[str]) -> tuple[str, ...]:
    """Force, voltage, the rig's response quantity, and the other one if only it has a sensor at the drive point."""
    chosen = ["force", "voltage", rig.extraction.quantity]
    if rig.drive_point not in rig.response_points(Quantity[rig.extraction.quantity.upper()]):
        chosen.append("acceleration" if rig.extraction.quantity == "displacement" else "displacement")
    return tuple(topic for topic in topics if topic in chosen)


def _response_topic(rig: Rig) -> str:
    for quantity in (Quantity[rig.extraction.quantity.upper()], Quantity.DISPLACEMENT, Quantity.ACCELERATION):
        if rig.drive_point in rig.response_points(quantity):
            return quantity.topic
    raise BenchError(
        f"Rig {rig.name} has no displacement or acceleration sensor at its drive point {rig.drive_point}; "
        "phase resonance needs one: add {quantity: acceleration, point: drive} to its sensors."
    )


def _with_loops(pll: PllSettings, test: TestPlan, linear: LinearDescription | None, response: str) -> PllSettings:
    """The settings with those that the rig gives the loops.

    Amplitude floors default to a fraction of the linear estimate at the lowest level.
    """
    values = dict(test.rig.pll)
    block = float(test.rig.block_samples) / float(test.rig.sample_rate_hz)
    values = curve_values(test.kind, linear, values, test.control, block, test.lead_blocks)
    chosen = {**_node_values(values), **_paper_values(values)}
    if linear is not None:
        _add_floors(values, test, linear, response)
    if test.rig.limits.voltage_v is not None:
        values.setdefault("voltage_limit", float(test.rig.limits.voltage_v))
    if test.kind.controlled_harmonics:
        limits, rate = test.rig.limits, float(test.rig.sample_rate_hz)
        usual = 0.0 if limits.voltage_v is None else default_slew(float(limits.voltage_v), rate)
        values.setdefault("slew_limit", float(usual if limits.slew_v_s is None else limits.slew_v_s))
    if test.ramps:
        values.setdefault("ramp_delay_periods", RAMP_DELAY)
    settings_from({**values, "latency_blocks": test.lead_blocks})
    return with_values(pll, {"latency_blocks": test.lead_blocks, **chosen, **values}, "pll")


def _add_floors(values: dict[str, Any], test: TestPlan, linear: LinearDescription, response: str) -> None:
    scale = linear.frequencies_rad_s[linear.target_mode] ** MOTIONS.get(Quantity[response.upper()], 0)
    force_per_volt, response_per_volt = linear.force_per_volt, linear.displacement_per_volt * scale
    per_volt = {"voltage": 1.0, "response": response_per_volt, "force": force_per_volt}[test.control]
    lowest = min(test.levels) / per_volt
    if "force_floor" not in values and lowest * force_per_volt > 0:
        values["force_floor"] = 0.02 * lowest * force_per_volt
    if isinstance(test.kind, SecondaryResonanceTest):  # its response is not that of the mode in phase resonance
        return
    if test.kind.is_curve and test.control == "force":  # a stiff mode answers as a spring at least
        response_per_volt *= 2.0 * linear.plant_damping_ratio
    if "response_floor" not in values and lowest * response_per_volt > 0:
        values["response_floor"] = 0.02 * lowest * response_per_volt


def _paper_values(values: dict[str, Any]) -> dict[str, Any]:
    """Take the settings of the paper's loop out of the rig's settings, checked."""
    chosen: dict[str, Any] = {}
    known = {PAPER_PREFIX + parameter.name for parameter in parameters_of(PaperSettings)}
    for name in [name for name in values if name.startswith(PAPER_PREFIX)]:
        if name not in known:
            raise BenchError(f"PLL setting '{name}' is not known; known are {', '.join(sorted(known))}.")
        chosen[name] = float(values.pop(name))
    PaperSettings(**{name.removeprefix(PAPER_PREFIX): value for name, value in chosen.items()})
    return chosen


def _node_values(values: dict[str, Any]) -> dict[str, Any]:
    """Take what belongs to the loop's node and to no loop out of the rig's settings: which loop, the settling time.

    Raises:
        BenchError: a setting that follows from the rig and its test.
    """
    names = {item.name for item in fields(PllSettings)} - {"loop_settings", "paper_settings"}
    chosen = {name: values.pop(name) for name in list(values) if name in names}
    for name in chosen:
        if name in _FROM_RIG_AND_TEST:
            raise BenchError(
                f"The rig's pll.{name} follows from the rig and its test; leave it out of the section pll."
            )
    return chosen


_FROM_RIG_AND_TEST = frozenset({item.name for item in fields(NodeSettings)}) | {
    "linear_json", "force_per_volt_json", "drive_point", "exciters", "sample_rate", "block_samples", "response_topic",
    "bundle_blocks", "joined_input", "self_excited_method", "response_limit",
}  # fmt: skip
"""Settings of the loop's node that no rig file gives."""
