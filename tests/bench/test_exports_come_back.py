"""Import of an export is the recording, for every kind of test, one exciter and two, in every form of samples."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiers import with_quick

from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_core.kinds import KINDS
from nmt_core.messages.wire import LEVEL
from nmt_core.vocabulary import TestKind
from nmt_extract.decays.free_decay import free_decays, holds_decays_only
from nmt_extract.linear.evaluation import evaluate_linear_test
from nmt_extract.modal.table import write_csv
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.export.exported_run import export_run
from nmt_record.windows.segments import read_signals, recorded_tests, segments
from nmt_session import Session, plan_test

RESONANCE: dict[str, Any] = {"test": "secondary_resonance", "control": "force", "window_periods": 10}
RANDOM: dict[str, Any] = {"test": "random", "duration": 5.5, "band_hz": (20.0, 600.0)}
TESTS: dict[str, tuple[str, list[float], dict[str, Any]]] = {
    "phase resonance": ("joint_resonator", [0.5, 2.0], {"window_periods": 10}),
    "two exciters": ("frame", [1.0, 4.0], {"window_periods": 10}),
    "controlled harmonics": ("joint_resonator", [1.0], {"window_periods": 10, "harmonics_control": 3}),
    "self-excited": ("belt", [0.001, 0.002], {"test": "self_excited", "window_periods": 10}),
    "3:1": ("strong_cubic", [8.0], {**RESONANCE, "resonance": "3:1"}),
    "1:3": ("strong_cubic", [9.6], {**RESONANCE, "resonance": "1:3", "release": 0.00075}),
    "response curve": (
        "strong_cubic",
        [0.16],
        {"test": "response_curve", "control": "force", "lag_deg": (70.0, 110.0), "spacing": 0.4, "window_periods": 10},
    ),
    "random": ("joint_resonator", [0.25], {**RANDOM, "band_hz": (10.0, 2000.0)}),
    "random, two exciters": ("frame", [0.25], RANDOM),
    "ring-down": ("beam", [0.1, 2.0], {"test": "ring_down", "duration": 0.6}),
    "sweep": ("beam", [0.5], {"test": "sweep", "frequencies_hz": (18.0,), "frequency_end_hz": 19.0, "rate_hz_s": 1.0}),
    "stepped sine": ("beam", [0.5], {"test": "stepped_sine", "frequencies_hz": (21.0, 22.0), "window_periods": 10}),
}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    root, done = tmp_path_factory.mktemp("recordings"), {}

    def recording(name: str) -> Path:
        if name not in done:
            rig, levels, settings = TESTS[name]
            with Session(plan_test(rig, levels, **settings), root / str(len(done)), record=True) as session:
                session.run()
            done[name] = root / str(len(done))
        return done[name]

    return recording


def results(bag: Path, folder: Path) -> Any:
    """What the evaluation of its kind says: modal.csv, linear.json, decays, or the levels and windows themselves."""
    opened = Bag.open(bag)
    kinds = {KINDS[segment.kind] for segment in segments(opened)}
    if all(kind.gives_modal_points for kind in kinds):
        points = extract_bag(bag).points
        assert points
        write_csv(points, folder / "modal.csv")
        return (folder / "modal.csv").read_bytes()
    if all(kind.is_broad_band for kind in kinds):
        return evaluate_linear_test(opened).to_mapping()
    if holds_decays_only(opened):
        decays = free_decays(opened)
        assert any(decay.frequency_hz.size for decay in decays)
        return [(d.channel, d.frequency_hz.tolist(), d.damping_ratio.tolist(), d.reason) for d in decays]
    return list(map(repr, opened.lock_events()))


def test_every_kind_of_test_is_tried() -> None:
    tried = {settings.get("test", "phase_resonance") for _, _, settings in TESTS.values()}
    assert tried == {kind.label for kind in KINDS if kind is not TestKind.RECORD}


@pytest.mark.parametrize(
    ("name", "form"),
    with_quick(
        [(name, form) for name in TESTS for form in ("npz", "csv", "uff")],
        ("phase resonance", "npz"),
        ("random, two exciters", "uff"),
        ("ring-down", "npz"),
        ("sweep", "csv"),
        ("stepped sine", "uff"),
    ),
)
def test_an_import_of_an_export_is_the_recording(
    name: str, form: str, recordings: Callable[[str], Path], tmp_path: Path
) -> None:
    bag, exported, imported = recordings(name), tmp_path / "exported", tmp_path / "imported"
    exported.mkdir()
    export_run(bag, exported, form)
    import_data(exported / "sidecar.yaml", imported)
    before, after = Bag.open(bag), Bag.open(imported)
    assert recorded_tests(after) == recorded_tests(before)
    assert list(map(repr, after.lock_events())) == list(map(repr, before.lock_events()))  # NaN is NaN
    assert list(map(repr, after.records("level", LEVEL))) == list(map(repr, before.records("level", LEVEL)))
    for segment in segments(before):
        one, other = (read_signals(item, segment.first_sample, segment.samples) for item in (before, after))
        assert list(one.channels) == list(other.channels)
        for channel, values in one.channels.items():
            assert np.array_equal(values, other.channels[channel])
    if form == "npz":  # the samples are the same, so are the results
        assert results(imported, tmp_path) == results(bag, tmp_path)


def test_windows_of_a_secondary_resonance_need_their_lock_events(
    recordings: Callable[[str], Path], tmp_path: Path
) -> None:
    export_run(recordings("3:1"), tmp_path, "npz")
    sidecar = tmp_path / "sidecar.yaml"
    sidecar.write_text(sidecar.read_text().replace("locks: locks.csv\n", ""))
    with pytest.raises(BenchError, match="needs the lock events"):
        import_data(sidecar, tmp_path / "imported")
