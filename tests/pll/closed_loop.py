"""The loop closed around a simulated rig, block by block, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pll.stepped_loop import SteppedLoop

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import LoopState
from nmt_pll.detection.lock import Transition
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.loop import LockWindow, LoopOutput, PhaseLockedLoop
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig


@dataclass
class LevelOutcome:
    """What one level brought."""

    lock: LockWindow | None = None
    outputs: list[LoopOutput] = field(default_factory=list)
    transitions: list[Transition] = field(default_factory=list)

    @property
    def window(self) -> list[LoopOutput]:
        """Answers within the locked window."""
        assert self.lock is not None, self.transitions
        return [item for item in self.outputs if item.last_sample >= self.lock.first_sample]

    def column(self, name: str) -> np.ndarray:
        """One field of the answers within the window."""
        return np.array([getattr(item, name) for item in self.window])

    @property
    def reason(self) -> str:
        """Reason of the last transition."""
        return self.transitions[-1].reason


class ClosedLoop(SteppedLoop):
    """Rig and loop; blocks pass from one to the other as in lockstep.

    Args:
        point: drive point of the beam.
        overrides: as on the command line.
        settings: loop settings.
        response: quantity whose phase is controlled.
        spoil: changes the pair of blocks before the loop sees them; None drops them.
    """

    def __init__(
        self,
        point: int = 2,
        overrides: Sequence[str] = (),
        settings: LoopSettings | None = None,
        response: Quantity = Quantity.DISPLACEMENT,
        spoil: Callable[[SampleBlock, SampleBlock], tuple[SampleBlock, SampleBlock] | None] | None = None,
    ) -> None:
        rig = load_rig("beam", [f"exciter.point={point}", *overrides])
        self.linear: LinearDescription = linear_description(rig)
        settings = settings or LoopSettings()
        loop = PhaseLockedLoop(self.linear, settings, rig.sample_rate_hz, rig.block_samples)
        super().__init__(rig, loop, response, settings.latency_blocks, spoil)
        self.sequence = 0

    def order(self, amplitude: float, **fields: object) -> LevelCommand:
        """A level for the next block."""
        self.sequence += 1
        level = LevelCommand(
            sequence=self.sequence,
            index=self.sequence - 1,
            amplitude=amplitude,
            apply_at_sample=self.next_sample,
            ramp=0.5,
            window_periods=30,
            timeout=30.0,
        )
        level = replace(level, **fields)
        self.loop.set_level(level)
        return level

    def run_level(self, amplitude: float, seconds: float = 60.0, **fields: object) -> LevelOutcome:
        """Until the window is complete, the lock is lost or the time is over."""
        self.order(amplitude, **fields)
        return self.run(seconds)

    def run(self, seconds: float, to_end: bool = False) -> LevelOutcome:
        """Until as above; ``to_end``: all the time."""
        outcome = LevelOutcome()
        end = self.next_sample + round(seconds * self.device.sample_rate)
        while self.next_sample < end:
            output = self.step()
            if output is None:
                continue
            outcome.outputs.append(output)
            if output.transition is not None:
                outcome.transitions.append(output.transition)
            outcome.lock = output.lock or outcome.lock
            if to_end:
                continue
            lock = outcome.lock
            if lock is not None and self.next_sample >= lock.first_sample + lock.samples:
                break
            if output.state == LoopState.LOCK_LOST:
                break
        return outcome
