"""Where something sits and what an explanation consists of: values that compare and hash.

Words for people and keys of ``diagnosis.json`` are made from them here and nowhere read back.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from nmt_signals.channel_faults.mains_lines import MAINS_HZ

LocationKind = Literal[
    "structure", "boundary", "joint", "exciter", "force_sensor", "response_sensor", "controller", "time"
]


def joined(words: Iterable[str]) -> str:
    """Several names as one, as reports and ``diagnosis.json`` write them."""
    return " + ".join(words)


_WORDS = {
    "second_friction_contact": "friction contact",
    "missing_mode": "a further mode",
    "one_sided_stop": "one-sided stop",
    "two_sided_gap": "two-sided clearance",
}
"""Effects with other words than their name: without friction in the model a contact is the first; a mode is lacking."""


def effect_words(name: str) -> str:
    """``cubic stiffness`` for ``cubic_stiffness``, and the same of several that are joined."""
    return joined(_WORDS.get(part, part.replace("_", " ")) for part in name.split(" + "))


@dataclass(frozen=True)
class Location:
    """Where an effect or a source sits.

    Attributes:
        kind: place of the verdict.
        points: points of the structure that tell it from others of its kind; empty where there is only one.
        channel: channel it belongs to; empty if it is of no sensor.
        detail: what a reader sees in addition to the kind; empty where there is only one.
    """

    kind: LocationKind
    points: tuple[int, ...] = ()
    channel: str = ""
    detail: str = ""

    @classmethod
    def at(cls, kind: LocationKind, point: int, other_point: int = 0) -> Location:
        """At a point, or between two; ``other_point`` 0 is the ground."""
        points = (point, other_point) if other_point else (point,)
        return cls(kind, points, detail="-".join(str(item) for item in points))

    @classmethod
    def on_channel(
        cls, kind: LocationKind, channel: str, point: int, picked_up: int = 0, mains_hz: float = MAINS_HZ[0]
    ) -> Location:
        """At the channel of a sensor at ``point``; ``picked_up`` is another point that it picks up."""
        detail = f"{channel}<{picked_up}" if picked_up else channel
        if mains_hz != MAINS_HZ[0]:
            detail += f" at {mains_hz:g} Hz"
        return cls(kind, (point, picked_up) if picked_up else (point,), channel, detail)


@dataclass(frozen=True)
class Cause:
    """An effect at a place.

    Attributes:
        effect: name of the effect.
        location: where it acts.
        form: which of several forms of the effect; empty where there is one. No part of its label.
    """

    effect: str
    location: Location
    form: str = ""

    def same_but_for_form(self, other: Cause) -> bool:
        """Whether both are one effect at one place."""
        return (self.effect, self.location) == (other.effect, other.location)

    @property
    def label(self) -> str:
        """For example ``cubic_stiffness@4``."""
        return f"{self.effect}@{self.location.detail}" if self.location.detail else self.effect


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a gap is explained by; two are equal if they have the same causes, in any order.

    Attributes:
        causes: in the order in which they were found; empty for the model itself.
    """

    causes: tuple[Cause, ...] = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Explanation) and frozenset(self.causes) == frozenset(other.causes)

    def __hash__(self) -> int:
        return hash(frozenset(self.causes))

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, sorted."""
        return tuple(sorted(cause.effect for cause in self.causes))

    @property
    def locations(self) -> tuple[Location, ...]:
        """Where they act, in the order of the causes."""
        return tuple(cause.location for cause in self.causes)

    @property
    def label(self) -> str:
        """For example ``cubic_stiffness@4 + air_drag@7``; ``none`` for the model itself."""
        return joined(cause.label for cause in self.causes) or "none"

    @property
    def place(self) -> str:
        """Details of its places, the kind where there is none: ``4 + 7``, ``f1``, ``joint``."""
        return joined(location.detail or location.kind for location in self.locations)

    @property
    def kinds(self) -> str:
        """Kinds of its places, each once."""
        return joined(dict.fromkeys(location.kind for location in self.locations))
