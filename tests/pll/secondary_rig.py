"""The shipped rig with a strong cubic spring under the loop of secondary resonances, and its solutions by a balance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from independent.harmonic_continuation import CubicModes, PhaseBranch, Solution
from pll.stepped_loop import SteppedLoop

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import LevelCommand
from nmt_core.messages.secondary_resonance import resonance_named
from nmt_core.vocabulary import ControlKind, LoopState, TestKind
from nmt_pll.level_loop import LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.secondary.secondary_loop import SecondaryResonanceLoop
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig

OMEGA, FORCE, LENGTH = math.sqrt(16000.0), 16.0, 1.0e-3
"""rad/s, N and m that are units of ẍ + 0.02 ẋ + x + x³ = F cos Ωt."""
_ONE = np.array([1.0])


def dimensionless(name: str) -> CubicModes:
    """That equation with the orders of a resonance."""
    k, nu, _ = resonance_named(name)
    return CubicModes(_ONE, np.array([0.01]), _ONE, _ONE, 1.0, 25, nu, k)


@cache
def branch(name: str) -> tuple[PhaseBranch, tuple[Solution, ...]]:
    """Solutions with the lag held: 3:1 from F = 0.2 to 1.05, 1:3 from the tip at F = 1 by the least force and back."""
    system = dimensionless(name)
    series = np.zeros((system.orders.size, 1), complex)
    if name == "3:1":
        series[0, 0], series[1, 0] = 0.21, 0.115j
        found = PhaseBranch(system, 270.0, 1.0)
        return found, tuple(found.follow(Solution(series, 0.345, 0.2), 0.3, lambda item: item.force > 1.05))
    series[0, 0], series[1, 0] = 2.33 * np.exp(-1j * math.pi / 6.0), -0.088
    found = PhaseBranch(system, 90.0, 1.0)
    return found, tuple(found.follow(Solution(series, 2.287, 1.0), -0.1, lambda item: item.force > 1.05))


def at_force(name: str, force: float) -> list[Solution]:
    """All solutions at a dimensionless force, the largest response first."""
    held, found = branch(name)
    forces = np.array([item.force for item in found])
    crossed = np.flatnonzero(np.diff(np.sign(forces - force)))
    solutions = [held.at_force(found[place], force) for place in crossed]
    return sorted(solutions, key=lambda item: -abs(held.system.drive_point(item.series, held.system.response_order)))


@dataclass
class Outcome:
    """What a level brought."""

    lock: LockWindow | None = None
    outputs: list[LoopOutput] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)


class SecondaryRig(SteppedLoop):
    """Rig and loop, block by block; forces and lengths in the units above."""

    def __init__(
        self,
        name: str,
        overrides: Sequence[str] = (),
        latency_blocks: int = 0,
        block_samples: int = 200,
        **settings: float,
    ) -> None:
        rig = load_rig("strong_cubic", [f"block_samples={block_samples}", *overrides])
        self.resonance = resonance_named(name)
        self.linear = linear_description(rig)
        values = LoopSettings(latency_blocks=latency_blocks, guard_high=4.0, force_floor=1e-3, **settings)
        loop = SecondaryResonanceLoop(self.linear, values, rig.sample_rate_hz, rig.block_samples)
        super().__init__(rig, loop, Quantity.DISPLACEMENT, latency_blocks)
        self.sequence = 0

    def run_level(
        self, force: float, seconds: float = 60.0, start: float = 0.0, release: float = 0.0, index: int | None = None
    ) -> Outcome:
        """Until the window is over or the lock is lost; ``start``: excitation frequency over the linear mode's."""
        self.sequence += 1
        self.loop.set_level(
            LevelCommand(
                sequence=self.sequence,
                index=self.sequence - 1 if index is None else index,
                amplitude=force * FORCE,
                apply_at_sample=self.next_sample,
                ramp=0.5,
                control=ControlKind.FORCE,
                frequency_hz=start * OMEGA / (2.0 * math.pi),
                window_periods=60,
                timeout=seconds,
                test=TestKind.SECONDARY_RESONANCE,
                response_order=self.resonance.response_order,
                force_order=self.resonance.force_order,
                release=release * LENGTH,
            )
        )
        outcome, end = Outcome(), self.next_sample + round((seconds + 10.0) * self.device.sample_rate)
        while self.next_sample < end:
            output = self.step()
            assert output is not None
            outcome.outputs.append(output)
            if output.transition is not None:
                outcome.reasons.append(output.transition.reason)
            outcome.lock = output.lock or outcome.lock
            if outcome.lock is not None and self.next_sample >= outcome.lock.first_sample + outcome.lock.samples:
                break
            if output.state == LoopState.LOCK_LOST:
                break
        return outcome

    def base_frequency(self, outcome: Outcome) -> float:
        """Mean base frequency over the window, over that of the linear mode."""
        assert outcome.lock is not None, outcome.reasons
        inside = [item.frequency_hz for item in outcome.outputs if item.last_sample >= outcome.lock.first_sample]
        return 2.0 * math.pi * float(np.mean(inside)) / self.resonance.force_order / OMEGA
