"""Messages are read by the definition stored with them: fields may have come, gone or moved since.

What is stored here is written by rosbags from altered definitions, so that the bytes are not made by what reads them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nmt_core.errors import BenchError
from nmt_core.messages.modal_point import COMPLEX, EVALUATED, ModalPoint
from nmt_core.messages.wire import MODAL_POINT, BlockReader, record_defaults
from nmt_core.vocabulary import PointStatus
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter
from nmt_record.bag.bench_topics import BENCH_TOPICS, SAMPLE_BLOCK
from nmt_record.bag.message_definitions import DefinitionStore, MessageDefinition

POINT = "nmt_msgs/msg/ModalPoint"
OWN = sorted({topic.message_type for topic in BENCH_TOPICS if topic.message_type.startswith("nmt_msgs/")})
MEASURED = ModalPoint(
    2, PointStatus.OK, "", 0.3, "V", 5_000_000_000, 100, 400, 20, 21.5, 1e-3, 135.1, 1e-2, 0.004, 1e-5, harmonics=1,
    points=(2, 6), force_harmonics=[0, 1 + 2j], shape_harmonics=[[0, 0], [1j, 2j]], normalised_shape=[1, 2],
    participation=[0.5, 0.1], harmonics_control=3,
)  # fmt: skip


class AnotherRelease:
    """Messages of one type as a release with other fields would have stored them.

    Args:
        store: definitions of today.
        message_type: the type.
        alter: makes the other release's lines of today's.
    """

    def __init__(self, store: DefinitionStore, message_type: str, alter: Callable[[list[str]], list[str]]) -> None:
        own, line, nested = store.definition(message_type).text.partition("=" * 80)
        self.definition = MessageDefinition("\n".join(alter(own.splitlines())) + "\n" + line + nested)
        self.message_type, self._local = message_type, store.typestore
        self._store = get_typestore(Stores.EMPTY)
        self._store.register(get_types_from_msg(self.definition.text, message_type))
        self.fields = [name for name, _ in self._store.fielddefs[message_type][1]]

    def bytes_of(self, raw: bytes, **unknown: Any) -> bytes:
        """A message of today in the other release's form; ``unknown``: fields that today does not know."""
        message = self._local.deserialize_cdr(raw, self.message_type)
        values = {name: unknown[name] if name in unknown else getattr(message, name) for name in self.fields}
        made = self._store.types[self.message_type](**values)
        return bytes(self._store.serialize_cdr(made, self.message_type))

    def bag(self, folder: Path, topic: str, *messages: bytes) -> Path:
        writer = BagWriter(folder, run_json='{"run_id": "r"}')
        writer.add_topic(topic, self.message_type, definition=self.definition)
        for index, raw in enumerate(messages):
            writer.write(topic, raw, 10 * index)
        writer.close()
        return folder


