"""Linear test with two exciters at once: closed form of two modes 2 % apart, noise, dependent inputs."""

from __future__ import annotations

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_extract.linear.evaluation import LinearTestResult
from nmt_extract.linear.file import description, frf_table, linear_mapping
from nmt_extract.linear.identification import linear_test
from nmt_extract.linear.results import LinearTestSettings
from nmt_record.windows.segments import Signals
from nmt_report.linear_report import coherence_remarks, linear_page
from nmt_signals.frequency_responses import averaged_spectra, frf_estimate

RATE, SECONDS = 2000.0, 24.0
FREQUENCIES, ZETA = np.array([100.0, 102.0, 260.0]), np.array([0.003, 0.004, 0.005])
SHAPES = np.array([[0.45, 0.55, 0.5], [0.6, -0.4, -0.4], [0.4, 0.5, -0.5]])
BAND = (20.0, 600.0)


def motion_of(forces, frequencies=FREQUENCIES):
    """Accelerations (points, samples) under forces (inputs, samples) that are straight between the samples.

    Each mode's equation is stepped by the matrix exponential of [η, η̇, f, ḟ], in the coordinates in which the matrix of
    η and η̇ is diagonal: two complex filters of first order.
    """
    from scipy.linalg import expm
    from scipy.signal import lfilter

    result = np.zeros((3, forces.shape[1]))
    for k in range(3):
        omega = 2 * np.pi * frequencies[k]
        modal = SHAPES[: forces.shape[0], k] @ forces
        matrix = np.zeros((4, 4))
        matrix[0, 1], matrix[1, 0], matrix[1, 1], matrix[1, 2] = 1.0, -(omega**2), -2 * ZETA[k] * omega, 1.0
        matrix[2, 3] = 1.0
        step = expm(matrix / RATE)[:2]
        roots, vectors = np.linalg.eig(step[:, :2])
        slope = np.diff(modal, append=modal[-1]) * RATE
        driven = np.linalg.solve(vectors, step[:, 2:] @ np.array([modal, slope]))
        filtered = [lfilter([0.0, 1.0], [1.0, -root], row) for root, row in zip(roots, driven, strict=True)]
        displacement, velocity = (vectors @ np.array(filtered)).real
        result += SHAPES[:, k : k + 1] * (modal - 2 * ZETA[k] * omega * velocity - omega**2 * displacement)
    return result


@pytest.fixture(scope="module")
def record():
    forces = noise_forces()
    return forces, motion_of(forces)


def noise_forces(seconds=SECONDS):
    samples = round(RATE * seconds)
    spectrum = np.fft.rfft(np.random.default_rng(5).standard_normal((2, samples)))
    lines = np.fft.rfftfreq(samples, 1.0 / RATE)
    spectrum[:, (lines < BAND[0]) | (lines > BAND[1])] = 0.0
    return np.fft.irfft(spectrum, samples)


def signals(forces, responses, noise=0.0):
    generator = np.random.default_rng(9)
    channels = {"f1": forces[0], "f2": forces[1], "u": 0.5 * forces[0], "u2": 0.25 * forces[1] + 0.1 * forces[0]}
    for row, values in enumerate(responses):
        channels[f"a{row + 1}"] = values + noise * values.std() * generator.standard_normal(values.size)
    kinds = {"f": Quantity.FORCE, "u": Quantity.VOLTAGE, "a": Quantity.ACCELERATION}
    points = {name: 0 if name[0] == "u" else int(name[1:]) for name in channels}
    quantities = {name: kinds[name[0]] for name in channels}
    units = {name: kind.unit for name, kind in quantities.items()}
    return Signals(RATE, 0, channels, units, points, quantities, None, ())


def evaluated(recorded, points=(1, 2), band=BAND, **asked):
    return linear_test(recorded, LinearTestSettings(points, Quantity.ACCELERATION, band, **asked))


@pytest.fixture(scope="module")
def clean(record):
    return evaluated(signals(*record), mode=2)


@pytest.mark.parametrize("noise", with_quick([0.0, 0.02], 0.02))
def test_both_modes_are_found(record, clean, noise):
    test = evaluated(signals(*record, noise), mode=2) if noise else clean
    found = np.array([(item.frequency_hz, item.damping_ratio, item.frequency_std) for item in test.modes]).T
    np.testing.assert_allclose(found[0], FREQUENCIES[:2], rtol=2e-5)
    np.testing.assert_allclose(found[1], ZETA[:2], rtol=0.005)
    np.testing.assert_allclose(test.shapes, SHAPES[:, :2], atol=0.005)
    assert (np.abs(found[0] - FREQUENCIES[:2]) < 4.0 * found[2] + 5e-4).all()
    described = description(test)
    assert described.exciter_points == (1, 2)
    assert described.target_mode == 1
    # u1 = 0.5 f1 and u2 = 0.25 f2 + 0.1 f1: f1 = 2 u1, f2 = 4 u2 − 0.8 u1.
    per_volt = test.force_per_volt()[0]
    np.testing.assert_allclose(per_volt, np.broadcast_to([[2.0, 0.0], [-0.8, 4.0]], per_volt.shape), atol=1e-6)
    # Forces that isolate the mode are orthogonal to the other one's shape at the exciters; the first is 2 u1.
    assert described.force_per_volt == pytest.approx(2.0, rel=1e-3)
    assert LinearDescription.from_mapping(linear_mapping(test)) == described


def test_modes_closer_than_the_averages_can_tell_are_told_apart():
    close = np.array([100.0, 100.6, 260.0])
    forces = noise_forces()
    test = evaluated(signals(forces, motion_of(forces, close)))
    np.testing.assert_allclose([mode.frequency_hz for mode in test.modes], close[:2], rtol=2e-5)
    np.testing.assert_allclose([mode.damping_ratio for mode in test.modes], ZETA[:2], rtol=0.01)
    np.testing.assert_allclose(test.shapes, SHAPES[:, :2], atol=0.01)


