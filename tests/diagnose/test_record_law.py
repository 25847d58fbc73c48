"""The law of a missing force, read from a record of an imposed motion whose force was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnose.one_of_each_kind import KINDS, rig_of_kinds
from diagnose.test_imposed_motion import DRIVE, RATE, bag_of, jenkins, record, rig_of, sines
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from tiers import with_quick

from nmt_core.numerics.arrays import FloatArray
from nmt_core.text.number_words import significant
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import library
from nmt_diagnose.law.law_blocks import Along, Block, BlockColumns
from nmt_diagnose.law.law_elements import with_law
from nmt_diagnose.law.moved_record import MovedRecords
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.law.record_check import autocorrelation
from nmt_diagnose.law.record_law import parting_motion, read_record_law
from nmt_diagnose.law.record_search import RecordSearch
from nmt_diagnose.law.terms import Term
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.say.law_sentences import law_sentences
from nmt_diagnose.search.law_starts import law_of
from nmt_report.law_figures import law_figure, law_table
from nmt_rig.rig import load_rig
from nmt_rig.rig_snapshot import rig_text

TEXT = DRIVE.format(spring=12.0, damper=0.05)
TIME = np.arange(4000) / RATE
# Three sines that grow: displacement, velocity and acceleration by the spline of their sum.
_SPLINE = CubicSpline(
    TIME, (0.3 + 0.035 * TIME) * sines(TIME, (0.01, 1.0, 0.0), (0.004, 2.7, 1.0), (0.002, 6.1, 2.0))[0]
)
X, V, A = _SPLINE(TIME), _SPLINE(TIME, 1), _SPLINE(TIME, 2)


def reading_of(folder: Path, missing: FloatArray, noise: float = 1e-3) -> LawReading:
    """What is read of a mass of 2 g with a spring and a damper beside a missing force."""
    random = np.random.default_rng(1)
    force = 2e-3 * A + 0.05 * V + 12.0 * X + missing + noise * random.standard_normal(TIME.size)
    columns = {"displacement 1": X + 1e-6 * random.standard_normal(TIME.size), "force 1": force}
    rig = rig_of(folder, TEXT)
    bag = bag_of(folder, RATE, columns, record(TIME.size, held="response"), TEXT)
    reading = law_of(rig, read_observations([bag], rig))
    assert reading is not None
    return reading


LAWS = {
    "hardening spring": (4e5 * X**3, {"power": 4e5}),
    "dry friction": (0.03 * np.tanh(V / 1e-4), {"friction": 0.03}),
    "dry friction that weakens with speed": (
        (0.02 + 0.03 * np.exp(-((V / 0.05) ** 2))) * np.tanh(V / 1e-3),
        {"friction": 0.02, "weakening friction": 0.03},
    ),
    "friction of a slider behind a spring": (jenkins(X, 60.0, 0.05), {"slider": 60.0}),
    "damping that grows with speed": (8.0 * V * np.abs(V), {"speed": 8.0}),
    "clearance": (300.0 * np.sign(X) * np.maximum(np.abs(X) - 0.006, 0.0), {"gap": 300.0}),
    "stop on one side": (300.0 * np.maximum(X - 0.006, 0.0), {"stop": 300.0}),
}


@pytest.mark.parametrize("words", with_quick(LAWS, "dry friction", "stop on one side"))
def test_a_law_is_read_with_its_strengths(tmp_path: Path, words: str) -> None:
    missing, strengths = LAWS[words]
    reading = reading_of(tmp_path, missing)
    assert reading.is_stated
    (law,) = reading.laws
    assert (law.family, law.place) == (words, "1")
    assert reading.late is None  # a force in step is not reported as a delay
    found = {term.kind: term for term in law.terms}
    for kind, strength in strengths.items():
        assert found[kind].coefficient == pytest.approx(strength, rel=0.03)
        assert abs(found[kind].coefficient - strength) < 4.0 * found[kind].std
    assert reading.closed_inside > 0.95
    assert reading.closed_above > 0.95
    assert law.valid_to_m == pytest.approx(np.abs(X).max(), rel=0.01)
    for loop in law.loops:
        np.testing.assert_allclose(loop.measured, loop.law, atol=0.15 * np.ptp(missing))


@pytest.mark.campaign
def test_noise_beyond_the_stated_one_refuses_no_law(tmp_path: Path) -> None:
    """Half of the misfit is white noise."""
    missing = LAWS["hardening spring"][0]
    reading = reading_of(tmp_path, missing, noise=float(np.std(missing)))
    assert reading.after > 0.5 * reading.before
    assert reading.is_stated
    assert [law.family for law in reading.laws] == ["hardening spring"]


BESIDE = {
    "dry friction and damping that grows with speed": (
        0.05 * np.tanh(V / 2e-3) + 8.0 * V * np.abs(V), {"friction": 0.05, "speed": 8.0}
    ),
    "friction of a slider behind a spring and stop on one side": (
        jenkins(X, 60.0, 0.05) + 300.0 * np.maximum(X - 0.006, 0.0), {"slider": 60.0, "stop": 300.0}
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", with_quick(BESIDE, next(iter(BESIDE))))
def test_terms_side_by_side_are_told_apart(tmp_path: Path, words: str) -> None:
    """Beside a preload of any size, which is not a part of the law."""
    missing, strengths = BESIDE[words]
    reading = reading_of(tmp_path, missing + 0.3)
    assert reading.is_stated
    (law,) = reading.laws
    assert set(law.family.split(" and ")) == set(words.split(" and "))
    found = {term.kind: term for term in law.terms}
    for kind, strength in strengths.items():
        assert found[kind].coefficient == pytest.approx(strength, rel=0.05)
        assert abs(found[kind].coefficient - strength) < 4.0 * found[kind].std
    assert min(reading.closed_inside, reading.closed_above) > 0.95


def late(force: FloatArray, seconds: float) -> FloatArray:
    """The force so much later, by the spline of its samples."""
    return np.asarray(CubicSpline(TIME, force)(TIME - seconds))


# Seconds by which the force comes late, halves of a sample among them.
LATE = {
    "dry friction": -0.015, "friction of a slider behind a spring": 0.025, "hardening spring": 0.015,
    "damping that grows with speed": 0.0125, "clearance": 0.04,
}  # fmt: skip


@pytest.mark.parametrize("words", with_quick(LATE, "clearance"))
def test_a_law_is_read_beside_a_force_that_comes_late(tmp_path: Path, words: str) -> None:
    missing, strengths = LAWS[words]
    known = 2e-3 * A + 0.05 * V + 12.0 * X
    reading = reading_of(tmp_path, late(known + missing, LATE[words]) - known)
    assert reading.is_stated
    (law,) = reading.laws
    assert law.family == words
    assert reading.late is not None
    assert reading.late == ("f1", pytest.approx(LATE[words], abs=5e-4))
    for kind, strength in strengths.items():
        term = next(term for term in law.terms if term.kind == kind)
        assert term.coefficient == pytest.approx(strength, rel=0.05)
    sentences = " ".join(law_sentences(reading, True))
    goes = "after" if LATE[words] > 0.0 else "ahead of"
    assert f"f1 comes {significant(1e3 * abs(reading.late[1]), 2)} ms {goes} the motion" in sentences
    delays = [sensor.delay_s for sensor in with_law(rig_of(tmp_path, TEXT), reading).sensors]
    # The bench has no channel that leads by more than a sample.
    assert max(delays) == pytest.approx(max(LATE[words], 0.0), abs=5e-4)


def test_a_force_that_only_comes_late_is_no_law(tmp_path: Path) -> None:
    known = 2e-3 * A + 0.05 * V + 12.0 * X
    reading = reading_of(tmp_path, late(known, 0.02) - known)
    assert not reading.is_stated
    assert reading.late == ("f1", pytest.approx(0.02, abs=1e-3))


@pytest.mark.parametrize(("stiffness", "relaxation"), with_quick([(30.0, 0.02), (60.0, 0.15)], (60.0, 0.15)))
def test_hysteresis_that_no_law_has_is_not_told_as_a_delay(tmp_path: Path, stiffness: float, relaxation: float) -> None:
    """A spring behind a damper (Maxwell): its force runs ahead of the displacement at every frequency."""
    left = np.exp(-1.0 / RATE / relaxation)
    way = relaxation * (1.0 - left) * 0.5 * (V[1:] + V[:-1])
    assert reading_of(tmp_path, stiffness * np.append(0.0, lfilter([1.0], [1.0, -left], way))).late is None


def test_the_shape_of_a_law_holds_along_a_smaller_motion(tmp_path: Path) -> None:
    """A slider whose spring stiffens: at half of the motion most of it lies where a straight spring is wrong."""

    def stiffening(x: FloatArray) -> FloatArray:
        z = jenkins(x, 1.0, 0.004)
        return 10.0 * z + 6e5 * z**3

    reading = reading_of(tmp_path, stiffening(X))
    assert reading.is_stated
    (law,) = reading.laws
    assert law.family == "friction with pinched loops"
    x, v = (0.35 * part[np.newaxis] for part in (X, V))
    force = sum(term.coefficient * term.of_unit_strength.force(x, v, closed=False)[0] for term in law.terms)
    truth = stiffening(x[0])
    assert np.std(force - truth) < 0.02 * np.std(truth)


def test_laws_that_one_narrow_sine_does_not_tell_apart_are_named_with_a_motion_that_does(tmp_path: Path) -> None:
    turn = 2.0 * np.pi * 1.3 * TIME
    size = 0.012 * (1.0 + 0.01 * np.sin(0.3 * TIME))
    x, v, a = size * np.sin(turn), size * 8.168 * np.cos(turn), -size * 8.168**2 * np.sin(turn)
    random = np.random.default_rng(1)
    force = 2e-3 * a + 0.05 * v + 12.0 * x + 4e5 * x**3 + 0.03 * random.standard_normal(TIME.size)
    rig = rig_of(tmp_path, TEXT)
    columns = {"displacement 1": x + 1e-6 * random.standard_normal(TIME.size), "force 1": force}
    bag = bag_of(tmp_path, RATE, columns, record(TIME.size, held="response"), TEXT)
    reading = law_of(rig, read_observations([bag], rig))
    assert reading is not None
    (law,) = reading.laws
    assert "hardening spring" in (law.family, *law.other_families)
    assert law.other_families
    assert law.parted_by.startswith(("twice the displacement", "half of the displacement"))
    assert f"record a motion of {law.parted_by}. Check first that the specimen" in " ".join(
        law_sentences(reading, True)
    )


def test_rows_that_lie_far_apart_separate_no_noise_from_a_misfit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_of(tmp_path, TEXT)
    bag = bag_of(tmp_path, RATE, {"displacement 1": X, "force 1": 4e5 * X**3}, record(TIME.size, held="response"), TEXT)
    records = MovedRecords.of(rig, read_observations([bag], rig))
    assert records is not None
    search = RecordSearch(records)
    law = search.law([Block("law", (Term("friction", 0.01),))])
    share = law.score / search.null.score
    assert search.remaining(law) == pytest.approx(share, rel=0.2)  # what it leaves is not noise
    monkeypatch.setattr(MovedRecords, "independent", lambda *_: 1.0)
    assert search.remaining(law) == share


def test_a_motion_that_reaches_no_contact_parts_it_by_no_more_than_all_of_a_force(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, TEXT)
    known = 2e-3 * A + 0.05 * V + 12.0 * X
    contact = 300.0 * np.sign(X) * np.maximum(np.abs(X) - 0.01, 0.0)
    bag = bag_of(
        tmp_path, RATE, {"displacement 1": X, "force 1": known + contact}, record(TIME.size, held="response"), TEXT
    )
    records = MovedRecords.of(rig, read_observations([bag], rig))
    assert records is not None
    search = RecordSearch(records)
    laws = [search.law([Block("law", (term,))]) for term in (Term("gap", 0.01), Term("power", 5.0))]
    text = parting_motion(records, laws[0], laws[1:])
    assert text.startswith("half of the displacement: there they differ by up to 100 %")


FOLLOWED = {
    "friction": ("current", "A", 0.8 + 0.6 * np.sin(0.8 * TIME), np.tanh(V / 2e-3), (0.05, 0.12)),
    "falling friction": ("current", "A", 0.8 + 0.6 * np.sin(0.8 * TIME), np.tanh(V / 2e-3), (0.2, -0.1)),
    "damping": ("voltage", "V", np.where(TIME < 9.0, 1.0, 4.0), V * np.abs(V), (2.0, 3.0)),
    "slider": ("current", "A", 1.0 + 0.5 * np.sin(0.5 * TIME), None, (20.0, 40.0)),
    "friction under a load": ("magnitude of current", "A", 3.0 * np.sin(0.8 * TIME), np.tanh(V / 2e-3), (0.05, 0.03)),
    "friction of a ring": ("magnitude of displacement", "m", X, np.tanh(V / 2e-3), (0.03, 8.0)),
}


@pytest.mark.parametrize("case", with_quick(FOLLOWED, "friction"))
def test_a_strength_that_follows_a_channel_is_told_with_it(tmp_path: Path, case: str) -> None:
    """f = (a + b s(t)) g(x, v), with the channel s measured."""
    channel, unit, values, shape, (constant, slope) = FOLLOWED[case]
    shape = jenkins(X, 1.0, 1e-3) if shape is None else shape
    followed = np.abs(values) if channel.startswith("magnitude") else values
    force = 2e-3 * A + 0.05 * V + 12.0 * X + (constant + slope * followed) * shape
    force += 1e-3 * np.random.default_rng(4).standard_normal(TIME.size)
    rig = rig_of(tmp_path, TEXT)
    columns = {"displacement 1": X, "force 1": force}
    columns.setdefault(f"{channel.split()[-1]} 1", values)
    bag = bag_of(tmp_path, RATE, columns, record(TIME.size, held="response"), TEXT)
    reading = law_of(rig, read_observations([bag], rig))
    assert reading is not None
    assert reading.is_stated
    assert reading.closed_by_file > 0.9
    (law,) = reading.laws
    assert law.family.endswith(f"that follows the {channel}")
    base, following = law.terms
    assert (base.by, following.by) == ("", channel)
    assert (following.unit) == f"{base.unit}/{unit}"
    assert base.coefficient == pytest.approx(constant, rel=0.05)
    assert following.coefficient == pytest.approx(slope, rel=0.05)
    assert abs(following.coefficient - slope) < 4.0 * following.std
    sentences = " ".join(law_sentences(reading, True))
    assert f"{'grows' if slope > 0.0 else 'falls'} with the {channel}: " in sentences
    assert f"Its elements follow the {channel} of a record" in sentences
    ((_, low, high),) = law.valid_between
    (middle,) = law.at_middle
    assert middle.coefficient == pytest.approx(constant + slope * 0.5 * (low + high), rel=0.05)


MEANS: dict[str, tuple[float, Callable[[FloatArray], FloatArray]]] = {
    "linear spring": (3.0, lambda values: 0.05 * V + (12.0 + 3.0 * values) * X),
    # The model has what the damper has at one end of the channel's range: on the whole it has too much.
    "viscous damping": (-0.03, lambda values: (0.032 - 0.03 * values) * V + 12.0 * X),
}


@pytest.mark.parametrize("family", MEANS)
def test_a_strength_that_follows_a_channel_is_told_where_its_mean_is_an_error_of_the_model(
    tmp_path: Path, family: str
) -> None:
    """Alone the spring takes less of the force than what the model's own stiffness is uncertain by."""
    values = 0.6 * np.sin(0.8 * TIME)
    slope, made = MEANS[family]
    force = 2e-3 * A + made(values)
    force += 2e-4 * np.random.default_rng(4).standard_normal(TIME.size)
    rig = rig_of(tmp_path, TEXT)
    columns = {"displacement 1": X, "force 1": force, "current 1": values}
    bag = bag_of(tmp_path, RATE, columns, record(TIME.size, held="response"), TEXT)
    reading = law_of(rig, read_observations([bag], rig))
    assert reading is not None
    assert reading.is_stated
    (law,) = reading.laws
    assert law.family == f"{family} that follows the current"
    assert law.terms[-1].coefficient == pytest.approx(slope, rel=0.03)


