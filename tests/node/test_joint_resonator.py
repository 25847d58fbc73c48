"""The joint resonator through all nodes, shortened: fewer levels and periods than the rig's own test."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest

from nmt_bench.harness import Bench, RunResult
from nmt_core.vocabulary import PointStatus, ResultCode
from nmt_extract.modal.hysteresis import HysteresisLayout, loop_of_point
from nmt_extract.modal.table import LOOP_SAMPLES, write_results
from nmt_extract.offline import extract_bag
from nmt_report.run_report import report_data_from_bag, report_html
from nmt_rig.model.local_elements.iwan import IwanSection
from nmt_rig.reference import compute_reference
from nmt_rig.rig import load_rig

LEVELS = [0.6, 3.0, 12.0]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    out = tmp_path_factory.mktemp("run") / "out"
    with Bench("joint_resonator", LEVELS, out=out, window_periods=40) as bench:
        result = bench.run()
        write_results(result.points, out, {"extraction": bench.plan.run["extraction"]})
    return result


def test_backbone_agrees_with_epmc(finished: RunResult) -> None:
    assert finished.code == ResultCode.SUCCEEDED
    assert all(point.status == PointStatus.OK for point in finished.points)
    reference = compute_reference(
        load_rig("joint_resonator"), 9, np.array([point.modal_amplitude for point in finished.points])
    )
    for index, point in enumerate(finished.points):
        assert point.omega_rad_s == pytest.approx(reference.omega_rad_s[index], rel=1e-4)
        assert point.damping_ratio == pytest.approx(reference.damping_ratio[index], rel=5e-3)
        assert point.mac > 0.999
        assert point.pbmif > 0.999


def test_hysteresis_damping_agrees_with_the_energies_of_the_model(finished: RunResult) -> None:
    """Each slider loses 4 μN (X - μN/k) a cycle and stores (μN)²/k at most (k X²/2 while it sticks)."""
    rig = load_rig("joint_resonator")
    leaf, joint_damper = rig.structure.springs_n_m[0], rig.structure.dampers_ns_m[1]
    suspension = rig.structure.ground_dampers_ns_m[2]
    angles = np.exp(2j * np.pi * np.outer(np.arange(4096) / 4096, np.arange(1, 8)))
    for point in finished.points:
        motion = {number: point.shape_harmonics[1:, row] for row, number in enumerate(point.points)}
        joint, spring = motion[3] - motion[2], motion[2] - motion[1]
        reach, stretch = np.abs((angles @ joint).real).max(), np.abs((angles @ spring).real).max()
        # m3 also drags its suspension along, which is part of -m3 x3''.
        damper = joint_damper * abs(joint[0]) ** 2 + suspension * (motion[3][0] * joint[0].conjugate()).real
        work = math.pi * point.omega_rad_s * damper
        energy = 0.5 * leaf * stretch**2
        for section in rig.local_elements:
            assert isinstance(section, IwanSection)
            energy += 0.5 * section.remaining_stiffness_n_m * reach**2
            for stiffness, limit in zip(*section.slider_table(), strict=True):
                if reach > limit:
                    work += 4.0 * stiffness * limit * (reach - limit)
                    energy += stiffness * limit**2 if reach > 2.0 * limit else _midline(stiffness, limit, reach)
                else:
                    energy += 0.5 * stiffness * reach**2
        expected = work / (4.0 * math.pi * energy)
        tolerance = 4.0 * point.hysteresis_damping_std + 0.005 * expected
        assert point.hysteresis_damping == pytest.approx(expected, abs=tolerance)
        assert 0.8 < point.hysteresis_damping / point.damping_ratio < 1.0
        assert point.hysteresis_damping_std < 0.02 * expected


def _midline(stiffness: float, limit: float, reach: float) -> float:
    """Mean of loading and unloading branch of a slider, integrated from 0 to the largest displacement.

    Unloading from +limit: k(limit - (X - x)); it meets -limit at X - 2 limit, below zero here. Loading is its mirror
    image, which has reached +limit at 2 limit - X.
    """
    turn = 2.0 * limit - reach
    unloading = stiffness * (limit * reach - 0.5 * reach**2)
    loading = stiffness * limit * (reach - turn) + stiffness * (limit * turn - 0.5 * turn**2)
    return 0.5 * (loading + unloading)


@pytest.mark.campaign
def test_loops_are_written_and_shown(finished: RunResult) -> None:
    assert finished.bag is not None
    folder = finished.bag.parent
    settings = json.loads((folder / "run.json").read_text(encoding="utf-8"))["extraction"]
    layout = HysteresisLayout.from_mapping(settings["hysteresis"])
    with (folder / "hysteresis.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(LEVELS) * LOOP_SAMPLES
    for index, point in enumerate(finished.points):
        loop = loop_of_point(layout, point)
        assert loop is not None
        # From the point's harmonics as from the window's.
        assert loop.damping_ratio == pytest.approx(point.hysteresis_damping, rel=1e-6)
        own = rows[index * LOOP_SAMPLES : (index + 1) * LOOP_SAMPLES]
        x = np.array([float(row["relative_displacement_m"]) for row in own])
        f = np.array([float(row["joint_force_n"]) for row in own])
        area = 0.5 * float(np.dot(f, np.roll(x, -1) - np.roll(x, 1)))
        assert area == pytest.approx(loop.dissipated_work, rel=1e-3)
    data = report_data_from_bag(finished.bag)
    html = report_html(data)
    assert html.count('<figure id="hysteresis"') == 1
    assert "δ<sub>hyst</sub>" in html
    assert "modal acceleration ω̃²<i>q</i>" in html


def test_offline_extraction_is_the_same_bit_for_bit(finished: RunResult) -> None:
    assert finished.bag is not None
    offline = extract_bag(finished.bag)
    assert all(a.identical(b) for a, b in zip(offline.points, finished.points, strict=True))


def test_no_loop_with_the_exciter_elsewhere() -> None:
    with Bench("joint_resonator", [1.0], exciter=3, window_periods=20) as bench:
        assert bench.plan.run["extraction"]["hysteresis"] is None
