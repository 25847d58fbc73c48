"""Every option of a test, every field of its plan and every setting of a run arrives where it belongs.

Each is given a value that is not its default, one at a time, so that a wiring that is deleted fails the case of its
field. A new field fails until it has a case here.
"""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any, get_type_hints

import pytest

from nmt_bench.command_parser import CommandParser
from nmt_bench.commands import hardware_options, linear_command, run_command, sweep_command
from nmt_bench.page.start_goal import StartRequest, goal_of, start_form, start_request
from nmt_core.kinds import (
    GOAL_FIELDS,
    KindOfTest,
    PhaseResonanceTest,
    RandomTest,
    ResponseCurveTest,
    RingDownTest,
    SecondaryResonanceTest,
    SweepTest,
)
from nmt_core.messages.message_files import find_message_file, message_fields
from nmt_core.messages.run_settings import RunSettings
from nmt_core.options import add_options, options_of
from nmt_core.settings import ordered_fields, parameters_of, values_of
from nmt_core.vocabulary import ControlKind
from nmt_extract.extraction_settings import ExtractSettings
from nmt_plant.plant_settings import PlantSettings
from nmt_pll.pll_settings import PllSettings
from nmt_record.bag.recorder_settings import RecorderSettings
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig
from nmt_sequencer.run_core import RunCore
from nmt_sequencer.sequencer_settings import SequencerSettings
from nmt_session import planning
from nmt_session.node_plan import NODES, plan_nodes
from nmt_session.plan_of_test import TestPlan

SOURCES = Path(__file__).resolve().parents[2] / "ros2_ws" / "src"

# -- from options to the test ------------------------------------------------------------------------------------------

HERE = {
    run_command: ("force", "reference", "calibration", "no_report", "quiet", "page"),
    sweep_command: ("replace", "points", "reference", "quiet", "page"),
    linear_command: ("force", "bag", "mode", "near", "modes", "segment", "reference", "quiet", "page"),
}
"""Options that the command itself takes; all others are of the test, and the bench gets them."""
WORDS = {
    "rig": ["clamped_beam"], "out": ["--out", "elsewhere"], "levels": ["0.1,0.3"], "set": ["seed=9"],
    "device": ["portaudio"], "harmonics_control": ["9"], "band": ["20:900"], "start": ["16"], "stop": ["30"],
    "stepped": ["5"], "domain": ["7"], "direction": ["down"], "lag": ["30:150"],
}  # fmt: skip
NEEDED: dict[ModuleType, list[str]] = {
    run_command: ["beam", "--levels", "0.2,0.4"],
    sweep_command: ["beam", "--force", "1", "--from", "15", "--to", "25"],
    linear_command: ["beam"],
}
ALSO = {
    (sweep_command, "periods"): ["--stepped", "5"],
    (run_command, "release"): ["--resonance", "1:3"],
    (run_command, "start_frequency"): ["--resonance", "3:1"],
}


class AskedError(Exception):
    """What the bench was asked for."""


