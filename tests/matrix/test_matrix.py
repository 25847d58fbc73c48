"""Every kind of test, with every exciter and drive, meets every consumer: right on its own model, or refused by name.

The lists are the registries themselves: a kind, an exciter or a consumer without a case fails. What a model records of
itself has no gap, offline is live, and an import of an export is the recording.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matrix.own_model import distance
from matrix.small_rigs import EXCITERS, rig_text

import nmt
from nmt_bench.consumers import CONSUMERS, covers_of
from nmt_bench.data_import import import_data
from nmt_bench.page.live_view import LiveView
from nmt_bench.page.message_records import WATCHED_TOPICS, RecordReader
from nmt_core.errors import BenchError
from nmt_core.kinds import KINDS
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.vocabulary import ControlKind, PointStatus, TestKind
from nmt_diagnose.observations.read_observations import read_observations
from nmt_extract.linear.evaluation import evaluate_linear_test
from nmt_extract.modal.table import write_results
from nmt_extract.offline import extract_bag
from nmt_extract.synthesis.single_mode import SynthesisedBackbone
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.export.exported_run import export_run
from nmt_record.windows.segments import read_signals, recorded_tests, segments
from nmt_report.figure_files import report_figures
from nmt_report.run_data_from_bag import report_data_from_bag
from nmt_report.run_report import write_report
from nmt_rig.linear_description import linear_description
from nmt_rig.reference import compute_reference
from nmt_rig.rig import Rig, load_rig
from nmt_session import RunResult, Session, TestPlan, plan_test

SETTINGS: dict[TestKind, dict[str, Any]] = {
    TestKind.PHASE_RESONANCE: {},
    TestKind.RANDOM: {"levels": [0.15, 0.3], "band_hz": (5.0, 60.0), "duration": 30.0},
    TestKind.SWEEP: {"levels": [0.5], "frequencies_hz": (18.0,), "frequency_end_hz": 23.0, "rate_hz_s": 1.0},
    TestKind.STEPPED_SINE: {"levels": [0.5], "frequencies_hz": (19.0, 20.0, 21.0), "control": "force"},
    TestKind.RING_DOWN: {"duration": 2.0},
    TestKind.SELF_EXCITED: {},
    TestKind.RESPONSE_CURVE: {"levels": [0.5], "lag_deg": (50.0, 130.0), "spacing": 0.4},
    TestKind.SECONDARY_RESONANCE: {"levels": [40.0], "resonance": "3:1", "control": "force"},
}
RELEASED: dict[str, Any] = {"levels": [9.6], "resonance": "1:3", "control": "force", "release": 0.75e-3}
"""A 1:3 resonance: 0.6 of the unit of force of `strong_cubic`, let go at three quarters of its unit of length."""
RELEASED_BY = ("force", "shaking_table")
"""Exciters that release it: a shaker does not come to phase resonance at that amplitude."""
FIRST_TIER = "electrodynamic_shaker"
CAMPAIGN_KINDS = (TestKind.SELF_EXCITED, TestKind.RESPONSE_CURVE, TestKind.SECONDARY_RESONANCE)
"""The row of an exciter protects a change; those of the other exciters and of these kinds are campaigns."""


@dataclass(frozen=True)
class Recording:
    """A test that a model did of itself."""

    folder: Path
    rig: Rig
    plan: TestPlan
    result: RunResult

    @property
    def bag(self) -> Path:
        assert self.result.bag is not None
        return self.result.bag

    @property
    def kind(self) -> type:
        return type(self.plan.kind)

    @property
    def report(self) -> Path:
        """The page, made once."""
        path = self.folder / "report.html"
        if not path.exists():
            write_report(report_data_from_bag(self.bag, list(self.result.points)), path)
        return path


def rows() -> Iterator[Any]:
    """Kind, exciters, and what is asked for."""
    for kind in KINDS:
        if kind is TestKind.RECORD:  # no test of the bench
            continue
        for exciters in EXCITERS:
            controls = (False, True) if "harmonics_control" in KINDS[kind].FROM_RIG else (False,)
            for controlled in controls:
                # With controlled harmonics all is asked that is asked without.
                plain = len(controls) > 1 and not controlled
                quick = exciters == FIRST_TIER and kind not in CAMPAIGN_KINDS and not plain
                marks = () if quick else (pytest.mark.campaign,)
                name = f"{kind.label}, {exciters}{', controlled harmonics' if controlled else ''}"
                settings = {**SETTINGS[kind], **({"harmonics_control": 5} if controlled else {})}
                yield pytest.param(kind, exciters, settings, id=name, marks=marks)
    for exciters in RELEASED_BY:
        name = f"1:3, {exciters}"
        yield pytest.param(TestKind.SECONDARY_RESONANCE, exciters, RELEASED, id=name, marks=pytest.mark.campaign)


def driven(kind: TestKind, exciters: str, settings: dict[str, Any]) -> DrivenTest:
    return DrivenTest(
        kind=kind,
        exciters=tuple(section["kind"] for section in EXCITERS[exciters]),
        control=ControlKind.named(settings.get("control", KINDS[kind].CONTROL.label)),
        controlled_harmonics=settings.get("harmonics_control", 0),
        resonance=settings.get("resonance", ""),
    )


def record(folder: Path, kind: TestKind, exciters: str, settings: dict[str, Any]) -> Recording:
    file = folder / "small.yaml"
    file.write_text(rig_text(exciters, kind, settings.get("resonance", "")), encoding="utf-8")
    asked = {key: value for key, value in settings.items() if key != "levels"}
    plan = plan_test(file, settings.get("levels"), test=kind.label, **asked)
    out = folder / "run"
    with Session(plan, out) as session:
        result = session.run()
    if result.points:
        write_results(result.points, out)
    return Recording(out, load_rig(file), plan, result)


# -- what each consumer does with a recording --------------------------------------------------------------------------


def extracts(recording: Recording, _: Path) -> None:
    again = extract_bag(recording.bag)
    live = recording.result.points
    assert len(again.points) == len(live) > 0
    assert all(one.identical(other) for one, other in zip(again.points, live, strict=True))


def judges(recording: Recording, _: Path) -> None:
    assert all(point.status is PointStatus.OK for point in recording.result.points), recording.result.points
    assert not any(segment.fault for segment in segments(Bag.open(recording.bag)))


def diagnoses(recording: Recording, _: Path) -> None:
    observations = read_observations([recording.bag], recording.rig)
    assert len(observations.values) > 2
    assert distance(observations, recording.rig) < 1.5


def compares_with_the_reference(recording: Recording, _: Path) -> None:
    points = recording.result.points
    found = compute_reference(recording.rig, modal_amplitudes=sorted(point.modal_amplitude for point in points) or None)
    hertz = found.omega_rad_s / (2.0 * np.pi)
    if not points:  # a ring-down: the frequency at which it was let go
        locked = [segment.frequency_hz for segment in segments(Bag.open(recording.bag))]
        assert all(0.995 * hertz.min() < frequency < 1.005 * hertz.max() for frequency in locked)
        return
    by_amplitude = sorted(points, key=lambda point: point.modal_amplitude)
    assert [point.frequency_hz for point in by_amplitude] == pytest.approx(hertz.tolist(), rel=2e-3)
    away = np.array([point.damping_ratio for point in by_amplitude]) - found.damping_ratio
    assert np.abs(away).max() < 3e-4  # what one exciter and a sine of voltage leave


def fits_modes(recording: Recording, _: Path) -> None:
    found = evaluate_linear_test(Bag.open(recording.bag), modes=2)
    exact = linear_description(recording.rig)
    assert found.test.modes[0].frequency_hz < 25.0  # the target; a table does not drive the mode above it
    for mode, omega, ratio in zip(found.test.modes, exact.frequencies_rad_s, exact.damping_ratios, strict=False):
        assert mode.frequency_hz == pytest.approx(omega / (2.0 * np.pi), rel=2e-3)
        assert mode.damping_ratio == pytest.approx(ratio, rel=0.1)


def synthesises(recording: Recording, _: Path) -> None:
    points = recording.result.points
    if not points:
        return
    backbone = SynthesisedBackbone.from_points(points)
    omega, damping, _ = backbone.at(backbone.modal_amplitude)
    assert omega / (2.0 * np.pi) == pytest.approx(sorted(point.frequency_hz for point in points), rel=1e-3)
    assert np.all(damping > 0.0)


def exports_and_imports(recording: Recording, folder: Path) -> None:
    out = folder / "exported"
    out.mkdir()
    export_run(recording.folder, out, "npz")
    import_data(out / "sidecar.yaml", folder / "imported")
    before, after = Bag.open(recording.bag), Bag.open(folder / "imported")
    pairs = list(zip(segments(before), segments(after), strict=True))
    assert pairs
    for one, other in pairs:
        assert (one.kind, one.samples) == (other.kind, other.samples)
        first, second = (read_signals(bag, s.first_sample, s.samples) for bag, s in ((before, one), (after, other)))
        for name, values in first.channels.items():
            assert np.array_equal(values, second.channels[name]), name
    if recording.result.points:
        again = extract_bag(folder / "imported").points
        assert [p.damping_ratio for p in again] == [p.damping_ratio for p in recording.result.points]


def opens(recording: Recording, _: Path) -> None:
    assert nmt.open(recording.folder).to_dataframe().shape[0] == len(recording.result.points)


def reports(recording: Recording, _: Path) -> None:
    path = recording.report
    assert "nan" not in path.read_text(encoding="utf-8").partition("<body")[2].lower().replace("nanometre", "")[:2000]


def draws(recording: Recording, _: Path) -> None:
    assert report_figures(recording.report)


def shows(recording: Recording, _: Path) -> None:
    bag = Bag.open(recording.bag)
    view, reader = LiveView(), RecordReader()
    view.begin(bag.run_start or {}, {})
    for topic, _, _, raw in bag.raw_messages(WATCHED_TOPICS):
        taken = reader.read(topic, raw)
        if taken is not None:
            view.take(taken)
    assert view.facts()


TRIALS: dict[str, Callable[[Recording, Path], None]] = {
    "judgement": judges,
    "extract": extracts,
    "linear": fits_modes,
    "export and import": exports_and_imports,
    "nmt.open": opens,
    "reference": compares_with_the_reference,
    "diagnosis": diagnoses,
    "synthesis": synthesises,
    "report": reports,
    "figures": draws,
    "page": shows,
}


def test_every_consumer_has_a_trial_and_every_kind_its_settings() -> None:
    assert {"run", *TRIALS} == set(CONSUMERS)
    assert set(SETTINGS) == set(KINDS) - {TestKind.RECORD}


@pytest.mark.parametrize(("kind", "exciters", "settings"), rows())
def test_a_recording_of_itself_is_right_or_refused_by_every_consumer(
    kind: TestKind, exciters: str, settings: dict[str, Any], tmp_path: Path
) -> None:
    test = driven(kind, exciters, settings)
    if covers_of("run")(test):  # before a node starts
        with pytest.raises(BenchError, match=re.escape(covers_of("run")(test))):
            record(tmp_path, kind, exciters, settings)
        assert not (tmp_path / "run" / "bag").exists()
        return
    recording = record(tmp_path, kind, exciters, settings)
    steps = max(len(recording.plan.asked.levels), len(recording.result.points))  # points are put along a response curve
    assert recording.result.message.startswith(f"{steps} of {steps} levels")
    assert recording.plan.driven == test
    assert recorded_tests(Bag.open(recording.bag)) == (test,)
    wrong = []
    for consumer, trial in TRIALS.items():
        sentence = covers_of(consumer)(test)
        folder = tmp_path / consumer
        folder.mkdir()
        if sentence:
            assert sentence.endswith("."), sentence
            assert sentence[0].isupper(), sentence
            continue
        try:
            trial(recording, folder)
        except (AssertionError, BenchError) as error:
            wrong.append(f"{consumer}: {str(error)[:300]}")
    assert not wrong, "\n".join(wrong)
