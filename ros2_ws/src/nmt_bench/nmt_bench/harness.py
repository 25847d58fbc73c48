"""Launch-free harness: the bench's nodes on a private domain, started, driven and cleaned up from Python.

>>> from nmt_bench.harness import Bench
>>> with Bench("beam", levels=[0.1, 0.5], window_periods=20) as bench:
...     result = bench.run()
>>> round(result.points[0].damping_ratio, 4)
0.0051

Nodes live in this process (fast, one thread) or each in a process of its own (as on a lab PC). Leaving the ``with``
block ends them whatever happened; no process and, without ``out``, no file stays behind.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Unpack

import rclpy
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

from nmt_bench.orchestration.bench_domain import BenchDomain, bench_environment
from nmt_bench.orchestration.interrupts import deferred_interrupts, unbroken
from nmt_bench.orchestration.node_processes import NodeProcesses
from nmt_bench.orchestration.prepared_nodes import NodeLoader, take_loader
from nmt_bench.orchestration.run_client_node import RESEND, RunClient
from nmt_bench.orchestration.surroundings import check_surroundings
from nmt_core.dds_profile import PROFILE_VARIABLE, lockstep_profile
from nmt_core.errors import BenchError
from nmt_core.files.whole_file import write_whole
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.wire import MODAL_POINT
from nmt_core.nodes.link import Link, serve
from nmt_core.nodes.liveness import HANG_LIMIT
from nmt_core.nodes.transport import LINK_PERIOD
from nmt_core.processes.memory import calm_collector
from nmt_core.processes.output_record import drive_sentence
from nmt_core.text.number_words import level_list
from nmt_core.vocabulary import ResultCode
from nmt_msgs.srv import Steer
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import Rig
from nmt_sequencer.steering import SteeringRequest
from nmt_session.node_plan import NODES, NodePlan, plan_nodes
from nmt_session.planning import TestSettings, plan_test
from nmt_session.run_result import Progress, RunResult, with_cause

START_TIMEOUT = 120.0  # s; on a busy computer the plant compiles and loads for a minute
_POLL = 0.02
_RESEND = RESEND
_NO_RAMP = 1.5  # s without work after which nodes are hurried where no ramp to zero can come
_STILL = HANG_LIMIT + 15.0  # s without progress of the recorder after which its bag stays open
_NOTE_AFTER = 5.0  # s that a run is held up, or the recorder writes on, before it is said, and between two notes
_LAST_WRITES = 0.5  # s that the recorder gets for what is on its way to it
_LATE_DEATH = 1.5  # s after a result of a lost node in which that may be seen here, too


class Bench:
    """The nodes of one test.

    Args:
        rig, levels, settings: as of :func:`nmt_session.planning.plan_test`.
        out: folder that gets ``bag``, ``rig.yaml``, ``run.json`` and the nodes' logs; None = a temporary one.
        processes: each node its own process.
        domain_id: ROS domain; None = any that no other bench uses.

    Raises:
        BenchError: the rig, the levels or a setting is refused; nothing has been started then.
    """

    def __init__(
        self,
        rig: str | Path | Rig,
        levels: Sequence[float] | str | None = None,
        *,
        out: Path | str | None = None,
        processes: bool = False,
        domain_id: int | None = None,
        **settings: Unpack[TestSettings],
    ) -> None:
        self.test = plan_test(rig, levels, **settings)
        self.rig = self.test.rig
        self.use_processes = processes
        self._out = Path(out) if out is not None else None
        self._domain_id = domain_id
        self._cleanup = contextlib.ExitStack()
        self.nodes: dict[str, Any] = {}
        self._links: list[Link] = []
        self.processes: NodeProcesses | None = None
        self._goal_handle: Any = None
        self._ran = False
        # Refuses what can be refused before anything is created.
        self.plan: NodePlan = plan_nodes(self.test, Path("bag"), Path("rig.yaml"))

    # -- life ----------------------------------------------------------------------------------------------------

    def __enter__(self) -> Bench:
        try:
            self._start()
        except BaseException:
            with deferred_interrupts(patient=True):
                self._cleanup.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._goal_handle is not None and kind is not None:
                with contextlib.suppress(Exception):
                    self.stop()
        finally:
            with deferred_interrupts(patient=True):
                self._cleanup.close()

    def _start(self) -> None:
        loader: NodeLoader | None = None
        if self.use_processes:
            loader = take_loader()  # before all else: it imports meanwhile
            if loader is not None:
                self._cleanup.callback(loader.close)
        if self._out is None:
            check_surroundings(Path(tempfile.gettempdir()) / "nmt")
            self.out = Path(tempfile.mkdtemp(prefix="nmt-"))
            self._cleanup.callback(shutil.rmtree, self.out, ignore_errors=True)
        else:
            self.out = self._out
            check_surroundings(self.out)
            self.out.mkdir(parents=True, exist_ok=True)
        domain = BenchDomain(self._domain_id)
        self._cleanup.callback(domain.close)
        self.domain_id = domain.id
        environment = bench_environment(domain.id)
        self._cleanup.callback(_restore_environment, {name: os.environ.get(name) for name in environment})
        os.environ.update(environment)

        rig_file = self.out / "rig.yaml"
        rig_file.write_text(self.test.rig_yaml, encoding="utf-8")
        self.plan = plan_nodes(self.test, self.out / "bag", rig_file.resolve(), self.test.device_name)
        (self.out / "run.json").write_text(json.dumps(self.plan.run, indent=2) + "\n", encoding="utf-8")

        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain.id, signal_handler_options=SignalHandlerOptions.NO)
        self._cleanup.callback(rclpy.try_shutdown, context=self.context)
        self.executor = EventsExecutor(context=self.context)
        self._cleanup.callback(self.executor.shutdown)
        if self.use_processes:
            if self.test.pacing == "lockstep":
                profile = self.out / "log" / "fastdds.xml"
                profile.parent.mkdir(exist_ok=True)
                profile.write_text(lockstep_profile(), encoding="utf-8")
                environment[PROFILE_VARIABLE] = str(profile.resolve())
            quiet = 0.0 if self.rig.device is None else self.rig.device.quiet_s
            self.processes = NodeProcesses(self.plan, self.out, environment, loader, domain.descriptor, quiet)
            self._cleanup.callback(self.processes.end)
            self.processes.start()
        else:
            for name, (_, _, where) in NODES.items():
                module, _, attribute = where.partition(":")
                kind = getattr(importlib.import_module(module), attribute)
                node = kind(self.plan.settings[name], context=self.context)
                self.add_node(name, node)
        self.client = RunClient(self.context, tuple(self.plan.settings), self.test.pacing == "lockstep")
        self.add_node("client", self.client)
        thresholds = gc.get_threshold()
        # A collection would look at all that the program around the bench holds, a fifth of a second in a large one.
        # What is garbage by now is freed after the bench.
        calm_collector(collect=False)
        self._cleanup.callback(gc.set_threshold, *thresholds)
        self._cleanup.callback(gc.unfreeze)

    def add_node(self, name: str, node: Node) -> None:
        """Let a node of this process work with those of the bench; it ends with them."""
        self.nodes[name] = node
        self.executor.add_node(node)
        link = getattr(node, "link", None)
        if link is not None:
            self._links.append(link)
        self._cleanup.callback(self._remove, node)

    def _remove(self, node: Node) -> None:
        if getattr(node, "link", None) in self._links:
            self._links.remove(node.link)
        self.executor.remove_node(node)
        shut_down = getattr(node, "shut_down", None)
        if shut_down is not None:
            shut_down()
        node.destroy_node()

    # -- use -----------------------------------------------------------------------------------------------------

    def run(
        self, on_progress: Callable[[Progress], None] | None = None, on_note: Callable[[str], None] | None = None
    ) -> RunResult:
        """Work through the levels.

        Args:
            on_progress: called about ten times a second.
            on_note: told in a sentence what holds the run up for long.

        Returns:
            How it ended; a lost lock or a dead node is a result, not an exception.

        Raises:
            BenchError: the nodes did not come up, or this bench has run already.
        """
        if self._ran:
            raise BenchError("A bench runs once; make a new one for another run.")
        self._ran = True
        self._tell = on_note or (lambda sentence: None)
        self.spin_until(lambda: self.client.server_is_ready(), START_TIMEOUT, "the sequencer's action server")
        self.spin_until(
            lambda: not self.client.liveness.unheard, START_TIMEOUT, "the first heartbeat of every node of the bench"
        )
        handle = self._send_goal(on_progress)
        if not handle.accepted:
            raise BenchError("The sequencer refused the plan; its log says why.")
        self._goal_handle = handle
        began = time.monotonic()
        try:
            message, lost, interrupted = self._await_result(handle)
        finally:
            self._goal_handle = None
        if message is not None and message.result_code == ResultCode.NODE_LOST and not lost:
            lost = self._late_death()
        wall_time = max(0.0, (self.client.last_progress or time.monotonic()) - (self.client.started or began))
        points: tuple[ModalPoint, ...] = ()
        with deferred_interrupts() as deferred:
            if lost and lost != "plant":
                self.spin_while(lambda: not self.client.drive_is_at_zero, 3.0)
            obituary = self._obituary(lost)  # before the remaining nodes are ended
            bag_state, lacks = self._await_bag(lost)
            if message is not None and message.result_code == ResultCode.LIMIT:
                # The plant's next heartbeat says which.
                self.spin_while(lambda: not self.client.plant_said.get("tripped"), 1.0)
        if message is None:
            code, text = ResultCode.NODE_LOST, obituary
            points = self._recorded_points()
        else:
            code = ResultCode(message.result_code)
            text = with_cause(message.message, self.client.plant_said.get("tripped", ""))
            points = tuple(MODAL_POINT.read(serialize_message(point)) for point in message.points)
            if lost:
                code, text = ResultCode.NODE_LOST, obituary
        missing: tuple[int, ...] = ()
        trouble = ""
        if message is None or lost or message.missing_points:
            named = () if message is None else message.missing_points
            points, missing, trouble = self._with_windows_of_bag(points, named)
        if missing or trouble:
            found = {point.level_index for point in points}.intersection(missing)
            text = f"{text} {_extracted_later(missing, found, trouble)}".strip()
        lack = f"The bag lacks {lacks:.3f} s of bench time, at its end or in gaps; what is in it can be extracted."
        result = RunResult(
            code=code,
            message=text,
            points=points,
            bag=self.out / "bag",
            bag_state=bag_state,
            wall_time=wall_time,
            bench_time=self._bench_time,
            lost_node=lost,
            interrupted=interrupted or deferred.came,
            remarks=(*([lack] if lacks > 0.0 else []), *self.client.remarks(self.test.pacing)),
            lacks_s=lacks,
            missing=missing,
        )
        self._write_end(result)
        return result

    def _write_end(self, result: RunResult) -> None:
        """Put into run.json how the run ended and what its bag lacks."""
        end = {
            "code": result.code.name,
            "message": result.message,
            "bench_time_s": result.bench_time,
            "bag": {"state": result.bag_state, "lacks_s": result.lacks_s},
            "points": {
                "count": len(result.points),
                "not_live": [index + 1 for index in result.missing],
            },
        }
        text = json.dumps({**self.plan.run, "result": end}, indent=2) + "\n"
        with contextlib.suppress(OSError):  # a full disk must not cost the result
            write_whole(self.out / "run.json", text)

    def stop(self) -> bool:
        """End the run early by a ramp to zero; False if nothing was running."""
        return self._call("stop")

    def pause(self) -> bool:
        """Hold the present level; False if no run can be paused."""
        return self._call("pause")

    def resume(self) -> bool:
        """Go on after a pause; False if nothing is paused."""
        return self._call("resume")

    def ask_to_steer(self, request: SteeringRequest) -> Any:
        """Ask the sequencer to steer the run, without waiting: for callbacks of :meth:`run`.

        Returns:
            A future of the answer of ``nmt_msgs/Steer``: ``success``, and ``message``, one sentence.

        Raises:
            BenchError: the sequencer's service is not there.
        """
        if not self.client.steer.service_is_ready():
            raise BenchError("The sequencer does not answer to 'steer'; it may have died.")
        return self.client.steer.call_async(Steer.Request(**request.fields))

    def cancel(self) -> None:
        """Cancel the goal without waiting; :meth:`run` returns when the drive is at zero."""
        if self._goal_handle is not None:
            self._goal_handle.cancel_goal_async()

    def spin(self, seconds: float) -> None:
        """Let in-process nodes work for a while of wall time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.work(Future(), min(0.1, max(0.0, end - time.monotonic())))

    # -- waiting -------------------------------------------------------------------------------------------------

    def turn(self) -> None:
        """Let the executor work for a moment; a signal that breaks into its conversions would end as a TypeError."""
        with unbroken():
            if self._links:
                self.work(Future(), LINK_PERIOD)
            else:
                self.executor.spin_once(timeout_sec=_POLL)

    def work(self, future: Future, seconds: float) -> None:
        """Let in-process nodes work until a future is done, for some seconds at most."""
        end = time.monotonic() + seconds
        while self._links and not future.done() and time.monotonic() < end:
            serve(self._links, min(LINK_PERIOD, seconds))
            self.executor.spin_until_future_complete(future, timeout_sec=0.0)
        if not self._links:
            # spin_once serves no timers while no message comes.
            self.executor.spin_until_future_complete(future, timeout_sec=seconds)

    def _call(self, service: str) -> bool:
        client = self.client.create_client(Trigger, service)
        try:
            self.spin_until(client.service_is_ready, 5.0, f"the service '{service}'")
            answer = self.wait_for(client.call_async(Trigger.Request()), 5.0, f"the service '{service}'")
            return bool(answer.success)
        finally:
            self.client.destroy_client(client)

    def _send_goal(self, on_progress: Callable[[Progress], None] | None) -> Any:
        """Handle of the goal once it is answered.

        Raises:
            BenchError: no answer comes, or a node ended.
        """

        def turn() -> None:
            self._check_start()
            self.turn()

        handle = self.client.begin(self.plan.goal, on_progress, turn, START_TIMEOUT, _RESEND)
        if handle is None:
            logs = self.out / "log"
            raise BenchError(
                f"Waited {START_TIMEOUT:g} s in vain for the goal's answer; the logs in {logs} may say why."
            )
        return handle

    def spin_until(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        """Let in-process nodes work until something is so.

        Args:
            done: whether it is.
            timeout: s of wall time.
            what: is waited for, for the error.

        Raises:
            BenchError: it did not come within the time, or a node ended.
        """
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() > end:
                logs = self.out / "log"
                raise BenchError(f"Waited {timeout:g} s in vain for {what}; the logs in {logs} may say why.")
            self._check_start()
            self.turn()

    def wait_for(self, future: Any, timeout: float, what: str) -> Any:
        """Result of a future; arguments and errors as of :meth:`spin_until`."""
        self.spin_until(future.done, timeout, what)
        return future.result()

    def _check_start(self) -> None:
        dead = self.processes.first_dead() if self.processes else ""
        if dead:
            raise BenchError(f"Node {dead} ended at once{self._last_words(dead)}.")
        stuck = self.processes.not_coming_up(self.client.liveness.unheard) if self.processes else ""
        if stuck:
            raise BenchError(stuck)

    def _await_result(self, handle: Any) -> tuple[Any, str, bool]:
        """The action's result (None if the sequencer is lost), the name of a lost node, and whether Ctrl-C came."""
        future = handle.get_result_async()
        lost, deadline, interrupted = "", math.inf, False
        asked = noted = time.monotonic()
        while not future.done():
            try:
                if self.use_processes:
                    self.turn()
                else:
                    self.work(future, 0.2)
            except KeyboardInterrupt:
                if interrupted:
                    raise
                interrupted = True
                self.cancel()
            now = time.monotonic()
            noted = self._note_what_holds_up(now, noted)
            gone = self._lost_node(now)
            if gone and not lost:
                lost = gone
                deadline = now + (2.0 if lost == "sequencer" else 15.0)
                self.cancel()
            if now > deadline:
                return None, lost, interrupted
            if self.client.run_is_over and now - asked > _RESEND:
                asked, future = now, handle.get_result_async()
        return future.result().result, lost, interrupted

    def _lost_node(self, now: float) -> str:
        """Name of a node whose process has ended, or which gives no sign of life; empty if all are well."""
        if self.processes is None:
            return ""
        self.client.liveness.listened(now)
        return self.processes.first_dead() or next(iter(self.client.liveness.lost(now)), "")

    def _note_what_holds_up(self, now: float, noted: float) -> float:
        """Say which node the run waits for, if it does for long; when that was said last."""
        if now - max(noted, self.client.last_progress or now) < _NOTE_AFTER:
            return noted
        held_up = self.client.liveness.waited_for(now)
        for name, why in held_up.items():
            self._tell(f"The run waits for node {name}, which {why}; Ctrl-C ends it.")
        if self.client.run_is_over and not held_up:
            taken = self.client.taken / self.rig.sample_rate_hz
            self._tell(f"Extraction works on: {taken:.1f} of {self._bench_time:.1f} s are extracted.")
        return now

    def _late_death(self) -> str:
        """Name of a node that is seen to be lost only after the run that it broke; empty if none is."""
        end = time.monotonic() + _LATE_DEATH
        while self.processes is not None and time.monotonic() < end:
            lost = self._lost_node(time.monotonic())
            if lost:
                return lost
            self.turn()
        return ""

    def _recorded_points(self) -> tuple[ModalPoint, ...]:
        """The modal points in the bag, where the result of the action is lost."""
        with contextlib.suppress(BenchError):
            return tuple(Bag.open(self.out / "bag").records("modal_point", MODAL_POINT))
        return ()

    def _with_windows_of_bag(
        self, points: tuple[ModalPoint, ...], named: Sequence[int]
    ) -> tuple[tuple[ModalPoint, ...], tuple[int, ...], str]:
        """Points with those that extraction did not send, extracted from the bag.

        Returns:
            The points; the levels that extraction did not send; what failed with the bag, as a clause.

        Args:
            points: those that it sent.
            named: levels of which it is known that it did not.
        """
        from nmt_extract.offline import extract_bag

        if not self.test.kind.gives_modal_points:
            return points, (), ""
        known = {point.level_index for point in points}
        try:
            found = extract_bag(self.out / "bag").points
        except BenchError:  # without a lock event, or without a whole message
            return points, tuple(sorted(named)), ""
        except Exception as error:  # what ended the node may end this as well; the points that came are not lost for it
            return points, tuple(sorted(named)), f"{type(error).__name__}: {str(error).rstrip('.')}"
        missing = [point for point in found if point.level_index not in known]
        both = sorted([*points, *missing], key=lambda point: point.level_index)
        return tuple(both), tuple(sorted({*named, *(point.level_index for point in missing)})), ""

    def _obituary(self, lost: str) -> str:
        said = self.client.plant_said
        drive = drive_sentence(said or None, alive=lost != "plant", lockstep=self.test.pacing == "lockstep")
        if self.processes is not None and self.processes.is_alive(lost):
            lockstep = self.test.pacing == "lockstep"
            how = "hangs" if lockstep else "gives no sign of life (it is stopped or hangs)"
            return f"Node {lost} {how}; the run was ended and {drive}."
        return f"Node {lost} has died{self._last_words(lost)}; the run was ended and {drive}."

    def _await_bag(self, lost: str) -> tuple[str, float]:
        """Wait until all that was sent is in the bag; its state, and the bench time that it lacks, s."""
        client = self.client
        stands_still = lost == "plant" and self.test.pacing == "lockstep"
        if (lost == "sequencer" or stands_still) and self.processes is not None:
            # The recorder does not know that the run is over: wait for the plant's own ramp, then end all nodes.
            self.spin_while(lambda: not (client.drive_is_at_zero or stands_still), 10.0)
            self.spin(_LAST_WRITES)
            self.processes.end(*([_NO_RAMP] if stands_still else []))
        begun = moved = time.monotonic()
        written = client.recorded
        ended = ("recorder", "sequencer", "plant") if stands_still else ("recorder", "sequencer")
        while client.bag.state == "open" and lost not in ended and time.monotonic() - moved < _STILL:
            self.turn()
            lost = lost or self._lost_node(time.monotonic())
            if client.recorded != written:
                written, moved = client.recorded, time.monotonic()
                if moved - begun > _NOTE_AFTER:
                    begun = moved
                    self._tell(f"The recorder writes on: {written[1]} of {self._bench_time:.1f} s are in the bag.")
        bag = self.out / "bag"
        if client.bag.state == "failed" or (bag / "metadata.yaml").exists():
            closed = "failed" if client.bag.state == "failed" else "closed"
            if lost not in ended:
                return closed, client.bag.lacks_s
        else:
            closed = "open"
        with contextlib.suppress(BenchError):
            return closed, max(0.0, round(self._bench_time - Bag.open(bag).end_time_s, 6))
        return closed, self._bench_time

    @property
    def _bench_time(self) -> float:
        """Bench time that the sequencer has told of, s."""
        return (self.client.newest_sample + 1) / self.rig.sample_rate_hz

    def spin_while(self, condition: Callable[[], bool], timeout: float) -> None:
        """Let in-process nodes work while something is so, for some seconds at most."""
        end = time.monotonic() + timeout
        while condition() and time.monotonic() < end:
            self.turn()

    def _last_words(self, name: str) -> str:
        words = self.processes.last_words(name) if self.processes and name else ""
        return f" ({words})" if words else ""


def _extracted_later(missing: Sequence[int], found: Collection[int], trouble: str) -> str:
    """What was done about points that did not come live, as sentences; ``trouble``: why the bag could not be read."""
    if trouble:
        whose = f"{level_list(missing)} " if missing else ""
        return f"Extraction of {whose}from the bag failed, too ({trouble}); what was measured is in the bag."
    lacking = [index for index in missing if index not in found]
    text = f"The points of {level_list(found)} were extracted from the bag." if found else ""
    more = f"The bag gives none for {level_list(lacking)}." if lacking else ""
    return " ".join(filter(None, (text, more)))


def _restore_environment(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
