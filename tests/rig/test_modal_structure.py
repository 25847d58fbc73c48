"""A structure given by its modes behaves as the beam that the modes are taken from; files say the same."""

from __future__ import annotations

import numpy as np
import pytest
import pyuff

from nmt_core.errors import BenchError
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import acceleration_output, assemble, displacement_output, velocity_output
from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.epmc import epmc_backbone
from nmt_rig.model.forced_response import ForcedProblem, frequency_response
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.local_elements.springs import CubicSpring
from nmt_rig.model.modal_structure import Mode, modal_structure
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.structure import Structure
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.reference import compute_reference
from nmt_rig.rig import load_rig
from nmt_rig.rig_file_edit import edited_rig_text
from nmt_rig.rig_snapshot import rig_text

SHAKER = ElectrodynamicShaker(0.024, 20707.0, 28.33, 0.019, 8.42e6, 57.17, 15.48, 140e-6, 3.0)


@pytest.fixture(scope="module")
def beam() -> Structure:
    return euler_bernoulli_beam(0.7, 0.02, 0.008, 185e9, 7830.0, 5, 2e-6)


@pytest.fixture(scope="module")
def modal(beam: Structure) -> Structure:
    """All modes of the beam, their shapes at points 2, 4 and 5 in scales of their own."""
    return model_of(beam, (2, 4, 5))


def model_of(beam: Structure, points: tuple[int, ...]) -> Structure:
    modes = sticking_modes(beam)
    rows = [modes.points.index(point) for point in points]
    entries = []
    for k, (omega, ratio) in enumerate(zip(modes.frequencies, modes.damping_ratios, strict=True)):
        scale = 0.3 + 0.7 * k
        participation = float(modes.full_shapes[:, k] @ beam.base_load) / scale
        entries.append(Mode(omega, ratio, tuple(scale * modes.shapes[rows, k]), scale**2, participation))
    return modal_structure(points, entries)


def test_frequencies_damping_and_shapes_are_the_beams(beam, modal):
    ours, theirs = sticking_modes(modal), sticking_modes(beam)
    np.testing.assert_allclose(ours.frequencies, theirs.frequencies, rtol=1e-10)
    np.testing.assert_allclose(ours.damping_ratios, theirs.damping_ratios, rtol=1e-6)
    np.testing.assert_allclose(np.abs(ours.shapes), np.abs(theirs.shapes[[1, 3, 4]]), rtol=1e-6, atol=1e-9)
    assert ours.points == (2, 4, 5)


@pytest.mark.parametrize("shaker", [None, SHAKER])
def test_responses_are_the_beams(beam, modal, shaker):
    one, other = (assemble(structure, [], 4, shaker) for structure in (modal, beam))
    for frequency in (30.0, 300.0, 5000.0):
        q, force = one.response(frequency)
        p, expected = other.response(frequency)
        for point in (2, 4, 5):
            np.testing.assert_allclose(one.motion(point, q), other.motion(point, p), rtol=1e-8)
        np.testing.assert_allclose(force, expected, rtol=1e-6)


@pytest.mark.parametrize("shaker", [None, SHAKER])
def test_time_integration_is_the_beams(beam, modal, shaker):
    def run(structure):
        element = CubicSpring(structure.direction(5, 2), 1e9)
        system = assemble(structure, [element], 4, shaker)
        outputs = [
            displacement_output(system, 5),
            velocity_output(system, 2),
            acceleration_output(system, 4),
            system.force,
        ]
        integrator = TimeIntegrator(system, 20000.0, outputs)
        return integrator.advance(20.0 * np.sin(2.0 * np.pi * 90.0 * np.arange(4001) / 20000.0))

    ours, theirs = run(modal), run(beam)
    largest = np.abs(theirs).max(axis=1, keepdims=True)
    np.testing.assert_allclose(ours / largest, theirs / largest, rtol=0.0, atol=1e-7)


def test_nonlinear_mode_and_forced_response_are_the_beams(beam, modal):
    amplitudes = np.geomspace(1e-5, 1e-3, 8)

    def elements(structure):
        return [CubicSpring(structure.direction(5), 2e9)]

    ours, theirs = (epmc_backbone(s, elements(s), amplitudes, FourierBasis.up_to(5)) for s in (modal, beam))
    np.testing.assert_allclose(ours.omega_rad_s, theirs.omega_rad_s, rtol=1e-7)
    np.testing.assert_allclose(ours.damping_ratio, theirs.damping_ratio, rtol=1e-5)
    assert ours.omega_rad_s[-1] > 1.05 * ours.omega_rad_s[0]

    start = sticking_modes(beam, [], 1).frequencies[0]

    def peak(structure):
        problem = ForcedProblem(assemble(structure, elements(structure), 4, None), FourierBasis.up_to(3), float(start))
        curve = frequency_response(problem, 0.5, 0.9 * start, 1.2 * start)
        return max(abs(problem.system.motion(5, r.unknowns[problem.basis.fundamental])) for r in curve.responses)

    assert peak(modal) == pytest.approx(peak(beam), rel=1e-6)


