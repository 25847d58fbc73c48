"""Where a search begins when responses peak far from the model's resonances."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.blocks import Quantity
from nmt_diagnose.inference.resonance_starts import measured_resonances, natural_frequencies, resonance_starts
from nmt_diagnose.observations.conditions import MeasuredChannel, RandomTest
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.observations.row_table import Place, RowTable
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

HZ, RATIO = (50.0, 130.0), 0.004
LINES = np.linspace(20.0, 200.0, 721)


def chain(first_kg: float) -> Rig:
    """Two masses on two springs, fixed at one end; both of 1 kg as modelled."""
    stiffness = (2.0 * math.pi * 80.0) ** 2
    values = {
        "name": "chain",
        "structure": {
            "kind": "chain",
            "masses_kg": [first_kg, 1.0],
            "springs_n_m": [stiffness],
            "ground_springs_n_m": [stiffness, 0.0],
        },
        "exciter": {"kind": "force", "point": 1, "newton_per_volt": 1.0},
        "sensors": [{"quantity": "acceleration", "point": 1}, {"quantity": "force", "point": "drive"}],
        "extraction": {"quantity": "acceleration", "linear_modes": 1},
    }
    return validate_rig(RigDocument("test", values, {}))


def frequencies(first_kg: float) -> np.ndarray:
    """Closed form: λ² − λ (2/m + 1) + 1/m = 0 with λ = ω²/(k/1 kg)."""
    middle, product = (2.0 / first_kg + 1.0) / 2.0, 1.0 / first_kg
    spread = math.sqrt(middle**2 - product)
    return 80.0 * np.sqrt(np.array([middle - spread, middle + spread]))


def observed(resonances: np.ndarray, channels: int = 2, hidden: int = 0) -> Observations:
    """Responses of a table that peak at some frequencies; the last ``hidden`` channels see the first peak only."""
    rows = RowTable()
    names = tuple(MeasuredChannel(f"a{k + 1}", Quantity.ACCELERATION, 1) for k in range(channels))
    for k in range(channels):
        seen = resonances[:1] if k >= channels - hidden else resonances
        size = np.abs(sum(1.0 / (f**2 - LINES**2 + 2j * RATIO * f * LINES) for f in seen))
        for line, hz in enumerate(LINES):
            rows.add(Part.LOG_MAGNITUDE, math.log(size[line]), 0.01, 0.0, Place(line, 0.0, float(hz), 0.0), k)
    test = RandomTest("table", 1, names, "force", LINES, 0.25, "none", 0.0, 0.0, 0.0)
    return rows.observations(test, [])


def test_peaks_of_most_channels_are_resonances() -> None:
    found = measured_resonances(observed(np.array(HZ), channels=3, hidden=1))
    np.testing.assert_allclose(found, HZ, atol=0.13)
    alone = measured_resonances(observed(np.array(HZ), channels=3, hidden=2))
    np.testing.assert_allclose(alone, HZ[:1], atol=0.13)


def test_the_model_has_its_closed_form() -> None:
    np.testing.assert_allclose(np.sort(natural_frequencies(chain(1.3), 1)), frequencies(1.3), rtol=1e-9)


@pytest.mark.parametrize("mass", [0.7, 1.6])
def test_a_strength_that_meets_the_peaks_is_found(mass: float) -> None:
    """A first mass that is 30 to 60 % off, beside a candidate that moves nothing and one that has no rig."""

    def changed(number: int, strength: float) -> Rig:
        return chain((1.0, 1.0 + 0.1 * strength, -1.0)[number])

    observations = observed(frequencies(mass))
    ((number, strength),) = resonance_starts(observations, chain(1.0), [(3.0, True)] * 3, changed, 4)
    assert number == 1
    assert 1.0 + 0.1 * strength == pytest.approx(mass, rel=0.1)


def test_where_the_peaks_are_near_nothing_is_sought() -> None:
    observations = observed(frequencies(1.005))
    assert resonance_starts(observations, chain(1.0), [(3.0, True)], lambda _, strength: chain(1.0 + strength), 4) == []
