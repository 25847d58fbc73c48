"""The linear modal test on records of simulated rigs: against the models' exact modes, and what it refuses."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tiers import with_quick

from nmt_bench import import_data
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_extract.linear.evaluation import evaluate_linear_test
from nmt_extract.linear.file import Linearity, description, frf_table, linear_mapping, linearity
from nmt_extract.linear.identification import linear_test, target_of
from nmt_extract.linear.results import LinearTest, LinearTestSettings
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Signals
from nmt_report.linear_report import exact_modes, linear_page
from nmt_report.quantity_format import uncertain
from nmt_rig.linear_description import force_per_volt, linear_description
from nmt_rig.rig import Rig, load_rig

BAND = (10.0, 2000.0)


def record(rig: Rig, rms: float, seconds: float, settle: float = 2.0) -> Signals:
    """Random record of a simulated rig."""
    device = SimulatedRig(rig)
    device.configure()
    device.start()
    command = DriveCommand(Waveform.RANDOM, amplitude=rms, ramp=0.5, band_low_hz=BAND[0], band_high_hz=BAND[1])
    parts: dict[str, list[np.ndarray]] = {}
    flags = 0
    for _ in range(round((settle + seconds) * rig.sample_rate_hz / rig.block_samples)):
        device.write(command)
        for block in device.read():
            flags |= block.flags
            for name, row in zip(block.channels, block.data, strict=True):
                parts.setdefault(name, []).append(row)
    skip = round(settle * rig.sample_rate_hz)
    channels = {name: np.concatenate(rows)[skip:] for name, rows in parts.items()}
    sensors = {rig.sensor_channel(sensor): sensor for sensor in rig.sensors}
    return Signals(
        rig.sample_rate_hz,
        skip,
        channels,
        {name: Quantity[sensor.quantity.upper()].unit for name, sensor in sensors.items()},
        {name: rig.sensor_point(sensor) for name, sensor in sensors.items()},
        {name: Quantity[sensor.quantity.upper()] for name, sensor in sensors.items()},
        None,
        (),
        flags,
    )


def settings(rig: Rig) -> LinearTestSettings:
    return LinearTestSettings(
        rig.exciter_points,
        Quantity[rig.extraction.quantity.upper()],
        BAND,
        rig.extraction.linear_modes,
        rig_mode=rig.test.mode,
    )


@pytest.fixture(scope="module")
def resonator() -> tuple[Rig, Signals, LinearTest]:
    rig = load_rig("joint_resonator")
    signals = record(rig, 0.25, 25.0)
    return rig, signals, linear_test(signals, settings(rig))


@pytest.fixture(scope="module")
def beam() -> tuple[Rig, Signals, LinearTest]:
    rig = load_rig("beam")
    signals = record(rig, 0.05, 20.0)
    return rig, signals, linear_test(signals, settings(rig))


@pytest.fixture(params=["resonator", pytest.param("beam", marks=pytest.mark.campaign)])
def tested(request: pytest.FixtureRequest) -> tuple[Rig, Signals, LinearTest]:
    return request.getfixturevalue(request.param)  # type: ignore[no-any-return]


def test_modes_are_the_exact_sticking_modes(tested):
    rig, _, test = tested
    exact = linear_description(rig)
    frequencies = np.array(exact.frequencies_rad_s)
    in_band = frequencies > 2 * np.pi * BAND[0]
    assert len(test.modes) == np.count_nonzero(in_band)
    for mode, index in zip(test.modes, np.flatnonzero(in_band), strict=True):
        shape = exact.shape_matrix[:, index]
        assert mode.omega == pytest.approx(frequencies[index], rel=5e-4)
        assert mode.damping_ratio == pytest.approx(exact.damping_ratios[index], rel=0.03)
        correlation = (mode.shape @ shape) ** 2 / ((mode.shape @ mode.shape) * (shape @ shape))
        assert correlation >= 0.9999
        assert abs(mode.shape @ shape) / (shape @ shape) == pytest.approx(1.0, abs=0.01)
    target = test.target_mode
    assert target.omega == pytest.approx(frequencies[exact.target_mode], rel=5e-4)


def test_plant_with_exciter(tested):
    rig, _, test = tested
    exact = linear_description(rig)
    assert test.plant is not None
    measured = description(test)
    assert measured.plant_frequency_rad_s == pytest.approx(exact.plant_frequency_rad_s, rel=1e-4)
    assert measured.plant_damping_ratio == pytest.approx(exact.plant_damping_ratio, rel=2e-3)
    assert measured.force_per_volt == pytest.approx(exact.force_per_volt, rel=0.01)
    assert measured.displacement_per_volt == pytest.approx(exact.displacement_per_volt, rel=0.01)
    assert measured.moving_mass_kg == pytest.approx(exact.moving_mass_kg, rel=0.06)
    assert measured.source == "test"


@pytest.mark.campaign
def test_narrow_mode_of_the_averages_is_wider_than_that_of_the_fit(beam):
    _, _, test = beam
    target = test.target_mode
    # The reason for the fit without window: 10 segments of 2 s cannot resolve 0.22 Hz.
    assert target.averaged.damping_ratio > 1.2 * target.damping_ratio


def test_residuals_complete_the_receptance(resonator):
    rig, _, test = resonator
    mass = sum(rig.structure.masses_kg)
    assert test.suspension_below_band
    # All three masses move with the suspension mode: 1/m at every point.
    assert test.residuals.lower.real == pytest.approx([1 / mass] * 3, rel=0.02)
    exact = linear_description(rig)
    omega = 2 * np.pi * np.array([350.0, 390.0])
    phi, w, z = exact.shape_matrix, np.array(exact.frequencies_rad_s), np.array(exact.damping_ratios)
    drive = phi[exact.points.index(rig.drive_point)]
    others = [index for index in range(len(w)) if index != exact.target_mode]
    rest = sum(np.outer(phi[:, r] * drive[r], 1 / (w[r] ** 2 - omega**2 + 2j * z[r] * w[r] * omega)) for r in others)
    found = test.target_residuals.receptance(np.array([350.0, 390.0]))
    np.testing.assert_allclose(found, rest, atol=0.02 * np.max(np.abs(rest)))


@pytest.mark.campaign
def test_a_rig_held_firmly_has_no_suspension_mode(beam):
    assert not beam[2].suspension_below_band


@pytest.mark.campaign
def test_scatter_over_seeds_is_the_stated_uncertainty():
    errors = []
    exact = linear_description(load_rig("joint_resonator"))
    for seed in range(4):
        rig = load_rig("joint_resonator", [f"seed={100 + seed}"])
        test = linear_test(record(rig, 0.1, 8.0), settings(rig))
        mode = test.target_mode
        shape = exact.shape_matrix[:, exact.target_mode]
        shape = shape * np.sign(shape @ mode.shape)
        errors.append(
            [
                (mode.damping_ratio - exact.damping_ratios[exact.target_mode]) / mode.damping_std,
                *((mode.shape - shape) / mode.shape_std),
            ]
        )
    # Half of it is statistics of four draws.
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(spread > 0.2)
    assert np.all(spread < 2.5)


@pytest.mark.campaign
def test_an_ideal_force_as_exciter(tmp_path):
    rig = load_rig("beam")
    text = rig.model_dump(mode="json", exclude_none=True)
    text["exciter"] = {"kind": "force", "point": 2, "newton_per_volt": 2.0}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(text), encoding="utf-8")
    rig = load_rig(path)
    test = linear_test(record(rig, 0.05, 15.0), settings(rig))
    exact = linear_description(rig)
    assert test.target_mode.damping_ratio == pytest.approx(exact.damping_ratios[0], rel=0.01)
    assert test.target_mode.drive_shape == pytest.approx(exact.drive_point_shape, rel=0.01)
    assert test.plant is not None
    assert test.plant.frequency_hz == pytest.approx(exact.frequency_hz, rel=1e-3)
    assert test.plant.force_per_volt == pytest.approx(2.0, rel=1e-3)
    assert test.plant.moving_mass_kg < 0.005


@pytest.mark.parametrize("seed", with_quick([1, 2, 3], 1))
@pytest.mark.parametrize(
    ("name", "rms"), [("joint_resonator", 0.25), ("strong_cubic", 0.02), ("internal_resonance", 0.05)]
)
def test_a_rig_without_faults_has_no_finding(name: str, rms: float, seed: int) -> None:
    rig = load_rig(name).model_copy(update={"seed": seed})
    test = linear_test(record(rig, rms, 10.0), settings(rig))
    assert not [remark for remark in test.remarks if remark.startswith("Channel")]


def test_without_voltage_the_force_is_the_input(resonator):
    rig, signals, _ = resonator
    bare = replace(
        signals,
        channels={name: values for name, values in signals.channels.items() if name != "u"},
        quantities={name: quantity for name, quantity in signals.quantities.items() if name != "u"},
    )
    test = linear_test(bare, settings(rig))
    assert (test.reference, test.plant) == ("force", None)
    exact = linear_description(rig)
    assert test.target_mode.omega == pytest.approx(exact.frequencies_rad_s[1], rel=1e-4)
    assert description(test).plant_frequency_rad_s == test.target_mode.omega


def test_target_by_number_and_by_frequency(resonator):
    rig, _, test = resonator
    modes, plain = list(test.modes), settings(rig)
    # The rig counts its suspension mode, the band does not hold it.
    assert rig.test.mode == 2
    assert target_of(modes, plain, True) is modes[0]
    assert target_of(modes, plain, False) is modes[1]
    assert target_of(modes, replace(plain, mode=2), True) is modes[1]
    assert target_of(modes, replace(plain, near_hz=1000.0), True) is modes[1]
    with pytest.raises(BenchError, match="--near"):
        target_of(modes, replace(plain, mode=7), True)
    with pytest.raises(BenchError, match="10 % of 600 Hz"):
        target_of(modes, replace(plain, near_hz=600.0), True)


def test_one_mode_kept_is_the_target(resonator):
    rig, signals, _ = resonator
    test = linear_test(signals, replace(settings(rig), modes=1, mode=2))
    assert [round(mode.frequency_hz) for mode in test.modes] == [1030]
    assert [round(mode.frequency_hz) for mode in test.further_modes] == [370]


def _changed(signals: Signals, **channels: np.ndarray) -> Signals:
    return replace(signals, channels={**signals.channels, **channels})


def _cut(signals: Signals, samples: int) -> Signals:
    return replace(signals, channels={name: values[:samples] for name, values in signals.channels.items()})


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda s: replace(s, flags=int(BlockFlag.OVERLOAD)), "overload"),
        (lambda s: replace(s, flags=int(BlockFlag.LIMIT)), "drive to zero"),
        (lambda s: replace(s, flags=int(BlockFlag.STOP)), "drive was stopped"),
        (lambda s: replace(s, gaps=(("force", 5, 7),)), "7 samples of force are missing"),
        (lambda s: _changed(s, a2=np.clip(s.channels["a2"], -1.0, 1.0)), "a2 is clipped"),
        (lambda s: _changed(s, a1=np.full_like(s.channels["a1"], 3.0)), "a1 shows no signal"),
        (lambda s: _changed(s, f1=np.where(np.arange(s.samples) == 9, np.nan, s.channels["f1"])), "not numbers"),
        (lambda s: _changed(s, f1=-s.channels["f1"]), "inverted"),
        (lambda s: _cut(s, 20_000), "record"),
        (
            lambda s: _changed(
                s, **{n: np.random.default_rng(k).standard_normal(s.samples) for k, n in enumerate(("a1", "a2", "a3"))}
            ),
            "No stable mode",
        ),
        (lambda s: replace(s, quantities={**s.quantities, "f1": Quantity.VOLTAGE}), "0 force channels"),
        (lambda s: replace(s, points={**s.points, "a1": 7}), "drive point 1"),
    ],
)
def test_records_that_cannot_be_evaluated_are_refused_in_words(resonator, spoil, sentence):
    rig, signals, _ = resonator
    short = _cut(signals, 6 * round(signals.sample_rate))
    with pytest.raises(BenchError, match=sentence):
        linear_test(spoil(short), settings(rig))


def test_the_level_at_which_the_joint_slips_is_noticed(resonator):
    rig, _, low = resonator
    high = linear_test(record(rig, 3.0, 25.0), settings(rig))
    check = linearity(high, low, 3.0, 0.25)
    assert not check.is_linear
    assert check.damping_change > 0.02
    assert "NOT linear" in check.sentence
    assert Linearity(2.0, 1.0, 1e-5, 1e-3, 1e-6, 1e-4).is_linear


def test_linear_json_reads_back_as_linear_description(tested):
    _, _, test = tested
    mapping = json.loads(json.dumps(linear_mapping(test, None, 0.25), allow_nan=False))
    assert LinearDescription.from_mapping(mapping) == description(test)
    points, modes = len(test.points), len(test.modes)
    assert np.shape(mapping["uncertainties"]["shapes"]) == (points, modes)
    for key in ("residuals", "target_residuals"):
        assert np.shape(mapping[key]["lower"]) == (points, 2)
        assert np.shape(mapping[key]["upper"]) == (points, 2)
    assert np.shape(mapping["mass_estimate"]) == (points, points)
    with pytest.raises(BenchError):
        LinearDescription.from_mapping({**mapping, "surprise": 1})


def test_frf_table_holds_what_was_estimated(resonator):
    _, _, test = resonator
    lines = frf_table(test).splitlines()
    head = lines[0].split(",")
    values = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    column = {name: values[:, index] for index, name in enumerate(head)}
    row = test.force_frfs[0].outputs.index("a2")
    for label in ("h1", "h2", "hv", "hc"):
        complex_column = column[f"a2_f1_{label}_real"] + 1j * column[f"a2_f1_{label}_imag"]
        np.testing.assert_allclose(complex_column, getattr(test.force_frfs[0], label)[row], rtol=1e-7)
    np.testing.assert_allclose(column["a2_f1_coherence"], test.force_frfs[0].coherence[row], rtol=1e-7)
    assert {"f1_u_h1_real", "a3_u_h1_imag", "f1_u_coherence"} <= set(head)


# -- from a recording -------------------------------------------------------------------------------------------------


def imported(signals: Signals, folder: Path, segments: list[dict[str, Any]]) -> Bag:
    """A bag with these signals, by way of an import of NPZ data."""
    names = list(signals.channels)
    np.savez(folder / "data.npz", **signals.channels)
    channels = [
        {
            "column": name,
            "quantity": signals.quantities[name].name.lower(),
            "unit": {"FORCE": "N", "DISPLACEMENT": "m", "ACCELERATION": "m/s^2", "VOLTAGE": "V"}[
                signals.quantities[name].name
            ],
            "point": signals.points[name],
            "name": name,
        }
        for name in names
    ]
    document = {"file": "data.npz", "sample_rate": signals.sample_rate, "channels": channels, "segments": segments}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(document))
    import_data(folder / "sidecar.yaml", folder / "bag")
    return Bag.open(folder / "bag")


@pytest.mark.campaign
def test_a_recording_gives_what_its_windows_give(resonator, tmp_path):
    rig, signals, _ = resonator
    seconds = [{"kind": "random", "start": 0.0, "stop": 10.0, "level": 0.1, "band_hz": [12.0, 1900.0]}]
    seconds.append({"kind": "random", "start": 10.0, "stop": 25.0, "level": 0.25, "band_hz": [12.0, 1900.0]})
    bag = imported(signals, tmp_path, seconds)
    asked = settings(rig)
    result = evaluate_linear_test(
        bag, band_hz=BAND, modes=asked.modes, rig_mode=asked.rig_mode, exciter_points=asked.exciter_points,
        quantity=asked.quantity,
    )  # fmt: skip
    rate = round(signals.sample_rate)
    lower = linear_test(_between(signals, 0, 10 * rate), asked)
    upper = linear_test(_between(signals, 10 * rate, 25 * rate), asked)
    for mode, expected in zip(result.test.modes, upper.modes, strict=True):
        assert mode.frequency_hz == expected.frequency_hz
        assert mode.damping_ratio == expected.damping_ratio
        np.testing.assert_array_equal(mode.shape, expected.shape)
    assert result.level == 0.25
    assert result.check == linearity(upper, lower, 0.25, 0.1)
    assert result.remarks == upper.remarks
    assert result.to_mapping()["quality"]["remarks"] == list(upper.remarks)
    # What is not said comes from the recording: response quantity, drive point and band of the excitation.
    own = evaluate_linear_test(bag, modes=asked.modes, rig_mode=asked.rig_mode)
    assert own.test.settings.quantity is Quantity.ACCELERATION
    assert own.test.settings.drive_point == rig.drive_point
    assert own.test.settings.band_hz == (12.0, 1900.0)
    page = linear_page(result, rig, exact_modes(rig))
    text = unescape(re.sub(r"<[^>]+>", " ", re.sub(r"<(style|script|svg)\b.*?</\1>", "", page, flags=re.S)))
    assert f"{len(upper.modes)} modes identified and mass-normalised" in text
    assert uncertain(upper.modes[0].frequency_hz, upper.modes[0].frequency_std) in text
    assert result.check.sentence in text
    for heading in ("Against the model", "Mass-normalised shape at", "Plant: structure and exciter", "Estimated mass"):
        assert heading in text


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({"modes": 0}, "number of modes to keep must be at least 1, got 0"),
        ({"near_hz": -1.0}, "frequency near the target must be positive"),
        ({"segment_s": math.inf}, "length of a segment must be positive"),
        ({"band_hz": (20.0, 10.0)}, "two rising frequencies"),
        ({}, "no whole window of random excitation"),
    ],
)
def test_what_cannot_be_evaluated_is_refused(asked, sentence, resonator, tmp_path):
    _, signals, _ = resonator
    short = _between(signals, 0, 4 * round(signals.sample_rate))
    bag = imported(short, tmp_path, [{"kind": "sweep", "start": 0.0, "stop": 4.0, "level": 1.0}])
    with pytest.raises(BenchError, match=sentence):
        evaluate_linear_test(bag, **asked)


def _between(signals: Signals, first: int, last: int) -> Signals:
    return replace(signals, channels={name: row[first:last] for name, row in signals.channels.items()})


def test_force_per_volt_over_frequency_is_that_of_the_model(tested):
    """What control of the force's harmonics begins with; the model's response is the independent figure."""
    rig, _, test = tested
    rows = np.array(description(test).force_per_volt_rows)
    assert rows.shape[0] > 100
    assert rows[0, 0] >= BAND[0]
    assert rows[-1, 0] <= BAND[1]
    assert (np.diff(rows[:, 0]) > 0).all()
    exact = force_per_volt(rig, rows[:, 0].tolist())
    size = np.abs(exact)
    known = size > 0.1 * np.median(size)  # narrow dips are filled by the leakage of the segments
    error = np.abs(rows[known, 1] + 1j * rows[known, 2] - exact[known]) / size[known]
    # Control has a gain margin of 4.5 and a phase margin of 70 degrees: a quarter is plenty.
    assert np.median(error) < 0.05
    assert np.quantile(error, 0.9) < 0.25
    again = LinearDescription.from_json(description(test).to_json())
    assert again.force_per_volt_rows == description(test).force_per_volt_rows
    without = replace(again, force_per_volt_rows=())
    assert "force_per_volt_rows" not in without.to_json()
    for bad in ([[1.0, 2.0]], [[2.0, 1.0, 1.0], [1.0, 1.0, 1.0]], [[1.0, 1e300, 0.0]]):
        with pytest.raises(BenchError):
            LinearDescription.from_mapping({**json.loads(without.to_json()), "force_per_volt_rows": bad})
