"""What the page shows of whole tests: fed by a run in one process, by strangers, and by a bag."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench.frame_reader import read_frame

from nmt_bench.page.bag_player import BagPlayer
from nmt_bench.page.live_view import LiveView
from nmt_bench.page.signal_views import deflection
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.records import DriveStop, LoopStatus, RunState
from nmt_core.vocabulary import OutputState, PointStatus, ResultCode, RunPhase, SteeringAct, StopCause
from nmt_extract.curves.response_curve import response_curves
from nmt_record.bag.bag_reader import Bag
from nmt_report.quantity_format import uncertain
from nmt_sequencer.steering import SteeringRequest
from nmt_session import Session, plan_test

BEAM: dict[str, Any] = {"levels": [0.2, 0.5, 0.9], "window_periods": 20, "run_id": "shown"}


def watched(tmp_path: Path, *requests: SteeringRequest, **arguments: Any) -> tuple[LiveView, Any]:
    """A view fed with a whole run, and the run's result."""
    view = LiveView()
    asked: list[str] = []

    def listen(topic: str, record: Any) -> None:
        view.take(record)
        if topic == "run_state" and record.phase == RunPhase.RUNNING and not asked:
            asked.extend(session.steer(request) for request in requests)
            asked.append("")

    with Session(plan_test("beam", **{**BEAM, **arguments}), tmp_path / "run", listener=listen) as session:
        view.begin(session.plan.run, {"limits": {"voltage_v": 10.0, "force_n": 20.0}})
        result = session.run()
    assert not any(asked)
    return view, result


def facts(view: LiveView) -> tuple[dict[str, Any], dict[str, Any]]:
    return read_frame(view.facts())


def live(view: LiveView) -> tuple[dict[str, Any], dict[str, Any]]:
    return read_frame(view.live(0))


def test_a_run_shows_its_points_as_the_report_writes_them(tmp_path: Path) -> None:
    view, result = watched(tmp_path)
    head, arrays = facts(view)
    assert (head["run"], head["rig"], head["test"], head["phase"]) == ("shown", "beam", "phase_resonance", "done")
    assert [row["state"] for row in head["plan"]] == ["done"] * 3
    assert arrays["point_q"] == pytest.approx([point.modal_amplitude for point in result.points], rel=1e-6)
    assert arrays["point_d_std"] == pytest.approx([100 * point.damping_ratio_std for point in result.points], rel=1e-6)
    assert head["table_head"][1] == "f̃ / Hz"
    assert head["verdict"] == ["3 of 3 levels locked and extracted", "good"]
    point = result.points[1]
    assert head["table"][1]["cells"][1] == uncertain(point.frequency_hz, point.omega_rad_s_std / (2.0 * math.pi), 4)
    numbers, _ = live(view)
    assert numbers["drive_limit"].startswith("10")
    assert numbers["progress"] == 1.0
    levels = {row["name"]: row for row in head["channels"]}
    assert (levels["f2"]["abort_peak"], levels["f2"]["warning_peak"]) == (20.0, 16.0)
    assert levels["x2"]["abort_peak"] is None


def test_the_newest_periods_and_the_orbit_are_those_of_the_signals(tmp_path: Path) -> None:
    view = LiveView()
    frames: list[tuple[dict[str, Any], dict[str, Any]]] = []

    def listen(topic: str, record: Any) -> None:
        view.take(record)
        if topic == "voltage" and record.first_sample == 45_000:
            frames.append(live(view))

    with Session(plan_test("beam", **BEAM), listener=listen, record=False, extract=False) as session:
        session.run()
    ((head, arrays),) = frames
    assert head["loop"] in ("acquiring", "locked")
    assert head["periods"] == 3
    spectrum, lines = arrays["spectrum_force"], arrays["spectrum_force_f"]
    assert lines[spectrum.argmax()] == pytest.approx(head["fundamental"], abs=1.5)
    assert np.abs(arrays["orbit_force"]).max() == pytest.approx(arrays["harmonics_force"][0], rel=0.2)
    # At phase resonance the force is in phase with the velocity: the orbit encloses no area.
    force, velocity = arrays["orbit_force"], arrays["orbit_velocity"]
    assert np.corrcoef(force, velocity)[0, 1] > 0.9
    assert arrays["low0"].size == arrays["high0"].size > 400
    assert (arrays["low0"] <= arrays["high0"]).all()


