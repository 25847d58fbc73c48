"""What every node of the bench shares: settings from parameters, quality of service, diagnostics and ``main``."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_msgs.msg import UInt64

from nmt_core.dds_profile import check_ports, seal_transport
from nmt_core.errors import BenchError
from nmt_core.messages.command_judge import CommandSource
from nmt_core.messages.run_announcement import TAKEN_TOPICS, TELL_EVERY
from nmt_core.messages.wire import NodeStatus, read_diagnostics, write_diagnostics
from nmt_core.nodes.heartbeat import HEARTBEAT_PERIOD, Heartbeat
from nmt_core.nodes.identity import Identity
from nmt_core.nodes.link import Link, serve, serve_late
from nmt_core.nodes.liveness import READY, Liveness
from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.nodes.parameters import Parameter
from nmt_core.nodes.transport import LINK_PERIOD, Outlet, Transport
from nmt_core.processes.memory import calm_collector, return_large_memory
from nmt_core.settings import parameters_of, settings_of, values_of

RCLError = rclpy_implementation.RCLError

# Reliable with KEEP_LAST loses under load at any depth; samples and commands must not be lost.
SAMPLES_QOS = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.VOLATILE
)
STATE_QOS = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


_SPIN_LIMIT = 0.1  # s; a request to end waits so long
_END_GRACE = 4.0  # s that a node gets to take its part of a run to an end
_LONGEST_WORK = 10.0  # s that a node gets in real time while it still works off what it was sent
_HURRY = 1.0  # s after which a second request to end is not the echo of the first
_INSTANCES = itertools.count(1)
_LOOK_BEATS = 4  # heartbeats between two looks of a node at work for publishers that do not belong here


class BenchNode(Node):  # type: ignore[misc]
    """A node whose parameters are the fields of its settings and whose counters go to ``/diagnostics``.

    A heartbeat on ``/diagnostics`` says ``ready`` once every expected peer is connected in both directions; the
    sequencer starts a run only when all nodes it watches are ready, so that no first sample is lost.

    Args:
        name: default node name.
        kind: class of the node's settings.
        settings: take the place of the defaults (launch-free use); ROS overrides win over them.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: a parameter is unknown, of the wrong type or out of range.
    """

    BURST_PERIOD = 0.0  # s; see spin_for_ever
    NEEDED: tuple[str, ...] = ()
    """Parameters without which the node does not start: with their defaults it would work, but without a guard."""

    def __init__(
        self,
        name: str,
        kind: type[NodeSettings] = NodeSettings,
        settings: NodeSettings | None = None,
        **kwargs: Any,
    ) -> None:
        kwargs.setdefault("start_parameter_services", True)
        kwargs.setdefault("enable_rosout", True)
        super().__init__(name, **kwargs)
        self.settings = self._declare(kind, settings)
        self.counters: dict[str, int | float | str] = {}
        self.received = 0
        self.expected_peers = _parse_peers(self.settings.expected_peers, self.get_name())
        linked = self.settings.linked and self.settings.pacing == "lockstep"
        self.link = _link_of(self) if linked else None
        self.transport = Transport(self.get_name(), self.link)
        self.identity = Identity(_NodeGraph(self), self.transport.peers)
        if self.link is not None:
            self._tell_failure = self.link.sender("diagnostics")
        # Guard, heartbeat and tick must go on whatever becomes of ROS time.
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        watched = self.settings.watched_nodes
        self.watched_nodes: list[str] = [self._in_own_namespace(name) for name in watched if name]
        self.instance = f"{socket.gethostname()} process {os.getpid()} node {next(_INSTANCES)}"
        self.in_lockstep = self.settings.pacing == "lockstep"
        self.liveness = Liveness(
            self.watched_nodes,
            self.settings.silence_timeout,
            self.heartbeat_name,
            self.instance,
            lockstep=self.in_lockstep,
        )
        self._last_message = ""
        if self.watched_nodes:
            self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50, raw=True)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        hang = self.settings.hang_timeout
        starting = NodeStatus(self.heartbeat_name, self.instance, message="starting")
        self.heartbeat = Heartbeat(starting, self._publish_status, hang, self.in_lockstep, RCLError)
        self._beats = 0
        self.beat_timer = self.steady_timer(HEARTBEAT_PERIOD, self.beat)

    def _declare(self, kind: type[NodeSettings], settings: NodeSettings | None) -> NodeSettings:
        """Declare the parameters, and read them back once: from here on they are settings with types."""
        table = parameters_of(kind)
        known = {parameter.name for parameter in table}
        unknown = set(self._parameter_overrides) - known - {"use_sim_time"}
        if unknown:
            raise BenchError(
                f"Parameter '{sorted(unknown)[0]}' is not known to {self.get_name()}; "
                f"it knows {', '.join(sorted(known))}."
            )
        needed = [name for name in self.NEEDED if settings is None and name not in self._parameter_overrides]
        if needed:
            raise BenchError(
                f"{self.get_fully_qualified_name()} needs the parameter '{needed[0]}'; start it with "
                "'--ros-args --params-file FILE' and a file of './nmt params' that names this node."
            )
        defaults = values_of(kind() if settings is None else settings)
        given: dict[str, Any] = {}
        for item in table:
            try:
                given[item.name] = self.declare_parameter(item.name, defaults[item.name], _descriptor(item)).value
            except (InvalidParameterTypeException, InvalidParameterValueException) as error:
                raise BenchError(f"Parameter '{item.name}' of {self.get_name()} is refused: {error}") from error
        return settings_of(kind, given, self.get_name())

    def bench_publisher(self, kind: Any, topic: str, qos: QoSProfile) -> Outlet:
        """A publisher of serialised messages that counts among the node's endpoints."""
        publisher = self.create_publisher(kind, topic, qos)
        self.identity.claim(topic)

        def finish(patience: float) -> None:
            with contextlib.suppress(RCLError):
                publisher.wait_for_all_acked(Duration(seconds=patience))

        return self.transport.outlet(topic, publisher, qos.durability != DurabilityPolicy.VOLATILE, finish)

    def bench_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile, raw: bool = False
    ) -> Any:
        """A subscription that counts among the node's endpoints."""

        def counted(message: Any) -> None:
            self.received += 1
            callback(message)

        if self.transport.takes(topic):
            assert self.link is not None
            self.link.take(topic, counted)
            self.transport.endpoint(topic, lambda: self.count_publishers(self.resolve_topic_name(topic)))
            return None
        subscription = self.create_subscription(kind, topic, counted, qos, raw=raw)
        self.transport.endpoint(topic, subscription.get_publisher_count)
        return subscription

    def command_subscription(
        self, kind: Any, topic: str, callback: Callable[[bytes, CommandSource], None], qos: QoSProfile
    ) -> Any:
        """A raw subscription to a topic that one publisher may command; the callback gets the sender of a message.

        The EventsExecutor of ROS 2 Jazzy hands no message info to callbacks. But the middleware delivers the messages
        of matched publishers only, and names those: while there is one, it is the sender; while there are several,
        it is unknown.
        """
        self.identity.watch_commands(topic, f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}")
        # Over a link only the node's own bench speaks, and who else publishes is searched for by the guard.
        asked = self.identity.known_source if self.transport.takes(topic) else self.identity.source
        return self.bench_subscription(kind, topic, lambda raw: callback(raw, asked(topic)), qos, raw=True)

    def bench_service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> Any:
        """A service of this node alone on this bench."""
        self.identity.claim_service(name)
        return self.create_service(kind, name, callback)

    def second_publisher(self) -> str:
        """A sentence that names who does the same work on this bench; empty if none.

        Another publisher of a commanded topic or of a topic of this node, or a node with the name of this one or of
        one that it watches.
        """
        twice = self.liveness.twice(time.monotonic())
        return self.identity.intruder or twice or self.identity.second_command()

    def steady_timer(self, period: float, callback: Callable[[], None]) -> Any:
        """A timer (s) on the steady clock, which goes on when ROS time stands still."""
        return self.create_timer(period, callback, clock=self._steady_clock)

    def _on_diagnostics(self, raw: bytes) -> None:
        try:
            statuses = read_diagnostics(raw)
        except ValueError as error:
            self.get_logger().error(f"Diagnostics refused: {error}", throttle_duration_sec=1.0)
            return
        for status in statuses:
            self.hear(status)

    def hear(self, status: NodeStatus) -> None:
        """Take a heartbeat."""
        failed = status.level == DiagnosticStatus.ERROR
        self.liveness.hear(status.name, status.hardware_id, status.message, failed, time.monotonic())

    def beat(self) -> None:
        """Send a heartbeat: what is missing, what is waited for, and whether the working thread still works."""
        self.liveness.listened(time.monotonic())
        missing = self.transport.missing(self.expected_peers)
        self._beats += 1
        if not self.is_at_work or self._beats % _LOOK_BEATS == 0:  # the middleware takes long to answer
            self.identity.look_around()
        second = self.second_publisher()
        self.update_counters()
        waiting = f"waiting for {', '.join(missing)}" if missing else ""
        message = waiting or second or self.why_not_ready() or READY
        if message != self._last_message:
            self._last_message = message
            self.get_logger().info(message[:1].upper() + message[1:])
        self.publish_diagnostics(DiagnosticStatus.ERROR if second and not waiting else DiagnosticStatus.OK, message)

    @property
    def is_at_work(self) -> bool:
        """Whether a run needs this node's time now."""
        return False

    def why_not_ready(self) -> str:
        """Why the node could not take part in a run now, for its heartbeat; empty if it could."""
        return ""

    def update_counters(self) -> None:
        """Called before each heartbeat; nodes fill :attr:`counters` here."""

    @property
    def heartbeat_name(self) -> str:
        """The node's name on `/diagnostics`: with its namespace, without a leading slash."""
        return str(self.get_fully_qualified_name()).lstrip("/")

    def _in_own_namespace(self, name: str) -> str:
        """A watched node's name on `/diagnostics`; it lives in this node's namespace unless it begins with a slash."""
        return name.lstrip("/") if name.startswith("/") else _full_name(self.get_namespace(), name).lstrip("/")

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters under the node's name."""
        counters = {**self.counters, **self.transport.counters}
        status = NodeStatus(self.heartbeat_name, self.instance, level, message, counters)
        self.heartbeat.say(status)
        if self.link is not None and level == DiagnosticStatus.ERROR:
            self._tell_failure(write_diagnostics(status, 0))

    def _publish_status(self, status: NodeStatus) -> None:
        self._diagnostics.publish(write_diagnostics(status, self.get_clock().now().nanoseconds))

    def told_to_end(self) -> None:
        """Called once when the process is asked to end; the node goes on until :meth:`may_end`, for some seconds."""
        self.get_logger().info("Told to end")
        self.publish_diagnostics(DiagnosticStatus.ERROR, "it was told to end")

    @property
    def end_grace(self) -> float:
        """How long (s) a node that was told to end waits for what it needs; in lockstep since the last message."""
        return _END_GRACE

    def may_end(self, since: float) -> bool:
        """Whether a node that was told to end ``since`` s ago has done its part, such as the ramp to zero."""
        return True

    def shut_down(self) -> None:
        """Called once before the node is destroyed, whatever ended it; nodes quiet the drive and close files here."""

    def destroy_node(self) -> None:
        """Release the node and its link."""
        self.transport.close()
        super().destroy_node()


