"""Launch-free harness: the bench's nodes on a private domain, started, driven and cleaned up from Python.

>>> from nmt_bench.harness import Bench
>>> with Bench("beam", levels=[0.1, 0.5], window_periods=20) as bench:      # doctest: +SKIP
...     result = bench.run()
...     result.points[0].damping_ratio

Nodes live in this process (fast, one thread) or each in a process of its own (as on a lab PC). Leaving the ``with``
block ends them whatever happened; no process, no shared memory and, without ``out``, no file stays behind.
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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import Trigger

from nmt_bench.orchestration.bench_domain import BenchDomain, bench_environment
from nmt_bench.orchestration.node_processes import NodeProcesses
from nmt_bench.orchestration.shared_memory import remove_dead_segments
from nmt_core.base_node import STATE_QOS, calm_collector
from nmt_core.errors import BenchError
from nmt_core.linear_description import LinearDescription
from nmt_core.modal_point import ModalPoint
from nmt_core.vocabulary import ResultCode, RunPhase
from nmt_core.wire import MODAL_POINT, RUN_STATE
from nmt_msgs.action import RunLevels
from nmt_msgs.msg import RunState
from nmt_rig.rig import Rig
from nmt_session.node_plan import NODES, NodePlan, plan_nodes
from nmt_session.plan_test import plan_test
from nmt_session.run_result import Progress, RunResult

START_TIMEOUT = 60.0
_POLL = 0.02
_LAST_WRITES = 0.5  # s that the recorder gets for what is on its way to it


class Bench:
    """The nodes of one test.

    Args:
        rig: name of a rig that comes with the bench, path of a rig file, or a loaded rig.
        levels: drive amplitudes in V, the notation of ``--levels``, or None for the rig's own.
        out: folder that gets ``bag``, ``rig.yaml``, ``run.json`` and the nodes' logs; None = a temporary one.
        processes: each node its own process.
        overrides: ``key=value`` texts applied to the rig file.
        exciter: drive point; None = the rig's own.
        seed: seed of all noise; None = the rig's own.
        pacing: ``lockstep`` or ``realtime``.
        latency_blocks: blocks of buffering between command and excitation.
        window_periods, ramp, timeout: None = the rig's own; periods, s, s.
        stop_on_lost_lock: end at the first level that does not lock.
        run_id: name of the run; None = from the clock.
        linear: linear description for loop and extraction; None = from the rig's model.
        domain_id: ROS domain; None = any that no other bench uses.
        node_values: further parameters by node name.
        control: what the levels are: ``voltage`` (V), ``response`` (m or m/s²) or ``force`` (N).
        strategy: ``stepped`` or ``ramp``, see :class:`nmt_session.node_plan.TestPlan`.
        test, frequencies_hz, band_hz, rate_hz_s, frequency_end_hz, duration: kind of test and its settings, see there.
            A stepped sine with several frequencies and one level is run at that level at each of them.

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
        overrides: Sequence[str] = (),
        exciter: int | None = None,
        seed: int | None = None,
        pacing: str = "lockstep",
        latency_blocks: int = 0,
        window_periods: int | None = None,
        ramp: float | None = None,
        timeout: float | None = None,
        stop_on_lost_lock: bool = False,
        run_id: str | None = None,
        linear: LinearDescription | None = None,
        domain_id: int | None = None,
        node_values: Mapping[str, Mapping[str, Any]] | None = None,
        control: str = "voltage",
        strategy: str = "stepped",
        test: str = "phase_resonance",
        frequencies_hz: Sequence[float] = (),
        band_hz: tuple[float, float] | None = None,
        rate_hz_s: float = 0.0,
        frequency_end_hz: float = 0.0,
        duration: float = 0.0,
    ) -> None:
        self.test = plan_test(
            rig,
            levels,
            overrides=overrides,
            exciter=exciter,
            seed=seed,
            pacing=pacing,
            latency_blocks=latency_blocks,
            window_periods=window_periods,
            ramp=ramp,
            timeout=timeout,
            stop_on_lost_lock=stop_on_lost_lock,
            run_id=run_id,
            linear=linear,
            node_values=node_values,
            control=control,
            strategy=strategy,
            test=test,
            frequencies_hz=frequencies_hz,
            band_hz=band_hz,
            rate_hz_s=rate_hz_s,
            frequency_end_hz=frequency_end_hz,
            duration=duration,
        )
        self.rig = self.test.rig
        self.use_processes = processes
        self._out = Path(out) if out is not None else None
        self._domain_id = domain_id
        self._cleanup = contextlib.ExitStack()
        self.nodes: dict[str, Any] = {}
        self.processes: NodeProcesses | None = None
        self._goal_handle: Any = None
        self._ran = False
        # Refuses what can be refused before anything is created.
        self._dry = plan_nodes(self.test, Path("bag"), Path("rig.yaml"))

    # -- life ----------------------------------------------------------------------------------------------------

    def __enter__(self) -> Bench:
        try:
            self._start()
        except BaseException:
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
            self._cleanup.close()

    def _start(self) -> None:
        if self._out is None:
            self.out = Path(tempfile.mkdtemp(prefix="nmt-"))
            self._cleanup.callback(shutil.rmtree, self.out, ignore_errors=True)
        else:
            self.out = self._out
            self.out.mkdir(parents=True, exist_ok=True)
        if self.use_processes:
            self._cleanup.callback(remove_dead_segments)
        domain = BenchDomain(self._domain_id)
        self._cleanup.callback(domain.close)
        self.domain_id = domain.id
        environment = bench_environment(domain.id)
        self._cleanup.callback(_restore_environment, {name: os.environ.get(name) for name in environment})
        os.environ.update(environment)

        rig_file = self.out / "rig.yaml"
        rig_file.write_text(self.test.rig_yaml, encoding="utf-8")
        self.plan: NodePlan = plan_nodes(self.test, self.out / "bag", rig_file.resolve())
        (self.out / "run.json").write_text(json.dumps(self.plan.run, indent=2) + "\n", encoding="utf-8")

        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain.id, signal_handler_options=SignalHandlerOptions.NO)
        self._cleanup.callback(self._shut_context)
        self.executor = EventsExecutor(context=self.context)
        self._cleanup.callback(self._shut_executor)
        if self.use_processes:
            self.processes = NodeProcesses(self.plan, self.out, environment)
            self._cleanup.callback(self.processes.end)
            self.processes.start()
        else:
            for name, (_, _, where) in NODES.items():
                module, _, attribute = where.partition(":")
                kind = getattr(importlib.import_module(module), attribute)
                node = kind(values=self.plan.values[name], context=self.context)
                self._add(name, node)
        self.client = _RunClient(self.context)
        self._add("client", self.client)
        thresholds = gc.get_threshold()
        calm_collector()
        self._cleanup.callback(gc.set_threshold, *thresholds)
        self._cleanup.callback(gc.unfreeze)

    def _add(self, name: str, node: Node) -> None:
        self.nodes[name] = node
        self.executor.add_node(node)
        self._cleanup.callback(self._remove, node)

    def _remove(self, node: Node) -> None:
        self.executor.remove_node(node)
        shut_down = getattr(node, "shut_down", None)
        if shut_down is not None:
            shut_down()
        node.destroy_node()

    def _shut_executor(self) -> None:
        self.executor.shutdown()

    def _shut_context(self) -> None:
        rclpy.try_shutdown(context=self.context)

    # -- use -----------------------------------------------------------------------------------------------------

    def run(self, on_progress: Callable[[Progress], None] | None = None) -> RunResult:
        """Work through the levels.

        Args:
            on_progress: called about ten times a second.

        Returns:
            How it ended; a lost lock or a dead node is a result, not an exception.

        Raises:
            BenchError: the nodes did not come up, or this bench has run already.
        """
        if self._ran:
            raise BenchError("A bench runs once; make a new one for another run.")
        self._ran = True
        self._spin_until(lambda: self.client.server_is_ready(), START_TIMEOUT, "the sequencer's action server")
        handle = self._await(self.client.send_goal(self.plan.goal, on_progress), START_TIMEOUT, "the goal's answer")
        if not handle.accepted:
            raise BenchError("The sequencer refused the plan; its log says why.")
        self._goal_handle = handle
        began = time.monotonic()
        try:
            message, lost, interrupted = self._await_result(handle.get_result_async())
        finally:
            self._goal_handle = None
        wall_time = max(0.0, (self.client.last_progress or time.monotonic()) - (self.client.started or began))
        bag_state = self._await_bag(lost)
        if message is not None and message.result_code == ResultCode.LIMIT:
            self._spin_while(lambda: not self.client.plant_trip, 1.0)  # the plant's next heartbeat says which
        points: tuple[ModalPoint, ...] = ()
        if message is None:
            code, text = ResultCode.NODE_LOST, self._obituary(lost)
        else:
            code, text = ResultCode(message.result_code), message.message
            points = tuple(MODAL_POINT.read(serialize_message(point)) for point in message.points)
            if lost:
                code, text = ResultCode.NODE_LOST, self._obituary(lost)
        return RunResult(
            code=code,
            message=text,
            points=points,
            bag=self.out / "bag",
            bag_state=bag_state,
            wall_time=wall_time,
            bench_time=(self.client.newest_sample + 1) / self.rig.sample_rate_hz,
            lost_node=lost,
            interrupted=interrupted,
            remarks=tuple(self.client.remarks(self.test.pacing)),
        )

    def stop(self) -> bool:
        """End the run early by a ramp to zero; False if nothing was running."""
        return self._call("stop")

    def pause(self) -> bool:
        """Hold the present level; False if no run can be paused."""
        return self._call("pause")

    def resume(self) -> bool:
        """Go on after a pause; False if nothing is paused."""
        return self._call("resume")

    def cancel(self) -> None:
        """Cancel the goal without waiting; :meth:`run` returns when the drive is at zero."""
        if self._goal_handle is not None:
            self._goal_handle.cancel_goal_async()

    def spin(self, seconds: float) -> None:
        """Let in-process nodes work for a while of wall time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=min(_POLL, max(0.0, end - time.monotonic())))

    # -- waiting -------------------------------------------------------------------------------------------------

    def _call(self, service: str) -> bool:
        client = self.client.create_client(Trigger, service)
        try:
            self._spin_until(client.service_is_ready, 5.0, f"the service '{service}'")
            answer = self._await(client.call_async(Trigger.Request()), 5.0, f"the service '{service}'")
            return bool(answer.success)
        finally:
            self.client.destroy_client(client)

    def _spin_until(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() > end:
                logs = self.out / "log"
                raise BenchError(f"Waited {timeout:g} s in vain for {what}; the logs in {logs} may say why.")
            self._check_start()
            self.executor.spin_once(timeout_sec=_POLL)

    def _await(self, future: Any, timeout: float, what: str) -> Any:
        self._spin_until(future.done, timeout, what)
        return future.result()

    def _check_start(self) -> None:
        dead = self.processes.first_dead() if self.processes else ""
        if dead:
            raise BenchError(f"Node {dead} ended at once{self._last_words(dead)}.")

    def _await_result(self, future: Any) -> tuple[Any, str, bool]:
        """The action's result (None if the sequencer died), the name of a node that died, and whether Ctrl-C came."""
        lost, deadline, interrupted = "", math.inf, False
        while not future.done():
            try:
                if self.use_processes:
                    self.executor.spin_once(timeout_sec=_POLL)
                else:
                    self.executor.spin_until_future_complete(future, timeout_sec=0.2)
            except KeyboardInterrupt:
                if interrupted:
                    raise
                interrupted = True
                self.cancel()
            dead = self.processes.first_dead() if self.processes else ""
            if dead and not lost:
                lost = dead
                deadline = time.monotonic() + (2.0 if lost == "sequencer" else 15.0)
                self.cancel()
            if time.monotonic() > deadline:
                return None, lost, interrupted
        return future.result().result, lost, interrupted

    def _obituary(self, lost: str) -> str:
        drive = "the plant's output ended with it" if lost == "plant" else "the drive was taken to zero"
        return f"Node {lost} has died{self._last_words(lost)}; the run was ended and {drive}."

    def _await_bag(self, lost: str) -> str:
        if lost == "recorder":
            return "lost"
        if lost == "sequencer" and self.processes is not None:
            # Nobody tells the recorder that the run is over: wait for the plant's own ramp, then end all nodes.
            self._spin_while(lambda: not self.client.drive_is_at_zero, 10.0)
            self.spin(_LAST_WRITES)
            self.processes.end()
            return "closed" if (self.out / "bag" / "metadata.yaml").exists() else "open"
        self._spin_while(lambda: self.client.bag_state not in ("closed", "failed"), 10.0)
        return self.client.bag_state

    def _spin_while(self, condition: Callable[[], bool], timeout: float) -> None:
        end = time.monotonic() + timeout
        while condition() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=_POLL)

    def _last_words(self, name: str) -> str:
        words = self.processes.last_words(name) if self.processes and name else ""
        return f" ({words})" if words else ""