def test_what_was_steered_is_shown_with_its_sample(tmp_path: Path) -> None:
    view, _ = watched(
        tmp_path,
        SteeringRequest(SteeringAct.SKIP_LEVEL, 0, at_sample=12_000, source="a test"),
        SteeringRequest(SteeringAct.CHANGE_LEVELS, levels=(0.3,), at_sample=20_000, source="a test"),
    )
    head, _ = facts(view)
    assert [row["state"] for row in head["plan"]] == ["skipped", "done", "done"]
    assert [row["text"] for row in head["plan"]] == ["0.2", "0.5", "0.3"]
    assert "level 1 skipped by a test" in head["acts"][0]
    assert "sample 1" in head["acts"][0]


@pytest.mark.campaign
def test_a_response_curve_grows_with_the_stability_of_its_points(tmp_path: Path) -> None:
    curve = {"test": "response_curve", "lag_deg": (70.0, 150.0), "spacing": 0.45, "ramp": 0.3, "window_periods": 12}
    view = LiveView()
    sizes = []

    def listen(topic: str, record: Any) -> None:
        view.take(record)
        if topic == "modal_point":
            sizes.append(facts(view)[1]["curve_f"].size)

    with Session(plan_test("strong_cubic", [0.32], **curve), listener=listen) as session:
        result = session.run()
    head, arrays = facts(view)
    assert head["test"] == "response_curve"
    assert head["curve_axis"] == "response at the drive point / m"
    assert sizes == list(range(1, len(result.points) + 1))
    (measured,) = response_curves(result.points)
    assert arrays["curve_f"] == pytest.approx(measured.frequency_hz, rel=1e-6)
    assert arrays["curve_y"] == pytest.approx(measured.response, rel=1e-6)
    assert np.array_equal(arrays["curve_stable"], measured.stable, equal_nan=True)
    assert {0.0, 1.0} <= set(arrays["curve_stable"])
    assert not arrays["curve_number"].any()


def test_a_level_that_does_not_lock_shows_why(tmp_path: Path) -> None:
    view, _ = watched(tmp_path, timeout=0.3, levels=[0.3])
    head, arrays = facts(view)
    assert head["plan"][0]["state"] == "not locked"
    assert head["plan"][0]["why"]
    assert head["table"][0]["reason"].startswith("not locked: ")
    assert arrays["point_q"].size == 0


def test_a_random_test_shows_its_averages(tmp_path: Path) -> None:
    view, _ = watched(tmp_path, levels=[0.05], test="random", band_hz=(5.0, 500.0), duration=8.0)
    head, arrays = read_frame(view.live(0))
    assert facts(view)[0]["test"] == "random"
    assert arrays["averages"][0] >= 10
    assert arrays["frf_f"].size == arrays["frf"].size == arrays["coherence"].size > 50
    # The first resonance of the beam.
    peak = arrays["frf_f"][np.where(arrays["frf_f"] < 60.0, arrays["frf"], 0.0).argmax()]
    assert peak == pytest.approx(22.2, abs=2.0)
    assert 0.0 <= arrays["coherence"].min() <= arrays["coherence"].max() <= 1.0 + 1e-6
    assert head["fundamental"] is None


def test_another_run_begins_with_an_empty_page(tmp_path: Path) -> None:
    view, _ = watched(tmp_path / "a")
    with Session(
        plan_test("beam", **{**BEAM, "run_id": "next"}), record=False, listener=lambda _, r: view.take(r)
    ) as s:
        s.run()
    head, _ = facts(view)
    assert head["run"] == "next"
    assert len(head["table"]) == 3


@pytest.mark.parametrize(
    ("run", "rig"),
    [
        ({}, {}),
        (None, None),
        ({"plan": 3, "rig": "<script>alert(1)</script>", "exciter_point": "two"}, {"limits": []}),
        ({"plan": {"levels": ["a", None, 1.0], "test": 7}}, {"limits": {"channels": "all", "voltage_v": "much"}}),
    ],
)
def test_strange_start_records_break_nothing(run: Any, rig: Any) -> None:
    view = LiveView()
    view.begin(run, rig)
    head, _ = facts(view)
    live(view)
    json.dumps(head)


def test_a_node_that_falls_silent_is_named() -> None:
    now = [0.0]
    view = LiveView(clock=lambda: now[0])
    view.take_health("pll", 0, "ready", {})
    assert live(view)[0]["nodes"] == [{"name": "pll", "level": 0, "text": "ready"}]
    now[0] = 4.0
    (node,) = live(view)[0]["nodes"]
    assert node["level"] == 2
    assert node["text"].startswith("silent for 4.0")


