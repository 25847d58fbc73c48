"""Terms, convex fits and written elements of laws against closed forms and other solvers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import lsq_linear

from nmt_diagnose.law.convex import ConvexFit
from nmt_diagnose.law.law_elements import element_of
from nmt_diagnose.law.law_words import family
from nmt_diagnose.law.reading import LawTerm, LocalLaw
from nmt_diagnose.law.terms import SAMPLES, Term, harmonics
from nmt_rig.model.local_elements.attachments import LEFT_SHARE

OMEGA, A = 100.0, 1e-3
TURN = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
X, V = A * np.cos(TURN)[np.newaxis], -OMEGA * A * np.sin(TURN)[np.newaxis]


def gap_share(gap: float) -> float:
    """Stiffness of stops on both sides at an amplitude over that of the stops (describing function)."""
    ratio = gap / A
    return 1.0 - 2.0 / math.pi * (math.asin(ratio) + ratio * math.sqrt(1.0 - ratio**2))


@pytest.mark.parametrize(
    ("term", "first"),
    [
        (Term("power", 3.0), 0.75 * A**3),
        (Term("power", 5.0), 0.625 * A**5),
        (Term("gap", 0.4 * A), gap_share(0.4 * A) * A),
        (Term("speed", 2.0), 8.0 / (3.0 * math.pi) * (OMEGA * A) ** 2 * 1j),
        (Term("amplitude", 2.0), 0.25 * A**3 * OMEGA * 1j),
        (Term("friction", 1e-5 * OMEGA * A), 4.0 / math.pi * 1j),
    ],
)
def test_the_fundamental_of_a_term_is_its_describing_function(term: Term, first: complex) -> None:
    found = harmonics(term.force(X, V))[0, 1]
    assert abs(found - first) < 2e-3 * abs(first)


def test_a_slider_dissipates_four_times_its_slip_force_and_way() -> None:
    slip = 0.3 * A
    loss = float(np.sum(Term("slider", slip).force(X, V) * V)) * 2.0 * math.pi / OMEGA / SAMPLES
    assert loss == pytest.approx(4.0 * slip * (A - slip), rel=1e-2)


def test_memory_of_a_record_begins_as_in_a_model_at_rest() -> None:
    """Virgin loading from zero: a slider by its spring up to its slip, bristles by Dahl's exponential."""
    x = np.linspace(0.0, A, 400)[np.newaxis]
    v = np.full_like(x, A)
    slip = 0.4 * A
    assert Term("slider", slip).force(x, v, closed=False) == pytest.approx(np.minimum(x, slip), abs=1e-9 * A)
    expected = slip * (1.0 - np.exp(-x / slip))
    assert Term("bristle", slip).force(x, v, closed=False) == pytest.approx(expected, abs=1e-6 * A)
    slack = Term("slack slider", slip, 0.5).force(x, v, closed=False)
    assert slack == pytest.approx(np.clip(x - 0.5 * slip, 0.0, 0.5 * slip), abs=1e-9 * A)


def test_friction_weakens_only_where_its_force_falls() -> None:
    """tanh(u) (1 + s exp(−u²)) only has another knee while s is small; over a longer speed it falls."""
    knee = [(Term("friction", 1e-3), 1.0), (Term("weakening friction", 1e-3, 1e-3), 0.45)]
    assert family(knee) == "dry friction"
    assert family([knee[0], (Term("weakening friction", 1e-3, 1e-2), 0.45)]) == "dry friction that weakens with speed"
    assert family([(Term("weakening friction", 1e-3, 1e-3), 0.45)]) == "dry friction that weakens with speed"


@pytest.mark.parametrize("reach", [0.05 * A, 0.7 * A, 20.0 * A])
def test_bristles_have_the_loop_of_their_closed_form(reach: float) -> None:
    """dz/dx = 1 − z / reach one way and its mirror the other: z = reach tanh(A / reach) at the ends (Dahl 1976)."""
    force = Term("bristle", reach).force(X, V)[0]
    end = reach * math.tanh(A / reach)
    assert force[0] == pytest.approx(end, rel=1e-3)
    loss = float(np.sum(force * V[0])) * 2.0 * math.pi / OMEGA / SAMPLES
    expected = 4.0 * A * reach - 2.0 * reach * (reach + end) * (1.0 - math.exp(-2.0 * A / reach))
    assert loss == pytest.approx(expected, rel=1e-2, abs=1e-4 * A**2)