def test_an_exponent_is_fitted_and_a_whole_one_stays(tmp_path: Path) -> None:
    for exponent, strength in ((1.7, 5.0), (2.0, 8.0)):
        (folder := tmp_path / f"{exponent}").mkdir()
        reading = reading_of(folder, strength * np.sign(V) * np.abs(V) ** exponent)
        assert reading.is_stated
        ((term,),) = (law.terms for law in reading.laws)
        assert term.kind == "speed"
        assert term.parameters[0] == pytest.approx(exponent, rel=0.0 if exponent == 2.0 else 0.01)
        assert term.coefficient == pytest.approx(strength, rel=0.03)


def test_no_damper_is_asked_with_an_exponent_below_one(tmp_path: Path) -> None:
    """An exponent that was fitted is also asked as the nearest half of a whole one."""
    rig = rig_of(tmp_path, TEXT)
    bag = bag_of(tmp_path, RATE, {"displacement 1": X, "force 1": V}, record(TIME.size, held="response"), TEXT)
    records = MovedRecords.of(rig, read_observations([bag], rig))
    assert records is not None
    along = Along(lambda terms: records.columns(terms).reshape(-1, len(terms)))
    for exponent in np.linspace(1.06, 1.6, 40):
        block = Block("drag", (Term("speed", float(exponent)),), (1,))
        fitted = BlockColumns.of("", "drag", along, block, (0.0, 0.4), asked=False)
        assert {other.block.terms[0].first for other in fitted.shorter(np.ones(1))} <= {1.5}