def asked_for(command: ModuleType, words: list[str], monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the bench gets where a command is called so."""

    def bench(*positional: Any, **settings: Any) -> None:
        raise AskedError({"rig": positional[0], "levels": positional[1], **settings})

    harness = ModuleType("nmt_bench.harness")
    harness.Bench = bench  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "nmt_bench.harness", harness)
    monkeypatch.setattr(hardware_options, "look_for_device", lambda *_: None)
    monkeypatch.setattr(hardware_options, "checked_device", lambda _, device, __: {"device": device})
    parser = CommandParser(prog=command.__name__)
    kind = get_type_hints(command.run)["options"]
    add_options(parser, kind)
    options = options_of(kind, parser.parse_args(words))
    calls = {
        run_command: lambda: run_command.run_test(options),
        sweep_command: lambda: sweep_command.measure_sweep(options, *sweep_command.checked_request(options)),
        linear_command: lambda: linear_command.measure_noise(options, linear_command.band_of(options.band), None),
    }
    with pytest.raises(AskedError) as asked:
        calls[command]()
    found: dict[str, Any] = asked.value.args[0]
    return {name: str(value) if name == "out" else value for name, value in found.items()}


def option_fields() -> list[tuple[ModuleType, str]]:
    kinds = {command: get_type_hints(command.run)["options"] for command in HERE}
    return [(command, item.name) for command, kind in kinds.items() for item in fields(kind)]


@pytest.mark.parametrize(
    ("command", "name"), [pair for pair in option_fields() if pair[1] not in HERE[pair[0]]], ids=lambda value: (
        value if isinstance(value, str) else value.__name__.rpartition(".")[2]
    )
)  # fmt: skip
def test_an_option_of_a_test_reaches_the_bench(
    command: ModuleType, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("linear.json").write_text(linear_description(load_rig("beam")).to_json(), encoding="utf-8")
    kind = get_type_hints(command.run)["options"]
    parser = CommandParser(prog="x")
    add_options(parser, kind)
    (action,) = (action for action in parser._actions if action.dest == name)
    if name in WORDS:
        words = WORDS[name][-1:]
    elif action.nargs == 0:
        words = []
    elif action.choices:
        words = [next(str(choice) for choice in action.choices if choice != action.default)]
    else:
        words = ["linear.json" if name == "linear" else "4"]
    usual = [*NEEDED[command], *ALSO.get((command, name), []), "--out", "out"]
    given = [*usual, action.option_strings[0], *words] if action.option_strings else [*words, *usual[1:]]
    assert asked_for(command, given, monkeypatch) != asked_for(command, usual, monkeypatch)


# -- from the plan of a test to its nodes ------------------------------------------------------------------------------

BEAM = load_rig("beam")
RANDOM = {"test": "random", "band_hz": (10.0, 900.0), "duration": 2.0}
SWEEP = {"test": "sweep", "frequencies_hz": (15.0,), "frequency_end_hz": 25.0, "rate_hz_s": 0.5, "control": "force"}
SELF_EXCITED = {
    "rig": load_rig("subcritical"), "test": "self_excited", "control": "response", "levels": (0.001, 0.002),
}  # fmt: skip
HARDWARE = {"device": "portaudio", "pacing": "realtime"}
EVERY_NODE = frozenset(NODES)
PLANS: dict[str, tuple[dict[str, Any], Any, frozenset[str]]] = {
    "rig": ({}, load_rig("beam", ["recording.compression=zstd"]), frozenset(("recorder",))),
    "rig_yaml": ({}, "name: other\n", frozenset(("rig.yaml",))),
    "levels": ({}, (0.05, 0.4), frozenset(("asked", "pll"))),
    "run_id": ({}, "mine", frozenset(("asked",))),
    "pacing": ({}, "realtime", EVERY_NODE),
    "latency_blocks": ({}, 2, frozenset(("plant", "pll", "sequencer"))),
    "window_periods": ({}, 33, frozenset(("asked",))),
    "ramp": ({}, 0.7, frozenset(("asked",))),
    "timeout": ({}, 12.0, frozenset(("asked",))),
    "stop_on_lost_lock": ({}, True, frozenset(("asked",))),
    "linear": ({}, replace(linear_description(BEAM), source="test"), frozenset(("pll", "extract"))),
    "node_values": ({}, {"pll": {"cutoff": 9.0}}, frozenset(("pll",))),
    "control": ({}, "force", frozenset(("asked", "pll"))),
    "strategy": ({}, "ramp", frozenset(("asked", "pll", "extract"))),
    "test": ({"duration": 2.0}, "ring_down", frozenset(("asked",))),
    "frequencies_hz": ({}, (21.0,), frozenset(("asked",))),
    "band_hz": (RANDOM, (20.0, 800.0), frozenset(("asked",))),
    "rate_hz_s": (SWEEP, 0.25, frozenset(("asked",))),
    "frequency_end_hz": (SWEEP, 30.0, frozenset(("asked",))),
    "duration": (RANDOM, 3.0, frozenset(("asked",))),
    "device": ({"pacing": "realtime"}, "portaudio", frozenset(("plant", "pll", "sequencer"))),
    "device_address": (HARDWARE, "host:1", frozenset(("plant",))),
    "linked": ({}, False, EVERY_NODE),
    "harmonics_control": ({}, 5, frozenset(("asked", "pll"))),
    "harmonics_target": (
        {"harmonics_control": 5, "rig": load_rig("beam", ["extraction.linear_modes=3"])},
        "modal",
        frozenset(("asked", "plant")),
    ),
    "levels_without": ({"harmonics_control": 5}, (0,), frozenset(("asked",))),
    "resonance": ({"test": "secondary_resonance"}, "1:3", frozenset(("asked",))),
    "release": ({"test": "secondary_resonance", "resonance": "1:3", "release": 2e-3}, 1e-3, frozenset(("asked",))),
    "refinement": ({}, 1e-3, frozenset(("asked",))),
    "lag_deg": ({"test": "response_curve", "control": "force"}, (30.0, 150.0), frozenset(("asked",))),
    "spacing": ({"test": "response_curve", "control": "force"}, 0.1, frozenset(("asked",))),
    "floquet": ({"test": "response_curve", "control": "force"}, True, frozenset(("asked",))),
    "perturbation": ({"test": "response_curve", "control": "force"}, 0.02, frozenset(("asked",))),
    "along": ({"test": "response_curve", "control": "force"}, "secant", frozenset(("asked",))),
    "method": (SELF_EXCITED, "envelope", frozenset(("asked", "pll"))),
    "tick_blocks": ({}, 3, frozenset(("sequencer", "plant", "pll"))),
    "block_reason": ({}, "because", frozenset(("run.json",))),
}
"""For each field of a plan and each setting of a kind of test: what else the plan has, a value that is not the default,
and where that arrives."""


def plan_of(values: dict[str, Any]) -> TestPlan:
    """A plan of its fields and of the settings of its kind of test."""
    given = dict(values)
    kind = planning.kind_of_rig(given.pop("test", "phase_resonance"), given["rig"], given)
    return TestPlan.of(**given, kind=kind)


def test_every_field_of_a_plan_has_its_case() -> None:
    of_kinds = set(planning.TestSettings.__annotations__) - {"overrides", "exciter", "seed", "compare"}
    known = {item.name for record in (RunSettings, TestPlan) for item in fields(record)}
    assert set(PLANS) == known - {"kind", "asked"} | of_kinds


@pytest.mark.parametrize("name", sorted(PLANS))
def test_a_field_of_the_plan_arrives_at_its_nodes(name: str) -> None:
    beside, value, places = PLANS[name]
    usual = {"rig": BEAM, "rig_yaml": "name: beam\n", "levels": (0.1, 0.4), "run_id": "usual", **beside}
    changed = {**usual, name: value}
    if name == "test":
        del usual["duration"]
    if name == "resonance":
        usual["resonance"] = "3:1"
        changed["release"] = 1e-3
    one, other = (plan_nodes(plan_of(plan), Path("bag"), Path("rig.yaml")) for plan in (usual, changed))
    blank = {"run_json": "", "rig_yaml": ""}
    found = {
        node
        for node in NODES
        if {**one.values[node], **(blank if node == "recorder" else {})}
        != {**other.values[node], **(blank if node == "recorder" else {})}
    }
    found |= {"asked"} if one.asked != other.asked else set()
    found |= {"rig.yaml"} if one.recorder.rig_yaml != other.recorder.rig_yaml else set()
    found |= {"run.json"} if one.run["block"] != other.run["block"] else set()
    assert found == places


GIVEN = {
    "lockstep": {
        "plant": "rig_file pacing bundle_blocks loop_topics drive_point reader_lead expected_peers watched_nodes "
        "linked",
        "pll": "linear_json drive_point sample_rate block_samples bundle_blocks joined_input force_floor "
        "response_floor voltage_limit pacing expected_peers watched_nodes linked",
        "sequencer": "sample_rate block_samples largest_voltage largest_force largest_response expected_peers "
        "watched_nodes linked",
        "extract": "linear_json harmonics topics bundled rig pacing expected_peers linked",
        "recorder": "output bundled run_json rig_yaml chunk_messages pacing expected_peers linked",
    },
    "realtime": {
        "plant": "rig_file latency_blocks output_record device device_address expected_peers watched_nodes",
        "pll": "linear_json drive_point sample_rate block_samples force_floor response_floor latency_blocks "
        "voltage_limit expected_peers watched_nodes",
        "sequencer": "sample_rate block_samples pacing latency_blocks largest_voltage largest_force largest_response "
        "expected_peers watched_nodes",
        "extract": "linear_json harmonics topics rig expected_peers",
        "recorder": "output run_json rig_yaml chunk_messages expected_peers",
    },
}
"""Settings of each node that a plan gives other values than their defaults, by pacing."""


@pytest.mark.parametrize("pacing", GIVEN)
def test_a_plan_gives_each_node_these_settings(pacing: str) -> None:
    rig = load_rig("beam", ["sample_rate_hz=8000", "block_samples=100"])
    more = {**HARDWARE, "device_address": "host:1"} if pacing == "realtime" else {}
    plan = plan_nodes(TestPlan.of(rig, "name: beam\n", (0.1, 0.4), **more), Path("bag"), Path("rig.yaml"))
    for name, settings in plan.settings.items():
        usual = values_of(type(settings)())
        given = {key for key, value in values_of(settings).items() if value != usual[key]}
        assert given == set(GIVEN[pacing][name].split()), name


# -- from what a run is asked for to goal, sequencer, run.json and page ------------------------------------------------

RUN: dict[str, Any] = {
    "run_id": "mine", "levels": (0.3, 0.5), "control": 3, "ramp": 0.7, "window_periods": 33, "timeout": 12.0,
    "stop_on_lost_lock": True, "frequencies_hz": (21.0, 22.0), "levels_without": frozenset({1}),
}  # fmt: skip
KINDS: dict[str, KindOfTest] = {
    "test": RingDownTest(duration=1.0),
    "band_low_hz": RandomTest(band_low_hz=20.0, band_high_hz=900.0, duration=1.0),
    "band_high_hz": RandomTest(band_low_hz=10.0, band_high_hz=800.0, duration=1.0),
    "rate_hz_s": SweepTest(rate_hz_s=0.5, frequency_end_hz=30.0),
    "frequency_end_hz": SweepTest(rate_hz_s=1.0, frequency_end_hz=29.0),
    "duration": RingDownTest(duration=2.0),
    "harmonics_control": PhaseResonanceTest(harmonics_control=7),
    "harmonics_target": PhaseResonanceTest(harmonics_control=7, harmonics_target=1),
    "response_order": SecondaryResonanceTest(response_order=3, force_order=1),
    "force_order": SecondaryResonanceTest(response_order=1, force_order=3, release=2e-3),
    "release": SecondaryResonanceTest(response_order=1, force_order=3, release=1e-3),
    "refinement": PhaseResonanceTest(refinement=1e-3),
    "lag_from": ResponseCurveTest(lag_from=0.4),
    "lag_to": ResponseCurveTest(lag_to=2.5),
    "spacing": ResponseCurveTest(spacing=0.1),
    "perturbation": ResponseCurveTest(perturbation=0.02),
    "along": ResponseCurveTest(along=2),
}
ASKED = [RunSettings(levels=(0.1, 0.2), kind=item) for item in KINDS.values()] + [
    replace(RunSettings(levels=(0.1, 0.2), kind=PhaseResonanceTest(harmonics_control=5)), **{name: value})
    for name, value in RUN.items()
]
ASKED = [replace(item, frequencies_hz=(15.0, 16.0)) if isinstance(item.kind, SweepTest) else item for item in ASKED]
ASKED = [
    replace(item, control=ControlKind.FORCE) if isinstance(item.kind, ResponseCurveTest) else item for item in ASKED
]


def test_every_field_of_a_run_has_its_case_and_is_one_of_the_goal() -> None:
    assert {*RUN, "kind"} == {item.name for item in fields(RunSettings)}
    assert set(KINDS) == {*GOAL_FIELDS, "test"}
    action = find_message_file("nmt_msgs/msg/Level").parents[1] / "action" / "RunLevels.action"
    goal = action.read_text(encoding="utf-8").partition("\n---\n")[0]
    assert {name for name, _ in message_fields(goal)} == set(RunSettings().goal)


@pytest.mark.parametrize("asked", ASKED, ids=str)
def test_what_a_run_is_asked_for_arrives_at_sequencer_description_and_page(asked: RunSettings) -> None:
    assert RunSettings.of_goal(asked.goal) == asked
    core = RunCore(SequencerSettings(pacing="realtime"))
    plan = core.plan(asked.goal)
    left_open = {"run_id": plan.run_id, "ramp": plan.ramp, "window_periods": plan.window_periods}
    left_open["timeout"] = plan.timeout
    expected = {**asked.values, **{name: left_open[name] for name in left_open if not getattr(asked, name)}}
    if isinstance(asked.kind, ResponseCurveTest):  # a curve begins with its two ends; points between come as it runs
        expected["levels"] = tuple(level for level in asked.levels for _ in range(2))
    assert expected == plan.values
    for name in ("run_id", "ramp", "window_periods", "timeout"):
        assert getattr(asked, name) in (0, "", getattr(plan, name))
    described = json.loads(json.dumps(core.announcement("goal", plan).plan))
    assert described["pacing"] == "realtime"
    assert RunSettings.described(described) == replace(RunSettings(**plan.values), run_id="")
    again = RunSettings.of_goal(goal_of(StartRequest(tuple(expected["levels"])), described))
    assert again == replace(RunSettings(**plan.values), run_id="", levels_without=frozenset())


def test_what_the_page_asks_for_arrives_in_the_goal_and_has_its_input() -> None:
    orders = {"levels": "0.5", "window_periods": 44, "harmonics_control": "9"}
    assert set(orders) == {item.name for item in fields(StartRequest)}
    before = RunSettings(levels=(0.1,), kind=PhaseResonanceTest(harmonics_control=5)).description
    inputs = {"levels": "levels", "window_periods": "window_periods", "harmonics_control": "harmonics"}
    for name, value in orders.items():
        order = {"levels": "0.1", inputs[name]: value}
        usual, asked = (goal_of(start_request(each), before) for each in ({"levels": "0.1"}, order))
        assert {key for key in asked if asked[key] != usual[key]} == {name}
    assert [word.partition('"')[0] for word in start_form().split('name="')[1:]] == ["levels", "harmonics"]


# -- settings of nodes -------------------------------------------------------------------------------------------------


def unread_names(names: set[str], but: tuple[str, ...]) -> set[str]:
    """Those of some attributes that the sources do not read; a file without any of them is not parsed."""
    unread = set(names)
    for path in SOURCES.glob("nmt_*/nmt_*/**/*.py"):
        text = path.read_text(encoding="utf-8")
        if path.name in but or not any(f".{name}" in text for name in unread):
            continue
        nodes = ast.walk(ast.parse(text))
        unread -= {node.attr for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)}
    return unread


def test_every_setting_of_a_node_is_read() -> None:
    kinds = (PlantSettings, PllSettings, SequencerSettings, ExtractSettings, RecorderSettings)
    unread_of_all = unread_names({item.name for kind in kinds for item in ordered_fields(kind)}, ("node_settings.py",))
    for kind in kinds:
        unread = [item.name for item in ordered_fields(kind) if item.name in unread_of_all]
        assert unread in ([], ["rig"]), kind  # the name of the rig stands in the log of the parameters only
        assert len({parameter.name for parameter in parameters_of(kind)}) == len(parameters_of(kind)), kind


def test_an_unknown_option_is_the_first_cause_of_what_else_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    parser = CommandParser(prog="x")
    pair = parser.add_mutually_exclusive_group()
    pair.add_argument("sidecar", nargs="?")
    pair.add_argument("--init")
    with pytest.raises(SystemExit):
        parser.parse_args(["--init", "data.csv", "--model", "rig.yaml"])
    assert "Unknown argument '--model'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        parser.parse_args(["--ini", "data.csv", "rig.yaml"])
    assert "not allowed with argument" in capsys.readouterr().err
