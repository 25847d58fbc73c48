"""Laws of a missing local force, read from held levels that an independent time integration made."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.simulated_levels import FORCES, MASSES, chain_of_masses, held, held_sines, modes
from scipy.optimize import brentq
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.law.law_blocks import Block
from nmt_diagnose.law.law_elements import element_of, with_law
from nmt_diagnose.law.law_search import LawCandidate, LawPlace, LawSearch, UnboundedMotionError
from nmt_diagnose.law.reading import LawReading, LawTerm, LocalLaw, read_law
from nmt_diagnose.law.terms import Term, force_of
from nmt_diagnose.measurements.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations, RowTable
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.search.law_starts import _start, effects_of_law
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument
from nmt_rig.rig_model import build_structure


@cache
def reading(*laws, **how) -> LawReading:
    found = read_law(chain_of_masses(), held(laws, **how))
    assert found is not None
    return found


def top_of(found: LawReading):
    return found.laws[0].loops[-1]


@pytest.mark.court(not_said="law")
def test_a_healthy_chain_has_no_law() -> None:
    found = reading()
    assert not found.is_stated
    assert found.laws == ()
    assert found.before < 1.0


@pytest.mark.court(said="law")
def test_a_cubic_spring_is_read_with_its_place_and_strength() -> None:
    found = reading((3, "cubic", (4.0e8,), ()))
    assert found.is_stated
    (law,) = found.laws
    assert (law.place, law.family) == ("3", "hardening spring")
    (term,) = law.terms
    assert (term.kind, term.parameters) == ("power", (3.0,))
    assert term.coefficient == pytest.approx(4.0e8, rel=0.01)
    assert found.closed_inside > 0.95
    assert found.closed_above > 0.9


@pytest.mark.campaign
@pytest.mark.court(said="law")
def test_a_clearance_is_read_with_gap_and_stiffness() -> None:
    found = reading((2, "gap", (8.0e3, 2.0e-4), ()))
    (law,) = found.laws
    assert (law.place, law.family) == ("2", "clearance")
    term = next(term for term in law.terms if term.kind == "gap")
    assert term.parameters[0] == pytest.approx(2.0e-4, rel=0.02)
    assert term.coefficient == pytest.approx(8.0e3, rel=0.05)


def test_friction_that_weakens_with_speed_is_no_law_of_the_library_but_is_read() -> None:
    found = reading((4, "stribeck", (0.004, 4e-3, 1.0, 0.1), ()))
    assert found.is_stated
    (law,) = found.laws
    assert law.place == "4"
    assert law.family == "dry friction that weakens with speed"
    assert found.closed_inside > 0.9


def test_bristles_that_weaken_with_speed_are_read_and_written() -> None:
    """Friction of LuGre: its presliding is that of bristles, not of one slider."""
    found = reading((4, "lugre", (150.0, 1e-3, 0.029, 0.046, 0.044), ()), forces=FORCES[:6])
    assert found.is_stated
    (law,) = found.laws
    assert (law.place, law.family) == ("4", "dry friction that weakens with speed")
    assert (found.closed_inside, found.closed_above) == pytest.approx((1.0, 1.0), abs=0.05)
    bristles, weakening = with_law(chain_of_masses(), found).local_elements
    assert bristles.bristle_stiffness_n_m + weakening.bristle_stiffness_n_m == pytest.approx(150.0, rel=0.05)
    assert bristles.static_force_n + weakening.static_force_n == pytest.approx(0.046, rel=0.05)
    assert bristles.coulomb_force_n + weakening.coulomb_force_n == pytest.approx(0.029, rel=0.05)


@pytest.mark.campaign
def test_friction_whose_loops_are_pinched_is_read() -> None:
    found = reading((4, "pinched", (75.0, 2.2e-3, 1.5, 2.0, 5.4e-4), ()), forces=FORCES[:6])
    assert found.is_stated
    (law,) = found.laws
    assert (law.place, law.family) == ("4", "friction with pinched loops")
    assert found.closed_inside > 0.9


@pytest.mark.parametrize("compliance", [0.5, 2.0])
def test_a_mean_force_moves_a_soft_place_to_its_equilibrium(compliance: float) -> None:
    """x₀ = −C k ⟨max(x₀ + a cos − g, 0)⟩, also where repeating it goes away from its solution (C k s > 1)."""
    angles = 2.0 * np.pi * np.arange(512) / 512
    gap, amplitude, stiffness, participation = 2e-4, 1e-3, 1e3, np.array([1.0])
    motion = np.zeros((1, 16), complex)
    motion[0, 1] = amplitude

    def mean_force(mean: float) -> float:
        return stiffness * float(np.mean(np.maximum(mean + amplitude * np.cos(angles) - gap, 0.0)))

    softness = compliance / (0.3 * stiffness)
    expected = brentq(lambda mean: mean + softness * mean_force(mean), -1e-3, 0.0, xtol=1e-15)

    def moved(place: LawPlace, forces) -> np.ndarray:
        result = motion.copy()
        result[:, 0] = -softness * forces[0][1][:, 0]
        return result

    rows = SimpleNamespace(levels=SimpleNamespace(omega=np.array([100.0])), denominators=[np.array([[1.0 / softness]])])
    search = SimpleNamespace(rows=rows, motion=moved)
    search.forces = lambda candidate: LawSearch.forces(search, candidate)
    place = LawPlace(1, 0, participation)
    fit = SimpleNamespace(coefficients=np.array([stiffness]))
    candidate = LawCandidate(((place, Block("stop above", (Term("stop", gap, 1.0),))),), fit, (motion,))
    for _ in range(4):
        found = LawSearch._moved(search, candidate, 0, search.forces(candidate))
        candidate = replace(candidate, motions=(found,))
    assert found[0, 0].real == pytest.approx(expected, rel=1e-3)


def test_two_laws_at_two_places_are_read_and_written() -> None:
    found = reading((4, "cubic", (3.0e8,), ()), (2, "stribeck", (0.01, 1e-3, 0.0, 1.0), ()))
    assert found.is_stated
    assert sorted((law.place, law.family) for law in found.laws) == [("2", "dry friction"), ("4", "hardening spring")]
    by_place = {law.place: law for law in found.laws}
    strengths = {place: sum(term.coefficient for term in law.terms) for place, law in by_place.items()}
    assert strengths == {"4": pytest.approx(3.0e8, rel=0.03), "2": pytest.approx(0.01, rel=0.05)}
    # Each loop is that of its place: the other law is taken off.
    loop = by_place["4"].loops[-1]
    force = 3.0e8 * np.array(loop.displacement) ** 3
    assert np.sqrt(np.mean((np.array(loop.measured) - force) ** 2)) < 0.08 * np.sqrt(np.mean(force**2))
    elements = with_law(chain_of_masses(), found).local_elements
    assert sorted((element.kind, element.point) for element in elements) == [("cubic_spring", 4), ("tanh_friction", 2)]
    starts = [name for law in found.laws for name, _ in effects_of_law(law)]
    assert sorted(starts) == ["cubic_stiffness", "second_friction_contact"]


@pytest.mark.parametrize("order", [(3, 0), (2, 3), (3, 2)])
@pytest.mark.parametrize(
    ("kind", "parameters", "strength"),
    [("stop", (1e-4, 1.0), 2e4), ("stop", (1e-4, -1.0), 2e4), ("power", (2.0,), 3e6), ("power", (3.0,), -4e8)],
)
def test_a_law_begins_at_the_effect_that_has_its_force(
    order: tuple[int, int], kind: str, parameters: tuple[float, ...], strength: float
) -> None:
    """Between two points the effect has them in one order, and the law in any."""
    rig = chain_of_masses()
    term = LawTerm(kind, parameters, strength, 1.0, "N")
    law = LocalLaw(*order, "", (term,), 1e-3, (), ())
    library = candidates(rig, operating_range(rig, []))
    started = _start(library, law)
    assert started is not None
    candidate, theta = started
    element = Parametrisation(rig, (), (candidate,)).rig(theta).local_elements[-1]
    expected = element_of(term, law)
    assert expected is not None
    structure, motion = build_structure(rig), 3e-4 * np.random.default_rng(1).standard_normal((20, len(MASSES)))

    def forces(section: Any) -> Any:
        (one,) = section.elements(structure)
        along = motion @ one.direction
        return np.outer(force_of(one, along, np.zeros(along.size)), one.direction)

    assert np.any(forces(expected))
    np.testing.assert_allclose(forces(element), forces(expected), rtol=1e-9, atol=1e-12)


@pytest.mark.campaign
def test_two_laws_at_one_place_are_read() -> None:
    found = reading((4, "drag", (3.0,), ()), (4, "quintic", (-3.0e10,), ()))
    families = sorted((law.place, law.family) for law in found.laws)
    assert families == [("4", "damping that grows with speed"), ("4", "softening spring")]


def test_two_exciters_drive_a_structure_whose_law_is_read() -> None:
    found = reading((3, "cubic", (4.0e8,), ()), second=-0.4)
    (law,) = found.laws
    assert found.is_stated
    assert (law.place, law.family) == ("3", "hardening spring")
    assert law.terms[0].coefficient == pytest.approx(4.0e8, rel=0.01)
    healthy = reading(second=-0.4)
    assert healthy.laws == ()
    assert healthy.before < 1.0


def test_one_law_has_no_second_beside_it() -> None:
    laws = [(3, "cubic", (4.0e8,)), (3, "drag", (3.0,)), (2, "gap", (8.0e3, 2.0e-4))]
    assert [len(reading((*law, ())).laws) for law in laws] == [1] * len(laws)


def amplitudes(decay: bool, cubic: float = 0.0, friction: float = 0.0, bent: float = 0.0) -> Observations:
    """A decay or a table of 2 kg at 20 Hz with a cubic spring and dry friction, by their describing functions.

    The squared frequency has ¾ k a² / m more (Nayfeh and Mook, Nonlinear Oscillations, 1979), the damping
    2 F / (π ω² m a) (Den Hartog, Trans. ASME 53, 1931). ``bent`` is a relative error of the frequency.
    """
    mass, first, ratio = 2.0, 2.0 * np.pi * 20.0, 0.004
    a = np.geomspace(2e-5, 1e-3, 30)[::-1]
    omega = np.sqrt(first**2 + 0.75 * cubic * a**2 / mass) * (1.0 + bent)
    damping = ratio * first / omega + 2.0 * friction / (np.pi * omega**2 * mass * a)
    table, draw = RowTable(), np.random.default_rng(1)
    for k, size in enumerate(a):
        place = Place(k, 0.1 * k, float(omega[k] / (2.0 * np.pi)), float(size))
        table.add(Part.LOG_FREQUENCY, float(np.log(omega[k]) + 1e-6 * draw.standard_normal()), 1e-6, 0.0, place, 0, 1)
        table.add(Part.DAMPING, float(damping[k] + 1e-5 * draw.standard_normal()), 1e-5, 0.0, place, 0, 1)
    channel = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)
    test = RecordedDecay("decay", 1, channel, a, 20.0) if decay else BackboneTable("table", 1, channel, a)
    found = table.observations(test)
    return Observations(found.tests, found.rows, found.values, found.std, found.floor, chains=(MeasuringChain(),))


def one_mass(kind: str = "force") -> Rig:
    values = {
        "name": "mass",
        "structure": {"kind": "modal", "modes": [{"frequency_hz": 20.0, "damping_ratio": 0.004, "modal_mass_kg": 2.0}]},
    }
    rig = validate_rig(RigDocument("test", values, {}))
    return rig if kind == "force" else rig.model_copy(update={"exciter": rig.exciter.model_copy(update={"kind": kind})})


@pytest.mark.parametrize("decay", with_quick([True, False], True))
def test_decays_and_tables_give_the_law_of_one_mode(decay: bool) -> None:
    spring = read_law(one_mass(), amplitudes(decay, cubic=5.0e8))
    assert spring is not None
    assert spring.is_stated
    (law,) = spring.laws
    (term,) = law.terms
    assert (law.family, term.parameters) == ("hardening spring", (3.0,))
    assert term.coefficient == pytest.approx(5.0e8, rel=0.02)
    rubbed = read_law(one_mass(), amplitudes(decay, friction=0.02))
    assert rubbed is not None
    assert rubbed.is_stated
    (law,) = rubbed.laws
    assert law.family in ("dry friction", "friction of a slider behind a spring")
    loss = [t.coefficient * (t.parameters[0] if t.kind == "slider" else 1.0) for t in law.terms]
    assert sum(loss) == pytest.approx(0.02, rel=0.05)


@pytest.mark.court(not_said="law")
def test_a_decay_of_the_model_has_no_law() -> None:
    for bent in (0.0, 0.005):
        found = read_law(one_mass(), amplitudes(True, bent=bent))
        assert found is not None
        assert not found.laws


def test_a_decay_with_a_shaker_attached_is_not_read() -> None:
    assert read_law(one_mass("electrodynamic_shaker"), amplitudes(True, cubic=5.0e8)) is None


def lines(reference: str, cubic: float, friction: float, responses: str = "relative") -> tuple[Rig, Observations]:
    """Stepped sines of 2 kg at 20 Hz with a cubic spring and dry friction, by their describing functions.

    A force of amplitude P, or a base of acceleration P / m, and the displacement relative to it have the ratio
    (k + ¾ κ a² − m ω² + i (c ω + 4 F / (π a)))⁻¹ (Nayfeh and Mook; Den Hartog): at a given a it is solved for ω.
    """
    mass, first, ratio = 2.0, 2.0 * np.pi * 20.0, 0.01
    stiffness, damper = mass * first**2, 2.0 * ratio * mass * first
    structure = {
        "kind": "matrices", "mass_kg": [[mass]], "stiffness_n_m": [[stiffness]], "damping_ratios": [ratio],
        "base_vector": [1.0], "base_load_kg": [mass], "points_at": [{"point": 1, "row": 0}],
    }  # fmt: skip
    table_section = {"kind": "shaking_table", "point": 1, "responses": responses}
    exciter = {"kind": "force", "point": 1} if reference == "force" else table_section
    values = {
        "name": "mass", "structure": structure, "exciter": exciter,
        "sensors": [{"quantity": "displacement", "point": 1}, {"quantity": "force", "point": "drive"}],
        "extraction": {"quantity": "displacement", "linear_modes": 1},
    }  # fmt: skip
    rig = validate_rig(RigDocument("test", values, {}))
    channel = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)
    draw, found = np.random.default_rng(2), []
    for number, force in enumerate((0.05, 0.1, 0.2, 0.4)):

        def impedance(omega: float, a: float) -> complex:
            real = stiffness + 0.75 * cubic * a**2 - mass * omega**2
            return complex(real, damper * omega + 4.0 * friction / (np.pi * a))

        def too_stiff(omega: float, a: float, force: float = force) -> float:
            return abs(impedance(omega, a)) * a - force

        top = (force - 4.0 * friction / np.pi) / (damper * first)
        rows = []
        for a in np.linspace(0.5, 0.97, 6) * top:
            middle = math.sqrt((stiffness + 0.75 * cubic * a**2) / mass)
            for low, high in ((0.8 * middle, middle), (middle, 1.2 * middle)):
                if too_stiff(middle, a) < 0.0:
                    omega = float(brentq(too_stiff, low, high, args=(a,)))
                    rows.append((omega, 1.0 / impedance(omega, a)))
        omega, compliance = (np.array(part) for part in zip(*sorted(rows, key=lambda row: row[0]), strict=True))
        measured = compliance if reference == "force" else -mass * compliance
        if reference == "base" and responses == "absolute":
            measured = measured - 1.0 / omega**2
        measured = measured * (1.0 + 1e-3 * draw.standard_normal(omega.size))
        test = SteppedResponses(
            f"up {number}", 1, (channel,), reference, reference, omega / (2.0 * np.pi),
            np.full(omega.size, force if reference == "force" else force / mass), measured[:, np.newaxis],
            np.full(omega.size, 1e-3),
        )  # fmt: skip
        found.append(test)
    table = RowTable()
    for k in range(len(found)):
        table.add(Part.LOG_MAGNITUDE, 0.0, 1e-3, 0.0, Place(k, 0.0, 20.0, 1.0), 0, 1)
    one = table.observations(found[0])
    rows_of_all = replace(one.rows, test=np.arange(len(found)))
    return rig, Observations(tuple(found), rows_of_all, one.values, one.std, one.floor)


@pytest.mark.parametrize(
    ("reference", "responses"),
    with_quick([("force", "relative"), ("base", "relative"), ("base", "absolute")], ("base", "absolute")),
)
def test_stepped_sines_at_several_forces_give_the_law(reference: str, responses: str) -> None:
    spring = read_law(*lines(reference, 2.0e9, 0.0, responses))
    assert spring is not None
    assert spring.is_stated
    (law,) = spring.laws
    (term,) = law.terms
    assert (law.family, term.parameters) == ("hardening spring", (3.0,))
    assert term.coefficient == pytest.approx(2.0e9, rel=0.02)
    rubbed = read_law(*lines(reference, 0.0, 0.015, responses))
    assert rubbed is not None
    assert rubbed.is_stated
    (law,) = rubbed.laws
    loss = [t.coefficient * (t.parameters[0] if t.kind == "slider" else 1.0) for t in law.terms]
    assert sum(loss) == pytest.approx(0.015, rel=0.05)


def test_a_stepped_sine_of_the_model_has_no_law() -> None:
    found = read_law(*lines("base", 0.0, 0.0, "absolute"))
    assert found is not None
    assert not found.laws


def test_where_no_term_acts_no_law_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A force that is not a passive one: all coefficients of all laws are zero."""
    monkeypatch.setattr(LawSearch, "refit", lambda search, candidate: SimpleNamespace(elements=0))
    found = read_law(chain_of_masses(), held([(3, "cubic", (4.0e8,), ())]))
    assert found is not None
    assert (found.laws, found.refusals) == ((), ("no local force explains them",))


