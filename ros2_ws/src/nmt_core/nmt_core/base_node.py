"""What every node of the bench shares: parameters from a table, quality of service, diagnostics and ``main``."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import itertools
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
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
from nmt_core.nodes.launcher_watch import LauncherWatch
from nmt_core.nodes.link import TAKEN_BY, Link, serve, serve_late
from nmt_core.nodes.liveness import BUSY, HANG_LIMIT, HUNG, READY, Liveness
from nmt_core.nodes.parameters import Parameter, ParameterValue, check_values, parameter_table
from nmt_core.nodes.shared_memory import remove_dead_segments
from nmt_core.processes.process_watch import ProcessWatch

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
LINK_PERIOD = 0.01  # s between two looks at the middleware of a node that takes the sample path past it
HEARTBEAT_PERIOD = 0.25  # s of wall time
_LATE = 2.5 * HEARTBEAT_PERIOD  # s without a heartbeat of the working thread after which another one speaks for it
_END_GRACE = 4.0  # s that a node gets to take its part of a run to an end
_LONGEST_WORK = 10.0  # s that a node gets in real time while it still works off what it was sent
_LAST_WORDS = 3.0  # s
_LAST_MEMORY = 1.5  # s that shared memory of killed nodes is waited for, to be cleared away
# Options of mallopt of glibc, and the size from which a piece of memory is one of its own.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _LARGE_BYTES = -1, -3, 256 * 1024
_HURRY = 1.0  # s after which a second request to end is not the echo of the first
_INSTANCES = itertools.count(1)
_LOOK_BEATS = 4  # heartbeats between two looks of a node at work for publishers that do not belong here
PACING = Parameter(
    "pacing",
    "realtime",
    "",
    "lockstep: the run waits for its nodes, and wall time ends nothing; realtime: paced by the converter.",
    choices=("lockstep", "realtime"),
)
"""For nodes that watch others or wait for them; plant and sequencer have lockstep as their default."""
COMMON_PARAMETERS = (PACING, *parameter_table("""\
expected_peers =[""]  Endpoints that must be connected before the node calls itself ready, as 'topic:count'; empty =
    none.
watched_nodes =[""]  Nodes whose heartbeat this node watches, in its own namespace unless they begin with a slash;
    empty = none.
silence_timeout =2.0 (s) 0.5..  Real time: wall time without a heartbeat after which a watched node is lost.
hang_timeout =10.0 (s) 1.0..  Real time: wall time that the node may be at one piece of work; beyond it the node calls
    itself hung.
