"""Files as acquisition programs write them: the sidecar that is proposed imports once its questions are answered."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates
from nmt_record.exchange.unit_table import channel_factor

T = np.arange(400) / 1000.0
X = np.exp(-5.0 * T) * np.sin(2.0 * np.pi * 20.0 * T)
F = 18.0 + 0.01 * np.arange(400)
RECEPTANCE = 1.0 / ((2.0 * np.pi) ** 2 * (20.0**2 - F**2 + 0.4j * F))


def imported(path: Path, answers: dict[str, str] | None = None) -> list[ImportedRun]:
    """Every recording of a file by the proposed sidecars, with question marks replaced in turn."""
    runs = []
    for number, text in enumerate(sidecar_templates(path)):
        for question, answer in (answers or {}).items():
            for one in answer.split("|"):
                text = text.replace(question, one, 1) if "|" in answer else text.replace(question, one)
        (path.parent / f"{number}.yaml").write_text(text)
        runs.append(read_import(path.parent / f"{number}.yaml"))
    return runs


def rows(*columns: np.ndarray, tab: str = "\t") -> str:
    return "".join(tab.join(f"{value:.9g}" for value in row) + "\r\n" for row in zip(*columns, strict=True))


def test_labview_text(tmp_path: Path) -> None:
    head = (
        "LabVIEW Measurement\t\r\nSeparator\tTab\r\nDecimal_Separator\t.\r\nX_Columns\tOne\r\n***End_of_Header***\t\r\n"
    )
    head += "\t\r\nChannels\t2\t\t\r\nY_Unit_Label\tVolts\tVolts\t\r\nX0\t-0.01\t-0.01\t\r\nDelta_X\t0.001\t0.001\t\r\n"
    head += "***End_of_Header***\t\t\t\r\nX_Value\tlaser 100 mV/mm\ttrigger\tComment\r\n"
    (tmp_path / "d.lvm").write_text(head + rows(T - 0.01, X, 5.0 * (T < 0.01)), newline="")
    (run,) = imported(tmp_path / "d.lvm")
    (channel,) = run.channels  # volts of a trigger are no drive voltage
    assert channel.quantity is Quantity.DISPLACEMENT
    np.testing.assert_allclose(channel.data, 0.01 * X, rtol=1e-7, atol=1e-12)
    assert (run.sample_rate, run.segments[0].section.kind, run.segments[0].section.start) == (
        1000.0,
        "ring_down",
        -0.01,
    )
    (tmp_path / "d.lvm").write_text(head)
    with pytest.raises(BenchError, match=r"d\.lvm"):
        sidecar_templates(tmp_path / "d.lvm")


def test_tdms(tmp_path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(tmp_path / "d.tdms") as file:
        properties = {"wf_increment": 0.001, "wf_start_offset": 0.0, "unit_string": "m/s^2"}
        file.write_segment([ChannelObject("test", "a2", X, properties=properties)])
    (run,) = imported(tmp_path / "d.tdms")
    np.testing.assert_array_equal(run.channels[0].data, X)
    assert (run.sample_rate, run.channels[0].point) == (1000.0, 2)
    (tmp_path / "d.tdms").write_bytes((tmp_path / "d.tdms").read_bytes()[:60])
    with pytest.raises(BenchError, match=r"d\.tdms"):
        sidecar_templates(tmp_path / "d.tdms")


def test_vibrometer_text_keeps_its_response(tmp_path: Path) -> None:
    head = (
        "Source File Name:\ttap4\r\nPoint Index:\t1\t[x = 0.1\ty = 0.2]\r\n\r\nTime\tTime Signal\r\n[ s ]\t[ m/s ]\r\n"
    )
    (tmp_path / "t.txt").write_text(head + rows(T, X), newline="")
    (run,) = imported(tmp_path / "t.txt")
    assert [channel.quantity for channel in run.channels] == [Quantity.VELOCITY]
    assert run.segments[0].section.kind == "ring_down"


def test_time_before_a_trigger(tmp_path: Path) -> None:
    (tmp_path / "h.csv").write_text("Time (s),Hammer (N),Acc1 (m/s^2)\n" + rows(T - 0.01, X**2, X, tab=","), newline="")
    (run,) = imported(tmp_path / "h.csv")
    segment = run.segments[0]
    assert (segment.first_sample, segment.stop_sample, segment.section.kind) == (0, 400, "record")


@pytest.mark.parametrize("amplitudes", ["peak", "rms"])
def test_responses_of_a_controller_at_two_levels(tmp_path: Path, amplitudes: str) -> None:
    head = "X-Data [Hz]\tLaser (M) [m/s]\tPhase [Deg]\tLaser (M) [m/s]\tPhase [Deg]\t\r\n"
    head += "\t003: [11-03-25 09:57]\t\t005: [11-03-25 10:02]\t\t\r\n"
    velocity = 2j * np.pi * F * RECEPTANCE
    lag = 25.0 - np.degrees(np.angle(RECEPTANCE))
    text = rows(F, 0.4 * np.abs(velocity), lag, 1.2 * np.abs(velocity), lag).replace(".", ",")
    (tmp_path / "c.txt").write_text(head + text, newline="")
    (run,) = imported(
        tmp_path / "c.txt", {"level: '?'": "level: 0.4|level: 1.2", "amplitudes: '?'": f"amplitudes: {amplitudes}"}
    )
    factor = np.sqrt(2.0) if amplitudes == "rms" else 1.0
    assert [table.level for table in run.tables] == pytest.approx([0.4 * factor, 1.2 * factor])
    for table in run.tables:
        assert (table.direction, table.quantity, table.reference) == ("up", Quantity.VELOCITY, "force")
        error = table.responses / velocity
        np.testing.assert_allclose(np.abs(error), 1.0, rtol=1e-6)
        assert np.abs(np.degrees(np.angle(error))).max() < 4.0  # the offset is guessed from the ends


def test_responses_without_the_held_level_are_refused(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("frequency_hz,magnitude\n" + rows(F, np.abs(RECEPTANCE), tab=","), newline="")
    (tmp_path / "s.yaml").write_text("file: r.csv\nsegments: [{kind: frf, unit: mm}]\n")
    with pytest.raises(BenchError, match="mm is a response, not a response per force; give the level"):
        read_import(tmp_path / "s.yaml")


def test_arrays_of_structs_are_segments_with_their_forces(tmp_path: Path) -> None:
    runs = np.zeros((1, 2), dtype=[(name, object) for name in ("Force", "Frequency", "Amplitude", "Phase")])
    for number, force in enumerate((0.4, 1.2)):
        phase = np.degrees(np.angle(RECEPTANCE))
        runs[0, number] = (force, F, force * np.abs(RECEPTANCE), phase)
    savemat(tmp_path / "r.mat", {"FRF": runs})
    (run,) = imported(tmp_path / "r.mat", {"amplitudes: '?'": "amplitudes: peak", "unit: '?'": "unit: m"})
    assert [table.level for table in run.tables] == [0.4, 1.2]
    for table in run.tables:
        np.testing.assert_allclose(table.responses, RECEPTANCE, rtol=1e-12)


def test_cells_are_recordings_of_their_own(tmp_path: Path) -> None:
    cells = np.empty((2, 2), dtype=object)
    cells[:, 0] = "tap 1", "tap 2"
    cells[0, 1], cells[1, 1] = np.vstack([T, X]), np.vstack([T, 2.0 * X])
    savemat(tmp_path / "t.mat", {"xData": cells})
    answers = {"quantity: '?'": "quantity: displacement", "unit: '?'": "unit: mm"}
    runs = imported(tmp_path / "t.mat", answers)
    assert [run.segments[0].section.kind for run in runs] == ["ring_down"] * 2
    for run, factor in zip(runs, (1e-3, 2e-3), strict=True):
        np.testing.assert_allclose(run.channels[0].data, factor * X, rtol=1e-12)


def test_what_follows_a_hit_is_a_decay(tmp_path: Path) -> None:
    force = np.where((T > 0.02) & (T < 0.024), 30.0, 0.0) + 0.01 * np.sin(900.0 * T)
    (tmp_path / "h.csv").write_text("t [s],hammer [N],acc [m/s^2]\n" + rows(T, force, X, tab=","), newline="")
    (run,) = imported(tmp_path / "h.csv")
    assert run.segments[0].section.kind == "ring_down"
    assert 0.024 <= run.segments[0].section.start < 0.03
    (tmp_path / "h.csv").write_text("t [s],hammer [N],acc [m/s^2]\n" + rows(T, 30.0 * X, X, tab=","), newline="")
    assert "kind: record" in sidecar_templates(tmp_path / "h.csv")[0]


def test_a_backbone_is_asked_whether_its_amplitudes_are_peak_or_rms(tmp_path: Path) -> None:
    (tmp_path / "b.csv").write_text("frequency,amplitude [mm]\n10,1\n10.1,2\n", newline="")
    assert "amplitudes: '?'       # peak, rms or peak_to_peak" in sidecar_templates(tmp_path / "b.csv")[0]


@pytest.mark.parametrize(
    ("unit", "factor", "quantity"), [("deg", np.pi / 180.0, "angle"), ("µm/m", 1e-6, "strain")], ids=("angle", "strain")
)
def test_angles_and_strains_are_quantities_of_their_own(
    tmp_path: Path, unit: str, factor: float, quantity: str
) -> None:
    (tmp_path / "a.csv").write_text(f"t [s];value [{unit}]\n" + rows(T, X, tab=";"), newline="")
    (run,) = imported(tmp_path / "a.csv")
    assert run.channels[0].quantity is Quantity.DISPLACEMENT
    assert run.channels[0].section.quantity == quantity
    np.testing.assert_allclose(run.channels[0].data, factor * X, rtol=1e-6, atol=1e-12)
    assert not any("unusually" in note for note in run.notes)
    with pytest.raises(BenchError, match=f"is one of {quantity}; write quantity: {quantity}"):
        channel_factor("displacement", unit, "it")
    with pytest.raises(BenchError, match="its unit 'mm' is none; use"):
        channel_factor(quantity, "mm", "it")
