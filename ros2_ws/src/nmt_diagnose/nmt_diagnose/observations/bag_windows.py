"""What a bag holds for the kinds of measurement to read: its windows with their samples, its channels, the model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.channels.bag_samples import SampleStretch, read_windows
from nmt_diagnose.observations.channels.plausibility import check_frequency, clipping_notes, out_of_scale, repeats_notes
from nmt_diagnose.observations.model_view import ModelView, matched
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Segment
from nmt_rig.rig import Rig

LOCKED = (TestKind.PHASE_RESONANCE, TestKind.STEPPED_SINE, TestKind.RESPONSE_CURVE)
"""Kinds of test whose windows are periods of one frequency."""


@dataclass(frozen=True, eq=False)
class BagWindow:
    """A window, its samples, and what the sidecar says was held in it; empty where it says nothing."""

    segment: Segment
    stretch: SampleStretch
    held: str = ""

    @property
    def frequency_hz(self) -> float:
        """Frequency of the oscillator, else the one that was written down, Hz; NaN where it is unknown."""
        cycles = self.stretch.cycles
        if cycles is not None and cycles.size > 1:
            return float(cycles[-1] - cycles[0]) / (cycles.size - 1) * self.stretch.sample_rate
        return self.segment.frequency_hz if self.segment.frequency_hz > 0.0 else math.nan


@dataclass(eq=False)
class BagWindows:
    """The windows of one bag, from which each kind of measurement takes its own in turn.

    Attributes:
        name: of the bag, for tests and sentences.
        run: its start record.
        model: the rig file that is to be compared with it.
        view: the model, driven where the bag was.
        settings: of the reading.
        sine: whether a drive that was not recorded was a sine at one exciter; else only the forces are known.
        channels: the model's channel for each recorded one that can be trusted.
        of_decays: the same and ideal sensors for the motions that the model has none of.
        sample_rate: of its first window, Hz.
        windows: those that no kind took for itself, in time.
        notes: sentences on what was found, left out and why.
    """

    name: str
    run: dict[str, Any]
    model: Rig
    view: ModelView
    settings: ObservationSettings
    sine: bool
    channels: dict[str, MeasuredChannel]
    of_decays: dict[str, MeasuredChannel]
    sample_rate: float
    windows: list[BagWindow]
    notes: list[str] = field(default_factory=list)
    _trusted: bool = False

    @classmethod
    def of(
        cls,
        bag: Bag,
        name: str,
        usable: Sequence[Segment],
        model: Rig,
        settings: ObservationSettings,
        sine: bool,
        notes: list[str],
    ) -> BagWindows | None:
        """The windows of a bag; None where it has no samples of any.

        Args:
            bag: an opened bag.
            name, model, settings, sine: attributes.
            usable: its windows.
            notes: takes sentences.

        Raises:
            BenchError: the model has no such drive point.
        """
        run = bag.run_start or {}
        held = _held(run)
        windows = []
        for segment, stretch in zip(usable, read_windows(bag, usable), strict=True):
            if stretch is None or stretch.samples < THRESHOLDS.reading.stretch_fewest_samples:
                where = f"{name}: level {segment.level_index}"
                notes.append(f"{where} is left out: the bag has no samples of its window, or hardly any.")
            else:
                windows.append(BagWindow(segment, stretch, held.get(segment.level_index, "")))
        if not windows:
            return None
        recorded = tuple({c.name: c for window in windows for c in window.stretch.channels}.values())
        points = _drive_points(run, recorded, model)
        lacking = [point for point in points if point not in model.structure.points]
        if lacking:
            raise BenchError(
                f"{name} was driven at point {lacking[0]}, but the model {model.name} has points 1 to "
                f"{model.structure.points[-1]}; name the rig file of the rig that was tested."
            )
        view = ModelView.of(model, points)
        channels, more = matched(recorded, view)
        # A decay needs no sensor in the rig file: where it lacks one, an ideal one is meant.
        of_decays = {c.name: c for c in recorded if c.quantity in MOTIONS and c.point in model.structure.points}
        of_decays |= channels
        if all(window.segment.kind is TestKind.RING_DOWN for window in windows):
            channels, more = of_decays, ()
        notes += [f"{name}: {note}" for note in more]
        rate = windows[0].stretch.sample_rate
        return cls(name, run, model, view, settings, sine, channels, of_decays, rate, windows, notes)

    @property
    def imported(self) -> bool:
        """Whether someone else recorded it."""
        return "imported" in self.run

    @property
    def hold_rate_hz(self) -> float:
        """Rate at which the drive was interpolated linearly, Hz: that of the run, else that of simulated rigs."""
        value = self.run.get("drive_hold_hz")
        if isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0:
            return float(value)
        return math.inf if self.imported or not self.run else self.sample_rate

    @property
    def controlled_quantity(self) -> Quantity | None:
        """Quantity of the response whose phase the loop controlled; None where the bag does not say."""
        extraction = self.run.get("extraction")
        topics = extraction.get("topics") if isinstance(extraction, dict) else None
        for topic in topics if isinstance(topics, list | tuple) else ():
            if topic in ("displacement", "velocity", "acceleration"):
                return Quantity[topic.upper()]
        return None

    # -- what the kinds ask for ----------------------------------------------------------------------------------------

    def take(self, windows: Sequence[BagWindow]) -> None:
        """Take windows out, so that no other kind reads them."""
        self.windows = [window for window in self.windows if window not in windows]

    def of_kind(self, kind: TestKind) -> list[BagWindow]:
        """Windows of a kind of test, in time."""
        return [window for window in self.windows if window.segment.kind is kind]

    def named(self, kind: TestKind) -> str:
        """Name of the test that the windows of a kind are."""
        return f"{self.name}/{kind.label}" if len({window.segment.kind for window in self.windows}) > 1 else self.name

    def part_named(self, windows: Sequence[BagWindow], words: str) -> str:
        """Name of the test that some of the windows are, whatever their kind."""
        return f"{self.name}/{words}" if len(windows) < len(self.windows) else self.name

    def each(self, kinds: Iterable[TestKind]) -> Iterator[tuple[str, BagWindow]]:
        """Windows of some kinds that are a test each, with its name; what is clipped or lost in them is noted."""
        for kind in kinds:
            windows = self.of_kind(kind)
            for window in windows:
                name = f"{self.named(kind)} {window.segment.level_index}" if len(windows) > 1 else self.named(kind)
                self.notes += clipping_notes(name, [(window.segment.level_index, window.stretch)])
                self.notes += repeats_notes(name, [window.stretch])
                yield name, window

    def is_swept(self, kind: TestKind) -> bool:
        """Whether windows of a kind are frequency responses at their measured force, and not locked levels."""
        windows = self.of_kind(kind)
        enough = len(windows) >= THRESHOLDS.reading.stepped_fewest_lines
        forced = all(window.stretch.find(Quantity.FORCE) is not None for window in windows)
        stepped = kind is TestKind.STEPPED_SINE and self.imported and enough and forced
        return stepped or kind is TestKind.RESPONSE_CURVE

    def note_few_levels(self, name: str, levels: int) -> None:
        """Note the limits of a test of few levels."""
        if 0 < levels < THRESHOLDS.reading.few_levels:
            self.notes.append(
                f"{name}: {levels} level{'s' if levels > 1 else ''} cannot tell effects apart by how they grow with "
                "amplitude; measure five or more."
            )

    def require_responses(self) -> None:
        """Refuse a bag without a response that the model has a channel for.

        Raises:
            BenchError: it has none.
        """
        decays = any(window.segment.kind is TestKind.RING_DOWN for window in self.windows)
        channels = self.of_decays if decays else self.channels
        if not any(channel.quantity in MOTIONS for channel in channels.values()):
            raise BenchError(
                f"{self.name} has no response channel that the model {self.model.name} has too; name the rig file of "
                "the rig that was tested, or add its sensors."
            )

    def drop_implausible(self) -> None:
        """Leave out channels whose size in windows of one frequency can only be a wrong unit; once.

        Raises:
            BenchError: most channels are off, or all windows lie at no mode of the model.
        """
        locked = [window for window in self.windows if window.segment.kind in LOCKED]
        if self._trusted or not locked:
            return
        self._trusted = True
        frequencies = [window.frequency_hz for window in locked]
        check_frequency(self.name, [value for value in frequencies if math.isfinite(value)], self.view)
        size = [window.segment.level if math.isfinite(window.segment.level) else math.inf for window in locked]
        lowest = np.argsort(size, kind="stable")[:3]
        stretches = [(locked[i].stretch, frequencies[i]) for i in lowest]
        off, more = out_of_scale(self.name, stretches, self.view, self.channels)
        self.notes += more
        self.notes += clipping_notes(self.name, [(window.segment.level_index, window.stretch) for window in locked])
        self.notes += repeats_notes(self.name, [window.stretch for window in locked])
        self.channels = {key: channel for key, channel in self.channels.items() if key not in off}


def _held(run: dict[str, Any]) -> dict[int, str]:
    """What each segment of an imported sidecar says was held, by its level index; those that say nothing left out."""
    try:
        sections = [dict(section) for section in run["imported"]["sidecar"]["segments"]]
    except (KeyError, TypeError, ValueError):
        return {}
    signals = sorted((s for s in sections if "start" in s), key=lambda section: section["start"])
    return {s.get("index") or number: str(s["held"]) for number, s in enumerate(signals) if s.get("held")}


def _drive_points(run: dict[str, Any], recorded: tuple[MeasuredChannel, ...], model: Rig) -> tuple[int, ...]:
    forces = [c.point for c in recorded if c.quantity is Quantity.FORCE and c.point > 0]
    driven = run.get("exciter_points", list(model.exciter_points))
    if isinstance(driven, list) and len(driven) > 1 and set(driven) <= set(forces):
        return tuple(driven)
    if forces:
        return (forces[0],)
    linear = run.get("linear")
    for value in (run.get("exciter_point"), linear.get("drive_point") if isinstance(linear, dict) else None):
        if isinstance(value, int) and not isinstance(value, bool) and value > 0:
            return (value,)
    return (model.drive_point,)
