"""The topics of the bench, their types and the quality of service they are offered with."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SAMPLE_TOPICS

SAMPLE_BLOCK = "nmt_msgs/msg/SampleBlock"
RUN_RECORD = "nmt_msgs/msg/RunRecord"
RUN_STATE = "nmt_msgs/msg/RunState"


class Service(Enum):
    """Quality of service of a topic."""

    SAMPLES = "reliable, keep all, volatile"
    STATE = "reliable, keep last 1, transient local"
    DEFAULT = "reliable, keep last 10, volatile"


@dataclass(frozen=True, slots=True)
class BenchTopic:
    """One topic.

    Attributes:
        name: without leading slash.
        message_type: ``package/msg/Name``.
        service: quality of service.
    """

    name: str
    message_type: str
    service: Service


BENCH_TOPICS: tuple[BenchTopic, ...] = (
    *(BenchTopic(name, SAMPLE_BLOCK, Service.SAMPLES) for name in SAMPLE_TOPICS),
    BenchTopic("drive", "nmt_msgs/msg/Drive", Service.SAMPLES),
    BenchTopic("frequency", "nmt_msgs/msg/Frequency", Service.SAMPLES),
    BenchTopic("level", "nmt_msgs/msg/Level", Service.SAMPLES),
    BenchTopic("lock", "nmt_msgs/msg/LockEvent", Service.SAMPLES),
    BenchTopic("modal_point", "nmt_msgs/msg/ModalPoint", Service.SAMPLES),
    BenchTopic("steering", "nmt_msgs/msg/Steering", Service.SAMPLES),
    BenchTopic("run_state", RUN_STATE, Service.STATE),
    BenchTopic("run_record", RUN_RECORD, Service.STATE),
    BenchTopic("drive_stop", "nmt_msgs/msg/DriveStop", Service.STATE),
    BenchTopic("monitor", "nmt_msgs/msg/Monitor", Service.SAMPLES),
    BenchTopic("emergency_stop", "std_msgs/msg/Bool", Service.DEFAULT),
    BenchTopic("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", Service.DEFAULT),
)

_BY_NAME = {topic.name: topic for topic in BENCH_TOPICS}


def bench_name(topic: str) -> str:
    """Name of a topic without the leading slash."""
    return topic.lstrip("/")


def parse_topic(text: str) -> BenchTopic:
    """Topic named by the user: a topic of the bench, or ``name:package/msg/Type``.

    Raises:
        BenchError: the name is not one of the bench and no type is given, or the type is malformed.
    """
    name, _, message_type = text.partition(":")
    name = bench_name(name.strip())
    if not message_type:
        if name not in _BY_NAME:
            raise BenchError(
                f"Topic '{text}' is not one of the bench ({', '.join(_BY_NAME)}); "
                "give its type as in 'temperature:sensor_msgs/msg/Temperature'."
            )
        return _BY_NAME[name]
    parts = message_type.strip().split("/")
    if not name or len(parts) != 3 or parts[1] != "msg" or not all(parts):
        raise BenchError(f"Topic '{text}' must be written as 'name:package/msg/Type'.")
    return BenchTopic(name, message_type.strip(), Service.DEFAULT)


def qos_profile(service: Service) -> dict[str, Any]:
    """The profile as rosbag2 (metadata version 9) writes it."""
    history, depth, durability = {
        Service.SAMPLES: ("keep_all", 0, "volatile"),
        Service.STATE: ("keep_last", 1, "transient_local"),
        Service.DEFAULT: ("keep_last", 10, "volatile"),
    }[service]
    # rosbag2 writes the largest duration for "no limit".
    unlimited = {"sec": 9223372036, "nsec": 854775807}
    return {
        "history": history,
        "depth": depth,
        "reliability": "reliable",
        "durability": durability,
        "deadline": dict(unlimited),
        "lifespan": dict(unlimited),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(unlimited),
        "avoid_ros_namespace_conventions": False,
    }
