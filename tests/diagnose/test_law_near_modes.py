"""Laws at levels that move two near modes, on the modes of the frame, integrated by another program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from diagnose.simulated_levels import held_sines, levels_of
from tiers import with_quick

from nmt_diagnose.law.law_rows import LawRows
from nmt_diagnose.law.modal_frame import ModalFrame
from nmt_diagnose.law.reading import LawReading, read_law
from nmt_diagnose.measurements.measurement import Observations
from nmt_rig.rig import Rig, load_rig

JOINT = (3, "sliders", (), ((16000.0, 2.0),))
"""That of the frame, which the model has."""
FORCES = tuple(float(force) for force in np.geomspace(0.3, 6.0, 5))
ERRORS = (0.995, 1.004, 1.01, 0.99)
"""True frequencies over those of the model."""


def frame() -> Rig:
    return load_rig("frame")


def levels(
    *laws: tuple, weights: Mapping[int, float] | None = None, errors: Sequence[float] = (1.0,) * 4, turned: float = 0.0,
    hz: float = 100.5, forces: Sequence[float] = FORCES,
) -> Observations:  # fmt: skip
    """Levels of the frame with its joint and laws; the shapes of its near modes ``turned`` into each other, rad."""
    modes = frame().structure.modes
    omega = 2.0 * np.pi * np.array([mode.frequency_hz for mode in modes]) * errors
    shapes = np.array([mode.shape for mode in modes]).T
    cos, sin = np.cos(turned), np.sin(turned)
    turn = np.array([[cos, -sin], [sin, cos]])
    shapes[:, :2] = shapes[:, :2] @ turn
    ratios = np.array([mode.damping_ratio for mode in modes])
    sines = [(force, hz) for force in forces]
    return held_sines((omega, ratios, shapes), [JOINT, *laws], weights or {1: 1.0}, sines, (1.0, 1.01, 0.99, 1.005))


def reading(*laws: tuple, **how) -> LawReading:
    found = read_law(frame(), levels(*laws, **how))
    assert found is not None
    return found


def test_the_frame_of_near_modes_has_both() -> None:
    held = levels_of(levels(forces=FORCES[:1]))
    assert held is not None
    for torsion_hz, expected in ((101.4, (0, 1)), (160.0, (0,))):
        rig = frame()
        modes = list(rig.structure.modes)
        modes[1] = modes[1].model_copy(update={"frequency_hz": torsion_hz})
        rig = rig.model_copy(update={"structure": rig.structure.model_copy(update={"modes": modes})})
        structure = ModalFrame.of(rig, held)
        assert structure is not None
        assert structure.modes == expected


def test_coordinates_and_residuals_of_both_modes_are_those_of_the_equations() -> None:
    """A force at a place gives each mode p G / D and its residual p G, by the closed form of a modal model."""
    held = levels_of(levels(forces=FORCES[:2]))
    assert held is not None
    structure = ModalFrame.of(frame(), held)
    assert structure is not None
    rows = LawRows(structure, held)
    place, force = structure.at(4), np.zeros((2, 16), complex)
    force[:, 1] = 2.0 - 1.0j
    stiff = structure.omega**2 - held.omega[0] ** 2 + 2j * structure.zeta * structure.omega * held.omega[0]
    motion = -(structure.sensors * place / stiff) @ np.ones(4) * force[0, 1]
    near = motion - structure.sensors[:, 2:] @ (-(place / stiff)[2:] * force[0, 1])
    assert rows.take_q @ near == pytest.approx(-(place / stiff)[:2] * force[0, 1], rel=1e-12)
    # What the structure does to a force and what the rows of the force say are one.
    y = np.stack([motion, motion])
    measured = rows.assembled(np.zeros((2, 2), complex), y, np.zeros((2, 4, rows.highest - 1), complex))
    assert rows.of_force(place, force)[:, :6] == pytest.approx(measured[:, :6], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("second", with_quick([0.0, 0.9], 0.9))
def test_a_spring_is_read_where_both_modes_move(second: float) -> None:
    weights = {1: 1.0, 2: second} if second else {1: 1.0}
    found = reading((2, "cubic", (6e10,), ()), weights=weights, errors=ERRORS, turned=0.1)
    assert found.is_stated
    (law,) = found.laws
    assert (law.place, law.family, law.other_places) == ("2", "hardening spring", ())
    assert law.terms[0].coefficient == pytest.approx(6e10, rel=0.05)


def test_friction_is_read_where_both_modes_move() -> None:
    found = reading((4, "sliders", (), ((8000.0, 0.5),)), weights={1: 1.0, 2: -0.6}, errors=ERRORS, hz=101.5)
    assert found.is_stated
    (law,) = found.laws
    assert (law.place, law.family) == ("4", "friction of a slider behind a spring")
    (term,) = law.terms
    assert (term.coefficient, term.coefficient * term.parameters[0]) == pytest.approx((8000.0, 0.5), rel=0.05)


@pytest.mark.parametrize(("errors", "turned"), [((1.0,) * 4, 0.0), (ERRORS, 0.1)])
def test_a_healthy_frame_has_no_law(errors: Sequence[float], turned: float) -> None:
    found = reading(weights={1: 1.0, 2: 0.5}, errors=errors, turned=turned)
    assert found.laws == ()
    assert found.before < 0.5


def test_sensors_that_do_not_tell_near_modes_apart_are_no_reading() -> None:
    """Corners 1 and 3 move alike in both modes; the third sensor tells them apart by ever less."""
    rig, found = frame(), levels((2, "cubic", (6e10,), ()))
    modes = list(rig.structure.modes)

    def with_torsion(share: float) -> Rig:
        shape = [s + share * (t - s) for s, t in zip(modes[0].shape, modes[1].shape, strict=True)]
        changed = [modes[0], modes[1].model_copy(update={"shape": shape}), *modes[2:]]
        return rig.model_copy(update={"structure": rig.structure.model_copy(update={"modes": changed})})

    held = levels_of(found)
    assert held is not None
    alike = [ModalFrame.of(with_torsion(share), held) for share in (0.14, 0.10)]
    assert [one is not None and one.resolution > 0.1 for one in alike] == [True, False]
    refused = read_law(with_torsion(0.10), found)
    assert refused is not None
    assert not refused.laws
    assert "do not tell their shapes apart" in refused.refusals[0]
