"""Changes and places that effects share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

from nmt_diagnose.effects.effect import Site
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import value_at, with_element, with_value
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.rig import BeamSection, Rig

Change: TypeAlias = Callable[[Rig, Site, Mapping[str, float]], Rig]
Sites: TypeAlias = Callable[[Rig, OperatingRange], tuple[Site, ...]]
OPTION = "<option>"
"""In a path: the option of the site."""


def with_local(rig: Rig, section: type[ElementSection], site: Site, **settings: object) -> Rig:
    """The rig with one more local element at a site; ``settings`` are keys of its section."""
    if site.other_point:
        settings["other_point"] = site.other_point
    if site.option == "rotation":
        settings["rotation"] = True
    element = section.model_construct(kind=section.kind_name(), point=site.point, **settings)  # type: ignore[arg-type]
    return with_element(rig, element)  # type: ignore[arg-type]


def local_element(section: type[ElementSection], keys: Mapping[str, str], **settings: object) -> Change:
    """Change that adds one local element; ``keys`` maps parameters to keys of its section, ``settings`` are further."""

    def change(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
        return with_local(rig, section, site, **{key: values[name] for name, key in keys.items()}, **settings)

    return change


def added(name: str, *path: str) -> Change:
    """Change that adds a parameter to the number at a key of the rig file; a missing number counts as 0."""

    def change(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
        key_path = tuple(site.option if part == OPTION else part for part in path)
        return with_value(rig, key_path, float(value_at(rig, key_path) or 0.0) + values[name])

    return change


def has_friction(rig: Rig) -> bool:
    """Whether the model has friction."""
    return any(element.friction for element in rig.local_elements)


def is_clamped(rig: Rig) -> bool:
    """Whether the model is a beam with a clamp."""
    return isinstance(rig.structure, BeamSection) and "clamped" in rig.structure.boundary


def inverse(value: float) -> float:
    """1/value, infinite at 0: what is reported for a strength that is the inverse of a quantity."""
    return 1.0 / value if value else float("inf")
