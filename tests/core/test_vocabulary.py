"""The vocabulary against the message files, and against second definitions anywhere else."""

from __future__ import annotations

import ast
import re
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import get_args

import pytest

from nmt_core import vocabulary
from nmt_core.errors import BenchError
from nmt_core.vocabulary import (
    LEVEL_UNITS,
    BlockFlag,
    ControlKind,
    CurveParameter,
    HarmonicsTarget,
    LoopState,
    OutputState,
    PointStatus,
    Quantity,
    RecordKind,
    ResultCode,
    RunPhase,
    SteeringAct,
    StopCause,
    TestKind,
    Waveform,
)
from nmt_record.exchange.sidecar.import_sidecar import SignalSection

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "ros2_ws" / "src"
MESSAGES = SOURCES / "nmt_msgs"
ENUMS = [
    item
    for item in vars(vocabulary).values()
    if isinstance(item, type) and issubclass(item, IntEnum | IntFlag) and item not in (IntEnum, IntFlag)
]


def constants(file: str) -> dict[str, int]:
    """The constants of a message or action file, by name."""
    text = (MESSAGES / file).read_text(encoding="utf-8")
    return {name: int(value) for name, value in re.findall(r"^uint8 +([A-Z_]+)=(\d+)", text, re.MULTILINE)}


def members(kind: type[IntEnum] | type[IntFlag], prefix: str = "") -> dict[str, int]:
    return {f"{prefix}{name}": int(member) for name, member in kind.__members__.items()}


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        (
            "msg/SampleBlock.msg",
            {**members(Quantity), **{n: v for n, v in members(BlockFlag, "FLAG_").items() if n != "FLAG_NONE"}},
        ),
        ("msg/Drive.msg", members(Waveform)),
        ("msg/Frequency.msg", members(LoopState)),
        (
            "msg/Level.msg",
            {
                **members(ControlKind, "CONTROL_"),
                **{k: v for k, v in members(TestKind, "TEST_").items() if v != 6},
                **members(HarmonicsTarget, "TARGET_"),
                **members(CurveParameter, "PARAMETER_"),
            },
        ),
        ("msg/LockEvent.msg", {**members(TestKind, "TEST_"), **members(CurveParameter, "PARAMETER_")}),
        ("msg/ModalPoint.msg", members(PointStatus, "STATUS_")),
        ("msg/DriveStop.msg", {**members(StopCause, "CAUSE_"), **members(OutputState, "OUTPUT_")}),
        ("msg/RunRecord.msg", members(RecordKind)),
        ("msg/RunState.msg", members(RunPhase)),
        ("msg/Steering.msg", members(SteeringAct)),
        (
            "action/RunLevels.action",
            {
                **members(ControlKind, "CONTROL_"),
                **{k: v for k, v in members(TestKind, "TEST_").items() if v != 6},
                **members(HarmonicsTarget, "TARGET_"),
                **members(ResultCode),
            },
        ),
    ],
)
def test_members_are_the_constants_of_the_messages(file, expected):
    assert constants(file) == expected


def test_every_message_file_with_constants_is_compared_above():
    with_constants = {
        path.name for path in MESSAGES.glob("*/*") if re.search(r"^uint8 +[A-Z_]+=", path.read_text(), re.M)
    }
    assert with_constants == {
        "SampleBlock.msg", "Drive.msg", "Frequency.msg", "Level.msg", "LockEvent.msg", "ModalPoint.msg",
        "RunRecord.msg", "RunState.msg", "Steering.msg", "DriveStop.msg", "RunLevels.action",
    }  # fmt: skip


