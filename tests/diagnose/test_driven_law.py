"""The law of a missing force, read from records that a measured force drives, at any place of a structure."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from diagnose.test_imposed_motion import DRIVE, bag_of, diagnosed, record, rig_of, sines
from tiers import with_quick

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.law.driven_law import read_driven_law
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.law.record_search import RecordSearch
from nmt_diagnose.law.responding_record import DrivenBasis, RespondingRecord, RespondingRecords, moving
from nmt_diagnose.law.terms import Term
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.observations.read_observations import read_observations
from nmt_rig.model.assembly import acceleration_output, displacement_output
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.rig_model import build_structure, build_system

RATE = 400.0
TEXT = """
name: row
sample_rate_hz: 400
structure:
  kind: chain
  masses_kg: [0.5, 0.4, 0.3]
  springs_n_m: [900.0, 700.0]
  dampers_ns_m: [0.8, 0.5]
  ground_springs_n_m: [800.0, 0.0, 0.0]
exciter: {kind: force, point: 1}
sensors:
  - {quantity: force, point: drive}
  - {quantity: displacement, point: 1}
  - {quantity: displacement, point: 2}
  - {quantity: acceleration, point: 3}
extraction: {quantity: displacement, linear_modes: 1}
"""
TIME = np.arange(4800) / RATE
TURN = 2.0 * np.pi * TIME
DRIVEN = (1.2 + 0.15 * TIME) * (
    np.sin(2.6 * TURN + 0.3 * np.sin(TIME)) + 0.7 * np.sin(6.1 * TURN + 1.0) + 0.5 * np.sin(9.3 * TURN)
)
LAWS = {
    "hardening spring": ("cubic_spring", "stiffness_n_m3: {}", 3e6, ("power", 1.0)),
    "damping that grows with speed": (
        "power_law_damper", "coefficient_n_sp_mp: {}, exponent: 2.0", 8.0, ("speed", 1.0)
    ),
    "clearance": ("two_sided_gap", "gap_m: 0.004, stiffness_n_m: {}", 1500.0, ("gap", 1.0)),
    "friction of a slider behind a spring": (
        "jenkins", "tangential_stiffness_n_m: {}, slip_force_n: 0.4", 400.0, ("slider", 1.0)
    ),
}  # fmt: skip


def element(words: str, place: str, share: float = 1.0) -> str:
    kind, keys, strength, _ = LAWS[words]
    return f"local_elements:\n  - {{kind: {kind}, {place}, {keys.format(share * strength)}}}\n"


@cache
def motion_of(folder: Path, more: str) -> FloatArray:
    """Channels by the bench's time integration, (3, n)."""
    rig = rig_of(folder, TEXT + more)
    system = build_system(rig, build_structure(rig))
    outputs = [displacement_output(system, 1), displacement_output(system, 2), acceleration_output(system, 3)]
    return np.asarray(TimeIntegrator(system, RATE, outputs, substeps=8).advance(np.append(DRIVEN, DRIVEN[-1])))[
        :, : TIME.size
    ]


def bag(folder: Path, more: str, channels: tuple[int, ...] = (0, 1, 2), seed: int = 1) -> Path:
    random = np.random.default_rng(seed)
    names = ("displacement 1", "displacement 2", "acceleration 3")
    made = motion_of(folder, more)
    columns = {names[k]: made[k] + 2e-4 * float(np.std(made[k])) * random.standard_normal(TIME.size) for k in channels}
    columns["force 1"] = DRIVEN + 1e-3 * random.standard_normal(TIME.size)
    rig_of(folder, TEXT)
    return bag_of(folder, RATE, columns, record(TIME.size, RATE, held="force"), TEXT)


def reading_of(folder: Path, more: str, channels: tuple[int, ...] = (0, 1, 2)) -> LawReading:
    made = bag(folder, more, channels)
    rig = rig_of(folder, TEXT)
    reading = read_driven_law(rig, read_observations([made], rig))
    assert reading is not None
    return reading