def test_a_channel_that_nothing_follows_is_not_told(tmp_path: Path) -> None:
    values = 0.8 + 0.6 * np.sin(0.8 * TIME)
    force = 2e-3 * A + 0.05 * V + 12.0 * X + 0.05 * np.tanh(V / 2e-3)
    force += 1e-3 * np.random.default_rng(4).standard_normal(TIME.size)
    rig = rig_of(tmp_path, TEXT)
    columns = {"displacement 1": X, "force 1": force, "current 1": values}
    bag = bag_of(tmp_path, RATE, columns, record(TIME.size, held="response"), TEXT)
    reading = law_of(rig, read_observations([bag], rig))
    assert reading is not None
    assert [law.family for law in reading.laws] == ["dry friction"]


CLOSED_FORMS: dict[str, Callable[[Any], FloatArray]] = {
    "cubic_spring": lambda it: it.stiffness_n_m3 * X**3,
    "tanh_friction": lambda it: it.slip_force_n * np.tanh(V / it.reference_velocity_m_s),
    "weakening_friction": lambda it: (
        it.slip_force_n * np.tanh(V / it.reference_velocity_m_s) * np.exp(-((V / it.decay_velocity_m_s) ** 2))
    ),
    "two_sided_gap": lambda it: it.stiffness_n_m * np.sign(X) * np.maximum(np.abs(X) - it.gap_m, 0.0),
    "unilateral_stop": lambda it: it.stiffness_n_m * np.maximum(X - it.gap_m, 0.0),
    "jenkins": lambda it: jenkins(X, it.tangential_stiffness_n_m, it.slip_force_n),
    "power_law_damper": lambda it: it.coefficient_n_sp_mp * np.sign(V) * np.abs(V) ** it.exponent,
}


