"""A structure given by matrices is the beam they were exported from; reduction keeps statics and low modes."""

from __future__ import annotations

import numpy as np
import pytest
from matrix.element_structures import FIRST_HZ, STRUCTURES
from scipy import io, sparse
from scipy.linalg import eigh
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_rig.linear_description import linear_description
from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.linear_modes import modal_damping_matrix, sticking_modes
from nmt_rig.model.matrix_structure import TRUNCATION, Matrices, condensed, craig_bampton
from nmt_rig.reference import compute_reference
from nmt_rig.rig import load_rig
from nmt_rig.rig_file_edit import edited_rig_text
from nmt_rig.rig_model import build_structure
from nmt_rig.rig_snapshot import rig_text

BEAM = load_rig("beam")


@pytest.fixture(scope="module")
def beam():
    return build_structure(BEAM)


def rig_of(tmp_path, structure, overrides=()):
    """The shipped beam's rig with matrices for its structure."""
    text = rig_text(BEAM, None, ["x=y"])
    start, end = text.index("structure:"), text.index("local_elements:")
    file = tmp_path / "rig.yaml"
    file.write_text(f"{text[:start]}structure: {{kind: matrices, {structure}}}\n{text[end:]}")
    return load_rig(file, overrides)


def points_at(beam, rotations=False):
    entries = []
    for point, row in beam.points.items():
        rotation = f", rotation_row: {beam.rotations[point]}" if rotations else ""
        entries.append(f"{{point: {point}, row: {row}{rotation}}}")
    return "points_at: [" + ", ".join(entries) + "]"


def export(tmp_path, beam, **more):
    np.savez(tmp_path / "beam.npz", M=beam.mass, K=beam.stiffness, C=beam.damping, **more)


def test_exported_matrices_are_the_beam(tmp_path, beam):
    export(tmp_path, beam)
    rig = rig_of(tmp_path, f"file: beam.npz, {points_at(beam, rotations=True)}")
    structure = build_structure(rig)
    for name in ("mass", "damping", "stiffness"):
        np.testing.assert_allclose(getattr(structure, name), getattr(beam, name), rtol=1e-14)
    assert structure.points == beam.points
    assert structure.rotations == beam.rotations
    ours, theirs = linear_description(rig), linear_description(BEAM)
    np.testing.assert_allclose(ours.frequencies_rad_s, theirs.frequencies_rad_s, rtol=1e-12)
    np.testing.assert_allclose(ours.force_per_volt, theirs.force_per_volt, rtol=1e-9)
    amplitudes = [1e-5, 1e-4, 1e-3]
    one, other = (compute_reference(r, 5, amplitudes) for r in (rig, BEAM))
    np.testing.assert_allclose(one.omega_rad_s, other.omega_rad_s, rtol=1e-9)
    np.testing.assert_allclose(one.damping_ratio, other.damping_ratio, rtol=1e-7)


def test_what_travels_needs_no_files(tmp_path, beam):
    export(tmp_path, beam)
    rig = rig_of(tmp_path, f"file: beam.npz, modes: 2, {points_at(beam)}")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "rig.yaml").write_text(rig_text(rig, tmp_path / "rig.yaml"))
    assert load_rig(elsewhere / "rig.yaml") == rig
    assert rig.structure.source.startswith("beam.npz (SHA-256 ")


@pytest.mark.parametrize("structure", with_quick(STRUCTURES, *STRUCTURES[::8], *STRUCTURES[3::8]), ids=lambda s: s.name)
def test_what_nodes_and_diagnoses_write_loads(tmp_path, structure):
    """The rounding of a reduction is not a number of a rig file; the frequencies are those of the full matrices."""
    file = structure.write(tmp_path)
    rig = load_rig(file)
    (tmp_path / "snapshot.yaml").write_text(rig_text(rig, file))
    assert load_rig(tmp_path / "snapshot.yaml") == rig
    exact = linear_description(rig).frequencies_rad_s
    np.testing.assert_allclose(exact[0], 2.0 * np.pi * FIRST_HZ, rtol=2e-3)
    changed = rig.model_copy(update={"seed": 7})
    (tmp_path / "model.yaml").write_text(edited_rig_text(file.read_text(), file.name, changed))
    again = load_rig(tmp_path / "model.yaml")
    assert again.seed == 7
    np.testing.assert_allclose(linear_description(again).frequencies_rad_s, exact, rtol=1e-12)


