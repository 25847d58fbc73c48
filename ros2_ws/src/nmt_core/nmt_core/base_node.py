"""What every node of the bench shares: parameters from a table, quality of service, diagnostics and ``main``."""

from __future__ import annotations

import contextlib
import gc
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from nmt_core.command_judge import Source
from nmt_core.dds_profile import check_ports, seal_transport
from nmt_core.errors import BenchError
from nmt_core.parameters import Parameter, ParameterValue, check_values

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


_SPIN_LIMIT = 1.0  # s
HEARTBEAT_PERIOD = 0.25  # s of wall time
READY = "ready"
COMMON_PARAMETERS = (
    Parameter(
        "expected_peers",
        [""],
        "",
        "Endpoints that must be connected before the node calls itself ready, as 'topic:count'; empty = none.",
    ),
    Parameter(
        "watched_nodes",
        [""],
        "",
        "Nodes whose heartbeat this node watches, in its own namespace unless they begin with a slash; empty = none.",
    ),
    Parameter(
        "silence_timeout", 3.0, "s", "Wall time without a heartbeat after which a watched node is lost.", low=0.5
    ),
)


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
        kwargs.setdefault("enable_rosout", False)
        super().__init__(name, **kwargs)
        self.values = self._declare((*table, *COMMON_PARAMETERS), dict(values or {}))
        self.counters: dict[str, int | float | str] = {}
        self.received = 0
        self._expected = _parse_peers(self.values["expected_peers"], self.get_name())
        self._endpoints: dict[str, list[Any]] = {}
        self._sources: dict[str, tuple[int, Source]] = {}
        self._command_types: dict[str, str] = {}
        # Guard, heartbeat and tick must go on whatever becomes of ROS time.
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        watched: Any = self.values["watched_nodes"]
        self.watched_nodes: list[str] = [self._in_own_namespace(name) for name in watched if name]
        silence: Any = self.values["silence_timeout"]
        self._silence_timeout = float(silence)
        self._heard: dict[str, tuple[float, str]] = {}
        self._failures: dict[str, str] = {}
        if self.watched_nodes:
            self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
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

    def bench_publisher(self, kind: Any, topic: str, qos: QoSProfile) -> Any:
        """A publisher that counts among the node's endpoints."""
        publisher = self.create_publisher(kind, topic, qos)
        self._endpoints.setdefault(topic, []).append(publisher.get_subscription_count)
        return publisher

    def bench_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile, raw: bool = False
    ) -> Any:
        """A subscription that counts among the node's endpoints."""

        def counted(message: Any) -> None:
            self.received += 1
            callback(message)

        subscription = self.create_subscription(kind, topic, counted, qos, raw=raw)
        self._endpoints.setdefault(topic, []).append(subscription.get_publisher_count)
        return subscription

    def command_subscription(
        self, kind: Any, topic: str, callback: Callable[[bytes, Source], None], qos: QoSProfile
    ) -> Any:
        """A raw subscription to a topic that one publisher may command; the callback is told who sent a message.

        The EventsExecutor of ROS 2 Jazzy hands no message info to callbacks. But the middleware delivers the messages
        of matched publishers only, and names those: while there is one, it is the sender; while there are several,
        nobody can tell.
        """
        self._command_types[topic] = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        return self.bench_subscription(kind, topic, lambda raw: callback(raw, self.source(topic)), qos, raw=True)

    def source(self, topic: str) -> Source:
        """Who publishes on a topic of `command_subscription` now."""
        count = max(connected() for connected in self._endpoints[topic])
        known = self._sources.get(topic)
        if known is not None and known[0] == count:
            return known[1]
        return self._look_for_publishers(topic, count)

    def _look_for_publishers(self, topic: str, count: int) -> Source:
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
            source = Source(" ".join(sorted(found)), names, alone=len(found) == 1 and count <= 1)
        self._sources[topic] = (count, source)
        return source

    def second_publisher(self) -> str:
        """A sentence that names the publishers of a commanded topic that has several; empty if none has."""
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

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            self._heard[status.name] = (now, status.message)
            if status.level == DiagnosticStatus.ERROR and status.name in self.watched_nodes:
                self._failures[status.name] = status.message

    def unready_nodes(self) -> dict[str, str]:
        """Watched nodes that have not called themselves ready, each with what it waits for."""
        states = {name: self._heard.get(name, (0.0, "not heard of"))[1] for name in self.watched_nodes}
        return {name: state for name, state in states.items() if state != READY}

    def silent_node(self) -> str:
        """A watched node that was heard once and has fallen silent; empty if none."""
        limit = time.monotonic() - self._silence_timeout
        return next((n for n in self.watched_nodes if n in self._heard and self._heard[n][0] < limit), "")

    def forget_failures(self) -> None:
        """Begin anew: what a watched node reported before a run does not end it."""
        self._failures.clear()

    def failed_node(self) -> tuple[str, str]:
        """A watched node that reports an error, and its words; empty if none does."""
        return next(iter(self._failures.items()), ("", ""))

    def _beat(self) -> None:
        missing = self.missing_peers()
        for topic in self._command_types:
            self._look_for_publishers(topic, max(connected() for connected in self._endpoints[topic]))
        second = self.second_publisher()
        self.update_counters()
        message = f"waiting for {', '.join(missing)}" if missing else second or READY
        self.publish_diagnostics(message=message)

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
        status = DiagnosticStatus(level=level, name=self.heartbeat_name, message=message, hardware_id="")
        status.values = [KeyValue(key=key, value=str(value)) for key, value in self.counters.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def shut_down(self) -> None:
        """Called once before the node is destroyed, whatever ended it; nodes quiet the drive and close files here."""


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


def calm_collector() -> None:
    """Keep the cyclic collector off what lives as long as the node, and from looking often.

    Blocks and messages are freed by reference counting; a collection over everything that was imported would stop the
    sample path for tens of milliseconds.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 50, 100)


def spin_for_ever(executor: Any, node: BenchNode) -> None:
    """Spin until the node's context is shut down.

    ``EventsExecutor.spin()`` without a time limit burns a core, serves nothing and does not see signals; with a limit
    it waits as it should. A node with a ``BURST_PERIOD`` sleeps so long and then works off all that has come: waking
    it for every message would cost more than the message.
    """
    context, burst_period = node.context, node.BURST_PERIOD
    never = Future()
    while context.ok():
        if burst_period <= 0.0:
            executor.spin_until_future_complete(never, timeout_sec=_SPIN_LIMIT)
            continue
        time.sleep(burst_period)
        received = -1
        while received != node.received and context.ok():
            received = node.received
            executor.spin_once(timeout_sec=0.0)


def spin_node(factory: Callable[[], BenchNode], args: list[str] | None = None) -> int:
    """Run one node until it is told to end: the shared ``main`` of all executables.

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
    rclpy.init(args=args)
    node: BenchNode | None = None
    try:
        node = factory()
        check_ports(node.context.get_domain_id())
        executor = EventsExecutor()
        executor.add_node(node)
        calm_collector()
        with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
            spin_for_ever(executor, node)
        return 0
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except KeyboardInterrupt:
        return 0
    except RCLError:
        if rclpy.ok():
            raise
        return 0  # a callback was about to publish when the signal came
    finally:
        if node is not None:
            with contextlib.suppress(KeyboardInterrupt, RCLError):
                node.shut_down()
            with contextlib.suppress(KeyboardInterrupt, RCLError):
                node.destroy_node()
        rclpy.try_shutdown()
