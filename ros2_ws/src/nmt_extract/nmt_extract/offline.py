"""Extraction from bags: the same code as the live node, fed with recorded messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import MOTIONS
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.extractor import Extractor
from nmt_extract.message_feed import STATE_TOPICS, MessageFeed
from nmt_extract.modal.coverage import covers


@dataclass(frozen=True, eq=False)
class ExtractionResult:
    """What a bag gave.

    Attributes:
        points: in the order in which they became ready, as the live node publishes them.
        run: the run's description from the bag's start record; empty if it has none.
        loss: one sentence on what is missing from the bag; None if nothing is.
        counters: points by status, gaps and blocks by topic.
        linear: linear description that was used.
        settings: settings that were used.
    """

    points: list[ModalPoint]
    run: dict[str, Any]
    loss: str | None
    counters: dict[str, int]
    linear: LinearDescription
    settings: ExtractionSettings = field(default_factory=ExtractionSettings)

    @property
    def inputs(self) -> dict[str, Any]:
        """What ``modal.json`` says about where the points come from."""
        return {
            "run_id": self.run.get("run_id"),
            "rig": self.run.get("rig"),
            "linear": vars(self.linear),
            "extraction": self.settings.to_mapping(),
            "counters": self.counters,
            "loss": self.loss,
        }


def extract_bag(
    path: Path | str,
    linear: LinearDescription | None = None,
    settings: ExtractionSettings | None = None,
) -> ExtractionResult:
    """Extract all modal points of a bag, streaming.

    Args:
        path: bag, see :meth:`nmt_record.bag.bag_reader.Bag.open`.
        linear: takes the place of the linear description in the bag's start record.
        settings: takes the place of the settings there.

    Returns:
        The points; on one machine equal to those that the live node published, bit for bit.

    Raises:
        BenchError: no such bag, or it lacks lock events, samples or the linear description.

    Examples:
        >>> result = nmt.extract("out/demo")
        >>> [(point.level, round(point.frequency_hz, 3)) for point in result.points]
        [(0.1, 22.193), (0.6, 21.12)]

        The same damping ratios as the run has, to the last bit on the machine that recorded it, and with more
        harmonics:

        >>> recorded = nmt.open("out/demo").points
        >>> [abs(a.damping_ratio / b.damping_ratio - 1) < 1e-9 for a, b in zip(result.points, recorded)]
        [True, True]
        >>> settings = dataclasses.replace(result.settings, harmonics=9)
        >>> nmt.extract("out/demo", settings=settings).points[0].force_harmonics.shape
        (10,)
    """
    from nmt_record.bag.bag_reader import Bag

    return extract_opened_bag(Bag.open(path), linear, settings)


def extract_opened_bag(
    bag: Any,
    linear: LinearDescription | None = None,
    settings: ExtractionSettings | None = None,
) -> ExtractionResult:
    """As :func:`extract_bag`, for an opened bag."""
    _refuse_foreign(bag)
    run: dict[str, Any] = bag.run_start or {}
    _refuse_other_kinds(run, bag)
    if linear is None:
        linear = _linear_of(run, bag)
    if settings is None:
        settings = _settings_of(run, bag)
    _require(bag, settings)
    extractor = Extractor(linear, settings, require_loop_state=_count(bag, "frequency") > 0)
    feed = MessageFeed(extractor)
    points: list[ModalPoint] = []
    wanted = [topic for topic in (*settings.topics, *STATE_TOPICS) if topic in bag.topics]
    for topic, _, _, raw in bag.raw_messages(wanted):
        feed.callbacks[topic](raw)
        if extractor.ready:
            points += extractor.take()
    points += extractor.finish()
    if not points:
        _refuse_if_damaged(bag)
    counters = {**extractor.counters, "malformed": feed.malformed}
    return ExtractionResult(points, run, bag.loss, counters, linear, settings)


def _refuse_foreign(bag: Any) -> None:
    from nmt_record.exchange.messages.ros_bag_table import is_foreign

    if is_foreign(bag) and bag.topics and not bag.loss:
        there = ", ".join(f"/{topic} ({kind})" for topic, (kind, _) in sorted(bag.topics.items())[:8])
        raise BenchError(
            f"The bag {bag.path} has none of the bench's topics: it has {there}. './nmt import --init {bag.path}' "
            "lists its numeric fields and writes a sidecar (a file that says what they are) to fill in."
        )


def _refuse_other_kinds(run: dict[str, Any], bag: Any) -> None:
    sentence = covers(DrivenTest.of_run(run, None))
    if sentence:
        raise BenchError(f"The bag {bag.path} cannot be extracted: {sentence}")


def _linear_of(run: dict[str, Any], bag: Any) -> LinearDescription:
    description = run.get("linear")
    if not isinstance(description, dict):
        raise BenchError(
            f"The bag {bag.path} does not say which linear modes its structure has (no 'linear' in its "
            "start record); "
            "give a linear description."
        )
    return LinearDescription.from_mapping(description)


def _settings_of(run: dict[str, Any], bag: Any) -> ExtractionSettings:
    from nmt_record.windows.segments import analysed_topics

    values = run.get("extraction") or {}
    if not isinstance(values, dict):
        raise BenchError(f"The bag {bag.path} has an 'extraction' entry that is not a mapping in its start record.")
    if "topics" not in values:
        present = analysed_topics(bag)
        if "force" in present and len(present) > 1:
            values = {**values, "topics": present}
    return ExtractionSettings.from_mapping(values)


def _require(bag: Any, settings: ExtractionSettings) -> None:
    has = ", ".join(sorted(topic for topic, (_, count) in bag.topics.items() if count)) or "no messages at all"
    if not all(_count(bag, topic) for topic in (*settings.topics, "lock")):
        _refuse_if_damaged(bag)
    missing = [topic for topic in settings.topics if not _count(bag, topic)]
    motions = {quantity.name.lower() for quantity in MOTIONS}
    if "force" in missing and motions & {topic for topic in bag.topics if _count(bag, topic)}:
        raise BenchError(
            f"The bag {bag.path} has no force (it has {has}), and without it a window tells no damping; "
            f"'./nmt diagnose --model RIG --real {bag.path}' compares its frequencies and amplitudes with a model."
        )
    if missing:
        raise BenchError(
            f"The bag {bag.path} has no samples of {', '.join(missing)} (it has {has}); record a run of "
            "the bench or "
            "name another bag."
        )
    if not _count(bag, "lock") and not _count(bag, "frequency"):
        raise BenchError(
            f"The bag {bag.path} has no 'lock' events, so no window to extract (it has {has}); a record without a "
            f"run goes to './nmt diagnose --model RIG --real {bag.path}'."
        )
    if not _count(bag, "lock"):
        raise BenchError(
            f"The bag {bag.path} has no 'lock' events: no level of the run locked, so it has no window "
            "to extract; "
            "see the reasons on topic 'frequency'."
        )


def _refuse_if_damaged(bag: Any) -> None:
    """What is lost may have held the windows: nothing is said about the run itself."""
    if bag.loss:
        raise BenchError(f"{bag.loss} What could be read holds no window to extract.")


def _count(bag: Any, topic: str) -> int:
    return int(bag.topics.get(topic, ("", 0))[1])
