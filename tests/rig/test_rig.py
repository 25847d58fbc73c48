"""Rig files: the beam's figures, and one sentence with file and line for whatever is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import find_rig, load_rig


@pytest.fixture(scope="module")
def text() -> str:
    return find_rig("beam").read_text(encoding="utf-8")


def line_of(text: str, needle: str) -> int:
    return text[: text.index(needle)].count("\n") + 1


def load_text(tmp_path: Path, text: str):
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


def test_beam_has_the_figures_of_the_paper(rig):
    assert rig.exciter.force_factor_n_a == 15.48
    assert rig.exciter.inductance_h == 140e-6
    assert rig.exciter.coil_stiffness_n_m == 8.42e7
    assert rig.structure.youngs_modulus_pa == 185e9
    assert rig.local_elements[0].tangential_stiffness_n_m == 8000
    assert [rig.sensor_channel(s) for s in rig.sensors] == ["f2", "x2", "x4", "x5", "x6", "a2", "u"]
    assert len(rig.assumptions) >= 5


def test_moving_the_exciter_takes_the_drive_point_sensors_along():
    rig = load_rig("beam", ["exciter.point=6"])
    assert [rig.sensor_channel(s) for s in rig.sensors] == ["f6", "x2", "x4", "x5", "x6", "a6", "u"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("resistance_ohm: 3.0", "resistance_ohm: -3", "exciter.resistance_ohm must be positive, got -3"),
        ("resistance_ohm: 3.0", "resistence_ohm: 3.0", "resist"),
        ("length_m: 0.7", "length_m: .nan", "structure.length_m must be a finite number"),
        ("length_m: 0.7", "length_m: 0.7 m", "must be a number in the unit that its name says, got '0.7 m'"),
        ("length_m: 0.7", "length_m: [0.7]", "structure.length_m must be a number"),
        ("length_m: 0.7", "length_mm: 700", "length_m"),
        ("slip_force_n: 1.0", "slip_force_n: 0", "local_elements.0.slip_force_n must be positive"),
        ("kind: jenkins", "kind: jenkin", "local_elements.0.kind must be one of"),
        ("density_kg_m3: 7830", "density_kg_m3: 7830\n  density_kg_m3: 7830", "given twice"),
        ("sample_rate_hz: 10000", "sample_rate_hz: true", "sample_rate_hz must be a number"),
        ("  elements: 7", "  elements: 7.5", "structure.elements must be a whole number"),
        ("point: 3 ", "point: 9 ", "the structure has points 1 to 7"),
        ("pll: {} ", "pll: {cutoff: .inf} ", "pll.cutoff must be a finite number"),
        ("  blocks: 50", "  blocks: -1", "watchdog.blocks must not be negative"),
        ("seed: 1", "seed: [1", "fix the YAML syntax"),
        ("seed: 1", "seed: 1\nsede: 2", "unknown key sede; did you mean seed?"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, old, new, says):
    assert old in text
    with pytest.raises(BenchError) as failure:
        load_text(tmp_path, text.replace(old, new, 1))
    sentence = str(failure.value)
    assert says in sentence
    assert sentence.startswith("rig.yaml line ")
    assert "\n" not in sentence
    if "YAML" not in sentence and "sede" not in sentence and "twice" not in sentence and "rename" not in new:
        named = int(sentence.split("line ")[1].split(":")[0])
        # A missing key is reported at its section, everything else on its own line.
        assert named == line_of(text, old) or "missing" in sentence or "unknown" in sentence


@pytest.mark.parametrize("content", ["", "- 1\n- 2\n", "just a word", "\x00\x01", "a: &a [*a]"])
def test_files_that_are_no_rigs(tmp_path, content):
    with pytest.raises(BenchError, match=r"rig\.yaml"):
        load_text(tmp_path, content)


def test_unknown_rig_names_the_known_ones():
    with pytest.raises(BenchError, match="beam"):
        load_rig("baem")


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("exciter.point", "write it as"),
        ("exciter.point=12", "points 1 to 7"),
        ("sensors.nine.gain=1", "none is called nine"),
        ("exciter.point.x=1", "no keys inside"),
        ("seed=[", "not valid YAML"),
        ("local_elements.joint.slip_force_n=-1", "must be positive"),
        ("sensors.1.point=4", "channel x4 exists already"),
        ("limits.slew_v_s=0", "limits.slew_v_s must be positive"),
        ("limits.warning_share=1.5", "limits.warning_share must be at most 1"),
        ("limits.drive_maximum_v=51", "drive_maximum_v must not be larger than voltage_v"),
        ('limits.channels=[{"channel": "a9", "abort_peak": 1}]', "limits.channels.0.channel is a9, but .* are f2, x2,"),
        ('limits.channels=[{"channel": "a2"}]', "limits.channels.0 has no level"),
        (
            'limits.channels=[{"channel": "a2", "abort_rms": 1, "warning_rms": 2}]',
            "warning_rms must not be larger than abort_rms",
        ),
        ('limits.open_loop=[{"channel": "q", "least": 1, "drive_v": 1}]', "limits.open_loop.0.channel is q"),
        ('limits.open_loop=[{"channel": "f2", "least": 1, "drive": 1}]', "did you mean drive_v"),
        ("extraction.linear_modes=9", "number of displacement sensors"),
    ],
)
def test_overrides_are_validated_alike(override, says):
    with pytest.raises(BenchError, match=says):
        load_rig("beam", [override])


def test_overrides_reach_lists_by_name():
    rig = load_rig("beam", ["local_elements.joint.tangential_stiffness_n_m=2e4", "structure.elements=14"])
    assert rig.local_elements[0].tangential_stiffness_n_m == 20_000.0
    assert rig.structure.elements == 14


def test_a_chain_with_an_ideal_force(tmp_path):
    rig = load_text(
        tmp_path,
        "name: chain\nstructure: {kind: chain, masses_kg: [1, 2], springs_n_m: [1e4], "
        "ground_springs_n_m: [1e3, 0]}\nexciter: {kind: force, point: 1, newton_per_volt: 2.0}\n"
        "sensors:\n- {quantity: force, point: drive}\n- {quantity: displacement, point: 1}\n"
        "- {quantity: displacement, point: 2}\n",
    )
    description = linear_description(rig)
    assert description.force_per_volt == pytest.approx(2.0)
    assert description.plant_frequency_rad_s == pytest.approx(description.frequencies_rad_s[0])


def test_linear_description_of_the_beam(rig):
    description = linear_description(rig)
    assert description.points == (2, 4, 5, 6)
    assert description.frequencies_rad_s[0] == pytest.approx(139.42, abs=0.01)
    assert description.drive_point_shape == description.shapes[0][0]
    assert description.moving_mass_kg == pytest.approx(0.043)
    assert 0.25 < description.force_per_volt < 0.31
    assert math.isfinite(description.displacement_per_volt)
    assert LinearDescription.from_json(description.to_json()) == description
