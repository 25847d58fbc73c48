"""How sequencer and recorder agree on a bag for every run: an announcement and its answer, as JSON texts.

The sequencer announces a run on the latched topic ``run_plan`` before its first level, and begins it when the recorder
has answered on the latched topic ``bag`` that a bag is open for it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

ANNOUNCEMENT_TOPIC = "run_plan"
BAG_TOPIC = "bag"
TAKEN_TOPICS = {"recorder": "recorded", "extract": "extracted"}
"""By node the topic on which it tells, latched, the first sample that it has not taken yet; in lockstep the plant waits
for it."""
TELL_EVERY = 1.0
"""Bench time between two such messages, s."""


@dataclass(frozen=True)
class RunAnnouncement:
    """A run that is about to begin.

    Attributes:
        goal: name of the goal, unlike that of any other goal; empty: none is about to begin.
        run_id: name of the run.
        plan: what will be done, for the bag's description of itself.
    """

    goal: str = ""
    run_id: str = ""
    plan: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        """The text that goes over the topic."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> RunAnnouncement:
        """Read the text of the topic.

        Raises:
            ValueError: it is not an announcement.
        """
        given = _object(text)
        goal, run_id, plan = given.get("goal", ""), given.get("run_id", ""), given.get("plan", {})
        if not (isinstance(goal, str) and isinstance(run_id, str) and isinstance(plan, dict)):
            raise ValueError("an announcement of a run has the texts goal and run_id and the object plan")
        return cls(goal, run_id, plan)


@dataclass(frozen=True)
class BagState:
    """What the recorder does.

    Attributes:
        path: folder of the newest bag.
        state: ``open``, ``closed`` or ``failed``.
        messages: messages in it.
        reason: why it was closed or failed; empty if there is nothing to say.
        goal: goal of the run that the bag is for, as announced; empty if none was announced.
        recorded_s: bench time up to which everything is in it, s.
        lacks_s: bench time that a bag which is closed lacks, at its end and in gaps, s.
    """

    path: str
    state: str
    messages: int = 0
    reason: str = ""
    goal: str = ""
    recorded_s: float = 0.0
    lacks_s: float = 0.0

    def to_json(self) -> str:
        """The text that goes over the topic."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> BagState:
        """Read the text of the topic.

        Raises:
            ValueError: it is not a state of a bag.
        """
        given = _object(text)
        try:
            state = cls(**{item.name: given[item.name] for item in fields(cls) if item.name in given})
        except TypeError as error:
            raise ValueError(f"this is not a state of a bag: {error}") from error
        if not all(isinstance(text, str) for text in (state.path, state.state, state.reason, state.goal)):
            raise ValueError("path, state, reason and goal of a bag's state are texts")
        return state


def _object(text: str) -> dict[str, Any]:
    given = json.loads(text)
    if not isinstance(given, dict):
        raise ValueError("a JSON object is expected")
    return given
