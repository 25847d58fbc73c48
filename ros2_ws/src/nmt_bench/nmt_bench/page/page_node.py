"""The page's node: listens like any other node, and can die or hang without anybody noticing.

Its readers of samples are best effort and keep a bounded number of messages, so that no publisher ever waits for it;
they are looked at some twenty times a second, and what has been overwritten by then is left out. The latched topics
keep their newest message only. Events, a few a level, are read reliably and as they come: on a busy machine they would
wait for ever behind samples that come faster than they can be read. The node subscribes to samples only once a run has
begun: until then the nodes count their peers, and an additional reader must not be taken for one of them.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_msgs.msg import Bool, String

from nmt_bench.page.bench_link import ServiceAnswer
from nmt_bench.page.live_view import LiveView
from nmt_bench.page.message_records import RecordReader
from nmt_bench.page.start_goal import StartRequest, goal_of
from nmt_core.base_node import STATE_QOS, BenchNode
from nmt_core.dds_profile import seal_transport
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SAMPLE_TOPICS
from nmt_core.vocabulary import RunPhase
from nmt_msgs import msg
from nmt_msgs.action import RunLevels
from nmt_msgs.srv import Steer
from nmt_sequencer.steering import SteeringRequest

_ANSWER_TIMEOUT = 8.0  # s
_RETRY_PERIOD = 0.25  # s
_LOOK_PERIOD = 0.04  # s
_DEPTH = 200
_MONITOR_QOS = QoSProfile(
    reliability=ReliabilityPolicy.BEST_EFFORT,
    history=HistoryPolicy.KEEP_LAST,
    depth=_DEPTH,
    durability=DurabilityPolicy.VOLATILE,
)
_STREAMS = {"frequency": msg.Frequency, **dict.fromkeys(SAMPLE_TOPICS, msg.SampleBlock)}
# A few messages a level, each of which matters: none is to be lost while the page is busy. A publisher keeps them for a
# page that hangs until the middleware takes it for dead, and never comes to wait: it may keep thousands.
_EVENT_QOS = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    history=HistoryPolicy.KEEP_LAST,
    depth=1000,
    durability=DurabilityPolicy.VOLATILE,
)
_EVENTS = {
    "level": msg.Level,
    "lock": msg.LockEvent,
    "modal_point": msg.ModalPoint,
    "steering": msg.Steering,
}


class PageNode(BenchNode):
    """Feeds a view with what the bench publishes.

    Args:
        view: what is fed.
        on_bag: told of the folder of the bag that is being written.
        **kwargs: forwarded to :class:`rclpy.node.Node`.
    """

    def __init__(self, view: LiveView, on_bag: Callable[[Path], None] = lambda _: None, **kwargs: Any) -> None:
        kwargs.setdefault("start_parameter_services", False)
        super().__init__("page", **kwargs)
        self._view, self._on_bag = view, on_bag
        self._reader = RecordReader()
        self._listening = False
        # A node of its own that no executor knows: its messages wait until they are looked at.
        self._signals = Node(
            "page_signals",
            context=kwargs.get("context"),
            namespace=kwargs.get("namespace"),
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._streams: list[tuple[str, Any]] = []
        self._bag = ""
        self.stop_publisher = self.create_publisher(
            Bool, "emergency_stop", 10, event_callbacks=PublisherEventCallbacks(use_default_callbacks=False)
        )
        self.steer_client = self.create_client(Steer, "steer")
        self.run_client = ActionClient(self, RunLevels, "run_levels")
        self.bench_subscription(msg.RunState, "run_state", self._on_state, STATE_QOS, raw=True)
        self.bench_subscription(msg.DriveStop, "drive_stop", self._taking("drive_stop"), STATE_QOS, raw=True)
        self.bench_subscription(String, "bag", self._on_bag_state, STATE_QOS)
        self.bench_subscription(DiagnosticArray, "/diagnostics", self._on_health, _MONITOR_QOS)

    def _taking(self, topic: str) -> Callable[[bytes], None]:
        def take(raw: bytes) -> None:
            record = self._reader.read(topic, raw)
            if record is not None:
                self._view.take(record)

        return take

    def _on_state(self, raw: bytes) -> None:
        state = self._reader.read("run_state", raw)
        if state is None:
            return
        self._view.take(state)
        if not self._listening and state.phase not in (RunPhase.UNKNOWN, RunPhase.IDLE):
            self._listening = True
            for topic, kind in _EVENTS.items():
                self.bench_subscription(kind, topic, self._taking(topic), _EVENT_QOS, raw=True)
            for topic, kind in _STREAMS.items():
                reader = self._signals.create_subscription(kind, topic, lambda _: None, _MONITOR_QOS, raw=True)
                self._streams.append((topic, reader))

    def look_at_signals(self) -> None:
        """Take the samples and states of the loop that have come since, as many as the readers keep."""
        for topic, reader in self._streams:
            take = self._taking(topic)
            with reader.handle:
                for _ in range(_DEPTH):
                    message = reader.handle.take_message(reader.msg_type, True)
                    if message is None:
                        break
                    self.received += 1
                    take(message[0])

    def destroy_node(self) -> None:
        """Release the node and the readers of its signals."""
        self._signals.destroy_node()
        super().destroy_node()

    def _on_bag_state(self, message: Any) -> None:
        with contextlib.suppress(ValueError, TypeError, KeyError):
            path = str(json.loads(message.data)["path"])
            if path and path != self._bag:
                self._bag = path
                self._on_bag(Path(path))

    def _on_health(self, message: Any) -> None:
        for status in message.status:
            if status.name == self.heartbeat_name:
                continue
            values = {item.key: item.value for item in status.values}
            self._view.take_health(status.name, status.level[0], status.message, values)

    def update_counters(self) -> None:
        """Counters for the heartbeat."""
        self.counters.update(received=self.received, malformed=self._reader.malformed)


class NodeLink:
    """The node in a thread of its own, and the way to the bench.

    Args:
        view: what is fed.
        domain_id: ROS domain; None = that of the environment.
        on_bag: told of the folder of the bag that is being written, in the node's thread.
        namespace: of the bench.
    """

    def __init__(
        self,
        view: LiveView,
        domain_id: int | None = None,
        on_bag: Callable[[Path], None] = lambda _: None,
        namespace: str = "",
    ) -> None:
        seal_transport()
        self._view = view
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        self.node = PageNode(view, on_bag, context=self._context, namespace=namespace)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="page node", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        never = Future()
        with contextlib.suppress(Exception):  # the context is shut down from outside
            while self._context.ok():
                self._executor.spin_until_future_complete(never, timeout_sec=_LOOK_PERIOD)
                self.node.look_at_signals()

    async def steer(self, request: SteeringRequest) -> ServiceAnswer:
        """Ask the sequencer; it answers within a few seconds or is not there."""
        if not await self._found(self.node.steer_client.service_is_ready):
            return ServiceAnswer(False, "no sequencer is there to be asked")
        answer = await self._answer(self.node.steer_client.call_async(Steer.Request(**request.fields)))
        if answer is None:
            return ServiceAnswer(False, f"the sequencer has not answered within {_ANSWER_TIMEOUT:g} s")
        return ServiceAnswer(bool(answer.success), str(answer.message))

    async def start(self, request: StartRequest) -> ServiceAnswer:
        """Send the sequencer a goal; the run goes on whatever becomes of the page."""
        if self._view.active:
            return ServiceAnswer(False, "a run is under way")
        if not await self._found(self.node.run_client.server_is_ready):
            return ServiceAnswer(False, "no sequencer is there to be asked")
        try:
            goal = goal_of(request, self._view.run_plan)
        except BenchError as error:
            return ServiceAnswer(False, str(error).rstrip("."))
        # A sequencer that has told the end of a run still waits for its last points and for the recorder.
        end = asyncio.get_running_loop().time() + _ANSWER_TIMEOUT
        while True:
            answer = await self._answer(self.node.run_client.send_goal_async(RunLevels.Goal(**goal)))
            if answer is None:
                return ServiceAnswer(False, f"the sequencer has not answered within {_ANSWER_TIMEOUT:g} s")
            if answer.accepted:
                break
            if self._view.active or asyncio.get_running_loop().time() > end:
                return ServiceAnswer(
                    False, "the sequencer refuses this plan, or has not done with a run; its log says which"
                )
            await asyncio.sleep(_RETRY_PERIOD)
        return ServiceAnswer(True, "the run begins when every node is ready")

    @staticmethod
    async def _found(ready: Callable[[], bool]) -> bool:
        """Whether a service is there, or comes soon: discovery finds a node's topics before its services."""
        end = asyncio.get_running_loop().time() + _ANSWER_TIMEOUT
        while not ready():
            if asyncio.get_running_loop().time() > end:
                return False
            await asyncio.sleep(_RETRY_PERIOD)
        return True

    async def _answer(self, future: Any) -> Any:
        """What a future of the node comes to; None if that takes too long."""
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def tell(answer: Any) -> None:
            if not answered.done():
                answered.set_result(answer)

        future.add_done_callback(lambda done: loop.call_soon_threadsafe(tell, done.result()))
        try:
            return await asyncio.wait_for(answered, _ANSWER_TIMEOUT)
        except asyncio.TimeoutError:
            return None

    def emergency_stop(self) -> None:
        """Take the drive to zero and hold it there until the operator releases it."""
        self.node.stop_publisher.publish(Bool(data=True))

    def close(self) -> None:
        """End the node."""
        rclpy.try_shutdown(context=self._context)
        self._thread.join(timeout=5.0)
        with contextlib.suppress(Exception):
            self.node.destroy_node()
