"""Cases of the blind check, drawn from a seed: what is true of each, before anything is measured."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from nmt_blind.cases.injected_effects import INJECTED_EFFECTS, KNOWN, NEAR_TWINS, OPEN, InjectedEffect
from nmt_blind.cases.laboratory import TrialError
from nmt_blind.cases.laboratory_rig import Converters
from nmt_blind.cases.operating import Operating
from nmt_blind.cases.priors import draw_shifts
from nmt_blind.cases.rig_edits import Edit, with_edits
from nmt_blind.cases.tolerances import check_tolerances, draw_chain
from nmt_core.errors import BenchError
from nmt_rig.rig import Rig

SIZES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Of single effects, see `InjectedEffect.natural`: from what noise hides to what anyone sees."""
TWIN_SIZES = (0.1, 0.3, 1.0)
"""Of effects with a near twin: what is strong enough is distinguished by anyone."""
UNNAMED_SIZES = (0.3, 1.0, 3.0, 10.0)
"""Of effects without a name: a named relative takes most of a weak one."""
COMPOUND_SIZES = (
    (0.1, 0.1), (0.1, 1.0), (1.0, 0.1), (0.3, 0.3), (0.3, 3.0), (3.0, 0.3), (1.0, 1.0), (3.0, 3.0), (10.0, 10.0),
)  # fmt: skip
"""Of each of two effects."""

MIXTURE: dict[str, int] = {"null": 5, "effect": 8, "open": 2, "compound": 2, "twin": 1, "withheld": 2}
"""Kinds of case and how many of twenty."""

# Of the cases whose effect is not withheld, this share has another effect withheld: the flag alone says nothing.
_OTHERS_WITHHELD = 0.2


