"""What the extraction node does with messages, free of ROS: blocks, loop states, levels and locks in, points out."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.linear_description import LinearDescription
from nmt_core.modal_point import ModalPoint
from nmt_core.parameters import parameter_table
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.extractor import Extractor
from nmt_extract.message_feed import STATE_TOPICS, MessageFeed

PARAMETERS = parameter_table("""\
linear_json =""  Linear description of the rig as JSON, see the reference of linear.json; empty = nothing is
    extracted.
harmonics =10 1..200  Number of harmonics H; 0..H are extracted.
topics =["force","acceleration"]  Sample topics a window needs: force and the rig's response topics.
bundled =[""]  Topics that are taken from the bundles of plant and loop; empty = none.
sub_windows =10 3..1000  Sub-windows for the standard uncertainties.
minimum_periods =3 (periods) 3..  Windows of fewer whole periods are rejected.
power_balance =False  Balance of power for windows whose level still changes.
hysteresis_json =""  Masses and points of a three-mass chain with a joint as JSON; empty = none.
rig =""  Name of the rig, for the log.
""")  # fmt: skip


class ExtractionCore:
    """The extractor with its parameters; without a linear description nothing is extracted.

    Args:
        values: parameters of the node, complete; see ``PARAMETERS``.

    Attributes:
        topics: what it listens to.
        extractor: None without a linear description.

    Raises:
        BenchError: a parameter is refused.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        text = str(values["linear_json"])
        settings = _settings(values)
        self.topics: tuple[str, ...] = (*settings.topics, *STATE_TOPICS)
        self.extractor: Extractor | None = None
        self.feed: MessageFeed | None = None
        if text:
            self.extractor = Extractor(LinearDescription.from_json(text), settings)
            self.feed = MessageFeed(self.extractor)

    def callback(self, topic: str) -> Callable[[bytes], None]:
        """Function of one serialised message of a topic."""
        if self.feed is None:
            return lambda _: None
        return self.feed.callbacks[topic]

    def points(self) -> list[ModalPoint]:
        """Points that have become ready since the last call."""
        if self.extractor is None or not self.extractor.ready:
            return []
        return self.extractor.take()

    @property
    def counters(self) -> dict[str, int]:
        """Points by status, gaps and blocks by topic, and what could not be read."""
        if self.extractor is None or self.feed is None:
            return {}
        return {**self.extractor.counters, "malformed": self.feed.malformed}


def _settings(values: Mapping[str, Any]) -> ExtractionSettings:
    names = ("harmonics", "topics", "sub_windows", "minimum_periods", "power_balance")
    given: dict[str, Any] = {name: values[name] for name in names}
    text = str(values["hysteresis_json"])
    if text:
        try:
            given["hysteresis"] = json.loads(text)
        except json.JSONDecodeError as error:
            raise BenchError(f"Parameter 'hysteresis_json' of extract is not JSON: {error}.") from error
        if not isinstance(given["hysteresis"], dict):
            raise BenchError("Parameter 'hysteresis_json' of extract must be a JSON object.")
    return ExtractionSettings.from_mapping(given)
