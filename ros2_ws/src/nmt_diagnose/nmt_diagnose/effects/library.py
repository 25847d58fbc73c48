"""All effects that the diagnosis knows."""

from __future__ import annotations

import copyreg
from functools import cache
from typing import Any

from nmt_core.errors import BenchError
from nmt_diagnose.effects.boundary_effects import BOUNDARY_EFFECTS, JOINT_EFFECTS
from nmt_diagnose.effects.effect import Candidate, Effect
from nmt_diagnose.effects.exciter_effects import EXCITER_EFFECTS
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.region_effects import REGION_EFFECTS, SUPPORT_EFFECT
from nmt_diagnose.effects.sensor_effects import SENSOR_EFFECTS
from nmt_diagnose.effects.structure_effects import STRUCTURE_EFFECTS
from nmt_diagnose.effects.time_effects import CONTROLLER_EFFECTS, TIME_EFFECTS
from nmt_rig.rig import Rig

ALIKE_AT_EVERY_LEVEL = frozenset({
    "added_stiffness", "viscous_damping", "structural_damping", "added_mass", "missing_mode", "local_stiffness",
    "local_mass",
    "clamp_compliance", "stinger_stiffness", "source_impedance",
    "force_gain", "force_cell_mass", "response_gain", "transverse_sensitivity", "sensor_mass", "channel_skew",
    "shared_delay", "drive_hold", "low_pass", "charge_high_pass", "clock_error", "phase_offset", "loop_latency",
})  # fmt: skip
"""Effects that change every level by the same factor or phase: one found at a low level says nothing of growth."""


@cache
def library() -> tuple[Effect, ...]:
    """All effects, place by place."""
    return (
        *STRUCTURE_EFFECTS,
        *REGION_EFFECTS,
        *BOUNDARY_EFFECTS,
        SUPPORT_EFFECT,
        *JOINT_EFFECTS,
        *TIME_EFFECTS,
        *EXCITER_EFFECTS,
        *SENSOR_EFFECTS,
        *CONTROLLER_EFFECTS,
    )


def effect_named(name: str) -> Effect:
    """The first effect of a name.

    Raises:
        BenchError: there is none.
    """
    for effect in library():
        if effect.name == name:
            return effect
    raise BenchError(f"there is no effect {name}; known are {', '.join(effect.name for effect in library())}.")


def effect_numbered(number: int) -> Effect:
    """Effect by its place in the library: two of them may share a name, as they are the same on different models."""
    return library()[number]


def _reduced(effect: Effect) -> str | tuple[Any, ...]:
    """An effect of the library goes to another process by its number; its functions need not be of a module."""
    for number, known in enumerate(library()):
        if known is effect:
            return effect_numbered, (number,)
    return effect.__reduce_ex__(2)


copyreg.pickle(Effect, _reduced)


def candidates(rig: Rig, operating: OperatingRange, without: tuple[str, ...] = ()) -> tuple[Candidate, ...]:
    """All effects at all their places on a rig, except those named in ``without``."""
    return tuple(
        Candidate(effect, site)
        for effect in library()
        if effect.name not in without
        for site in effect.sites(rig, operating)
    )
