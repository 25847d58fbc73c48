"""Every study shows its figures and findings; their verdicts follow the results."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from study.synthetic_result import perfect_result
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.vocabulary import PointStatus
from nmt_report.svg import figure_style
from nmt_rig.rig import load_rig
from nmt_study import STUDIES, bench_time, exciter_location, joint_stiffness, levels, linear_modes, noise
from nmt_study.study_report import _verdict, index_page, study_page
from nmt_study.study_runner import load_study
from nmt_study.study_table import level_rows, summary_row


def shown(module, results):
    with figure_style():
        output = module.show(results)
    rows = [row for result in results for row in level_rows("s", result)]
    summary = [summary_row(result, level_rows("s", result)) for result in results]
    page = study_page("s", module.TITLE, results, summary, [*rows, *output.extra_rows], output, True)
    assert page.count('<svg class="plot"') == len(output.figures) > 0
    assert not re.search(r'(?:src|href)="(?!#|\w+/report\.html)', page)  # self-contained
    assert index_page([("s", module.TITLE, summary, output.findings)], False).startswith("<!DOCTYPE")
    return output


@pytest.mark.parametrize("name", with_quick(STUDIES, next(iter(STUDIES))))
def test_cases_are_well_formed(name):
    module = load_study(name)
    for quick in (True, False):
        cases = module.cases(quick)
        assert len({case.name for case in cases}) == len(cases) == len({case.title for case in cases})
        for case in cases:
            load_rig(case.rig, [*case.overrides, f"exciter.point={case.exciter}"])
            assert all(level > 0 for level in case.levels)
    assert len(module.cases(True)) <= len(module.cases(False))


def test_an_unknown_study_is_refused():
    with pytest.raises(BenchError, match="There is no study 'x'"):
        load_study("x")


def test_a_far_point_that_is_best_contradicts_the_lower_accuracy(monkeypatch):
    errors = {2: 0.02, 4: 0.03, 5: 0.01, 6: 0.05}
    row = {"participation_2": 0.0, "pbmif": 1.0, "gamma_force": 1.0}
    monkeypatch.setattr(
        exciter_location,
        "level_rows",
        lambda _, result: [{**row, "damping_error_epmc": errors[result["case"]["exciter"]]}],
    )
    monkeypatch.setattr(exciter_location, "summary_row", lambda *_: SimpleNamespace(epmc=(0.0, 0.0)))
    results = [{"case": {"exciter": point}} for point in errors]
    findings = list(exciter_location._findings(results))
    lower = next(finding for finding in findings if "5 or 6" in finding.claim)
    assert not lower.holds
    assert lower.found.endswith("best at point 5")
    whole = SimpleNamespace(locked=4, levels=4)
    assert _verdict(findings, [whole]) == ("4 of 5 statements hold; 4 of 4 levels locked and extracted", "partly")
    assert _verdict(findings, [SimpleNamespace(locked=0, levels=4)])[1] == "bad"
    # Recordings of random excitation have no levels: the statements alone count.
    assert _verdict(findings, [SimpleNamespace(locked=0, levels=0)]) == ("4 of 5 statements hold", "partly")
    errors[5] = 0.04
    assert _verdict(list(exciter_location._findings(results)), [whole])[1] == "good"


@pytest.mark.campaign
def test_exciter_location():
    results = [perfect_result(replace(case, harmonics=5)) for case in exciter_location.cases(True)]
    output = shown(exciter_location, results)
    verdicts = {finding.claim: finding.holds for finding in output.findings}
    assert verdicts["The contribution of the second mode is negligible."]
    assert verdicts["The PBMIF deviates considerably from one at point 6."]
    # The drive points are compared over the same range of q.
    ranges = [[level["modal_amplitude"] for level in result["levels"]] for result in results]
    np.testing.assert_allclose(ranges[0], ranges[1], rtol=5e-3)


@pytest.mark.campaign
def test_noise():
    results = []
    for case in noise.cases(True):
        result = perfect_result(replace(case, harmonics=5), lost=(0,) if "100" in case.name else ())
        result["extra"] = {"snr_db": {"0": {"force": 14.0, "displacement": 11.0}}}
        results.append(result)
    output = shown(noise, results)
    assert all(finding.holds for finding in output.findings if "SNR at the low" in finding.claim)
    assert any("states its uncertainty truthfully" in finding.claim for finding in output.findings)


def test_noise_of_the_paper_is_put_on_force_and_displacements():
    rig = load_rig("beam", noise.noise_overrides(10.0))
    assert [sensor.noise_psd for sensor in rig.sensors[:2]] == pytest.approx([2e-8, 4.5e-15])
    assert [sensor.quantity for sensor in rig.sensors[:5]] == ["force"] + 4 * ["displacement"]
    assert rig.sensors[5].noise_psd == 0.0


def test_linear_modes():
    (case,) = linear_modes.cases(True)
    result = perfect_result(replace(case, harmonics=5))
    damping = np.array([row["damping_ratio"] for row in result["levels"]])
    q = np.array([row["modal_amplitude"] for row in result["levels"]])
    omega = [row["omega_rad_s"] for row in result["levels"]]
    result["extra"] = {
        "scaled": {
            f"{k:g}": {
                "modal_amplitude": (q / k).tolist(),
                "damping_ratio": (k**2 * damping).tolist(),
                "omega_rad_s": omega,
            }
            for k in (0.9, 1.1)
        },
        "random": {
            f"{e:g}": {"modal_amplitude": [q.tolist()] * 3, "damping_ratio": [((1 + e / 5) * damping).tolist()] * 3}
            for e in (0.05, 0.1)
        },
        "witness": 0.0,
    }
    output = shown(linear_modes, [result])
    assert all(finding.holds for finding in output.findings)
    assert len(output.extra_rows) == (2 + 2 * 3) * len(q)


@pytest.mark.campaign
def test_levels():
    results = [perfect_result(replace(case, harmonics=5)) for case in levels.cases(True)]
    output = shown(levels, results)
    assert output.findings[0].holds
    results[1]["levels"][0]["omega_rad_s"] *= 1.01
    assert not shown(levels, results).findings[0].holds


@pytest.mark.campaign
def test_joint_stiffness():
    results = []
    for case in joint_stiffness.cases(True):
        result = perfect_result(replace(case, harmonics=7))
        result["extra"] = {"history": {"time_s": [0, 1], "omega_rad_s": [250.0, 730.0], "state": [2, 3]}}
        results.append(result)
    hunted = next(r for r in results if r["case"]["loop"] == "paper")
    good = next(r for r in results if "omega_rad_s" in r["levels"][0] and r["levels"][0]["omega_rad_s"])
    hunted["levels"] = [{**good["levels"][0], "omega_rad_s": 730.0}]
    output = shown(joint_stiffness, results)
    verdicts = [finding for finding in output.findings if "second mode" in finding.claim]
    assert [finding.holds for finding in verdicts] == [True]


@pytest.mark.campaign
def test_bench_time():
    results = [perfect_result(replace(case, harmonics=5)) for case in bench_time.cases(True)]
    for result in results:
        for row in result["levels"]:
            row["periods"] = 45.0
    output = shown(bench_time, results)
    assert output.findings[-1].holds
    for result in results:
        for row in result["levels"]:
            row["periods"] = 80.0
    assert not shown(bench_time, results).findings[-1].holds


def test_the_spread_of_levels_is_from_the_smallest_to_the_largest():
    rows = [
        {"level": level, "status": PointStatus.OK, "omega_rad_s": omega, "damping_ratio": damping}
        for level, omega, damping in ((1.0, 100.0, 0.01), (1.0, 101.0, 0.01), (1.0, 100.5, 0.013), (2.0, 90.0, 0.02))
    ]
    omega, damping = levels._largest_difference([{"levels": rows[:2]}, {"levels": rows[2:]}])
    assert omega == pytest.approx(1.0 / 100.5)
    assert damping == pytest.approx(0.003 / 0.011)
