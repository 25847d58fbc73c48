"""What the page asks of the bench, whoever answers: nodes, a bag, a test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from nmt_sequencer.steering import SteeringRequest


@dataclass(frozen=True)
class ServiceAnswer:
    """What became of a request: whether it was taken, and one sentence."""

    taken: bool
    message: str


@dataclass(frozen=True)
class StartRequest:
    """A run that a person asks for; what is not said here is as in the run before, or the sequencer's.

    Attributes:
        levels: in the order of the test, in the unit of the run before, else V.
        window_periods: whole periods a window; 0 = as before.
        harmonics_control: up to which the force's harmonics are controlled, see ``nmt_msgs/Level``; None = as before.
    """

    levels: tuple[float, ...]
    window_periods: int = 0
    harmonics_control: int | None = None


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
        """There is no drive."""
