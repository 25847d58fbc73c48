"""What the recorder does with messages, free of ROS: serialised messages in, one bag that explains itself out."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nmt_core.cdr import read_stamp
from nmt_core.errors import BenchError
from nmt_core.hardened import read_text
from nmt_core.parameters import Parameter
from nmt_core.vocabulary import ResultCode, RunPhase
from nmt_core.wire import RUN_STATE, BlockReader
from nmt_record.bag_writer import COMPRESSIONS, BagWriter
from nmt_record.bench_topics import BENCH_TOPICS, SAMPLE_BLOCK, BenchTopic, parse_topic
from nmt_record.gap_counter import GapCounter
from nmt_record.message_definitions import local_definitions

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("output", "", "", "Folder of the bag to create; must not exist."),
    Parameter(
        "topics",
        [topic.name for topic in BENCH_TOPICS],
        "",
        "Topics to record; those that are not of the bench as 'name:package/msg/Type'.",
    ),
    Parameter("run_json", "", "", "Self-description of the run, a JSON object."),
    Parameter("run_file", "", "", "File with the same, instead of run_json."),
    Parameter("rig_yaml", "", "", "The rig file as used, its text."),
    Parameter("rig_file", "", "", "File with the same, instead of rig_yaml."),
    Parameter("chunk_messages", 500, "", "Messages after which a chunk is written.", low=1),
    Parameter("flush_interval", 0.5, "s", "Wall time after which a chunk is written.", low=0.01),
    Parameter("compression", "none", "", "Compression of the chunks.", choices=tuple(COMPRESSIONS)),
    Parameter("split_bytes", 0, "byte", "Size after which the bag goes on in another file; 0 = one file.", low=0),
    Parameter("split_duration", 0.0, "s", "Wall time after which it does so; 0 = one file.", low=0.0),
    Parameter("settle_time", 0.25, "s", "Silence before the bag of a done run closes.", low=0.0),
    Parameter("patience", 2.0, "s", "Silence after which missing blocks are given up.", low=0.1),
)


class RunRecorder:
    """Writes the messages of a run into a bag and notices its end.

    The bag exists, with the run's start record in it, when the constructor returns.

    Args:
        values: parameters of the node, complete; see ``PARAMETERS``.
        clock: time in ns at which messages are received; None = wall time.

    Attributes:
        topics: what is recorded.
        writer: the bag being written.
        gaps: continuity of the sample topics.
        malformed: messages that could not be understood; they are recorded as they came.
        late: messages after the end of the bag.
        end_sample: sample at which the run ended; None before.

    Raises:
        BenchError: a parameter is wrong, or the bag cannot be created.
    """

    def __init__(self, values: Mapping[str, Any], clock: Callable[[], int] | None = None) -> None:
        if not values["output"]:
            raise BenchError("Parameter 'output' of recorder must name the folder of the bag to create.")
        self.topics: list[BenchTopic] = [parse_topic(text) for text in values["topics"]]
        self.gaps = GapCounter()
        self.malformed = 0
        self.late = 0
        self.end_sample: int | None = None
        run_json = _text(values, "run_json", "run_file")
        self.writer = BagWriter(
            str(values["output"]),
            run_json=run_json,
            rig_yaml=_text(values, "rig_yaml", "rig_file"),
            chunk_messages=values["chunk_messages"],
            flush_interval=values["flush_interval"],
            compression=str(values["compression"]),
            split_bytes=values["split_bytes"],
            split_duration=values["split_duration"],
            clock=clock,
        )
        self._run_id = str(json.loads(run_json).get("run_id", "")) if run_json else ""
        self._seen_running = False
        self._ended_well = False
        self._newest_voltage: bytes | None = None
        self._callbacks: dict[str, Callable[[bytes], None]] = {}
        for topic in self.topics:
            self.writer.add_topic(topic.name, topic.message_type, topic.service)
            self._callbacks[topic.name] = self._callback(topic)

    def callback(self, topic: str) -> Callable[[bytes], None]:
        """Function of one serialised message of a topic.

        The function raises BenchError if the disk refuses; what had been written before remains readable.
        """
        return self._callbacks[topic]

    def close(self, exit_state: str, reason: str) -> str:
        """Write the stop record and close the bag; does nothing if it is closed already. Never raises.

        Returns:
            The reason, or why the bag could not be closed.
        """
        with contextlib.suppress(BenchError):
            self.writer.close(
                exit_state,
                reason,
                round(self.gaps.bench_time() * 1e9),
                gaps=self.gaps.as_dict(),
                malformed_messages=self.malformed,
            )
        return self.writer.failure or reason

    @property
    def awaits_ramp(self) -> bool:
        """Whether the run ended early and the newest block of the voltage, if there is any, is not at zero yet."""
        if self.end_sample is None or self._ended_well or self._newest_voltage is None:
            return False
        try:
            return bool(BlockReader().read(self._newest_voltage).data.any())
        except ValueError:
            return False  # malformed; nothing can be told from it

    def _callback(self, topic: BenchTopic) -> Callable[[bytes], None]:
        name = topic.name
        if topic.message_type == SAMPLE_BLOCK:
            head_of = BlockReader().head

            def on_block(raw: bytes) -> None:
                try:
                    head = head_of(raw)
                    self.gaps.add(name, head.first_sample, head.samples, head.sample_rate)
                    if name == "voltage":
                        self._newest_voltage = raw
                except ValueError:
                    self.malformed += 1
                self._write(name, True, raw)

            return on_block
        if name == "run_state":
            return self._on_run_state
        stamped = local_definitions().fields(topic.message_type)[:1] in (("stamp",), ("header",))
        return lambda raw: self._write(name, stamped, raw)

    def _on_run_state(self, raw: bytes) -> None:
        self._write("run_state", True, raw)
        try:
            state = RUN_STATE.read(raw)
        except ValueError:
            self.malformed += 1
            return
        if state.phase != RunPhase.DONE:
            self._seen_running = True
        elif self._seen_running or (state.run_id and state.run_id == self._run_id):
            # Otherwise it is the latched end of an earlier run.
            self.end_sample = state.sample
            self._ended_well = state.result_code == ResultCode.SUCCEEDED

    def _write(self, topic: str, stamped: bool, raw: bytes) -> None:
        if self.writer.state != "open":
            self.late += 1
            return
        stamp = None
        if stamped:
            try:
                stamp = max(read_stamp(raw), 0)
            except ValueError:
                self.malformed += 1
        self.writer.write(topic, raw, None, stamp)


def _text(values: Mapping[str, Any], text: str, file: str) -> str:
    if values[text] and values[file]:
        raise BenchError(f"Parameters '{text}' and '{file}' of recorder exclude each other; give one.")
    if not values[file]:
        return str(values[text])
    return read_text(Path(values[file]), f"file of parameter '{file}' of recorder,")
