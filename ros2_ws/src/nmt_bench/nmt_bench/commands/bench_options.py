"""The bench that a command's options ask for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Unpack, cast

from nmt_bench.commands.shared_options import DeviceOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nmt_bench.harness import Bench
    from nmt_session.planning import TestSettings


class BenchOptions(DeviceOptions, Protocol):
    """Options of a command that starts a test."""

    @property
    def out(self) -> Path:
        """Folder of the results."""

    @property
    def seed(self) -> int | None:
        """Seed of all noise; None = the rig's."""

    @property
    def one_process(self) -> bool:
        """All nodes in one process."""

    @property
    def domain(self) -> int | None:
        """ROS domain; None = a free one."""


def bench_of(
    options: BenchOptions,
    levels: Sequence[float] | str | None = None,
    **settings: Unpack[TestSettings],
) -> Bench:
    """The bench that the options of rig, device and processes ask for; the rest as of `plan_test`.

    Raises:
        BenchError: the rig, a level or an option is refused, or the converter is not there or not checked.
    """
    from nmt_bench.commands.hardware_options import device_settings
    from nmt_bench.harness import Bench

    chosen = {**settings, **device_settings(options, settings.get("latency_blocks", 0))}
    chosen |= {"overrides": options.set, "exciter": options.exciter, "seed": options.seed}
    return Bench(
        options.rig,
        levels,
        out=options.out,
        processes=not options.one_process,
        domain_id=options.domain,
        **cast("TestSettings", chosen),
    )
