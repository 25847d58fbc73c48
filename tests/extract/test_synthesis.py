"""Synthesis from a backbone: linear limit, folded closed form, the model's forced response, what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.response_curve import response_curves
from nmt_extract.synthesis.single_mode import OtherModes, Synthesis, SynthesisedBackbone, peak, resonance_error
from nmt_extract.synthesis.synthesised_responses import compare_curve
from nmt_report.response_analysis import interpolate_curve, model_responses
from nmt_rig.linear_description import linear_description
from nmt_rig.reference import compute_reference
from nmt_rig.rig import load_rig

OMEGA, DAMPING = 2 * np.pi * 370.0, 0.004
SHAPE = np.array([0.4, 0.5 + 0.01j, -0.6])
POINTS = (1, 2, 3)


def backbone(q: np.ndarray, stiffening: float = 0.0) -> SynthesisedBackbone:
    """ω̃² = ω² + ¾ κ q², viscous damping: a Duffing oscillator in one-term balance."""
    omega = np.sqrt(OMEGA**2 + 0.75 * stiffening * q**2)
    return SynthesisedBackbone(q, omega, DAMPING * OMEGA / omega, np.tile(SHAPE, (q.size, 1)), POINTS)


def test_linear_limit_is_the_frequency_response() -> None:
    s = Synthesis(backbone(np.geomspace(1e-6, 1e-2, 12)), 1, OtherModes.none(POINTS), 10.0)
    omega = 2 * np.pi * np.linspace(340.0, 400.0, 121)
    exact = SHAPE * (np.conj(SHAPE[0]) * 10.0 / (OMEGA**2 - omega**2 + 2j * DAMPING * OMEGA * omega))[:, None]
    assert s.response(omega) == pytest.approx(exact, rel=1e-10)
    assert s.gaps(omega[0], omega[-1]) == []
    assert len(s.curves) == 1
    curve = s.curves[0]
    assert curve.acceleration == pytest.approx(-(curve.omega_rad_s**2)[:, None] * curve.displacement)


def test_folded_duffing_gives_all_three_solutions() -> None:
    """Against the roots of the cubic in q² that the frequency equation is."""
    stiffening, force = 1e13, 30.0
    s = Synthesis(backbone(np.geomspace(1e-6, 1e-2, 2000), stiffening), 1, OtherModes.none(POINTS), force)
    counts = set()
    for hertz in np.linspace(360.0, 470.0, 45):
        w, a = 2 * np.pi * hertz, 0.75 * stiffening
        d = OMEGA**2 - w**2
        roots = np.roots([a**2, 2 * a * d, d**2 + (2 * DAMPING * OMEGA * w) ** 2, -((0.4 * force) ** 2)])
        exact = np.sqrt(sorted(roots[np.abs(roots.imag) < 1e-7 * np.abs(roots)].real, reverse=True))
        found = np.array([q for q, _ in s.solutions(w)])
        assert found == pytest.approx(exact, rel=1e-6), hertz
        counts.add(found.size)
    assert counts == {1, 3}
    up = 2 * np.pi * np.linspace(360.0, 470.0, 2000)
    rising, falling = s.response(up, "sweep"), s.response(up[::-1], "sweep")[::-1]
    assert np.abs(rising[:, 0]).max() > 1.3 * np.abs(falling[:, 0]).max()


def test_nothing_is_extrapolated() -> None:
    short = backbone(np.geomspace(2e-5, 1e-4, 8))
    s = Synthesis(short, 1, OtherModes.none(POINTS), 20.0)
    low, high = 2 * np.pi * 350, 2 * np.pi * 390
    sentences = s.gaps(low, high)
    assert any("above the highest" in line for line in sentences)
    assert any("lowest measured level" in line for line in sentences)
    assert np.all(np.isnan(s.response(np.array([OMEGA, low]))))
    amplitudes = np.concatenate([curve.modal_amplitude for curve in s.curves])
    assert amplitudes.min() >= 2e-5 * (1 - 1e-12)
    assert amplitudes.max() <= 1e-4 * (1 + 1e-12)
    nothing = Synthesis(short, 1, OtherModes.none(POINTS), 1e-6)
    assert nothing.curves == []
    assert "no response at all" in nothing.gaps(low, high)[0]


def test_other_modes_from_residuals_and_from_modes() -> None:
    linear = LinearDescription(
        "test", 1, 1, POINTS, (10.0, OMEGA, 40_000.0), (0.1, DAMPING, 0.01),
        ((0.3, 0.4, 0.2), (0.3, 0.5, -0.4), (0.3, -0.6, 0.1)), 0.4, OMEGA, 0.005, 0.0,
    )  # fmt: skip
    modes = OtherModes.from_modes(linear, (3, 1))
    w = np.array([OMEGA])
    phi = linear.shape_matrix[[2, 0]]
    exact = np.zeros(2, dtype=complex)
    for r in (0, 2):
        own, damping = linear.frequencies_rad_s[r], linear.damping_ratios[r]
        exact += phi[:, r] * linear.shape_matrix[0, r] / (own**2 - w[0] ** 2 + 2j * damping * own * w[0])
    assert modes.receptance(w)[0] == pytest.approx(exact)
    values = {
        **vars(linear),
        "target_residuals": {"lower": [[0.09, 0.0]] * 3, "upper": [[5e-11, 0.0], [-1e-10, 0.0], [2.5e-11, 1e-13]]},
    }
    residuals = OtherModes.from_file(values, (3, 1))
    assert residuals.receptance(w)[0] == pytest.approx(np.array([2.5e-11 + 1e-13j, 5e-11]) - 0.09 / OMEGA**2)
    assert OtherModes.from_file({**values, "target_residuals": None}, (3, 1)).receptance(w) == pytest.approx(
        modes.receptance(w)
    )
    with pytest.raises(BenchError, match="target_residuals"):
        OtherModes.from_file({**values, "target_residuals": {"lower": [1.0, 2.0, 3.0], "upper": []}}, (3, 1))
    with pytest.raises(BenchError, match="points"):
        OtherModes.from_modes(linear, (3, 7))


@pytest.fixture(scope="module")
def joint_resonator():
    return load_rig("joint_resonator")


@pytest.mark.parametrize(("force", "tolerance"), with_quick([(14.65, 0.006), (38.15, 0.006)], (38.15, 0.006)))
def test_against_the_models_forced_response(joint_resonator, force: float, tolerance: float) -> None:
    """Backbone by EPMC, witness by harmonic balance of the forced system with the exciter: independent problems."""
    linear = linear_description(joint_resonator)
    reference = compute_reference(joint_resonator, 7, np.geomspace(8e-6, 4e-4, 120)).backbone
    fundamental = int(np.flatnonzero(reference.orders == 1)[0])
    rows = [point - 1 for point in linear.points]
    shape = reference.normalised_shape[:, fundamental][:, rows]
    measured = SynthesisedBackbone(
        reference.modal_amplitude, reference.omega_rad_s, reference.damping_ratio, shape, linear.points
    )
    s = Synthesis(measured, linear.drive_point, OtherModes.from_modes(linear, linear.points), force)
    model = model_responses(joint_resonator, [force], 350.0, 390.0, ["a1", "a2", "a3"])[0]
    hertz = np.linspace(350.0, 390.0, 401)
    values = -((2 * np.pi * hertz[:, None]) ** 2) * s.response(2 * np.pi * hertz)
    for row, channel in enumerate(model.channels):
        error = resonance_error(channel, hertz, model.at(row, hertz), values[:, row])
        assert abs(error.amplitude_error) < tolerance
        assert abs(error.frequency_error) < 1e-4
        assert error.rms_error < 2 * tolerance
        assert error.band_hz[0] < error.peak_frequency_hz < error.band_hz[1]


def point(q: float, **values) -> ModalPoint:
    return ModalPoint(
        0, PointStatus.OK, "", 1.0, "V", omega_rad_s=OMEGA, damping_ratio=DAMPING, modal_amplitude=q, points=POINTS,
        normalised_shape=SHAPE, force_harmonics=np.array([0, 2.0j]), **values,
    )  # fmt: skip


def test_backbone_from_levels() -> None:
    levels = [point(3e-4), point(1e-4), point(1.0001e-4), replace(point(2e-4), status=PointStatus.NOT_LOCKED)]
    found = SynthesisedBackbone.from_points(levels)
    assert found.modal_amplitude == pytest.approx([1.00005e-4, 3e-4])
    lower = np.array([0.2 + 0j, 0.1, 0.3])
    others = replace(OtherModes.none(POINTS), lower=lower)
    own = SynthesisedBackbone.from_points(levels, others)
    assert own.shape[1] == pytest.approx(SHAPE + lower / OMEGA**2 * 2.0j / 3e-4)
    with pytest.raises(BenchError, match="two levels"):
        SynthesisedBackbone.from_points(levels[:1])
    with pytest.raises(BenchError, match="drive point 9"):
        Synthesis(found, 9, OtherModes.none(POINTS), 1.0)
    with pytest.raises(BenchError, match="positive"):
        Synthesis(found, 1, OtherModes.none(POINTS), 0.0)


def test_peak_and_errors() -> None:
    hertz = np.linspace(99.0, 101.0, 41)
    mode = 1.0 / (1.0 + 2j * (hertz - 100.013))
    at, height = peak(hertz, np.abs(mode))
    assert at == pytest.approx(100.013, abs=1e-9)
    assert height == pytest.approx(1.0, abs=1e-9)
    error = resonance_error("a1", hertz, mode, 1.1 * mode)
    assert error.amplitude_error == pytest.approx(0.1)
    assert error.frequency_error == pytest.approx(0.0, abs=1e-12)
    band = np.abs(mode) >= math.sqrt(0.5)
    assert error.rms_error == pytest.approx(0.1 * np.sqrt(np.mean(np.abs(mode[band]) ** 2)))
    assert error.points == np.count_nonzero(band)
    folded = np.array([99.0, 100.0, 101.0, 100.5, 99.5, 101.0]), np.array([1, 2, 3, 2, 1, 0.5]) + 0j
    assert interpolate_curve(*folded, np.array([100.5, 98.0]))[0] == pytest.approx(2.5)
    assert np.isnan(interpolate_curve(*folded, np.array([98.0]))[0])


def test_along_a_response_curve_the_synthesis_is_the_forced_response_at_every_lag() -> None:
    """Of a Duffing oscillator in one-term balance both are explicit; beyond the backbone nothing is said."""
    stiffening, force, drive = 1e13, 30.0, 0.4
    lag = np.radians(np.linspace(20.0, 165.0, 30))
    q = []
    for angle in lag:  # of q: Ω from the lag, and the balance in quadrature, 2 δ ω Ω q = φ F sin ϑ

        def balance(log_q: float, angle: float = angle) -> float:
            q = math.exp(log_q)
            natural, decay = math.sqrt(OMEGA**2 + 0.75 * stiffening * q**2), DAMPING * OMEGA
            omega = brentq(
                lambda w: (natural**2 - w**2) * math.sin(angle) - 2.0 * w * decay * math.cos(angle), 0.2, 1e6
            )
            return 2.0 * omega * decay * q / (drive * force * math.sin(angle)) - 1.0

        q.append(math.exp(brentq(balance, math.log(1e-7), math.log(1e-2), xtol=1e-13)))
    amplitude = np.array(q)
    natural = np.sqrt(OMEGA**2 + 0.75 * stiffening * amplitude**2)
    # The larger root of Ω² + 2 Ω δ ω cot ϑ − ω̃² = 0.
    half = DAMPING * OMEGA / np.tan(lag)
    omega = np.sqrt(natural**2 + half**2) - half
    points = [
        ModalPoint(
            k, PointStatus.OK, "", force, "N", frequency_hz=w / (2 * np.pi), omega_rad_s=w, force_n=force,
            held_phase=a - 1.5,
            modal_amplitude=x, phase_error=a - 0.5 * np.pi, active_power=0.5 * w * drive * x * force * math.sin(a),
        )
        for k, (a, x, w) in enumerate(zip(lag, amplitude, omega, strict=True))
    ]  # fmt: skip
    (curve,) = response_curves(points)
    assert len(curve.folds) == 2
    found = compare_curve(backbone(np.geomspace(1e-6, 1e-2, 2000), stiffening), 1, curve)
    assert np.abs(found.frequency_error).max() < 1e-6
    assert np.abs(found.force_error).max() < 1e-6
    assert "30 of 30 points lie within the backbone" in found.sentence
    short = compare_curve(backbone(np.geomspace(amplitude.min() * 2.0, 1e-2, 500), stiffening), 1, curve)
    assert 0 < np.isnan(short.force_error).sum() < 30
