"""A whole test in one process without ROS: device, loop, run, extraction and bag, with the cores that the nodes have.

>>> from nmt_session import Session, plan_test
>>> with Session(plan_test("beam", levels=[0.1, 0.5], window_periods=20)) as session:
...     result = session.run()
>>> round(result.points[0].damping_ratio, 4)
0.0051

Messages pass through one queue in the order in which they are published, as between nodes in lockstep. The bag is the
one that the nodes write, message for message, but for ``/diagnostics``, which a session does not have.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import DriveCommand, DriveStop, LevelCommand, LockEvent, LoopStatus, RunState
from nmt_core.messages.wire import (
    DRIVE_STOP,
    LEVEL,
    LOCK_EVENT,
    MODAL_POINT,
    MONITOR,
    RUN_STATE,
    STEERING,
    BlockWriter,
    write_drive,
    write_status,
)
from nmt_core.settings import with_values
from nmt_core.vocabulary import Quantity, ResultCode, RunPhase, SteeringAct
from nmt_extract.extraction_core import ExtractionCore
from nmt_plant.devices.device import Device, DeviceFault
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.plant_core import PlantCore
from nmt_pll.loop_core import LoopCore
from nmt_record.bag.bag_keys import SIMULATED_RIG
from nmt_record.bag.run_recorder import RunRecorder
from nmt_sequencer.run_core import RunCore
from nmt_sequencer.steering import SteeringRequest
from nmt_session.node_plan import plan_nodes
from nmt_session.plan_of_test import TestPlan
from nmt_session.run_result import Progress, RunResult, with_cause

_PROGRESS_PERIOD = 0.1  # s of wall time

_CODECS: dict[str, Any] = {
    "level": LEVEL,
    "lock": LOCK_EVENT,
    "run_state": RUN_STATE,
    "modal_point": MODAL_POINT,
    "drive_stop": DRIVE_STOP,
    "steering": STEERING,
    "monitor": MONITOR,
}

Listener = Callable[[str, Any], None]
"""Told of every message: its topic and its record."""


class Session:
    """One test, stepped in this process.

    Args:
        test: the test; its pacing is lockstep.
        out: folder that gets ``bag``, ``rig.yaml`` and ``run.json``; None = a temporary one.
        device: what takes the place of the simulated rig of the test; its blocks must be as those of that rig.
        loop_values: parameters of the loop that differ from the plan's and of which the bag says nothing.
        record: whether a bag is written.
        extract: whether modal points are extracted.
        listener: told of every message, in order.
        timed: whether ``spent`` is counted; asking the clock costs a fifth of a short block's time.

    Attributes:
        plan: parameters of every node, and the run's description of itself.
        spent: process time in s spent in ``plant``, ``loop``, ``record`` and ``extract``; zeros unless ``timed``.
        blocks: blocks the device has given, by bench time.

    Raises:
        BenchError: the test or a setting is refused.
    """

    def __init__(
        self,
        test: TestPlan,
        out: Path | str | None = None,
        *,
        device: Device | None = None,
        loop_values: Mapping[str, Any] | None = None,
        record: bool = True,
        extract: bool = True,
        listener: Listener | None = None,
        timed: bool = False,
    ) -> None:
        if test.pacing != "lockstep":
            raise BenchError("A session in one process runs in lockstep; use the nodes for real time.")
        self.test = test
        self.rig = test.rig
        self.spent = dict.fromkeys(("plant", "loop", "record", "extract"), 0.0)
        self.blocks = 0
        self._clock: Callable[[], float] = time.process_time if timed else lambda: 0.0
        self._out = Path(out) if out is not None else None
        self._device = device
        self._loop_values = dict(loop_values or {})
        self._record = record
        self._extract = extract
        self._listener = listener
        self._cleanup = contextlib.ExitStack()
        self._queue: deque[tuple[str, Any]] = deque()
        self._ran = False
        self._interrupted = False
        self._description: dict[str, Any] | None = None
        # Refuses what can be refused before anything is created.
        self.plan = plan_nodes(test, Path("bag"), Path("rig.yaml"))

    def describe(self, run: Mapping[str, Any]) -> None:
        """Give the run another description of itself than the plan's, before the session is entered."""
        self._description = dict(run)

    @property
    def levels_locked(self) -> int:
        """Levels whose window is complete."""
        return sum(record.complete for record in self._sequencer.machine.records)

    # -- life ----------------------------------------------------------------------------------------------------

    def __enter__(self) -> Session:
        try:
            self._start()
        except BaseException:
            self._cleanup.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._cleanup.close()

    def _start(self) -> None:
        if self._out is None:
            self.out = Path(tempfile.mkdtemp(prefix="nmt-"))
            self._cleanup.callback(shutil.rmtree, self.out, ignore_errors=True)
        else:
            self.out = self._out
            self.out.mkdir(parents=True, exist_ok=True)
        rig_file = self.out / "rig.yaml"
        device = SimulatedRig(self.rig) if self._device is None else self._device
        made_by = SIMULATED_RIG if self._device is None else type(device).__name__
        self.plan = plan_nodes(self.test, self.out / "bag", rig_file.resolve(), made_by)
        self._plant = PlantCore(device, self.test.latency_blocks)
        self._cleanup.callback(self._plant.shut_down, "the session ends")
        self._recorder: RunRecorder | None = None
        if self._record:
            run = self._description or self.plan.run
            rig_file.write_text(self.test.rig_yaml, encoding="utf-8")
            (self.out / "run.json").write_text(json.dumps(run, indent=2) + "\n", encoding="utf-8")
            settings = replace(self.plan.recorder, run_json=json.dumps(run))
            self._recorder = RunRecorder(settings, self._bench_time_ns)
            self._cleanup.callback(self._recorder.close, "interrupted", "the session was left before its end")
        self._loop = LoopCore(with_values(self.plan.pll, self._loop_values, "pll"))
        self._sequencer = RunCore(self.plan.sequencer)
        self._extraction: ExtractionCore | None = None
        if self._extract:
            self._extraction = ExtractionCore(self.plan.extract)
        self._writers = {quantity: BlockWriter(self.rig.name) for quantity in self._plant.quantities}
        self._loop_inputs = (Quantity.FORCE, self._loop.response)

    def _bench_time_ns(self) -> int:
        return round(self._plant.device.next_sample / self._plant.device.sample_rate * 1e9)

    # -- use -----------------------------------------------------------------------------------------------------

    def run(self, on_progress: Callable[[Progress], None] | None = None) -> RunResult:
        """Work through the levels.

        Ctrl-C ramps the drive to zero and ends the run with CANCELED; an exception of a callback ramps it to zero as
        well and then goes on to the caller. The bag is closed in every case.

        Args:
            on_progress: called about ten times a second of wall time.

        Returns:
            How it ended; a lost lock or a fault of the device is a result, not an exception.

        Raises:
            BenchError: this session has run already, or the bag cannot be written.
        """
        if self._ran:
            raise BenchError("A session runs once; make a new one for another run.")
        self._ran = True
        began = time.monotonic()
        machine = self._sequencer.machine
        try:
            with self._interrupts():
                self._publish_run()  # the state before the run, as the node latches it
                self._sequencer.start(self._sequencer.plan(self.plan.goal))
                self._publish_run()
                self._pump(on_progress)
        except DeviceFault as fault:
            self._plant.device.close()
            machine.abandon(ResultCode.NODE_LOST, f"The device failed: {fault}")
            self._close("interrupted", machine.reason)
        except BaseException as error:
            self._end_early(f"{type(error).__name__}: {error}")
            raise
        else:
            self._close("done", "")
        return self._result(time.monotonic() - began)

    def stop(self) -> bool:
        """End the run early by a ramp to zero, from a callback; False if nothing is running."""
        active = self._sequencer.machine.active
        self._sequencer.steer(SteeringRequest(SteeringAct.END, source="the stop service"))
        return active

    def steer(self, request: SteeringRequest) -> str:
        """Steer the run, from a callback or a listener; what becomes of it is on the topic ``steering``.

        A session does not wait: a pause ends when nothing moves any more, unless it is resumed from a callback before.

        Returns:
            Empty, or the sentence why the run cannot be steered so.
        """
        return self._sequencer.steer(request)

    # -- messages ------------------------------------------------------------------------------------------------

    def _pump(self, on_progress: Callable[[Progress], None] | None = None) -> None:
        """Hand on messages until nothing moves any more, which is when the run is over."""
        reported = time.monotonic()
        deliver = self._deliver
        queue = self._queue
        while self._going_on():
            deliver(*queue.popleft())
            if self._interrupted and self._sequencer.machine.active:
                self._sequencer.machine.stop(ResultCode.CANCELED, "Cancelled by the client.")
            if on_progress is not None and time.monotonic() - reported >= _PROGRESS_PERIOD:
                reported = time.monotonic()
                progress = self._progress()
                if progress is not None:
                    on_progress(progress)
        machine = self._sequencer.machine
        if machine.active:
            machine.abandon(
                ResultCode.INTERNAL_ERROR, "The run came to a standstill: no drive command answers a block."
            )
            self._publish_run()
        for blocks in self._plant.quiet_down("the run is over"):
            self._publish_blocks(blocks)
        while queue:
            deliver(*queue.popleft())

    def _going_on(self) -> bool:
        """Whether there is a message to hand on; a pause is over when there is none."""
        if not self._queue and self._sequencer.machine.phase == RunPhase.PAUSED:
            self._sequencer.steer(SteeringRequest(SteeringAct.RESUME, source="the session"))
            self._publish_run()
        return bool(self._queue)

    def _deliver(self, topic: str, record: Any) -> None:
        """What the subscribers of a topic do with a message: recorder, extraction, and whom it concerns."""
        clock = self._clock
        if self._recorder is not None:
            began = clock()
            self._recorder.callback(topic)(self._raw(topic, record))
            self.spent["record"] += clock() - began
        if self._extraction is not None and topic in self._extraction.topics:
            began = clock()
            self._feed(topic, record)
            self.spent["extract"] += clock() - began
        if self._listener is not None:
            self._listener(topic, record)
        if isinstance(record, SampleBlock):
            if record.quantity in self._loop_inputs:
                self._answer(record)
        elif isinstance(record, DriveCommand):
            began = clock()
            self._plant.take_drive(record)
            self.spent["plant"] += clock() - began
            self._produce()
        elif isinstance(record, LoopStatus):
            self._sequencer.take_status(record)
            self._publish_run()
        elif isinstance(record, LockEvent):
            self._sequencer.take_lock(record)
            self._publish_run()
        elif isinstance(record, LevelCommand):
            self._queue.extend(("frequency", status) for status in self._loop.take_level(record))
        elif isinstance(record, RunState):
            self._plant.take_state(record)
            self._produce()
        elif isinstance(record, DriveStop):
            self._sequencer.take_stop(record)
            self._publish_run()
        elif isinstance(record, ModalPoint):
            self._sequencer.take_point(record)

    def _answer(self, block: SampleBlock) -> None:
        began = self._clock()
        answer = self._loop.take_block(block)
        self.spent["loop"] += self._clock() - began
        if answer is None:
            return
        self._queue.append(("drive", answer.drive))
        if answer.lock is not None:
            self._queue.append(("lock", answer.lock))
        self._queue.extend(("frequency", status) for status in answer.statuses)

    def _produce(self) -> None:
        while self._plant.due:
            began = self._clock()
            blocks = self._plant.produce()
            self.spent["plant"] += self._clock() - began
            self._publish_blocks(blocks)

    def _publish_blocks(self, blocks: Sequence[SampleBlock]) -> None:
        self.blocks += 1
        stop = self._plant.stop()
        if stop is not None:
            self._queue.append(("drive_stop", stop))
        self._queue.extend((block.quantity.topic, block) for block in blocks)
        levels = self._plant.levels(blocks)
        if levels is not None:
            self._queue.append(("monitor", levels))

    def _publish_run(self) -> None:
        self._queue.extend(("steering", act) for act in self._sequencer.acts())
        self._queue.extend(("level", level) for level in self._sequencer.orders())
        state = self._sequencer.state()
        if state is not None:
            self._queue.append(("run_state", state))

    def _feed(self, topic: str, record: Any) -> None:
        assert self._extraction is not None
        feed, extractor = self._extraction.feed, self._extraction.extractor
        if feed is None or extractor is None:
            return
        if isinstance(record, SampleBlock):
            extractor.add_block(topic, record)
        elif isinstance(record, LoopStatus):
            feed.add_status(record)
        elif isinstance(record, LockEvent):
            feed.add_lock(record)
        else:
            feed.add_level(record)
        self._queue.extend(("modal_point", point) for point in self._extraction.points())

    def _raw(self, topic: str, record: Any) -> bytes:
        if isinstance(record, SampleBlock):
            return self._writers[record.quantity].write(record)
        if isinstance(record, DriveCommand):
            return write_drive(record, self._loop.sample_rate)
        if isinstance(record, LoopStatus):
            return write_status(record, self._loop.sample_rate)
        raw: bytes = _CODECS[topic].write(record)
        return raw

    # -- the end -------------------------------------------------------------------------------------------------

    def _end_early(self, reason: str) -> None:
        """After an error: ramp the drive to zero, record the ramp, close the bag; never raises."""
        self._listener = None
        with contextlib.suppress(Exception):
            self._sequencer.machine.stop(ResultCode.INTERNAL_ERROR, reason)
            self._publish_run()
            self._pump()
        self._close("interrupted", reason)

    def _close(self, exit_state: str, reason: str) -> None:
        if self._recorder is not None:
            self._recorder.close(exit_state, reason)

    def _result(self, wall_time: float) -> RunResult:
        machine = self._sequencer.machine
        points = self._sequencer.points
        remarks: list[str] = []
        if self._recorder is not None:
            gaps, writer = self._recorder.gaps, self._recorder.writer
            remarks.append(
                f"Recorded {writer.messages} messages; gaps {gaps.gaps}, missing samples {gaps.missing_samples}."
            )
        if self._plant.device.tripped:
            remarks.append(f"Plant: {self._plant.device.tripped}.")
        return RunResult(
            code=machine.code,
            message=with_cause(machine.reason, self._plant.device.tripped),
            points=tuple(points[index] for index in sorted(points)),
            bag=None if self._recorder is None else self._recorder.writer.path,
            bag_state="" if self._recorder is None else self._recorder.writer.state,
            wall_time=wall_time,
            bench_time=(machine.newest + 1) / float(self.rig.sample_rate_hz),
            interrupted=self._interrupted,
            remarks=tuple(remarks),
        )

    def _progress(self) -> Progress | None:
        machine = self._sequencer.machine
        report = machine.report
        if report is None or machine.plan is None:
            return None
        shown = machine.reported
        return Progress(
            level_index=0 if shown is None else shown.index,
            level_count=len(machine.plan.levels),
            level=0.0 if shown is None else shown.amplitude,
            state=report.state,
            frequency_hz=report.frequency_hz,
            phase_error=report.phase_error,
            fraction_done=float(machine.progress),
            sample=machine.newest,
        )

    @contextlib.contextmanager
    def _interrupts(self) -> Iterator[None]:
        """Take note of Ctrl-C between two messages instead of in the middle of one; a second one ends at once."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def on_signal(number: int, frame: Any) -> None:
            if self._interrupted:
                raise KeyboardInterrupt
            self._interrupted = True

        before = signal.signal(signal.SIGINT, on_signal)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
