from __future__ import annotations

import math

import pytest
from extract.synthetic import (
    FREQUENCY,
    RATE,
    SETTINGS,
    Stream,
    in_phase_case,
    interleaved,
    linear_description,
    lock_event,
)

from nmt_core.errors import BenchError
from nmt_core.vocabulary import LoopState, PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.extractor import Extractor
from nmt_extract.modal.hysteresis import HysteresisLayout

SAMPLES = round(5 * RATE / FREQUENCY)


def run(schedule, locks=(), levels=((0, 0.1, "V"), (1, 0.2, "V"))):
    """Blocks with the loop states (state, level index) of the schedule, one for each block."""
    force, shape = in_phase_case()
    stream = Stream([0, force], [[0, x] for x in shape], samples=200 * len(schedule))
    extractor = Extractor(linear_description(), SETTINGS)
    for level in levels:
        extractor.add_level(*level)
    points = []
    locks = {lock.sample: lock for lock in locks}
    for (state, level), pair in zip(
        schedule, interleaved(stream.blocks("force"), stream.blocks("displacement")), strict=True
    ):
        for block in pair:
            extractor.add_block(block.quantity.topic, block)
        last = pair[0].end_sample - 1
        if last in locks:
            extractor.add_lock(locks[last])
        reason = "no lock within 30 s" if state == LoopState.LOCK_LOST else ""
        extractor.add_state(last, state, level, reason, "m")
        points += extractor.take()
    return [*points, *extractor.finish()], extractor


def test_a_level_that_locks_gives_one_point():
    lock = lock_event(400, SAMPLES, 5, sample=399)
    points, extractor = run([(LoopState.ACQUIRING, 0), *[(LoopState.LOCKED, 0)] * 14], [lock])
    assert [point.status for point in points] == [PointStatus.OK]
    assert points[0].damping_ratio == pytest.approx(0.012, rel=1e-9)
    assert points[0].time_ns == round((400 + SAMPLES - 1) / RATE * 1e9)
    assert extractor.counters["points"] == 1
    assert extractor.counters["blocks_force"] == 15


def test_a_level_that_never_locks_is_reported_once():
    points, extractor = run([(LoopState.FIXED, 0), (LoopState.ACQUIRING, 0), *[(LoopState.LOCK_LOST, 0)] * 5])
    (point,) = points
    assert point.status is PointStatus.NOT_LOCKED
    assert point.reason == "The level did not lock: no lock within 30 s."
    assert (point.level, point.level_unit, point.level_index) == (0.1, "V", 0)
    assert math.isnan(point.damping_ratio)
    assert extractor.counters["not_locked"] == 1


def test_every_level_that_does_not_lock_is_reported():
    schedule = [
        (LoopState.ACQUIRING, 0),
        (LoopState.LOCK_LOST, 0),
        (LoopState.LOCK_LOST, 0),
        (LoopState.ACQUIRING, 1),
        (LoopState.ACQUIRING, 1),
        (LoopState.LOCK_LOST, 1),
    ]
    points, _ = run(schedule)
    assert [(point.level_index, point.level, point.status) for point in points] == [
        (0, 0.1, PointStatus.NOT_LOCKED),
        (1, 0.2, PointStatus.NOT_LOCKED),
    ]


def test_lock_lost_within_the_window_rejects_it_and_is_not_reported_twice():
    lock = lock_event(400, SAMPLES, 5, sample=399)
    points, _ = run([(LoopState.ACQUIRING, 0), *[(LoopState.LOCKED, 0)] * 5, *[(LoopState.LOCK_LOST, 0)] * 9], [lock])
    (point,) = points
    assert point.status is PointStatus.REJECTED
    assert "lock lost at sample 1399 (no lock within 30 s)" in point.reason


def test_lock_lost_after_the_window_does_no_harm():
    lock = lock_event(400, SAMPLES, 5, sample=399)
    points, _ = run([(LoopState.ACQUIRING, 0), *[(LoopState.LOCKED, 0)] * 14, (LoopState.LOCK_LOST, 0)], [lock])
    assert [point.status for point in points] == [PointStatus.OK]


def test_a_second_try_of_the_same_level_counts_for_itself():
    lock = lock_event(400, SAMPLES, 5, sample=399)
    points, _ = run(
        [(LoopState.ACQUIRING, 0), *[(LoopState.LOCKED, 0)] * 14, (LoopState.ACQUIRING, 0), (LoopState.LOCK_LOST, 0)],
        [lock],
    )
    assert [point.status for point in points] == [PointStatus.OK, PointStatus.NOT_LOCKED]


def test_the_end_of_the_streams_gives_up_the_open_window():
    lock = lock_event(400, SAMPLES, 5, sample=399)
    points, _ = run([(LoopState.ACQUIRING, 0), *[(LoopState.LOCKED, 0)] * 7], [lock])
    (point,) = points
    assert point.reason == "The window was never completed: 'force' ended after 1200 of its 2253 samples."


def test_a_level_nobody_announced_has_the_responses_unit():
    points, _ = run([(LoopState.ACQUIRING, 0), (LoopState.LOCK_LOST, 0)], levels=())
    assert math.isnan(points[0].level)
    assert points[0].level_unit == "m"


def test_the_quiet_level_at_the_end_is_no_level():
    points, _ = run([(LoopState.ACQUIRING, 0), (LoopState.LOCK_LOST, 0)], levels=((0, 0.1, "V"), (0, 0.0, "V")))
    assert points[0].level == 0.1


@pytest.mark.parametrize(
    "values",
    [
        {"harmonics": 0},
        {"harmonics": 2.5},
        {"harmonics": True},
        {"sub_windows": 2},
        {"minimum_periods": 1},
        {"topics": ["force"]},
        {"topics": ["displacement"]},
        {"topics": ["force", "force", "displacement"]},
        {"topics": ["force", "sound"]},
        {"topics": "force"},
        {"hysteresis": {"masses": 3}},
        {"colour": "red"},
    ],
)
def test_settings_that_make_no_sense_are_refused(values):
    with pytest.raises(BenchError):
        ExtractionSettings.from_mapping(values)


def test_settings_survive_json_values():
    layout = HysteresisLayout(1, 2, 3, 1.5, 2.5)
    settings = ExtractionSettings(harmonics=7, topics=("force", "acceleration"), hysteresis=layout)
    assert ExtractionSettings.from_mapping(settings.to_mapping()) == settings
    assert ExtractionSettings.from_mapping({}) == ExtractionSettings()