def without(*names: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [line for line in lines if line.split("#")[0].split()[1:2] not in [[n] for n in names]]


def with_line(behind: str, *added: str) -> Callable[[list[str]], list[str]]:
    def alter(lines: list[str]) -> list[str]:
        at = next(i for i, line in enumerate(lines) if line.split("#")[0].split()[1:2] == [behind])
        return [*lines[: at + 1], *added, *lines[at + 1 :]]

    return alter


def test_a_field_in_its_natural_place_leaves_earlier_points_readable(store: DefinitionStore, tmp_path: Path) -> None:
    """Damping and its uncertainty stand in the middle of a point; a release before them had neither."""
    before = AnotherRelease(store, POINT, without("damping_ratio", "damping_ratio_std"))
    path = before.bag(tmp_path / "bag", "modal_point", before.bytes_of(MODAL_POINT.write(MEASURED)))
    (point,) = Bag.open(path).records("modal_point", MODAL_POINT)
    assert math.isnan(point.damping_ratio)
    assert math.isnan(point.damping_ratio_std)
    for item in fields(ModalPoint):
        if not item.name.startswith("damping_ratio"):
            assert np.array_equal(
                getattr(point, item.name), getattr(MEASURED, item.name), equal_nan=item.name in NUMBERS
            )


NUMBERS = {item.name for item in fields(ModalPoint) if item.type == "float" or item.name in COMPLEX}


def test_fields_of_a_later_release_are_left_out(store: DefinitionStore, tmp_path: Path) -> None:
    after = AnotherRelease(store, POINT, with_line("damping_ratio_std", "float32 q_factor", "string[] words"))
    raw = after.bytes_of(MODAL_POINT.write(MEASURED), q_factor=3.0, words=["one", "two"])
    (point,) = Bag.open(after.bag(tmp_path / "bag", "modal_point", raw)).records("modal_point", MODAL_POINT)
    assert point.identical(MEASURED)


def test_fields_in_another_order_are_found_by_their_names(store: DefinitionStore, tmp_path: Path) -> None:
    def turned(lines: list[str]) -> list[str]:
        return sorted(lines, key=lambda line: "frequency_hz" in line.split("#")[0] and "=" not in line)

    moved = AnotherRelease(store, POINT, turned)
    assert moved.fields[-2:] == ["frequency_hz", "frequency_hz_std"]
    path = moved.bag(tmp_path / "bag", "modal_point", moved.bytes_of(MODAL_POINT.write(MEASURED)))
    (point,) = Bag.open(path).records("modal_point", MODAL_POINT)
    assert point.identical(MEASURED)


@pytest.mark.parametrize("message_type", OWN)
def test_every_field_that_a_bag_lacks_has_the_default_of_its_record(
    message_type: str, store: DefinitionStore, tmp_path: Path
) -> None:
    """Every other field is missing, in messages of all types."""
    store.definition(message_type)
    names = store.fields(message_type)
    missing = names[1::2]
    before = AnotherRelease(store, message_type, without(*missing))
    assert before.fields == [name for name in names if name not in missing]
    kinds = dict(store.typestore.fielddefs[message_type][1])
    message = store.typestore.types[message_type](**{name: _something(store, kinds[name]) for name in names})
    raw = bytes(store.typestore.serialize_cdr(message, message_type))
    bag = Bag.open(before.bag(tmp_path / "bag", "anything", before.bytes_of(raw)))
    ((_, _, read),) = bag.messages(["anything"])
    defaults = record_defaults(message_type.rsplit("/", 1)[-1])
    for name in names:
        got, default = getattr(read, name), defaults.get(name)
        if name not in missing:
            assert str(got) == str(getattr(message, name)), name
        elif isinstance(default, (int, float, str)):
            assert np.array_equal(got, default, equal_nan=isinstance(default, float)), name
        elif isinstance(got, float):
            assert math.isnan(got), name
        else:
            assert np.size(got) == 0 or not got or (got.sec, got.nanosec) == (0, 0), name


def _something(store: DefinitionStore, description: Any) -> Any:
    """A value that no default has."""
    node, detail = description
    if node.name == "BASE":
        return {"string": "text", "bool": True, "float64": 7.0}.get(detail[0], 7)
    if node.name == "NAME":
        return store.typestore.types[detail](
            **{name: _something(store, of) for name, of in store.typestore.fielddefs[detail][1]}
        )
    (_, item), _ = detail
    return ["one"] if item[0] == "string" else np.array([1, 2], item[0])


def test_blocks_of_another_release_are_read_everywhere(
    store: DefinitionStore, make_block: Callable[..., bytes], tmp_path: Path
) -> None:
    blocks = [make_block(20 * index) for index in range(6)]
    after = AnotherRelease(store, SAMPLE_BLOCK, with_line("unit", "uint8 range_code"))
    path = after.bag(tmp_path / "bag", "displacement", *(after.bytes_of(raw, range_code=3) for raw in blocks))
    bag = Bag.open(path)
    assert [raw for *_, raw in bag.raw_messages(["displacement"])] == blocks
    whole = [BlockReader().read(raw) for raw in blocks]
    assert all(np.array_equal(a.data, b.data) for a, b in zip(bag.blocks("displacement"), whole, strict=True))
    assert [head.first_sample for _, head in bag.heads()] == [block.first_sample for block in whole]
    assert bag.end_time_s == whole[-1].end_sample / 10_000.0


def test_a_repaired_copy_keeps_what_it_does_not_know(store: DefinitionStore, tmp_path: Path) -> None:
    after = AnotherRelease(store, POINT, with_line("damping_ratio_std", "float64 q_factor"))
    raw = after.bytes_of(MODAL_POINT.write(MEASURED), q_factor=125.0)
    copy = Bag.open(Bag.open(after.bag(tmp_path / "bag", "modal_point", raw)).repair(tmp_path / "copy"))
    assert [stored for *_, stored in copy.raw_messages(["modal_point"], as_stored=True)] == [raw]
    (point,) = copy.records("modal_point", MODAL_POINT)
    assert point.identical(MEASURED)


def test_what_does_not_fit_the_stored_definition_is_refused_in_a_sentence(
    store: DefinitionStore, tmp_path: Path
) -> None:
    after = AnotherRelease(store, POINT, with_line("damping_ratio_std", "float64 q_factor"))
    raw = after.bytes_of(MODAL_POINT.write(MEASURED), q_factor=1.0)
    bag = Bag.open(after.bag(tmp_path / "bag", "modal_point", raw[:60]))
    with pytest.raises(
        BenchError, match=r"'modal_point' in the bag .* cannot be read: the message is not a whole Modal"
    ):
        list(bag.records("modal_point", MODAL_POINT))


def test_defaults_are_those_of_the_records() -> None:
    point = record_defaults("ModalPoint")
    assert is_dataclass(ModalPoint)
    assert all(math.isnan(point[name]) and math.isnan(point[f"{name}_std"]) for name in EVALUATED)
    assert record_defaults("Level")["test"] == 1
    assert record_defaults("Drive")["ramp"] == 0.0
    assert record_defaults("Unheard") == {}