def test_masses_at_points_are_the_beams(beam, modal):
    added = [(5, 0.05), (2, 0.01)]
    np.testing.assert_allclose(
        sticking_modes(modal.with_masses(added)).frequencies,
        sticking_modes(beam.with_masses(added)).frequencies,
        rtol=1e-9,
    )
    q, _ = assemble(modal.with_masses(added), [], 4).response(100.0)
    assert np.isfinite(q).all()


def test_the_residual_makes_up_for_modes_that_are_left_out(beam):
    points = (2, 4, 5)
    few = sticking_modes(beam, [], 2)
    rows = [few.points.index(point) for point in points]
    static = np.array(
        [[np.linalg.solve(beam.stiffness, beam.selector(b)) @ beam.selector(a) for b in points] for a in points]
    )
    kept = (few.shapes[rows] / few.frequencies**2) @ few.shapes[rows].T
    modes = [
        Mode(omega, ratio, tuple(few.shapes[rows, k]))
        for k, (omega, ratio) in enumerate(zip(few.frequencies, few.damping_ratios, strict=True))
    ]
    bare = modal_structure(points, modes)
    whole = modal_structure(points, modes, static - kept, 2.0 * np.pi * 20000.0)

    def response(structure, frequency):
        system = assemble(structure, [], 2)
        return np.array([system.motion(point, system.response(frequency)[0]) for point in points])

    np.testing.assert_allclose(response(whole, 0.0), static[0], rtol=1e-10)
    assert np.max(np.abs(response(bare, 0.0) / static[0] - 1.0)) > 1e-3
    # Between the modes: within 1 % of the beam, where the two modes alone are 5 % off at the drive point.
    between = 0.5 * float(few.frequencies.sum())
    exact = response(beam, between)
    assert abs(response(whole, between)[0] / exact[0] - 1.0) < 0.5 * abs(response(bare, between)[0] / exact[0] - 1.0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"modes": ()}, "at least one mode"),
        ({"points": (1, 1)}, "differ from each other"),
        ({"modes": (Mode(10.0, 0.01, (1.0,)),)}, "must have 2 entries"),
        ({"modes": (Mode(10.0, 0.01, (1.0, 0.0), 0.0),)}, "positive modal mass"),
        ({"residual_flexibility": np.array([[1.0, 0.5], [0.0, 1.0]])}, "symmetric"),
        ({"residual_flexibility": np.array([[1.0, 2.0], [2.0, 1.0]])}, "negative eigenvalues"),
        ({"residual_flexibility": np.eye(2), "residual_frequency": 5.0}, "lie above"),
        ({"residual_flexibility": np.eye(3)}, "2 x 2"),
    ],
)
def test_modes_that_make_no_structure_are_refused(change, says):
    settings = {"points": (1, 2), "modes": (Mode(10.0, 0.01, (1.0, 0.5)),), "residual_frequency": 100.0} | change
    with pytest.raises(ValueError, match=says):
        modal_structure(**settings)


ONE_MODE = """name: one_mode
structure: {kind: modal, modes: [{frequency_hz: 133.1, damping_ratio: 0.0035, modal_mass_kg: 1.0}]}
test: {levels: "0.01:1:5"}
"""


def test_three_lines_are_a_rig(tmp_path):
    file = tmp_path / "one.yaml"
    file.write_text(ONE_MODE)
    rig = load_rig(file)
    assert [rig.sensor_channel(sensor) for sensor in rig.sensors] == ["f1", "x1", "a1", "u"]
    linear = linear_description(rig)
    assert linear.frequency_hz == pytest.approx(133.1, rel=1e-12)
    assert linear.damping_ratios == (pytest.approx(0.0035, rel=1e-12),)
    assert linear.shapes == ((pytest.approx(1.0),),)
    # 1 N at resonance: x = F / (2 ζ m ω²).
    omega = 2.0 * np.pi * 133.1
    assert linear.displacement_per_volt == pytest.approx(1.0 / (2.0 * 0.0035 * omega**2), rel=1e-9)
    # What was left out can be changed like what was written.
    assert load_rig(file, ["exciter.newton_per_volt=3", "sensors.3.gain=2"]).exciter.newton_per_volt == 3.0
    # The rig that travels in a bag loads to the same rig.
    copy = tmp_path / "copy.yaml"
    copy.write_text(rig_text(rig))
    assert load_rig(copy) == rig
    copy.write_text(edited_rig_text(ONE_MODE, "one.yaml", load_rig(file, ["structure.modes.0.frequency_hz=140"])))
    assert load_rig(copy).structure.modes[0].frequency_hz == 140.0