def test_without_voltages_the_forces_are_the_inputs(record):
    recorded = signals(*record)
    for name in ("u", "u2"):
        del recorded.channels[name], recorded.quantities[name]
    test = evaluated(recorded)
    assert test.reference == "force"
    np.testing.assert_allclose([mode.frequency_hz for mode in test.modes], FREQUENCIES[:2], rtol=2e-5)
    np.testing.assert_allclose(test.shapes, SHAPES[:, :2], atol=0.005)
    described = description(test)
    assert described.exciter_points == ()
    assert np.isnan(described.force_per_volt)


def test_segment_and_band_count(record):
    test = evaluated(signals(*record, 0.02), band=(30.0, 400.0), segment_s=2.0, near_hz=102.0)
    assert test.frequency_hz[0] == 30.0
    assert test.frequency_hz[1] - test.frequency_hz[0] == pytest.approx(0.5)
    assert test.frequency_hz[-1] == 400.0
    assert test.target == 1


def test_responses_and_coherence_are_those_of_each_input(record):
    forces, responses = record
    generator = np.random.default_rng(2)
    noisy = 3.0 * forces[1] + generator.standard_normal(forces.shape[1])
    channels = {"f1": forces[0], "f2": forces[1], "a": responses[0], "b": noisy}
    channels |= {"u": 0.5 * forces[0], "u2": 0.25 * forces[1] + 0.1 * forces[0]}
    spectra = averaged_spectra(channels, RATE, 8000, BAND)
    away = np.abs(spectra.frequency_hz - 160.0) < 20.0
    s = 2j * np.pi * spectra.frequency_hz[away]
    poles = [s * s / (s * s + 2 * z * w * s + w * w) for w, z in zip(2 * np.pi * FREQUENCIES, ZETA, strict=True)]
    coherences = []
    for column, (name, other) in enumerate([("f1", "f2"), ("f2", "f1")]):
        voltages = ("u", ("u2",)) if column == 0 else ("u2", ("u",))
        frf = frf_estimate(spectra, name, ("a", "b"), voltages[0], (other,), voltages[1])
        exact = sum(SHAPES[0, k] * SHAPES[column, k] * poles[k] for k in range(3))
        for estimate in (frf.h1, frf.h2, frf.hv, frf.hc):
            np.testing.assert_allclose(estimate[0, away], exact, rtol=0.06, atol=0.01)
        # The whole matrix at once, S_xf S_ff⁻¹ and S_xu S_fu⁻¹, says the same.
        for estimate, by in ((frf.h1, ("f1", "f2")), (frf.hc, ("u", "u2"))):
            cross = np.array([[spectra.cross(row, at) for at in by] for row in ("a", "b")])
            inputs = np.array([[spectra.cross(row, at) for at in by] for row in ("f1", "f2")])
            matrix = np.einsum("xjl,ljf->xfl", cross, np.linalg.inv(inputs.transpose(2, 0, 1)))
            np.testing.assert_allclose(estimate, matrix[:, column], rtol=1e-7)
        coherences.append(frf.coherence)
    assert coherences[0][0].mean() > 0.97
    assert np.median(coherences[0][1]) < 0.1  # b knows nothing of f1
    assert np.median(coherences[1][1]) > 0.5


def test_inputs_that_depend_on_each_other_are_refused(record):
    forces, responses = record
    same = np.array([forces[0], 2.0 * forces[0]])
    with pytest.raises(BenchError, match="not independent"):
        evaluated(signals(same, responses))


@pytest.mark.parametrize("inverted", with_quick(["12", "1", "2"], "2"))
def test_an_inverted_force_is_refused(record, inverted):
    forces, responses = record[0].copy(), record[1]
    recorded = signals(forces, responses)
    for number in inverted:
        recorded.channels[f"f{number}"] = -forces[int(number) - 1]
    with pytest.raises(BenchError, match="wrong sign"):
        evaluated(recorded)


def test_a_voltage_is_recorded_for_every_exciter(record):
    recorded = signals(*record)
    del recorded.channels["u2"], recorded.quantities["u2"]
    with pytest.raises(BenchError, match="1 voltages for 2 exciters"):
        evaluated(recorded)


def test_table_and_page_have_every_input(clean):
    test = clean
    head, *rows = frf_table(test).splitlines()
    columns = head.split(",")
    assert len(rows) == test.frequency_hz.size
    for name in ("a3_f1_hc_real", "a3_f2_hc_real", "a3_f2_coherence", "f1_u_h1_real", "f2_u_h1_imag", "a1_u2_h1_real"):
        assert name in columns
    first = dict(zip(columns, map(float, rows[40].split(",")), strict=True))
    assert first["a3_f2_hc_real"] == pytest.approx(test.force_frfs[1].hc[2, 40].real, rel=1e-8)
    page = linear_page(LinearTestResult(test, 1.0, None, {"rig": "pair", "run_id": "two-shakers"}, ()))
    for text in ("two-shakers", "points 1, 2", "Receptance of point 3", "force at point 2", "exciter at point 2"):
        assert text in page


def test_a_low_partial_coherence_is_named_with_its_input(clean):
    test = clean
    assert not [line for line in coherence_remarks(test) if "point 3" in line]
    test.force_frfs[1].coherence[2] = 0.4
    (sentence,) = (line for line in coherence_remarks(test) if "point 3" in line)
    assert sentence.startswith("The partial coherence of point 3 with the exciter at point 2 is 0.40")
