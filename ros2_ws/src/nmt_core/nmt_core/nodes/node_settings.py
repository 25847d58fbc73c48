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
        "lockstep: the run waits for its nodes; realtime: paced by the converter.",
        choices=PACINGS,
    )
    expected_peers: tuple[str, ...] = setting(("",), "Endpoints required for ready, as 'topic:count'; empty = none.")
    watched_nodes: tuple[str, ...] = setting(
        ("",),
        "Watched nodes, in the own namespace unless they begin with a slash; empty = none.",
    )
    silence_timeout: float = setting(2.0, "Real time: wall time without heartbeat of a lost node.", unit="s", low=0.5)
    hang_timeout: float = setting(
        10.0,
        "Real time: longest wall time of one piece of work.",
        unit="s",
        low=1.0,
    )
    linked: bool = setting(False, "Lockstep: samples pass the middleware by sockets of this host.")
