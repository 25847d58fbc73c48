"""A simulated rig under a loop of given frequency, block by block, without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pll.stepped_loop import SteppedLoop

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import ControlKind, LoopState, TestKind
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.open_loop.sweep_loop import SteppedSineLoop, SweepLoop
from nmt_rig.rig import load_rig


@dataclass
class Outcome:
    """What one level brought."""

    lock: object = None
    outputs: list = field(default_factory=list)
    reasons: list = field(default_factory=list)
    blocks: list[dict[Quantity, SampleBlock]] = field(default_factory=list)

    def column(self, name: str) -> np.ndarray:
        """One field of the answers within the window."""
        inside = [o for o in self.outputs if self.lock.first_sample <= o.last_sample]
        return np.array([getattr(o, name) for o in inside])


class SweptRig(SteppedLoop):
    """Joint resonator and a loop; blocks pass from one to the other as in lockstep."""

    def __init__(
        self, kind: TestKind = TestKind.SWEEP, overrides: Sequence[str] = (), latency_blocks: int = 0, **settings: float
    ) -> None:
        rig = load_rig("joint_resonator", overrides)
        values = LoopSettings(latency_blocks=latency_blocks, **settings)
        kinds = {TestKind.SWEEP: SweepLoop, TestKind.STEPPED_SINE: SteppedSineLoop}
        loop = kinds[kind](rig.drive_point, values, rig.sample_rate_hz, rig.block_samples)
        super().__init__(rig, loop, Quantity.ACCELERATION, latency_blocks)
        self.kind = kind
        self.sequence = 0

    def order(self, amplitude: float, frequency_hz: float, **fields: object) -> LevelCommand:
        """A level for the next block."""
        self.sequence += 1
        values = {"ramp": 0.2, "control": ControlKind.FORCE, "timeout": 20.0, "window_periods": 20, **fields}
        level = LevelCommand(
            sequence=self.sequence,
            index=self.sequence - 1,
            amplitude=amplitude,
            apply_at_sample=self.device.next_sample,
            frequency_hz=frequency_hz,
            test=self.kind,
            **values,
        )
        self.loop.set_level(level)
        return level

    def run(self, seconds: float = 120.0) -> Outcome:
        """Until the window is complete, the level is given up or the time is over."""
        outcome = Outcome()
        end = self.device.next_sample + round(seconds * self.device.sample_rate)
        while self.device.next_sample < end:
            output = self.step()
            assert output is not None
            outcome.outputs.append(output)
            outcome.blocks.append(self.blocks)
            if output.transition is not None:
                outcome.reasons.append(output.transition.reason)
            outcome.lock = output.lock or outcome.lock
            lock = outcome.lock
            if lock is not None and self.device.next_sample >= lock.first_sample + lock.samples:
                break
            if output.state == LoopState.LOCK_LOST:
                break
        return outcome
