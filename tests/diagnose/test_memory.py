"""A diagnosis that remembers the one before says what one that begins anew says, from fewer fits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnose.observation_bags import record, rig_with_noise
from diagnose.predicted_observations import chain, observations_of_model, real

from nmt_diagnose.diagnose import DiagnosisOutcome, diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.effects.location import Cause, Location
from nmt_diagnose.ledger import held_out as held_out_module
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations import read_observations as reader
from nmt_diagnose.search import memory as memory_module
from nmt_diagnose.search import search as search_module
from nmt_diagnose.search.memory import Memory, Remembered

MODEL = chain()
TRUTH = real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}])
KNOWN = ("cubic_stiffness", "quintic_stiffness", "phase_offset", "viscous_damping")
SETTINGS = DiagnosisSettings(
    withheld=tuple(effect.name for effect in library() if effect.name not in KNOWN), look_ahead=False
)
LOW, ALL = (0.1, 0.4, 1.6), (0.1, 0.4, 1.6, 2.0)


def observed(drives: tuple[float, ...]) -> Observations:
    return observations_of_model(TRUTH, seed=6, drives=drives)


class Counted:
    """Diagnoses, how many candidates each fitted on top of the model alone, and fits to splits of the data."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.fits = 0
        self.held_out: list[tuple[int, str]] = []
        added = search_module.Search.with_added

        def counted(*arguments: Any, **more: Any) -> Any:
            self.fits += 1
            return added(*arguments, **more)

        patch.setattr(search_module.Search, "with_added", counted)
        left = held_out_module.refit

        def noted(fitted: Any, all_data: Any, found: Any, split: Any) -> Any:
            self.held_out.append((id(found), split.name))
            return left(fitted, all_data, found, split)

        patch.setattr(held_out_module, "refit", noted)

    def diagnosed(self, observations: Observations, memory: Memory | None) -> tuple[DiagnosisOutcome, int]:
        self.fits, self.held_out = 0, []
        return diagnose_observations(MODEL, observations, SETTINGS, memory=memory), self.fits


@pytest.fixture(scope="module")
def counted() -> Iterator[Counted]:
    with pytest.MonkeyPatch.context() as patch:
        yield Counted(patch)


def test_the_answer_is_that_of_a_new_diagnosis_and_takes_fewer_fits(counted: Counted) -> None:
    memory = Memory()
    counted.diagnosed(observed(LOW), memory)
    assert memory.near
    warm, fewer = counted.diagnosed(observed(ALL), memory)
    cold, more = counted.diagnosed(observed(ALL), None)
    assert fewer < 0.5 * more
    assert len({found for found, _ in counted.held_out}) > 1
    assert len(set(counted.held_out)) == len(counted.held_out)  # the model alone beside each explanation
    one, other = warm.diagnosis, cold.diagnosis
    assert (one.verdict, one.ranking[0].effect, one.ranking[0].detail) == (
        other.verdict, other.ranking[0].effect, other.ranking[0].detail,
    )  # fmt: skip
    assert one.ranking[0].probability == pytest.approx(other.ranking[0].probability, abs=1e-3)
    value, known = one.ranking[0].parameters["k"], other.ranking[0].parameters["k"]
    assert value.value == pytest.approx(known.value, abs=0.2 * known.std)
    assert value.std == pytest.approx(known.std, rel=0.02)


def test_what_is_remembered_wrongly_is_looked_for_anew(counted: Counted, monkeypatch: pytest.MonkeyPatch) -> None:
    """A memory of another rig leaves more than noise: nothing of it is taken."""
    cause = Cause("quintic_stiffness", Location.at("structure", 1))
    memory = Memory(near=(Remembered((cause,), ({"k": 2e14},), {}),))
    begun: list[bool] = []
    original = memory_module.fitted_again

    def noted(*arguments: Any, **more: Any) -> Any:
        begun.append(True)
        return original(*arguments, **more)

    monkeypatch.setattr(memory_module, "fitted_again", noted)
    found, _ = counted.diagnosed(observed(LOW), memory)
    assert begun
    assert (found.diagnosis.ranking[0].effect, found.diagnosis.ranking[0].detail) == ("cubic_stiffness", "2")


def test_a_recording_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By name and content: what lies elsewhere under another name is read."""
    rig = rig_with_noise()
    bag = record(tmp_path / "one", rig, levels=(0.1,), periods=20)
    read: list[str] = []
    original = reader.read_bag

    def noted(bag: Any, name: str, *more: Any) -> Observations:
        read.append(name)
        return original(bag, name, *more)

    monkeypatch.setattr(reader, "read_bag", noted)
    readings: dict[tuple[str, str], Observations] = {}
    first = reader.read_observations([bag], rig, readings=readings)
    again = reader.read_observations([bag], rig, readings=readings)
    assert len(read) == 1
    assert (again.values == first.values).all()
    reader.read_observations([bag], rig)
    assert len(read) == 2
