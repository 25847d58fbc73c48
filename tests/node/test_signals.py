"""Signals to each process of ``./nmt run``: the run ends, the drive is at zero in the bag, and no process stays.

``python tests/node/signal_trials.py`` does as many as one likes, drawn at random.
"""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from node.signal_trials import LAUNCHER, Trial, attempt

# Each process, each signal, both pacings.
QUICK = [(LAUNCHER, "KILL", "lockstep")]
CASES = [
    (LAUNCHER, "HUP", "realtime"),
    (LAUNCHER, "STOP", "realtime"),
    (LAUNCHER, "INT", "lockstep"),
    ("plant", "TERM", "realtime"),
    ("plant", "STOP", "realtime"),
    ("pll", "STOP", "realtime"),
    ("sequencer", "STOP", "realtime"),
    ("sequencer", "HUP", "realtime"),
    ("extract", "KILL", "lockstep"),
    ("recorder", "TERM", "lockstep"),
]


@pytest.mark.parametrize(
    ("victim", "name", "pacing"), [*QUICK, *(pytest.param(*case, marks=pytest.mark.campaign) for case in CASES)]
)
def test_a_signal_ends_the_run_with_the_drive_at_zero(victim: str, name: str, pacing: str, tmp_path: Path) -> None:
    outcome = attempt(Trial(victim, name, pacing), tmp_path / "out")
    # How long it takes on a busy computer is for the table of signal_trials.py.
    assert [fault for fault in outcome.faults if not fault.startswith("over ")] == [], outcome.said
    if victim == LAUNCHER:
        codes = {"KILL": -signal.SIGKILL, "STOP": 1}
        assert outcome.code == codes.get(name, 130), outcome.said
        assert (name == "STOP") == ("is stopped" in outcome.said)
    else:
        assert outcome.code == 1
        assert f"Node {victim} " in outcome.said
        assert (name == "STOP") == ("gives no sign of life" in outcome.said)
