"""The gain of a channel beside two close modes, on shapes in closed form, and a witness that shares no code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.threshold import thresholds_of
from nmt_extract.judgement.channel_gain import ShapeLevel, channel_gain
from nmt_extract.judgement.thresholds import THRESHOLDS

OMEGA = np.array([183.9, 188.7])
DAMPING = np.array([0.0027, 0.0029])
SHAPES = np.array([[1.571, 1.581], [0.0786, 0.0], [1.571, -1.581]])
SHIFTS = 0.0001 * 4.0 ** np.arange(6)
"""Of the frequency from that of mode 1, of the distance of the modes: 0.01 to 10 %."""


def linear(**changes: Any) -> LinearDescription:
    values: dict[str, Any] = {
        "source": "model", "drive_point": 1, "target_mode": 0, "points": (1, 2, 3), "frequencies_rad_s": tuple(OMEGA),
        "damping_ratios": tuple(DAMPING), "shapes": tuple(map(tuple, SHAPES)), "drive_point_shape": SHAPES[0, 0],
        "plant_frequency_rad_s": OMEGA[0], "plant_damping_ratio": DAMPING[0], "moving_mass_kg": 0.0,
        "exciter_points": (1, 3),
    }  # fmt: skip
    return LinearDescription(**(values | changes))


def levels(
    gains: Any = (1.0, 1.0, 1.0),
    *,
    shapes: Any = SHAPES,
    shifts: Any = SHIFTS,
    place: int = 0,
    forces: Any = (0.0, 0.0),
    noise: float = 1e-4,
) -> list[ShapeLevel]:
    """Shapes of a structure with a conservative force s at one point and forces F (N per m√kg) at points 1 and 3.

    (ω_k² − ω² + 2iδ_k ω_k ω) a_k = φ_k(F) − φ_k(d) s, with a_1 = 1 by what s is then.
    """
    random = np.random.default_rng(5)
    found = []
    for shift in shifts:
        omega = OMEGA[0] + shift * (OMEGA[1] - OMEGA[0])
        share = shapes[place, 1] / shapes[place, 0] * (OMEGA[0] ** 2 - omega**2) / (OMEGA[1] ** 2 - omega**2)
        dynamic = OMEGA[1] ** 2 - omega**2 + 2j * DAMPING[1] * OMEGA[1] * omega
        shape = shapes @ np.array([1.0, share + shapes[[0, 2], 1] @ np.array(forces) / dynamic])
        shape = shape * (1.0 + noise * random.standard_normal(3)) * np.array(gains)
        size = 1e-4 * np.exp(1j * random.uniform(0.0, 6.0))
        found.append(ShapeLevel(omega, size * shape, 1e-4 * noise * np.abs(shape), size * np.array(forces)))
    return found


def off_by(channel: int, gain: complex) -> Any:
    return np.where(np.arange(3) == channel, gain, 1.0)


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("gain", [0.9, 1.1])
@pytest.mark.parametrize("place", [0, 2])
def test_the_channel_whose_gain_is_off_is_found_with_its_gain(channel: int, gain: float, place: int) -> None:
    found = channel_gain(levels(off_by(channel, gain), place=place), linear())
    assert found is not None
    assert found.place == channel
    assert abs(found.ratio - gain) < 2.0 * found.std < 0.1 * gain


@pytest.mark.parametrize("place", [0, 2])
def test_a_shape_that_moves_by_a_near_mode_has_no_gain(place: int) -> None:
    assert channel_gain(levels(place=place), linear()) is None
    assert channel_gain(levels(place=place, forces=(0.9, 0.0)), linear()) is None


def witness(data: list[ShapeLevel], channel: int) -> tuple[float, float]:
    """Gain of a channel and misfit, by least squares with the law of one conservative force, of unknown place.

    y = D(g) (φ₁ + ρ x φ₂) a with x = (ω² − ω₁²)/(ω² − ω₂²): g and ρ are common to all levels.
    """
    ratios = np.array([(level.omega**2 - OMEGA[0] ** 2) / (level.omega**2 - OMEGA[1] ** 2) for level in data])

    def residuals(values: np.ndarray) -> np.ndarray:
        left = []
        for level, ratio in zip(data, ratios, strict=True):
            shape = off_by(channel, values[0]) * (SHAPES[:, 0] + values[1] * ratio * SHAPES[:, 1])
            factor = np.vdot(shape, level.shape) / np.vdot(shape, shape)
            left.append((level.shape - factor * shape) / level.std)
        stacked = np.concatenate(left)
        return np.concatenate([stacked.real, stacked.imag])

    fit = least_squares(residuals, [1.0, 0.0], x_scale=[0.1, 0.1])
    return float(fit.x[0]), float(2.0 * fit.cost)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_the_law_of_a_conservative_force_finds_the_same_channel_and_gain(channel: int) -> None:
    data = levels(off_by(channel, 1.1))
    by_law = [witness(data, each) for each in range(3)]
    assert int(np.argmin([misfit for _, misfit in by_law])) == channel
    found = channel_gain(data, linear())
    assert found is not None
    assert found.place == channel
    assert found.ratio == pytest.approx(by_law[channel][0], abs=found.std)


def test_two_points_and_shapes_of_the_same_channels_tell_nothing() -> None:
    data = [level._replace(shape=level.shape[[0, 2]], std=level.std[[0, 2]]) for level in levels(off_by(0, 1.1))]
    assert channel_gain(data, linear(points=(1, 3), shapes=tuple(map(tuple, SHAPES[[0, 2]])))) is None
    measured = off_by(0, 1.1)[:, np.newaxis] * SHAPES
    assert channel_gain(levels(off_by(0, 1.1)), linear(shapes=tuple(map(tuple, measured)), source="test")) is None


def test_a_gain_that_comes_in_the_middle_is_none_of_all_levels() -> None:
    assert channel_gain([*levels()[:3], *levels(off_by(0, 1.3))[3:]], linear()) is None


FIRST = SHIFTS[:1]
STIFF_BODY = {
    "shapes": ((1.571, 1.581), (0.8, 0.0), (1.571, -1.581)),
    "shape_stds": ((1e-4, 1e-4),) * 3,
    "source": "test",
}
Case = tuple[Any, dict[str, Any], dict[str, Any]]
CASES: dict[str, tuple[Case, float, Case, float]] = {
    "evidence": ((off_by(0, 1.1), {"shifts": FIRST}, {}), 2.0, (off_by(0, 1.08), {"shifts": FIRST}, {}), 0.5),
    "lead": (
        (off_by(0, 1.1), {"shifts": FIRST}, {}), 2.0,
        (off_by(0, 1.15), {"shifts": FIRST, "forces": (200.0, 0.0)}, {}), 0.5,
    ),
    "misfit": ((off_by(0, 1.13 * np.exp(0.05j)), {}, {}), 0.5, (off_by(0, 1.13 * np.exp(0.08j)), {}, {}), 2.0),
    "smallest": ((off_by(1, 1.07), {}, STIFF_BODY), 2.0, (off_by(1, 1.04), {}, STIFF_BODY), 0.5),
    "model_shape": ((off_by(0, 1.1), {"shifts": FIRST}, {}), 2.0, (off_by(0, 1.08), {"shifts": FIRST}, {}), 0.5),
    "shape_floor": ((off_by(1, 1.1), {}, {}), 2.0, (off_by(1, 1.06), {}, {}), 0.5),
    "mixing": (
        (off_by(0, 1.1), {"shifts": [0.002, 0.004]}, {}), 2.0,
        (off_by(0, 1.15), {"shifts": [0.005, 0.01]}, {}), 0.5,
    ),
    "mixed": ((off_by(0, 1.1), {"shifts": FIRST}, {}), 2.0, (off_by(0, 1.08), {"shifts": FIRST}, {}), 0.5),
    "driven": (
        (off_by(0, 1.1), {"shifts": FIRST, "forces": (50.0, 0.0)}, {}), 2.0,
        (off_by(0, 1.1), {"shifts": FIRST, "forces": (100.0, 0.0)}, {}), 0.5,
    ),
}  # fmt: skip
"""By threshold: a case in which a channel is named and the factor with which it is not, one the other way round."""


def is_named(case: Case) -> bool:
    gains, run, description = case
    described = linear(**description)
    return channel_gain(levels(gains, shapes=described.shape_matrix, **run), described) is not None


@pytest.mark.parametrize("name", CASES)
def test_a_threshold_decides(name: str) -> None:
    named, without, unnamed, within = CASES[name]
    value = getattr(THRESHOLDS.gain, name)
    assert is_named(named)
    assert not is_named(unnamed)
    try:
        object.__setattr__(THRESHOLDS.gain, name, without * value)
        assert not is_named(named)
        object.__setattr__(THRESHOLDS.gain, name, within * value)
        assert is_named(unnamed)
    finally:
        object.__setattr__(THRESHOLDS.gain, name, value)


def test_every_threshold_states_unit_and_reason_and_has_such_a_case() -> None:
    entries = {path.rpartition(".")[2]: entry for path, _, entry in thresholds_of(THRESHOLDS.gain)}
    assert entries.keys() == CASES.keys()
    for name, entry in entries.items():
        assert entry.metadata["unit"]
        assert len(entry.metadata["reason"].split()) >= 4
        assert entry.metadata["reason"].endswith(".")
        assert entry.metadata["test"].endswith(f"::test_a_threshold_decides[{name}]")
