"""Force surface from held responses, against the closed form of one mode with stiffness and damping over amplitude."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from nmt_core.errors import BenchError
from nmt_extract.curves.force_surface import ForceSurface, surface_sentences
from nmt_extract.curves.response_curve import ResponseCurve

OMEGA, UNIT, ZETA = 126.5, 1e-3, 0.01
AMPLITUDES = UNIT * np.linspace(0.2, 1.7, 11)


def stiffness(omega, response):
    """Z = ω₀² (1 + ¾ γ a²) − Ω² + i Ω c(a): the damping falls with the amplitude and rises again; 1 kg."""
    a = response / UNIT
    damping = 2.0 * ZETA * OMEGA * (1.0 - 1.2 * a**2 + 0.4 * a**4)
    return OMEGA**2 * (1.0 + 0.02 * a**2) - omega**2 + 1j * omega * damping


def force(frequency_hz, response):
    return response * np.abs(stiffness(2.0 * math.pi * frequency_hz, response))


def curve(response: float, noise: float = 0.0, seed: int = 0) -> ResponseCurve:
    """Frequencies about resonance at a held response."""
    omega = OMEGA * math.sqrt(1.0 + 0.02 * (response / UNIT) ** 2) * np.linspace(0.985, 1.015, 9)
    z = stiffness(omega, response) * (1.0 + noise * np.random.default_rng(seed).standard_normal(9))
    zero, held = np.zeros(9), np.full(9, response)
    return ResponseCurve(
        response, "m", np.angle(z), zero, omega / (2.0 * math.pi), zero, held, zero, response * np.abs(z), zero, ()
    )  # fmt: skip


CURVES = [curve(response) for response in AMPLITUDES]


def birth() -> tuple[float, float, float]:
    """Force, frequency and response of the minimum of the closed form."""
    found = minimize(lambda x: force(x[0] * 20.0, x[1] * UNIT), [1.02, 1.2], method="Nelder-Mead",
                     options={"xatol": 1e-9, "fatol": 1e-14})  # fmt: skip
    return float(found.fun), float(found.x[0] * 20.0), float(found.x[1] * UNIT)


def test_the_surface_is_the_closed_form_between_the_amplitudes():
    surface = ForceSurface.of(CURVES)
    for response in 0.5 * (AMPLITUDES[1:] + AMPLITUDES[:-1]):
        hertz = OMEGA / (2.0 * math.pi) * np.linspace(0.99, 1.01, 7)
        expected = force(hertz, np.full(7, response))
        assert surface.force(hertz, np.full(7, response)) == pytest.approx(expected, rel=2e-3)


def test_an_isola_is_foretold_by_the_force_at_its_birth():
    (isola,) = ForceSurface.of(CURVES).isolas()
    expected = birth()
    assert isola.birth_force == pytest.approx(expected[0], rel=5e-3)
    assert isola.frequency_hz == pytest.approx(expected[1], rel=1e-3)
    assert isola.response == pytest.approx(expected[2], rel=1e-2)
    assert "An isola is born at" in isola.sentence


def test_cuts_are_closed_only_between_birth_and_merging():
    surface, (born, _, _) = ForceSurface.of(CURVES), birth()
    assert not any(cut.closed for cut in surface.cut(0.9 * born))
    closed = [cut for cut in surface.cut(1.5 * born) if cut.closed]
    assert len(closed) == 1
    at = surface.force(closed[0].frequency_hz, closed[0].response)
    assert at == pytest.approx(1.5 * born, rel=1e-2)
    # From rest the damping is largest at 0.59 mm; beyond that force the branches are one.
    merging = force(np.array([20.2]), np.array([0.59e-3])).item()
    assert not any(cut.closed for cut in surface.cut(1.3 * merging))


def test_both_folds_of_an_isola_are_told_with_their_stability():
    surface, (born, _, _) = ForceSurface.of(CURVES), birth()
    (cut,) = (item for item in surface.cut(1.1 * born) if item.closed)
    grid = np.linspace(cut.frequency_hz.min() - 0.01, cut.frequency_hz.max() + 0.01, 4001)
    amplitudes = UNIT * np.linspace(1.0, 1.6, 601)
    least = np.array([force(grid, np.full(grid.size, a)) for a in amplitudes]).min(axis=0)  # over the amplitude
    reached = grid[least <= 1.1 * born]
    assert cut.folds[:, 0] == pytest.approx([reached[0], reached[-1]], abs=2e-3)
    middle = np.interp(cut.frequency_hz, cut.folds[:, 0], cut.folds[:, 1])  # of both orbits at a frequency
    clear = np.abs(cut.response - middle) > 0.1 * np.ptp(cut.response)
    assert np.array_equal(cut.stable[clear] == 1.0, cut.response[clear] > middle[clear])
    (sentence,) = surface_sentences(CURVES)
    assert "its folds lie at" in sentence
    assert "larger response are stable" in sentence


def test_the_uncertainty_is_that_of_noise():
    noisy = [curve(response, 0.01, seed) for seed, response in enumerate(AMPLITUDES)]
    surface, born = ForceSurface.of(noisy), birth()
    isola = min(surface.isolas(), key=lambda item: abs(item.response - born[2]))
    assert abs(isola.birth_force - born[0]) < 4.0 * isola.birth_force_std
    assert isola.birth_force_std < 0.1 * born[0]


def test_too_few_amplitudes_and_points_are_refused():
    with pytest.raises(BenchError, match="4 response amplitudes or more, got 3"):
        ForceSurface.of(CURVES[:3])
    short = ResponseCurve(
        *(value[:3] if isinstance(value, np.ndarray) else value for value in vars(CURVES[0]).values())
    )
    with pytest.raises(BenchError, match="has 3 points"):
        ForceSurface.of([short, *CURVES[1:]])
