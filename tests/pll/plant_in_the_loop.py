"""The simulated rig and a loop, block by block, without ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pll.stepped_loop import SteppedLoop

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import LevelCommand
from nmt_pll.phase_loop.paper_loop import PaperLoop
from nmt_pll.phase_loop.paper_settings import PaperSettings
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig


@dataclass
class History:
    time: np.ndarray
    omega: np.ndarray
    phase_error: np.ndarray
    locked_at: float | None
    reasons: list[str]


class LoopOnRig(SteppedLoop):
    """A paper loop on the virtual beam."""

    def __init__(self, overrides=(), **settings):
        rig = load_rig("beam", overrides)
        self.rate = rig.sample_rate_hz
        self.linear = linear_description(rig)
        loop = PaperLoop(self.linear, PaperSettings(**settings), rig.sample_rate_hz, rig.block_samples)
        super().__init__(rig, loop, Quantity.DISPLACEMENT)
        self.index = -1
        self.last_blocks: list[dict[Quantity, np.ndarray]] = []

    def hold(self, volts, seconds, ramp=0.5, frequency_hz=0.0, periods=100, timeout=0.0) -> History:
        self.index += 1
        start = self.device.next_sample
        self.loop.set_level(
            LevelCommand(self.index + 1, self.index, volts, start, ramp, 1, frequency_hz, periods, timeout)
        )
        rows, locked_at, reasons = [], None, []
        while self.device.next_sample < start + seconds * self.rate:
            output = self.step()
            time = (output.last_sample + 1 - start) / self.rate
            rows.append((time, 2 * math.pi * output.frequency_hz, output.phase_error))
            if output.lock is not None:
                locked_at = time
            if output.transition is not None:
                reasons.append(output.transition.reason)
            self.last_blocks = [*self.last_blocks[-39:], self.blocks]
        return History(*np.array(rows).T, locked_at, reasons)

    def measured_phase(self):
        """Phase by which force leads displacement over the last 0.8 s, by least squares, degrees."""
        first = self.last_blocks[0][Quantity.FORCE].first_sample
        force = np.concatenate([b[Quantity.FORCE].data[0] for b in self.last_blocks])
        response = np.concatenate([b[Quantity.DISPLACEMENT].data[0] for b in self.last_blocks])
        phase = np.concatenate(
            [
                b[Quantity.FORCE].oscillator.cycles
                + b[Quantity.FORCE].oscillator.frequency_hz * np.arange(b[Quantity.FORCE].samples) / self.rate
                for b in self.last_blocks
            ]
        )
        assert first >= 0
        basis = np.column_stack([f(2 * np.pi * n * phase) for n in range(1, 6) for f in (np.cos, np.sin)])
        c = np.linalg.lstsq(basis, np.column_stack([force, response]), rcond=None)[0]
        complex_ = c[0] - 1j * c[1]
        return math.degrees(np.angle(complex_[0] / complex_[1]))
