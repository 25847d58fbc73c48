"""What the registry of local elements gives to effects, law and blind cases, as it was when it stood in seven places.

``python tests/diagnose/test_registry_of_forces.py`` in ``./nmt shell`` writes the file; new elements need no entry.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnose.predicted_tests import chain

from nmt_blind.cases.injected_effects import INJECTED_EFFECTS, KNOWN, InjectedEffect
from nmt_blind.cases.operating import Operating
from nmt_diagnose.effects.effect import Effect
from nmt_diagnose.effects.library import library
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.law.law_blocks import Block, blocks, blocks_of_records
from nmt_diagnose.law.law_elements import element_of, not_written
from nmt_diagnose.law.law_words import family, formula
from nmt_diagnose.law.reading import LawTerm, LocalLaw
from nmt_diagnose.law.terms import Term, force_of
from nmt_diagnose.search.law_starts import effects_of_law
from nmt_rig.model.element_uses import LawForm
from nmt_rig.model.local_elements import SECTIONS
from nmt_rig.model.local_elements.attachments import AttachmentSection
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.rig import Rig, load_rig

GOLDEN = Path(__file__).parent / "registry_of_forces.json"
OMEGA, LARGEST = 157.0, 1.3e-3
TERMS = [
    *(("power", (n,)) for n in (2.0, 3.0, 5.0)), *(("speed", (n,)) for n in (1.5, 2.0, 3.0)), ("amplitude", (2.0,)),
    ("gap", (4e-4,)), ("gap damping", (4e-4,)), ("slider", (2e-4,)), ("slack slider", (2e-4, 0.3)),
    ("bristle", (2e-4,)), ("weakening bristle", (2e-4, 0.05)), ("friction", (0.01,)),
    ("weakening friction", (0.01, 0.05)), ("brake", (0.07,)),
    *((kind, (4e-4, side)) for kind in ("stop", "stop damping") for side in (1.0, -1.0)),
]  # fmt: skip


def operating_range(rig: Rig) -> OperatingRange:
    points = rig.structure.points
    some = {point: 1e-3 * (1.0 + 0.1 * point) for point in points}
    return OperatingRange(
        omega=OMEGA, displacement=some, rotation=dict(some), effective_mass={p: 0.4 + 0.01 * p for p in points},
        effective_inertia=dict(some), pairs={(1, 2): (2e-4, 0.3)}, coil_displacement=1e-3, total_mass=2.0, voltage=1.0,
        force=3.0, channels={}, channels_low={}, duration_s=60.0, cycles=900.0,
    )  # fmt: skip


def motion_of(rig: Rig) -> Operating:
    some = {point: 1e-3 * (1.0 + 0.1 * point) for point in rig.structure.points}
    stiffness = {point: 5e3 / (1.0 + 0.1 * point) for point in some}
    return Operating(OMEGA, some, dict(some), dict(some), stiffness, dict(stiffness), {}, {}, {}, 1.0, 60.0, 900.0)


def of_effect(effect: Effect, rigs: dict[str, Rig]) -> dict[str, Any]:
    """Everything that an effect of the structure is, with what it does to two rigs."""
    found: dict[str, Any] = {
        key: getattr(effect, key) for key in ("place", "equation", "reference", "keys", "equivalents", "form")
    }
    found["parameters"] = [asdict(parameter) for parameter in effect.parameters]
    for name, rig in rigs.items():
        sites = effect.sites(rig, operating_range(rig))
        for site in (*sites[:1], *sites[-1:]):
            values = {key: 1.7 * scale for key, scale in site.scales.items()}
            changed = effect.apply(rig, site, values)
            element = [
                item.model_dump(exclude_unset=True) for item in changed.local_elements[len(rig.local_elements) :]
            ]
            stated = {key: value for key, value in vars(site).items() if value not in ("", 0, -1, {}, 0.0)}
            found[f"{name} {site.location}"] = [stated, element, effect.reported(site, values)]
    return found


def of_term(kind: str, parameters: tuple[float, ...]) -> dict[str, Any]:
    """Everything that a term of the law is, along one motion."""
    turn = 2.0 * np.pi * np.arange(512) / 512
    x, v = LARGEST * (np.cos(turn) + 0.1 * np.sin(2 * turn)), LARGEST * OMEGA * (0.2 * np.cos(2 * turn) - np.sin(turn))
    term = Term(kind, *parameters)
    stated = LawTerm(kind, parameters, 3e2, 1.0, term.unit)
    law = LocalLaw(3, 2, "", (stated,), LARGEST, (), ())
    element = element_of(stated, law)
    return {
        "force": term.force(x[np.newaxis], v[np.newaxis])[0, 5::64].tolist(),
        "unit": term.unit,
        "signed": term.signed,
        "family": family([(term, 1.0)]) if not kind.endswith(" damping") else "",
        "formula": formula(term),
        "element": None if element is None else element.model_dump(exclude_unset=True),
        "not written": not_written([law]),
        "starts": effects_of_law(law) if kind != "brake" else [],
    }


def of_truth(truth: InjectedEffect, rigs: dict[str, Rig]) -> dict[str, Any]:
    """A truth of blind cases at all its spots on two rigs."""
    found: dict[str, Any] = {key: getattr(truth, key) for key in ("place", "unit", "signed", "known")}
    for name, rig in rigs.items():
        motion = motion_of(rig)
        for spot in truth.spots(rig)[-2:]:
            value = truth.value(rig, motion, spot, 1.3)
            edits = [asdict(edit) for edit in truth.edits(rig, motion, spot, value)]
            limit = truth.limit(rig, motion, spot)
            found[f"{name} {spot.label}"] = [value, edits, truth.figures(rig, motion, spot, value), min(limit, 1e99)]
    return found


def of_block(block: Block) -> list[Any]:
    return [block.name, block.refined, block.contact, [[t.kind, t.first, t.second] for t in block.terms]]


def key_of(block: Block) -> str:
    """What it consists of, without sizes."""
    terms = [f"{t.kind} {t.first if t.kind == 'power' else np.sign(t.second):g}" for t in block.terms]
    return f"{block.name}: {', '.join(dict.fromkeys(terms))}"


def registry() -> dict[str, Any]:
    """All that effects, law and blind cases know of local elements."""
    rigs = {"chain": chain(), "beam": load_rig("beam")}
    turn = 2.0 * np.pi * np.arange(512) / 512
    along = blocks(LARGEST * np.cos(turn)[np.newaxis], OMEGA * LARGEST * np.sin(turn)[np.newaxis])
    effects = [effect for effect in library() if effect.place in ("structure", "joint")]
    truths = [truth for truth in KNOWN if truth.place in ("structure", "joint")]
    open_truths = [INJECTED_EFFECTS[name] for name in ("eddy_brake", "backlash_damper", "fractional_damper")]
    found = {
        "effects": {f"{effect.name} {effect.form or effect.keys}": of_effect(effect, rigs) for effect in effects},
        "terms": {f"{kind} {parameters}": of_term(kind, parameters) for kind, parameters in TERMS},
        "blocks": {key_of(some[0]): [of_block(some[0]), of_block(some[-1]), len(some)] for some in along.values()},
        "truths": {truth.name: of_truth(truth, rigs) for truth in [*truths, *open_truths]},
        "order": {
            "effects": list(dict.fromkeys(effect.name for effect in library())),
            "truths": list(INJECTED_EFFECTS),
        },
    }  # fmt: skip
    plain: dict[str, Any] = json.loads(json.dumps(found, default=str))
    return plain


def compared(found: Any, golden: Any, where: str) -> None:
    """What stands in the file is found with the same values; there may be more."""
    if isinstance(golden, dict):
        for key, value in golden.items():
            compared(found[key], value, f"{where}: {key}")
    elif isinstance(golden, list) and where != ": order":
        assert len(found) == len(golden), where
        for number, (one, other) in enumerate(zip(found, golden, strict=True)):
            compared(one, other, f"{where}[{number}]")
    elif isinstance(golden, float):
        assert found == pytest.approx(golden, rel=1e-12, abs=1e-18), where
    else:
        assert found == golden, where


def test_effects_terms_and_truths_are_what_they_were() -> None:
    found, golden = registry(), json.loads(GOLDEN.read_text(encoding="utf-8"))
    for name, names in golden.pop("order").items():
        assert [one for one in found["order"][name] if one in names] == names
    compared(found, golden, "registry")


@pytest.mark.parametrize("section", SECTIONS)
def test_what_leaves_an_element_out_is_told(section: type[ElementSection]) -> None:
    """Each use has the element or its reason, not both."""
    assert bool(section.effect) != bool(section.without_effect)
    assert bool(section.law) != bool(section.without_law)
    if issubclass(section, AttachmentSection) or section.element is None:
        return
    element = section.element
    switched = "sliders" in vars(element) or "contacts" in vars(element)
    covered = bool(element.degree or element.samples[0] or switched)
    assert covered != bool(section.without_harmonic_balance)


@pytest.mark.parametrize("section", [section for section in SECTIONS if section.effect is not None])
def test_an_effect_is_of_keys_of_its_element(section: type[ElementSection]) -> None:
    assert section.effect is not None
    keys = list(section.effect.parameters.values())
    assert keys == section.own_keys()
    assert section.effect.name in [effect.name for effect in library()]
    assert section.effect.name in [truth.name for truth in KNOWN]


@pytest.mark.parametrize("form", [form for section in SECTIONS for form in section.law], ids=lambda form: form.formula)
def test_a_form_is_tried_along_levels(form: LawForm) -> None:
    turn = 2.0 * np.pi * np.arange(512) / 512
    tried_along = blocks_of_records if form.of_records else blocks
    along = tried_along(LARGEST * np.cos(turn)[np.newaxis], OMEGA * LARGEST * np.sin(turn)[np.newaxis])
    tried = [block for some in along.values() for block in some if any(term.form is form for term in block.terms)]
    assert tried
    # The force of a strength is so many times that of one, along arrays as at each sample.
    term = next(term for term in tried[0].terms if term.form is form)
    x, v = LARGEST * np.cos(turn), -LARGEST * OMEGA * np.sin(turn)
    assert term.section is not None
    element = term.section.element(np.ones(1), *term.values(3.0).values())
    assert 3.0 * term.force(x, v) == pytest.approx(force_of(element, x, v), rel=1e-9, abs=1e-12)
    if not issubclass(term.section, AttachmentSection) and not element.sliders and not element.contacts:
        single = [element.response(*element.values, *at)[0] for at in zip(x, v, strict=True)]
        assert force_of(element, x, v) == pytest.approx(np.array(single), rel=1e-12)


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(registry(), ensure_ascii=False) + "\n", encoding="utf-8")
