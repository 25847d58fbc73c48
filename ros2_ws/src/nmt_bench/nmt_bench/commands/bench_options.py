"""The bench that a command's options ask for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Unpack

from nmt_bench.commands.shared_options import DeviceOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nmt_bench.harness import Bench
    from nmt_session.node_plan import PlanSettings


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
    compare: int = 0,
    **settings: Unpack[PlanSettings],
) -> Bench:
    """The bench that the options of rig, device and processes ask for; the rest as of `plan_test`.

    Raises:
        BenchError: the rig, a level or an option is refused, or the converter is not there or not checked.
    """
    from nmt_bench.commands.hardware_options import device_settings
    from nmt_bench.harness import Bench

    settings.update(device_settings(options, settings.pop("latency_blocks", 0)))
    return Bench(
        options.rig,
        levels,
        out=options.out,
        processes=not options.one_process,
        domain_id=options.domain,
        overrides=options.set,
        exciter=options.exciter,
        seed=options.seed,
        compare=compare,
        **settings,
    )