def test_one_mode_with_a_cubic_is_duffings_oscillator(tmp_path):
    file = tmp_path / "one.yaml"
    file.write_text(ONE_MODE + "local_elements: [{kind: cubic_spring, point: 1, stiffness_n_m3: 5.0e11}]\n")
    reference = compute_reference(load_rig(file), modal_amplitudes=[1e-6, 1e-4, 3e-4])
    omega = 2.0 * np.pi * 133.1
    # One harmonic: ω² = ω₀² + ¾ k₃ q², and damping ζ ω₀ / ω. Higher harmonics change the frequency by less than 0.1 %.
    expected = np.sqrt(omega**2 + 0.75 * 5e11 * reference.modal_amplitude**2)
    np.testing.assert_allclose(reference.omega_rad_s, expected, rtol=1e-3)
    np.testing.assert_allclose(reference.damping_ratio, 0.0035 * omega / reference.omega_rad_s, rtol=3e-3)
    assert expected[-1] / expected[0] > 1.02


def load_modal(tmp_path, structure, more="", overrides=()):
    file = tmp_path / "rig.yaml"
    file.write_text(f"name: modal\nstructure: {{kind: modal, {structure}}}\n{more}")
    return load_rig(file, overrides)


def test_a_csv_table_gives_the_modes(tmp_path):
    (tmp_path / "modes.csv").write_text(
        "# from the hammer test\nfrequency_hz,damping_ratio,participation,point_3,point_7\n"
        "12.5,0.01,1.2,1.0,-0.4\n80,0.02,0.1,0.5,2\n"
    )
    rig = load_modal(tmp_path, "file: modes.csv")
    assert rig.structure.points == [3, 7]
    assert [mode.frequency_hz for mode in rig.structure.modes] == [12.5, 80.0]
    assert rig.structure.modes[1].shape == [0.5, 2.0]
    assert rig.structure.modes[0].participation == 1.2
    assert rig.structure.source.startswith("modes.csv (SHA-256 ")
    assert rig.extraction.linear_modes == 2
    # Read once: what travels needs no table, and what it holds can be changed.
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (moved / "rig.yaml").write_text(rig_text(rig, tmp_path / "rig.yaml"))
    assert load_rig(moved / "rig.yaml") == rig
    changed = load_modal(tmp_path, "file: modes.csv", "", ["structure.modes.0.damping_ratio=0.05"])
    assert changed.structure.modes[0].damping_ratio == 0.05
    chosen = load_modal(tmp_path, "file: modes.csv, points: [7]", "extraction: {linear_modes: 1}")
    assert chosen.structure.modes[0].shape == [-0.4]
    (moved / "new.yaml").write_text(edited_rig_text((tmp_path / "rig.yaml").read_text(), "rig.yaml", rig))
    assert load_rig(moved / "new.yaml") == rig


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("frequency,point_1\n1,1\n", "column 'frequency' is not one of them"),
        ("damping_ratio,point_1\n1,1\n", "frequency_hz is missing"),
        ("frequency_hz,point_1\n1\n", "row 1 has 1 values for 2 columns"),
        ("frequency_hz,point_1\n1,a\n", "not a number"),
        ("frequency_hz,point_1\n1,nan\n", "not finite"),
        ("frequency_hz,point_1\n", "a row for each mode"),
        ("frequency_hz,point_1\n-3,1\n", "frequency_hz must not be negative"),
    ],
)
def test_tables_that_are_wrong_are_named(tmp_path, table, says):
    (tmp_path / "modes.csv").write_text(table)
    with pytest.raises(BenchError, match=says):
        load_modal(tmp_path, "file: modes.csv")


@pytest.mark.parametrize(
    ("structure", "says"),
    [
        ("file: none.csv", "rig.yaml line 2: structure.file is none.csv, and there is no file"),
        ("modes: []", "needs modes"),
        (
            "points: [1, 2], modes: [{frequency_hz: 10}]",
            "modes.0.shape needs one entry for each of the 2 points, got 0",
        ),
        ("modes: [{frequency_hz: 10, shape: [0.0]}]", "must not be zero at all points"),
        ("modes: [{frequency_hz: -1}]", "frequency_hz must not be negative"),
        ("modes: [{frequency_hz: 10, damping_percent: 1}]", "unknown key structure.modes.0.damping_percent"),
        ("modes: [{frequency_hz: 10}], residual: {flexibility_m_n: [[1e-6]], frequency_hz: 5}", "lie above"),
        ("modes: [{frequency_hz: 10}], file: a.csv", "no file"),
        ("points: [4], modes: [{frequency_hz: 10}], added_masses: [{point: 1, mass_kg: 1}]", "has point 4 only"),
    ],
)
def test_modal_sections_that_are_wrong_are_named(tmp_path, structure, says):
    with pytest.raises(BenchError, match=says):
        load_modal(tmp_path, structure)


