"""From bags to observations: every kind of test that a real side may contain."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import MOTIONS, ROTATION_UNITS, TestKind
from nmt_diagnose.coverage import NotCoveredError, covers
from nmt_diagnose.measurements.backbone_table.reading import table_observations
from nmt_diagnose.measurements.backbone_table.unforced import is_unforced, unforced_observations
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record.reading import record_observations
from nmt_diagnose.measurements.imposed_motion.reading import (
    Window,
    imposed_motion_observations,
    reason_for_imposed,
)
from nmt_diagnose.measurements.locked_windows.reading import phase_resonance_observations
from nmt_diagnose.measurements.random_responses.reading import random_observations
from nmt_diagnose.measurements.recorded_decay.reading import ring_down_observations
from nmt_diagnose.measurements.stepped_responses.reading import is_response, stepped_sine_observations
from nmt_diagnose.measurements.stepped_responses.table_reading import measured_together
from nmt_diagnose.observations.channels.bag_samples import SampleStretch, read_windows
from nmt_diagnose.observations.channels.measuring_chain import measuring_chain
from nmt_diagnose.observations.channels.plausibility import check_frequency, clipping_notes, out_of_scale, repeats_notes
from nmt_diagnose.observations.model_view import ModelView, matched
from nmt_diagnose.observations.noise.floors import repeatability, with_stated_repeatability
from nmt_diagnose.observations.noise.scatter import with_shared_scatter
from nmt_diagnose.observations.observables import Observations, empty, joined
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.origin import origin_of, refuse_own_recordings, strangers
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.reduced.observables import ObservableTable, observable_tables
from nmt_record.windows.recorded_tests import recorded_tests
from nmt_record.windows.segments import Segment, segments
from nmt_rig.rig import Rig

_LOCKED = (TestKind.PHASE_RESONANCE, TestKind.STEPPED_SINE, TestKind.RESPONSE_CURVE)


def read_observations(
    bags: Sequence[Path | str],
    model: Rig,
    floor_bags: Sequence[Path | str] = (),
    settings: ObservationSettings | None = None,
    progress: Callable[[str], None] | None = None,
    allow_own_model: bool = True,
    readings: dict[tuple[str, str], Observations] | None = None,
) -> Observations:
    """All observables of a real side.

    Locked windows, random tests, ring-downs, records and reduced tables become tests; imported stepped sines and
    response curves become frequency responses at their measured force, stepped sines of the bench's own runs near
    resonance count as locked windows whose phase nobody controlled. What :func:`~nmt_diagnose.coverage.covers` does not
    take and what cannot be used is left out, with a sentence in ``notes``.

    Args:
        bags: bags of one rig: recorded runs or imports.
        model: the rig file that is to be compared with them.
        floor_bags: repeats of tests among ``bags``; the differences are what no model can beat.
        settings: None = defaults.
        progress: called with a sentence as the work goes on.
        allow_own_model: take recordings that ``model`` itself made, too.
        readings: of earlier calls with the same model and settings, by name and digest; takes what this one reads.

    Raises:
        BenchError: there is no such bag, a bag is damaged or of another rig, the model itself made it, or nothing in
            them can be used.
    """
    settings = settings or ObservationSettings()
    if not bags:
        raise BenchError("The diagnosis needs at least one bag of the real side; give --real.")
    observations = _read_all(bags, model, settings, progress, readings)
    made = [(path, origin) for (path, _), origin in zip(observations.inputs, observations.origins, strict=True)]
    if not allow_own_model:
        refuse_own_recordings(model, made)
    if not len(observations.rows):
        reasons = " ".join(observations.notes) or "No level was locked and no other test was made."
        raise BenchError(f"Nothing in {', '.join(map(str, bags))} can be used as observations. {reasons}")
    observations = with_shared_scatter(observations)
    notes = [*observations.notes, *strangers(made)]
    if floor_bags:
        repeats = _read_all(floor_bags, model, settings, progress)
        floor, more = repeatability(observations, repeats)
        notes += [*(f"Floor bag: {note}" for note in repeats.notes), *more]
        observations = replace(
            observations,
            floor=floor,
            inputs=(*observations.inputs, *repeats.inputs),
            origins=(*observations.origins, *repeats.origins),
        )
    return replace(observations, notes=tuple(dict.fromkeys(notes)))


def _read_all(
    bags: Sequence[Path | str],
    model: Rig,
    settings: ObservationSettings,
    progress: Callable[[str], None] | None,
    readings: dict[tuple[str, str], Observations] | None = None,
) -> Observations:
    parts: list[Observations] = []
    path_by_digest: dict[str, str] = {}
    names: set[str] = set()
    readings = {} if readings is None else readings
    for path in map(Path, bags):
        digest = bag_digest(path)
        if digest in path_by_digest:
            parts.append(empty((f"The bag {path} is the same as {path_by_digest[digest]} and is used once.",)))
            continue
        path_by_digest[digest] = str(path)
        name = _unique(_name(path), names)
        if (name, digest) in readings:
            parts.append(readings[name, digest])
            continue
        if progress is not None:
            progress(f"reading {path}")
        bag = Bag.open(path)
        try:
            part = read_bag(bag, name, model, settings)
        except BenchError as refusal:
            if len(bags) == 1:
                raise
            sentence = str(refusal)
            part = empty((sentence if isinstance(refusal, NotCoveredError) else f"{name} is left out: {sentence}",))
        origin = origin_of(bag, path, [test.name for test in part.tests])
        readings[name, digest] = replace(part, inputs=((str(path), digest),), origins=(origin,))
        parts.append(readings[name, digest])
    return joined(parts)


def _turns(bag: Bag, tables: Sequence[ObservableTable]) -> bool:
    """Whether all motions and forces of a bag are angles and torques."""
    firsts: dict[str, tuple[Quantity, str]] = {}
    for topic, block in bag.heads():
        firsts.setdefault(topic, (block.quantity, block.unit))
        if len(firsts) == len(bag.sample_topics):
            break
    turning = [unit == ROTATION_UNITS[kind] for kind, unit in firsts.values() if kind in ROTATION_UNITS]
    turning += [table.turns for table in tables]
    return bool(turning) and all(turning)


def read_bag(bag: Bag, name: str, model: Rig, settings: ObservationSettings) -> Observations:
    """All observables of one bag.

    Args:
        bag: an opened bag.
        name: for its tests and sentences.
        model: the rig file that is to be compared with it.
        settings: settings.

    Raises:
        BenchError: the bag is damaged or of another rig.
    """
    notes: list[str] = [bag.loss] if bag.loss else []
    run = bag.run_start or {}
    tables = observable_tables(bag) if "observables" in bag.topics else []
    if _turns(bag, tables):
        model = model.model_copy(update={"coordinate": "angle"})
    rig = run.get("rig")
    if isinstance(rig, str) and rig and rig != model.name:
        notes.append(f"{name} was recorded on rig '{rig}', the model is '{model.name}'.")
    parts: list[Observations] = []
    found = segments(bag)
    tests = recorded_tests(bag, found)
    refused = {test.kind: sentence for test in tests if (sentence := covers(test))}
    if len(refused) == len(tests) and not tables:
        raise NotCoveredError(f"{name}: {next(iter(refused.values()))}")
    notes += [f"{name}: {sentence}" for sentence in refused.values()]
    found = [segment for segment in found if segment.kind not in refused]
    usable = [segment for segment in found if segment.usable_samples]
    for segment in found:
        level = f"{name}: level {segment.level_index} ({segment.kind.label})"
        if segment in usable and segment.fault:
            share = f"{segment.usable_samples} of {segment.samples} samples"
            notes.append(f"{level} is used in part, {share} from {segment.usable_first_sample} on: {segment.fault}.")
        elif segment.fault:
            notes.append(f"{level} is left out: {segment.fault}.")
    if usable:
        sine = not any(test.has_several_exciters or test.controlled_harmonics for test in tests)
        parts += _signals(bag, name, usable, run, model, settings, sine, notes)
    for numbers in measured_together(tables, model.drive_point):
        first = tables[numbers[0]].name or f"table {numbers[0] + 1}"
        count = len(numbers) - 1
        more = f" and {count} more point{'s' if count > 1 else ''}" if count else ""
        test_name = name if len(tables) == len(numbers) and not usable else f"{name}/{first}{more}"
        reduced = table_observations(test_name, [tables[number] for number in numbers], model, settings)
        chains = tuple(test.table_chain(settings.calibration) for test in reduced.tests)
        parts.append(replace(reduced, chains=chains))
    if not found and not tables:
        notes.append(f"{name}: no level was locked and no window was marked, so there is nothing to compare.")
    return with_stated_repeatability(joined([empty(notes), *parts]), run)


@dataclass(frozen=True)
class _Window:
    segment: Segment
    stretch: SampleStretch


def _signals(
    bag: Bag,
    name: str,
    usable: list[Segment],
    run: dict[str, Any],
    model: Rig,
    settings: ObservationSettings,
    sine: bool,
    notes: list[str],
) -> list[Observations]:
    """Observations of the windows of one bag."""
    stretches = read_windows(bag, usable)
    windows = []
    for segment, stretch in zip(usable, stretches, strict=True):
        if stretch is None or stretch.samples < THRESHOLDS.reading.stretch_fewest_samples:
            where = f"{name}: level {segment.level_index}"
            notes.append(f"{where} is left out: the bag has no samples of its window, or hardly any.")
        else:
            windows.append(_Window(segment, stretch))
    if not windows:
        return []
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
    of_decays = {c.name: c for c in recorded if c.quantity in MOTIONS and c.point in model.structure.points} | channels
    decays = [window.segment.kind is TestKind.RING_DOWN for window in windows]
    if all(decays):
        channels, more = of_decays, ()
    held = _held(run)
    imposed = [Window(w.segment, w.stretch, held.get(w.segment.level_index, "")) for w in windows]
    imposed = [window for window in imposed if "imported" in run and reason_for_imposed(window, view)]
    notes += [f"{name}: {note}" for note in more]
    if not imposed and not any(
        channel.quantity in MOTIONS for channel in (of_decays if any(decays) else channels).values()
    ):
        raise BenchError(
            f"{name} has no response channel that the model {model.name} has too; name the rig file of the rig that "
            "was tested, or add its sensors."
        )
    sampling = windows[0].stretch.sample_rate
    rate = _hold_rate(run, sampling)
    response = _response_quantity(run)
    parts = []
    if imposed:
        test_name = f"{name}/imposed" if len(imposed) < len(windows) else name
        parts.append(imposed_motion_observations(test_name, imposed, view, channels, settings))
        segments_taken = [window.segment for window in imposed]
        windows = [window for window in windows if window.segment not in segments_taken]
    locked = [window for window in windows if window.segment.kind in _LOCKED]
    unforced = [(w.segment, w.stretch) for w in locked if is_unforced(w.segment, w.stretch, model)]
    if unforced:
        test_name = f"{name}/unforced" if len(unforced) < len(windows) else name
        parts.append(unforced_observations(test_name, unforced, view, channels, settings))
        notes += _few_levels(test_name, len(parts[-1].rows))
        windows = [window for window in windows if not is_unforced(window.segment, window.stretch, model)]
        locked = [window for window in locked if not is_unforced(window.segment, window.stretch, model)]
    if locked:
        channels = _plausible(name, locked, view, channels, notes)
        several = len({window.segment.kind for window in windows}) > 1
        for kind in _LOCKED:
            selected = [(window.segment, window.stretch) for window in locked if window.segment.kind is kind]
            if selected:
                test_name = f"{name}/{kind.label}" if several else name
                imported = kind is TestKind.STEPPED_SINE and "imported" in run and is_response(selected)
                if imported or kind is TestKind.RESPONSE_CURVE:
                    parts.append(stepped_sine_observations(test_name, selected, view, channels, settings))
                    continue
                parts.append(
                    phase_resonance_observations(test_name, selected, view, channels, settings, response, rate, sine)
                )
                levels = len(parts[-1].tests[0].locked_levels) if parts[-1].tests else 0
                notes += _few_levels(test_name, levels)
    broad_band = [kind for kind in TestKind if kind_class(kind).is_broad_band]
    for kind in (*broad_band, TestKind.RING_DOWN):
        windows_of_kind = [window for window in windows if window.segment.kind is kind]
        for window in windows_of_kind:
            test_name = f"{name}/{kind.label}" if len(windows) > len(windows_of_kind) else name
            test_name = f"{test_name} {window.segment.level_index}" if len(windows_of_kind) > 1 else test_name
            notes += clipping_notes(test_name, [(window.segment.level_index, window.stretch)])
            notes += repeats_notes(test_name, [window.stretch])
            if kind in broad_band:
                parts += _random(test_name, window.stretch, view, channels, settings, rate)
            else:
                guess = window.segment.frequency_hz
                parts.append(
                    ring_down_observations(test_name, window.stretch, guess, view, of_decays, settings, response)
                )
    records = [window for window in windows if window.segment.kind is TestKind.RECORD]
    if records:
        test_name = f"{name}/record" if len(records) < len(windows) else name
        taken = [window.stretch for window in records]
        parts.append(record_observations(test_name, taken, view, channels, settings, math.isfinite(rate)))
    chain = measuring_chain(run, channels, sampling, bag.rig_yaml, settings.calibration)
    return [replace(part, chains=(chain,) * len(part.tests)) for part in parts]


def _few_levels(name: str, levels: int) -> list[str]:
    """What a test of few levels cannot tell."""
    if not 0 < levels < THRESHOLDS.reading.few_levels:
        return []
    return [
        f"{name}: {levels} level{'s' if levels > 1 else ''} cannot tell effects apart by how they grow with amplitude; "
        "measure five or more."
    ]


def _random(
    name: str,
    stretch: SampleStretch,
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: ObservationSettings,
    rate: float,
) -> list[Observations]:
    """Responses to the drive of each exciter, with what those of the others do taken out."""
    points = view.rig.exciter_points
    if len(points) == 1:
        return [random_observations(name, stretch, view, channels, settings, rate)]
    voltages = view.voltages(stretch.channels)
    found = []
    for number, point in enumerate(points):
        order = [number, *(k for k in range(len(points)) if k != number)]
        own = ModelView.of(view.rig, [points[k] for k in order])
        named = [voltages[k] for k in order]
        where = f"{name} from point {point}"
        found.append(random_observations(where, stretch, own, channels, settings, rate, named))
    return found


def _held(run: dict[str, Any]) -> dict[int, str]:
    """What each segment of an imported sidecar says was held, by its level index; those that say nothing left out."""
    try:
        sections = [dict(section) for section in run["imported"]["sidecar"]["segments"]]
    except (KeyError, TypeError, ValueError):
        return {}
    signals = sorted((s for s in sections if "start" in s), key=lambda section: section["start"])
    return {s.get("index") or number: str(s["held"]) for number, s in enumerate(signals) if s.get("held")}


def _plausible(
    name: str,
    locked: list[_Window],
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    notes: list[str],
) -> dict[str, MeasuredChannel]:
    """Channels that can be trusted."""
    frequencies = [_frequency(window) for window in locked]
    check_frequency(name, [value for value in frequencies if math.isfinite(value)], view)
    size = [window.segment.level if math.isfinite(window.segment.level) else math.inf for window in locked]
    lowest = np.argsort(size, kind="stable")[:3]
    off, more = out_of_scale(name, [(locked[i].stretch, frequencies[i]) for i in lowest], view, channels)
    notes += more
    notes += clipping_notes(name, [(window.segment.level_index, window.stretch) for window in locked])
    notes += repeats_notes(name, [window.stretch for window in locked])
    return {key: channel for key, channel in channels.items() if key not in off}


def _frequency(window: _Window) -> float:
    cycles = window.stretch.cycles
    if cycles is not None and cycles.size > 1:
        return float(cycles[-1] - cycles[0]) / (cycles.size - 1) * window.stretch.sample_rate
    return window.segment.frequency_hz if window.segment.frequency_hz > 0.0 else math.nan


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


def _response_quantity(run: dict[str, Any]) -> Quantity | None:
    extraction = run.get("extraction")
    topics = extraction.get("topics") if isinstance(extraction, dict) else None
    for topic in topics if isinstance(topics, list | tuple) else ():
        if topic in ("displacement", "velocity", "acceleration"):
            return Quantity[topic.upper()]
    return None


def _hold_rate(run: dict[str, Any], sample_rate: float) -> float:
    """Rate at which the drive was interpolated linearly: ``drive_hold_hz`` of the run, else that of simulated rigs."""
    value = run.get("drive_hold_hz")
    if isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0:
        return float(value)
    return math.inf if "imported" in run or not run else sample_rate


def bag_digest(path: Path) -> str:
    """SHA-256 over the data files of a bag, in the order of their names.

    Raises:
        BenchError: a file cannot be read.
    """
    found = sorted(item for item in path.rglob("*") if item.suffix in (".mcap", ".db3"))
    files = [path] if path.is_file() else found
    digest = hashlib.sha256()
    try:
        for file in files:
            with open(file, "rb") as handle:
                while chunk := handle.read(1 << 20):
                    digest.update(chunk)
    except OSError as error:
        raise BenchError(f"The bag {path} cannot be read: {error.strerror or error}.") from error
    return digest.hexdigest()


def _name(path: Path) -> str:
    stem = path.stem if path.is_file() else path.name
    return path.resolve().parent.name or stem if stem in ("bag", "") else stem


def _unique(name: str, taken: set[str]) -> str:
    result, number = name, 2
    while result in taken:
        result, number = f"{name} ({number})", number + 1
    taken.add(result)
    return result
