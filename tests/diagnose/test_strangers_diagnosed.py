"""Recordings that strangers brought, of which no model in the library is the whole: told as such, and as one thing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from nmt_bench.cli import main
from nmt_blind.campaign.foreign_case import contradictions

INPUTS = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "strangers"

CLIPPED = INPUTS.parent / "strangers3" / "effort_clip.py"

pytestmark = pytest.mark.skipif(not INPUTS.is_dir(), reason=f"the inputs of strangers are not there ({INPUTS})")


def diagnosed(folder: Path, model: str, sidecars: tuple[str, ...], out: Path) -> dict[str, Any]:
    words = ["diagnose", "--model", str(folder / model), "--out", str(out / "diagnosis"), "--quiet", "--jobs", "1"]
    for name in sidecars:
        assert main(["import", str(folder / f"{name}.yaml"), "--out", str(out / name)]) == 0
        words += ["--real", str(out / name)]
    assert main(words) == 0
    result: dict[str, Any] = json.loads((out / "diagnosis" / "diagnosis.json").read_text())
    return result


def test_a_misfit_of_percents_is_no_noise_of_a_thousandth(tmp_path: Path) -> None:
    """A resonance with neighbours beyond the band, of 0.1 % of scatter with 0.2 % stated, and a model of one mode."""
    found = diagnosed(INPUTS / "02-misfit-taken-for-noise", "m.yaml", ("frf",), tmp_path)
    assert found["verdict"] == "unknown"
    assert found["gap"]["after"] > 5.0
    assert contradictions(found) == ()


def test_a_pendulum_with_friction_is_one_thing_in_headline_and_table(tmp_path: Path) -> None:
    """Friction beside the restoring torque of a sine: cubic softening and friction, which leave a part."""
    found = diagnosed(INPUTS / "15-headline-against-table", "pend.yaml", ("p1", "p2"), tmp_path)
    assert (found["verdict"], found["adequate"]) == ("effect", False)
    head, both = found["ranking"][:2]
    assert head["effect"] == "cubic_stiffness"
    assert head["given_library"]
    assert both["effect"] == "cubic_stiffness + second_friction_contact"
    assert "with friction contact added it closes" in found["sentences"][1]
    # The law is read from one of two decays; its file closes 89 % of what is held out of both, the effect 97 %.
    assert found["law"]["closed_by_file"] < found["gap"]["low"]
    # The cubic spring moves the model's frequency by more than 3 of its tolerances: the law is the answer.
    assert found["sentences"][0].startswith(
        "At the held levels the missing force acts like softening spring at point 1"
    )
    assert "The fit moves parameters further than their tolerances" in " ".join(found["sentences"])
    assert found["probabilities"]["unknown"] > 0.9
    assert contradictions(found) == ()


@pytest.mark.campaign
@pytest.mark.skipif(not CLIPPED.is_file(), reason=f"the generator is not there ({CLIPPED})")
def test_a_drive_that_saturates_where_no_channel_shows_it_has_no_sure_place(tmp_path: Path) -> None:
    """The effort is a command beyond what the drive gives: a gain of either channel comes nearest."""
    subprocess.run([sys.executable, CLIPPED, tmp_path], check=True, capture_output=True)
    found = diagnosed(tmp_path, "arm.yaml", ("s",), tmp_path)
    assert found["verdict"] == "unknown"
    places = {item["place"]: item["p"] for item in found["where"]}
    assert max(places.values()) < 0.6
    assert min(places["response_sensor"], places["force_sensor"]) > 0.3
    assert contradictions(found) == ()
