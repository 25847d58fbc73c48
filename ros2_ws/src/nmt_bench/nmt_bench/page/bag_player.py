"""Plays a recording into the view: from the beginning, from any moment, at any speed."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

from nmt_bench.page.channels import STRIP_SECONDS
from nmt_bench.page.live_view import LiveView
from nmt_bench.page.message_records import WATCHED_TOPICS, RecordReader
from nmt_bench.page.server import Player
from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_core.messages.blocks import SAMPLE_TOPICS, SampleBlock
from nmt_record.bag.bag_reader import Bag

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_STEP = 0.02  # s of wall time
_LATE_BEGIN = 1.0  # s of bench time


class BagPlayer(Player):
    """Feeds the messages of a bag to a view by their bench time.

    It begins when the state is asked for, which a page does as soon as somebody watches.

    Args:
        path: the bag.
        view: what shows it.

    Attributes:
        duration: s of bench time.

    Raises:
        BenchError: not a readable bag, or one without samples.
    """

    def __init__(self, path: Path | str, view: LiveView) -> None:
        self._bag = Bag.open(path)
        present = [topic for topic in SAMPLE_TOPICS if self._bag.topics.get(topic, ("", 0))[1]]
        if not present:
            raise BenchError(f"The bag {path} has no samples to show; name a bag of the bench.")
        self._view = view
        self._changed = threading.Condition()
        self._position = 0.0
        self._playing = True
        self._speed = 1.0
        self._target: float | None = 0.0
        self._ended = False
        stamps = [stamp for _, _, stamp, _ in self._bag.raw_messages(present[:1])]
        # A converter may have run for hours before the run.
        self._first = stamps[0] / 1e9 if stamps[0] > _LATE_BEGIN * 1e9 else 0.0
        self.duration = stamps[-1] / 1e9 - self._first
        self._watched = False
        view.begin(self._bag.run_start or {}, _rig(self._bag.rig_yaml))
        self._thread = threading.Thread(target=self._play, name="bag player", daemon=True)
        self._thread.start()

    def state(self) -> dict[str, Any]:
        """Position and duration in s, whether it plays, and its speed."""
        with self._changed:
            if not self._watched:
                self._watched = True
                self._changed.notify_all()
            return {
                "position": self._position,
                "duration": self.duration,
                "playing": self._playing,
                "speed": self._speed,
            }

    def control(self, order: dict[str, Any]) -> None:
        """Take an order of the page: ``seek`` (s), ``playing`` or ``speed``; what is not one is passed over."""
        with self._changed:
            seek, playing, speed = order.get("seek"), order.get("playing"), order.get("speed")
            if isinstance(seek, int | float) and math.isfinite(seek):
                self._target = min(max(0.0, float(seek)), self.duration)
            if isinstance(playing, bool):
                self._playing = playing
                if playing and self._position >= self.duration and self._target is None:
                    self._target = 0.0
            if speed in SPEEDS:
                self._speed = float(speed)
            self._changed.notify_all()

    def close(self) -> None:
        """Play no more."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join(timeout=5.0)

    def _play(self) -> None:
        while not self._ended:
            with self._changed:
                self._changed.wait_for(lambda: self._ended or (self._watched and self._target is not None))
                start, self._target = self._target or 0.0, None
            self._view.seek()
            self._play_from(start)

    def _interrupted(self) -> bool:
        return self._ended or self._target is not None

    def _play_from(self, start: float) -> None:
        """Catch up to a moment, then go on by the clock until the end, or until something else is asked for."""
        reader = RecordReader()
        position, seen = start, time.monotonic()
        for topic, _, stamp, raw in self._bag.raw_messages(WATCHED_TOPICS):
            if self._interrupted():
                return
            at = stamp / 1e9 - self._first
            if at > self.duration:  # without a stamp of its own, as a level: the wall time of its reception
                at = position
            if at < start - STRIP_SECONDS and topic in SAMPLE_TOPICS:
                continue
            while at > position:
                with self._changed:
                    self._position = position
                    if not self._playing:
                        self._changed.wait_for(lambda: self._interrupted() or self._playing)
                        seen = time.monotonic()
                    if self._interrupted():
                        return
                    speed = self._speed
                now = time.monotonic()
                position += (now - seen) * speed
                seen = now
                if at > position:
                    time.sleep(_STEP)
            record = reader.read(topic, raw)
            if record is not None:
                self._view.take(record)
                if isinstance(record, SampleBlock):
                    with self._changed:
                        self._position = max(min(at, position), start)
        with self._changed:
            self._position, self._playing = self.duration, False


def _rig(text: str | None) -> dict[str, Any]:
    try:
        value = yaml_value(text or "", "rig file of the bag")
    except BenchError:
        return {}
    return value if isinstance(value, dict) else {}