def test_modes_of_a_file_have_no_rounding_either(tmp_path):
    (tmp_path / "modes.csv").write_text(
        "frequency_hz,damping_ratio,modal_mass_kg,point_1,point_2\n20,0.01,1,1,-3.1e-33\n50,0.01,1,1e-40,1\n"
    )
    file = tmp_path / "rig.yaml"
    file.write_text("name: two\nstructure: {kind: modal, file: modes.csv}\n")
    rig = load_rig(file)
    assert [mode.shape for mode in rig.structure.modes] == [[1.0, 0.0], [0.0, 1.0]]
    (tmp_path / "snapshot.yaml").write_text(rig_text(rig, file))
    assert load_rig(tmp_path / "snapshot.yaml") == rig


def test_a_file_beyond_every_quantity_is_refused_before_nodes_start(tmp_path, beam):
    np.savez(tmp_path / "beam.npz", M=beam.mass, K=beam.stiffness * 1e26)
    with pytest.raises(BenchError, match=r"rig.yaml line \d+: structure.stiffness_n_m: .*beyond every quantity here"):
        rig_of(tmp_path, f"file: beam.npz, {points_at(beam, rotations=True)}")


@pytest.mark.parametrize("form", ["npz", "mat", "mtx", "npy", "sparse"])
def test_every_form_of_file_gives_the_same(tmp_path, beam, form):
    names = {"mass": ("M", beam.mass), "stiffness": ("K", beam.stiffness), "damping": ("C", beam.damping)}
    keys = []
    if form == "npz":
        arrays = {}
        for letter, matrix in names.values():
            rows = sparse.csr_matrix(matrix)
            arrays |= {f"{letter}_{part}": getattr(rows, part) for part in ("data", "indices", "indptr", "shape")}
        np.savez(tmp_path / "beam.npz", **arrays)
        keys = ["file: beam.npz"]
    elif form == "mat":
        io.savemat(tmp_path / "beam.mat", {"M": sparse.csc_matrix(beam.mass), "K": beam.stiffness, "C": beam.damping})
        keys = ["file: beam.mat"]
    else:
        for quantity, (letter, matrix) in names.items():
            if form == "mtx":
                io.mmwrite(tmp_path / f"{letter}.mtx", sparse.coo_matrix(matrix), symmetry="symmetric", precision=17)
            elif form == "npy":
                np.save(tmp_path / f"{letter}.npy", matrix)
            else:
                sparse.save_npz(tmp_path / f"{letter}.npz", sparse.csc_matrix(matrix))
            keys.append(f"{quantity}_file: {letter}.{'npz' if form == 'sparse' else form}")
    structure = build_structure(rig_of(tmp_path, f"{', '.join(keys)}, {points_at(beam)}"))
    for name in ("mass", "damping", "stiffness"):
        np.testing.assert_allclose(getattr(structure, name), getattr(beam, name), rtol=1e-13, atol=0.0)


