"""What every node of the bench shares: parameters from a table, quality of service, diagnostics and ``main``."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from nmt_core.errors import BenchError
from nmt_core.parameters import Parameter, ParameterValue, check_values

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


class BenchNode(Node):
    """A node whose parameters come from a table and whose counters go to ``/diagnostics``.

    Args:
        name: default node name.
        table: the node's parameters.
        values: values that take the place of the table's defaults (launch-free use); ROS overrides win over them.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: a parameter is unknown, of the wrong type or out of range.
    """

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
        self.values = self._declare(table, dict(values or {}))
        self.counters: dict[str, int | float | str] = {}
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def _declare(self, table: Sequence[Parameter], values: dict[str, Any]) -> dict[str, ParameterValue]:
        known = {parameter.name for parameter in table}
        unknown = set(self._parameter_overrides) - known - {"use_sim_time"}
        if unknown:
            raise BenchError(
                f"Parameter '{sorted(unknown)[0]}' is not known to {self.get_name()}; "
                f"it knows {', '.join(sorted(known))}."
            )
        given: dict[str, Any] = {}
        for item in table:
            default = values.pop(item.name, item.default)
            try:
                given[item.name] = self.declare_parameter(item.name, default, _descriptor(item)).value
            except InvalidParameterTypeException as error:
                raise BenchError(f"Parameter '{item.name}' of {self.get_name()} has the wrong type: {error}") from error
        given.update(values)
        return check_values(table, given, self.get_name())

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters under the node's name."""
        status = DiagnosticStatus(level=level, name=self.get_name(), message=message, hardware_id="")
        status.values = [KeyValue(key=key, value=str(value)) for key, value in self.counters.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def shut_down(self) -> None:
        """Called once before the node is destroyed, whatever ended it; nodes quiet the drive and close files here."""


def _descriptor(item: Parameter) -> ParameterDescriptor:
    unit = f" [{item.unit}]" if item.unit else ""
    descriptor = ParameterDescriptor(description=item.description + unit, read_only=True)
    if item.choices:
        descriptor.additional_constraints = "one of " + ", ".join(item.choices)
    if item.low is not None and item.high is not None:
        if isinstance(item.default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(item.low), to_value=float(item.high))]
        elif isinstance(item.default, int) and not isinstance(item.default, bool):
            descriptor.integer_range = [IntegerRange(from_value=int(item.low), to_value=int(item.high), step=1)]
    return descriptor


def spin_node(factory: Callable[[], BenchNode], args: list[str] | None = None) -> int:
    """Run one node until it is told to end: the shared ``main`` of all executables.

    Args:
        factory: makes the node after rclpy has been initialised.
        args: command line, None = ``sys.argv``.

    Returns:
        Exit code: 0 after a regular end or Ctrl-C, 2 for a mistake of the user.
    """
    rclpy.init(args=args)
    node: BenchNode | None = None
    try:
        node = factory()
        executor = EventsExecutor()
        executor.add_node(node)
        gc.collect()
        gc.freeze()
        with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
            executor.spin()
        return 0
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except KeyboardInterrupt:
        return 0
    finally:
        if node is not None:
            with contextlib.suppress(KeyboardInterrupt):
                node.shut_down()
                node.destroy_node()
        rclpy.try_shutdown()
