"""A run's report data from its bag, read once and thinned on the way."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.wire import BlockReader
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import LoopState
from nmt_report.coverage import covers
from nmt_report.run_data import (
    Excerpt,
    LevelStart,
    LockMark,
    LoopHistory,
    ReferenceCurve,
    RunReportData,
    SignalEnvelope,
)
from nmt_report.shown_levels import MOST_PANELS, spread_evenly

if TYPE_CHECKING:
    from nmt_core.messages.modal_point import ModalPoint
    from nmt_record.bag.bag_reader import Bag
    from nmt_record.windows.segments import Signals

STRETCHES = 1200
EXCERPT_PERIODS = 3.0


def report_data_from_bag(
    path: Path | str | Bag,
    points: Sequence[ModalPoint] | None = None,
    reference: ReferenceCurve | None = None,
) -> RunReportData:
    """Read what a report shows.

    Args:
        path: a bag, as ``nmt_record.bag.bag_reader.Bag.open`` takes it, or one that is open.
        points: modal points to show; None = those recorded in the bag.
        reference: computed backbone to compare with.

    Returns:
        The data, without the list of files.

    Raises:
        BenchError: the path is not a readable bag, or its test gives no modal points.
    """
    from nmt_core.messages.driven_test import DrivenTest
    from nmt_core.messages.wire import MODAL_POINT
    from nmt_record.bag.bag_reader import Bag

    bag = path if isinstance(path, Bag) else Bag.open(path)
    run = bag.run_start or {}
    linear = LinearDescription.from_mapping(run["linear"]) if run.get("linear") else None
    loop: list[tuple[int, float, float, int, float]] = []
    words: dict[int, str] = {}
    levels: list[LevelStart] = []
    locks: list[LockMark] = []
    recorded: list[ModalPoint] = list(bag.records("modal_point", MODAL_POINT)) if "modal_point" in bag.topics else []
    shown = recorded if points is None else points
    refusal = "" if shown else covers(DrivenTest.of_run(run, _rig(bag.rig_yaml)))
    if refusal:
        raise BenchError(refusal)
    for topic, _, _, raw in bag.raw_messages(["frequency", "level", "lock"]):
        if topic == "frequency":
            row, level, reason = _status(bag, raw)
            loop.append(row)
            if reason and row[3] == LoopState.LOCKED:
                words[level] = reason
            continue
        message = bag.deserialise(topic, raw)
        if topic == "level":
            levels.append(LevelStart(int(message.index), float(message.amplitude), int(message.apply_at_sample)))
        else:
            locks.append(_lock(message))
    envelopes, excerpts, windows, sample_rate, end_sample = _signals(bag, linear, locks)
    excerpts = _with_frequency(excerpts, shown)
    return RunReportData(
        points=shown,
        sample_rate=sample_rate,
        run=run,
        rig=_rig(bag.rig_yaml),
        stop=bag.run_stop or {},
        linear=linear,
        history=_history(loop),
        envelopes=envelopes,
        excerpts=excerpts,
        excerpts_of=windows,
        levels=levels,
        locks=locks,
        reference=reference,
        loss=bag.loss,
        not_live=_not_live(points or recorded, recorded, locks) if "modal_point" in bag.topics else (),
        end_sample=end_sample,
        lock_words=words,
        plant=plant_facts(bag),
    )


def _status(bag: Bag, raw: bytes) -> tuple[tuple[int, float, float, int, float], int, str]:
    """Last sample, frequency, phase error, state and drive amplitude of a message of ``frequency``; level, reason."""
    from nmt_core.messages.wire import read_status

    status: Any
    if bag.topics["frequency"][0] == "nmt_msgs/msg/Frequency":
        try:
            status = read_status(raw)
        except ValueError as error:
            raise BenchError(
                f"A message of topic 'frequency' in the bag {bag.path} cannot be read: {error}."
            ) from error
    else:
        status = bag.deserialise("frequency", raw)
    row = status.last_sample, status.frequency_hz, status.phase_error, status.state, status.drive_amplitude
    return row, int(status.level_index), str(status.reason)


def _not_live(
    points: Sequence[ModalPoint], recorded: Sequence[ModalPoint], locks: Sequence[LockMark]
) -> tuple[int, ...]:
    """Locked levels that have a point now and had none in the recording."""
    locked, live = {lock.level_index for lock in locks}, {point.level_index for point in recorded}
    return tuple(sorted({point.level_index for point in points} & locked - live))


def plant_facts(bag: Bag) -> dict[str, str]:
    """The counters that the plant node published last; none where plants of several benches were heard."""
    said: dict[str, dict[str, str]] = {}
    with contextlib.suppress(BenchError):  # a damaged one costs no report
        for _, _, message in bag.messages(["diagnostics"]):
            for status in message.status:
                # The name has the bench's namespace in front, and the topic is shared by all benches of a domain.
                if str(status.name).rpartition("/")[2] == "plant":
                    said[str(status.name)] = {str(item.key): str(item.value) for item in status.values}
    return next(iter(said.values())) if len(said) == 1 else {}


class _Signal:
    """One channel on its way through the bag: its envelope over stretches of blocks."""

    def __init__(self, topic: str, point: int, blocks: int, shortest: float) -> None:
        self._topic, self._symbol = topic, _SYMBOLS[topic]
        self._point = point
        self._reader = BlockReader()
        self._blocks_per_stretch = max(1, math.ceil(blocks / STRETCHES))
        self._shortest = shortest
        self._gathered: list[Any] = []
        self._first = 0
        self._envelope: list[tuple[float, float, float]] = []
        self.channel = ""
        self.unit = ""
        self.sample_rate = math.nan
        self.end_sample = 0

    def add(self, raw: bytes) -> None:
        """Take a serialised block.

        Raises:
            ValueError: it is not a whole block.
        """
        head = self._reader.head(raw)
        points, end = head.points, head.first_sample + head.samples
        row = points.index(self._point) if self._point in points else 0
        self.channel, self.unit, self.sample_rate = head.channels[row], head.unit, head.sample_rate
        if end > self.end_sample:
            self.end_sample = end
        if not self._gathered:
            self._first = head.first_sample
        self._gathered.append(self._reader.samples(raw, row))
        if len(self._gathered) >= self._blocks_per_stretch and end - self._first >= self._shortest * head.sample_rate:
            self._close_stretch(end)

    def envelope(self) -> SignalEnvelope:
        if self._gathered:
            self._close_stretch(self.end_sample)
        sample, low, high = np.array(self._envelope).reshape(-1, 3).T
        return SignalEnvelope(self.channel, self.symbol, self.unit, sample, low, high)

    @property
    def symbol(self) -> str:
        return self._symbol.format(self.channel[1:]) if self.channel else self._symbol

    def excerpt(self, signals: Signals) -> FloatArray | None:
        """Samples of the channel over a stretch; None unless all of them were there."""
        # Where two topics have channels of one name, the topic stands before it.
        names = (f"{self._topic}/{self.channel}", self.channel)
        name = next((name for name in names if signals.topics.get(name) == self._topic), None)
        samples = None if name is None else signals.channels[name]
        return samples if samples is not None and np.all(np.isfinite(samples)) else None

    def _close_stretch(self, end_sample: int) -> None:
        values = np.concatenate(self._gathered)
        self._envelope.append((0.5 * (self._first + end_sample), np.fmin.reduce(values), np.fmax.reduce(values)))
        self._gathered.clear()


_SYMBOLS = {
    "voltage": "$u$",
    "force": "$F$",
    "displacement": "$x_{{{}}}$",
    "acceleration": r"$\ddot x_{{{}}}$",
}


def _signals(
    bag: Bag, linear: LinearDescription | None, locks: Sequence[LockMark]
) -> tuple[list[SignalEnvelope], list[Excerpt], int, float, int]:
    """Envelopes, excerpts, windows that these were chosen from, sample rate (Hz), sample after the last one.

    The samples are read once. Of many windows only those are cut out that a page shows.
    """
    from nmt_record.bag.bench_topics import SAMPLE_BLOCK
    from nmt_record.windows.segments import read_stretches

    present = [topic for topic in _SYMBOLS if bag.topics.get(topic, ("", 0))[1]]
    for topic in present:
        if bag.topics[topic][0] != SAMPLE_BLOCK:
            raise BenchError(f"Topic '{topic}' of the bag {bag.path} holds {bag.topics[topic][0]}, not samples.")
    if "displacement" in present and "acceleration" in present:
        present.remove("acceleration")
    point = linear.drive_point if linear is not None else -1
    # A stretch shorter than a period would show the signal itself, not its envelope.
    shortest = 1.5 / linear.frequency_hz if linear is not None else 0.0
    signals = {topic: _Signal(topic, point, bag.topics[topic][1], shortest) for topic in present}

    def add(topic: str, raw: bytes) -> None:
        if topic not in signals:
            return
        try:
            signals[topic].add(raw)
        except ValueError as error:
            raise BenchError(f"A block of topic '{topic}' in the bag {bag.path} cannot be used: {error}.") from error

    chosen = spread_evenly(locks, MOST_PANELS)
    excerpts = _excerpts(signals, chosen, read_stretches(bag, [_excerpt_span(lock) for lock in chosen], add, True))
    windows = len(locks)
    if len(excerpts) < len(chosen) < windows:
        # Some of them lack samples: the page chooses among those that do not.
        cut = read_stretches(bag, [_excerpt_span(lock) for lock in locks], whole=True)
        excerpts = _excerpts(signals, locks, cut)
        windows = len(excerpts)
    elif len(chosen) == windows:
        windows = len(excerpts)
    end_sample = max((signal.end_sample for signal in signals.values()), default=0)
    rates = [signal.sample_rate for signal in signals.values()]
    envelopes = [signal.envelope() for signal in signals.values()]
    return envelopes, excerpts, windows, rates[0] if rates else math.nan, end_sample


def _excerpts(
    signals: dict[str, _Signal], locks: Sequence[LockMark], stretches: Sequence[Signals | None]
) -> list[Excerpt]:
    """Excerpts of the windows whose samples are all there."""
    response = signals.get("displacement") or signals.get("acceleration")
    force = signals.get("force")
    excerpts = []
    for lock, stretch in zip(locks, stretches, strict=True):
        if force is None or response is None or stretch is None:
            continue
        force_samples, response_samples = force.excerpt(stretch), response.excerpt(stretch)
        if force_samples is None or response_samples is None:
            continue
        excerpts.append(
            Excerpt(
                level_index=lock.level_index,
                level=lock.level,
                level_unit=lock.level_unit,
                frequency_hz=lock.frequency_hz,
                sample_rate=force.sample_rate,
                force=force_samples,
                response=response_samples,
                response_symbol=response.symbol,
                response_unit=response.unit,
            )
        )
    return excerpts


def _with_frequency(excerpts: Sequence[Excerpt], points: Sequence[ModalPoint]) -> list[Excerpt]:
    """Imported windows need not name their frequency: it is then that of the modal point."""
    known = {point.level_index: point.excitation_frequency_hz for point in points}
    complete = []
    for excerpt in excerpts:
        frequency = known.get(excerpt.level_index, math.nan)
        if excerpt.frequency_hz > 0.0:  # 0 and NaN both say that it is not known
            complete.append(excerpt)
        elif frequency > 0.0:
            stop = round(EXCERPT_PERIODS * excerpt.sample_rate / frequency)
            force, response = excerpt.force[:stop], excerpt.response[:stop]
            complete.append(dataclasses.replace(excerpt, frequency_hz=frequency, force=force, response=response))
    return complete


def _excerpt_samples(lock: LockMark) -> int:
    """Samples of a few periods, never beyond the window."""
    if lock.window_periods == 0:
        return lock.window_samples
    return min(lock.window_samples, round(EXCERPT_PERIODS * lock.window_samples / lock.window_periods))


def _excerpt_span(lock: LockMark) -> tuple[int, int]:
    """First sample and number of samples."""
    return lock.window_first_sample, _excerpt_samples(lock)


def _lock(message: Any) -> LockMark:
    return LockMark(
        level_index=int(message.level_index),
        level=float(message.level),
        level_unit=str(message.level_unit),
        sample=int(message.sample),
        frequency_hz=float(message.frequency_hz),
        window_first_sample=int(message.window_first_sample),
        window_samples=int(message.window_samples),
        window_periods=int(message.window_periods),
    )


def _history(loop: Sequence[tuple[int, float, float, int, float]]) -> LoopHistory | None:
    if not loop:
        return None
    sample, frequency, error, state, amplitude = zip(*loop, strict=True)
    return LoopHistory(
        sample=np.array(sample, dtype=np.int64),
        frequency_hz=np.array(frequency, dtype=np.float64),
        phase_error=np.array(error, dtype=np.float64),
        state=np.array(state, dtype=np.int64),
        drive_amplitude=np.array(amplitude, dtype=np.float64),
    )


def _rig(text: str | None) -> dict[str, Any]:
    try:
        content = yaml_value(text or "", "rig.yaml")
    except BenchError:
        return {}
    return content if isinstance(content, dict) else {}
