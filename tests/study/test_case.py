from __future__ import annotations

import json
from dataclasses import replace

import pytest

from nmt_core.errors import BenchError
from nmt_study.case import JOINT_KEY, StudyCase
from nmt_study.case_store import CaseStore

CASE = StudyCase("point_2", "point 2", 2, (0.1, 0.3), loop_values={"cutoff": 20.0}, labels={"exciter": 2})


def test_a_case_survives_json():
    again = StudyCase.from_mapping(json.loads(json.dumps(CASE.to_mapping())))
    assert again == CASE
    assert again.fingerprint == CASE.fingerprint


def test_everything_but_title_and_labels_decides_the_fingerprint():
    assert replace(CASE, title="other", labels={}).fingerprint == CASE.fingerprint
    for change in ({"levels": (0.1, 0.4)}, {"exciter": 4}, {"seed": 2}, {"loop": "paper"}, {"ramp": 0.1}):
        assert replace(CASE, **change).fingerprint != CASE.fingerprint


def test_what_is_no_case_is_refused():
    with pytest.raises(BenchError, match="letters, digits"):
        replace(CASE, name="a/b")
    with pytest.raises(BenchError, match="no 'colour'"):
        StudyCase.from_mapping({**CASE.to_mapping(), "colour": "red"})
    with pytest.raises(BenchError, match="not complete"):
        StudyCase.from_mapping({"name": "x"})


def test_joint_stiffness_is_the_overridden_one():
    assert CASE.joint_stiffness == 8000.0
    assert replace(CASE, overrides=(f"{JOINT_KEY}=5e4",)).joint_stiffness == 50_000.0


def test_a_finished_case_is_not_run_again_unless_it_has_changed(tmp_path):
    store = CaseStore(tmp_path / "out", "noise")
    other = replace(CASE, name="other")
    assert store.missing([CASE, other]) == [CASE, other]
    store.save(CASE, {"levels": [1.5]})
    again = CaseStore(tmp_path / "out", "noise")
    assert again.missing([CASE, other]) == [other]
    assert again.load(CASE)["levels"] == [1.5]
    assert again.load(replace(CASE, title="new name"))["case"]["title"] == "new name"
    assert again.load(replace(CASE, window_periods=7)) is None


def test_a_damaged_file_counts_as_not_finished(tmp_path):
    store = CaseStore(tmp_path, "noise")
    store.save(CASE, {})
    path = tmp_path / "cases" / "point_2.json"
    path.write_text(path.read_text()[:-20])
    assert store.load(CASE) is None


def test_a_folder_of_something_else_is_refused(tmp_path):
    CaseStore(tmp_path / "a", "noise").save(CASE, {})
    with pytest.raises(BenchError, match="holds the study noise"):
        CaseStore(tmp_path / "a", "levels")
    anew = CaseStore(tmp_path / "a", "levels", force=True)
    assert anew.load(CASE) is None
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "thesis.txt").write_text("precious")
    with pytest.raises(BenchError, match="something else"):
        CaseStore(tmp_path / "b", "noise")
    with pytest.raises(BenchError, match="is a file"):
        CaseStore(tmp_path / "b" / "thesis.txt", "noise")