def test_weakening_bristles_are_those_of_their_equation() -> None:
    """ż = v − |v| z / s(v) by an adaptive integrator, at its fourth period."""
    reach, fall = 0.1 * A, 0.3 * OMEGA * A

    def rate(time: float, z: np.ndarray) -> np.ndarray:
        v = -OMEGA * A * math.sin(OMEGA * time)
        level = reach * (LEFT_SHARE + (1.0 - LEFT_SHARE) * math.exp(-((v / fall) ** 2)))
        return np.array([v - abs(v) * z[0] / level])

    period = 2.0 * math.pi / OMEGA
    times = period * (3.0 + np.arange(0, SAMPLES, 8) / SAMPLES)
    found = solve_ivp(rate, (0.0, 4.0 * period), [0.0], "LSODA", times, rtol=1e-9, atol=1e-13, max_step=period / 64)
    force = Term("weakening bristle", reach, fall).force(X, V)[0, ::8]
    assert np.abs(force - found.y[0]).max() < 0.02 * reach


def test_slack_narrows_a_sliders_loop_about_no_force() -> None:
    """The slack takes its share of the force that slides, and all of the stiffness about no force."""
    slip, share = 0.3 * A, 0.4
    force = Term("slack slider", slip, share).force(X, V)[0]
    loss = float(np.sum(force * V[0])) * 2.0 * math.pi / OMEGA / SAMPLES
    assert loss == pytest.approx(4.0 * slip * (1.0 - share) * (A - slip), rel=1e-2)
    behind = Term("slider", slip).force(X, V)[0]
    assert np.all(force[np.abs(behind) < share * slip] == 0.0)


def test_even_forces_have_a_mean() -> None:
    found = harmonics(Term("power", 2.0).force(X, V))[0]
    assert found[0] == pytest.approx(0.5 * A**2)
    assert found[2] == pytest.approx(0.5 * A**2)


