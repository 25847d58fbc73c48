"""Settings of the phase loop along a response curve, where it has to hold what is unstable without it.

With the force held and the frequency as input, the lag of a mode answers as (s + δ) / (s² + 2 δ s + D), D = δ dΩ/dϑ
along the curve: D is negative between the folds, and the plant then has a pole in the right half plane. The PI
controller holds it where D + k_p δ + k_i > 0, so both gains are to be as large as filter and dead time allow. The
closed form of the gains grows with the cut-off of the filter; the usual one is chosen against noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import KindOfTest, ResponseCurveTest
from nmt_core.kinds.response_curve import ALONG
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.vocabulary import ControlKind
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.gains import LoopPlant
from nmt_pll.thresholds import CURVE, PHASE

SHORTEST_BLOCK = 0.0025
"""Shortest block that is chosen for such a test, s."""


def with_course(kind: KindOfTest, description: Callable[[], LinearDescription | None]) -> KindOfTest:
    """The kind with what a response curve is stepped along, where that is left to the structure.

    Within the bandwidth of its filter a loop of the lag answers to the beat of two modes; there the lag may turn back
    along the curve, and where it does not, the loop swings.

    Args:
        kind: of the test; another kind stays as it is.
        description: linear description of the rig, which is asked for where it is needed.
    """
    if not isinstance(kind, ResponseCurveTest) or ALONG[kind.along] != "auto":
        return kind
    linear = description()
    return replace(kind, along=ALONG.index("secant" if linear is not None and has_neighbour(linear) else "lag"))


def has_neighbour(linear: LinearDescription) -> bool:
    """Whether another mode that the drive point moves in lies within the filter of the loop."""
    omega = np.asarray(linear.frequencies_rad_s, dtype=np.float64)
    shape = np.abs(linear.shape_matrix[linear.points.index(linear.drive_point)])
    target = linear.target_mode
    near = np.abs(omega - omega[target]) < CURVE.cutoff_share * omega[target]
    near &= shape > CURVE.neighbour_share * shape[target]
    near[target] = False
    return bool(near.any())


def curve_values(
    kind: KindOfTest,
    linear: LinearDescription | None,
    values: Mapping[str, Any],
    control: ControlKind,
    block_duration: float = 0.0,
    latency_blocks: int = 0,
) -> dict[str, Any]:
    """Settings of the loop with those that a response curve needs and that are not given.

    Args:
        kind: of the test; the settings of another kind stay as they are.
        linear: linear description of the rig.
        values: what the rig and the test give.
        control: what is held; at a held response nothing folds over the frequency.
        block_duration: of the blocks, s; 0 = still open.
        latency_blocks: blocks between command and excitation.

    Raises:
        BenchError: the structure feeds the mode's motion.
    """
    chosen = dict(values)
    if not isinstance(kind, ResponseCurveTest) or linear is None:
        return chosen
    defaults = LoopSettings()
    chosen.setdefault("phase_tolerance", CURVE.phase_tolerance)
    # What moves at the rate r with the decay δ has r / δ to go; over a dwell of n periods it goes 2 π n ζ of that.
    ratio = linear.damping_ratios[linear.target_mode]
    if ratio <= 0.0:
        raise BenchError(
            f"Mode {linear.target_mode + 1} feeds its motion (damping {100.0 * ratio:.2g} %), so that it "
            "moves without a force and has no response curve from rest; use --kind self_excited."
        )
    dwell = 2.0 * math.pi * float(chosen.get("dwell_periods", defaults.dwell_periods)) * ratio
    held = control is ControlKind.RESPONSE  # where the force is what settles, by twice the rate of the response
    for name, share in (
        ("amplitude_tolerance", CURVE.held_steadiness if held else CURVE.steadiness),
        ("frequency_tolerance", CURVE.frequency_steadiness),
    ):
        chosen.setdefault(name, max(min(dwell, 1.0) * share, CURVE.least_tolerance))
    if control is not ControlKind.FORCE:
        return chosen
    omega = linear.frequencies_rad_s[linear.target_mode]
    cutoff = CURVE.cutoff_share * omega
    if block_duration > 0.0:  # not more than the dead time lets the closed form have
        margin = float(values.get("delay_margin", defaults.delay_margin))
        allowed = margin / ((PHASE.dead_time_blocks + latency_blocks) * block_duration)
        cutoff = min(cutoff, 3.0 * allowed - LoopPlant.from_description(linear).plant_decay)
    chosen.setdefault("cutoff", max(cutoff, defaults.resolved_cutoff(linear)))
    return chosen
