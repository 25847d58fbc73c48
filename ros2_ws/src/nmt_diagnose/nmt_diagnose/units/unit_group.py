"""What several diagnoses say together: one effect for all or of one unit, means, scatter, the band of the next unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from nmt_core.text.number_words import value_text
from nmt_diagnose.effects.location import effect_words
from nmt_diagnose.ledger.diagnosis import Diagnosis, Value, Verdict
from nmt_diagnose.say.sentences import UNITS_FIRST
from nmt_diagnose.say.words import detail_text
from nmt_diagnose.units.random_effects import Components, Estimate, components

_ALIKE = 0.05
# Of a standard uncertainty, that no two units share.
_LEAST_ALONE = 0.01
_NAMED = {
    "none": "no effect is missing",
    "unknown": "the cause is unknown",
    "channel": "a channel has another unit or sign than the model predicts",
}
_LAW = "law of "
_WITHIN = {"mounting": "re-mounting", "day": "one day to another", "repeat": "one repeat to another", "": "settings"}


@dataclass(frozen=True)
class UnitDiagnosis:
    """A diagnosis, of which unit and at which setting it is."""

    unit: str
    setting: str
    diagnosis: Diagnosis


@dataclass(frozen=True)
class UnitQuantity:
    """A parameter of the model or of an effect over the units.

    Attributes:
        name: of the parameter; of an effect behind its name and place.
        unit_of_value: SI unit.
        of_effect: whether it belongs to an effect that the model lacks.
        initial: value of the model, 0 for effects.
        estimates: by unit and setting.
        components: their means and scatter.
    """

    name: str
    unit_of_value: str
    of_effect: bool
    initial: float
    estimates: tuple[Estimate, ...]
    components: Components


@dataclass(frozen=True)
class UnitGroup:
    """Several units together.

    Attributes:
        units: names, in the order of the table.
        explanations: what each diagnosis named: ``none``, ``unknown``, ``channel`` (another unit or sign), the law of
            a force that no effect has, or effect and place.
        quantities: parameters that two units or more have, those of effects first.
        sentences: the verdict.
        varied: what differs within units: mounting, day, repeat, or nothing.
    """

    units: tuple[str, ...]
    explanations: tuple[tuple[str, str, str], ...]
    quantities: tuple[UnitQuantity, ...]
    sentences: tuple[str, ...]
    varied: str

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        mapping = asdict(self)
        mapping["explanations"] = [
            {"unit": unit, "setting": setting, "explanation": label} for unit, setting, label in self.explanations
        ]
        return mapping


@dataclass(frozen=True)
class StatedValue:
    """A value that one diagnosis states.

    Attributes:
        name, of_effect, initial: of the quantity.
        unit, setting: whose it is.
        value: with its uncertainty and SI unit.
    """

    name: str
    of_effect: bool
    initial: float
    unit: str
    setting: str
    value: Value


def unit_group(diagnoses: Sequence[UnitDiagnosis], varied: str) -> UnitGroup:
    """Put diagnoses of several units together; each has its own ±, and nothing is fitted again."""
    explanations = tuple((each.unit, each.setting, _label(each.diagnosis)) for each in diagnoses)
    stated: list[StatedValue] = []
    for each in diagnoses:
        diagnosis = each.diagnosis
        if diagnosis.verdict is Verdict.EFFECT and diagnosis.ranking:
            words = explanation_words(_label(diagnosis))
            for name, value in diagnosis.ranking[0].parameters.items():
                stated.append(StatedValue(f"{words}: {name}", True, 0.0, each.unit, each.setting, value))
        for row in diagnosis.calibration:
            to = Value(row.to, row.std, row.unit, row.shared_std)
            stated.append(StatedValue(row.name, False, row.start, each.unit, each.setting, to))
    channels = [
        f"{each.unit}{f', {each.setting}' if each.setting else ''}: {sentence}"
        for each, (_, _, label) in zip(diagnoses, explanations, strict=True)
        if label == "channel"
        for sentence in each.diagnosis.sentences[:-1]
    ]
    return grouped(explanations, [*of_explanations(explanations), *channels], stated, varied)


def grouped(
    explanations: Sequence[tuple[str, str, str]], sentences: Sequence[str], stated: Sequence[StatedValue], varied: str
) -> UnitGroup:
    """Components of every quantity that two units or more have.

    Args:
        explanations: unit, setting, and what was named.
        sentences: on the explanations.
        stated: all values.
        varied: what differs within units.
    """
    by_name: dict[str, list[StatedValue]] = {}
    for each in stated:
        if math.isfinite(each.value.value) and math.isfinite(each.value.std) and each.value.std > 0.0:
            by_name.setdefault(each.name, []).append(each)
    compared = [values for values in by_name.values() if len({each.unit for each in values}) > 1]
    quantities = []
    for values in compared:
        first, estimates = values[0], tuple(_estimate(each) for each in values)
        quantities.append(
            UnitQuantity(
                first.name, first.value.unit, first.of_effect, first.initial, estimates,
                components(estimates, len(compared)),
            )
        )  # fmt: skip
    quantities.sort(key=lambda quantity: not quantity.of_effect)
    units = tuple(dict.fromkeys(unit for unit, _, _ in explanations))
    text = (*sentences, *(s for q in quantities for s in _of_quantity(q, varied)))
    return UnitGroup(units, tuple(explanations), tuple(quantities), text, varied)


def explanation_words(label: str) -> str:
    """What a diagnosis named, for people: ``cubic_stiffness@2`` is cubic stiffness at point 2."""
    if label.startswith(_LAW):
        return f"a force like {label.removeprefix(_LAW)}, which no effect of the library explains"
    if label == "channel":
        return _NAMED[label]
    effect, _, where = label.partition("@")
    places = [detail_text(part) for part in where.split(" + ")] if where else []
    at = " and ".join(dict.fromkeys(place for place in places if place))
    return effect_words(effect) + (f" at {at}" if at else "")


def _label(diagnosis: Diagnosis) -> str:
    if diagnosis.law is not None and diagnosis.law_leads:
        return _LAW + " and ".join(f"{law.family} ({detail_text(law.place)})" for law in diagnosis.law.laws)
    if diagnosis.sentences[-1:] == (UNITS_FIRST,):
        return "channel"
    if diagnosis.verdict is not Verdict.EFFECT or not diagnosis.ranking:
        return "unknown" if diagnosis.verdict.gap else "none"
    head = diagnosis.ranking[0]
    return f"{head.effect}@{head.detail or head.place}"


def _estimate(stated: StatedValue) -> Estimate:
    value = stated.value
    alone = math.sqrt(max(value.std**2 - value.shared_std**2, (_LEAST_ALONE * value.std) ** 2))
    return Estimate(stated.unit, stated.setting, value.value, alone, value.shared_std)


def of_explanations(explanations: Sequence[tuple[str, str, str]]) -> list[str]:
    """Whether the units have one explanation, in sentences."""
    units = tuple(dict.fromkeys(unit for unit, _, _ in explanations))
    by_unit = {unit: sorted({label for name, _, label in explanations if name == unit}) for unit in units}
    labels = {label for found in by_unit.values() for label in found}
    if len(labels) == 1:
        (label,) = labels
        words = {"channel": _NAMED["channel"], "none": "none lacks an effect", "unknown": "none has a known cause"}
        kind = "force" if label.startswith(_LAW) else "effect"
        return [f"All {len(units)} units: {words.get(label) or f'one {kind} for all, {explanation_words(label)}'}."]
    sentences = []
    for label in sorted(labels):
        having = [unit for unit, found in by_unit.items() if label in found]
        named = _NAMED.get(label) or explanation_words(label)
        sentences.append(f"{len(having)} of {len(units)} units: {named} ({', '.join(having)}).")
    return sentences


def _of_quantity(quantity: UnitQuantity, varied: str) -> list[str]:
    """Sentences on a parameter."""
    found, unit = quantity.components, quantity.unit_of_value
    sentences = [
        f"{odd.unit} differs from its sisters in {quantity.name} by "
        f"{value_text(odd.difference, odd.difference_std, unit)} (p = {odd.p:.1g})."
        for odd in found.odd
    ]
    if found.within_std is not None and found.within_std > abs(found.mean - quantity.initial) > 0.0:
        what = "the effect" if quantity.of_effect else "its distance from the model"
        sentences.append(f"{quantity.name}: the scatter of {_WITHIN[varied]} is larger than {what}.")
    elif found.within_std is not None and found.within_std > found.between_std:
        sentences.append(f"{quantity.name}: the scatter of {_WITHIN[varied]} is larger than that between units.")
    if quantity.of_effect and not found.odd and found.heterogeneity_p > _ALIKE:
        sentences.append(
            f"{quantity.name}: one value for all within its ±, {value_text(found.mean, found.mean_std, unit)}."
        )
    return sentences