# -- replay ----------------------------------------------------------------------------------------------------------


def until(condition: Any) -> None:
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_bag_is_replayed_from_any_moment(tmp_path: Path) -> None:
    watched(tmp_path)
    view = LiveView(replay=True)
    player = BagPlayer(tmp_path / "run" / "bag", view)
    try:
        player.control({"playing": False})
        player.control({"seek": player.duration / 2})
        until(lambda: abs(player.state()["position"] - player.duration / 2) < 0.5)
        until(lambda: len(facts(view)[0]["table"]) >= 1)
        head, _ = facts(view)
        assert 1 <= len(head["table"]) < 3
        player.control({"seek": player.duration, "playing": True})
        until(lambda: len(facts(view)[0]["table"]) == 3)
        player.control({"seek": 0.0, "playing": False})
        until(lambda: len(facts(view)[0]["table"]) == 0)
        player.control({"speed": 50.0, "playing": True})
        until(lambda: facts(view)[0]["phase"] == "done")
        for nonsense in ({"seek": float("nan")}, {"seek": "end"}, {"speed": 1e9}, {"playing": 1}, {}):
            player.control(nonsense)
        assert player.state()["speed"] == 50.0
    finally:
        player.close()


def test_messages_that_have_the_time_of_their_reception_hold_up_no_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched(tmp_path)
    stamped = Bag.raw_messages

    def received(self: Bag, *arguments: Any) -> Any:
        for topic, kind, stamp, raw in stamped(self, *arguments):
            yield topic, kind, 1_800_000_000_000_000_000 if topic == "level" else stamp, raw

    monkeypatch.setattr(Bag, "raw_messages", received)
    view = LiveView(replay=True)
    player = BagPlayer(tmp_path / "run" / "bag", view)
    try:
        player.control({"seek": player.duration})
        player.state()
        until(lambda: len(facts(view)[0]["table"]) == 3)
    finally:
        player.close()


def test_a_folder_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchError):
        BagPlayer(tmp_path, LiveView(replay=True))


def test_a_stop_is_shown_until_it_is_released_whatever_else_comes(tmp_path: Path) -> None:
    view, _ = watched(tmp_path)
    stop = DriveStop(70_000, StopCause.EMERGENCY_STOP, OutputState.RAMPING, "emergency stop by /page", 7_000_000_000)
    view.take(stop)
    assert facts(view)[0]["stopped"].startswith("Emergency stop by /page. The drive goes to zero")
    view.take(replace(stop, output=OutputState.HELD))
    view.take_health("pll", 2, "hung", {})
    view.take(RunState("another", RunPhase.IDLE, 0, 0, 0.0, 0.0, 0, 0, ResultCode.UNKNOWN, ""))
    head, _ = facts(view)
    assert head["stopped"] == "Emergency stop by /page. The drive is at zero and stays there until it is released."
    view.take(replace(stop, output=OutputState.NOT_KNOWN))
    assert "Nobody can tell" in facts(view)[0]["stopped"]
    view.take(replace(stop, cause=StopCause.RELEASED, reason=""))
    head, _ = facts(view)
    assert (head["stopped"], head["stop_state"]) == ("", "released")


def test_a_rig_that_comes_to_rest_reaches_no_denormal_number(tmp_path: Path) -> None:
    view = LiveView()
    newest: dict[Any, Any] = {}

    def listen(topic: str, record: Any) -> None:
        view.take(record)
        newest[type(record), getattr(record, "quantity", None)] = record

    with Session(plan_test("beam", **{**BEAM, "levels": [0.2]}), tmp_path / "run", listener=listen) as session:
        session.run()
    blocks = [record for record in newest.values() if isinstance(record, SampleBlock)]
    status = newest[LoopStatus, None]
    for step, size in enumerate((1e-6, 1e-15, 1e-19, 1e-150, 1e-310, 5e-324, 0.0), 1):
        for block in blocks:
            small = np.full_like(block.data, size)
            view.take(replace(block, first_sample=block.first_sample + step * block.samples, data=small))
        moved = status._replace(last_sample=status.last_sample + step, force_amplitude=size, response_amplitude=size)
        view.take(moved)
        head, arrays = live(view)
        shown = [array[(array != 0) & np.isfinite(array)] for name, array in arrays.items() if name != "coherence"]
        assert min(float(np.abs(part).min()) for part in shown if part.size) >= 1e-30 or size == 1e-6
    assert head["force"].startswith("0")
    for block in blocks:
        view.take(replace(block, first_sample=block.first_sample + 10**6, data=np.full_like(block.data, 1e-310)))
    view.take(status._replace(last_sample=status.last_sample + 100, force_amplitude=1e-300))
    head, arrays = live(view)
    assert head["force"].startswith("below ")
    assert (arrays["peak"][arrays["floor"] > 0] >= 0).all()


