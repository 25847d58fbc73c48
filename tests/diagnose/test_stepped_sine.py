"""Frequency responses at held amplitudes: the prediction against closed forms and time integration; tables."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.ahead.frequency_sweep import frequency_sweep
from nmt_diagnose.effects.library import candidates, library
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.ledger.held_out import splits
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.stepped_reading import jumps_of, scatter_of_lines
from nmt_diagnose.measurements.stepped_responses import SteppedResponses, gain_error, whitened_difference
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward, traced
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

HZ, RATIO, CUBIC = 50.0, 0.01, 2.4e9
OMEGA = 2.0 * math.pi * HZ
DAMPER = 2.0 * RATIO * OMEGA
CHANNEL = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)

MODEL = f"""
name: one_mode
structure: {{kind: modal, modes: [{{frequency_hz: {HZ}, damping_ratio: {RATIO}, modal_mass_kg: 1.0}}]}}
"""
ON_TABLE = """
name: on_table
structure: {kind: modal, modes: [{frequency_hz: 50.0, damping_ratio: 0.01, modal_mass_kg: 1.0, participation: 1.5}]}
exciter: {kind: shaking_table, point: 1}
"""


def oscillator(cubic: float = 0.0, exciter: dict[str, object] | None = None) -> Rig:
    values: dict[str, object] = {
        "name": "one_mode",
        "structure": {
            "kind": "modal",
            "modes": [{"frequency_hz": HZ, "damping_ratio": RATIO, "modal_mass_kg": 1.0, "participation": 1.5}],
        },
        "exciter": exciter or {"kind": "force", "point": 1, "newton_per_volt": 1.0},
    }
    if cubic:
        values["local_elements"] = [{"kind": "cubic_spring", "point": 1, "stiffness_n_m3": cubic}]
    return validate_rig(RigDocument("test", values, {}))


def first_order(hz: float, force: float, cubic: float = CUBIC) -> list[complex]:
    """Displacement over force of the first-order harmonic balance of the Duffing oscillator, smallest first.

    With z = |x|², ((k − ω² + ¾ k₃ z)² + (c ω)²) z = F² (Nayfeh and Mook, Nonlinear Oscillations, section 4.1).
    """
    omega = 2.0 * math.pi * hz
    a, b = OMEGA**2 - omega**2, 0.75 * cubic
    roots = np.roots([b * b, 2.0 * a * b, a * a + (DAMPER * omega) ** 2, -(force**2)])
    real = sorted(float(z.real) for z in roots if abs(z.imag) < 1e-9 * abs(z) and z.real > 0.0)
    return [1.0 / (a + b * z + 1j * DAMPER * omega) for z in real]


def integrated(hz: float, force: float, start: complex, base: bool = False) -> complex:
    """Fundamental of the steady displacement over force (or acceleration of the base), from a start x, v."""
    omega = 2.0 * math.pi * hz
    load = -1.5 if base else 1.0

    def slope(t: float, y: FloatArray) -> list[float]:
        push = load * force * math.cos(omega * t)
        return [y[1], push - DAMPER * y[1] - OMEGA**2 * y[0] - CUBIC * y[0] ** 3]

    periods, samples = 150, 64
    stop = periods / hz
    times = stop + np.arange(samples) / samples / hz
    first = [start.real, -omega * start.imag]
    run = solve_ivp(slope, (0.0, times[-1]), first, t_eval=times, rtol=1e-9, atol=1e-12, method="DOP853")
    return complex(2.0 * np.mean(run.y[0] * np.exp(-1j * omega * times)) / force)


def swept(
    hz: FloatArray, force: float, measured: FloatArray, direction: int = 1, reference: str = "force"
) -> SteppedResponses:
    count = hz.size
    column = np.asarray(measured, dtype=np.complex128).reshape(count, 1)
    return SteppedResponses(
        f"{force:g} {direction}", 1, (CHANNEL,), reference, reference, hz, np.full(count, force), column,
        np.full(count, 5e-3), direction,
    )  # fmt: skip


def observations_of(tests: list[SteppedResponses], std: float = 5e-3) -> Observations:
    rows = []
    for number, test in enumerate(tests):
        for part in (Part.LOG_MAGNITUDE, Part.PHASE):
            for line, (hz, h) in enumerate(zip(test.lines_hz, test.measured[:, 0], strict=True)):
                value = math.log(abs(h)) if part is Part.LOG_MAGNITUDE else float(np.angle(h))
                rows.append((number, line, 0, 1, int(part), 0.0, hz, test.levels[line], value))
    table = np.array(rows)
    whole = [table[:, k].astype(np.int64) for k in range(5)]
    identity = Rows(*whole, table[:, 5], table[:, 6], table[:, 7])
    return Observations(tuple(tests), identity, table[:, 8], np.full(len(rows), std), np.full(len(rows), 2e-4))


def predicted(rig: Rig, test: SteppedResponses) -> np.ndarray:
    """Responses that the rows of a test say, its noise propagated about the rig itself."""
    own = observations_of([test])
    for _ in range(2):
        forward = Forward(own.tests, own.rows)
        prediction = forward.predict(rig)
        own = replace(own, tests=traced(own.tests, prediction))
    half = test.lines_hz.size
    return np.asarray(np.exp(prediction.values[:half] + 1j * prediction.values[half:]))


def test_a_linear_rig_has_the_closed_form() -> None:
    hz = np.linspace(45.0, 57.0, 25)
    exact = np.array([first_order(f, 1.0, 0.0)[0] for f in hz])
    # Whatever was measured, within what a linearisation in the logarithm allows: of a linear rig anything.
    found = predicted(oscillator(), swept(hz, 8.0, exact * 1.3 * np.exp(0.2j)))
    np.testing.assert_allclose(found, exact, rtol=1e-6)


def test_all_branches_of_a_duffing_oscillator_at_small_amplitude() -> None:
    # Weak enough that third harmonics, of relative size k₃ x² / 32 k, hardly act back.
    cubic, force = 2.4e9, 0.5
    for hz in (49.5, 50.2, 50.6):
        for exact in first_order(hz, force, cubic):
            found = predicted(oscillator(cubic), swept(np.array([hz]), force, np.array([exact])))[0]
            assert abs(found / exact - 1.0) < 2e-3


@pytest.mark.parametrize(("hz", "branch"), [(52.0, 0), (54.5, -1), (54.5, 0), (58.0, 0)])
def test_a_strongly_driven_duffing_oscillator_against_time_integration(hz: float, branch: int) -> None:
    force = 8.0
    exact = integrated(hz, force, force * first_order(hz, force)[branch])
    states = len(first_order(hz, force))
    assert states == (3 if hz == 54.5 else 1)
    found = predicted(oscillator(CUBIC), swept(np.array([hz]), force, np.array([exact])))[0]
    # What the first-order closed form is off by here shows that this is not a small amplitude.
    assert abs(found / exact - 1.0) < 2e-4
    if branch == -1:
        assert abs(force * exact) ** 2 * CUBIC > 0.2 * OMEGA**2


def test_a_moving_base_against_time_integration() -> None:
    rig = oscillator(CUBIC, {"kind": "shaking_table", "point": 1})
    level, hz = 5.0, 52.0
    exact = integrated(hz, level, -1.5 * level * first_order(hz, 1.5 * level)[0], base=True)
    found = predicted(rig, swept(np.array([hz]), level, np.array([exact]), reference="base"))[0]
    assert abs(found / exact - 1.0) < 2e-4


def folds(force: float) -> tuple[float, float]:
    """Frequencies of the lower and upper fold of the first-order closed form, Hz."""
    hz = np.linspace(50.0, 60.0, 4001)
    three = hz[[len(first_order(f, force)) == 3 for f in hz]]
    return float(three[0]), float(three[-1])


@pytest.mark.campaign
def test_a_sweep_follows_its_branch_and_jumps_at_the_folds() -> None:
    force, hz = 5.0, np.linspace(48.0, 57.0, 91)
    low, high = folds(force)
    rig, largest = oscillator(CUBIC), 1.2 * force / (DAMPER * OMEGA)
    for direction, fold in ((1, high), (-1, low)):
        found = frequency_sweep(rig, swept(hz, force, np.ones(hz.size), direction), largest)
        assert len(found.jumps) == 1
        # The line after the fold; the third harmonic moves folds by some hundredths of a hertz.
        assert 0.0 < direction * (hz[found.jumps[0]] - fold) < 0.1 + 0.05
        inside = (hz > low + 0.1) & (hz < high - 0.1)
        branch = np.array([first_order(f, force)[-1 if direction > 0 else 0] for f in hz[inside]])
        np.testing.assert_allclose(np.abs(found.responses[inside]), np.abs(branch), rtol=0.02)


def test_sensitivities_are_those_of_solutions() -> None:
    test = swept(np.array([50.5, 52.0, 54.0]), 5.0, np.array([first_order(f, 5.0)[-1] for f in (50.5, 52.0, 54.0)]))
    own = observations_of([test])
    rig = oscillator(CUBIC)
    own = replace(own, tests=traced(own.tests, Forward(own.tests, own.rows).predict(rig)))
    forward = Forward(own.tests, own.rows)
    known = candidates(oscillator(), operating_range(oscillator(), own.tests), withheld(("cubic_stiffness",)))
    parametrisation = Parametrisation(oscillator(), (), known)
    scale = known[0].site.scales["k"]
    theta = np.array([CUBIC / scale])
    prediction = forward.predict(parametrisation.rig(theta))
    column = forward.jacobian(parametrisation, theta, prediction)[:, 0]
    step = 1e-4 * theta[0]
    ends = [forward.predict(parametrisation.rig(theta + d)).values for d in (-step, step)]
    np.testing.assert_allclose(column, (ends[1] - ends[0]) / (2.0 * step), rtol=1e-3, atol=1e-8)


def test_noise_of_the_amplitude_is_propagated() -> None:
    """Responses of a steep and of a folding course: rows scatter as the response does, never more."""
    generator = np.random.default_rng(1)
    noise = 1e-3 * generator.standard_normal((2, 4000))
    for slope, turn in ((8.0, 3.0), (1.0, 0.0), (0.1, 2.0), (-4.0, 1.0)):
        growth = np.full(4000, slope - 1j * turn)
        # ln of measured over modelled response at the measured amplitude, whose error is that of the magnitude.
        rest = slope * noise[0] + 1j * (noise[1] - turn * noise[0])
        left = whitened_difference(rest[:, None], growth)[:, 0] / 1e-3
        assert np.std(left.real) == pytest.approx(min(abs(slope), 1.0), rel=0.05)
        assert np.std(left.imag) < 1.05
        if abs(slope) >= 1.0:
            assert np.std(left.imag) == pytest.approx(1.0, rel=0.05)
            assert abs(np.corrcoef(left.real, left.imag)[0, 1]) < 0.05


# -- tables ------------------------------------------------------------------------------------------------------------


def imported(folder: Path, files: dict[str, str], segments: str, model: str = MODEL) -> Path:
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "sidecar.yaml").write_text(
        f"rig: one_mode\nfile: {next(iter(files))}\nsegments:\n{segments}", encoding="utf-8"
    )
    return write_import(read_import(folder / "sidecar.yaml"), folder / "bag", "one_mode", model, {})


def lines_of(hz: FloatArray, response: np.ndarray, more: str = "") -> str:
    return "".join(f"{f!r},{h.real!r},{h.imag!r}{more}\n" for f, h in zip(hz.tolist(), response.tolist(), strict=True))


HEAD = "frequency_hz,real,imag"


def upper(hz: FloatArray, force: float) -> np.ndarray:
    """Responses of a rising sweep."""
    return np.array([first_order(f, force)[-1] for f in hz])


def rig_from(text: str, folder: Path) -> Rig:
    from nmt_rig.rig import load_rig

    path = folder / "model.yaml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


@pytest.mark.campaign
def test_noise_turns_the_phase_of_a_strong_nonlinearity_by_more_than_its_first_order() -> None:
    """1.5 % of the amplitude moves the resonance by its half width: what is left of the true rig is noise all the same.

    The measured responses are integrated; the model is the rig itself.
    """
    force, noise = 70.0, 0.015
    hz = np.linspace(58.0, 76.0, 13)
    exact, start = [], 0.004 + 0.0j
    for f in hz:
        exact.append(integrated(float(f), force, start))
        start = exact[-1] * force
    size = force * np.abs(exact)
    assert np.max(1.5 * CUBIC * size**2 * noise) > DAMPER * 2.0 * math.pi * hz[-1]
    rig = oscillator(CUBIC)

    def left(seed: int, moves: bool) -> float:
        generator = np.random.default_rng(seed)
        scatter = noise * (generator.standard_normal(hz.size) + 1j * generator.standard_normal(hz.size))
        test = replace(swept(hz, force, np.array(exact) * (1.0 + scatter)), noise=np.full(hz.size, noise))
        own = observations_of([test], noise)
        for _ in range(6):
            tests = traced(own.tests, Forward(own.tests, own.rows).predict(rig))
            own = replace(own, tests=tests if moves else tuple(replace(each, moved=None) for each in tests))
        rest = (own.values - Forward(own.tests, own.rows).predict(rig).values) / noise
        return float(np.mean(rest**2))

    assert np.mean([left(seed, True) for seed in range(20)]) == pytest.approx(1.0, abs=0.2)
    assert np.mean([left(seed, False) for seed in range(20)]) > 3.0


def test_a_column_of_levels_makes_a_test_for_each(tmp_path: Path) -> None:
    hz = np.linspace(46.0, 58.0, 61)
    text = f"{HEAD},level\n" + "".join(lines_of(hz, upper(hz, f), f",{1000 * f!r}") for f in (0.5, 2.0, 5.0))
    segment = "  - {kind: frf, unit: m/N, point: 1, drive_point: 1, level_unit: mN, direction: up, noise: 0.5}\n"
    observations = read_observations([imported(tmp_path, {"a.csv": text}, segment)], rig_from(MODEL, tmp_path))
    tests = [test for test in observations.tests if isinstance(test, SteppedResponses)]
    assert [float(np.median(test.levels)) for test in tests] == pytest.approx([0.5, 2.0, 5.0])
    assert {(test.held, test.reference, test.direction) for test in tests} == {("force", "force", 1)}
    np.testing.assert_allclose(observations.std, 5e-3)
    assert max(test.lines_hz.size for test in tests) <= 40
    # The jump down from the upper branch of the highest level is seen, and its lines are left out.
    high = folds(5.0)[1]
    assert np.min(np.abs(tests[2].lines_hz - high)) > 0.05
    assert any("the response jumps between" in note for note in observations.notes)
    names = [split.name for split in splits(observations)]
    assert names == ["every second level", "the highest levels"]
    odd = splits(observations)[0].held_out
    assert set(observations.rows.test[odd]) == {1}


def test_the_measured_force_of_each_line_counts(tmp_path: Path) -> None:
    hz = np.linspace(46.0, 49.0, 13)
    force = np.linspace(1.0, 2.0, 13)
    response = np.array([first_order(f, p)[0] for f, p in zip(hz, force, strict=True)])
    rows = "".join(lines_of(hz[k : k + 1], response[k : k + 1], f",{float(force[k])!r}") for k in range(13))
    segment = "  - {kind: frf, unit: m/N, point: 1, drive_point: 1, direction: up}\n"
    bag = imported(tmp_path, {"a.csv": f"{HEAD},force_n\n" + rows}, segment)
    observations = read_observations([bag], rig_from(MODEL, tmp_path))
    test = observations.tests[0]
    assert isinstance(test, SteppedResponses)
    np.testing.assert_allclose(test.levels, force)
    np.testing.assert_allclose(test.amplitudes, np.abs(response) * force)


def test_levels_in_g_of_a_moving_base_and_of_a_response(tmp_path: Path) -> None:
    hz = np.linspace(46.0, 49.0, 13)
    text = f"{HEAD}\n" + lines_of(hz, upper(hz, 0.5))
    rig = rig_from(ON_TABLE, tmp_path)
    base = "  - {kind: frf, unit: g/g, point: 1, drive_point: 1, level: 0.1, level_unit: g, direction: up}\n"
    test = read_observations([imported(tmp_path, {"a.csv": text}, base, ON_TABLE)], rig).tests[0]
    assert isinstance(test, SteppedResponses)
    assert (test.reference, test.held) == ("base", "base")
    np.testing.assert_allclose(test.levels, 0.980665)
    (tmp_path / "other").mkdir()
    held = "  - {kind: frf, unit: m/s^2/N, point: 1, drive_point: 1, level: 0.2, level_unit: mm}\n"
    test = read_observations([imported(tmp_path / "other", {"a.csv": text}, held)], rig_from(MODEL, tmp_path)).tests[0]
    assert isinstance(test, SteppedResponses)
    assert test.held == "response"
    np.testing.assert_allclose(test.amplitudes, 2e-4 * (2.0 * np.pi * test.lines_hz) ** 2)


def test_what_is_assumed_is_said_and_what_cannot_be_is_refused(tmp_path: Path) -> None:
    hz = np.linspace(46.0, 49.0, 13)
    text = f"{HEAD}\n" + lines_of(hz, upper(hz, 0.5))
    rig = rig_from(MODEL, tmp_path)
    plain = "  - {kind: frf, unit: m/N, point: 1, drive_point: 1, level: 0.5}\n"
    notes = " ".join(read_observations([imported(tmp_path, {"a.csv": text}, plain)], rig).notes)
    assert "taken as the amplitude of the force in N" in notes
    assert "does not say whether the frequency rose or fell" in notes
    for number, (segment, message) in enumerate(
        (
            ("unit: m/N, level: 0.5, level_unit: V", "the voltage was held"),
            ("unit: g/g, level: 0.1, level_unit: g", "not a shaking table"),
        )
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        bag = imported(folder, {"a.csv": text}, f"  - {{kind: frf, point: 1, drive_point: 1, {segment}}}\n")
        with pytest.raises(BenchError, match=message):
            read_observations([bag], rig)


def test_a_coherence_is_that_of_noise(tmp_path: Path) -> None:
    hz = np.linspace(46.0, 49.0, 13)
    text = f"{HEAD},coherence\n" + lines_of(hz, upper(hz, 0.5), ",0.99")
    segment = "  - {kind: frf, unit: m/N, point: 1, drive_point: 1, level: 0.5, level_unit: N}\n"
    observations = read_observations([imported(tmp_path, {"a.csv": text}, segment)], rig_from(MODEL, tmp_path))
    assert isinstance(observations.tests[0], RandomResponses)


def test_imported_windows_of_a_stepped_sine_are_a_frequency_response(tmp_path: Path) -> None:
    rate, each, samples = 2000.0, 1.0, 2000
    hz = np.concatenate([np.linspace(48.0, 54.0, 9), np.linspace(54.0, 48.0, 9)])
    generator = np.random.default_rng(2)
    force, motion = [], []
    exact = [first_order(f, 5.0)[-1 if k < 9 else 0] for k, f in enumerate(hz)]
    for f, h in zip(hz, exact, strict=True):
        turning = np.exp(2j * np.pi * f * np.arange(samples) / rate + 0.4j)
        force.append(np.real(5.0 * turning) + 0.01 * generator.standard_normal(samples))
        motion.append(np.real(5.0 * h * turning) + 1e-6 * generator.standard_normal(samples))
    np.savez(tmp_path / "data.npz", f=np.concatenate(force), x=np.concatenate(motion))
    segments = "".join(
        f"  - {{kind: stepped_sine, start: {k * each}, stop: {(k + 1) * each}, window: [{k * each}, {(k + 1) * each}], "
        f"level: 5, level_unit: N}}\n"
        for k in range(hz.size)
    )
    (tmp_path / "sidecar.yaml").write_text(
        f"rig: one_mode\nsample_rate: {rate}\nfile: data.npz\nchannels:\n"
        "  - {column: f, quantity: force, unit: N, point: 1}\n"
        f"  - {{column: x, quantity: displacement, unit: m, point: 1}}\nsegments:\n{segments}",
        encoding="utf-8",
    )
    bag = write_import(read_import(tmp_path / "sidecar.yaml"), tmp_path / "bag", "one_mode", MODEL, {})
    observations = read_observations([bag], rig_from(MODEL, tmp_path))
    tests = [test for test in observations.tests if isinstance(test, SteppedResponses)]
    assert [test.direction for test in tests] == [1, -1]
    for test, mine in zip(tests, (hz[:9], hz[9:]), strict=True):
        assert (test.held, test.reference) == ("force", "force")
        np.testing.assert_allclose(test.levels, 5.0, rtol=2e-3)
        branch = -1 if test.direction > 0 else 0
        want = np.array([first_order(f, 5.0)[branch] for f in test.lines_hz])
        assert np.max(np.abs(test.measured[:, 0] / want - 1.0) / test.noise) < 5.0
        assert set(np.round(test.lines_hz, 3)) <= set(np.round(mine, 3))
    # Up and down differ where there are two branches, and one jump each is left out.
    assert sum("the response jumps between" in note for note in observations.notes) == 2


def test_a_noise_that_all_lines_have_is_seen_where_the_response_is_small() -> None:
    hz, generator = np.linspace(20.0, 200.0, 300), np.random.default_rng(5)
    modes = ((1.0, 40.0), (0.7, 95.0), (-0.4, 160.0))
    response = sum(-(hz**2) * a / (f**2 - hz**2 + 0.02j * f * hz) for a, f in modes)
    noise = generator.standard_normal((4, hz.size))
    noisy = response * (1.0 + 0.005 * (noise[0] + 1j * noise[1])) + 0.02 * (noise[2] + 1j * noise[3])
    relative, common = scatter_of_lines(hz, noisy)
    stated, true = np.hypot(relative, common / np.abs(response)), np.hypot(0.005, 0.02 / np.abs(response))
    for few in (np.abs(response) < np.quantile(np.abs(response), 0.1), np.abs(response) > 2.0):
        assert 0.7 < float(np.median(stated[few] / true[few])) < 1.5
    assert scatter_of_lines(hz, response * (1.0 + 0.005 * (noise[0] + 1j * noise[1])))[1] == 0.0


def test_scatter_and_jumps_are_seen_in_the_lines() -> None:
    hz = np.linspace(46.0, 58.0, 241)
    response = upper(hz, 8.0)
    generator = np.random.default_rng(3)
    noise = generator.standard_normal((2, hz.size))
    noisy = response * np.exp(6e-3 * (noise[0] + 1j * noise[1]))
    assert scatter_of_lines(hz, noisy) == (pytest.approx(6e-3, rel=0.2), 0.0)
    ((first, last),) = jumps_of(noisy)
    assert last == first + 1
    assert hz[first] <= folds(8.0)[1] <= hz[last]
    # The line behind a jump may stand between the branches: it had not settled.
    between = np.insert(noisy, last, np.sqrt(noisy[first] * noisy[last]))
    assert jumps_of(between) == [(first, first + 2)]
    # A linear resonance turns as fast and does not jump.
    assert jumps_of(np.array([first_order(f, 1.0, 0.0)[0] for f in hz])) == []


@pytest.mark.parametrize("off", [(0,), (1,), (0, 1)])
def test_an_error_of_a_gain_moves_the_rows_as_a_recording_that_has_it(off: tuple[int, ...]) -> None:
    """A displacement, which is the amplitude of the lines, and an acceleration, on a cubic resonance; both: the force.

    The amplitude that the model has stays: an error of that is one of the cubic spring.
    """
    hz = np.linspace(47.0, 52.0, 21)
    x = np.array([first_order(f, 1.0)[-1] for f in hz])
    channels = (CHANNEL, MeasuredChannel("a1", Quantity.ACCELERATION, 1))
    plain = replace(swept(hz, 1.0, x), channels=channels, measured=np.stack([x, -((2.0 * np.pi * hz) ** 2) * x], 1))
    lines, count = np.arange(hz.size), hz.size
    parts = [(channel, part) for channel in range(2) for part in (Part.LOG_MAGNITUDE, Part.PHASE)]
    level, channel = np.tile(lines, 4), np.repeat([c for c, _ in parts], count)
    part = np.repeat([int(p) for _, p in parts], count)
    zeros = np.zeros(4 * count, dtype=np.int64)
    rows = Rows(zeros, level, channel, zeros + 1, part, np.zeros(4 * count), hz[level], np.ones(4 * count))
    rig = oscillator(CUBIC)

    def left(test: SteppedResponses) -> FloatArray:
        forward, seen = Forward((test,), rows), test.measured[level, channel]
        values = np.where(part == Part.PHASE, np.angle(seen), np.log(np.abs(seen)))
        return forward.difference(values, forward.predict(rig).values)

    prediction = Forward((plain,), rows).predict(rig)
    test = replace(traced((plain,), prediction)[0], noise=np.full(count, 1.0))
    assert isinstance(test, SteppedResponses)
    gain = 1.0 + 1e-5 * np.isin([0, 1], off)
    changed = replace(test, measured=test.measured * gain, scale=1.0 / gain[0])
    found = (left(changed) - left(test)) / 1e-5
    error = gain_error(test, None if len(off) == 2 else off[0])[level, channel]
    np.testing.assert_allclose(found, np.where(part == Part.PHASE, error.imag, error.real), atol=2e-3)
    assert np.abs(error.imag).max() > 0.1 if 0 in off else not np.abs(error[channel == 0]).any()


# -- diagnosis ---------------------------------------------------------------------------------------------------------


def withheld(known: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(effect.name for effect in library() if effect.name not in known)
