"""Files of finite-element programs are the structure they were written from; points are named by node or by place."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import numpy as np
import pytest
from rig.superelement_files import FORMS, REPORTED, cantilever, entry_list, op2, reported, write
from rig.test_matrix_files import mutated
from scipy import sparse
from scipy.linalg import eigh

from nmt_core.errors import BenchError
from nmt_rig.file_errors import BadFileError
from nmt_rig.matrix_files import read_model, read_part
from nmt_rig.model.matrix_structure import Matrices, lowest_frequencies
from nmt_rig.model_figures import model_figures
from nmt_rig.named_rows import Units
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_structure
from nmt_rig.rig_snapshot import rig_text
from nmt_rig.superelement_texts import matrix_names, quantity_of

BEAM = load_rig("beam")


def rig_of(folder, structure):
    """The shipped beam's rig with its structure from files; points 2 and 7 are those of its exciter and sensors."""
    text = rig_text(BEAM, None, ["x=y"])
    start, end = text.index("structure:"), text.index("local_elements:")
    file = folder / "rig.yaml"
    file.write_text(f"{text[:start]}structure: {{kind: matrices, {structure}}}\n{text[end:]}")
    return load_rig(file)


def keys(paths):
    return ", ".join(f"{key}: {path.name}" for key, path in paths.items())


def points(entry):
    return f"points_at: [{', '.join(entry(point) for point in range(1, 8))}]"


