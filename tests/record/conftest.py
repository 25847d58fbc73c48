"""Messages and bags for the tests of nmt_record, made without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmt_record.bag.bag_writer import BagWriter, Storage
from nmt_record.bag.bench_topics import BENCH_TOPICS, SAMPLE_BLOCK
from nmt_record.bag.message_definitions import DefinitionStore, local_definitions

RUN_JSON = '{"run_id": "run-7", "linear": {"source": "model"}, "extraction": {"harmonics": 5}}'
RIG_YAML = "name: beam\n"


@pytest.fixture(scope="session")
def store() -> DefinitionStore:
    definitions = local_definitions()
    for topic in BENCH_TOPICS:
        definitions.definition(topic.message_type)
    return definitions


@pytest.fixture
def make_block(store: DefinitionStore) -> Callable[..., bytes]:
    types = store.typestore.types

    def make(first_sample: int, samples: int = 20, channels: int = 2, frame: str = "beam", unit: str = "m") -> bytes:
        seconds, rest = divmod(first_sample, 10_000)
        message = types[SAMPLE_BLOCK](
            header=types["std_msgs/msg/Header"](
                stamp=types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest * 100_000), frame_id=frame
            ),
            first_sample=first_sample,
            sample_rate=10_000.0,
            quantity=2,
            unit=unit,
            channels=[f"x{i + 1}" for i in range(channels)],
            points=np.arange(1, channels + 1, dtype=np.uint32),
            data=np.random.default_rng(first_sample).standard_normal(channels * samples),
            oscillator_cycles=0.25,
            oscillator_frequency_hz=50.0,
            oscillator_rate_hz_s=0.0,
            flags=0,
        )
        return bytes(store.typestore.serialize_cdr(message, SAMPLE_BLOCK))

    return make


@pytest.fixture
def make_bag(tmp_path: Path, make_block: Callable[..., bytes]) -> Iterator[Callable[..., Path]]:
    left_open = []

    def make(
        name: str = "bag",
        blocks: int = 40,
        per_chunk: int = 5,
        close: bool = True,
        storage: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> Path:
        writer = BagWriter(
            tmp_path / name,
            run_json=RUN_JSON,
            rig_yaml=RIG_YAML,
            storage=Storage(chunk_messages=per_chunk, flush_interval=60.0, **(storage or {})),
            **options,
        )
        writer.add_topic("displacement", SAMPLE_BLOCK)
        for index in range(blocks):
            writer.write("displacement", make_block(20 * index), 1_000 * index + 10, 2_000_000 * index)
        if close:
            writer.close()
        else:
            left_open.append(writer)
        return writer.path

    yield make
    for writer in left_open:
        writer.close()
