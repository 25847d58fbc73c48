"""Tests on both converters with the specimen behind their ports: the whole chain from check to report, short.

The scripts beside this file do the same at length: `converter_demo`, `converter_delay`, `converter_gaps`,
`converter_faults`, `check_trials`.
"""

from __future__ import annotations

import json
import os
import re
import signal
import time

import numpy as np
import pytest
from busy_computer import ATTEMPTS, on_a_quiet_computer
from node.converter_bench import KINDS, MISSING, WHAT_IS_MISSING, converter_bench, environment
from node.converter_delay import measured_delay, sentences, true_delay
from node.converter_demo import MOST_DAMPING, MOST_FREQUENCY, compare
from node.converter_excitations import compare as excitations
from node.converter_faults import attempt, processes, until_locked
from node.converter_gaps import stream

SEED = 3
AT_ONCE = 5.0  # s; what has to be waited for otherwise takes ten


@pytest.fixture(params=KINDS)
def kind(request):
    if MISSING[request.param]:
        pytest.skip(WHAT_IS_MISSING)
    return request.param


def only(kind):
    """One converter is enough for what is the same on both; the scripts do both."""
    return pytest.mark.parametrize("kind", [kind], indirect=True)


@pytest.mark.campaign
@on_a_quiet_computer(environment)
def test_the_demo_on_a_converter_is_the_simulated_one(kind, tmp_path):
    found, said = compare(kind, tmp_path, "--levels", "1", "--periods", "40", "--reference", "none", attempts=ATTEMPTS)
    assert [each.level for each in found] == [1.0]
    for each in found:
        assert abs(each.frequency_difference) <= MOST_FREQUENCY
        assert abs(each.damping_difference) <= MOST_DAMPING
        assert each.frequency_difference != 0.0, "the converter's noise is in it"
    assert "gaps 0" in said
    report = (tmp_path / "run" / "report.html").read_text()
    for words in ("Late by", "Turns of the converter with lost samples", "Priority of the plant node", "governor"):
        assert words in report
    assert re.search(r"round trip \d+ samples", said)


@on_a_quiet_computer(environment)
def test_a_start_finds_the_delay(kind, tmp_path):
    for planted in np.random.default_rng(SEED).integers(0, 900, 2):
        assert abs(measured_delay(kind, tmp_path, int(planted)) - true_delay(kind, int(planted))) <= 1


@pytest.mark.campaign
@only("portaudio")
@on_a_quiet_computer(environment)
def test_a_clock_that_is_off_is_said(kind, tmp_path):
    """A card whose output and input drift apart shows in the delay; of a whole converter see `converter_delay`."""
    _, drift, said = sentences(kind, tmp_path, 50.0, 10.0)
    assert drift == pytest.approx(-50e-6 * 48_000 * 10.0, rel=0.5) or drift > 1.0
    assert any("do not share one clock" in sentence for sentence in said)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("kind", "process", "fault"),
    [("portaudio", "owner", "SIGSTOP"), ("nidaqmx", "plant", "SIGKILL")],
    indirect=["kind"],
)
@on_a_quiet_computer(environment)
def test_the_port_is_at_zero_after_a_fault(kind, process, fault, tmp_path):
    """Recorded on the other side; JACK repeats the last period of a client that is stopped, until it is ended."""
    found = attempt(kind, process, fault, tmp_path)
    assert found.amplitude > 0.05
    assert found.seconds < AT_ONCE
    assert found.ended == 1
    if process == "plant":
        assert found.step < 0.01, "along the ramp, without a click"


@pytest.mark.campaign
@on_a_quiet_computer(environment)
def test_a_gap_is_marked(kind, tmp_path):
    """The process at the converter is stopped now and then: blocks that are given are what was put out."""
    found = stream(kind, tmp_path, 8.0, stop_every=1.5, stop_s=0.03 if kind == "portaudio" else 0.2)
    assert found.stops >= 3
    assert found.marked >= found.stops
    assert found.unmarked == []
    assert found.ended == ""


@pytest.mark.campaign
@only("portaudio")
@on_a_quiet_computer(environment)
def test_lost_samples_reject_their_window_only(kind, tmp_path):
    """The process at the converter is stopped for a moment in the window of the second of three levels."""
    for turn in range(ATTEMPTS):
        points, said = run_with_a_stop(kind, tmp_path, tmp_path / f"run-{turn}")
        if [point["status"] for point in points] == ["OK", "REJECTED", "OK"]:
            break
    assert [point["status"] for point in points] == ["OK", "REJECTED", "OK"], said
    # What is lost may cost the lock before the window is looked at.
    assert any(words in points[1]["reason"] for words in ("missing", "gap", "did not hold its lock")), points[1]
    assert "samples lost in 0 turns" not in said


def run_with_a_stop(kind, folder, out):
    """Points of a run of three levels with a stop in the second one's window, and what the command said."""
    with converter_bench(kind, folder) as bench:
        bench.pass_check()
        words = ["--levels", "0.3,0.6,1", "--periods", "100", "--quiet", "--no-report", "--out", str(out)]
        command = bench.start("run", *words)
        try:
            until_locked(command, out, 2)
            time.sleep(1.0)
            owner = processes(command.pid)["owner"]
            os.kill(owner, signal.SIGSTOP)
            time.sleep(0.03 if kind == "portaudio" else 0.15)
            os.kill(owner, signal.SIGCONT)
            said, _ = command.communicate(timeout=120)
        finally:
            command.kill()
            command.wait()
    return json.loads((out / "modal.json").read_text())["points"], said


@pytest.mark.campaign
@only("nidaqmx")
@on_a_quiet_computer(environment)
def test_a_ring_down_on_a_converter_is_the_simulated_one(kind, tmp_path):
    for name, found, wanted in excitations(kind, tmp_path, "ring_down"):
        assert found == pytest.approx(wanted, rel=2e-3), name
