"""The middleware profile is there, is well-formed, and says what the decision says."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from nmt_bench.orchestration.bench_domain import bench_environment
from nmt_core.dds_profile import PROFILE, dds_environment

NAMESPACE = {"d": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}


def test_heartbeats_come_every_fifty_milliseconds() -> None:
    root = ElementTree.parse(PROFILE).getroot()
    writer = root.find("d:profiles/d:data_writer", NAMESPACE)
    assert writer is not None
    assert writer.get("is_default_profile") == "true"
    assert writer.findtext("d:times/d:heartbeatPeriod/d:sec", namespaces=NAMESPACE) == "0"
    assert writer.findtext("d:times/d:heartbeatPeriod/d:nanosec", namespaces=NAMESPACE) == "50000000"


def test_benches_and_their_nodes_load_it() -> None:
    environment = bench_environment(7)
    assert Path(environment["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file()
    assert environment.items() >= dds_environment().items()
    assert environment["ROS_DOMAIN_ID"] == "7"
