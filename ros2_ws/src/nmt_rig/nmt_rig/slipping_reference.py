"""Single-point reference of a friction-damped rig reached from the slipping range instead of from rest.

With a stiff joint the sticking mode may have no phase resonance at the drive point, because the residual
flexibility of the other modes covers it there; at high levels, where the joint slips, it has one. A test gets
there by starting at its highest level. The reference follows: it goes up with a softer joint that has a phase
resonance from rest on, stiffens the joint at the highest level, and then goes down level by level.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_rig.model.continuation import NotConvergedError, follow_branch, solve_at_parameter
from nmt_rig.model.forced_response import ForcedProblem
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.local_elements.friction import JenkinsSection
from nmt_rig.model.local_elements.iwan import IwanSection
from nmt_rig.model.phase_resonance import _Quadrature, extract_mode, linear_phase_resonance
from nmt_rig.reference import SinglePointReference
from nmt_rig.rig import Rig
from nmt_rig.rig_model import (
    build_resting_elements,
    build_structure,
    build_system,
    input_per_volt,
    refuse_beyond_harmonic_balance,
)

_SOFTENING = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
_STIFFENING_STEPS = 15
_LEVELS_PER_DECADE = 80
_FRICTION = (JenkinsSection, IwanSection)
_WHAT = "phase resonance in the slipping range"


def softened(rig: Rig, factor: float) -> Rig:
    """The rig with the tangential stiffness of every Jenkins element and Iwan joint times a factor."""
    elements = [
        element.model_copy(update={"tangential_stiffness_n_m": factor * element.tangential_stiffness_n_m})
        if isinstance(element, _FRICTION)
        else element
        for element in rig.local_elements
    ]
    return rig.model_copy(update={"local_elements": elements})


def single_point_reference_from_above(
    rig: Rig, levels: Sequence[float] | FloatArray, harmonics: int = 7
) -> SinglePointReference:
    """Phase-resonant responses reached from the highest level down, and the method's extraction from them.

    Args:
        rig: rig with Jenkins elements.
        levels: (k,) drive amplitudes, V, positive; in any order.
        harmonics: highest harmonic order.

    Returns:
        Ascending levels, as :func:`nmt_rig.reference.single_point_reference`; those below the end of the
        slipping range are left out.

    Raises:
        BenchError: no levels, no Jenkins element, or no phase resonance at the highest level.
    """
    volts = np.unique(np.asarray(levels, dtype=np.float64))
    if volts.size == 0 or volts[0] <= 0.0:
        raise BenchError("levels must be positive voltages; give at least one.")
    if not any(isinstance(element, _FRICTION) for element in rig.local_elements):
        raise BenchError(f"rig {rig.name} has no Jenkins element, so it has no slipping range.")
    refuse_beyond_harmonic_balance(rig, with_exciter=True)
    structure = build_structure(rig)
    # One reference frequency scales all problems, so that a solution of one is a guess for the next.
    scale = float(sticking_modes(structure, (), rig.test.mode).frequencies[rig.test.mode - 1])
    per_volt = input_per_volt(rig)
    top = float(np.log10(volts[-1] * per_volt))
    factor, z = _from_rest(rig, harmonics, scale, top)
    for step in np.geomspace(factor, 1.0, _STIFFENING_STEPS)[1:]:
        system = _Quadrature(_problem(softened(rig, float(step)), harmonics, scale))
        z = solve_at_parameter(system, z, what=_WHAT)
    logs = np.log10(volts * per_volt)
    count = max(2, round((logs[-1] - logs[0]) * _LEVELS_PER_DECADE))
    reached = {}
    for value in np.unique(np.concatenate((np.linspace(logs[0], logs[-1], count), logs)))[::-1]:
        z = np.append(z[:-1], value)
        try:
            z = solve_at_parameter(system, z, what=_WHAT)
        except NotConvergedError:
            break
        if value in logs:
            reached[float(value)] = system.response(z)
    order = sorted(reached)
    elements = build_resting_elements(rig, structure)
    modes = sticking_modes(structure, elements, max(rig.extraction.linear_modes, rig.test.mode))
    points = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    shapes = modes.shapes[[modes.points.index(point) for point in points], : rig.extraction.linear_modes]
    mode = extract_mode(system.problem, [reached[value] for value in order], points, shapes, structure.mass)
    known = volts[[int(np.flatnonzero(logs == value)[0]) for value in order]]
    return SinglePointReference(rig.drive_point, known, mode, len(order) == volts.size)


def _problem(rig: Rig, harmonics: int, scale: float) -> ForcedProblem:
    return ForcedProblem(build_system(rig), FourierBasis.up_to(harmonics), scale)


def _from_rest(rig: Rig, harmonics: int, scale: float, top: float) -> tuple[float, FloatArray]:
    """A solution at the highest level with a softer joint, and how much softer it is."""
    failure: BenchError | None = None
    for factor in _SOFTENING:
        softer = softened(rig, factor)
        structure = build_structure(softer)
        sticking = sticking_modes(structure, build_resting_elements(softer, structure), softer.test.mode)
        try:
            resonance = linear_phase_resonance(
                _problem(softer, harmonics, float(sticking.frequencies[softer.test.mode - 1]))
            )
            problem = _problem(softer, harmonics, scale)
            system = _Quadrature(problem)
            guess = np.concatenate((problem.linear_start(resonance), [resonance / scale, top - 5.0]))
            start = solve_at_parameter(system, guess, what=_WHAT)
            branch = follow_branch(system, start, top + 1e-9, what=_WHAT)
            return factor, solve_at_parameter(system, branch.at_parameter(top), what=_WHAT)
        except BenchError as error:
            failure = error
    raise BenchError(f"no phase resonance at the highest level even with a softer joint: {failure}")
