"""A self-excited rig and its loop, block by block, and the modal points of its windows; no ROS, no bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pll.stepped_loop import SteppedLoop

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import ControlKind, LoopState, TestKind
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.extractor import Extractor
from nmt_pll.level_loop import LoopOutput
from nmt_pll.loop_core import lock_event
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.self_excited.self_excited_loop import SelfExcitedLoop
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig

PAPER_NOISE = 2e-9, 4.5e-16  # N²/Hz, m²/Hz
PAPER_CORRELATION = 1e-5  # s


@dataclass
class Level:
    """What became of a level."""

    amplitude: float
    point: ModalPoint | None = None
    reasons: list[str] = field(default_factory=list)


class SelfExcitedBench(SteppedLoop):
    """Rig and loop.

    Args:
        name: of the rig.
        method: of the loop.
        latency: blocks between command and excitation.
        noise: whether force and displacement have the noise of the paper.
        seed: of the noise.
        overrides: as on the command line.
    """

    def __init__(
        self, name: str, method: str = "auto", latency: int = 0, noise: bool = False, seed: int = 1,
        overrides: Sequence[str] = (), **settings: float,
    ) -> None:  # fmt: skip
        changes = [f"seed={seed}", *overrides]
        if noise:
            for row, sensor in enumerate(load_rig(name).sensors):
                if sensor.quantity in ("force", "displacement"):
                    density = PAPER_NOISE[sensor.quantity == "displacement"]
                    changes.append(f"sensors.{row}.noise_psd={density}")
                    changes.append(f"sensors.{row}.noise_correlation_time_s={PAPER_CORRELATION}")
        self.rig = load_rig(name, changes)
        self.linear = linear_description(self.rig)
        self.limit = float(self.rig.limits.displacement_m)
        values = LoopSettings(
            latency_blocks=latency, voltage_limit=float(self.rig.limits.voltage_v), quiet_ramp=0.2, **settings
        )
        loop = SelfExcitedLoop(self.linear, values, self.rig.sample_rate_hz, self.rig.block_samples, method, self.limit)
        super().__init__(self.rig, loop, Quantity.DISPLACEMENT, latency)
        self.extractor = Extractor(self.linear, ExtractionSettings(topics=("force", "displacement")))
        self.outputs: list[LoopOutput] = []
        self.largest = 0.0
        self.sequence = 0

    def advance(self) -> LoopOutput:
        """One block, also to the extraction."""
        output = self.step()
        assert output is not None
        for quantity in (Quantity.FORCE, Quantity.DISPLACEMENT):
            self.extractor.add_block(quantity.topic, self.blocks[quantity])
        self.extractor.add_state(output.last_sample, int(output.state))
        if output.lock is not None:
            self.extractor.add_lock(lock_event(output.lock, Quantity.DISPLACEMENT, self.rig.sample_rate_hz))
        self.outputs.append(output)
        self.largest = max(self.largest, float(np.abs(self.motion.data[0]).max()))
        return output

    @property
    def motion(self) -> SampleBlock:
        """Newest block of displacements."""
        return self.blocks[Quantity.DISPLACEMENT]

    def order(self, amplitude: float, duration: float = 5.0, timeout: float = 20.0) -> None:
        """A level from the next block on."""
        self.sequence += 1
        self.loop.set_level(
            LevelCommand(
                self.sequence,
                self.sequence - 1,
                amplitude,
                self.next_sample,
                0.3,
                control=ControlKind.RESPONSE,
                window_periods=40,
                timeout=timeout,
                test=TestKind.SELF_EXCITED,
                duration=duration,
            )
        )

    def run_level(self, amplitude: float, seconds: float = 60.0, **fields: float) -> Level:
        """Until its point is there, or the lock is lost."""
        self.order(amplitude, **fields)
        level = Level(amplitude)
        end = self.next_sample + round(seconds * self.rig.sample_rate_hz)
        while self.next_sample < end:
            output = self.advance()
            if output.transition is not None:
                level.reasons.append(output.transition.reason)
            points = self.extractor.take()
            if points:
                level.point = points[0]
                return level
            if output.state == LoopState.LOCK_LOST:
                return level
        raise AssertionError(f"level {amplitude}: nothing after {seconds} s; {level.reasons}")

    def end(self, duration: float = 5.0) -> list[LoopOutput]:
        """The level of zero, until the drive is at zero."""
        self.order(0.0, duration=duration)
        outputs = []
        for _ in range(round((duration + 1.0) / self.loop.block_duration)):
            outputs.append(self.advance())
        return outputs
