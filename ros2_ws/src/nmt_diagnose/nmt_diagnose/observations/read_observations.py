"""From bags to observations: every kind of test that a real side may contain."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.vocabulary import ROTATION_UNITS
from nmt_diagnose.coverage import NotCoveredError, covers, refuse_unbalanced
from nmt_diagnose.measurements.measurement import Observations, empty, joined
from nmt_diagnose.measurements.registry import MEASUREMENTS
from nmt_diagnose.measurements.stepped_reading import measured_together
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.channels.measuring_chain import measuring_chain, table_chain
from nmt_diagnose.observations.noise.floors import repeatability, with_stated_repeatability
from nmt_diagnose.observations.noise.scatter import with_shared_scatter
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.origin import origin_of, refuse_own_recordings, strangers
from nmt_diagnose.observations.read_tables import table_observations
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.reduced.observables import ObservableTable, observable_tables
from nmt_record.windows.segments import Segment, recorded_tests, segments
from nmt_rig.rig import Rig


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
    resonance count as locked windows without control of the phase. What :func:`~nmt_diagnose.coverage.covers` does not
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
        BenchError: a bag does not exist, is damaged or of another rig, the model itself made it, or nothing in them can
            be used.
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
    refuse_unbalanced(model, observations.tests)
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
    return replace(observations, notes=notes_together(notes))


def notes_together(notes: Iterable[str]) -> tuple[str, ...]:
    """Notes of ``name: sentence``, those with the same sentence as one of all their names, each once."""
    names: dict[str, dict[str, None]] = {}
    for note in notes:
        name, mark, sentence = note.partition(": ")
        names.setdefault(sentence if mark else note, {})[name if mark else ""] = None
    return tuple(f"{', '.join(several)}: {text}" if any(several) else text for text, several in names.items())


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
        notes.append(f"{name}: recorded on rig '{rig}'; the model is '{model.name}'.")
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
        parts += _read_windows(bag, name, usable, model, settings, tests, notes)
    for numbers in measured_together(tables, model.drive_point):
        first = tables[numbers[0]].name or f"table {numbers[0] + 1}"
        count = len(numbers) - 1
        more = f" and {count} more point{'s' if count > 1 else ''}" if count else ""
        test_name = name if len(tables) == len(numbers) and not usable else f"{name}/{first}{more}"
        reduced = table_observations(test_name, [tables[number] for number in numbers], model, settings)
        chains = tuple(
            None if test.lines is None else table_chain(test.channels, settings.calibration) for test in reduced.tests
        )
        parts.append(replace(reduced, chains=chains))
    if not found and not tables:
        notes.append(f"{name}: no level was locked and no window was marked, so there is nothing to compare.")
    return with_stated_repeatability(joined([empty(notes), *parts]), run)


def _read_windows(
    bag: Bag,
    name: str,
    usable: list[Segment],
    model: Rig,
    settings: ObservationSettings,
    tests: Sequence[DrivenTest],
    notes: list[str],
) -> list[Observations]:
    """Observables of the windows of one bag: each kind of measurement is asked what of them is its own."""
    sine = not any(test.has_several_exciters or test.controlled_harmonics for test in tests)
    windows = BagWindows.of(bag, name, usable, model, settings, sine, notes)
    if windows is None:
        return []
    parts = [part for kind in MEASUREMENTS for part in kind.read(windows)]
    chain = measuring_chain(windows.run, windows.channels, windows.sample_rate, bag.rig_yaml, settings.calibration)
    return [replace(part, chains=(chain,) * len(part.tests)) for part in parts]


def bag_digest(path: Path) -> str:
    """SHA-256 over the data files of a bag, or of a results folder's bag, in the order of their names.

    Raises:
        BenchError: a file cannot be read.
    """
    digest = hashlib.sha256()
    try:
        folders = [folder for folder in (path, path / "bag") if folder.is_dir()]
        found = sorted(item for folder in folders for item in folder.iterdir() if item.suffix in (".mcap", ".db3"))
        files = [path] if path.is_file() else found
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