@pytest.mark.parametrize(
    ("words", "place"),
    with_quick(
        [(words, place) for words in LAWS for place in ("point: 3", "point: 2, other_point: 1")],
        ("clearance", "point: 2, other_point: 1"),
    ),
)
def test_a_law_is_read_at_its_place_away_from_the_force(tmp_path: Path, words: str, place: str) -> None:
    reading = reading_of(tmp_path, element(words, place))
    assert reading.is_stated
    assert reading.is_written
    (law,) = reading.laws
    assert (law.family, law.place) == (words, "3" if place == "point: 3" else "2-1")
    kind = LAWS[words][3][0]
    term = next(term for term in law.terms if term.kind == kind)
    assert term.coefficient == pytest.approx(LAWS[words][2], rel=0.05)
    assert min(reading.closed_inside, reading.closed_above) > 0.9


def test_a_healthy_record_has_no_law(tmp_path: Path) -> None:
    reading = reading_of(tmp_path, "")
    assert not reading.is_stated
    assert reading.before < 0.5


@pytest.mark.parametrize("words", ["hardening spring", "damping that grows with speed"])
def test_a_column_is_what_a_little_of_its_element_makes_of_the_motion(tmp_path: Path, words: str) -> None:
    """The difference quotient of the bench's time integration."""
    share = 1e-4
    plain, more = (motion_of(tmp_path, element(words, "point: 3", part)) for part in (1e-9, share))
    slope = (more - plain) / (share * LAWS[words][2])
    rig = rig_of(tmp_path, TEXT)
    basis = DrivenBasis.of(rig, read_observations([bag(tmp_path, element(words, "point: 3", 1e-9))], rig), 0, 1500)
    assert isinstance(basis, DrivenBasis)
    place = basis.plant.places.index((3, 0))
    record_at = RespondingRecord.of(basis, place, 5)
    exponent = {"hardening spring": Term("power", 3.0), "damping that grows with speed": Term("speed", 2.0)}[words]
    column = np.split(record_at.column(exponent), np.cumsum([part.size for part in record_at.parts])[:-1])
    for part, streams, at in zip(column, record_at.streams, record_at.parts, strict=True):
        truth = slope[streams, at // basis.plant.stride]
        for channel in range(3):
            some = streams == channel
            assert np.std(part[some] - truth[some]) < 0.02 * np.std(truth[some])


@pytest.mark.campaign
def test_several_records_of_one_rig_have_one_law(tmp_path: Path) -> None:
    """Each with its own beginning; parts of both stand for levels."""
    (first := tmp_path / "first").mkdir()
    (second := tmp_path / "second").mkdir()
    more, rig = element("hardening spring", "point: 3"), rig_of(tmp_path, TEXT)
    bags = [bag(first, more), bag(second, more, (0, 2), seed=2)]
    reading = read_driven_law(rig, read_observations(bags, rig))
    assert reading is not None
    assert reading.is_stated
    assert " and " in reading.test
    (law,) = reading.laws
    assert (law.family, law.place) == ("hardening spring", "3")
    assert law.terms[0].coefficient == pytest.approx(3e6, rel=0.05)


def test_a_record_that_is_held_out_tells_no_law(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, TEXT)
    observations = read_observations([bag(tmp_path, element("hardening spring", "point: 3"))], rig)
    assert read_driven_law(rig, observations.take(np.zeros(len(observations.rows), bool))) is None


def test_gains_do_not_take_off_the_motion_where_no_law_is(tmp_path: Path) -> None:
    """Channels by a gain and the force by another take off every row: without a law both stay ordinary."""
    rig = rig_of(tmp_path, TEXT)
    every = RespondingRecords.at_places(
        rig, read_observations([bag(tmp_path, element("hardening spring", "point: 3"))], rig)
    )
    assert not isinstance(every, str)
    records = every[0]
    search = RecordSearch(records)
    pulls = {
        name: abs(value)
        for name, value in zip(records.names, search.null.fit.nuisance / search.worth, strict=True)
        if name not in records.free
    }
    assert max(pulls.values()) < 3.1
    assert search.null.score > 10.0


def test_a_model_whose_sensors_filter_is_refused_with_the_remedy(tmp_path: Path) -> None:
    made = bag(tmp_path, "")
    text = TEXT.replace("{quantity: displacement, point: 2}", "{quantity: displacement, point: 2, low_pass_hz: 80.0}")
    rig = rig_of(tmp_path, text)
    reading = read_driven_law(rig, read_observations([made], rig))
    assert reading is not None
    assert reading.refusals == (
        "sensors of the model have filters or delays; correct the recording for them and leave them out",
    )


def test_a_place_whose_motion_no_channel_tells_is_not_named(tmp_path: Path) -> None:
    """One sensor far away: its noise leaves the motion between the others open."""
    made = bag(tmp_path, element("hardening spring", "point: 3"), (0, 1))
    rig = rig_of(tmp_path, TEXT)
    every = RespondingRecords.at_places(rig, read_observations([made], rig))
    assert not isinstance(every, str)
    assert {one.place for one in every} == {(1, 0), (2, 0), (3, 0), (2, 1), (3, 2)}
    assert (3, 2) not in {one.place for one in moving(every)}
    (second,) = (one for one in every if one.place == (2, 0))
    size = float(np.std(second.records[0].x))
    for share, known in ((0.15, True), (0.25, False)):
        uncertain = replace(second, records=tuple(replace(one, x_std=share * size) for one in second.records))
        others = [uncertain if one is second else one for one in every]
        assert (uncertain in moving(others)) is known


def test_the_diagnosis_states_the_law_of_a_driven_record(tmp_path: Path) -> None:
    """Where the library has nothing for it, the answer begins with the law and the file gets it."""
    more = element("clearance", "point: 3")
    found = diagnosed(rig_of(tmp_path, TEXT), bag(tmp_path, more), "added_mass")
    assert found.verdict is Verdict.UNKNOWN
    assert "In the record the missing force acts like clearance at point 3" in found.sentences[0]
    assert any("The rig file gets it as local elements" in sentence for sentence in found.sentences[1:])


def test_a_strength_that_follows_a_channel_is_read_from_a_driven_record(tmp_path: Path) -> None:
    """f = (a + b s(t)) v |v| on a mass with a spring, by the trapezoidal rule."""
    text = DRIVE.replace("sample_rate_hz: 200", "sample_rate_hz: 400").format(spring=12.0, damper=0.05)
    signal = 1.0 + 0.6 * np.sin(0.7 * TIME)
    driven = (0.4 + 0.05 * TIME) * sines(TIME, (0.2, 0.7, 0.0), (0.13, 1.9, 1.0), (0.08, 4.3, 2.0))[0]
    steps = 10
    fine = np.arange(steps * (TIME.size - 1) + 1) / steps
    force, strength = (np.interp(fine, np.arange(TIME.size), values) for values in (driven, 2.0 + 3.0 * signal))
    step, x, v = 1.0 / (RATE * steps), 0.0, 0.0
    motion = np.zeros(fine.size)
    for k in range(1, fine.size):
        # The drag of the middle of a step, where the speed of its beginning is close to it.
        lost = 0.05 + strength[k] * abs(v)
        middle = 0.5 * (force[k] + force[k - 1]) - 12.0 * (x + 0.5 * step * v) - lost * v
        change = step * middle / (2e-3 + 0.5 * step * lost + 0.25 * step**2 * 12.0)
        x, v = x + step * (v + 0.5 * change), v + change
        motion[k] = x
    random = np.random.default_rng(3)
    columns = {
        "displacement 1": motion[::steps] + 1e-6 * random.standard_normal(TIME.size),
        "force 1": driven,
        "current 1": signal,
    }
    rig = rig_of(tmp_path, text)
    made = bag_of(tmp_path, RATE, columns, record(TIME.size, RATE, held="force"), text)
    reading = read_driven_law(rig, read_observations([made], rig))
    assert reading is not None
    assert reading.is_stated
    (law,) = reading.laws
    assert law.family == "damping that grows with speed that follows the current"
    base, following = law.terms
    assert base.coefficient == pytest.approx(2.0, rel=0.1)
    assert following.coefficient == pytest.approx(3.0, rel=0.1)
