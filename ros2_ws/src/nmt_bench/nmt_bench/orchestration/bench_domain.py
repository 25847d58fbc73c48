"""Private ROS domains: one number for one bench at a time on this host."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterable

from nmt_core.dds_profile import dds_environment
from nmt_core.errors import BenchError

# Domain ids up to 101 keep clear of the system's ephemeral ports.
_DOMAINS = range(1, 101)
_FIRST_PORT = 28_700
_BENCHES = itertools.count(step=7)


class BenchDomain:
    """Holds a domain id until closed; the operating system releases it if the process dies.

    A loopback port stands for each id, so two benches, whoever started them, never share one. Nodes that are processes
    hold it as well: those of a launcher that was killed take their run to an end before another bench may have the id.

    Args:
        domain_id: a particular id; None = any free one.

    Raises:
        BenchError: no id is free, or the one asked for is taken or out of range.
    """

    def __init__(self, domain_id: int | None = None) -> None:
        if domain_id is not None and domain_id not in _DOMAINS:
            raise BenchError(f"A ROS domain must be from {_DOMAINS[0]} to {_DOMAINS[-1]}, got {domain_id}.")
        # Not the one just left: its last packets may still be on the way.
        count, offset = len(_DOMAINS), os.getpid() + next(_BENCHES)
        candidates: Iterable[int] = [_DOMAINS[(offset + k) % count] for k in range(count)]
        if domain_id is not None:
            candidates = [domain_id]
        for candidate in candidates:
            holder = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            try:
                holder.bind(("127.0.0.1", _FIRST_PORT + candidate))
            except OSError:
                holder.close()
                continue
            self._holder = holder
            self.id = candidate
            return
        which = "No ROS domain is free" if domain_id is None else f"ROS domain {domain_id} is in use by another bench"
        raise BenchError(f"{which}; stop benches that still run, or choose another with --domain.")

    @property
    def descriptor(self) -> int:
        """What a process has to hold open to hold the id."""
        return self._holder.fileno()

    def close(self) -> None:
        """Release the id, unless other processes hold it still."""
        self._holder.close()


def domains_in_use() -> list[int]:
    """Domains that benches on this host hold."""
    found = []
    for domain in _DOMAINS:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            try:
                probe.bind(("127.0.0.1", _FIRST_PORT + domain))
            except OSError:
                found.append(domain)
    return found


ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""The nodes share two or more cores: a numerical library that starts a thread a core would only slow them down."""


def bench_environment(domain_id: int) -> dict[str, str]:
    """Environment variables for the nodes of a bench.

    The transport stays on this host, because a shaker must not obey a stranger on the network.
    """
    return {"ROS_DOMAIN_ID": str(domain_id), **dds_environment(), **ONE_THREAD}