@pytest.mark.parametrize(
    "words", with_quick(["hardening spring", "dry friction", "clearance", *BESIDE], list(BESIDE)[1])
)
def test_a_law_comes_back_from_the_file_that_has_it(tmp_path: Path, words: str) -> None:
    """Law, rig file, a record by closed forms of the elements in that file, and the law of that record."""
    (first_folder := tmp_path / "first").mkdir()
    (again_folder := tmp_path / "again").mkdir()
    reading = reading_of(first_folder, {**LAWS, **BESIDE}[words][0])
    file = tmp_path / "written.yaml"
    file.write_text(rig_text(with_law(rig_of(tmp_path, TEXT), reading)), encoding="utf-8")
    elements = load_rig(file, vibrating=False).local_elements
    force = np.sum([CLOSED_FORMS[element.kind](element) for element in elements], axis=0)
    (law,), (before,) = reading_of(again_folder, force).laws, reading.laws
    assert law.family == before.family
    for term, other in zip(law.terms, before.terms, strict=True):
        assert term.kind == other.kind
        assert term.coefficient == pytest.approx(other.coefficient, rel=0.03)
    assert all(element.valid_to_m == pytest.approx(law.valid_to_m, rel=0.01) for element in elements)


def test_a_law_whose_file_predicts_worse_is_not_written(tmp_path: Path) -> None:
    reading = reading_of(tmp_path, LAWS["hardening spring"][0])
    assert reading.closed_by_file > 0.9
    assert reading.is_written
    worse = replace(reading, closed_by_file=-0.1)
    assert worse.is_stated
    assert not worse.is_written
    assert "It is not written to the rig file" in " ".join(law_sentences(worse, False))


