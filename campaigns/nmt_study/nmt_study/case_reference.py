"""What a case is compared with: the EPMC backbone and the single-point reference of its rig.

Distance to the EPMC is the error of the method, distance to the single-point reference that of the test.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.reference import SinglePointReference, compute_reference, single_point_reference
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_model import build_elements, build_structure
from nmt_rig.slipping_reference import single_point_reference_from_above
from nmt_study.case import StudyCase

_ATTEMPTS = (1.0, 0.6, 1.7)


def case_rig(case: StudyCase) -> Rig:
    """The rig of a case, as tested."""
    return load_rig(case.rig, [*case.overrides, f"exciter.point={case.exciter}", f"seed={case.seed}"])


@lru_cache(maxsize=64)
def _drive_curve(rig_name: str, overrides: tuple[str, ...], exciter: int, harmonics: int) -> Any:
    rig = load_rig(rig_name, [*overrides, f"exciter.point={exciter}"])
    return single_point_reference(rig, None, np.geomspace(0.01, 45.0, 90), harmonics)


def levels_for_amplitudes(
    overrides: Sequence[str], exciter: int, amplitudes: Sequence[float] | FloatArray, rig: str = "beam"
) -> tuple[float, ...]:
    """Drive voltages at which the single-point test has the given modal amplitudes (m√kg).

    Cases that are to be compared shall span the same range of q, whatever the drive point.

    Raises:
        BenchError: an amplitude is not reached between 10 mV and 45 V.
    """
    curve = _drive_curve(rig, tuple(overrides), exciter, 7)
    q, volts = np.log(curve.mode.modal_amplitude), np.log(curve.level)
    wanted = np.log(np.asarray(amplitudes, dtype=np.float64))
    if wanted.min() < q[0] or wanted.max() > q[-1] or np.any(np.diff(q) <= 0.0):
        raise BenchError(
            f"The drive at point {exciter} does not reach modal amplitudes from {min(amplitudes):g} to "
            f"{max(amplitudes):g} m√kg between 10 mV and 45 V; choose others."
        )
    return tuple(float(f"{value:.5g}") for value in np.exp(np.interp(wanted, q, volts)))


def single_point_at(case: StudyCase) -> dict[str, Any]:
    """Single-point reference of a case: at its levels, and as a curve over them.

    Returns:
        ``failure`` (a sentence, empty if there is a reference), ``single_valued``, ``levels`` and ``curve``
        with one list for each of level, modal_amplitude, omega_rad_s, damping_ratio, force_n, pbmif,
        gamma_force, gamma_acceleration, participation_real, participation_imag.
    """
    if case.control != "voltage" or case.test != "phase_resonance":
        failure = "levels are no voltages at phase resonance"
        return {"failure": failure, "single_valued": False, "levels": {}, "curve": {}}
    if case.harmonics_control:
        failure = "the reference has a sine of voltage, the case controls the force's harmonics"
        return {"failure": failure, "single_valued": False, "levels": {}, "curve": {}}
    volts = np.unique(np.asarray(case.levels))
    points = 240 if case.strategy == "ramp" else 60
    grid = np.unique(np.concatenate((np.geomspace(volts[0] / 1.3, volts[-1] * 1.1, points), volts)))
    try:
        reference = _reached(case, grid)
    except (BenchError, ArithmeticError, ValueError) as error:
        return {"failure": _sentence(error), "single_valued": False, "levels": {}, "curve": {}}
    columns = {
        name: [float(value) for value in getattr(reference.mode, name)]
        for name in (
            "modal_amplitude",
            "omega_rad_s",
            "damping_ratio",
            "force_n",
            "pbmif",
            "gamma_force",
            "gamma_acceleration",
        )
    }
    turn = np.exp(-1j * np.angle(reference.mode.participation[:, :1]))
    participation = reference.mode.participation * turn
    columns["participation_real"] = participation.real.tolist()
    columns["participation_imag"] = participation.imag.tolist()
    columns["level"] = [float(value) for value in reference.level]
    place = {level: k for k, level in enumerate(columns["level"])}
    at_levels = {
        name: [values[place[v]] if v in place else None for v in case.levels] for name, values in columns.items()
    }
    return {
        "failure": "",
        "single_valued": reference.single_valued,
        "levels": at_levels,
        "curve": columns,
    }


def _reached(case: StudyCase, grid: FloatArray) -> SinglePointReference:
    """The reference from rest; from above for a test that begins at its highest level and cannot be had from rest."""
    rig = case_rig(case)
    downwards = len(case.levels) > 1 and case.levels[0] == max(case.levels)
    try:
        reference = single_point_reference(rig, None, grid, case.harmonics)
        if not downwards or len(reference.level) == len(grid):
            return reference
    except (BenchError, ArithmeticError, ValueError):
        if not downwards:
            raise
    return single_point_reference_from_above(rig, grid, case.harmonics)


def epmc_at(case: StudyCase, amplitudes: Sequence[float]) -> dict[str, Any]:
    """EPMC backbone of a case's rig around given modal amplitudes (m√kg).

    Returns:
        ``failure``, ``harmonics``, ``folds`` (intervals of q in which the backbone is not single-valued) and
        lists modal_amplitude, omega_rad_s, damping_ratio, participation_real, participation_imag; the given
        amplitudes are among the first.
    """
    good = np.unique([q for q in amplitudes if np.isfinite(q) and q > 0.0])
    if good.size == 0:
        return {"failure": "there is no modal amplitude to compute it at", "folds": []}
    rig = case_rig(case)
    failure = ""
    for factor in _ATTEMPTS:
        harmonics = max(3, round(case.harmonics * factor))
        grid = np.geomspace(0.4 * good[0], 2.5 * good[-1], 160)
        try:
            reference = compute_reference(rig, harmonics, np.unique(np.concatenate((grid, good))))
            break
        except (BenchError, ArithmeticError, ValueError) as error:
            failure = failure or _sentence(error)
    else:
        return {"failure": failure, "folds": []}
    structure = build_structure(rig)
    modes = sticking_modes(structure, build_elements(rig, structure), rig.extraction.linear_modes)
    points = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    rows = [modes.points.index(point) for point in points]
    backbone = reference.backbone
    fundamental = int(np.flatnonzero(backbone.orders == 1)[0])
    full = backbone.normalised_shape[:, fundamental].T
    shapes = np.stack([structure.motion(point, full) for point in points], axis=1)
    participation = shapes @ np.linalg.pinv(modes.shapes[rows]).T
    participation = participation * np.exp(-1j * np.angle(participation[:, :1]))
    return {
        "failure": "",
        "harmonics": harmonics,
        "folds": fold_intervals(10.0 ** backbone.branch.points[:, -1]),
        "modal_amplitude": reference.modal_amplitude.tolist(),
        "omega_rad_s": reference.omega_rad_s.tolist(),
        "damping_ratio": reference.damping_ratio.tolist(),
        "participation_real": participation.real.tolist(),
        "participation_imag": participation.imag.tolist(),
    }


def fold_intervals(parameter: FloatArray) -> list[tuple[float, float]]:
    """Intervals that the parameter of a branch passes more than once, merged where they overlap.

    Args:
        parameter: (k,) along the branch.
    """
    highest = np.maximum.accumulate(parameter)
    lowest = np.minimum.accumulate(parameter[::-1])[::-1]
    intervals: list[tuple[float, float]] = []
    # Between the two envelopes lies what is passed again.
    folded = highest > lowest
    for k in np.flatnonzero(folded):
        low, high = float(lowest[k]), float(highest[k])
        if intervals and low <= intervals[-1][1]:
            intervals[-1] = (min(low, intervals[-1][0]), max(high, intervals[-1][1]))
        else:
            intervals.append((low, high))
    return intervals


def _sentence(error: Exception) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
