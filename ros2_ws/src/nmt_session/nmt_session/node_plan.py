"""From a rig and a test to the parameters of every node; free of ROS, so that it can be looked at and tested."""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.yaml_text import yaml_text
from nmt_core.kinds import (
    SecondaryResonanceTest,
    SelfExcitedTest,
)
from nmt_core.messages.blocks import SAMPLE_TOPICS, Quantity
from nmt_core.messages.bundle import LOOP_INPUT, MOST_BYTES, PLANT_BUNDLE, PLL_BUNDLE
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.run_settings import RunSettings
from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.nodes.parameters import ParameterValue
from nmt_core.settings import parameters_of, values_of, with_values
from nmt_core.vocabulary import AUTOMATIC, MOTIONS, ControlKind, HarmonicsTarget
from nmt_extract.extraction_settings import ExtractionSettings, ExtractSettings
from nmt_extract.modal.hysteresis import HysteresisLayout
from nmt_plant.plant_settings import PlantSettings
from nmt_plant.safety.output_guard import default_slew
from nmt_pll.coverage import covers_linear
from nmt_pll.force_control.modal_power_ratio import check_modes
from nmt_pll.loop_settings import settings_from
from nmt_pll.phase_loop.paper_settings import PaperSettings
from nmt_pll.pll_settings import PAPER_PREFIX, PllSettings
from nmt_pll.thresholds import HARMONICS
from nmt_record.bag.recorder_settings import RecorderSettings
from nmt_rig.linear_description import force_per_volt
from nmt_rig.rig import Rig
from nmt_sequencer.level_plan import LevelLimits
from nmt_sequencer.sequencer_settings import SequencerSettings
from nmt_session.coverage import covers
from nmt_session.curve_loop import curve_values
from nmt_session.plan_of_test import TestPlan, level_limits, response_topic
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
RAMP_DELAY = 1.0
"""Periods from the start of a level to its window in the strategy ``ramp``."""
OUTPUT_RECORD = "output.jsonl"
"""File next to the bag, in real time, in which the process that owns the output says what the output does."""

# Where each node's class and executable are found.
NODES: dict[str, tuple[str, str, str]] = {
    "plant": ("nmt_plant", "plant", "nmt_plant.plant_node:PlantNode"),
    "pll": ("nmt_pll", "pll", "nmt_pll.pll_node:PllNode"),
    "sequencer": ("nmt_sequencer", "sequencer", "nmt_sequencer.sequencer_node:SequencerNode"),
    "extract": ("nmt_extract", "extract", "nmt_extract.extract_node:ExtractNode"),
    "recorder": ("nmt_record", "recorder", "nmt_record.bag.recorder_node:RecorderNode"),
}


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
    for name in test.node_values:
        if name not in NODES:
            raise BenchError(f"Node '{name}' is not part of the bench; there are {', '.join(NODES)}.")
    linear = test.used_linear
    wiring = _wiring(test, linear)
    if wiring.wants_shape and linear is not None and len(linear.exciter_points) < 2:
        check_modes(linear, f"The test of rig {test.rig.name}")
    peers = wiring.peers
    plant = _given(_plant_settings(test, wiring, bag, rig_file), test, "plant", peers)
    loops = _with_loops(_pll_settings(test, wiring, linear), test, linear, wiring.response)
    pll = _given(loops, test, "pll", peers)
    sequencer = _given(_sequencer_settings(test, wiring), test, "sequencer", peers)
    extract = _given(_extract_settings(test, wiring), test, "extract", peers)
    recorder = _given(_recorder_settings(test, wiring, bag), test, "recorder", peers)
    refusal = covers(test.driven, pll.loop, test.ramps, test.device)
    if not refusal and linear is not None:
        refusal = covers_linear(test.driven, linear)
    if refusal:
        raise BenchError(refusal)
    nodes = {"plant": plant, "pll": pll, "sequencer": sequencer, "extract": extract, "recorder": recorder}
    run = _description(test, wiring, nodes, device)
    recorder = replace(recorder, run_json=json.dumps(run), rig_yaml=test.rig_yaml)
    return NodePlan(plant, pll, sequencer, extract, recorder, run, test.asked)