def test_a_law_is_checked_against_a_part_that_it_does_not_know(tmp_path: Path) -> None:
    """Strengths of the other parts, beside a preload; what is left is white, what was there is not."""
    force = 0.05 * np.tanh(V / 2e-3) + 0.1
    check = reading_of(tmp_path, force).check
    assert check is not None
    at = np.array(check.time_s)
    truth = np.interp(at, TIME, force - 0.1)
    assert np.std(np.interp(at, check.line_s, check.line) - truth) < 0.1 * np.std(truth)
    assert np.std(np.array(check.measured) - truth) < 0.1 * np.std(truth)
    assert np.std(np.interp(at, TIME, X)) > 1.3 * np.std(X)
    assert max(map(abs, check.with_law[1:])) < 3.0 * check.band < max(map(abs, check.without[1:]))


@pytest.mark.parametrize("left", ["white", "wave"])
def test_the_autocorrelation_of_a_remainder_is_that_of_its_process(tmp_path: Path, left: str) -> None:
    """1 and nothing of white noise; cos ωτ of a sine."""
    rig = rig_of(tmp_path, TEXT)
    columns = {"displacement 1": X, "force 1": 2e-3 * A + 0.05 * V + 12.0 * X}
    bag = bag_of(tmp_path, RATE, columns, record(TIME.size, held="response"), TEXT)
    records = MovedRecords.of(rig, read_observations([bag], rig))
    assert records is not None
    at = [records.records[k].parts[part] / records.records[k].test.sample_rate for k, part in records.part_of]
    random = np.random.default_rng(3)
    rows = [random.standard_normal(t.size) if left == "white" else np.sin(40.0 * t + 0.3) for t in at]
    padded = np.zeros_like(records.missing)
    for k, row in enumerate(rows):
        padded[k, : row.size] = row
    lags, found = autocorrelation(records, padded)
    assert lags.size > 10
    if left == "white":
        assert np.abs(found[1:]).max() < 5.0 / np.sqrt(sum(map(np.size, at)))
    else:
        np.testing.assert_allclose(found[1:], np.cos(40.0 * lags[1:]), atol=0.15)