def test_a_law_under_which_the_motion_has_no_bound_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = LawSearch.problem

    def problem(search: LawSearch, others: list) -> object:
        if others:
            raise UnboundedMotionError
        return plain(search, others)

    monkeypatch.setattr(LawSearch, "problem", problem)
    found = read_law(chain_of_masses(), held([(3, "cubic", (4.0e8,), ())]))
    assert found is not None
    assert not found.laws
    assert "the motion has no bound" in found.refusals[0]


@pytest.mark.court(not_said="law")
def test_a_wrong_gain_alone_is_no_law() -> None:
    found = reading(gains=(1.0, 1.2, 1.0, 1.0))
    assert not found.is_stated


def test_the_measured_loop_is_that_of_the_true_force() -> None:
    found = reading((3, "cubic", (4.0e8,), ()))
    loop = top_of(found)
    x = np.array(loop.displacement)
    force = 4.0e8 * x**3
    # The loop has the harmonics that were observed, without the mean.
    assert np.sqrt(np.mean((np.array(loop.measured) - force) ** 2)) < 0.05 * np.sqrt(np.mean(force**2))
    assert np.sqrt(np.mean((np.array(loop.law) - force) ** 2)) < 0.02 * np.sqrt(np.mean(force**2))


def test_the_chain_of_the_simulator_is_that_of_the_model() -> None:
    omega, _, shapes = modes()
    assert np.allclose(shapes.T @ np.diag((1.0, 0.8, 0.6, 0.5)) @ shapes, np.eye(4), atol=1e-12)
    assert omega[0] > 0.0