@dataclass(frozen=True)
class TrueEffect:
    """An effect that a case has.

    Attributes:
        name: of the truth.
        place: where it acts.
        detail: point, channel or form.
        size: multiple of its natural value that was drawn.
        value: in `unit`, with its sign; less than `size` says where no rig has more.
        known: the library is supposed to have it.
        figures: true values of the parameters that a diagnosis reports.
    """

    name: str
    place: str
    detail: str
    size: float
    value: float
    unit: str
    known: bool
    figures: Mapping[str, float]

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {**values, "figures": dict(self.figures)}


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        number: from 1.
        kind: null, effect, open, compound, twin or withheld.
        effects: what is true.
        withheld: effects that the library is to do without, joined by commas; empty = none.
        shifted: parameters of the model are off.
        edits: all changes of the model's rig file.
        noise_seed: seed of noise and random drive.
        converters: of the laboratory; None = the bench's own simulator.
    """

    number: int
    kind: str
    effects: tuple[TrueEffect, ...]
    withheld: str
    shifted: bool
    edits: tuple[Edit, ...]
    noise_seed: int
    converters: Converters | None = None

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.number:04d}"

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "case": self.name,
            "kind": self.kind,
            "effects": [effect.to_mapping() for effect in self.effects],
            "withheld": self.withheld,
            "shifted": self.shifted,
            "edits": [edit.to_mapping() for edit in self.edits],
            "noise_seed": self.noise_seed,
            "converters": None if self.converters is None else self.converters.to_mapping(),
        }


class _Deck:
    """Deals all cards in random order before any comes again."""

    def __init__(self, cards: Sequence[Any], generator: np.random.Generator) -> None:
        self._cards = list(cards)
        self._generator = generator
        self._order: list[int] = []

    def deal(self) -> Any:
        if not self._cards:
            raise BenchError("This rig has no place for effects of a kind of case; leave that kind out with --kinds.")
        if not self._order:
            self._order = [int(i) for i in self._generator.permutation(len(self._cards))]
        return self._cards[self._order.pop()]


def check_kinds(kinds: Sequence[str]) -> None:
    """Refuse kinds of case that do not exist.

    Raises:
        BenchError: one that does not.
    """
    for kind in kinds:
        if kind not in MIXTURE:
            raise BenchError(f"There is no kind of case '{kind}'; choose from {', '.join(MIXTURE)}.")


def draw_cases(
    model: Rig,
    operating: Operating,
    count: int,
    seed: int,
    kinds: Sequence[str] = (),
    tolerances: str = "none",
    motion: Callable[[Rig], Operating] | None = None,
) -> list[Case]:
    """Draw cases; the first ones are the same whatever the number.

    Args:
        model: the rig as it is believed to be.
        operating: how far it moves in its tests.
        count: number of cases.
        seed: of everything.
        kinds: kinds of case to draw; none = all.
        tolerances: of the measuring chain, ``none`` or ``laboratory``: a healthy one is drawn for every case.
        motion: how far a rig moves in its tests. Gaps and friction limits are shares of it: a rig that has more
            damping than its model would not reach a gap of the model's. None = as far as the model.

    Raises:
        BenchError: tolerances or a kind that do not exist, or a rig without a place for what is needed.
    """
    check_tolerances(tolerances)
    check_kinds(kinds)
    cards = [kind for kind, share in MIXTURE.items() if not kinds or kind in kinds for _ in range(share)]
    mixture = _Deck(cards, np.random.default_rng([seed, 1]))
    draws = _Draws(model, operating, seed)
    cases = []
    shifts = {kind: _Deck((True, False), np.random.default_rng([seed, 2, i])) for i, kind in enumerate(MIXTURE)}
    for number in range(1, count + 1):
        kind = mixture.deal()
        shifted = bool(shifts[kind].deal())
        generator = np.random.default_rng([seed, 3, number])
        moved = draw_shifts(model, generator) if shifted else ()
        effects, edits, family = draws.effects(kind, partial(_own_motion, model, operating, moved, motion))
        withheld = ",".join(family) if kind == "withheld" else draws.bystander(effects, generator)
        noise_seed = int(generator.integers(1, 2**31))
        all_edits, converters = (*moved, *edits), None
        if tolerances == "laboratory":
            chain = draw_chain(model, operating, np.random.default_rng([seed, 6, number]))
            all_edits += chain.edits(with_edits(model, all_edits), operating.omega)
            converters = chain.converters
        cases.append(Case(number, kind, effects, withheld, shifted, all_edits, noise_seed, converters))
    return cases


class _Draws:
    """Draws of effects, each kind of case with decks of its own."""

    def __init__(self, model: Rig, operating: Operating, seed: int) -> None:
        self.model, self.operating = model, operating
        self._motion: Callable[[], Operating] = lambda: operating
        self._generator = np.random.default_rng([seed, 4])
        self.known = [truth for truth in KNOWN if truth.spots(model)]
        unknown = [truth for truth in OPEN if truth.spots(model)]
        pairs = [pair for pair in NEAR_TWINS if all(any(truth.name == name for truth in self.known) for name in pair)]

        def deck(cards: Sequence[Any], key: int) -> _Deck:
            return _Deck(cards, np.random.default_rng([seed, 5, key]))

        self._single = deck(self.known, 0)
        self._size = {truth.name: deck(SIZES, 10 + i) for i, truth in enumerate(self.known)}
        self._open, self._withheld = deck(unknown, 1), deck(self.known, 2)
        self._pair, self._twin = deck([*pairs, *((b, a) for a, b in pairs)], 3), deck(TWIN_SIZES, 4)
        self._unnamed = deck(UNNAMED_SIZES, 7)
        self._first, self._second = deck(self.known, 5), deck(self.known, 6)
        self._together = deck(COMPOUND_SIZES, 8)

    def effects(
        self, kind: str, motion: Callable[[], Operating]
    ) -> tuple[tuple[TrueEffect, ...], tuple[Edit, ...], tuple[str, ...]]:
        """Effects of a case of some kind, the edits that make them, and what must be withheld to leave them unnamed."""
        self._motion = motion
        if kind == "null":
            return (), (), ()
        if kind == "effect":
            truth = self._single.deal()
            return self._drawn((truth, self._size[truth.name].deal()))
        if kind == "open":
            return self._drawn((self._open.deal(), self._unnamed.deal()))
        if kind == "withheld":
            return self._drawn((self._withheld.deal(), self._unnamed.deal()), withheld=True)
        if kind == "twin":
            return self._drawn((INJECTED_EFFECTS[self._pair.deal()[0]], self._twin.deal()))
        first, second = self._first.deal(), self._second.deal()
        while second.name == first.name or _near(first.name, second.name) or _overlap(first.name, second.name):
            second = self._second.deal()
        one, other = self._together.deal()
        return self._drawn((first, one), (second, other))

    def _drawn(
        self, *wanted: tuple[InjectedEffect, float], withheld: bool = False
    ) -> tuple[tuple[TrueEffect, ...], tuple[Edit, ...], tuple[str, ...]]:
        effects: list[TrueEffect] = []
        edits: list[Edit] = []
        family: tuple[str, ...] = ()
        for truth, size in wanted:
            spots = truth.spots(self.model)
            spot = spots[int(self._generator.integers(len(spots)))]
            if withheld:
                family = tuple(dict.fromkeys((truth.name, *_CONTAINED.get(truth.name, ()), *_twins(truth.name))))
            value = truth.value(self.model, self.operating, spot, size)
            if truth.signed and self._generator.random() < 0.5:
                value = -value
            operating = self._motion() if spot.shape else self.operating
            edits += truth.edits(self.model, operating, spot, value)
            place = truth.place_at(self.model, spot)
            effects.append(
                TrueEffect(
                    truth.name, place, spot.label, size, value, truth.unit, truth.known,
                    truth.figures(self.model, operating, spot, value),
                )
            )  # fmt: skip
        return tuple(effects), tuple(edits), family

    def bystander(self, effects: Sequence[TrueEffect], generator: np.random.Generator) -> str:
        """An effect to withhold that is not true here, or none."""
        names = {effect.name for effect in effects}
        others = [
            truth.name
            for truth in self.known
            if truth.name not in names and not any(_near(truth.name, name) for name in names)
        ]
        withhold = generator.random() < _OTHERS_WITHHELD
        return others[int(generator.integers(len(others)))] if withhold and others else ""


def _own_motion(
    model: Rig, operating: Operating, moved: tuple[Edit, ...], motion: Callable[[Rig], Operating] | None
) -> Operating:
    """How far a rig with shifted parameters moves; where it cannot be tested, whoever makes the case says so."""
    if motion is not None and moved:
        with contextlib.suppress(TrialError):
            return motion(with_edits(model, moved))
    return operating


def _twins(name: str) -> tuple[str, ...]:
    """Effects that are hardly another: with one of them in the library nothing is unnamed."""
    return tuple(other for pair in NEAR_TWINS if name in pair for other in pair if other != name)


def _near(one: str, other: str) -> bool:
    return any({one, other} == set(pair) for pair in NEAR_TWINS)


# Truths that write the same key: together only one of them would be true.
_SAME_KEY = (
    {"force_gain", "response_gain"},
    {"clipping", "quantisation"},
    {"low_pass", "channel_skew"},
    {"shared_delay", "channel_skew"},
)


# Effects of the library with one parameter more, of which an effect is a special case at one of its values: a Jenkins
# element is micro-slip with sliders that are all alike, linear and quadratic damping are powers of the velocity.
_CONTAINED = {
    "second_friction_contact": ("microslip",),
    "viscous_damping": ("power_law_damping",),
    "air_drag": ("power_law_damping",),
}


def _overlap(one: str, other: str) -> bool:
    return any({one, other} <= keys for keys in _SAME_KEY)
