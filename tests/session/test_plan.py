"""A test plan: its settings are told once, and numbers of numpy are numbers."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from nmt_core.errors import BenchError
from nmt_core.kinds import RandomTest
from nmt_core.messages.run_settings import RunSettings
from nmt_core.settings import parameters_of, values_of
from nmt_pll.pll_settings import PllSettings
from nmt_rig.rig import load_rig
from nmt_session import TestPlan, plan_nodes, plan_test
from nmt_session.plan_of_test import PlanSettings


def test_the_settings_are_the_fields_of_the_run_and_of_the_plan() -> None:
    made = {"rig", "rig_yaml", "asked", "levels", "tick_blocks", "block_reason", "kind"}
    known = {item.name for record in (RunSettings, TestPlan) for item in fields(record)}
    assert set(PlanSettings.__annotations__) == known - made


def test_numbers_of_numpy_give_the_same_files_as_those_of_python(tmp_path: Path) -> None:
    def files(test: TestPlan) -> tuple[object, object]:
        plan = plan_nodes(test, Path("bag"), Path("rig.yaml"))
        plan.write_parameters(tmp_path / "nodes.yaml")
        values = yaml.safe_load((tmp_path / "nodes.yaml").read_text(encoding="utf-8"))
        del values["/**/recorder"]["ros__parameters"]["run_json"]  # it has the time
        return values, plan.goal

    own = plan_test(
        "beam", [0.2, 0.5], run_id="one", seed=3, exciter=2, window_periods=40, ramp=0.5, latency_blocks=1,
        node_values={"pll": {"settling_time": 0.4}, "extract": {"harmonics": 5}},
    )  # fmt: skip
    numpy = plan_test(
        "beam", np.array([0.2, 0.5]), run_id="one", seed=np.int64(3), exciter=np.int64(2), window_periods=np.int64(40),
        ramp=np.float64(0.5), latency_blocks=np.int32(1),
        node_values={"pll": {"settling_time": np.float64(0.4)}, "extract": {"harmonics": np.int64(5)}},
    )  # fmt: skip
    assert files(numpy) == files(own)
    assert [type(level) for level in numpy.asked.levels] == [float, float]


def test_frequencies_and_band_may_be_arrays() -> None:
    stepped = plan_test("beam", [np.float64(0.2)], test="stepped_sine", frequencies_hz=np.linspace(20.0, 21.0, 3))
    assert (stepped.asked.levels, stepped.asked.frequencies_hz) == ((0.2,) * 3, (20.0, 20.5, 21.0))
    noise = plan_test("beam", np.array([0.05]), test="random", band_hz=np.array([10, 2000]), duration=np.float64(2.0))
    assert noise.asked.kind == RandomTest(band_low_hz=10.0, band_high_hz=2000.0, duration=2.0)
    assert type(noise.asked.kind.duration) is float


def test_a_wrong_setting_is_named() -> None:
    with pytest.raises(BenchError, match="A phase resonance test has no colour"):
        plan_test("beam", [0.2], colour=1)
    with pytest.raises(BenchError, match="Pacing 'slow' is not known; use lockstep or realtime"):
        plan_test("beam", [0.2], pacing="slow")


@pytest.mark.parametrize("name", [parameter.name for parameter in parameters_of(PllSettings)])
def test_a_rig_file_takes_every_setting_of_the_page_or_says_why_not(name: str) -> None:
    """The page of the node's parameters is what the reference of the rig file's section pll points to."""
    value = 3.5 if name == "settling_time" else values_of(PllSettings())[name]
    rig = load_rig("beam").model_copy(update={"pll": {name: value}})
    plan = replace(plan_test("beam", [0.1]), rig=rig)
    own = name in {item.name for item in fields(PllSettings)}
    if own and name not in ("loop", "settling_time"):
        with pytest.raises(BenchError, match=f"pll.{name} follows from the rig and its test; leave it out"):
            plan_nodes(plan, Path("bag"), Path("rig.yaml"))
    else:
        assert values_of(plan_nodes(plan, Path("bag"), Path("rig.yaml")).pll)[name] == value