class ReaderProgress:
    """How far a node that takes all samples has come, for the plant that waits for it in lockstep.

    Args:
        node: the node.
        reader: which of `nmt_core.messages.run_announcement.TAKEN_TOPICS` it is.
    """

    def __init__(self, node: BenchNode, reader: str) -> None:
        topic = TAKEN_TOPICS[reader]
        self._publisher = node.create_publisher(UInt64, topic, STATE_QOS)
        node.identity.claim(topic)
        self._last_sample = 0

    def tell(self, sample: int, rate: float) -> None:
        """Tell the first sample that has not been taken, about once in a second of bench time (``rate`` in Hz)."""
        if abs(sample - self._last_sample) >= TELL_EVERY * rate:
            self.rest(sample)

    def rest(self, sample: int) -> None:
        """Tell it, if it is news, since nothing more is there to be taken: the plant may wait for this very sample."""
        if sample != self._last_sample:
            self._last_sample = sample
            self._publisher.publish(UInt64(data=sample))


class _NodeGraph:
    """The graph of the middleware as a node sees it; see `nmt_core.nodes.identity.Graph`."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def publishers(self, topic: str, message_type: str = "") -> dict[str, str]:
        return {
            bytes(info.endpoint_gid).hex(): _full_name(info.node_namespace, info.node_name)
            for info in self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
            if info.topic_type == (message_type or info.topic_type)
            and info.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT  # those do not match
        }

    def count_publishers(self, topic: str) -> int:
        return int(self._node.count_publishers(self._node.resolve_topic_name(topic)))

    def servers(self, service: str) -> list[str]:
        name = self._node.resolve_service_name(service)
        if self._node.count_services(name) < 2:
            return []
        # The servers of a service are the publishers of its answers.
        found = self._node.get_publishers_info_by_topic(f"rr{name}Reply", no_mangle=True)
        return [_full_name(info.node_namespace, info.node_name) for info in found]


def _link_of(node: Node) -> Link:
    """The node's socket for what it takes past the middleware.

    Raises:
        BenchError: another node of its name is there.
    """
    bench = f"{node.context.get_domain_id()} {node.get_namespace()}"
    try:
        return Link(bench, node.get_name())
    except OSError as error:
        raise BenchError(f"Node {node.get_fully_qualified_name()} is there already; end it first.") from error


def _full_name(namespace: str, name: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _parse_peers(entries: Sequence[str], owner: str) -> dict[str, int]:
    expected = {}
    for entry in entries:
        if not entry:
            continue
        topic, _, count = entry.partition(":")
        if not topic or not count.isdigit():
            raise BenchError(f"Parameter 'expected_peers' of {owner} takes 'topic:count', got '{entry}'.")
        expected[topic] = int(count)
    return expected


def _descriptor(item: Parameter) -> ParameterDescriptor:
    unit = f" [{item.unit}]" if item.unit else ""
    descriptor = ParameterDescriptor(description=item.description + unit, read_only=True)
    if item.choices:
        descriptor.additional_constraints = "one of " + ", ".join(item.choices)
    if item.low is not None and item.high is not None:
        if isinstance(item.default, float):
            bounds = FloatingPointRange(from_value=float(item.low), to_value=float(item.high))
            descriptor.floating_point_range = [bounds]
        elif isinstance(item.default, int) and not isinstance(item.default, bool):
            descriptor.integer_range = [IntegerRange(from_value=int(item.low), to_value=int(item.high), step=1)]
    return descriptor


class EndRequest:
    """SIGINT, SIGTERM and SIGHUP as a wish to end that a node fulfils when it can; whatever is ignored stays so.

    The handlers of rclpy would shut the context down at once, and with it the topics that the ramp to zero needs.

    Attributes:
        since: when the first one came, s of the steady clock; None = none came.
        hurry: whether another one came that is not an echo of the first.
    """

    _SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self.since: float | None = None
        self.hurry = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> EndRequest:
        for number in self._SIGNALS:
            before = signal.getsignal(number)
            if before is not signal.SIG_IGN:
                self._before[number] = before
                signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before if before is not None else signal.SIG_DFL)

    def _on_signal(self, *_: object) -> None:
        now = time.monotonic()
        if self.since is None:
            self.since = now
        elif now - self.since > _HURRY:
            self.hurry = True


def spin_for_ever(executor: Any, node: BenchNode, request: EndRequest | None = None) -> None:
    """Spin until the node's context is shut down, or the node has fulfilled a request to end.

    ``EventsExecutor.spin()`` without a time limit burns a core, serves nothing and does not see signals; with a limit
    it waits as it should. A node with a ``BURST_PERIOD`` sleeps so long and then works off all that has come: waking
    it for every message would cost more than the message.
    """
    context, burst_period = node.context, node.BURST_PERIOD
    never = Future()
    told = False
    heard, worked = -1, 0.0
    while context.ok():
        if request is not None and request.since is not None:
            if not told:
                told = True
                node.told_to_end()
            now = time.monotonic()
            since = now - request.since
            works = node.received != heard  # off what it was sent
            if works:
                heard, worked = node.received, now
            if node.in_lockstep:
                over = now - max(worked, request.since) > node.end_grace
            else:
                over = since > (_LONGEST_WORK if works else node.end_grace)
            if request.hurry or over or node.may_end(since):
                return
        if node.link is not None and burst_period > 0.0:
            serve_late(node.link, burst_period)
        elif node.link is not None:
            serve((node.link,), LINK_PERIOD)
        elif burst_period <= 0.0:
            executor.spin_until_future_complete(never, timeout_sec=_SPIN_LIMIT)
            continue
        else:
            time.sleep(burst_period)
        received = -1
        while received != node.received and context.ok():
            received = node.received
            executor.spin_once(timeout_sec=0.0)


def spin_node(factory: Callable[[], BenchNode], args: list[str] | None = None) -> int:
    """Run one node until it is asked to end: the shared ``main`` of all executables.

    SIGINT, SIGTERM and SIGHUP let the node end its part of a run first: the drive goes to zero and the bag gets it.

    Args:
        factory: makes the node after rclpy has been initialised.
        args: command line, None = ``sys.argv``.

    Returns:
        Exit code: 0 after a regular end or Ctrl-C, 2 for a mistake of the user.
    """
    try:
        seal_transport()
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    node: BenchNode | None = None
    executor: Any = None
    with EndRequest() as request:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        try:
            node = factory()
            check_ports(node.context.get_domain_id())
            executor = EventsExecutor()
            executor.add_node(node)
            calm_collector()
            if node.link is None or node.BURST_PERIOD <= 0.0:  # bundles are small
                return_large_memory()
            node.get_logger().info(f"Started in ROS domain {node.context.get_domain_id()} as {node.instance}")
            with contextlib.suppress(ExternalShutdownException), node.heartbeat.watched_work():
                spin_for_ever(executor, node, request)
            return 0
        except BenchError as error:
            sys.stderr.write(f"{error}\n")
            return 2
        finally:
            if node is not None:
                node.shut_down()
                node.transport.deliver()
                if executor is not None:
                    # An executor that goes while it has a node aborts the process.
                    executor.remove_node(node)
                    executor.shutdown()
                node.destroy_node()
            rclpy.try_shutdown()