def test_a_healthy_record_has_no_law(tmp_path: Path) -> None:
    reading = reading_of(tmp_path, 0.0 * X)
    assert not reading.laws
    assert "no more than noise and tolerances" in reading.refusals[0]


@pytest.mark.parametrize("error", [0.02 * 12.0 * X, 0.1 * 0.05 * V, 0.002 + 0.0 * X])
def test_what_chain_and_model_are_off_by_is_no_law(tmp_path: Path, error: FloatArray) -> None:
    """A spring 2 % stiffer, a damper 10 % stronger, a zero of the force."""
    assert not reading_of(tmp_path, error).is_stated


def test_what_no_law_explains_is_not_stated(tmp_path: Path) -> None:
    """A force that knows nothing of the motion."""
    assert not reading_of(tmp_path, 0.05 * np.sin(2.0 * np.pi * 11.3 * TIME)).is_stated


def test_bands_widen_where_neighbours_say_the_same(tmp_path: Path) -> None:
    """Noise of the same size that is slow tells less than white noise."""
    random = np.random.default_rng(2)
    slow = np.convolve(random.standard_normal(TIME.size + 99), np.ones(100) / 10.0, "valid")
    (folder_a := tmp_path / "a").mkdir()
    (folder_b := tmp_path / "b").mkdir()
    (white,) = reading_of(folder_a, 4e5 * X**3 + 5e-3 * random.standard_normal(TIME.size)).laws
    (coloured,) = reading_of(folder_b, 4e5 * X**3 + 5e-3 * slow).laws
    assert coloured.terms[0].std > 2.0 * white.terms[0].std


