"""What the recorder does with messages, free of ROS: serialised messages in, one bag that explains itself out."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.messages.cdr import read_stamp
from nmt_core.messages.run_announcement import RunAnnouncement
from nmt_core.messages.wire import DRIVE_STOP, RUN_STATE, BlockReader
from nmt_core.vocabulary import ResultCode, RunPhase, StopCause
from nmt_record.bag.bag_writer import BagWriter, Storage, parse_run
from nmt_record.bag.bench_topics import SAMPLE_BLOCK, BenchTopic, parse_topic
from nmt_record.bag.gap_counter import GapCounter
from nmt_record.bag.message_definitions import local_definitions
from nmt_record.bag.recorder_settings import RecorderSettings


class RunRecorder:
    """Writes the messages of a run into a bag and notices its end.

    The bag exists, with the run's start record in it, when the constructor returns.

    Args:
        settings: those of the node.
        clock: time in ns at which messages are received; None = wall time.
        path: folder of the bag; None = that of the parameters.
        run_json: self-description of the run; None = that of the parameters.

    Attributes:
        topics: what is recorded.
        writer: the bag being written.
        gaps: continuity of the sample topics.
        malformed: messages that could not be understood; they are recorded as they came.
        late: messages after the end of the bag.
        run_id: name of the run as the bag gives it; empty if it gives none.
        begun: whether the run has begun.
        end_sample: sample at which the run ended; None before.
        after_end: whether the newest message is stamped after the end of the run.

    Raises:
        BenchError: a parameter is wrong, or the bag cannot be created.
    """

    def __init__(
        self,
        settings: RecorderSettings,
        clock: Callable[[], int] | None = None,
        *,
        path: Path | None = None,
        run_json: str | None = None,
    ) -> None:
        if not settings.output:
            raise BenchError("Parameter 'output' of recorder must name the folder of the bag to create.")
        self.topics: list[BenchTopic] = [parse_topic(text) for text in settings.topics]
        self.gaps = GapCounter()
        self.malformed = 0
        self.late = 0
        self.end_sample: int | None = None
        self.after_end = False
        self._end_stamp: int | None = None
        run_json = described_run(settings) if run_json is None else run_json
        self.writer = BagWriter(
            path or settings.output,
            run_json=run_json,
            rig_yaml=_text("rig_yaml", settings.rig_yaml, "rig_file", settings.rig_file),
            storage=Storage(
                chunk_messages=settings.chunk_messages,
                flush_interval=settings.flush_interval,
                compression=settings.compression,
                split_bytes=settings.split_bytes,
                split_duration=settings.split_duration,
            ),
            clock=clock,
        )
        self.run_id = _run_id(run_json)
        self._seen_running = False
        self.begun = False
        self._ended_well = False
        self._end_reason = ""
        self._newest_voltage: bytes | None = None
        self._device_failed = False
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
        if exit_state == "incomplete" and self._end_reason:
            reason = f"{reason}; the run ended with: {self._end_reason}"
        with contextlib.suppress(BenchError):
            self.writer.close(
                exit_state,
                reason,
                round(self.gaps.bench_time() * 1e9),
                gaps=self.gaps.as_dict(),
                lacks_s=round(self.lacks_s, 6),
                malformed_messages=self.malformed,
            )
        return self.writer.failure or reason

    @property
    def lacks_s(self) -> float:
        """Bench time that the bag lacks, s; see :meth:`nmt_record.bag.gap_counter.GapCounter.lacking`."""
        return self.gaps.lacking(self.end_sample)

    @property
    def awaits_ramp(self) -> bool:
        """Whether the run ended early and the newest block of the voltage, if there is any, is not at zero yet.

        A device that has failed gives no more blocks.
        """
        awaited = self.end_sample is not None and not self._ended_well and not self._device_failed
        return awaited and not self.drive_at_zero

    @property
    def awaits_points(self) -> bool:
        """Whether a level that locked has no modal point yet."""
        return self.writer.counts.get("lock", 0) > self.writer.counts.get("modal_point", 0)

    @property
    def drive_at_zero(self) -> bool:
        """Whether the newest block of the voltage is zero, or there is none."""
        if self._newest_voltage is None:
            return True
        try:
            return not BlockReader().read(self._newest_voltage).data.any()
        except ValueError:
            return True  # malformed; nothing can be told from it

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
        if name == "drive_stop":
            return self._on_stop
        stamped = local_definitions().fields(topic.message_type)[:1] in (("stamp",), ("header",))
        return lambda raw: self._write(name, stamped, raw)

    def _on_stop(self, raw: bytes) -> None:
        self._write("drive_stop", True, raw)
        try:
            self._device_failed = DRIVE_STOP.read(raw).cause is StopCause.DEVICE
        except ValueError:
            self.malformed += 1

    def _on_run_state(self, raw: bytes) -> None:
        self._write("run_state", True, raw)
        try:
            state = RUN_STATE.read(raw)
        except ValueError:
            self.malformed += 1
            return
        if state.phase != RunPhase.DONE:
            self._seen_running = True
            self.begun = self.begun or state.phase in (RunPhase.RUNNING, RunPhase.PAUSED, RunPhase.STOPPING)
        elif self._seen_running or (state.run_id and state.run_id == self.run_id):
            # Otherwise it is the latched end of an earlier run.
            self.end_sample = state.sample
            self._end_stamp = max(read_stamp(raw), 0)
            self._ended_well = state.result_code == ResultCode.SUCCEEDED
            self._end_reason = state.reason

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
        self.after_end = stamp is not None and self._end_stamp is not None and stamp > self._end_stamp
        self.writer.write(topic, raw, None, stamp)


def described_run(settings: RecorderSettings, announced: RunAnnouncement | None = None) -> str:
    """Self-description of a run, a JSON text.

    Args:
        settings: those of the node; their description holds for the run that it names.
        announced: another run on the same nodes, whose name and plan take the place of those of the parameters.

    Raises:
        BenchError: the description in the parameters cannot be read.
    """
    text = _text("run_json", settings.run_json, "run_file", settings.run_file)
    if announced is None or (text and _run_id(text) == announced.run_id):
        return text
    run = parse_run(text)
    plan = run.get("plan")
    run["run_id"] = announced.run_id
    run["plan"] = {**(plan if isinstance(plan, dict) else {}), **announced.plan}
    run["started"] = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    return json.dumps(run)


def free_path(path: Path) -> Path:
    """The folder itself, or the first of ``path-2``, ``path-3`` … that does not exist."""
    candidate, number = path, 1
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


def why_unwritable(path: Path, least_free_mb: int) -> str:
    """Why no bag can be recorded next to ``path``: folder or space; empty if one can."""
    folder = path.absolute().parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        return f"the folder {folder} cannot be written"
    try:
        free = shutil.disk_usage(folder).free / 1e6
    except OSError as error:
        return f"the folder {folder} cannot be examined ({error.strerror or error})"
    if free < least_free_mb:
        return f"{free:.1f} MB are free in {folder}, less than {least_free_mb} MB (parameter 'least_free_mb')"
    return ""


def _run_id(run_json: str) -> str:
    return str(parse_run(run_json).get("run_id", ""))


def _text(name: str, text: str, name_of_file: str, file: str) -> str:
    """What a setting says, or the file that another one names."""
    if text and file:
        raise BenchError(f"Parameters '{name}' and '{name_of_file}' of recorder exclude each other; give one.")
    return read_text(Path(file), f"file of parameter '{name_of_file}' of recorder,") if file else text
