"""The bench's transport: settings of the middleware that cannot be made through rclpy.

The profile ``fastdds.xml`` binds loopback only, so the network does not reach a node. A bench on
two hosts has a profile of its own, in which both hosts are named: ``python3 -m nmt_core.dds_profile`` writes it.
"""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import sys
from collections.abc import MutableMapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from nmt_core.errors import BenchError

PROFILE = Path(__file__).with_name("fastdds.xml")
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
OWN_TRANSPORT = "NMT_TRANSPORT"
LOCKSTEP_LEASE = 3600  # s
_MIDDLEWARE = "rmw_fastrtps"
_FIRST_PORT, _PORTS_PER_DOMAIN = 7400, 250  # of the protocol RTPS
_NAMESPACE = "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"


def dds_environment() -> dict[str, str]:
    """Environment variables that make Fast DDS read the bench's profile; see the comment in ``fastdds.xml``."""
    return {
        PROFILE_VARIABLE: str(PROFILE),
        "RMW_FASTRTPS_USE_QOS_FROM_XML": "1",
        "SKIP_DEFAULT_XML_FILE": "1",  # a profile that happens to lie in the working folder does not count
        RANGE_VARIABLE: "SYSTEM_DEFAULT",
    }


def seal_transport(environment: MutableMapping[str, str] | None = None) -> None:
    """Give this process the bench's transport, for a node that was started by hand; call it before ``rclpy.init``.

    A profile that the user names by ``FASTRTPS_DEFAULT_PROFILES_FILE`` stays, if it names its network interfaces.
    ``NMT_TRANSPORT=own`` leaves everything as it is.

    Args:
        environment: None = that of the process.

    Raises:
        BenchError: another middleware than Fast DDS was chosen, or a profile that cannot be read or is open to every
            interface.
    """
    environment = os.environ if environment is None else environment
    if environment.get(OWN_TRANSPORT) == "own":
        return
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware and not middleware.startswith(_MIDDLEWARE):
        raise BenchError(
            f"RMW_IMPLEMENTATION is {middleware}, but the bench can close its transport to the network with "
            f"{_MIDDLEWARE}_cpp only; unset it, or close the transport yourself and set {OWN_TRANSPORT}=own."
        )
    profile = environment.get(PROFILE_VARIABLE)
    if profile and Path(profile) != PROFILE:
        check_profile(Path(profile))
    if environment.get(RANGE_VARIABLE) == "LOCALHOST":  # the profile keeps to this host, and the range would widen it
        del environment[RANGE_VARIABLE]
    for name, value in dds_environment().items():
        environment.setdefault(name, value)


def check_ports(domain_id: int) -> None:
    """Make sure that this process hears its domain on loopback only; call it when a node is up.

    Raises:
        BenchError: a socket of the domain is open to the network, because the middleware did not take the profile.
    """
    if os.environ.get(OWN_TRANSPORT) == "own" or Path(os.environ.get(PROFILE_VARIABLE, PROFILE)) != PROFILE:
        return
    found = open_ports(domain_id)
    if found:
        raise BenchError(
            f"Port {found[0]} of ROS domain {domain_id} is open to the network although {PROFILE.name} closes it, so a "
            f"stranger could drive the shaker; use ROS 2 Jazzy with Fast DDS 2.14, or set {OWN_TRANSPORT}=own if the "
            "network is yours alone."
        )


def open_ports(domain_id: int) -> list[int]:
    """UDP ports of a domain on which this process hears more than the loopback interface."""
    own = set()
    for entry in Path("/proc/self/fd").glob("*"):
        with contextlib.suppress(OSError):
            target = os.readlink(entry)
            if target.startswith("socket:["):
                own.add(target[8:-1])
    first = _FIRST_PORT + _PORTS_PER_DOMAIN * domain_id
    found = []
    for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]:
        words = line.split()
        address, port = words[1].split(":")
        # The kernel prints the address as one little-endian number.
        if words[9] in own and not address.endswith("7F") and first <= int(port, 16) < first + _PORTS_PER_DOMAIN:
            found.append(int(port, 16))
    return sorted(found)