@pytest.mark.parametrize("kind", [np.asarray, sparse.csr_matrix])
def test_reduction_is_exact_in_statics_and_close_in_the_lowest_modes(kind):
    large = euler_bernoulli_beam(0.7, 0.02, 0.008, 185e9, 7830.0, 7, 1e-6, refinement=4)
    kept = [large.points[2], large.points[7]]
    matrices = Matrices(kind(large.mass), kind(large.stiffness), kind(large.damping), None, large.base_load).checked()
    small = craig_bampton(matrices, kept, 6)
    assert small.size == 2 + 6 + 2, "points, modes and what the modes left out answer"
    assert craig_bampton(matrices, kept, 6, most=9).size == 9
    assert craig_bampton(matrices, kept, 6, most=8).size == 8
    flexibility = np.linalg.inv(large.stiffness)[np.ix_(kept, kept)]
    np.testing.assert_allclose(np.linalg.inv(small.stiffness)[:2, :2], flexibility, rtol=1e-8)
    ours = np.sqrt(eigh(small.stiffness, small.mass, eigvals_only=True))[:4]
    np.testing.assert_allclose(ours, sticking_modes(large, [], 4).frequencies, rtol=2e-3)
    np.testing.assert_allclose(ours[:2], sticking_modes(large, [], 2).frequencies, rtol=5e-5)
    # Rayleigh: never too low. By the flexibility, for beside the highest mode the lowest is rounded to 1e-8.
    root = np.linalg.cholesky(large.stiffness)
    flexible = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, large.mass).T))[::-1]
    assert np.all(ours >= flexible[:4] ** -0.5 * (1.0 - 1e-9))
    # The base still moves the same mass: pᵀ K⁻¹ at the points is the static deflection under gravity.
    gravity = np.linalg.solve(large.stiffness, large.base_load)[kept]
    np.testing.assert_allclose(np.linalg.solve(small.stiffness, small.load())[:2], gravity, rtol=1e-8)
    all_modes = craig_bampton(matrices, kept, large.size - 2)
    np.testing.assert_allclose(
        np.sqrt(eigh(all_modes.stiffness, all_modes.mass, eigvals_only=True)[:10]),
        sticking_modes(large, [], 10).frequencies,
        rtol=1e-7,
    )


def test_a_large_sparse_model_is_reduced():
    """A rod of 1500 springs, fixed at one end: ω_k = 2 sin((2k - 1) π / (2 (2n + 1))) √(k/m) in closed form."""
    n = 1500
    ones = np.ones(n)
    stiffness = sparse.diags([2.0 * ones, -ones[1:], -ones[1:]], [0, 1, -1]).tolil()
    stiffness[n - 1, n - 1] = 1.0
    matrices = Matrices(sparse.identity(n, format="csr"), stiffness.tocsr(), None, ones).checked()
    small = craig_bampton(matrices, [n - 1], 8)
    found = np.sqrt(eigh(small.stiffness, small.mass, eigvals_only=True))[:4]
    exact = 2.0 * np.sin((2.0 * np.arange(1, 5) - 1.0) * np.pi / (2.0 * (2 * n + 1)))
    np.testing.assert_allclose(found, exact, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.inv(small.stiffness)[0, 0], n, rtol=1e-9)  # n springs in series
    np.testing.assert_allclose(small.base_vector, [1.0, *[0.0] * 9])


def test_damping_ratios_instead_of_a_matrix(tmp_path, beam):
    export(tmp_path, beam)
    damping = modal_damping_matrix(beam.mass, beam.stiffness, [0.003, 0.01])
    modes = sticking_modes(type(beam)(beam.mass, damping, beam.stiffness, beam.points))
    np.testing.assert_allclose(modes.damping_ratios[:4], [0.003, 0.01, 0.01, 0.01], rtol=1e-6)
    np.savez(tmp_path / "beam.npz", mass=beam.mass, stiffness=beam.stiffness)
    rig = rig_of(tmp_path, f"file: beam.npz, damping_ratios: [0.003, 0.01], {points_at(beam)}")
    np.testing.assert_allclose(build_structure(rig).damping, damping, rtol=1e-9, atol=1e-12 * np.abs(damping).max())