def write_uff(path, modes, analysis=2, data_type=2):
    """Data sets 55 as pyuff writes them; modes of (numbers, values of z at nodes 11 and 5)."""
    file = pyuff.UFF(str(path))
    for number, (numbers, z) in enumerate(modes, start=1):
        zero = np.zeros(2)
        file.write_sets(
            {
                "type": 55, "model_type": 1, "analysis_type": analysis, "data_ch": 2, "spec_data_type": 8,
                "data_type": data_type, "n_data_per_node": 3, "node_nums": np.array([11, 5]), "load_case": 0,
                "mode_n": number, "r1": zero * np.asarray(z), "r2": 0.1 * np.asarray(z), "r3": np.asarray(z), **numbers,
            },
            "add",
        )  # fmt: skip


def test_normal_modes_of_a_universal_file(tmp_path):
    write_uff(
        tmp_path / "modes.uff",
        [
            ({"freq": 95.5, "modal_m": 2.0, "modal_damp_vis": 0.012, "modal_damp_his": 0.0}, [0.3, -1.25]),
            ({"freq": 20.25, "modal_m": 0.5, "modal_damp_vis": 0.0, "modal_damp_his": 0.01}, [1.0, 0.5]),
        ],
    )
    section = load_modal(tmp_path, "file: modes.uff").structure
    assert section.points == [5, 11]
    assert [mode.frequency_hz for mode in section.modes] == [20.25, 95.5]
    assert [mode.modal_mass_kg for mode in section.modes] == [0.5, 2.0]
    assert [mode.damping_ratio for mode in section.modes] == [0.005, 0.012]
    assert [mode.shape for mode in section.modes] == [[0.5, 1.0], [-1.25, 0.3]]
    along_y = load_modal(tmp_path, "file: modes.uff, direction: y").structure
    np.testing.assert_allclose(along_y.modes[1].shape, [-0.125, 0.03], rtol=1e-5)
    with pytest.raises(BenchError, match="does not move in direction x"):
        load_modal(tmp_path, "file: modes.uff, direction: x")


def test_complex_modes_of_a_universal_file(tmp_path):
    """Modes of a real structure in another complex scale: a turns and grows with the square of the shape."""
    root = complex(-3.0, 250.0)
    scale = 2.0 * np.exp(0.7j)
    modal_a = 2j * root.imag * 1.6 * scale**2  # 1.6 kg in the scale of the real shape
    write_uff(
        tmp_path / "modes.uff",
        [({"eig": root, "modal_a": modal_a, "modal_b": 0j}, np.array([1.0, -0.4]) * scale)],
        analysis=3,
        data_type=5,
    )
    section = load_modal(tmp_path, "file: modes.uff, points: [11, 5]", "extraction: {linear_modes: 1}").structure
    mode = section.modes[0]
    assert mode.frequency_hz == pytest.approx(abs(root) / 2.0 / np.pi, rel=1e-5)
    assert mode.damping_ratio == pytest.approx(3.0 / abs(root), rel=1e-5)
    normalised = np.array(mode.shape) / np.sqrt(mode.modal_mass_kg)
    np.testing.assert_allclose(np.abs(normalised), np.array([1.0, 0.4]) / np.sqrt(1.6), rtol=1e-5)
    assert normalised[0] * normalised[1] < 0.0


def test_universal_files_that_do_not_serve_are_named(tmp_path):
    path = tmp_path / "modes.uff"
    path.write_text("    -1\n   151\nnothing\n    -1\n")
    with pytest.raises(BenchError, match="has no data set 55"):
        load_modal(tmp_path, "file: modes.uff")
    path.unlink()
    write_uff(path, [({"freq": 95.5, "modal_m": 0.0, "modal_damp_vis": 0.0, "modal_damp_his": 0.0}, [0.3, 1.0])])
    with pytest.raises(BenchError, match="mode 1 has no modal mass"):
        load_modal(tmp_path, "file: modes.uff")
    path.write_text(path.read_text()[:-200])
    with pytest.raises(BenchError, match=r"Dataset 1 of modes\.uff is cut off"):
        load_modal(tmp_path, "file: modes.uff")
    path.unlink()
    turning = np.array([1.0, 1j])
    write_uff(path, [({"eig": 1j, "modal_a": 1j, "modal_b": 0j}, turning)], analysis=3, data_type=5)
    with pytest.raises(BenchError, match="too complex"):
        load_modal(tmp_path, "file: modes.uff")
