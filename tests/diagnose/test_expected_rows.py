"""The rows that are expected of a test are those of a session of the same request, or a sentence says which are not."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matrix.small_rigs import rig_text
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.kinds import (
    KINDS,
    PhaseResonanceTest,
    RandomTest,
    RecordedTest,
    ResponseCurveTest,
    RingDownTest,
    SecondaryResonanceTest,
    SelfExcitedTest,
    SteppedSineTest,
    SweepTest,
)
from nmt_core.kinds.request import TestRequest
from nmt_core.vocabulary import ControlKind, TestKind
from nmt_diagnose.ahead.expected_rows import NOT_FORETOLD, expected, reason_against
from nmt_diagnose.measurements.measurement import Observations, empty
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import Rig, load_rig
from nmt_sequencer.level_plan import directed
from nmt_session import Session
from nmt_session.plan_of_test import TestPlan
from nmt_session.planning import plan_test

OF_THE_RECORDING = (Part.LINE, Part.STEP, Part.LIMIT, Part.REPEATS)
REQUESTS = {
    "levels": TestRequest(levels=(0.5, 1.0)),
    "levels both ways": TestRequest(levels=(0.5, 1.0), direction="both"),
    "levels of force": TestRequest(levels=(0.5, 1.0), control=ControlKind.FORCE),
    "levels at another point": TestRequest(levels=(0.5,), exciters=(2,)),
    "levels of the second mode": TestRequest(levels=(0.5,), changes=(("test.mode", 2),)),
    "stepped sines": TestRequest(
        kind=SteppedSineTest(), levels=(0.5,) * 4, frequencies_hz=(18.0, 19.9, 20.1, 22.0), control=ControlKind.FORCE
    ),
    "random": TestRequest(
        kind=RandomTest(band_low_hz=5.0, band_high_hz=60.0, duration=30.0), levels=(0.15,)
    ),
    "decays": TestRequest(kind=RingDownTest(duration=2.0), levels=(0.5, 1.0)),
    "response curve": TestRequest(
        kind=ResponseCurveTest(lag_from=np.radians(50.0), lag_to=np.radians(130.0), spacing=0.2), levels=(0.5,)
    ),
}  # fmt: skip
REFUSED = [SweepTest(), SecondaryResonanceTest(), SelfExcitedTest(), RecordedTest()]


def prepared(folder: Path, request: TestRequest) -> tuple[TestRequest, Rig]:
    file = folder / "small.yaml"
    text = rig_text("electrodynamic_shaker", request.kind.NUMBER)
    # A force is measured where the exciter is.
    file.write_text(text.replace("quantity: force\n  point: 1", "quantity: force\n  point: drive"), encoding="utf-8")
    return replace(request, rig=str(file)), load_rig(file)


def planned(request: TestRequest) -> TestPlan:
    return plan_test(
        request.rig,
        request.levels if request.direction == "given" else directed(request.levels, request.direction),
        overrides=[f"{key}={value}" for key, value in request.changes],
        exciter=request.exciters[0] if request.exciters else None,
        test=request.kind,
        control=request.control.label,
        frequencies_hz=request.frequencies_hz,
    )


def recorded(folder: Path, request: TestRequest, rig: Rig) -> Observations:
    """What a session of the request shows; without what may be wrong with a recording."""
    with Session(planned(request), folder / "run", extract=False) as session:
        session.run()
    found = read_observations([folder / "run"], rig)
    return found.take(~np.isin(found.rows.part, OF_THE_RECORDING))


def identity(found: Observations, *columns: str) -> list[tuple[object, ...]]:
    """Test, channel by its name, and further columns of each row."""
    names = [[channel.name for channel in test.channels] for test in found.tests]
    rows = found.rows
    channels = [names[t][c] if c >= 0 else "" for t, c in zip(rows.test, rows.channel, strict=True)]
    return list(zip(rows.test.tolist(), channels, *(getattr(rows, name).tolist() for name in columns), strict=True))


@pytest.mark.parametrize("name", with_quick(REQUESTS, "levels", "stepped sines", "decays"))
def test_what_is_expected_is_what_a_session_shows(name: str, tmp_path: Path) -> None:
    request, rig = prepared(tmp_path, REQUESTS[name])
    shown = recorded(tmp_path, request, rig)
    foretold = expected(request, rig, shown)
    assert [type(test) for test in foretold.tests] == [type(test) for test in shown.tests]
    columns = ("harmonic", "part")
    if reason_against(request.kind.NUMBER):
        assert set(identity(foretold, *columns)) == set(identity(shown, *columns))
        first, second = (Counter(identity(it, "part")) for it in (foretold, shown))
        assert all(0.4 < second[key] / count < 2.5 for key, count in first.items()), (first, second)
    else:
        assert identity(foretold, "level", *columns) == identity(shown, "level", *columns)
        assert foretold.rows.amplitude == pytest.approx(shown.rows.amplitude, rel=0.05)
        assert foretold.rows.frequency_hz == pytest.approx(shown.rows.frequency_hz, rel=0.2)
    # The model has a solution for each of them.
    assert np.all(np.isfinite(Forward(foretold.tests, foretold.rows).predict(rig).values))
    assert np.all(foretold.sigma > 0.0)


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_not_foretold_is_said(kind: SweepTest, tmp_path: Path) -> None:
    request, rig = prepared(tmp_path, TestRequest(levels=(0.5,)))
    at_hand = expected(request, rig, empty())
    with pytest.raises(BenchError) as refusal:
        expected(replace(request, kind=kind), rig, at_hand)
    assert str(refusal.value) == reason_against(kind.NUMBER)
    assert str(refusal.value).endswith(".")


def test_every_kind_is_foretold_or_a_sentence_says_why_not() -> None:
    asked = {type(request.kind) for request in REQUESTS.values()} | {type(kind) for kind in REFUSED}
    assert asked == set(KINDS.values())
    whole = {kind for kind in KINDS if not reason_against(kind)}
    assert whole == {TestKind.PHASE_RESONANCE, TestKind.STEPPED_SINE}
    assert {PhaseResonanceTest.NUMBER, SteppedSineTest.NUMBER} == whole
    assert all(reason.endswith(".") for reason in NOT_FORETOLD.values())