def test_unit_of_a_level_by_what_is_held():
    assert ControlKind.VOLTAGE.level_unit(Quantity.ACCELERATION) == "V"
    assert ControlKind.UNKNOWN.level_unit() == "V"
    assert ControlKind.FORCE.level_unit(Quantity.DISPLACEMENT) == "N"
    assert ControlKind.RESPONSE.level_unit(Quantity.DISPLACEMENT) == "m"
    assert ControlKind.RESPONSE.level_unit(Quantity.VELOCITY) == "m/s"
    assert ControlKind.RESPONSE.level_unit(Quantity.ACCELERATION) == "m/s^2"
    assert ControlKind.RESPONSE.level_unit() == ""
    expected = {"V": ControlKind.VOLTAGE, "N": ControlKind.FORCE, "N*m": ControlKind.FORCE}
    assert {unit: ControlKind.of_unit(unit) for unit in LEVEL_UNITS} == {
        unit: expected.get(unit, ControlKind.RESPONSE)
        for unit in ("V", "N", "m", "m/s", "m/s^2", "N*m", "rad", "rad/s", "rad/s^2")
    }
    with pytest.raises(BenchError, match="cannot be in 'A'"):
        ControlKind.of_unit("A")


def test_controls_by_name():
    assert [ControlKind.named(name) for name in ("voltage", "response", "force")] == [1, 2, 3]
    with pytest.raises(BenchError, match="Control 'unknown' is not known"):
        ControlKind.named("unknown")


def test_acts_of_steering_by_name():
    assert [SteeringAct.named(act.label) for act in SteeringAct if act] == [act for act in SteeringAct if act]
    with pytest.raises(BenchError, match="cannot be steered by 'unknown'"):
        SteeringAct.named("unknown")


def test_units_of_levels_in_a_sidecar_are_these():
    assert get_args(SignalSection.model_fields["level_unit"].annotation) == LEVEL_UNITS


# --- nobody else defines one of these --------------------------------------------------------------------------------

WORDS = {(name, int(member)) for kind in ENUMS for name, member in kind.__members__.items()}
UNITS = set(LEVEL_UNITS)
KINDS = {
    "CONTROL", "CODE", "FLAG", "KIND", "LOOP", "PHASE", "QUANTITY", "RECORD", "RESULT", "RUN", "STATE", "STATUS",
    "TEST", "WAVEFORM",
}  # fmt: skip


def is_word(name: str, value: int) -> bool:
    """Whether a name with this number says what a member of the vocabulary says, such as ``_LOCK_LOST = 4``."""
    plain = name.strip("_").upper()
    first, _, rest = plain.partition("_")
    return (plain, value) in WORDS or (first in KINDS and (rest, value) in WORDS)


def assigned(node: ast.AST) -> list[tuple[str, int]]:
    """Names and the whole numbers they are set to."""
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        pairs = [(node.target, node.value)]
    elif isinstance(node, ast.Assign):
        pairs = []
        for target in node.targets:
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs += zip(target.elts, node.value.elts, strict=False)
            else:
                pairs.append((target, node.value))
    else:
        return []
    return [
        (target.id, value.value)
        for target, value in pairs
        if isinstance(target, ast.Name) and isinstance(value, ast.Constant) and type(value.value) is int
        and target.id.isupper()
    ]  # fmt: skip


def is_table_of_derivatives(node: ast.Dict) -> bool:
    """Whether a table gives motions, by quantity or by letter, numbers such as those of `MOTIONS`."""
    keys = [ast.unparse(key).strip("'") for key in node.keys if key is not None]
    motions = {f"Quantity.{motion.name}" for motion in vocabulary.MOTIONS}
    letters = {motion.letter for motion in vocabulary.MOTIONS}
    small = {f"{sign}{number}{end}" for sign in ("", "-") for number in range(3) for end in ("", ".0")}
    values = {ast.unparse(value) for value in node.values}
    return len(keys) > 1 and (set(keys) <= motions or set(keys) <= letters) and values <= small


