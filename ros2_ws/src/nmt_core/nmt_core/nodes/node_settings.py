"""Settings that every node of the bench has."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.settings import setting

PACINGS = ("lockstep", "realtime")


@dataclass(frozen=True)
class NodeSettings:
    """What a node is among others; the settings of each node derive from it."""

    pacing: str = setting(
        "realtime",
        "lockstep: the run waits for its nodes, and wall time ends nothing; realtime: paced by the converter.",
        choices=PACINGS,
    )
    expected_peers: tuple[str, ...] = setting(
        ("",), "Endpoints that must be connected before the node calls itself ready, as 'topic:count'; empty = none."
    )
    watched_nodes: tuple[str, ...] = setting(
        ("",),
        "Nodes whose heartbeat this node watches, in its own namespace unless they begin with a slash; empty = none.",
    )
    silence_timeout: float = setting(
        2.0, "Real time: wall time without a heartbeat after which a watched node is lost.", unit="s", low=0.5
    )
    hang_timeout: float = setting(
        10.0,
        "Real time: wall time that the node may be at one piece of work; beyond it the node calls itself hung.",
        unit="s",
        low=1.0,
    )
    linked: bool = setting(False, "Lockstep: the nodes, all on this host, hand on the sample path past the middleware.")
