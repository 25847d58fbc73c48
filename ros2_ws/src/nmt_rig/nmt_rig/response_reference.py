"""Response curves of a rig's model at held forces: harmonic balance with continuation, folds, Floquet multipliers.

The structure without its exciter is driven by a pure force at the drive point. That is what a test with controlled
harmonics of the force measures, whatever exciter makes the force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_rig.model.assembly import assemble
from nmt_rig.model.continuation import solve_fold
from nmt_rig.model.floquet import floquet_multipliers
from nmt_rig.model.forced_response import ForcedProblem, FrequencyResponse, PeriodicResponse, frequency_response
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_elements, build_resting_elements, build_structure, refuse_beyond_harmonic_balance

CURVE_COLUMNS = ("force_n", "frequency_hz", "response_m", "lag_rad", "stable", "largest_multiplier")
"""Columns of ``response_curve.csv`` of a reference; ``largest_multiplier`` is nan where there are none."""
FOLD_COLUMNS = ("force_n", "frequency_hz", "response_m", "lag_rad")
_LOWEST, _HIGHEST = 0.5, 1.5  # range of frequencies over the linear one, unless the loop's guard band is wider
_POINTS = 400


@dataclass(frozen=True, eq=False)
class ReferenceResponse:
    """Periodic responses at one force along the curve; arrays are ``(points,)``.

    Attributes:
        force: N.
        frequency_hz: Hz.
        response: |x| at the drive point, m.
        lag: of the displacement behind the force, rad.
        stable: whether the orbit is stable with this force.
        largest_multiplier: largest magnitude of a Floquet multiplier; NaN with friction.
        folds: (folds, 3) frequency (Hz), response (m), lag (rad).
        multipliers: of each point, largest first; empty with friction.
        curve: what it was followed on.
    """

    force: float
    frequency_hz: FloatArray
    response: FloatArray
    lag: FloatArray
    stable: NDArray[np.bool_]
    largest_multiplier: FloatArray
    folds: FloatArray
    multipliers: tuple[ComplexArray, ...]
    curve: FrequencyResponse


def response_problem(rig: Rig, harmonics: int) -> tuple[ForcedProblem, float]:
    """Harmonic balance of the structure under a pure force at the drive point, and ω₁ (rad/s) of the mode under test.

    Raises:
        BenchError: a rig that harmonic balance does not cover, several exciters, or a shaking table.
    """
    if len(rig.all_exciters) > 1 or rig.exciter.kind == "shaking_table":
        raise BenchError(
            f"The response curves of rig {rig.name} need one force at one point; choose an exciter by its point with "
            "--set, or a rig without shaking table."
        )
    refuse_beyond_harmonic_balance(rig, with_exciter=False)
    structure = build_structure(rig)
    modes = sticking_modes(structure, build_resting_elements(rig, structure), rig.test.mode)
    omega = float(modes.frequencies[rig.test.mode - 1])
    system = assemble(structure, build_elements(rig, structure), rig.drive_point)
    return ForcedProblem(system, FourierBasis.up_to(harmonics), omega), omega


def reference_responses(
    rig: Rig,
    forces: Sequence[float],
    harmonics: int = 9,
    band_hz: tuple[float, float] | None = None,
    points: int = _POINTS,
) -> tuple[ReferenceResponse, ...]:
    """Response curves of a rig's model.

    Args:
        rig: rig; ``rig.test.mode`` says where.
        forces: amplitudes of the force, N.
        harmonics: highest harmonic order.
        band_hz: lowest and highest frequency, Hz; None = about the mode, as wide as the guard band of the loop.
        points: about so many a curve.

    Raises:
        BenchError: a rig that is not covered, a wrong force or band, or no solution.
    """
    problem, omega = response_problem(rig, harmonics)
    low = min(float(rig.pll.get("guard_low", _LOWEST)), _LOWEST) * omega
    high = max(float(rig.pll.get("guard_high", _HIGHEST)), _HIGHEST) * omega
    if band_hz is not None:
        low, high = (2.0 * math.pi * frequency for frequency in band_hz)
    return tuple(_response(problem, force, low, high, points) for force in forces)


def _response(problem: ForcedProblem, force: float, low: float, high: float, points: int) -> ReferenceResponse:
    curve = frequency_response(problem, force, low, high, points=points)
    folds = []
    slope = np.sign(curve.branch.tangents[:, -1])
    for k in np.flatnonzero(slope[1:] != slope[:-1]):
        found = curve.system.response(solve_fold(curve.system, curve.branch, int(k)))
        motion = _drive_point(problem, found)
        folds.append((found.angular_frequency / (2.0 * math.pi), abs(motion), _lag(motion)))
    motions = np.array([_drive_point(problem, item) for item in curve.responses])
    multipliers: tuple[ComplexArray, ...] = ()
    if not any(element.sliders for element in problem.system.elements):
        multipliers = tuple(floquet_multipliers(problem.system, item) for item in curve.responses)
    largest = np.array([abs(item[0]) for item in multipliers]) if multipliers else np.full(motions.size, math.nan)
    stable = largest < 1.0 if multipliers else slope > 0.0
    return ReferenceResponse(
        force,
        curve.omega_rad_s / (2.0 * math.pi),
        np.abs(motions),
        np.array([_lag(motion) for motion in motions]),
        stable,
        largest,
        np.array(folds).reshape(-1, 3),
        multipliers,
        curve,
    )


def _drive_point(problem: ForcedProblem, response: PeriodicResponse) -> complex:
    position = int(np.flatnonzero(response.orders == 1)[0])
    system = problem.system
    return complex(system.motion(system.drive_point, response.unknowns[position][:, np.newaxis])[0])


def _lag(motion: complex) -> float:
    """Phase by which a motion lags the force, which has the phase zero, rad in [0, 2π)."""
    return float(-np.angle(motion)) % (2.0 * math.pi)


def write_reference_responses(responses: Sequence[ReferenceResponse], folder: Path) -> None:
    """Write ``response_curve.csv`` and ``response_folds.csv``; SI units.

    Raises:
        BenchError: a file cannot be written; an older file is then left as it was.
    """
    rows: list[Sequence[str]] = [CURVE_COLUMNS]
    folds: list[Sequence[str]] = [FOLD_COLUMNS]
    for item in responses:
        columns = (item.frequency_hz, item.response, item.lag, item.stable, item.largest_multiplier)
        rows += [[repr(item.force), *(repr(float(v)) for v in row)] for row in zip(*columns, strict=True)]
        folds += [[repr(item.force), *(repr(float(v)) for v in row)] for row in item.folds]
    write_result(folder / "response_curve.csv", csv_text(rows))
    write_result(folder / "response_folds.csv", csv_text(folds))