def test_factors_scale_what_they_say(tmp_path, beam):
    np.savez(tmp_path / "beam.npz", M=beam.mass, K=beam.stiffness, C=beam.damping, p=beam.base_load)
    factors = ["structure.stiffness_factor=1.21", "structure.mass_factor=0.5", "structure.damping_factor=2"]
    structure = build_structure(rig_of(tmp_path, f"file: beam.npz, {points_at(beam)}", factors))
    np.testing.assert_allclose(structure.base_load, 0.5 * beam.base_load, rtol=1e-12)
    plain = sticking_modes(beam, [], 3)
    scaled = sticking_modes(structure, [], 3)
    np.testing.assert_allclose(scaled.frequencies, plain.frequencies * np.sqrt(1.21 / 0.5), rtol=1e-9)
    np.testing.assert_allclose(scaled.damping_ratios, plain.damping_ratios * 2.0 / np.sqrt(1.21 * 0.5), rtol=1e-6)


def two(**changes):
    base = {"mass": np.eye(2), "stiffness": np.array([[2.0, -1.0], [-1.0, 1.0]]), "damping": None}
    return Matrices(**(base | changes))


@pytest.mark.parametrize("kind", [np.asarray, sparse.csr_matrix])
@pytest.mark.parametrize(
    ("name", "matrix", "says"),
    [
        ("mass", [[0.0, 0.0], [0.0, 0.0]], "mass must be positive definite"),
        ("mass", [[1.0, 0.0], [0.0, -1.0]], "mass must be positive definite"),
        ("mass", [[1.0, 2.0], [2.0, 1.0]], "mass must be positive definite"),
        ("mass", [[0.0, 1.0], [1.0, 0.0]], "mass must be positive definite"),
        ("mass", [[1.0]], "mass must be 2 x 2, as the stiffness, got 1 x 1"),
        ("stiffness", [[2.0, -1.0], [0.0, 1.0]], "stiffness is not symmetric"),
        ("stiffness", [[1.0, -2.0], [-2.0, 1.0]], "stiffness has a negative eigenvalue"),
        ("stiffness", [[np.nan, 0.0], [0.0, 1.0]], "stiffness has entries that are not finite"),
        ("damping", [[-1.0, 0.0], [0.0, 1.0]], "damping has a negative eigenvalue"),
    ],
)
def test_matrices_that_are_wrong_are_named(kind, name, matrix, says):
    with pytest.raises(ValueError, match=says):
        two(**{name: kind(np.array(matrix))}).checked()


@pytest.mark.parametrize("kind", [np.asarray, sparse.csr_matrix])
def test_free_structures_are_accepted_and_rounding_is_forgiven(kind):
    free = np.array([[1.0, -1.0], [-1.0, 1.0 + 1e-12]])
    checked = two(stiffness=kind(free), mass=kind(np.eye(2)), damping=kind(np.zeros((2, 2)))).checked().dense()
    assert np.array_equal(checked.stiffness, checked.stiffness.T)
    with pytest.raises(ValueError, match="can still move freely"):
        craig_bampton(Matrices(np.eye(3), np.array([[1.0, 0, 0], [0, 1, -1], [0, -1, 1]])).checked(), [0], 1)


