"""Linear description: bit-exact travel through JSON, refusals."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription

finite = st.floats(0.0, 10.0)


@st.composite
def descriptions(draw) -> LinearDescription:
    points = tuple(draw(st.lists(st.integers(1, 99), min_size=1, max_size=4, unique=True)))
    modes = draw(st.integers(1, 3))

    def row() -> tuple[float, ...]:
        return tuple(draw(st.lists(finite, min_size=modes, max_size=modes)))

    return LinearDescription(
        source=draw(st.sampled_from(["model", "test"])),
        drive_point=draw(st.integers(1, 99)),
        target_mode=draw(st.integers(0, modes - 1)),
        points=points,
        frequencies_rad_s=row(),
        damping_ratios=row(),
        shapes=tuple(row() for _ in points),
        drive_point_shape=draw(finite),
        plant_frequency_rad_s=draw(finite),
        plant_damping_ratio=draw(finite),
        moving_mass_kg=draw(finite),
        force_per_volt=draw(finite | st.just(math.nan)),
        displacement_per_volt=draw(finite | st.just(math.nan)),
    )


def bits(value) -> object:
    """The value with every float as its bits; all NaN are one."""
    if isinstance(value, float):
        return "nan" if math.isnan(value) else struct.pack("<d", value)
    if isinstance(value, list | tuple):
        return tuple(bits(item) for item in value)
    return value


@given(descriptions())
def test_json_and_back_gives_the_same_bits(linear):
    text = linear.to_json()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    back = LinearDescription.from_json(text)
    for name, value in asdict(linear).items():
        assert bits(getattr(back, name)) == bits(value), name
    assert back.to_json() == text


@pytest.fixture
def linear() -> LinearDescription:
    return LinearDescription(
        "model", 2, 1, (2, 4), (100.0, 700.0), (0.01, 0.02), ((0.1, 0.2), (0.3, 0.4)), 0.2, 690.0, 0.05, 0.043
    )


def test_target_mode_and_shapes(linear):
    assert linear.frequency_hz == pytest.approx(700.0 / (2 * np.pi))
    np.testing.assert_array_equal(linear.shape_matrix, [[0.1, 0.2], [0.3, 0.4]])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"points": ()}, "at least one point"),
        ({"frequencies_rad_s": (), "damping_ratios": ()}, "at least one point and a damping ratio"),
        ({"damping_ratios": (0.01,)}, "a damping ratio for every mode"),
        ({"shapes": ((0.1, 0.2),)}, r"2 rows \(points\) of 2 modes"),
        ({"shapes": ((0.1,), (0.3,))}, r"2 rows \(points\) of 2 modes"),
        ({"target_mode": 2}, "target_mode must be below 2, got 2"),
        ({"target_mode": -1}, "target_mode must be below 2, got -1"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(linear, change, sentence):
    with pytest.raises(BenchError, match=sentence):
        replace(linear, **change)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "not valid JSON"),
        ("{", "not valid JSON"),
        ("[1, 2]", "must be a JSON object"),
        ("3", "must be a JSON object"),
        ("{}", "not complete or not well-formed: 'points'"),
    ],
)
def test_text_that_is_no_description_is_refused(text, sentence):
    with pytest.raises(BenchError, match=sentence):
        LinearDescription.from_json(text)


@pytest.mark.parametrize("name", ["source", "points", "shapes", "drive_point_shape", "moving_mass_kg"])
def test_a_missing_key_is_named(linear, name):
    values = json.loads(linear.to_json())
    del values[name]
    with pytest.raises(BenchError, match=name):
        LinearDescription.from_mapping(values)


@pytest.mark.parametrize(
    "change",
    [
        {"frequencies_rad_s": [[100.0, 700.0], [1.0, 2.0]]},
        {"frequencies_rad_s": ["100", "700"]},
        {"drive_point_shape": [0.1]},
        {"moving_mass_kg": [[0.1]]},
        {"surplus": 1},
        {"points": 3},
        {"shapes": [["a", "b"], [1, 2]]},
        {"shapes": None},
        {"target_mode": "0"},
    ],
)
def test_a_key_that_is_unknown_or_of_the_wrong_kind_is_refused(linear, change):
    with pytest.raises(BenchError, match="not complete or not well-formed"):
        LinearDescription.from_mapping({**json.loads(linear.to_json()), **change})


def test_per_volt_values_may_be_left_out(linear):
    values = json.loads(linear.to_json())
    del values["force_per_volt"], values["displacement_per_volt"]
    back = LinearDescription.from_mapping(values)
    assert math.isnan(back.force_per_volt)
    assert math.isnan(back.displacement_per_volt)


@pytest.mark.parametrize(
    "change",
    [
        {"damping_ratios": [1e308, 0.01]},
        {"frequencies_rad_s": [100.0, math.inf]},
        {"frequencies_rad_s": [-100.0, 700.0]},
        {"shapes": [[0.1, 0.2], [0.3, 1e99]]},
        {"plant_damping_ratio": 11.0},
        {"plant_damping_ratio": math.nan},
        {"moving_mass_kg": 1e9},
        {"force_per_volt": 1e308},
    ],
)
def test_magnitudes_of_no_structure_are_refused(linear, change):
    values = {**asdict(linear), **change}
    with pytest.raises(BenchError, match=f"{next(iter(change))} (has the value|must not be negative)"):
        LinearDescription.from_mapping(values)