@pytest.mark.parametrize(
    ("responses", "law", "expected"),
    [
        ("relative", (3, "cubic", (4e8,), ()), ("3", "hardening spring", 4e8)),
        ("absolute", (4, "stribeck", (0.02, 1e-3, 0.0, 1.0), ()), ("4", "dry friction", 0.02)),
        ("absolute", None, None),
    ],
)
def test_levels_on_a_shaking_table_give_the_law(responses: str, law: tuple | None, expected: tuple | None) -> None:
    """The chain on a table that moves by −1 m/s² for 1 N of the force that stands for it."""
    omega, ratios, shapes = modes()
    rig = chain_of_masses({"kind": "shaking_table", "point": 1, "effective_mass_kg": 1.0, "responses": responses})
    sines = [(float(force), omega[0] / (2.0 * np.pi)) for force in np.geomspace(0.02, 0.8, 5)]
    laws, moved = [] if law is None else [law], (shapes.T @ np.array(MASSES), responses == "absolute")
    found = read_law(rig, held_sines((omega, ratios, shapes), laws, {1: 1.0}, sines, (1.0,) * 4, table=moved))
    assert found is not None
    assert found.is_stated is (law is not None)
    if expected is None:
        assert found.before < 0.5
        return
    place, family, strength = expected
    (read,) = found.laws
    assert (read.place, read.family) == (place, family)
    assert read.terms[0].coefficient == pytest.approx(strength, rel=0.01)