@pytest.mark.parametrize(
    ("structure", "says"),
    [
        ("file: beam.npz", "structure.points_at must be a list of points"),
        ("file: none.npz, {points}", "there is no file"),
        ("file: rig.yaml, {points}", "structure.file must be .npz or .mat"),
        ("file: broken.npz, {points}", "broken.npz: The matrix file broken.npz is cut off or damaged"),
        ("file: other.npz, {points}", "it has none of M, K, C; it has stuff"),
        ("file: beam.npz, points_at: [{{point: 2, row: 99}}], modes: 2", "names row 99, but the rows are 0 to 13"),
        ("file: beam.npz, points_at: [{{point: 2, row: 99}}]", "names row 99, but the rows are 0 to 13"),
        ("file: beam.npz, {points}, modes: 99", "7 modes are left besides the points, 99 are asked for"),
        ("file: beam.npz, {points}, damping_ratios: [0.1]", "damping_ratios too; remove one"),
        ("file: large.npz, points_at: [{{point: 2, row: 1}}]", "100 degrees of freedom, and 60 is the limit"),
        ("mass_kg: [[1, 2], [3]], stiffness_n_m: [[1, 0], [0, 1]], {points}", "rows of numbers of equal length"),
        ("stiffness_n_m: [[1, 0], [0, 1]], {points}", "the mass matrix is missing"),
        ("file: beam.npz, mass_kg: [[1]], {points}", "both give the mass"),
    ],
)
def test_matrices_sections_that_are_wrong_are_named(tmp_path, beam, structure, says):
    export(tmp_path, beam)
    (tmp_path / "broken.npz").write_text("nothing")
    np.savez(tmp_path / "other.npz", stuff=np.eye(2))
    np.savez(tmp_path / "large.npz", M=np.eye(100), K=np.eye(100))
    with pytest.raises(BenchError, match=says.replace(".", r"\.")):
        rig_of(tmp_path, structure.format(points=points_at(beam)))


def lumped_frame():
    """A beam of nine elements on a clamp with its mass at the deflections: rotations have none."""
    full = build_structure(BEAM)
    mass = np.zeros_like(full.mass)
    for row in range(0, full.mass.shape[0], 2):
        mass[row, row] = 0.02 + 0.001 * row
    return Matrices(mass, full.stiffness)


def finite_frequencies(mass, stiffness, count=4):
    """Lowest angular frequencies by the inverse problem, in which rows without mass have the eigenvalue zero."""
    return np.sqrt(1.0 / eigh(mass, stiffness, eigvals_only=True)[::-1][:count])


def test_rows_without_mass_are_condensed_without_an_error():
    frame = lumped_frame().checked()
    small, left = condensed(frame, [0])
    assert not set(left) & set(frame.massless())
    assert small.size + frame.massless().size == frame.size
    np.testing.assert_allclose(
        finite_frequencies(small.mass, small.stiffness), finite_frequencies(frame.mass, frame.stiffness), rtol=1e-9
    )
    np.testing.assert_allclose(
        np.linalg.inv(small.stiffness), np.linalg.inv(frame.stiffness)[np.ix_(left, left)], rtol=1e-9
    )


@pytest.mark.parametrize("form", [np.asarray, sparse.csr_matrix])
def test_rows_without_mass_follow_in_a_reduction(form):
    frame = lumped_frame()
    frame = Matrices(form(frame.mass), form(frame.stiffness)).checked()
    small = craig_bampton(frame, [4, 7], 6)  # all that have mass; 7 is a rotation
    plain = frame.dense()
    np.testing.assert_allclose(
        finite_frequencies(small.mass, small.stiffness, 7),
        finite_frequencies(plain.mass, plain.stiffness, 7),
        rtol=1e-7,
    )
    with pytest.raises(ValueError, match="modes are left besides the points"):
        craig_bampton(frame, [4, 7], 7)


def test_a_rig_says_what_was_condensed(tmp_path, beam):
    frame = lumped_frame()
    np.savez(tmp_path / "beam.npz", M=frame.mass, K=frame.stiffness)
    ratios = ", ".join(["0.01"] * 7)
    rig = rig_of(tmp_path, f"file: beam.npz, damping_ratios: [{ratios}], {points_at(beam)}")
    assert rig.structure.source.endswith("; 7 rows without mass follow the others statically")
    with pytest.raises(BenchError, match="row 1 moves a point or a damper and has no mass"):
        rig_of(tmp_path, f"file: beam.npz, damping_ratios: [{ratios}], points_at: [{{point: 2, row: 1}}]")


