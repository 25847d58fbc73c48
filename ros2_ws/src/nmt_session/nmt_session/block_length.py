"""Block length of a simulated phase resonance test, from the mode's frequency and the loop's bandwidth.

In lockstep a block costs a fixed wall time, almost whatever its length. But the loop's dead time is a block and a half:
longer blocks leave it less bandwidth, and each level takes longer to settle. The choice is the longest block that costs
little bench time; see the page on the phase-locked loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from nmt_core.messages.linear_description import LinearDescription
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.gains import LoopPlant
from nmt_pll.thresholds import PHASE

USUAL = 0.02  # s, the shortest that is chosen
_STEP = 0.01  # s
_LONGEST = 0.05  # s
_SHARE = 0.03  # of a level's bench time that longer blocks may cost
_SETTLED = -math.log(0.05)  # time constants until 5 % are left
_LEAST_DWELL = 4  # blocks in which the loop judges a lock
_DECISION = 0.1  # s between two decisions of the sequencer
_LEAST_TICK = 2  # blocks
_MOST_BYTES = 65_536  # of a message


@dataclass(frozen=True)
class LevelTime:
    """What a level's bench time is made of, besides the time to settle.

    Attributes:
        ramp: half-cosine from the level before, s.
        window: length of the window, s.
        holds_amplitude: whether a controller holds force or response.
    """

    ramp: float
    window: float
    holds_amplitude: bool = False


@dataclass(frozen=True)
class BlockChoice:
    """A block length and why.

    Attributes:
        block_samples: samples a block.
        tick_blocks: blocks between two decisions of the sequencer.
        reason: one sentence for the report.
    """

    block_samples: int
    tick_blocks: int
    reason: str


def choose_block(
    linear: LinearDescription,
    settings: LoopSettings,
    level: LevelTime,
    sample_rate: float,
    channels: int,
    shortest: float = 0.0,
) -> BlockChoice:
    """The longest block, in steps of 10 ms from 20 to 50 ms, that lengthens a level by 3 % at most.

    Args:
        linear: linear description of the rig.
        settings: of the loop.
        level: ramp and window of a level.
        sample_rate: Hz.
        channels: of the largest message.
        shortest: of the blocks of a loop that needs all the bandwidth it asks for, s; 0 = it does not.
    """
    if shortest > 0.0:
        return _with_all_bandwidth(linear, settings, sample_rate, shortest)
    frequency = linear.frequencies_rad_s[linear.target_mode] / (2.0 * math.pi)
    longest = min(
        _LONGEST,
        settings.dwell_periods / (_LEAST_DWELL * frequency),
        _MOST_BYTES / (8.0 * channels * sample_rate),
    )
    usual = settling_time(linear, settings, level, USUAL)
    whole = level.ramp + level.window + usual + settings.dwell_periods / frequency
    chosen, cost = USUAL, 0.0
    for steps in range(1, math.floor((longest - USUAL) / _STEP + 1e-9) + 1):
        length = USUAL + steps * _STEP
        share = (settling_time(linear, settings, level, length) - usual) / whole
        if share <= _SHARE:
            chosen, cost = length, share
    bandwidth, allowed = wanted_bandwidth(linear, settings), allowed_bandwidth(settings, chosen)
    reason = f"loop bandwidth {min(bandwidth, allowed):.3g} rad/s for the mode at {frequency:.4g} Hz"
    if allowed < bandwidth:
        reason += f" ({bandwidth:.3g} without the dead time of {PHASE.dead_time_blocks:g} blocks)"
    if chosen > USUAL:
        reason += f"; a level takes {100.0 * cost:.1f} % longer than with blocks of {1e3 * USUAL:g} ms"
    else:
        reason += "; longer blocks would cost more bench time"
    return BlockChoice(max(2, round(chosen * sample_rate)), tick_blocks(chosen), f"chosen: {reason}")


def _with_all_bandwidth(
    linear: LinearDescription, settings: LoopSettings, sample_rate: float, shortest: float
) -> BlockChoice:
    """The longest block with which the dead time leaves the loop the bandwidth that its closed form asks for."""
    bandwidth = wanted_bandwidth(linear, settings)
    length = min(max(allowed_bandwidth(settings, 1.0) / bandwidth, shortest), USUAL)
    samples = max(2, int(length * sample_rate))
    reason = (
        f"the loop has to hold motions that are unstable without it and should have a bandwidth of {bandwidth:.3g} "
        f"rad/s; its dead time of {PHASE.dead_time_blocks:g} blocks allows "
        f"{allowed_bandwidth(settings, samples / sample_rate):.3g} rad/s"
    )
    return BlockChoice(samples, tick_blocks(samples / sample_rate), f"chosen: {reason}")


def tick_blocks(length: float) -> int:
    """Blocks between two decisions of the sequencer, about a tenth of a second, for blocks of ``length`` s."""
    return max(_LEAST_TICK, round(_DECISION / length))


def wanted_bandwidth(linear: LinearDescription, settings: LoopSettings) -> float:
    """Bandwidth that the closed form of the gains asks for, rad/s: all poles of the loop at one place."""
    return (LoopPlant.from_description(linear).plant_decay + settings.resolved_cutoff(linear)) / 3.0


def allowed_bandwidth(settings: LoopSettings, length: float) -> float:
    """Bandwidth that the dead time of blocks of ``length`` s allows, rad/s."""
    return settings.delay_margin / ((PHASE.dead_time_blocks + settings.latency_blocks) * length)


def settling_time(linear: LinearDescription, settings: LoopSettings, level: LevelTime, length: float) -> float:
    """Bench time from the end of the ramp until 5 % of a step are left and the sequencer has decided, s.

    The slower of loop and structure counts; a controlled amplitude settles after them.
    """
    allowed = allowed_bandwidth(settings, length)
    slowest = min(allowed, wanted_bandwidth(linear, settings), LoopPlant.from_description(linear).plant_decay)
    settled = _SETTLED / slowest
    if level.holds_amplitude:
        settled += _SETTLED / (PHASE.amplitude_bandwidth_share * allowed)
    return settled + 1.5 * tick_blocks(length) * length