linked =False  Lockstep: the nodes, all on this host, hand on the sample path past the middleware.
"""))  # fmt: skip


class Outlet:
    """A publisher of serialised messages.

    A message that nobody takes is not handed to the middleware, unless it is kept for those who come later.

    Args:
        publisher: of rclpy.
        send: hands a message to the nodes that take it past the middleware; None = there are none.
        takers: how many these are.
    """

    def __init__(self, publisher: Any, send: Callable[[bytes], None] | None = None, takers: int = 0) -> None:
        self.publisher, self._send, self._takers = publisher, send, takers
        self._keeps = publisher.qos_profile.durability != DurabilityPolicy.VOLATILE

    def publish(self, raw: bytes) -> None:
        """Publish a serialised message."""
        if self._send is not None:
            self._send(raw)
        if self._keeps or self.publisher.get_subscription_count():
            self.publisher.publish(raw)

    def peers(self) -> int:
        """How many take what is published."""
        return int(self.publisher.get_subscription_count()) + self._takers


class BenchNode(Node):  # type: ignore[misc]
    """A node whose parameters come from a table and whose counters go to ``/diagnostics``.

    A heartbeat on ``/diagnostics`` says ``ready`` once every expected peer is connected in both directions; the
    sequencer starts a run only when all nodes it watches are ready, so that no first sample is lost.

    Args:
        name: default node name.
        table: the node's parameters.
        values: values that take the place of the table's defaults (launch-free use); ROS overrides win over them.
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
        table: Sequence[Parameter],
        values: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        kwargs.setdefault("start_parameter_services", True)
        kwargs.setdefault("enable_rosout", True)
        super().__init__(name, **kwargs)
        own = {parameter.name for parameter in table}
        common = [parameter for parameter in COMMON_PARAMETERS if parameter.name not in own]
        self.values = self._declare((*table, *common), dict(values or {}))
        self.counters: dict[str, int | float | str] = {}
        self.received = 0
        self._expected = _parse_peers(self.values["expected_peers"], self.get_name())
        self._endpoints: dict[str, list[Any]] = {}
        self._sources: dict[str, tuple[int, CommandSource]] = {}
        self._command_types: dict[str, str] = {}
        self._own_topics: list[str] = []
        self._own_services: list[str] = []
        self._bench_publishers: list[Any] = []
        self.link = self._make_link()
        if self.link is not None:
            self._tell_failure = self.link.sender("diagnostics")
        # Guard, heartbeat and tick must go on whatever becomes of ROS time.
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        watched: Any = self.values["watched_nodes"]
        self.watched_nodes: list[str] = [self._in_own_namespace(name) for name in watched if name]
        silence: Any = self.values["silence_timeout"]
        self.instance = f"{socket.gethostname()} process {os.getpid()} node {next(_INSTANCES)}"
        self.in_lockstep = self.values["pacing"] == "lockstep"
        self.liveness = Liveness(
            self.watched_nodes, float(silence), self.heartbeat_name, self.instance, lockstep=self.in_lockstep
        )
        self._intruder = ""
        self._told = ""
        if self.watched_nodes:
            self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50, raw=True)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._newest = NodeStatus(self.heartbeat_name, self.instance, message="starting")
        self._worked = time.monotonic()
        self._beats = 0
        self._heartbeat = self.steady_timer(HEARTBEAT_PERIOD, self._beat)

    def _declare(self, table: Sequence[Parameter], values: dict[str, Any]) -> dict[str, ParameterValue]:
        known = {parameter.name for parameter in table}
        unknown = set(self._parameter_overrides) - known - {"use_sim_time"}
        if unknown:
            raise BenchError(
                f"Parameter '{sorted(unknown)[0]}' is not known to {self.get_name()}; "
                f"it knows {', '.join(sorted(known))}."
            )
        needed = [name for name in self.NEEDED if name not in values and name not in self._parameter_overrides]
        if needed:
            raise BenchError(
                f"{self.get_fully_qualified_name()} needs the parameter '{needed[0]}'; start it with "
                "'--ros-args --params-file FILE' and a file of './nmt params' that names this node."
            )
        given: dict[str, Any] = {}
        for item in table:
            default = values.pop(item.name, item.default)
            try:
                given[item.name] = self.declare_parameter(item.name, default, _descriptor(item)).value
            except (InvalidParameterTypeException, InvalidParameterValueException) as error:
                raise BenchError(f"Parameter '{item.name}' of {self.get_name()} is refused: {error}") from error
        given.update(values)
        return check_values(table, given, self.get_name())

    def _make_link(self) -> Link | None:
        """The node's socket for what it takes past the middleware; None where it takes nothing so.

        Raises:
            BenchError: another node of its name is there.
        """
        if not self.values["linked"] or self.values["pacing"] != "lockstep":
            return None
        bench = f"{self.context.get_domain_id()} {self.get_namespace()}"
        try:
            return Link(bench, self.get_name())
        except OSError as error:
            raise BenchError(f"Node {self.get_fully_qualified_name()} is there already; end it first.") from error

    def bench_publisher(self, kind: Any, topic: str, qos: QoSProfile) -> Outlet:
        """A publisher of serialised messages that counts among the node's endpoints."""
        publisher = self.create_publisher(kind, topic, qos)
        self._bench_publishers.append(publisher)
        self.claim(topic)
        outlet = Outlet(publisher)
        if self.link is not None and topic in TAKEN_BY:
            outlet = Outlet(publisher, self.link.sender(topic), len(TAKEN_BY[topic]))
        self._endpoints.setdefault(topic, []).append(outlet.peers)
        return outlet

    def bench_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile, raw: bool = False
    ) -> Any:
        """A subscription that counts among the node's endpoints."""

        def counted(message: Any) -> None:
            self.received += 1
            callback(message)

        if self.takes_past_middleware(topic):
            assert self.link is not None
            self.link.take(topic, counted)
            self._endpoints.setdefault(topic, []).append(lambda: self.count_publishers(self.resolve_topic_name(topic)))
            return None
        subscription = self.create_subscription(kind, topic, counted, qos, raw=raw)
        self._endpoints.setdefault(topic, []).append(subscription.get_publisher_count)
        return subscription

    def takes_past_middleware(self, topic: str) -> bool:
        """Whether the messages of a topic come over the node's link."""
        return self.link is not None and self.get_name() in TAKEN_BY.get(topic, ())

    def command_subscription(
        self, kind: Any, topic: str, callback: Callable[[bytes, CommandSource], None], qos: QoSProfile
    ) -> Any:
        """A raw subscription to a topic that one publisher may command; the callback is told who sent a message.

        The EventsExecutor of ROS 2 Jazzy hands no message info to callbacks. But the middleware delivers the messages
        of matched publishers only, and names those: while there is one, it is the sender; while there are several,
        nobody can tell.
        """
        self._command_types[topic] = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        # Over a link only the node's own bench speaks, and who else publishes is looked for by the guard.
        asked = self._known_source if self.takes_past_middleware(topic) else self.source
        return self.bench_subscription(kind, topic, lambda raw: callback(raw, asked(topic)), qos, raw=True)

    def _known_source(self, topic: str) -> CommandSource:
        known = self._sources.get(topic)
        return self.source(topic) if known is None else known[1]

    def source(self, topic: str) -> CommandSource:
        """Who publishes on a topic of `command_subscription` now."""
        count = max(connected() for connected in self._endpoints[topic])
        known = self._sources.get(topic)
        if known is not None and known[0] == count:
            return known[1]
        return self._look_for_publishers(topic, count)

    def _look_for_publishers(self, topic: str, count: int) -> CommandSource:
        found = {
            bytes(info.endpoint_gid).hex(): _full_name(info.node_namespace, info.node_name)
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name(topic))
            if info.topic_type == self._command_types[topic]
            and info.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT  # those do not match
        }
        known = self._sources.get(topic)
        if not found and known is not None and known[1].alone:
            source = known[1]  # what it sent before it left
        else:
            names = " and ".join(sorted(found.values())) or "a publisher that is not known yet"
            source = CommandSource(" ".join(sorted(found)), names, alone=len(found) == 1 and count <= 1)
        self._sources[topic] = (count, source)
        return source

    def claim(self, topic: str) -> None:
        """Watch that nobody else publishes on a topic that is this node's own."""
        self._own_topics.append(topic)

    def bench_service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> Any:
        """A service that nobody else may serve on this bench."""
        self._own_services.append(name)
        return self.create_service(kind, name, callback)

    def look_for_intruders(self) -> None:
        """Look whether somebody else does the work of this node; `second_publisher` says so then."""
        self._intruder = self._found_intruders()

    def _found_intruders(self) -> str:
        for service in self._own_services:
            name = self.resolve_service_name(service)
            if self.count_services(name) < 2:
                continue
            # The servers of a service are the publishers of its answers.
            servers = self.get_publishers_info_by_topic(f"rr{name}Reply", no_mangle=True)
            names = sorted({_full_name(info.node_namespace, info.node_name) for info in servers})
            return f"service {service} has several servers: {' and '.join(names)}"
        for topic in self._own_topics:
            name = self.resolve_topic_name(topic)
            if self.count_publishers(name) < 2:
                continue
            found = {
                bytes(info.endpoint_gid): _full_name(info.node_namespace, info.node_name)
                for info in self.get_publishers_info_by_topic(name)
                if info.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT  # those do not match
            }
            if len(found) > 1:
                return f"topic {topic} has several publishers: {' and '.join(sorted(found.values()))}"
        return ""

    def second_publisher(self) -> str:
        """A sentence that names who does the same work on this bench; empty if nobody does.

        Another publisher of a commanded topic or of a topic of this node, or a node with the name of this one or of
        one that it watches.
        """
        second = self._intruder or self.liveness.twice(time.monotonic())
        if second:
            return second
        for topic in self._command_types:
            source = self.source(topic)
            if not source.alone and self._sources[topic][0] > 1:
                return f"topic {topic} has several publishers: {source}"
        return ""

    def steady_timer(self, period: float, callback: Callable[[], None]) -> Any:
        """A timer (s) on the steady clock, which goes on when ROS time stands still."""
        return self.create_timer(period, callback, clock=self._steady_clock)

    def missing_peers(self) -> list[str]:
        """Topics whose expected peers are not connected yet."""
        return [
            topic
            for topic, count in self._expected.items()
            if max((connected() for connected in self._endpoints.get(topic, [])), default=0) < count
        ]

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

    def unready_nodes(self) -> dict[str, str]:
        """Watched nodes that have not called themselves ready, each with what it waits for."""
        return self.liveness.unready(time.monotonic())

    def lost_nodes(self) -> dict[str, str]:
        """Watched nodes that were heard once and are lost, each with why: see `nmt_core.nodes.liveness.Liveness`."""
        return self.liveness.lost(time.monotonic())

    def lost_node(self) -> str:
        """A sentence on the first of `lost_nodes`, without a full stop; empty if none is lost."""
        return self.liveness.first_lost(time.monotonic())

    def forget_failures(self) -> None:
        """Start over: what a watched node reported before a run, or its new start, does not end it."""
        self.liveness.failures.clear()
        self.liveness.meet_again(time.monotonic())

    def failed_node(self) -> tuple[str, str]:
        """A watched node that reports an error, and its words; empty if none does."""
        return next(iter(self.liveness.failures.items()), ("", ""))

    def _beat(self) -> None:
        self.liveness.listened(time.monotonic())
        missing = self.missing_peers()
        self._beats += 1
        if not self.is_at_work or self._beats % _LOOK_BEATS == 0:  # the middleware takes long to answer
            for topic in self._command_types:
                self._look_for_publishers(topic, max(connected() for connected in self._endpoints[topic]))
            self.look_for_intruders()
        second = self.second_publisher()
        self.update_counters()
        waiting = f"waiting for {', '.join(missing)}" if missing else ""
        message = waiting or second or self.why_not_ready() or READY
        if message != self._told:
            self._told = message
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
        waiting = {} if self.link is None else self.link.counters
        status = NodeStatus(self.heartbeat_name, self.instance, level, message, {**self.counters, **waiting})
        self._newest, self._worked = status, time.monotonic()
        self._publish_status(status)
        if self.link is not None and level == DiagnosticStatus.ERROR:
            self._tell_failure(write_diagnostics(status, 0))

    def _publish_status(self, status: NodeStatus) -> None:
        self._diagnostics.publish(write_diagnostics(status, self.get_clock().now().nanoseconds))

    @contextlib.contextmanager
    def watched_work(self) -> Iterator[None]:
        """Have a thread beside the working one that says on ``/diagnostics`` how long the work takes, if it is long.

        The node is ``busy`` then and stays alive to others; beyond ``hang_timeout``, and in lockstep when it could have
        worked for `nmt_core.nodes.liveness.HANG_LIMIT`, it is ``hung``, which is an error.
        """
        over = threading.Event()
        limit: Any = HANG_LIMIT if self.in_lockstep else self.values["hang_timeout"]
        process = ProcessWatch(os.getpid()) if self.in_lockstep else None

        def watch() -> None:
            worked, free = 0.0, 0.0
            while not over.wait(HEARTBEAT_PERIOD):
                since = time.monotonic() - self._worked
                if since < _LATE:
                    continue
                if process is None:
                    free = since
                elif worked != self._worked:  # begin to count what it could have worked since
                    worked, free = self._worked, 0.0
                    process.begin()
                else:
                    free += process.looked()[0]
                status = replace(self._newest, message=f"{BUSY} for {since:.1f} s")
                if free > limit:
                    status.level = DiagnosticStatus.ERROR
                    status.message = f"{HUNG}: nothing has been done for {since:.1f} s"
                with contextlib.suppress(RCLError):
                    self._publish_status(status)

        thread = threading.Thread(target=watch, name="heartbeat", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def told_to_end(self) -> None:
        """Called once when the process is told to end; the node goes on until :meth:`may_end`, for some seconds."""
        self.get_logger().info("Told to end")
        self.publish_diagnostics(DiagnosticStatus.ERROR, "it was told to end")

    @property
    def end_grace(self) -> float:
        """How long (s) a node that was told to end waits for what it needs; in lockstep since the last message."""
        return _END_GRACE

    def may_end(self, since: float) -> bool:
        """Whether a node that was told to end ``since`` s ago has done its part, such as the ramp to zero."""
        return True

    def deliver(self, patience: float = _LAST_WORDS) -> None:
        """Wait until all that was published has arrived, since what is on its way goes with its node.

        Args:
            patience: s, the longest wait; a stopped receiver takes nothing.
        """
        end = time.monotonic() + patience
        while self.link is not None and not self.link.flush() and time.monotonic() < end:
            time.sleep(LINK_PERIOD)
        for publisher in self._bench_publishers:
            with contextlib.suppress(RCLError):
                publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))

    def shut_down(self) -> None:
        """Called once before the node is destroyed, whatever ended it; nodes quiet the drive and close files here."""

    def destroy_node(self) -> None:
        """Release the node and its link."""
        if self.link is not None:
            self.link.close()
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
        node.claim(topic)
        self._told = 0

    def tell(self, sample: int, rate: float) -> None:
        """Tell the first sample that has not been taken, about once in a second of bench time (``rate`` in Hz)."""
        if abs(sample - self._told) >= TELL_EVERY * rate:
            self.rest(sample)

    def rest(self, sample: int) -> None:
        """Tell it, if it is news, since nothing more is there to be taken: the plant may wait for this very sample."""
        if sample != self._told:
            self._told = sample
            self._publisher.publish(UInt64(data=sample))