def test_a_large_reduction_is_kept_beside_its_file(tmp_path, beam, monkeypatch):
    export(tmp_path, beam)
    monkeypatch.setattr("nmt_rig.structure_files._SMALL_FILE", 0)
    text = f"file: beam.npz, modes: 2, {points_at(beam)}"
    first = rig_of(tmp_path, text)
    (stored,) = (tmp_path / ".nmt-reduced").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr("nmt_rig.matrix_files.read_matrices", None)
        assert rig_of(tmp_path, text) == first
    stored.write_text("{")
    assert rig_of(tmp_path, text) == first
    export(tmp_path, beam, stuff=1.0)
    assert rig_of(tmp_path, text).structure.mass_kg == first.structure.mass_kg
    assert len(list((tmp_path / ".nmt-reduced").iterdir())) == 2


def test_units_of_rows_between_the_points_change_no_reduction():
    """Rotations in other units are the same structure: the pivots of a held stiffness are judged row by row."""
    beam = euler_bernoulli_beam(0.7, 0.02, 0.008, 185e9, 7830.0, 7, 1e-6, refinement=4)
    kept = [beam.points[2], beam.points[7]]
    scale = np.ones(beam.mass.shape[0])
    scale[1::2] = 1e-6
    plain = craig_bampton(Matrices(beam.mass, beam.stiffness).checked(), kept, 5)
    turned = [sparse.csr_matrix(matrix * np.outer(scale, scale)) for matrix in (beam.mass, beam.stiffness)]
    scaled = craig_bampton(Matrices(*turned).checked(), kept, 5)
    np.testing.assert_allclose(scaled.stiffness[:2, :2], plain.stiffness[:2, :2], rtol=1e-7)
    np.testing.assert_allclose(np.diag(scaled.stiffness)[2:], np.diag(plain.stiffness)[2:], rtol=1e-7)


@pytest.mark.parametrize(("modes", "points"), [(3, [7]), (5, [2, 7]), (8, [3, 5])])
def test_a_reduction_says_up_to_where_its_frequencies_hold(modes, points):
    beam = euler_bernoulli_beam(0.7, 0.02, 0.008, 185e9, 7830.0, 7, 1e-6, refinement=8)
    matrices, kept = Matrices(beam.mass, beam.stiffness).checked(), [beam.points[p] for p in points]
    full = np.sqrt(eigh(beam.stiffness, beam.mass, eigvals_only=True))

    def error(small, factor):
        below = full[full <= factor * 2.0 * np.pi * small.band_hz]
        return np.sqrt(eigh(small.stiffness, small.mass, eigvals_only=True))[: below.size] / below - 1.0

    plain = craig_bampton(matrices, kept, modes, most=modes + len(points))
    assert error(plain, 1.0).size >= 2
    assert np.all(error(plain, 1.0) <= TRUNCATION)
    # The bound is not far from what it bounds: some error is reached within thrice its frequency.
    assert error(plain, 3.0).max() > 0.1 * TRUNCATION
    # What the modes left out answer to first order takes nearly all of it.
    assert error(craig_bampton(matrices, kept, modes), 1.0).max() < 0.03 * TRUNCATION


def test_a_large_mass_or_stiffness_with_a_negative_eigenvalue_is_named():
    n = 2500
    chain = sparse.diags([2.0 * np.ones(n), -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1]).tocsr()
    mass = (sparse.identity(n) + 0.2 * abs(chain - 2.0 * sparse.identity(n))).tolil()
    assert Matrices(mass.tocsr(), chain).checked().size == n
    mass[1200, 1300] = mass[1300, 1200] = 1.5
    with pytest.raises(ValueError, match="mass must be positive definite"):
        Matrices(mass.tocsr(), chain).checked()
    wrong = chain.tolil()
    wrong[1200, 1300] = wrong[1300, 1200] = -6.0
    with pytest.raises(ValueError, match="stiffness has a negative eigenvalue"):
        craig_bampton(Matrices(sparse.identity(n, format="csr"), wrong.tocsr()).checked(), [0], 2)
