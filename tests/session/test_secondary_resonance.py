"""Secondary resonances as whole tests in one process: recorded, extracted, extracted again."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pll.secondary_rig import FORCE, LENGTH, OMEGA, at_force

from nmt_core.errors import BenchError
from nmt_core.vocabulary import PointStatus
from nmt_extract.modal.table import read_json, write_json
from nmt_extract.offline import extract_bag
from nmt_session import Session, plan_test


def run(tmp_path: Path, resonance: str, forces, **settings):
    """Modal points of a run of the shipped rig, and the bag; forces in units of 16 N."""
    plan = plan_test(
        "strong_cubic",
        [force * FORCE for force in forces],
        control="force",
        test="secondary_resonance",
        resonance=resonance,
        window_periods=60,
        **settings,
    )
    with Session(plan, tmp_path / "run") as session:
        result = session.run()
    assert result.bag is not None
    return result.points, tmp_path / "run" / "bag"


def check(points, bag, resonance: str, forces, order: int):
    """Against the balance, and against the same extraction from the bag."""
    k, nu = (int(part) for part in resonance.split(":"))
    for point, force in zip(points, forces, strict=True):
        balance = at_force(resonance, force)[0]
        assert point.status is PointStatus.OK, point.reason
        assert (point.response_order, point.force_order) == (k, nu)
        assert point.frequency_hz == pytest.approx(k * balance.omega_b * OMEGA / (2.0 * math.pi), rel=1e-3)
        assert point.omega_rad_s == pytest.approx(2.0 * math.pi * point.frequency_hz, rel=1e-12)
        assert point.excitation_frequency_hz == pytest.approx(point.frequency_hz * nu / k, rel=1e-12)
        assert point.modal_amplitude == pytest.approx(abs(balance.series[order, 0]) * LENGTH, rel=5e-3)
        assert point.force_n == pytest.approx(force * FORCE, rel=5e-3)
        # One dashpot damps every order alike: ξ = 2 ζ ω₁ whatever the amplitude.
        assert point.damping_ratio == pytest.approx(0.01 * OMEGA / point.omega_rad_s, rel=2e-3)
        assert abs(math.degrees(point.phase_error)) < 0.5
        assert point.mac == pytest.approx(1.0)
    again = extract_bag(bag).points
    assert all(one.identical(other) for one, other in zip(again, points, strict=True))


def test_the_superharmonic_resonance_is_recorded_and_extracted_again_bit_for_bit(tmp_path):
    forces = (0.3, 1.0)
    points, bag = run(tmp_path, "3:1", forces)
    check(points, bag, "3:1", forces, 1)


def test_the_subharmonic_resonance_is_recorded_and_extracted_again_bit_for_bit(tmp_path):
    points, bag = run(tmp_path, "1:3", (0.6,), release=0.75e-3)
    check(points, bag, "1:3", (0.6,), 0)
    (point,) = points
    assert point.window_periods % 3 == 0
    content = np.abs(point.shape_harmonics[:, 0])
    assert content[1] > 20.0 * content[2]
    assert np.argmax(np.abs(point.force_harmonics)) == 3


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"resonance": "2:1"}, "'2:1' is not known"),
        ({"resonance": ""}, "needs the resonance, 3:1 or 1:3"),
        ({"resonance": "3:1", "release": 1e-3}, "needs no release"),
        ({"resonance": "1:3", "release": -1e-3}, "must not be negative"),
        ({"resonance": "3:1", "control": "response"}, "levels are voltages or forces"),
        ({"resonance": "3:1", "refinement": 1e-3}, "A secondary resonance test has no refinement"),
    ],
)
def test_what_a_secondary_resonance_test_cannot_be_is_refused(settings, sentence):
    with pytest.raises(BenchError, match=sentence):
        plan_test("strong_cubic", [1e-3], **{"control": "force", "test": "secondary_resonance", **settings})


def test_other_tests_have_no_resonance():
    with pytest.raises(BenchError, match="A phase resonance test has no resonance"):
        plan_test("strong_cubic", [0.1], resonance="3:1")


def test_a_table_keeps_the_orders(tmp_path):
    points, _ = run(tmp_path, "3:1", (0.3,))
    write_json(points, tmp_path / "modal.json")
    assert read_json(tmp_path / "modal.json")[0][0].identical(points[0])