def test_a_skipped_level_is_not_called_rejected(tmp_path: Path) -> None:
    view, _ = watched(tmp_path, SteeringRequest(SteeringAct.SKIP_LEVEL, level_index=0, source="page"))
    assert facts(view)[0]["plan"][0]["state"] == "skipped"
    point = replace(next(iter(view._points.values())), level_index=0, status=PointStatus.REJECTED)
    view.take(point)
    assert facts(view)[0]["plan"][0]["state"] == "skipped"


def test_the_shape_is_that_of_the_fundamental() -> None:
    t = np.arange(300) / 300
    periods = np.outer([0.5, -1.0, 9.0, 0.2], np.sin(2 * np.pi * 3 * t)) + np.cos(2 * np.pi * 9 * t)
    np.testing.assert_allclose(deflection(periods, [1, 2, 0, 4]), [-0.5, 1.0, 0.0, -0.2], atol=1e-12)
    assert not deflection(np.zeros((2, 300)), [1, 2]).size


def test_a_replay_waits_for_somebody_who_watches(tmp_path: Path) -> None:
    view, _ = watched(tmp_path)
    player = BagPlayer(tmp_path / "run" / "bag", view)
    try:
        time.sleep(0.1)
        assert player._position == 0.0
        assert facts(view)[0]["phase"] == "done"  # nothing was forgotten or played
        player.state()
        until(lambda: player.state()["position"] > 0.0)
    finally:
        player.close()


def test_every_exciter_has_its_force_and_its_voltage(tmp_path: Path) -> None:
    view = LiveView()
    frames: list[tuple[dict[str, Any], dict[str, Any]]] = []

    def listen(topic: str, record: Any) -> None:
        view.take(record)
        if topic == "lock":
            frames.append(live(view))

    with Session(plan_test("frame", [2.0], window_periods=20), listener=listen, record=False) as session:
        view.begin(session.plan.run, {"exciters": [{"point": 1}, {"point": 2}]})
        (point,) = session.run().points
    head, _ = frames[0]
    assert [row["name"] for row in head["exciters"]] == ["Exciter 1, point 1", "Exciter 2, point 2"]
    drive, other = (float(row["drive"].split()[0]) for row in head["exciters"])
    assert drive == pytest.approx(2.0, rel=1e-3)
    assert other != drive
    forces = [float(row["force"].split()[0]) for row in head["exciters"]]
    assert forces == pytest.approx(np.abs(point.exciter_forces.reshape(2, -1)[:, 1]), rel=0.01)
    # Each is drawn before the further responses.
    drawn = sorted((row["shown"], row["name"]) for row in facts(view)[0]["channels"] if row["shown"] >= 0)
    assert [name for _, name in drawn][:5] == ["f1", "a1", "u", "f2", "u2"]


def test_one_exciter_has_no_table_of_exciters() -> None:
    assert live(LiveView())[0]["exciters"] == []


def test_a_secondary_resonance_shows_the_mode_and_the_excitation() -> None:
    view = LiveView()
    plan = plan_test(
        "strong_cubic", [4.8], control="force", test="secondary_resonance", resonance="3:1", window_periods=20
    )
    with Session(plan, listener=lambda _, record: view.take(record), record=False) as session:
        view.begin(session.plan.run, {})
        (point,) = session.run().points
    head, arrays = facts(view)
    assert head["test"] == "secondary_resonance"
    # The third order of the response has the mode's frequency, the excitation a third of it.
    assert arrays["point_f"][0] == pytest.approx(point.frequency_hz, rel=1e-5)
    assert head["table_head"][1:3] == ["f̃ / Hz", "Ω/2π / Hz"]
    assert head["table"][0]["cells"][1] == uncertain(point.frequency_hz, point.omega_rad_s_std / (2.0 * math.pi), 4)
    assert head["table"][0]["cells"][2].startswith(f"{point.frequency_hz / 3.0:.3f}"[:-1])