def second_definitions(tree: ast.AST) -> list[str]:
    """What a module says again that the vocabulary says already."""
    found = []
    for node in ast.walk(tree):
        found += [f"line {node.lineno}: {name} = {value}" for name, value in assigned(node) if is_word(name, value)]
        if isinstance(node, ast.ClassDef):
            names = {target for item in node.body for target, _ in assigned(item)}
            for kind in ENUMS:
                if len(names & set(kind.__members__) - {"UNKNOWN"}) > 1 and "Enum" in ast.dump(ast.Tuple(node.bases)):
                    found.append(f"line {node.lineno}: {node.name} repeats {kind.__name__}")
        if isinstance(node, ast.Dict):
            if is_table_of_derivatives(node):
                found.append(f"line {node.lineno}: a table of derivatives")
            keys = [key.value for key in node.keys if isinstance(key, ast.Constant)]
            values = [value.value for value in node.values if isinstance(value, ast.Constant)]
            for one, other in ((keys, values), (values, keys)):
                if len(one) > 1 and all(type(item) is int for item in one) and other and set(other) <= UNITS:
                    found.append(f"line {node.lineno}: a table of units by number")
                numbered = len(one) == len(other) > 1 and all(type(item) is int for item in one)
                if numbered and all((str(b).upper(), a) in WORDS for a, b in zip(one, other, strict=True)):
                    found.append(f"line {node.lineno}: a table of words by number")
    return found


def test_a_second_definition_is_found():
    for text in (
        "LOCK_LOST = 4",
        "_LOCK_LOST: int = 4",
        "FIXED, ACQUIRING = 1, 2",
        "CONTROL_FORCE = 3",
        "WAVEFORM_SINE, WAVEFORM_RANDOM = 2, 3",
        "FLAG_LIMIT = 2",
        "from enum import IntEnum\nclass S(IntEnum):\n    LOCKED = 3\n    FIXED = 1",
        'UNITS = {1: "V", 3: "N"}',
        '_CONTROLS = {"V": 1, "m": 2, "N": 3}',
        'CONTROLS = {1: "voltage", 2: "response", 3: "force"}',
        'CODES = {"force": 1, "displacement": 2}',
        "_ORDER = {Quantity.DISPLACEMENT: 0, Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}",
        "power = {Quantity.DISPLACEMENT: 1, Quantity.ACCELERATION: -1}.get(quantity, 0)",
        'D = {"x": 0, "v": 1, "a": 2}',
    ):
        assert second_definitions(ast.parse(text)), text
    for text in (
        "ACCELERATION = 12",
        "LIMIT_KERNEL = 2",
        "limit = 2",
        'NAMES = {1: "a", 2: "b"}',
        'P = {"none": 0.0, "unknown": 0.0}',
        "RANGE = {Quantity.DISPLACEMENT: 0.3, Quantity.ACCELERATION: 1e5}",
        'SCALE = {"x": x, "v": v}',
    ):
        assert not second_definitions(ast.parse(text)), text


@pytest.mark.campaign
def test_nobody_else_defines_a_state_flag_kind_or_unit():
    files = [*SOURCES.glob("nmt_*/nmt_*/**/*.py"), *ROOT.glob("campaigns/**/*.py"), *(ROOT / "tests").rglob("*.py")]
    assert len(files) > 200
    found = {}
    for path in files:
        again = second_definitions(ast.parse(path.read_text(encoding="utf-8")))
        if SOURCES not in path.parents:  # a test may say itself what it holds against the program
            again = [each for each in again if not each.endswith("a table of derivatives")]
        if again and path.name != "vocabulary.py":
            found[str(path.relative_to(ROOT))] = again
    assert found == {}


def test_drive_commands_are_made_from_a_loops_output_in_one_place():
    """In the product a drive command is made by the codec, the loop's answer, and the plant's own measurements."""
    makers = set()
    for path in SOURCES.glob("nmt_*/nmt_*/**/*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "DriveCommand" in text else ():
            if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("DriveCommand"):
                makers.add(str(path.relative_to(SOURCES)))
    assert makers == {
        "nmt_core/nmt_core/messages/wire.py",
        "nmt_plant/nmt_plant/check/check_record.py",
        "nmt_pll/nmt_pll/loop_core.py",
    }
