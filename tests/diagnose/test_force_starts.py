"""Strengths from the forces that sweeps need, on a one-mode structure whose force is known in closed form."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from nmt_diagnose.inference.force_starts import ForceColumn, even_column, force_starts, lines_of_known_amplitude
from nmt_diagnose.observations.conditions import SteppedSineTest
from nmt_diagnose.observations.observables import Observations, Part

MASS, STIFFNESS, DAMPING = 0.4, 16_000.0, 0.8  # kg, N/m, N s/m: 31.8 Hz
OMEGA = np.tile(2.0 * np.pi * np.linspace(20.0, 60.0, 41), 2)  # rad/s, of two sweeps
AMPLITUDE = np.repeat([1e-4, 3e-3], 41)  # m, held
CUBIC = 6.0e9  # N/m³: at the higher level 2.5 times the linear stiffness


def force(stiffness: float = STIFFNESS, cubic: float = 0.0, quadratic: float = 0.0) -> np.ndarray:
    """Fundamental of the force that the motion needs, N; ¾ k₃ a³ and 8/(3 π) c₂ ω² a² by harmonic balance."""
    linear = (stiffness - MASS * OMEGA**2 + 1j * OMEGA * DAMPING) * AMPLITUDE
    bent = 0.75 * cubic * AMPLITUDE**3
    return np.asarray(linear + bent + 1j * 8.0 / (3.0 * np.pi) * quadratic * (OMEGA * AMPLITUDE) ** 2)


def stacked(values: np.ndarray) -> np.ndarray:
    """Observables of complex ln R/F: magnitudes, then phases."""
    return np.concatenate([values.real, values.imag])


LINES = np.array([(k, OMEGA.size + k) for k in range(OMEGA.size)])


def column(change: np.ndarray, spread: float, signed: bool = True) -> ForceColumn:
    """Of the change of the force per unit: ln R/F falls by its relative change."""
    return ForceColumn(stacked(-change / force()), spread, signed)


def columns(signed: bool = True) -> list[ForceColumn]:
    one = force(cubic=1.0) - force()
    other = force(quadratic=1.0) - force()
    return [column(other, 1e3), column(one, 1e9, signed), column(np.zeros(OMEGA.size), 1.0)]


def own_slope() -> np.ndarray:
    """Of the model's stiffness, in prior standard deviations of 3 %."""
    return np.asarray(stacked(-0.03 * STIFFNESS * AMPLITUDE / force())[:, None])


def difference(true: np.ndarray) -> np.ndarray:
    """Measured minus predicted; the phase as it is compared, within half a turn."""
    ratio = np.log(force() / true)
    return stacked(ratio)


def test_a_strength_many_times_the_model_is_found_at_once() -> None:
    found = force_starts(LINES, difference(force(cubic=CUBIC)), own_slope(), columns(), 3)
    assert found[0].number == 1
    # Priors of 3 % and 10⁹ hold both back a little.
    assert found[0].strength == pytest.approx(CUBIC, rel=5e-3)
    assert found[0].own[0] == pytest.approx(0.0, abs=0.1)


def test_the_models_own_parameters_are_found_with_it() -> None:
    true = force(stiffness=1.06 * STIFFNESS, cubic=CUBIC)
    found = force_starts(LINES, difference(true), own_slope(), columns(), 3)
    assert found[0].number == 1
    assert found[0].strength == pytest.approx(CUBIC, rel=0.01)
    assert found[0].own[0] == pytest.approx(2.0, abs=0.15)


def test_of_an_even_force_the_square_is_found() -> None:
    """k₂ x² beside k x: the fundamental lacks 5/6 k₂² a²/k at first order (Nayfeh, Mook 1979, equation 2.3.29)."""
    softened = force(stiffness=STIFFNESS)

    def even(strength: float) -> np.ndarray:
        return np.asarray(softened - 5.0 / 6.0 * strength**2 / STIFFNESS * AMPLITUDE**3)

    probe, true = 2e4, 6e5
    column = even_column(LINES, difference(even(probe)), probe, 1e6)
    found = force_starts(LINES, difference(even(true)), own_slope(), [column], 3)
    assert found[0].strength == pytest.approx(true, rel=5e-3)
    harder = difference(2.0 * softened - even(true))
    assert force_starts(LINES, harder, own_slope(), [column], 3) == [], "an even force only softens"


def test_a_strength_of_the_wrong_sign_is_no_start() -> None:
    softening = difference(force(cubic=-0.2 * CUBIC))
    assert 1 in [start.number for start in force_starts(LINES, softening, own_slope(), columns(), 3)]
    assert 1 not in [start.number for start in force_starts(LINES, softening, own_slope(), columns(signed=False), 3)]


def test_a_model_that_needs_nothing_gets_no_start() -> None:
    assert force_starts(LINES, difference(force(stiffness=1.03 * STIFFNESS)), own_slope(), columns(), 3) == []


def test_lines_that_could_not_be_compared_are_left_out() -> None:
    away = difference(force(cubic=CUBIC))
    away[LINES[5, 0]] = np.nan
    found = force_starts(LINES, away, own_slope(), columns(), 3)
    assert found[0].strength == pytest.approx(CUBIC, rel=5e-3)
    assert force_starts(LINES[:0], away, own_slope(), columns(), 3) == []
    nowhere = np.full_like(away, np.nan)
    assert force_starts(LINES, nowhere, own_slope(), columns(), 3) == []


def test_lines_are_those_of_sweeps_whose_motion_is_known() -> None:
    known, unknown = object.__new__(SteppedSineTest), object.__new__(SteppedSineTest)
    for test, reference, held in ((known, "force", "response"), (unknown, "force", "voltage")):
        for name, value in (("reference", reference), ("held", held), ("levels", np.ones(2))):
            object.__setattr__(test, name, value)
    # Each test: two lines of two channels; the second line of the known one has lost its phase.
    part, test, level, channel = [], [], [], []
    for number in range(2):
        for line in range(2):
            for k in range(2):
                for which in (Part.LOG_MAGNITUDE, Part.PHASE):
                    if (number, line, which) != (0, 1, Part.PHASE):
                        part.append(which), test.append(number), level.append(line), channel.append(k)
    rows = SimpleNamespace(
        test=np.array(test), level=np.array(level), channel=np.array(channel), part=np.array(part, dtype=object)
    )
    observations = cast(Observations, cast(Any, SimpleNamespace(tests=(known, unknown), rows=rows)))
    np.testing.assert_array_equal(lines_of_known_amplitude(observations), [[0, 1]])
