"""Regions of finite-element models through the reduction: what they change is what the full model changes by.

The full models are plates of scikit-fem with the same change in their own matrices.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh, splu
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_rig.model.matrix_structure import TRUNCATION, Matrices, craig_bampton
from nmt_rig.model.regions import Support, spread_of, supported
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_structure
from nmt_rig.rig_snapshot import rig_text

pytest.importorskip("skfem", reason="scikit-fem, which builds the plates, is not installed")

from nmt_laboratories import plates

PLATE = replace(plates.drawn(5), off=1.0)
COMPARED = 6


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return plates.write_model(PLATE, tmp_path_factory.mktemp("plate"))


def frequencies(model, *changes):
    structure = build_structure(load_rig(model, list(changes)))
    return np.sqrt(eigh(structure.stiffness, structure.mass, eigvals_only=True)[:COMPARED]) / (2.0 * np.pi)


def full(**changes):
    return plates.modes_of(replace(PLATE, **changes), plates.MODEL_ELEMENTS).omega[:COMPARED] / (2.0 * np.pi)


def test_the_band_that_is_stated_holds_the_frequencies_to_a_thousandth(model):
    source = load_rig(model).structure.source
    band_hz = float(source.split(" up to ")[1].split(" Hz")[0])
    exact = full(kind=plates.HEALTHY)
    assert np.sum(exact < band_hz) >= 2
    np.testing.assert_allclose(frequencies(model)[exact < band_hz], exact[exact < band_hz], rtol=1e-3)


@pytest.mark.parametrize("size", with_quick([1, 2, 3], 1))
def test_up_to_the_stated_frequency_a_reduction_is_the_full_plate(size):
    """Frequencies and responses to 0.1 %, whatever the mesh, through resonances of η = 2 %."""
    stiffness, mass, at = plates.specimen_matrices(replace(PLATE, kind=plates.HEALTHY), (8 * size, 6 * size))
    small = craig_bampton(Matrices(mass, stiffness).checked(), at.tolist(), 24)
    exact = np.sqrt(eigsh(stiffness, 12, M=mass, sigma=0.0, v0=np.ones(mass.shape[0]), return_eigenvectors=False))
    inside = np.sort(exact)[np.sort(exact) < 2.0 * np.pi * small.band_hz]
    assert inside.size >= 6
    found = np.sqrt(eigh(small.stiffness, small.mass, eigvals_only=True))[: inside.size]
    np.testing.assert_allclose(found, inside, rtol=TRUNCATION)
    force = np.zeros(mass.shape[0])
    force[at[0]] = 1.0
    loss = 1.0 + 0.02j
    for omega in 2.0 * np.pi * np.linspace(5.0, small.band_hz, 25):
        full_response = splu((stiffness * loss - omega**2 * mass).tocsc()).solve(force.astype(complex))[at]
        response = np.linalg.solve(small.stiffness * loss - omega**2 * small.mass, np.eye(small.size)[:, 0])[: at.size]
        assert np.max(np.abs(response - full_response)) < TRUNCATION * np.max(np.abs(full_response))


CHANGES = {
    "a soft patch": ("patch2.stiffness_factor=0.5", {"kind": plates.STIFFNESS, "at": 2, "factor": 0.5}),
    "a stiff patch": ("patch3.stiffness_factor=1.8", {"kind": plates.STIFFNESS, "at": 3, "factor": 1.8}),
    "a heavy patch": ("patch1.mass_factor=1.8", {"kind": plates.MASS, "at": 1, "factor": 1.8}),
    "a clamp that turns": (
        f"clamp.rotational_compliance_rad_nm={PLATE.compliance}",
        {"kind": plates.BOUNDARY, "compliance": PLATE.compliance},
    ),
}


@pytest.mark.parametrize(("change", "truth"), CHANGES.values(), ids=CHANGES)
def test_a_change_of_a_region_is_that_of_the_full_model(model, change, truth):
    """Frequencies that move by 1 to 13 % are right to 0.05 %, by a clamp to 0.1 %."""
    exact, before = full(**truth), full(kind=plates.HEALTHY)
    assert np.max(np.abs(exact / before - 1.0)) > 0.05
    # Springs of the clamp have the form of its deflections, those of the full model that of its slopes.
    rtol = 1e-3 if truth["kind"] == plates.BOUNDARY else 5e-4
    np.testing.assert_allclose(frequencies(model, f"structure.regions.{change}"), exact, rtol=rtol)


@pytest.mark.parametrize("softer", [4.0, 16.0, 64.0])
def test_a_clamp_that_turns_is_that_of_the_full_model_however_soft(model, softer):
    """Up to three quarters of the first frequency are lost; what is left is right to 0.1 %."""
    compliance = softer * PLATE.compliance
    exact, before = full(kind=plates.BOUNDARY, compliance=compliance), full(kind=plates.HEALTHY)
    assert exact[0] < (1.0 - 0.1 * np.log2(softer)) * before[0]
    found = frequencies(model, f"structure.regions.clamp.rotational_compliance_rad_nm={compliance}")
    np.testing.assert_allclose(found, exact, rtol=1e-3)


def test_the_factor_on_all_stiffness_is_none_on_the_springs_of_a_support(model):
    """A clamp keeps its stiffness in N m/rad where the modulus of the plate is corrected."""
    compliance = 4.0 * PLATE.compliance
    exact = full(kind=plates.BOUNDARY, compliance=compliance, modulus=1.2 * PLATE.modulus)
    soft = f"structure.regions.clamp.rotational_compliance_rad_nm={compliance}"
    found = frequencies(model, "structure.stiffness_factor=1.2", soft)
    np.testing.assert_allclose(found, exact, rtol=1e-3)
    assert found[0] < 0.99 * np.sqrt(1.2) * frequencies(model, soft)[0]


def test_rows_of_a_support_that_no_mode_moves_have_no_pattern():
    """A rotation that nothing couples to the structure: one pattern of the translation, none of the rotation."""
    stiffness = np.diag([2.0, 2.0, 1.0, 5.0]) - np.diag([1.0, 1.0, 0.0], 1) - np.diag([1.0, 1.0, 0.0], -1)
    rows = [np.array(each, dtype=np.int64) for each in ([2], [3], [])]
    found = supported(Matrices(np.eye(4), stiffness), [0], 1, [Support("clamp", 1, *rows)])
    assert {kind: len(columns) for (_, kind), columns in found.patterns.items()} == {0: 1, 1: 0}


SLOPES = {
    "stiffness": ("patch2.stiffness_factor", plates.STIFFNESS, {"at": 2}),
    "mass": ("patch1.mass_factor", plates.MASS, {"at": 1}),
}


@pytest.mark.parametrize(("key", "kind", "more"), SLOPES.values(), ids=SLOPES)
def test_slopes_are_differences_of_the_full_model(model, key, kind, more):
    step = 1e-3
    exact = (full(kind=kind, factor=1.0 + step, **more) - full(kind=kind, factor=1.0 - step, **more)) / (2.0 * step)
    lower, upper = (frequencies(model, f"structure.regions.{key}={1.0 + sign * step}") for sign in (-1.0, 1.0))
    np.testing.assert_allclose((upper - lower) / (2.0 * step), exact, rtol=2e-3, atol=2e-4 * np.max(np.abs(exact)))


def test_a_region_changes_the_responses_as_in_the_full_model(model):
    """Accelerances at all points by a force, between 0.6 of the first frequency and the sixth.

    A frequency that is off by 1e-4 is one per cent of a resonance of ζ = 1 %.
    """
    truth = replace(PLATE, kind=plates.STIFFNESS, at=2, factor=0.7, ratio=0.01)
    modes = plates.modes_of(truth, plates.MODEL_ELEMENTS)
    hz = np.geomspace(0.6 * modes.omega[0], modes.omega[5], 60) / (2.0 * np.pi)
    structure = build_structure(load_rig(model, ["structure.regions.patch2.stiffness_factor=0.7"]))
    squares, shapes = eigh(structure.stiffness, structure.mass)
    zeta = plates.damping_ratios(truth, np.sqrt(squares) * modes.omega[0] / np.sqrt(squares[0]))
    at = np.array([shapes[structure.points[point]] for point in range(1, 5)])
    w = 2.0 * np.pi * hz
    gains = at[truth.driven - 1][:, None] / (squares[:, None] - w**2 + 2j * (zeta * np.sqrt(squares))[:, None] * w)
    exact = plates.accelerances(truth, modes, hz)
    error = np.abs(-(w**2) * (at @ gains) - exact)
    assert np.max(error / np.max(np.abs(exact), axis=1, keepdims=True)) < 1e-2


def strip(elements: int, length: float, consistent: bool = True) -> np.ndarray:
    """Mass of a line of two-node elements, kg for 1 kg/m."""
    mass = np.zeros((elements + 1,) * 2)
    for k in range(elements):
        element = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0 if consistent else np.eye(2) / 2.0
        mass[k : k + 2, k : k + 2] += length / elements * element
    return mass


def test_springs_of_a_support_are_as_stiff_all_along_it():
    """Turning it takes n L²/12, whatever the mesh; a lumped mass leaves springs at the nodes, half of one at the ends.

    Rotations get what the translations of their nodes have.
    """
    for elements in (2, 6):
        nodes, places = elements + 1, np.linspace(-0.5, 0.5, elements + 1)
        rows, labels = np.arange(nodes), np.arange(1, nodes + 1) * 100 + 3
        turned = np.array([*range(2 * nodes)]), np.concatenate([labels + 1, labels + 2])
        springs = spread_of(strip(elements, 1.0), rows, labels, rows, labels).toarray()
        np.testing.assert_allclose(springs.sum(), nodes)
        np.testing.assert_allclose(places @ springs @ places, nodes / 12.0)
        both = spread_of(strip(elements, 1.0), rows, labels, *turned).toarray()
        np.testing.assert_allclose(both, np.kron(np.eye(2), springs))
        lumped = spread_of(strip(elements, 1.0, consistent=False), rows, labels, rows, labels).toarray()
        share = np.r_[0.5, np.ones(elements - 1), 0.5]
        np.testing.assert_allclose(lumped, np.diag(share * nodes / share.sum()))


def test_a_support_without_mass_has_a_spring_at_each_row():
    labels = np.array([103, 203])
    np.testing.assert_array_equal(
        spread_of(np.diag([1.0, 0.0]), np.arange(2), labels, np.arange(2), labels).toarray(), np.eye(2)
    )


def test_regions_travel_with_the_rig(model, tmp_path):
    rig = load_rig(model, ["structure.regions.patch2.stiffness_factor=0.7"])
    (tmp_path / "rig.yaml").write_text(rig_text(rig, model))
    again = load_rig(tmp_path / "rig.yaml", ["structure.regions.clamp.rotational_compliance_rad_nm=1e-6"])
    one, other = (
        build_structure(each)
        for each in (
            again,
            load_rig(
                model,
                [
                    "structure.regions.patch2.stiffness_factor=0.7",
                    "structure.regions.clamp.rotational_compliance_rad_nm=1e-6",
                ],
            ),
        )
    )
    np.testing.assert_allclose(one.stiffness, other.stiffness, rtol=1e-12)
    assert rig.structure.regions["patch2"].nodes == again.structure.regions["patch2"].nodes


def test_what_was_read_is_told(model):
    source = load_rig(model).structure.source
    assert "region clamp: 7 nodes, held in translations and rotations" in source
    patch = load_rig(model).structure.regions["patch1"]
    length, width, thickness = PLATE.size
    cells = plates.CELLS[0] * plates.CELLS[1]
    np.testing.assert_allclose(patch.moved_kg, PLATE.density * length * width * thickness * 4 / cells, rtol=1e-9)
    assert f"region patch1: 25 nodes, {patch.moved_kg:.4g} kg, with a stiffness of its own" in source
    assert "region twist: 63 nodes, with a stiffness of its own" in source


def test_nodes_alone_have_a_mass_and_a_box_names_them(model):
    length = PLATE.size[0]
    text = model.read_text()
    start = text.index("patch1:")
    boxed = model.parent / "boxed.yaml"
    end = text.index("patch2:")
    indent = text[:start].rsplit("\n", 1)[1]
    box = f"[[{0.74 * length}, -1, -1], [{1.1 * length}, 1, 1]]"
    boxed.write_text(f"{text[:start]}patch1:\n{indent}  within: {box}\n{indent}{text[end:]}")
    region = load_rig(boxed).structure.regions["patch1"]
    assert len(region.nodes) == 21
    assert region.stiffness_n_m is None
    # Half an element more than the strip of a quarter, in which the block of its rows ends.
    strip = PLATE.density * np.prod(PLATE.size) / 4.0
    assert strip < region.moved_kg < strip * 1.5
    with pytest.raises(BenchError, match="stiffness_factor needs a stiffness of its own; give file"):
        load_rig(boxed, ["structure.regions.patch1.stiffness_factor=0.5"])


REFUSED = {
    "an unknown node": ({"nodes": [4, 999]}, "region wrong: node 999 is not among the 63 nodes"),
    "an empty region": ({}, "region wrong: it has neither nodes nor a file"),
    "an empty box": ({"within": [[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]]}, "no node of the model lies within it"),
    "one corner": ({"within": [[5.0, 5.0, 5.0]]}, "within must be two corners"),
    "no file": ({"file": "none.npz"}, "region wrong: there is no file"),
    "a file of points": ({"held": True, "file": "patch1.npz"}, "it is held and has a file"),
    "held nothing": ({"held": True}, "it is held and names no nodes"),
    "held twice": ({"held": True, "nodes": [1]}, "regions clamp and wrong both hold node 1"),
    "a held point": ({"held": True, "within": [[0.2, -1, -1], [9, 9, 9]]}, "is both a point's and of a region"),
    "a key of the bench": ({"nodes": [4], "stiffness_n_m": [[1.0]]}, "stiffness_n_m is written by the bench"),
}


@pytest.mark.parametrize(("region", "says"), REFUSED.values(), ids=REFUSED)
def test_regions_that_do_not_fit_are_named(model, region, says):
    from nmt_core.files.yaml_text import yaml_text
    from nmt_rig.rig_file import read_document

    values = read_document(model).values
    structure = values["structure"]
    changed = {**values, "structure": {**structure, "regions": {**structure["regions"], "wrong": region}}}
    file = model.parent / "wrong.yaml"
    file.write_text(yaml_text(changed))
    with pytest.raises(BenchError, match=says):
        load_rig(file)


def test_a_region_of_a_structure_without_nodes_is_refused(tmp_path):
    np.savez(tmp_path / "two.npz", M=np.eye(3), K=np.diag([1.0, 2.0, 3.0]))
    text = rig_text(load_rig("beam"), None, ["x=y"])
    start, end = text.index("structure:"), text.index("local_elements:")
    section = "kind: matrices, file: two.npz, points_at: [{point: 2, row: 0}, {point: 7, row: 1}]"
    file = tmp_path / "rig.yaml"
    for more, says in (
        ("modes: 1, regions: {part: {nodes: [1]}}", "the files do not say which node a row belongs to"),
        ("regions: {part: {nodes: [1]}}", "structure.regions need structure.modes"),
        ("modes: 1, regions: [4]", "must be regions by name"),
        ("modes: 1, regions: {a.b: {nodes: [1]}}", "a name begins with a letter"),
    ):
        file.write_text(f"{text[:start]}structure: {{{section}, {more}}}\n{text[end:]}")
        with pytest.raises(BenchError, match=says):
            load_rig(file)
    file.write_text(f"{text[:start]}structure: {{kind: beam, regions: {{}}}}\n{text[end:]}")
    with pytest.raises(BenchError, match="regions"):
        load_rig(file)
