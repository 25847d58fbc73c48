"""What the extraction node does with messages, free of ROS: blocks, loop states, levels and locks in, points out."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.wire import BlockReader
from nmt_core.nodes.parameters import parameter_table
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
        self._passed: dict[str, tuple[int, float]] = dict.fromkeys(settings.topics, (0, math.nan))
        if text:
            self.extractor = Extractor(LinearDescription.from_json(text), settings)
            self.feed = MessageFeed(self.extractor)

    def callback(self, topic: str) -> Callable[[bytes], None]:
        """Function of one serialised message of a topic."""
        if self.feed is not None:
            return self.feed.callbacks[topic]
        if topic in self._passed:
            return partial(self._pass, topic, BlockReader().read)
        return lambda _: None

    def _pass(self, topic: str, read: Callable[[bytes], Any], raw: bytes) -> None:
        """Note how far a topic has come of which nothing is extracted."""
        with contextlib.suppress(ValueError):
            block = read(raw)
            self._passed[topic] = block.first_sample + block.data.shape[1], block.sample_rate

    @property
    def taken(self) -> tuple[int, float]:
        """First sample that has not been taken yet, and the sample rate (Hz; NaN before the first)."""
        if self.extractor is not None:
            return self.extractor.reached
        return min(self._passed.values(), default=(0, math.nan))

    def points(self) -> list[ModalPoint]:
        """Points that have become ready since the last call."""
        if self.extractor is None or not self.extractor.ready:
            return []
        return self.extractor.take()

    @property
    def counters(self) -> dict[str, int]:
        """Points by status, gaps and blocks by topic, and what could not be read."""
        own = {} if self.extractor is None else self.extractor.counters
        return {**own, "malformed": 0 if self.feed is None else self.feed.malformed, "taken": self.taken[0]}


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