def check_profile(path: Path) -> None:
    """Refuse a Fast DDS profile whose default participant opens sockets on every network interface.

    Raises:
        BenchError: with what is missing in the file.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise BenchError(f"The Fast DDS profile {path} ({PROFILE_VARIABLE}) cannot be read: {error}.") from error
    closed = {
        _text(item, "transport_id"): _text(item, "type") == "SHM" or bool(item.findall("{*}interfaceWhiteList/{*}*"))
        for item in root.iterfind(".//{*}transport_descriptor")
    }
    participants = [item for item in root.iterfind(".//{*}participant") if item.get("is_default_profile") == "true"]
    for participant in participants:
        chosen = [(item.text or "").strip() for item in participant.iterfind(".//{*}userTransports/{*}transport_id")]
        builtin = _text(participant, ".//{*}useBuiltinTransports") != "false"
        if not builtin and chosen and all(closed.get(name, False) for name in chosen):
            return
    raise BenchError(
        f"The Fast DDS profile {path} ({PROFILE_VARIABLE}) leaves the nodes open to every network interface; unset the "
        "variable, or write a profile that names both hosts with 'python3 -m nmt_core.dds_profile'."
    )


def two_host_profile(own_address: str, peers: Sequence[str]) -> str:
    """The bench's profile for nodes on several hosts, each of them named.

    Args:
        own_address: IPv4 address of this host on the wire between the hosts.
        peers: addresses of the other hosts.

    Returns:
        XML: sockets on loopback and on ``own_address``; discovery asks this host and ``peers``.

    Raises:
        BenchError: an address is none, or is one of all interfaces or of many hosts.
    """
    if not peers:
        raise BenchError("A profile for two hosts needs the address of the other host: --peer ADDRESS.")
    own, *others = [_address(text) for text in (own_address, *peers)]
    if own in others:
        raise BenchError(f"The address {own} is given for this host and for another one; give each host its own.")
    ElementTree.register_namespace("", _NAMESPACE)
    root = ElementTree.parse(PROFILE).getroot()
    for white_list in root.iterfind(".//{*}interfaceWhiteList"):
        _element(white_list, "address", own)
    for peers_list in root.iterfind(".//{*}participant/{*}rtps/{*}builtin/{*}initialPeersList"):
        for peer in others:
            _element(_element(_element(peers_list, "locator"), "udpv4"), "address", peer)
    return _xml(root)


def lockstep_profile() -> str:
    """The bench's profile for nodes in lockstep, which wait for each other however long that takes.

    Returns:
        XML: as ``fastdds.xml``, but what was sent to a node that says nothing is kept for `LOCKSTEP_LEASE`. That a
        process has died shows by the process itself there.
    """
    ElementTree.register_namespace("", _NAMESPACE)
    root = ElementTree.parse(PROFILE).getroot()
    for seconds in root.iterfind(".//{*}leaseDuration/{*}sec"):
        seconds.text = str(LOCKSTEP_LEASE)
    return _xml(root)


def _xml(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8" ?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the profile of one of two hosts; see docs/how-to/run-on-two-hosts.md.

    Returns:
        Exit code: 0, or 2 for a wrong address.
    """
    parser = argparse.ArgumentParser(
        prog="python3 -m nmt_core.dds_profile", description="Print the Fast DDS profile of a bench on two hosts."
    )
    parser.add_argument("--this", required=True, metavar="ADDRESS", help="IPv4 address of this host")
    parser.add_argument("--peer", required=True, action="append", metavar="ADDRESS", help="address of the other host")
    options = parser.parse_args(arguments)
    try:
        sys.stdout.write(two_host_profile(options.this, options.peer))
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def _address(text: str) -> str:
    try:
        address = ipaddress.IPv4Address(text)
    except ValueError as error:
        raise BenchError(f"'{text}' is not an IPv4 address; give one such as 192.168.10.1.") from error
    if (
        address.is_unspecified
        or address.is_multicast
        or address.is_loopback
        or address == ipaddress.IPv4Address(2**32 - 1)
    ):
        raise BenchError(f"The address {text} does not name one host on the wire; give one such as 192.168.10.1.")
    return str(address)


def _element(parent: ElementTree.Element, name: str, text: str | None = None) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, f"{{{_NAMESPACE}}}{name}")
    child.text = text
    return child


def _text(parent: ElementTree.Element, path: str) -> str:
    found = parent.find(path if path.startswith(".") else f"{{*}}{path}")
    return "" if found is None else (found.text or "").strip()


if __name__ == "__main__":
    sys.exit(main())