def test_what_no_effect_explains_is_told_as_the_law_of_a_record(tmp_path: Path) -> None:
    """Said of a record and not of levels, drawn as stretches, and written to the model."""
    random = np.random.default_rng(3)
    missing, _ = LAWS["clearance"]
    force = 2e-3 * A + 0.05 * V + 12.0 * X + missing + 1e-3 * random.standard_normal(TIME.size)
    rig = rig_of(tmp_path, TEXT)
    bag = bag_of(tmp_path, RATE, {"displacement 1": X, "force 1": force}, record(TIME.size, held="response"), TEXT)
    withheld = tuple(effect.name for effect in library() if effect.name != "air_drag")
    found = diagnose_bags(rig, [bag], settings=DiagnosisSettings(look_ahead=False, withheld=withheld))
    assert found.diagnosis.verdict is Verdict.UNKNOWN
    sentences = " ".join(found.diagnosis.sentences)
    assert "In the record the missing force acts like clearance at point 1" in sentences
    assert "levels left out" not in sentences
    law = found.diagnosis.law
    assert law is not None
    figure = law_figure(law.laws[0], 1)
    assert "along stretches of the record" in figure.caption
    assert "parts of" in law_table(law).note
    assert [element.kind for element in found.model.local_elements] == ["two_sided_gap"]


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "imposed motion"])
def test_other_kinds_of_test_have_none(kind: str) -> None:
    rig = rig_of_kinds()
    assert read_record_law(rig, KINDS[kind](rig)) is None


def test_a_parameter_of_the_model_is_off_by_its_own_prior(tmp_path: Path) -> None:
    """A spring's column is the force of a standard deviation of it along the motion."""
    rig = rig_of(tmp_path, TEXT)
    columns = {"displacement 1": X, "force 1": 2e-3 * A + 0.05 * V + 12.0 * X}
    bag = bag_of(tmp_path, RATE, columns, record(TIME.size, RATE, held="response"), TEXT)
    records = MovedRecords.of(rig, read_observations([bag], rig))
    assert records is not None
    (moved,) = records.records
    spring = next(p for p in calibration_parameters(rig) if "ground_springs" in p.name)
    at = np.concatenate(moved.parts)
    expected = spring.std * 12.0 * moved.x[0, at]
    np.testing.assert_allclose(np.concatenate(moved.errors[spring.name]), expected, rtol=1e-3, atol=1e-6)
