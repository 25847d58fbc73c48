"""Effects over time: what drifts while the tests go on, and how the loop stands."""

from __future__ import annotations

from nmt_diagnose.effects.changes import OPTION, added, has_friction
from nmt_diagnose.effects.effect import Effect, EffectParameter, Site
from nmt_diagnose.effects.location import Location
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_rig.rig import Rig


def _preload_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    if not has_friction(rig):
        return ()
    return tuple(
        Site(Location("time", detail=detail), {"rate": 0.05 / max(length, 1.0)}, option=key)
        for detail, length, key in (
            ("time", operating.duration_s, "slip_force_per_s"),
            ("cycles", operating.cycles, "slip_force_per_cycle"),
        )
    )


def _temperature_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    return (Site(Location("time"), {"rate": 0.005 / max(operating.duration_s, 1.0)}, option="stiffness_per_s"),)


TIME_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="preload_loss",
        place="time",
        equation="slip force times (1 + rate t), t in s or drive periods",
        reference="Brake (ed.), The Mechanics of Jointed Structures (2018)",
        keys="drift.slip_force_per_s, drift.slip_force_per_cycle",
        parameters=(EffectParameter("rate", "1/s or 1/period", signed=True),),
        sites=_preload_sites,
        change=added("rate", "drift", OPTION),
    ),
    Effect(
        name="temperature_drift",
        place="time",
        equation="K (1 + rate t)",
        reference="Xia et al., J. Civ. Struct. Health Monit. 2 (2012) 29",
        keys="drift.stiffness_per_s",
        parameters=(EffectParameter("rate", "1/s", signed=True),),
        sites=_temperature_sites,
        change=added("rate", "drift", OPTION),
    ),
)

CONTROLLER_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="phase_offset",
        place="controller",
        equation="the loop holds arg F − arg v = φ₀",
        reference="Peter and Leine, Mech. Syst. Signal Process. 96 (2017) 139",
        keys="pll.phase_offset_rad",
        parameters=(EffectParameter("phi0", "rad", signed=True),),
        sites=lambda rig, operating: (Site(Location("controller"), {"phi0": 0.02}),),
        change=added("phi0", "pll", "phase_offset_rad"),
        equivalents={"loop_latency": "a phase-locked test on another mode"},
    ),
    Effect(
        name="loop_latency",
        place="controller",
        equation="the loop holds arg F − arg v = ω τ",
        reference="Peter and Leine, Mech. Syst. Signal Process. 96 (2017) 139",
        keys="pll.loop_latency_s",
        parameters=(EffectParameter("tau", "s", signed=True),),
        sites=lambda rig, operating: (Site(Location("controller"), {"tau": 0.02 / operating.omega}),),
        change=added("tau", "pll", "loop_latency_s"),
        equivalents={"phase_offset": "a phase-locked test on another mode"},
    ),
)