class _RunClient(Node):  # type: ignore[misc]
    """Action client and listener of the harness."""

    def __init__(self, context: Context) -> None:
        super().__init__("bench_client", context=context, enable_rosout=False, start_parameter_services=False)
        self._client = ActionClient(self, RunLevels, "run_levels")
        self.bag_state = "open"
        self.started: float | None = None
        self.last_progress: float | None = None
        self.newest_sample = -1
        self._counters: dict[str, dict[str, str]] = {}
        self.create_subscription(String, "bag", self._on_bag, STATE_QOS)
        self.create_subscription(RunState, "run_state", self._on_state, STATE_QOS, raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def server_is_ready(self) -> bool:
        return bool(self._client.server_is_ready())

    def send_goal(self, goal: Mapping[str, Any], on_progress: Callable[[Progress], None] | None) -> Any:
        def on_feedback(message: Any) -> None:
            if on_progress is not None:
                feedback = message.feedback
                on_progress(Progress(*(getattr(feedback, item.name) for item in fields(Progress))))

        return self._client.send_goal_async(RunLevels.Goal(**goal), feedback_callback=on_feedback)

    def _on_bag(self, message: String) -> None:
        with contextlib.suppress(ValueError, TypeError, KeyError):
            self.bag_state = json.loads(message.data)["state"]

    def _on_state(self, raw: bytes) -> None:
        try:
            state = RUN_STATE.read(raw)
        except ValueError:
            return
        now = time.monotonic()
        if state.phase == RunPhase.RUNNING:
            self.started = self.started or now
        if state.sample > self.newest_sample:
            self.newest_sample = state.sample
            self.last_progress = now

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._counters[status.name] = {item.key: item.value for item in status.values}

    @property
    def plant_trip(self) -> str:
        return self._counters.get("plant", {}).get("tripped", "")

    @property
    def drive_is_at_zero(self) -> bool:
        return self._counters.get("plant", {}).get("drive_at_zero") == "1"

    def remarks(self, pacing: str) -> list[str]:
        """Sentences on what the nodes counted."""
        plant, recorder = self._counters.get("plant", {}), self._counters.get("recorder", {})
        lines = []
        if recorder:
            lines.append(
                f"Recorded {recorder.get('messages', '?')} messages; gaps {recorder.get('gaps', '?')}, missing samples "
                f"{recorder.get('missing_samples', '?')}."
            )
        if pacing == "realtime" and "jitter_p50_ms" in plant:
            lines.append(
                f"Real time: blocks late by {plant['jitter_p50_ms']} ms (median), {plant['jitter_p99_ms']} ms (99 %), "
                f"{plant['jitter_max_ms']} ms (worst); {plant['overruns']} by more than a block; margin "
                f"{100 * float(plant['real_time_margin']):.1f} % of the block time is left."
            )
        if plant.get("tripped"):
            lines.append(f"Plant: {plant['tripped']}.")
        return lines


def _restore_environment(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
