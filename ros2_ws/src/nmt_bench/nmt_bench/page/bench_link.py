"""What the page asks of the bench, whoever answers: nodes, a bag, a test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from nmt_bench.page.start_goal import StartRequest
from nmt_sequencer.steering import SteeringRequest


@dataclass(frozen=True)
class ServiceAnswer:
    """What became of a request: whether it was taken, and one sentence."""

    taken: bool
    message: str


class BenchLink(Protocol):
    """Way to the bench."""

    async def steer(self, request: SteeringRequest) -> ServiceAnswer:
        """Ask to steer the run; answers within a few seconds."""

    async def start(self, request: StartRequest) -> ServiceAnswer:
        """Ask for a run; answers within a few seconds."""

    def emergency_stop(self) -> None:
        """Take the drive to zero and hold it there; returns at once, may be called from any thread."""


class NoBench:
    """There is nothing to steer: a recording is shown."""

    async def steer(self, request: SteeringRequest) -> ServiceAnswer:
        """Nothing is steered."""
        return ServiceAnswer(False, "a recording cannot be steered")

    async def start(self, request: StartRequest) -> ServiceAnswer:
        """Nothing is started."""
        return ServiceAnswer(False, "there is nothing that could be started here")

    def emergency_stop(self) -> None:
        """No drive exists."""
