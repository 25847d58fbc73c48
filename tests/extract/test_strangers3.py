"""Generators of files after public reports: what the import says of each, before any model."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_extract.decays.free_decay import free_decays
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

GENERATORS = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "strangers3"

pytestmark = pytest.mark.skipif(not GENERATORS.is_dir(), reason=f"the generators are not there ({GENERATORS})")


@pytest.fixture
def made(tmp_path: Path) -> Callable[[str], Path]:
    """A folder with what a generator writes."""

    def make(name: str) -> Path:
        subprocess.run([sys.executable, GENERATORS / f"{name}.py", tmp_path], check=True, capture_output=True)
        return tmp_path

    return make


def answered(file: Path, number: int = 0, **answers: Any) -> Path:
    """The sidecar that is proposed, with answers for channels: keys by column, or for the whole."""
    values = yaml.safe_load(sidecar_templates(file)[number])
    values |= {key: value for key, value in answers.items() if not isinstance(value, dict)}
    keys = {key: value for key, value in answers.items() if isinstance(value, dict)}
    for channel in values.get("channels", []):
        channel.update(next((given for name, given in keys.items() if name in str(channel["column"])), {}))
    values["channels"] = [one for one in values.get("channels", []) if "?" not in one.values()]
    sidecar = file.with_name("answered.yaml")
    sidecar.write_text(yaml.safe_dump({key: value for key, value in values.items() if value not in ([], None)}))
    return sidecar


def noted(run: ImportedRun, words: str) -> bool:
    return any(re.search(words, note) for note in run.notes)


DECAY = [{"kind": "ring_down", "start": 0, "stop": 8}]
ANGLE = {"quantity": "angle", "unit": "rad"}
ACCELERATION = {"quantity": "acceleration", "unit": "m/s^2"}


@pytest.mark.parametrize(
    ("name", "sidecar", "words"),
    [
        (
            "deg_rad_mix",
            "s.yaml",
            r"rate of change of column .*knee \(x1\) is 57\.3 times .*degrees that were read as rad",
        ),
        ("dxl_uint16", "s.yaml", r"present_current jumps by 65536 at .*'wrap: 65536'"),
    ],
)
def test_what_contradicts_is_asked(made: Callable[[str], Path], name: str, sidecar: str, words: str) -> None:
    with pytest.raises(BenchError, match=words):
        read_import(made(name) / sidecar)


def test_an_answer_is_taken(made: Callable[[str], Path]) -> None:
    folder = made("dxl_uint16")
    values = yaml.safe_load((folder / "s.yaml").read_text())
    values["channels"][1]["wrap"] = 65536
    (folder / "s.yaml").write_text(yaml.safe_dump(values))
    force = read_import(folder / "s.yaml").channels[1].data
    assert np.abs(force).max() < 5.0


def test_gravity_of_1_is_asked_at_once(made: Callable[[str], Path]) -> None:
    text = sidecar_templates(made("livox_g") / "lidar")[0]
    assert re.search(r"read 1 on the whole, and gravity is 9\.81 m/s\^2: is it in g\? Say 'scale: 9\.80665'", text)
    assert "scale: '?'" in text


@pytest.mark.parametrize(
    ("name", "file", "answers", "words", "frequency", "damping"),
    [
        ("angle_wrap", "wrap", {"position": ANGLE}, "a whole turn", 2.0, 0.03),
        ("nan_codes", "scpi.csv", {}, r"holds 9\.91e\+37 6 times", 9.0, 0.01),
        ("nan_codes", "logger.csv", {}, r"holds -999\.25 6 times", 9.0, 0.01),
        (
            "savetxt_header",
            "run.csv",
            {"force": {"unit": "?"}, "segments": DECAY},
            "500 Hz by column time",
            15.0,
            0.008,
        ),
        ("jtc_state", "jtc", {"feedback.positions.lift": ANGLE}, "", 6.0, 0.02),
        ("lvm_multi", "hits.lvm", {}, "2 of one clock stand one after the other; 1 of other", 30.0, 0.01),
        ("raw_bytes", "raw", {}, "", 23.0, 0.008),
        ("interleaved_array", "daq", {}, "", 31.0, 0.007),
    ],
)
def test_decays_are_read_right(
    made: Callable[[str], Path], name: str, file: str, answers: dict[str, Any], words: str, frequency: float,
    damping: float,
) -> None:  # fmt: skip
    folder = made(name)
    own = {"raw_bytes": ("/adc.data", "bytes int16"), "interleaved_array": ("/plain.data.1", "interleaved 2")}
    if name in own:
        column, elements = own[name]
        values = {
            "file": file,
            "elements": elements,
            "channels": [{"column": column, "point": 1, "scale": 1e-3, **ACCELERATION}],
            "segments": [{"kind": "ring_down", "start": 0, "stop": 4}],
        }
        sidecar = folder / "answered.yaml"
        sidecar.write_text(yaml.safe_dump(values))
    else:
        sidecar = answered(folder / file, **answers)
    run = import_data(sidecar, folder / "bag")
    assert not words or noted(run, words), run.notes
    decays = free_decays(Bag.open(folder / "bag"))
    assert decays
    for decay in decays:
        assert decay.frequency_hz == pytest.approx(frequency, rel=2e-3)
        assert decay.damping_ratio == pytest.approx(damping, rel=0.05)


def test_the_counter_of_packets_tells_what_is_missing(made: Callable[[str], Path]) -> None:
    sidecar = answered(made("packet_counter") / "mt.csv", sample_rate=100.0, segments=[])
    run = read_import(sidecar)
    assert noted(run, "40 samples are missing at 9 places .*PacketCounter")
    assert run.samples == 1500


def test_bytes_channels_in_turn_and_rates_are_asked(made: Callable[[str], Path]) -> None:
    with pytest.raises(BenchError, match="'elements: bytes int16'"):
        sidecar_templates(made("raw_bytes") / "raw")
    assert "'elements: interleaved 2'" in sidecar_templates(made("interleaved_array") / "daq")[0]
    with pytest.raises(BenchError, match=r"changes its rate from segment to segment .500 Hz and 1000 Hz"):
        sidecar_templates(made("tdms_strain") / "rates.tdms")


def test_responses_of_others(made: Callable[[str], Path]) -> None:
    folder = made("uff_real_mag")
    assert "ordinate: '?'" in sidecar_templates(folder / "mag.uff")[0]
    (folder / "s.yaml").write_text("file: mag.uff\nsegments:\n  - {kind: frf}\n")
    with pytest.raises(BenchError, match="of real numbers: magnitudes"):
        read_import(folder / "s.yaml")
    (folder / "s.yaml").write_text("file: mag.uff\nsegments:\n  - {kind: frf, ordinate: magnitude}\n")
    table = read_import(folder / "s.yaml").tables[0]
    assert not table.phase_known
    assert table.columns["frequency_hz"][np.argmax(abs(table.responses))] == pytest.approx(33.0, abs=0.06)
    for name, file, peak in (("uff_spectra", "all.uff", 25.0), ("sweep_pk_rms", "sweep.csv", 54.18)):
        source = made(name) / file
        (sidecar := source.with_name("own.yaml")).write_text(sidecar_templates(source)[0])
        (table,) = read_import(sidecar).tables
        assert abs(table.responses).max() == pytest.approx(peak, rel=2e-3)
    stiff = made("frf_stiffness") / "dyn.csv"
    (sidecar := stiff.with_name("own.yaml")).write_text(sidecar_templates(stiff)[0])
    run = read_import(sidecar)
    assert noted(run, "the reciprocal was taken")
    natural = 2 * np.pi * 42.0
    assert abs(run.tables[0].responses).max() == pytest.approx(1 / (1.6 * 0.014 * natural**2), rel=1e-3)


def test_what_is_held_or_filtered_is_named(made: Callable[[str], Path]) -> None:
    source = made("hold_resampled") / "export.csv"
    (sidecar := source.with_name("own.yaml")).write_text(sidecar_templates(source)[0])
    assert noted(read_import(sidecar), r"Laser \(mm\) keeps each value for 10 samples.*late by 4\.5 samples")
    run = read_import(made("servo_velocity_filter") / "s.yaml")
    assert noted(run, "v1 is late against the rate of change")
    assert noted(run, "v1 falls to .* a filter")


def test_axes_of_one_sensor_are_told(made: Callable[[str], Path]) -> None:
    assert "x, y and z of one sensor are one point" in sidecar_templates(made("imu_triax") / "imu")[0]