@dataclass(frozen=True)
class _Wiring:
    """What several nodes of a test are given alike.

    Attributes:
        linear_json: linear description of loop and extraction; empty = none.
        response: topic of the response that the loop controls.
        topics: sample topics of the rig.
        extraction: settings of the extraction.
        bundle: blocks of a bundle for recorder and extraction; 0 = none.
        linked: whether the nodes hand on the sample path past the middleware.
        wants_shape: whether the loop takes all channels.
        joined: whether the loop takes force and response as one message.
        limits: largest levels.
    """

    linear_json: str
    response: str
    topics: list[str]
    extraction: ExtractionSettings
    bundle: int
    linked: bool
    wants_shape: bool
    joined: bool
    limits: LevelLimits

    @property
    def peers(self) -> dict[str, list[str]]:
        """Connections that each node waits for."""
        return expected_peers(self.topics, self.extraction.topics, self.response, self.bundle > 0, self.joined)


def _wiring(test: TestPlan, linear: LinearDescription | None) -> _Wiring:
    response, topics = response_topic(test.rig), _sample_topics(test.rig)
    linked, wants_shape = _is_linked(test), _wants_shape(test)
    return _Wiring(
        linear_json="" if linear is None else linear.to_json(),
        response=response,
        topics=topics,
        extraction=ExtractionSettings(
            harmonics=_extracted_harmonics(test, linear),
            topics=_extraction_topics(test.rig, topics),
            power_balance=test.ramps,
            hysteresis=_hysteresis_layout(test.rig),
        ),
        bundle=_bundle_blocks(test, len(topics)),
        linked=linked,
        wants_shape=wants_shape,
        joined=linked or (not wants_shape and _joins_loop_input(test, response)),
        limits=level_limits(test.rig),
    )


def _plant_settings(test: TestPlan, wiring: _Wiring, bag: Path, rig_file: Path) -> PlantSettings:
    settings = PlantSettings(
        rig_file=str(rig_file),
        pacing=test.pacing,
        latency_blocks=test.lead_blocks,
        watched_nodes=("pll", "sequencer"),
        reader_lead=_reader_lead(test.rig) if test.pacing == "lockstep" else 0.0,
        device=test.device if test.is_on_hardware else "",
        device_address=test.device_address if test.is_on_hardware else "",
        output_record=str(bag.absolute().parent / OUTPUT_RECORD) if test.pacing == "realtime" else "",
        bundle_blocks=wiring.bundle,
        linked=wiring.linked,
    )
    if not wiring.joined:
        return settings
    point = 0 if wiring.wants_shape else int(test.rig.drive_point)
    return replace(settings, loop_topics=("force", wiring.response), drive_point=point)


def _pll_settings(test: TestPlan, wiring: _Wiring, linear: LinearDescription | None) -> PllSettings:
    rig, kind = test.rig, test.kind
    settings = PllSettings(
        sample_rate=float(rig.sample_rate_hz),
        block_samples=int(rig.block_samples),
        pacing=test.pacing,
        linear_json=wiring.linear_json,
        drive_point=int(rig.drive_point),
        exciters=len(rig.all_exciters),
        response_topic=wiring.response,
        watched_nodes=("plant", "sequencer"),
        force_per_volt_json=_known_force(test, linear),
        bundle_blocks=wiring.bundle,
        linked=wiring.linked,
        joined_input=wiring.joined,
    )
    if isinstance(kind, SelfExcitedTest):
        limit = wiring.limits.largest_response
        return replace(settings, self_excited_method=kind.method, response_limit=limit)
    return settings


def _sequencer_settings(test: TestPlan, wiring: _Wiring) -> SequencerSettings:
    return SequencerSettings(
        sample_rate=float(test.rig.sample_rate_hz),
        block_samples=int(test.rig.block_samples),
        pacing=test.pacing,
        latency_blocks=test.lead_blocks,
        tick_blocks=test.tick_blocks,
        watched_nodes=("plant", "pll", "extract", "recorder"),
        limits=wiring.limits,
        linked=wiring.linked,
    )


