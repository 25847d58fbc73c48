"""The middleware profile is there, is well-formed, says what the decisions say, and reaches nodes started by hand."""

from __future__ import annotations

import socket
from pathlib import Path
from xml.etree import ElementTree

import pytest

from nmt_bench.orchestration.bench_domain import bench_environment
from nmt_core.dds_profile import (
    LOCKSTEP_LEASE,
    PROFILE,
    check_ports,
    check_profile,
    dds_environment,
    lockstep_profile,
    main,
    open_ports,
    seal_transport,
    two_host_profile,
)
from nmt_core.errors import BenchError

NAMESPACE = {"d": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}


def addresses(text: str, path: str) -> list[str]:
    root = ElementTree.fromstring(text.split("?>", 1)[1])
    return [(item.text or "").strip() for item in root.findall(path, NAMESPACE)]


WHITE_LIST = ".//d:transport_descriptor/d:interfaceWhiteList/d:address"
PEERS = ".//d:participant/d:rtps/d:builtin/d:initialPeersList/d:locator/d:udpv4/d:address"


def test_heartbeats_come_every_fifty_milliseconds() -> None:
    root = ElementTree.parse(PROFILE).getroot()
    writer = root.find("d:profiles/d:data_writer", NAMESPACE)
    assert writer is not None
    assert writer.get("is_default_profile") == "true"
    assert writer.findtext("d:times/d:heartbeatPeriod/d:sec", namespaces=NAMESPACE) == "0"
    assert writer.findtext("d:times/d:heartbeatPeriod/d:nanosec", namespaces=NAMESPACE) == "50000000"


def test_nodes_in_lockstep_keep_what_a_silent_one_has_not_taken_and_stay_on_this_host(tmp_path: Path) -> None:
    path = tmp_path / "profile.xml"
    path.write_text(lockstep_profile(), encoding="utf-8")
    check_profile(path)
    lease = ".//d:participant/d:rtps/d:builtin/d:discovery_config/d:leaseDuration/d:sec"
    assert addresses(path.read_text(encoding="utf-8"), lease) == [str(LOCKSTEP_LEASE)]
    assert addresses(PROFILE.read_text(encoding="utf-8"), lease) == ["5"]
    assert addresses(lockstep_profile(), WHITE_LIST) == ["127.0.0.1"]


def test_benches_and_their_nodes_load_it() -> None:
    environment = bench_environment(7)
    assert Path(environment["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file()
    assert environment.items() >= dds_environment().items()
    assert environment["ROS_DOMAIN_ID"] == "7"


def test_only_loopback_is_bound() -> None:
    text = PROFILE.read_text()
    assert addresses(text, WHITE_LIST) == ["127.0.0.1"]
    assert addresses(text, ".//d:transport_descriptor/d:type") == ["UDPv4"]
    assert addresses(text, ".//d:participant/d:rtps/d:useBuiltinTransports") == ["false"]
    ids = addresses(text, ".//d:transport_descriptor/d:transport_id")
    assert addresses(text, ".//d:participant/d:rtps/d:userTransports/d:transport_id") == ids
    check_profile(PROFILE)


def test_a_node_started_by_hand_gets_the_profile() -> None:
    environment: dict[str, str] = {}
    seal_transport(environment)
    assert environment == dds_environment()


def test_the_range_of_discovery_leaves_the_profile_in_charge() -> None:
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    seal_transport(environment)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    assert bench_environment(7)["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"


def test_ports_of_a_domain_that_hear_the_network_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NMT_TRANSPORT", raising=False)
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILE))
    domain = 230  # beyond the ports of benches and of outgoing connections
    port = 7400 + 250 * domain + 10
    for address, found in (("127.0.0.1", []), ("0.0.0.0", [port])):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
            listener.bind((address, port))
            assert open_ports(domain) == found
            assert open_ports(domain + 1) == []
            if found:
                with pytest.raises(BenchError, match=f"Port {port} of ROS domain 230 is open"):
                    check_ports(domain)
            else:
                check_ports(domain)
    assert open_ports(domain) == []


def test_what_the_user_set_stays_if_it_is_closed(tmp_path: Path) -> None:
    mine = tmp_path / "two_hosts.xml"
    mine.write_text(two_host_profile("192.168.10.1", ["192.168.10.2"]))
    environment = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(mine), "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
    seal_transport(environment)
    assert environment["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(mine)
    assert environment["RMW_FASTRTPS_USE_QOS_FROM_XML"] == "1"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<useBuiltinTransports>false</useBuiltinTransports>", ""),
        ("<useBuiltinTransports>false</useBuiltinTransports>", "<useBuiltinTransports>true</useBuiltinTransports>"),
        ("<address>127.0.0.1</address>", ""),
        (
            "<transport_id>bench_udp</transport_id>\n        <type>",
            "<transport_id>other</transport_id>\n        <type>",
        ),
        ('is_default_profile="true">\n      <rtps>', 'is_default_profile="false">\n      <rtps>'),
        ("</dds>", ""),
    ],
)
def test_an_open_or_broken_profile_is_refused(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "open.xml"
    text = PROFILE.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(BenchError, match=r"open\.xml"):
        seal_transport({"FASTRTPS_DEFAULT_PROFILES_FILE": str(path)})


def test_a_missing_profile_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="cannot be read"):
        seal_transport({"FASTRTPS_DEFAULT_PROFILES_FILE": str(tmp_path / "none.xml")})


def test_another_middleware_is_refused_unless_the_user_answers_for_it() -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    with pytest.raises(BenchError, match="NMT_TRANSPORT=own"):
        seal_transport(environment)
    environment["NMT_TRANSPORT"] = "own"
    seal_transport(environment)
    assert environment == {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "NMT_TRANSPORT": "own"}


def test_two_hosts_are_named_and_nobody_else(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--this", "192.168.10.1", "--peer", "192.168.10.2"]) == 0
    text = capsys.readouterr().out
    assert addresses(text, WHITE_LIST) == ["127.0.0.1", "192.168.10.1"]
    assert addresses(text, PEERS) == ["127.0.0.1", "192.168.10.2"]
    plain = ElementTree.parse(PROFILE).getroot().find(".//d:data_writer", NAMESPACE)
    same = ElementTree.fromstring(text.split("?>", 1)[1]).find(".//d:data_writer", NAMESPACE)
    assert [(e.tag, (e.text or "").strip()) for e in plain.iter()] == [
        (e.tag, (e.text or "").strip()) for e in same.iter()
    ]


@pytest.mark.parametrize("address", ["0.0.0.0", "239.255.0.1", "127.0.0.1", "255.255.255.255", "lab-pc", "10.0.0.2"])
def test_an_address_that_names_no_single_host_is_refused(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--this", address, "--peer", "10.0.0.2"]) == 2
    assert address in capsys.readouterr().err