def _full_name(namespace: str, name: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _parse_peers(entries: Any, owner: str) -> dict[str, int]:
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


def calm_collector(collect: bool = True) -> None:
    """Keep the cyclic collector off what lives as long as the node, and from looking often.

    Blocks and messages are freed by reference counting; a collection over everything that was imported would stop the
    sample path for tens of milliseconds.

    Args:
        collect: free what is garbage first; that looks at all that the program holds.
    """
    if collect:
        gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 50, 100)


def return_large_memory() -> None:
    """Large messages go back to the system as they are freed.

    The C library keeps freed memory of up to 32 MB a piece once a piece of that size has been freed. Between messages
    of many channels it stays in pieces that hardly anything fits: 30 MB in each node with 64 channels. Other libraries
    than glibc are left as they are.
    """
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, _LARGE_BYTES)
        library.mallopt(_TRIM_THRESHOLD, _LARGE_BYTES)


class EndRequest:
    """SIGINT, SIGTERM and SIGHUP as a wish to end that a node fulfils when it can; whatever is ignored stays so.

    The handlers of rclpy would shut the context down at once, and with it the topics that the ramp to zero needs.

    Attributes:
        since: when the first one came, s of the steady clock; None = none came.
        hurry: whether another one came that is no echo of the first.
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
    """Run one node until it is told to end: the shared ``main`` of all executables.

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
            with contextlib.suppress(ExternalShutdownException), node.watched_work():
                spin_for_ever(executor, node, request)
            return 0
        except BenchError as error:
            sys.stderr.write(f"{error}\n")
            return 2
        finally:
            if node is not None:
                node.shut_down()
                node.deliver()
                if executor is not None:
                    # An executor that goes while it has a node aborts the process.
                    executor.remove_node(node)
                    executor.shutdown()
                node.destroy_node()
            rclpy.try_shutdown()
            # Where a program has started the nodes and lives, it clears away what they leave.
            remove_dead_segments(patience=0.0 if LauncherWatch().lives else _LAST_MEMORY, ending=True)