@pytest.mark.parametrize("form", FORMS)
def test_every_file_is_the_matrices_it_was_written_from(tmp_path, form):
    matrices, rows, _ = cantilever()
    model = read_model(write(form, tmp_path))
    order = [rows.index((label // 100, label % 100)) for label in model.labels.tolist()]
    for name, matrix in matrices.items():
        found = model.matrices[name]
        found = found.toarray() if sparse.issparse(found) else found
        # Fields of 16 characters have ten figures.
        rtol = 2e-9 if form == "dmig large" else 1e-15
        np.testing.assert_allclose(found, matrix[np.ix_(order, order)], rtol=rtol, atol=0.0)


@pytest.mark.parametrize("form", FORMS)
def test_a_rig_names_its_points_by_node(tmp_path, form):
    paths = write(form, tmp_path)
    by_node = points(lambda point: f"{{point: {point}, node: {10 * point}, direction: z, rotation: ry}}")
    structure = build_structure(rig_of(tmp_path, f"{keys(paths)}, {by_node}"))
    beam = build_structure(BEAM)
    rows = [beam.points[p] for p in beam.points] + [beam.rotations[p] for p in beam.points]
    found = [structure.points[p] for p in beam.points] + [structure.rotations[p] for p in beam.points]
    for name in ("mass", "stiffness"):
        np.testing.assert_allclose(
            getattr(structure, name)[np.ix_(found, found)], getattr(beam, name)[np.ix_(rows, rows)], rtol=2e-9
        )


@pytest.mark.parametrize("kind", REPORTED)
@pytest.mark.parametrize(
    "seeds", [range(6), pytest.param(range(6, 100), marks=pytest.mark.campaign)], ids=["few", "all"]
)
def test_reported_files_are_right_or_refused_by_what_is_wrong(tmp_path, kind, seeds):
    """Against the frequencies of the matrices that the file was written from."""
    for seed in seeds:
        folder = tmp_path / str(seed)
        folder.mkdir()
        paths, right = reported(kind, seed, folder)
        if isinstance(right, str):
            with pytest.raises(BenchError, match=right):
                model_figures(paths, "m-kg-N")
        else:
            # Fields of eight characters have three to five figures.
            found = 2.0 * np.pi * np.array(model_figures(paths, "m-kg-N").frequencies_hz[:2])
            np.testing.assert_allclose(found, right, rtol=2e-2, err_msg=f"{kind} {seed}")


@pytest.mark.parametrize("form", ["dmig large", "npz", "rows beside a sparse matrix"])
def test_a_place_is_the_node_next_to_it(tmp_path, form):
    paths = write(form, tmp_path)
    at = points(lambda point: f"{{point: {point}, at: [{0.1 * point + 0.004}, 0, 0.003], direction: z}}")
    rig = rig_of(tmp_path, f"{keys(paths)}, {at}")
    assert [entry.node for entry in rig.structure.points_at] == [10, 20, 30, 40, 50, 60, 70]
    assert "point 2 is node 20, 0.005 from its place" in rig.structure.source
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "rig.yaml").write_text(rig_text(rig, tmp_path / "rig.yaml"))
    assert load_rig(elsewhere / "rig.yaml") == rig


def in_millimetres(matrices, rows, nodes):
    """The same structure in mm, t and N, written out by hand: rotations keep rad."""
    length = np.array([1e3 if direction > 3 else 1.0 for _, direction in rows])
    mass = matrices["mass"] * 1e-3 * np.outer(length, length)
    return {"mass": mass, "stiffness": matrices["stiffness"] * 1e-3 * np.outer(length, length)}, nodes * [1, 1e3, 1, 1]


def test_units_of_the_file_are_stated_or_asked(tmp_path):
    matrices, rows, nodes = cantilever()
    scaled, far = in_millimetres(matrices, rows, nodes)
    np.savez(tmp_path / "model.npz", M=scaled["mass"], K=scaled["stiffness"], rows=np.array(rows), nodes=far)
    by_node = points(lambda point: f"{{point: {point}, node: {10 * point}, direction: z, rotation: ry}}")
    with pytest.raises(BenchError, match=r"nodes are up to 600 m apart; state the units of the file, as units: mm-t-N"):
        rig_of(tmp_path, f"file: model.npz, {by_node}")
    structure = build_structure(rig_of(tmp_path, f"file: model.npz, units: mm-t-N, {by_node}"))
    order = [structure.points[node // 10] if d == 3 else structure.rotations[node // 10] for node, d in rows]
    for name, matrix in matrices.items():
        np.testing.assert_allclose(getattr(structure, name)[np.ix_(order, order)], matrix, rtol=1e-12)
    # Rotations between the points have another scale and the points do not notice.
    some = points(lambda p: f"{{point: {p}, node: {10 * p}, direction: z{', rotation: ry' if p == 7 else ''}}}")
    small = rig_of(tmp_path, f"file: model.npz, units: mm-t-N, modes: 3, {some}").structure
    np.savez(tmp_path / "model.npz", M=matrices["mass"], K=matrices["stiffness"], rows=np.array(rows), nodes=nodes)
    same = rig_of(tmp_path, f"file: model.npz, modes: 3, {some}").structure
    np.testing.assert_allclose(
        eigh(small.stiffness_n_m, small.mass_kg, eigvals_only=True),
        eigh(same.stiffness_n_m, same.mass_kg, eigvals_only=True), rtol=1e-8,
    )  # fmt: skip
    with pytest.raises(BenchError, match="units are length, mass and force, as m-kg-N"):
        rig_of(tmp_path, f"file: model.npz, units: mm, {some}")


def test_units_give_damping_its_time():
    """kg, mm and kN go with ms: c in kN ms/mm is 1000 N s/m."""
    damping = Units.named("mm-kg-kN").in_si({"damping": np.eye(1)}, [])["damping"]
    np.testing.assert_allclose(damping, 1000.0, rtol=1e-12)


def test_figures_are_those_of_the_closed_form(tmp_path):
    """A cantilever: ω = 1.8751² √(EI/ρA) / L²; the mass but for half an element at the clamp moves rigidly."""
    section = BEAM.structure
    area = section.width_m * section.height_m
    stiffness = section.youngs_modulus_pa * section.width_m * section.height_m**3 / 12.0
    line = section.density_kg_m3 * area
    exact = 1.87510406871196**2 * np.sqrt(stiffness / line) / section.length_m**2 / (2.0 * np.pi)
    paths = write("dmig free", tmp_path)
    figures = model_figures(paths, "m-kg-N")
    np.testing.assert_allclose(figures.frequencies_hz[0], exact, rtol=1e-5)
    # Of the first element's mass 13/35 moves with its free end.
    element = line * section.length_m / section.elements
    np.testing.assert_allclose(
        figures.mass_kg["z"], line * section.length_m - element * (1.0 - 13.0 / 35.0), rtol=1e-12
    )
    assert (figures.rows, figures.nodes, figures.directions) == (14, [10, 20, 30, 40, 50, 60, 70], "z and ry")
    assert any(line.startswith("mass: ") and "kg in z" in line for line in figures.lines("m-kg-N"))


def test_rigid_body_modes_have_no_frequency():
    """Two masses on a spring: one mode at rest, one at √(2 k / m)."""
    free = Matrices(np.diag([2.0, 2.0]), np.array([[9.0, -9.0], [-9.0, 9.0]])).checked()
    np.testing.assert_allclose(lowest_frequencies(free, 3), [0.0, 3.0], rtol=1e-9)


def test_a_light_free_part_keeps_its_rigid_motion_where_a_file_rounds():
    """A mode at rest, √(2 k / m) and √(k / m); the stiffness of the first is negative by what ten figures leave."""
    rounding = 1e-5
    light = 1e3 * np.array([[1.0, -1.0], [-1.0, 1.0]]) - rounding * np.eye(2)
    stiffness = np.zeros((3, 3))
    stiffness[0, 0], stiffness[1:, 1:] = 1e12, light
    found = lowest_frequencies(Matrices(np.diag([1.0, 1e-9, 1e-9]), stiffness).checked(), 2)
    np.testing.assert_allclose(found, [0.0, 1e6, np.sqrt(2.0) * 1e6], rtol=1e-6)


def test_files_that_calculix_wrote_have_its_frequencies():
    """CalculiX 2.20 on bar.inp; the frequencies are those that it prints itself without MATRIXSTORAGE."""
    path = Path(__file__).with_name("calculix") / "bar.sti"
    figures = model_figures({"file": path}, "mm-t-N")
    np.testing.assert_allclose(figures.frequencies_hz[:4], [3744.688, 5326.356, 11218.80, 22435.25], rtol=1e-6)
    assert (len(figures.nodes), figures.directions, figures.doubt_of_units) == (12, "x, y and z", "")
    # Of the mass of a linear element next to a clamp a third moves with its free end, and there are three.
    assert figures.mass_kg["x"] == pytest.approx(60.0 * 20.0 * 10.0 * 2.7e-6 * 7 / 9)
    assert "its mass is" in model_figures({"file": path}, "m-kg-N").doubt_of_units


def test_a_superelement_that_nastran_wrote_is_read_by_its_text_beside_it():
    """Of the files that pyyeti tests its own readers with."""
    pyyeti = pytest.importorskip("pyyeti", reason="pyyeti, which reads OP4, is not installed")
    folder = Path(pyyeti.__file__).parent / "tests" / "nas2cam_extseout"
    if not (folder / "outboard.op4").exists():
        pytest.skip("this pyyeti comes without its tests")
    figures = model_figures({"file": folder / "outboard.op4"}, "m-kg-N")
    assert (figures.rows, figures.nodes, figures.modal_coordinates) == (46, [3, 11, 19, 27], 22)
    assert figures.directions == "x, y, z, rx, ry and rz"
    assert figures.frequencies_hz[:6] == [0.0] * 6
    assert figures.frequencies_hz[6] > 1.0
    with pytest.raises(BenchError, match=r"outboard\.op4 next to it may have them"):
        model_figures({"file": folder / "outboard.pch"}, "m-kg-N")


def test_a_single_matrix_is_named_by_its_last_word_and_sent_to_the_others(tmp_path):
    names = {"plate_K.mtx": "stiffness", "M.npz": "mass", "two-c.mtx": "damping", "job_STIF1.mtx": "stiffness"}
    assert {name: quantity_of(Path(name)) for name in names} == names
    assert quantity_of(Path("sink.mtx")) is None
    sparse.save_npz(tmp_path / "plate_K.npz", sparse.eye(3, format="csr"))
    with pytest.raises(BenchError, match=r"it is a single matrix; .* --check K\.npz --check M\.npz"):
        model_figures({"file": tmp_path / "plate_K.npz"}, "m-kg-N")


def test_a_stiffness_may_have_a_number_and_structural_damping_is_none(tmp_path):
    assert matrix_names(["K40", "M40"]) == {"stiffness": "K40", "mass": "M40"}
    assert matrix_names(["K4", "M4"]) == {"stiffness": "K4", "mass": "M4"}
    assert matrix_names(["KGG", "K4GG", "MGG"]) == {"stiffness": "KGG", "mass": "MGG"}
    assert matrix_names(["K", "K4X", "M"]) == {"stiffness": "K", "mass": "M"}


def test_the_line_of_an_error_is_that_of_its_key(tmp_path):
    paths = write("npz", tmp_path)
    text = rig_text(BEAM, None, ["x=y"])
    end = text[text.index("local_elements:") :]
    lines = ["name: strip", "structure:", "  kind: matrices", f"  file: {paths['file'].name}", "  modes: 3"]
    lines += ["  points_at:", *(f"  - {{point: {p}, node: {10 * p}, direction: z}}" for p in range(1, 8))]
    lines += ["  regions:", "    left rib: {nodes: [10, 20]}"]

    def refusal(line, other):
        changed = [*lines[: line - 1], other, *lines[line:]]
        (tmp_path / "rig.yaml").write_text("\n".join(changed) + "\n" + end)
        with pytest.raises(BenchError) as caught:
            load_rig(tmp_path / "rig.yaml")
        return str(caught.value)

    assert refusal(5, "  modes: 30").startswith("rig.yaml line 14: 7 modes are left")
    assert refusal(9, "  - {point: 3, node: 31, direction: z}").startswith("rig.yaml line 9: point 3: node 31 is not")
    huge = "  - {point: 3, node: 99999999999999999999999, direction: z}"
    assert refusal(9, huge).startswith("rig.yaml line 9: point 3: it has a number of a node beyond 10¹²")
    assert refusal(15, "    left rib: {nodes: [11]}").startswith("rig.yaml line 15: region left rib: node 11 is not")
    assert refusal(5, "  units: mm").startswith("rig.yaml line 5: units are length")


def test_held_and_empty_rows_are_left_out(tmp_path):
    matrices, rows, _ = cantilever()
    stiffness = matrices["stiffness"].copy()
    stiffness[0] = stiffness[:, 0] = 0.0
    stiffness[0, 0] = 1e36
    entry_list(tmp_path / "job_STIF1.mtx", stiffness, rows)
    entry_list(tmp_path / "job_MASS1.mtx", matrices["mass"], rows)
    model = read_model({"file": tmp_path / "job_STIF1.mtx"})
    assert model.held == 1
    np.testing.assert_allclose(model.matrices["stiffness"].toarray(), stiffness[1:, 1:], rtol=1e-15)


def test_modes_of_a_substructure_stand_behind_its_nodes(tmp_path):
    (tmp_path / "sub.mtx").write_text(
        "*USER ELEMENT, NODES=2, LINEAR\n** ELEMENT NODES\n** 4, 9\n1\n2, 2, 3\n"
        "*MATRIX, TYPE=STIFFNESS\n1.,\n0., 2.,\n0., 0., 3.,\n0., 0., 0., 4.,\n"
        "*MATRIX, TYPE=MASS\n1.,\n0., 1., 0., 0., 1., 0., 0., 0., 1.\n"
    )
    model = read_model({"file": tmp_path / "sub.mtx"})
    assert [(label // 100, label % 100) for label in model.labels.tolist()] == [(4, 1), (9, 2), (9, 3), (-1, 0)]
    np.testing.assert_array_equal(np.diag(model.matrices["stiffness"]), [1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("{point: 2, node: 25, direction: z}", "point 2: node 25 is not among the 7 nodes that are kept, 10 to 70"),
        ("{point: 2, node: 20, direction: x}", "point 2: node 20 has no direction x, only z and ry"),
        ("{point: 2, node: 20}", "must be a list of points, each by one of"),
        ("{point: 2, node: 20, row: 3, direction: z}", "must be a list of points, each by one of"),
        ("{point: 2, at: [1, 2], direction: z}", "must be a list of points, each by one of"),
        ("{point: 2, at: [0, 0, 0], direction: z}", "the files have no coordinates of nodes"),
    ],
)
def test_points_that_are_not_there_are_named(tmp_path, entry, says):
    paths = write("calculix", tmp_path)
    with pytest.raises(BenchError, match=says):
        rig_of(tmp_path, f"{keys(paths)}, points_at: [{entry}]")


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("k_stif.mtx", "1,1,1,1,2.\n1,1,2\n", "5 finite numbers a line"),
        ("k_stif.mtx", "1,1,1,1,two\n", "not a number"),
        ("k_stif.mtx", "1,1,1,1,1e999\n", "5 finite numbers a line"),
        ("k_stif.mtx", "1,1.5,1,1,2.\n", "not whole"),
        ("k_stif.mtx", "1,1,1,700,2.\n", "not one of 0 to 99"),
        ("k_stif.mtx", "1000000000,1000000000,3.\n", "rows up to 1000000000 and 1 entries"),
        ("k_stif.mtx", "0,1,3.\n", "rows are counted from 1"),
        ("job.mtx", "1,1,1,1,2.\n", "does not say which matrix it is"),
        ("job.mtx", "*MATRIX, TYPE=MASS\n1.,2.\n", "which is not a triangle"),
        ("job.mtx", "*USER ELEMENT\n** ELEMENT NODES\n** 1, 2\n1,2\n*MATRIX, TYPE=MASS\n1.\n", "4 degrees of freedom"),
        ("job.mtx", "*USER ELEMENT\n** ELEMENT NODES\n** 1, 2\nx\n*MATRIX, TYPE=MASS\n1.\n", "not whole numbers"),
        ("job.pch", "GRID,1,,0.,0.,0.\n", "it has no square matrix"),
        ("job.pch", "DMIG,KA,0,6,2,0\nDMIG,KB,0,6,2,0\nDMIG,KA,1,1,,1,1,2.\nDMIG,KB,1,1,,1,1,2.\n", "KA and KB could"),
        ("job.pch", "DMIG,KA,0,6,2,0\nDMIG,KA,1,1,,1,1,stiff\n", "is not whole"),
        ("job.sti", "1 1 2.\n9 9 1.\n", "9 rows, and job.dof names 1"),
        ("job.pch", "DMIG,K,0,6,2,0\nDMIG,K,1,1,,1,1,1+9999\n", r"1\+9999 is not a finite number"),
        ("job.pch", f"DMIG,K,0,6,2,0\nDMIG,K,1,1,,{'9' * 23},1,2.\n", "names a node that is not a node"),
        ("job.pch", f"DMIG,K,0,6,2,0\nDMIG,K,{'9' * 23},1,,1,1,2.\n", "names a node that is not a node"),
        ("job.pch", f"GRID,{'9' * 23},,0.,0.,0.\nDMIG,K,0,6,2,0\nDMIG,K,1,1,,1,1,2.\n", "a node beyond 10¹²"),
        ("job.pch", f"EXTRN,{'9' * 23},3\n", "it has no square matrix|beyond 10¹²"),
        ("job.mtx", f"*USER ELEMENT\n** ELEMENT NODES\n** {'9' * 23}\n3\n*MATRIX, TYPE=MASS\n1.\n", "beyond 10¹²"),
        ("k_stif.mtx", "*INCLUDE, INPUT=more.mtx\n1,1,1,1,2.\n", "it includes more.mtx"),
        ("k_stif.mtx", "1,1,1,1,2.\n2,1,2,1,2.\n1,1,1,1,2.\n", "it has the entry node 1 x, node 1 x twice"),
        ("job.sub", "", r"no package reads \.sub"),
    ],
)
def test_texts_that_are_not_whole_are_refused(tmp_path, name, text, says):
    (tmp_path / name).write_text(text)
    (tmp_path / "job.dof").write_text("1.1\n")
    with pytest.raises(BadFileError, match=says):
        read_model({"file": tmp_path / name})


@pytest.mark.parametrize("form", FORMS)
def test_changed_bytes_are_a_structure_or_a_sentence(tmp_path, form):
    random = np.random.default_rng(7)
    paths = write(form, tmp_path)
    for path in paths.values():
        content = path.read_bytes()
        for _ in range(25):
            path.write_bytes(mutated(content, random))
            try:
                read_model(paths)
            except (BadFileError, BenchError):
                continue
        path.write_bytes(content)


@pytest.mark.parametrize(("ending", "package"), [("op4", "pyyeti"), ("op2", "pyyeti"), ("full", "ansys-mapdl-reader")])
def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch, ending, package):
    for module in ("pyyeti.nastran.op4", "pyyeti.nastran.op2", "ansys.mapdl.reader"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"k.{ending}").write_bytes(b"nothing")
    with pytest.raises(BadFileError, match=f"need the package {package}; install it with 'pip install {package}'"):
        read_part(tmp_path / f"k.{ending}")


def punched_names(rows):
    """EXTRN and GRID cards as Nastran punches them beside an OP4 of an external superelement."""
    fields = [
        f"{node:>8}{''.join(str(d) for n, d in rows if n == node):>8}" for node in dict.fromkeys(n for n, _ in rows)
    ]
    lines = ["EXTRN   " + "".join(fields[:4])]
    lines += [" " * 8 + "".join(fields[start : start + 4]) for start in range(4, len(fields), 4)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("how", [{"binary": True}, {"binary": False}, {"binary": True, "sparse": "bigmat"}])
def test_op4_is_read_by_name_of_the_cards_beside_it(tmp_path, how):
    op4 = pytest.importorskip("pyyeti.nastran.op4", reason="pyyeti, which reads OP4, is not installed")
    matrices, rows, _ = cantilever()
    content = {"KXX": matrices["stiffness"], "MXX": matrices["mass"], "K4XX": np.eye(14), "BOTHER": np.ones((3, 14))}
    op4.write(str(tmp_path / "model.op4"), content, **how)
    (tmp_path / "model.pch").write_text(punched_names(rows))
    model = read_model({"file": tmp_path / "model.op4"})
    assert [(label // 100, label % 100) for label in model.labels.tolist()] == rows
    for name, matrix in matrices.items():
        np.testing.assert_allclose(model.matrices[name].toarray(), matrix, rtol=1e-14)
    content_bytes = (tmp_path / "model.op4").read_bytes()
    random = np.random.default_rng(3)
    for _ in range(20):
        (tmp_path / "model.op4").write_bytes(content_bytes[: random.integers(len(content_bytes))])
        try:
            read_model({"file": tmp_path / "model.op4"})
        except BadFileError:
            continue


def test_op2_is_read_by_name_of_the_cards_beside_it(tmp_path):
    pytest.importorskip("pyyeti.nastran.op2", reason="pyyeti, which reads OP2, is not installed")
    matrices, rows, _ = cantilever()
    path = tmp_path / "model.op2"
    op2(path, {"KXX": matrices["stiffness"], "MXX": matrices["mass"]})
    (tmp_path / "model.asm").write_text(punched_names(rows))
    model = read_model({"file": path})
    assert [(label // 100, label % 100) for label in model.labels.tolist()] == rows
    for name, matrix in matrices.items():
        np.testing.assert_array_equal(model.matrices[name].toarray(), matrix)
    content = path.read_bytes()
    random = np.random.default_rng(5)
    for _ in range(20):
        path.write_bytes(content[: random.integers(len(content))])
        with contextlib.suppress(BadFileError):
            read_model({"file": path})


def test_the_file_with_the_matrices_is_named_beside_their_cards(tmp_path):
    """Of the files that Nastran writes together a newcomer takes the text."""
    (tmp_path / "model.pch").write_text(punched_names(cantilever()[1]))
    (tmp_path / "model.op4").write_bytes(b"")
    with pytest.raises(BadFileError, match=r"no square matrix; model\.op4 next to it may have them"):
        read_model({"file": tmp_path / "model.pch"})


def test_a_full_file_of_ansys_is_read(tmp_path):
    reader = pytest.importorskip("ansys.mapdl.reader", reason="ansys-mapdl-reader is not installed")
    from ansys.mapdl.reader import examples

    figures = model_figures({"file": Path(examples.fullfile)}, "m-kg-N")
    names, stiffness, mass = reader.read_binary(examples.fullfile).load_km(as_sparse=False)
    free = np.flatnonzero(stiffness.diagonal())
    both = [matrix + np.triu(matrix, 1).T for matrix in (stiffness[np.ix_(free, free)], mass[np.ix_(free, free)])]
    exact = np.sqrt(eigh(*both, subset_by_index=[0, 5], eigvals_only=True)) / (2.0 * np.pi)
    np.testing.assert_allclose(figures.frequencies_hz, exact, rtol=1e-6)
    assert figures.nodes == sorted({int(node) for node in np.asarray(names)[free, 0]})
