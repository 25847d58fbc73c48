"""Both converters in real time, with the specimen behind their ports: over JACK, and over NI's own client library.

Their logic is tested on a clock of the test in `plant.test_converters`. What is asked for here holds on a busy
computer, too: a computer that stands still loses samples, and then a run says so by name. The scripts beside this file
do the same at length: `converter_demo`, `converter_delay`, `converter_gaps`, `converter_faults`, `check_trials`.
"""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from node.converter_bench import KINDS, MISSING, WHAT_IS_MISSING, converter_bench, environment, simulated
from node.converter_delay import SINE, open_device, sentences, true_delay
from node.converter_demo import MOST_DAMPING, MOST_FREQUENCY, compare
from node.converter_excitations import compare as excitations
from node.converter_faults import attempt, processes, until_locked
from node.converter_gaps import stream
from tiers import with_quick

LOST = re.compile(
    r"loses samples again and again|had lost samples|are missing from the window|samples lost in [1-9]|gaps [1-9]"
    r"|NI-DAQmx lost samples|the computer too busy|has fallen silent|no drive command for"
)
"""What a run says where samples were lost or came too late, or a node did not get to work."""
AT_ONCE = 5.0  # s; what has to be waited for otherwise takes ten

both = pytest.mark.parametrize("kind", KINDS)


@pytest.fixture(autouse=True)
def _surroundings(request, tmp_path, monkeypatch):
    if MISSING[request.getfixturevalue("kind")]:
        pytest.skip(WHAT_IS_MISSING)
    for name, value in environment(tmp_path).items():
        monkeypatch.setenv(name, value)


@contextmanager
def or_losses_are_named(said: str = "") -> Iterator[None]:
    """What is asked for inside holds, unless an error or what was said names lost samples."""
    try:
        yield
    except Exception as error:
        found = LOST.search(f"{error} {said}")
        if found is None:
            raise
        pytest.skip(f"the computer lost samples, and it is said: '{found.group()}'")


@pytest.mark.parametrize("kind", with_quick(KINDS, "nidaqmx"))
def test_a_short_stream(kind, tmp_path):
    """A start finds the delay, every block that is given is what was put out, the output ends at zero."""
    with or_losses_are_named():
        try:
            with converter_bench(kind, tmp_path, "--delay", "37", record_s=60.0) as bench:
                drive_and_compare(kind, bench.device.partition("@")[2])
        finally:
            assert bench.port().time_to_zero(0.0) < np.inf


def drive_and_compare(kind, address):
    """Two seconds of a sine."""
    device = open_device(kind, address)
    row = [entry.channel for entry in device.section.inputs].index("u")
    try:
        assert abs(device.figures.delay - true_delay(kind, 37)) <= 1
        given, largest = 0, 0.0
        for _ in range(100):
            device.write(SINE)
            if device.read():
                given += 1
                seen = device.measured[row] / device.section.inputs[row].sensitivity_v
                np.testing.assert_allclose(seen, device.put_out, atol=0.01)
                largest = max(largest, float(np.abs(seen).max()))
        assert not device.tripped, device.tripped
        assert given == 100 or device.figures.lost_turns > 0
        assert largest == pytest.approx(SINE.amplitude, rel=0.01)
    finally:
        device.close()


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["portaudio"])
@pytest.mark.parametrize(
    ("options", "channel"),
    [
        (("--fault", "short:x6@0.8"), "x6"),
        (("--fault", "open:x6@0.8"), "x6"),
        (("--fault", "sensitivity:x5@0.8"), "x5"),
        (("--fault", "late:x5@0.8"), "x5"),
        (("--set", "sensors.4.clip=6e-4"), "x6"),
        (("--fault", "short:x2@0.8"), "x2"),
        (("--fault", "sensitivity:f2@0.8") * 2, "f2"),
        (("--fault", "sensitivity:f2@0.8"), "f2"),
        (("--fault", "short:f2@0.8"), "f2"),
        (("--fault", "sign:x4@0.8"), "x4"),
        (("--fault", "late:x2@0.8"), "x2"),
        (("--fault", "icp:x5@0.8"), "x5"),
        (("--fault", "sensitivity:x2@0.8"), "x2"),
    ],
)
def test_a_channel_that_fails_in_a_test_is_named(kind, options, channel, tmp_path):
    """From the second of three levels on; no damping ratio is wrong beyond its uncertainty."""
    words = ["--levels", "0.3,0.9,1.2", "--periods", "40", "--reference", "none", "--no-report"]
    simulated(kind, tmp_path, "run", *words, "--out", str(tmp_path / "simulated"))
    with converter_bench(kind, tmp_path, *options) as bench:
        bench.pass_check()
        with bench.start("run", "--quiet", *words, "--out", str(tmp_path / "run")) as process:
            said, _ = process.communicate()
    with or_losses_are_named(said):
        found, wanted = (
            json.loads((tmp_path / name / "modal.json").read_text())["points"] for name in ("run", "simulated")
        )
        assert found[0]["status"] == "OK"
        assert channel in " ".join(point["reason"] for point in found[1:]) or "no higher level follows" in said
        for point, truth in zip(found, wanted, strict=False):
            if point["status"] == "OK":
                away = abs(point["damping_ratio"] - truth["damping_ratio"])
                assert away < 2.0 * point["damping_ratio_std"] + MOST_DAMPING * truth["damping_ratio"]