def random_problem(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    return (
        generator.standard_normal((5, 12)),
        generator.standard_normal((5, 12, 3)),
        generator.standard_normal((5, 12, 4)),
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_convex_fit_is_that_of_a_bounded_solver(seed: int) -> None:
    target, nuisance, columns = random_problem(seed)
    signed = np.array([True, False, False, False])
    fit = ConvexFit(target, nuisance, [])
    found = fit.solve(columns, signed)
    matrix = np.vstack([np.concatenate([nuisance, columns], axis=2).reshape(60, 7), np.eye(3, 7)])
    low = np.array([-np.inf] * 4 + [0.0] * 3)
    other = lsq_linear(matrix, np.append(target.ravel(), np.zeros(3)), (low, np.inf), tol=1e-14).x
    assert np.allclose(np.append(found.nuisance, found.coefficients), other, atol=1e-5)
    cost = float(np.sum((matrix @ other - np.append(target.ravel(), np.zeros(3))) ** 2))
    assert found.cost == pytest.approx(cost, rel=1e-8)


def test_the_score_is_that_of_fits_without_the_level() -> None:
    target, nuisance, columns = random_problem(7)
    signed = np.ones(4, dtype=bool)
    found = ConvexFit(target, nuisance, [1, 2, 3]).solve(columns, signed)
    total = 0.0
    for out in (1, 2, 3):
        others = [k for k in range(5) if k != out]
        both = np.concatenate([nuisance, columns], axis=2)
        matrix = np.vstack([both[others].reshape(48, 7), np.eye(3, 7)])
        theta = np.linalg.lstsq(matrix, np.append(target[others].ravel(), np.zeros(3)), rcond=None)[0]
        total += float(np.sum((target[out] - both[out] @ theta) ** 2))
    assert found.score == pytest.approx(math.sqrt(total / 36.0), rel=1e-6)


def test_a_slider_is_written_as_a_jenkins_element() -> None:
    term = LawTerm("slider", (2e-4,), 1e3, 0.0, "N/m")
    section = element_of(term, LocalLaw(3, 2, "", (term,), 2e-3, (), ()))
    assert section is not None
    assert (section.point, section.other_point) == (3, 2)
    assert section.own_values() == [1e3, pytest.approx(0.2)]


def test_bristles_are_written_as_friction_of_bristles() -> None:
    """Steady force at a speed, c s(v), against the section's F_C + (F_S − F_C) exp(−(v / v_S)²)."""
    for term in (
        LawTerm("bristle", (2e-4,), 1e3, 0.0, "N/m"),
        LawTerm("weakening bristle", (2e-4, 0.1), 1e3, 0.0, "N/m"),
    ):
        section = element_of(term, LocalLaw(3, 0, "", (term,), 2e-3, (), ()))
        assert section is not None
        assert (section.kind, section.valid_to_m) == ("lugre", 2e-3)
        stiffness, damping, viscous, coulomb, static, speed = section.own_values()
        assert (stiffness, damping, viscous) == (1e3, 0.0, 0.0)
        # At a constant speed, over a way of many reaches, in the middle of a saw tooth.
        v = 0.07
        x = np.concatenate([np.linspace(-1.0, 1.0, 256), np.linspace(1.0, -1.0, 256)])[np.newaxis]
        force = 1e3 * Term(term.kind, *term.parameters).force(x, np.where(np.arange(512) < 256, v, -v)[np.newaxis])
        assert force[0, 128] == pytest.approx(coulomb + (static - coulomb) * math.exp(-((v / speed) ** 2)), rel=1e-6)


def test_what_no_kind_of_element_has_is_not_written() -> None:
    term = LawTerm("gap damping", (1e-3,), 0.2, 0.0, "N s/m")
    assert element_of(term, LocalLaw(3, 0, "", (term,), 2e-3, (), ())) is None


def test_what_friction_has_more_at_low_speed_is_written() -> None:
    term = LawTerm("weakening friction", (1e-3, 0.1), 0.2, 0.0, "N")
    section = element_of(term, LocalLaw(3, 0, "", (term,), 2e-3, (), ()))
    assert section is not None
    assert (section.kind, *section.own_values()) == ("weakening_friction", 0.2, 1e-3, 0.1)
    v = np.linspace(-0.4, 0.4, 33)[np.newaxis]
    force = Term("weakening friction", 1e-3, 0.1).force(np.zeros_like(v), v)
    assert force == pytest.approx(np.tanh(v / 1e-3) * np.exp(-((v / 0.1) ** 2)), rel=1e-12)
    assert np.all(force * v >= 0.0)


def test_families_are_named_by_what_the_terms_do() -> None:
    assert family([(Term("power", 3.0), 1.0)]) == "hardening spring"
    assert family([(Term("power", 3.0), -1.0), (Term("power", 5.0), 1.0)]) == "softening, then hardening spring"
    assert family([(Term("power", 2.0), 1.0)]) == "asymmetric spring"
    two = [(Term("slider", 1e-4), 1.0), (Term("slider", 1.4e-4), 1.0)]
    assert family(two) == "friction of a slider behind a spring"
    assert family([*two, (Term("slack slider", 2e-4, 0.3), 1.0)]) == "friction with pinched loops"
    assert family([(Term("bristle", 1e-4), 1.0)]) == "friction of a slider behind a spring"
    weakening = (Term("weakening bristle", 1e-4, 0.1), 1.0)
    for share, falls in ((0.06, True), (0.04, False)):
        words = family([(Term("bristle", 1e-4), 1.0 - share), (weakening[0], share)])
        assert (words == "dry friction that weakens with speed") is falls
    for share, pinched in ((0.21, True), (0.19, False)):
        slack = (Term("slack slider", 1e-4, 0.5), 2.0 * share)
        assert (family([(Term("slider", 1e-4), 1.0 - share), slack]) == "friction with pinched loops") is pinched
    assert family([(Term("bristle", 1e-4), 1.0), weakening]) == "dry friction that weakens with speed"
    assert family([*two, (Term("slider", 4e-4), 1.0)]) == "friction of many sliders"