def _extract_settings(test: TestPlan, wiring: _Wiring) -> ExtractSettings:
    layout = wiring.extraction.hysteresis
    return ExtractSettings(
        pacing=test.pacing,
        rig=test.rig.name,
        linear_json=wiring.linear_json,
        extraction=replace(wiring.extraction, hysteresis=None),
        hysteresis_json="" if layout is None else json.dumps(layout.to_mapping()),
        bundled=(*wiring.extraction.topics, "frequency") if wiring.bundle else ("",),
        linked=wiring.linked and wiring.bundle > 0,
    )


def _recorder_settings(test: TestPlan, wiring: _Wiring, bag: Path) -> RecorderSettings:
    settings = RecorderSettings(
        pacing=test.pacing,
        output=str(bag),
        chunk_messages=_chunk_messages(test.rig, len(wiring.topics)),
        bundled=(*wiring.topics, "monitor", *LOOP_TOPICS) if wiring.bundle else ("",),
        linked=wiring.linked and wiring.bundle > 0,
    )
    recording = test.rig.recording
    return settings if recording is None else replace(settings, compression=recording.compression)


def _description(test: TestPlan, wiring: _Wiring, nodes: Mapping[str, NodeSettings], device: str) -> dict[str, Any]:
    """Content of ``run.json``."""
    rig = test.rig
    return {
        "run_id": test.asked.run_id,
        "rig": rig.name,
        "seed": rig.seed,
        "plan": {
            **test.asked.description,
            "pacing": test.pacing,
            **vars(wiring.limits),
        },
        "block": {"samples": int(rig.block_samples), "reason": test.block_reason},
        "device": device,
        "exciter_point": rig.drive_point,
        **({"exciter_points": list(rig.exciter_points)} if len(rig.all_exciters) > 1 else {}),
        "linear": json.loads(wiring.linear_json) if wiring.linear_json else None,
        "extraction": wiring.extraction.to_mapping(),
        "parameters": {name: values_of(settings) for name, settings in nodes.items()},
        "versions": versions(),
        "started": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
    }


def _given(settings: S, test: TestPlan, name: str, peers: Mapping[str, Sequence[str]]) -> S:
    """The settings of a node with what the test says of them, and with the peers that it waits for.

    Raises:
        BenchError: the node has no such setting, or refuses its value.
    """
    return replace(with_values(settings, test.node_values.get(name, {}), name), expected_peers=tuple(peers[name]))


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
    """JSON of the force per volt at controlled harmonics: of the linear test, next to it of the model.

    On hardware nothing but the test is believed; what it does not cover is probed.
    """
    if not test.kind.controlled_harmonics or linear is None:
        return ""
    rows = [list(row) for row in linear.force_per_volt_rows]
    low, high = (rows[0][0], rows[-1][0]) if rows else (math.inf, math.inf)
    if not test.is_on_hardware:
        frequencies = np.geomspace(0.5 * linear.frequency_hz, 0.5 * float(test.rig.sample_rate_hz), _FORCE_ROWS)
        outside = frequencies[(frequencies < low) | (frequencies > high)]
        for frequency, value in zip(outside, force_per_volt(test.rig, outside.tolist()), strict=True):
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
    per_volt = {
        ControlKind.VOLTAGE: 1.0,
        ControlKind.RESPONSE: response_per_volt,
        ControlKind.FORCE: force_per_volt,
    }[test.control]
    lowest = min(test.asked.levels) / per_volt
    if "force_floor" not in values and lowest * force_per_volt > 0:
        values["force_floor"] = 0.02 * lowest * force_per_volt
    if isinstance(test.kind, SecondaryResonanceTest):  # its response is not that of the mode in phase resonance
        return
    if test.kind.is_curve and test.control is ControlKind.FORCE:  # a stiff mode answers as a spring at least
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
