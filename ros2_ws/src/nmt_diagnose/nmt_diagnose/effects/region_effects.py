"""Errors of a finite-element model's form: stiffness and mass of its regions, supports that give way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import exp, log

import numpy as np
from scipy.linalg import eigh

from nmt_diagnose.effects.changes import Sites, inverse
from nmt_diagnose.effects.effect import Effect, EffectParameter, Reported, Site
from nmt_diagnose.effects.location import Location
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import MatricesSection, Rig
from nmt_rig.structure_sections import RegionSection

SUPPORT_KEYS = {
    "lateral": ("translation_rows", "compliance_m_n"), "rotation": ("rotation_rows", "rotational_compliance_rad_nm"),
}  # fmt: skip
_UPDATING = "Friswell and Mottershead, Finite Element Model Updating in Structural Dynamics (1995), section 3"


def _regions(rig: Rig) -> Iterator[tuple[str, RegionSection]]:
    if isinstance(rig.structure, MatricesSection):
        yield from rig.structure.regions.items()


def _sites_of(matrix: str, moved: bool) -> Sites:
    """A site for each region that has a matrix of its own; strengths are logarithms of its factor."""

    def sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
        return tuple(
            Site(
                Location("structure", detail=name), {"change": THRESHOLDS.candidates.region_change}, option=name,
                reference=region.moved_kg if moved else 0.0,
                limits={"change": log(THRESHOLDS.candidates.largest_region_factor)},
            )
            for name, region in _regions(rig)
            if getattr(region, matrix) is not None
        )  # fmt: skip

    return sites


def _scaled(rig: Rig, site: Site, key: str, change: float) -> Rig:
    path = ("structure", "regions", site.option, key)
    assert isinstance(rig.structure, MatricesSection)
    return with_value(rig, path, float(getattr(rig.structure.regions[site.option], key)) * exp(change))


def _with_stiffness(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    return _scaled(rig, site, "stiffness_factor", values["change"])


def _with_mass(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    return _scaled(rig, site, "mass_factor", values["change"])


def _mass_report(site: Site, values: Mapping[str, float]) -> Reported:
    factor = exp(values["change"])
    return {"factor": (factor, "1"), "m": (site.reference * (factor - 1.0), "kg")}


def _support_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Supports of finite-element models that are ideal as the model has them."""
    return tuple(
        Site(Location("boundary", detail=f"{name} {option}"), {"compliance": scale}, option=option)
        for name, region in _regions(rig)
        for option, (rows, key) in SUPPORT_KEYS.items()
        if getattr(region, rows) and getattr(region, key) == 0.0
        for scale in [_support_scale(rig, region, getattr(region, rows), operating.omega)]
        if np.isfinite(scale)
    )


def _support_scale(rig: Rig, region: RegionSection, rows: list[int], omega: float) -> float:
    """Compliance of a support that lowers the frequency of the mode next to one by 1 %.

    A mode φ with reactions Y φ loses c |Y φ|² of its ω² to springs of compliance c, to first order.
    """
    section = rig.structure
    assert isinstance(section, MatricesSection)
    stiffness, mass = np.array(section.stiffness_n_m), np.array(section.mass_kg)
    free = np.setdiff1d(np.arange(mass.shape[0]), section.held_rows)
    squares, shapes = eigh(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)])
    mode = int(np.argmin(np.abs(squares - omega**2)))
    reactions = stiffness[rows][:, free] @ shapes[:, mode]
    return float(0.02 * squares[mode] / max(len(region.nodes) * float(reactions @ reactions), 1e-300))


def _with_support(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    name, key = site.location.detail.removesuffix(f" {site.option}"), SUPPORT_KEYS[site.option][1]
    return with_value(rig, ("structure", "regions", name, key), values["compliance"])


_CHANGE = (EffectParameter("change", "1", signed=True),)

REGION_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="local_stiffness", place="structure", equation="factor × the model's stiffness of a region",
        reference=_UPDATING, keys="structure.regions.NAME.stiffness_factor", parameters=_CHANGE,
        sites=_sites_of("stiffness_n_m", moved=False), change=_with_stiffness,
        report=lambda site, values: {"factor": (exp(values["change"]), "1")},
        equivalents={"local_mass": "several modes in a random test"}, alters=("too stiff", "too soft"),
    ),
    Effect(
        name="local_mass", place="structure", equation="factor × the model's mass of a region",
        reference=_UPDATING, keys="structure.regions.NAME.mass_factor", parameters=_CHANGE,
        sites=_sites_of("mass_kg", moved=True), change=_with_mass, report=_mass_report,
        factor=("structure", "mass_factor"),
        equivalents={"local_stiffness": "several modes in a random test"}, alters=("too heavy", "too light"),
    ),
)  # fmt: skip
SUPPORT_EFFECT = Effect(
    name="clamp_compliance", place="boundary",
    equation="springs of 1/compliance together, spread evenly over the length or area of a region that is held, in the "
    "directions of its nodes (or rotations)",
    reference="Gorman, Free Vibration Analysis of Beams and Shafts (1975); " + _UPDATING,
    keys="structure.regions.NAME.compliance_m_n, structure.regions.NAME.rotational_compliance_rad_nm",
    parameters=(EffectParameter("compliance", "m/N or rad/(N m)"),),
    sites=_support_sites, change=_with_support,
    report=lambda site, values: {"k": (inverse(values["compliance"]), "N/m or N m/rad")},
    equivalents={"stinger_stiffness": "a second drive point"}, form="of a finite-element model",
)  # fmt: skip
"""An ideal support that is elastic."""