@pytest.mark.campaign
@both
def test_a_short_test_by_the_command(kind, tmp_path):
    """Launcher, nodes and converter together: a level locks and has the values of the simulated one."""
    words = ["--levels", "1", "--periods", "10", "--reference", "none", "--no-report"]
    simulated(kind, tmp_path, "run", *words, "--out", str(tmp_path / "simulated"))
    with converter_bench(kind, tmp_path, record_s=120.0) as bench:
        bench.pass_check()
        with bench.start("run", "--quiet", *words, "--out", str(tmp_path / "run")) as process:
            said, _ = process.communicate()
    port = bench.port()
    assert port.time_to_zero(0.0) < np.inf
    with or_losses_are_named(said):
        assert process.returncode == 0, said
        assert np.abs(port.values).max() == pytest.approx(0.2, rel=0.01), "1 V behind an amplifier of 5"
        assert re.search(r"round trip \d+ samples", said)
        (found,), (wanted,) = (
            json.loads((tmp_path / name / "modal.json").read_text())["points"] for name in ("run", "simulated")
        )
        assert found["status"] == "OK"
        assert found["frequency_hz"] == pytest.approx(wanted["frequency_hz"], rel=1e-3)
        assert found["damping_ratio"] == pytest.approx(wanted["damping_ratio"], rel=0.05)


# -- at length -------------------------------------------------------------------------------------------------------


@pytest.mark.campaign
@both
def test_the_demo_on_a_converter_is_the_simulated_one(kind, tmp_path):
    """Check, test and report."""
    with or_losses_are_named():
        found, said = compare(kind, tmp_path, "--levels", "1", "--periods", "40", "--reference", "none")
        assert [each.level for each in found] == [1.0], said
        assert "gaps 0" in said, said
    for each in found:
        assert abs(each.frequency_difference) <= MOST_FREQUENCY
        assert abs(each.damping_difference) <= MOST_DAMPING
        assert each.frequency_difference != 0.0, "the converter's noise is in it"
    report = (tmp_path / "run" / "report.html").read_text()
    for words in ("Late by", "Turns of the converter with lost samples", "Priority of the plant node", "governor"):
        assert words in report


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["portaudio"])
def test_a_clock_that_is_off_is_said(kind, tmp_path):
    """A card whose output and input drift apart shows in the delay; of a whole converter see `converter_delay`."""
    with or_losses_are_named():
        _, drift, said = sentences(kind, tmp_path, 50.0, 10.0)
    assert drift == pytest.approx(-50e-6 * 48_000 * 10.0, rel=0.5) or drift > 1.0
    assert any("do not share one clock" in sentence for sentence in said)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("kind", "process", "fault"), [("portaudio", "owner", "SIGSTOP"), ("nidaqmx", "plant", "SIGKILL")]
)
def test_the_port_is_at_zero_after_a_fault(kind, process, fault, tmp_path):
    """Recorded on the other side; JACK repeats the last period of a client that is stopped, until it is ended."""
    with or_losses_are_named():
        found = attempt(kind, process, fault, tmp_path)
    assert found.amplitude > 0.05
    assert found.seconds < AT_ONCE
    assert found.ended == 1
    if process == "plant":
        assert found.step < 0.01, "along the ramp, without a click"


@pytest.mark.campaign
@both
def test_a_gap_is_marked(kind, tmp_path):
    """The process at the converter is stopped now and then: blocks that are given are what was put out."""
    with or_losses_are_named():
        found = stream(kind, tmp_path, 8.0, stop_every=1.5, stop_s=0.03 if kind == "portaudio" else 0.2)
        assert found.ended == "", found.ended
    assert found.stops >= 3
    assert found.marked >= found.stops
    assert found.unmarked == []


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["portaudio"])
def test_lost_samples_reject_their_window_only(kind, tmp_path):
    """The process at the converter is stopped for a moment in the window of the second of three levels."""
    out = tmp_path / "run"
    with converter_bench(kind, tmp_path) as bench, or_losses_are_named():
        bench.pass_check()
        words = ["--levels", "0.3,0.6,1", "--periods", "100", "--quiet", "--no-report", "--out", str(out)]
        with bench.start("run", *words) as command:
            until_locked(command, out, 2)
            time.sleep(1.0)
            owner = processes(command.pid)["owner"]
            os.kill(owner, signal.SIGSTOP)
            time.sleep(0.03)
            os.kill(owner, signal.SIGCONT)
            said, _ = command.communicate()
        points = json.loads((out / "modal.json").read_text())["points"]
        assert points[1]["status"] == "REJECTED", said
        # What is lost may cost the lock before the window is looked at.
        assert any(words in points[1]["reason"] for words in ("missing", "gap", "did not hold its lock")), points[1]
        assert "samples lost in 0 turns" not in said
        others = [point for point in points if point is not points[1]]
        assert all(point["status"] == "OK" or LOST.search(point["reason"]) for point in others), points


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["nidaqmx"])
def test_a_ring_down_on_a_converter_is_the_simulated_one(kind, tmp_path):
    with or_losses_are_named():
        found = excitations(kind, tmp_path, "ring_down")
    for name, value, wanted in found:
        assert value == pytest.approx(wanted, rel=2e-3), name
