"""Results as objects: what the files hold is what tables, arrays and plots show."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from report import diagnosis_fixture
from report.synthetic_run import LINEAR, synthetic_run
from scipy.io import netcdf_file

import nmt
from nmt_core.errors import BenchError
from nmt_core.vocabulary import PointStatus
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_extract.curves.response_table import write_response_csv
from nmt_extract.curves.swept_response import FrequencyResponseTable
from nmt_extract.judgement.uncertainty_budget import FORMAT
from nmt_extract.modal.table import write_results
from nmt_report.run_report import write_report

matplotlib.use("Agg")


@pytest.fixture
def run(tmp_path: Path) -> nmt.RunResults:
    write_results(synthetic_run().points, tmp_path, {"rig": "beam", "linear": json.loads(LINEAR.to_json())})
    opened = nmt.open(tmp_path)
    assert isinstance(opened, nmt.RunResults)
    return opened


def test_a_run(run: nmt.RunResults) -> None:
    made = synthetic_run()
    table = run.to_dataframe()
    assert len(table) == len(made.points)
    good = table[table.status == "OK"]
    np.testing.assert_array_equal(good.omega_rad_s, [p.omega_rad_s for p in made.good_points])
    np.testing.assert_array_equal(good.damping_ratio_std, [p.damping_ratio_std for p in made.good_points])
    assert set(table.reason[table.status != "OK"]) == {p.reason for p in made.failed_points}
    assert run.linear == LINEAR
    data = run.to_xarray()
    np.testing.assert_array_equal(data.frequency_hz, run.values("frequency_hz"))
    first = made.good_points[0]
    np.testing.assert_array_equal(data.shape_harmonics.isel(level=0), first.shape_harmonics)
    assert data.point.values.tolist() == list(first.points)
    assert data.level.attrs["units"] == first.level_unit


def test_the_standard_uncertainty_is_the_total_of_the_budget(tmp_path: Path) -> None:
    """As in the report; what the window shows of itself stands in a column of its own."""
    points = synthetic_run().points
    write_results(points, tmp_path, {"rig": "beam", "linear": json.loads(LINEAR.to_json())})
    first = next(point for point in points if point.status == PointStatus.OK)
    quantities = {"omega_rad_s": {"total": 0.7}, "damping_ratio": {"total": 0.002}}
    budget = {"format": FORMAT, "points": [{"level_index": first.level_index, "quantities": quantities}]}
    (tmp_path / "uncertainty.json").write_text(json.dumps(budget))
    opened = nmt.open(tmp_path)
    assert isinstance(opened, nmt.RunResults)
    row = next(row for row in opened.rows() if row["level_index"] == first.level_index)
    assert row["damping_ratio_std"] == 0.002
    assert row["frequency_hz_std"] == pytest.approx(0.7 / (2.0 * np.pi), rel=1e-12)
    assert row["damping_ratio_repeatability"] == first.damping_ratio_std
    assert row["mac_std"] == first.mac_std
    assert opened.values("damping_ratio_std")[0] == 0.002
    assert opened.values("damping_ratio_repeatability")[0] == first.damping_ratio_std
    assert float(opened.to_xarray().damping_ratio_repeatability[0]) == first.damping_ratio_std
    (tmp_path / "uncertainty.json").write_text("{}")
    with pytest.raises(BenchError, match="not an uncertainty budget"):
        nmt.open(tmp_path)


def test_a_diagnosis_without_explanations_has_the_columns_all_the_same(tmp_path: Path) -> None:
    document = {"verdict": "none", "sentences": [], "ranking": [], "gap": {}}
    (tmp_path / "diagnosis.json").write_text(json.dumps(document))
    table = nmt.open(tmp_path).to_dataframe()[["effect", "detail", "probability", "closed"]]
    assert table.shape == (0, 4)


def test_netcdf_holds_what_the_dataset_holds(run: nmt.RunResults, tmp_path: Path) -> None:
    """scipy reads the file: it shares nothing with xarray but the format."""
    own = run.to_xarray()
    with netcdf_file(run.to_netcdf(tmp_path / "run.nc"), mmap=False) as file:
        np.testing.assert_array_equal(file.variables["frequency_hz"][:], own["frequency_hz"].values)
        shape = file.variables["normalised_shape_real"][:] + 1j * file.variables["normalised_shape_imag"][:]
    np.testing.assert_array_equal(shape, own["normalised_shape"].values)


def test_a_plot_holds_the_points(run: nmt.RunResults) -> None:
    axes = run.plot("damping_ratio")
    (line, *_) = axes.lines
    np.testing.assert_array_equal(line.get_xdata(), run.values("modal_amplitude"))
    np.testing.assert_array_equal(line.get_ydata(), run.values("damping_ratio"))
    assert axes.get_ylabel() == "modal damping ratio"
    assert run.plot("mac", "level", axes) is axes


def test_a_notebook_shows_a_table(run: nmt.RunResults) -> None:
    page = run._repr_html_()
    assert page.count("<tr") == len(run.points) + 1
    assert "frequency_hz_std" in page


@pytest.mark.campaign
def test_figures_of_a_run(run: nmt.RunResults, tmp_path: Path) -> None:
    write_report(synthetic_run(), run.folder / "report.html")
    out = tmp_path / "figures"
    out.mkdir()
    run.figures(out, formats=["pdf"], names=["backbone"])
    assert sorted(path.name for path in out.iterdir()) == ["backbone.csv", "backbone.pdf"]


def test_a_linear_test(tmp_path: Path) -> None:
    (tmp_path / "linear.json").write_text(json.dumps(json.loads(LINEAR.to_json())))
    linear = nmt.open(tmp_path / "linear.json")
    assert isinstance(linear, nmt.LinearResult)
    table = linear.to_dataframe()
    np.testing.assert_allclose(2 * np.pi * table.frequency_hz, LINEAR.frequencies_rad_s)
    assert table["target"].tolist() == [True, False]
    np.testing.assert_array_equal(table[f"shape_{LINEAR.points[1]}"], LINEAR.shapes[1])
    with pytest.raises(BenchError, match=r"no frf\.csv"):
        linear.plot()
    data = linear.to_xarray()
    assert "response" not in data
    np.testing.assert_array_equal(data["shape"].sel(point=LINEAR.points[1]), LINEAR.shapes[1])


def test_a_sweep(tmp_path: Path) -> None:
    frequency = np.array([20.0, 21.0, 22.0])
    frf = np.array([[1.0 + 1.0j, 3.0j, -1.0]])
    levels = [
        FrequencyResponseTable(level, "N", 0.2, frequency, level + 0 * frequency, ("a2",), level * frf, 0.01 * abs(frf),
                               0 * frequency)
        for level in (1.0, 2.0)
    ]  # fmt: skip
    write_response_csv(levels, tmp_path / "frf.csv")
    sweep = nmt.open(tmp_path)
    assert isinstance(sweep, nmt.FrequencyResponses)
    table = sweep.to_dataframe()
    assert len(table) == 6
    np.testing.assert_array_equal(table.real + 1j * table.imag, np.concatenate([frf[0], 2 * frf[0]]))
    data = sweep.to_xarray()
    first, second = data.response.transpose("level", ...).values
    np.testing.assert_array_equal(second - first, frf)
    assert data.level.values.tolist() == [1.0, 2.0]
    axes = sweep.plot()
    np.testing.assert_allclose(axes.lines[1].get_ydata(), 2 * abs(frf[0]))
    with pytest.raises(BenchError, match="no channel 'a9'; it has a2"):
        sweep.plot("a9")


def test_a_reference(tmp_path: Path) -> None:
    (tmp_path / "reference.csv").write_text("modal_amplitude,omega_rad_s,damping_ratio\n1e-4,140,0.01\n1e-3,130,0.05\n")
    reference = nmt.open(tmp_path)
    assert isinstance(reference, nmt.ReferenceResult)
    assert reference.to_dataframe().damping_ratio.tolist() == [0.01, 0.05]
    assert reference.to_xarray().omega_rad_s.sel(modal_amplitude=1e-3) == 130.0
    assert reference.plot("damping_ratio").lines[0].get_ydata().tolist() == [0.01, 0.05]
    with pytest.raises(BenchError, match="no property 'mass'"):
        reference.plot("mass")


def test_a_diagnosis(tmp_path: Path) -> None:
    diagnosis = diagnosis_fixture.report(Verdict.EFFECT).diagnosis
    diagnosis.write(tmp_path / "diagnosis.json")
    opened = nmt.open(tmp_path)
    assert isinstance(opened, nmt.DiagnosisResult)
    assert opened.verdict == "effect"
    assert opened.sentences == tuple(diagnosis.sentences)
    assert opened.closed == pytest.approx(diagnosis.gap.closed)
    table = opened.to_dataframe()
    assert table.effect.tolist() == [entry.effect for entry in diagnosis.ranking]
    assert table.probability[0] == diagnosis.ranking[0].probability
    widths = [bar.get_width() for bar in opened.plot().patches]
    assert widths[-1] == diagnosis.ranking[0].probability
    assert opened.to_xarray().sizes["row"] == len(diagnosis.residual_map)


def test_nothing_to_open(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="no results that can be opened"):
        nmt.open(tmp_path)
    (tmp_path / "diagnosis.json").write_text("{}")
    with pytest.raises(BenchError, match="not a diagnosis"):
        nmt.open(tmp_path)
    (tmp_path / "modal.json").write_text("[")
    with pytest.raises(BenchError, match=r"modal\.json"):
        nmt.open(tmp_path)


def test_unknown_property(run: nmt.RunResults) -> None:
    with pytest.raises(BenchError, match="no property 'weight'"):
        run.values("weight")


def test_functions_are_those_of_the_commands() -> None:
    from nmt_diagnose import diagnose_bags
    from nmt_extract import extract_bag

    assert nmt.extract is extract_bag
    assert nmt.diagnose is diagnose_bags
    assert nmt.load_rig("beam").name == "beam"
