"""Plates by scikit-fem: specimens with an error of the model's form, and the models that their owners have.

A thin plate is held along one edge. The owner's mesh is coarser than the specimen's, and the owner has regions: the
clamp, three patches with matrices of their own, the stiffness against twist of the whole plate. A specimen of another
theory is a plate that is soft in shear (Mindlin), which no region is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from scipy import sparse
from scipy.sparse.linalg import eigsh, splu
from skfem import Basis, BilinearForm, ElementQuad2, ElementQuadBFS, ElementVector, FacetBasis, MeshQuad
from skfem.helpers import dd, ddot, dot, grad, sym_grad

from nmt_bench.data_import import import_data

HEALTHY, THEORY, BOUNDARY, STIFFNESS, MASS, DAMPING = "healthy", "theory", "boundary", "stiffness", "mass", "damping"
KINDS = (THEORY, BOUNDARY, STIFFNESS, MASS, DAMPING)
CELLS = (4, 3)
"""Cells of the plate that patches are made of; meshes have a multiple of them."""
MODEL_ELEMENTS, SPECIMEN_ELEMENTS = (8, 6), (12, 9)
MODES, LINES = 30, 200
LEAST_DAMPING = 5e-4
"""Of the material and of what holds the plate, in every mode."""


@dataclass(frozen=True)
class Plate:
    """A plate and what its owner does not know.

    Attributes:
        size: length, width and thickness, m.
        modulus, poisson, density: Pa, 1, kg/m³.
        ratio: damping ratio of the first mode.
        kind: error of the model's form.
        patches: cells of each patch.
        at: patch of the error.
        factor: on stiffness or mass of the patch, or on the shear stiffness; power of the frequency in the damping.
        compliance: of all rotational springs of the clamp together, rad/(N m).
        off: the owner's modulus over the true one.
        noise: relative deviation of a line.
        driven: number of the point with the force, from 1.
    """

    size: tuple[float, float, float]
    modulus: float
    poisson: float
    density: float
    ratio: float
    kind: str
    patches: tuple[tuple[tuple[int, int], ...], ...]
    at: int
    factor: float
    compliance: float
    off: float
    noise: float
    driven: int

    @cached_property
    def points(self) -> np.ndarray:
        """Places (4, 3) of the points, at corners of cells."""
        length, width, _ = self.size
        cells = ((4, 3), (3, 0), (2, 2), (1, 1))
        return np.array([[length * x / CELLS[0], width * y / CELLS[1], 0.0] for x, y in cells])


@dataclass(frozen=True)
class Assembled:
    """Matrices of a mesh with the clamp free.

    Attributes:
        stiffness, mass: of the whole plate.
        parts: stiffness and mass by patch ``patch1`` …; ``twist``: stiffness alone.
        edge: of springs against the slopes, 1 N m/rad in all, as stiff all along the clamp.
        places: (n, 3) of each row's node.
        nodes: (n,) number of each row's node, from 1.
        directions: (n,) 3 of w, 4 and 5 of its slopes, 7 of its twist.
    """

    stiffness: Any
    mass: Any
    parts: dict[str, tuple[Any, Any]]
    edge: Any
    places: np.ndarray
    nodes: np.ndarray
    directions: np.ndarray

    @property
    def clamped(self) -> np.ndarray:
        """Rows of the clamp."""
        return np.flatnonzero(self.places[:, 0] < 1e-9)

    def row(self, place: np.ndarray, direction: int) -> int:
        """Row of the node at a place."""
        far = np.linalg.norm(self.places - place, axis=1) + 1e3 * (self.directions != direction)
        return int(np.argmin(far))


def assembled(plate: Plate, elements: tuple[int, int]) -> Assembled:
    """Matrices of a thin plate (Bogner, Fox and Schmit): w, its slopes and its twist at each node."""
    length, width, thickness = plate.size
    mesh = MeshQuad.init_tensor(*(np.linspace(0, side, n + 1) for side, n in zip(plate.size, elements, strict=False)))
    basis = Basis(mesh, ElementQuadBFS())
    bending = plate.modulus * thickness**3 / (12.0 * (1.0 - plate.poisson**2))

    @BilinearForm
    def elastic(u, v, w):  # type: ignore[no-untyped-def]
        a, b = dd(u), dd(v)
        trace = (a[0, 0] + a[1, 1]) * (b[0, 0] + b[1, 1])
        return bending * (plate.poisson * trace + (1.0 - plate.poisson) * ddot(a, b))

    @BilinearForm
    def twisted(u, v, w):  # type: ignore[no-untyped-def]
        return 2.0 * bending * (1.0 - plate.poisson) * dd(u)[0, 1] * dd(v)[0, 1]

    @BilinearForm
    def sprung(u, v, w):  # type: ignore[no-untyped-def]
        return dot(grad(u), grad(v)) / width

    @BilinearForm
    def inertia(u, v, w):  # type: ignore[no-untyped-def]
        return plate.density * thickness * u * v

    sign = np.ones(basis.N)
    directions, nodes = np.zeros(basis.N, int), np.zeros(basis.N, int)
    # ∂w/∂y is a rotation about x, −∂w/∂x one about y.
    for dofs, direction in zip(basis.nodal_dofs, (3, 5, 4, 7), strict=True):
        directions[dofs], nodes[dofs] = direction, np.arange(1, dofs.size + 1)
    sign[directions == 5] = -1.0
    turned = sparse.diags(sign)

    def matrix(form: Any, on: Any = basis) -> Any:
        return (turned @ form.assemble(on) @ turned).tocsr()

    middle = mesh.p[:, mesh.t].mean(axis=1)
    cell = np.stack([middle[0] / length * CELLS[0], middle[1] / width * CELLS[1]]).astype(int).T.tolist()
    parts: dict[str, tuple[Any, Any]] = {}
    for number, cells in enumerate(plate.patches, start=1):
        inside = np.flatnonzero([tuple(each) in cells for each in cell])
        patch = Basis(mesh, ElementQuadBFS(), elements=inside)
        parts[f"patch{number}"] = (matrix(elastic, patch), matrix(inertia, patch))
    parts["twist"] = (matrix(twisted), None)
    places = np.column_stack([mesh.p.T, np.zeros(mesh.p.shape[1])])
    edge = matrix(sprung, FacetBasis(mesh, ElementQuadBFS(), facets=mesh.facets_satisfying(lambda x: x[0] < 1e-9)))
    return Assembled(matrix(elastic), matrix(inertia), parts, edge, places[nodes - 1], nodes, directions)


def shear_soft(plate: Plate, elements: tuple[int, int]) -> tuple[Any, Any, np.ndarray]:
    """Stiffness and mass of a Mindlin plate, held at its clamp, and its places with w in the first rows.

    Quadratic in deflection and rotations, shear by reduced integration.
    """
    length, width, thickness = plate.size
    mesh = MeshQuad.init_tensor(np.linspace(0, length, elements[0] + 1), np.linspace(0, width, elements[1] + 1))
    bending = plate.modulus * thickness**3 / (12.0 * (1.0 - plate.poisson**2))
    shear = plate.factor * plate.modulus / (2.0 * (1.0 + plate.poisson)) * thickness * 5.0 / 6.0
    scalar, vector = ElementQuad2(), ElementVector(ElementQuad2())
    w, b = Basis(mesh, scalar, intorder=4), Basis(mesh, vector, intorder=4)
    w_shear, b_shear = Basis(mesh, scalar, intorder=3), Basis(mesh, vector, intorder=3)

    @BilinearForm
    def bent(u, v, _):  # type: ignore[no-untyped-def]
        e, f = sym_grad(u), sym_grad(v)
        trace = (e[0, 0] + e[1, 1]) * (f[0, 0] + f[1, 1])
        return bending * (plate.poisson * trace + (1.0 - plate.poisson) * ddot(e, f))

    @BilinearForm
    def turned(u, v, _):  # type: ignore[no-untyped-def]
        return shear * dot(u, v)

    @BilinearForm
    def coupled(u, v, _):  # type: ignore[no-untyped-def]
        return -shear * dot(grad(u), v)

    @BilinearForm
    def sloped(u, v, _):  # type: ignore[no-untyped-def]
        return shear * dot(grad(u), grad(v))

    @BilinearForm
    def lateral(u, v, _):  # type: ignore[no-untyped-def]
        return plate.density * thickness * u * v

    @BilinearForm
    def rotary(u, v, _):  # type: ignore[no-untyped-def]
        return plate.density * thickness**3 / 12.0 * dot(u, v)

    mixed = coupled.assemble(w_shear, b_shear)
    k = sparse.bmat([
        [sloped.assemble(w_shear), mixed.T], [mixed, bent.assemble(b) + turned.assemble(b_shear)],
    ]).tocsr()  # fmt: skip
    m = sparse.block_diag([lateral.assemble(w), rotary.assemble(b)]).tocsr()
    places = np.column_stack([w.doflocs.T, np.zeros(w.N)])
    held = np.concatenate([w.get_dofs(lambda x: x[0] < 1e-9).all(), w.N + b.get_dofs(lambda x: x[0] < 1e-9).all()])
    free = np.setdiff1d(np.arange(k.shape[0]), held)
    return k[free][:, free], m[free][:, free], places[free[free < w.N]]


def specimen_matrices(plate: Plate, elements: tuple[int, int]) -> tuple[Any, Any, np.ndarray]:
    """Stiffness and mass of the truth, and the rows of its points."""
    if plate.kind == THEORY:
        k, m, places = shear_soft(plate, elements)
        return k, m, np.array([int(np.argmin(np.linalg.norm(places - place, axis=1))) for place in plate.points])
    mesh = assembled(plate, elements)
    k, m = mesh.stiffness, mesh.mass
    if plate.kind == STIFFNESS:
        k = k + (plate.factor - 1.0) * mesh.parts[f"patch{plate.at}"][0]
    elif plate.kind == MASS:
        m = m + (plate.factor - 1.0) * mesh.parts[f"patch{plate.at}"][1]
    clamped, held = mesh.clamped, mesh.clamped
    if plate.kind == BOUNDARY:
        # Turns about both axes are elastic; the lateral motion and the twist are held.
        gives = np.isin(mesh.directions[clamped], (4, 5))
        k, held = k + mesh.edge / plate.compliance, clamped[~gives]
    free = np.setdiff1d(np.arange(k.shape[0]), held)
    at = np.searchsorted(free, [mesh.row(place, 3) for place in plate.points])
    return k[free][:, free].tocsr(), m[free][:, free].tocsr(), at


@dataclass(frozen=True)
class Modes:
    """Modes of a specimen at its points.

    Attributes:
        omega: (MODES,) rad/s.
        shapes: (points, MODES), mass-normalised, lateral.
        residual: (points,) static flexibility of the modes beyond, by a force at the driven point, m/N.
    """

    omega: np.ndarray
    shapes: np.ndarray
    residual: np.ndarray


def modes_of(plate: Plate, elements: tuple[int, int] = SPECIMEN_ELEMENTS) -> Modes:
    """Modes of the truth."""
    k, m, at = specimen_matrices(plate, elements)
    squares, vectors = eigsh(k, MODES, M=m, sigma=0.0, v0=np.ones(k.shape[0]))
    force = np.zeros(k.shape[0])
    force[at[plate.driven - 1]] = 1.0
    static = splu(k.tocsc()).solve(force)[at]
    shapes = vectors[at]
    return Modes(np.sqrt(squares), shapes, static - shapes @ (shapes[plate.driven - 1] / squares))


def damping_ratios(plate: Plate, omega: np.ndarray) -> np.ndarray:
    """Of each mode: proportional to stiffness as the owner has it, or to another power of the frequency."""
    power = plate.factor if plate.kind == DAMPING else 1.0
    return np.asarray(LEAST_DAMPING + plate.ratio * (omega / omega[0]) ** power)


def accelerances(plate: Plate, modes: Modes, hz: np.ndarray) -> np.ndarray:
    """Of all points by a force at the driven one, (points, lines)."""
    w = 2.0 * np.pi * hz
    zeta = damping_ratios(plate, modes.omega)
    gains = modes.shapes[plate.driven - 1][:, None] / (
        modes.omega[:, None] ** 2 - w**2 + 2j * zeta[:, None] * modes.omega[:, None] * w
    )
    found: np.ndarray = -(w**2) * (modes.shapes @ gains + modes.residual[:, None])
    return found


def drawn(seed: int, kind: str | None = None) -> Plate:
    """A plate; errors take turns with the seed, every sixth is healthy."""
    random = np.random.default_rng([822, seed])
    kind = (*KINDS, HEALTHY)[seed % 6] if kind is None else kind
    length = float(random.uniform(0.25, 0.45))
    width = float(length * random.uniform(0.5, 0.8))
    size = (length, width, float(length * random.uniform(0.012, 0.025)))
    origins = [(x, y) for x in range(CELLS[0] - 1) for y in range(CELLS[1] - 1)]
    chosen = random.choice(len(origins), 3, replace=False)
    patches = tuple(
        tuple((origins[o][0] + dx, origins[o][1] + dy) for dx in range(2) for dy in range(2)) for o in chosen
    )
    material = ((70e9, 0.33, 2700.0), (205e9, 0.29, 7850.0))[int(random.integers(2))]
    factor = {
        STIFFNESS: float(random.choice([random.uniform(0.5, 0.8), random.uniform(1.3, 1.8)])),
        MASS: float(random.uniform(1.2, 1.8)),
        THEORY: float(10 ** random.uniform(-3.0, -2.0)),
        DAMPING: float(random.choice([-1.0, 0.0])),
    }.get(kind, 1.0)
    inertia = width * size[2] ** 3 / 12.0
    # A share of the turn of the tip by a moment there.
    compliance = float(10 ** random.uniform(-2.0, -1.0)) * length / (material[0] * inertia)
    return Plate(
        size, *material, float(10 ** random.uniform(-3.0, -2.2)), kind, patches, int(random.integers(1, 4)), factor,
        compliance, float(1.0 + 0.01 * random.standard_normal()), float(10 ** random.uniform(-2.7, -2.0)),
        int(random.integers(1, 4)),
    )  # fmt: skip


def _arrays(named: dict[str, Any]) -> dict[str, Any]:
    """Sparse matrices as an .npz has them."""
    return {
        f"{letter}_{key}": getattr(matrix.tocsr(), key)
        for letter, matrix in named.items()
        for key in ("data", "indices", "indptr", "shape")
    }


def write_model(plate: Plate, folder: Path, elements: tuple[int, int] = MODEL_ELEMENTS, modes: int = 8) -> Path:
    """The owner's model: nominal matrices, those of its regions, and the rig file, which is returned."""
    mesh = assembled(replace(plate, modulus=plate.modulus * plate.off), elements)
    rows = np.column_stack([mesh.nodes, mesh.directions])
    table = np.unique(np.column_stack([mesh.nodes, mesh.places]), axis=0)
    nominal = modes_of(replace(plate, kind=HEALTHY)).omega[0]
    beta = 2.0 * (plate.ratio + LEAST_DAMPING) / float(nominal)
    nominal_matrices = {"K": mesh.stiffness, "M": mesh.mass, "C": beta * mesh.stiffness}
    np.savez(folder / "plate.npz", rows=rows, nodes=table, **_arrays(nominal_matrices))
    regions: dict[str, Any] = {"clamp": {"nodes": np.unique(mesh.nodes[mesh.clamped]).tolist(), "held": True}}
    for name, (k, m) in mesh.parts.items():
        alone = {"K": k} | ({} if m is None else {"M": m})
        np.savez(folder / f"{name}.npz", rows=rows, **_arrays(alone))
        regions[name] = {"file": f"{name}.npz"}
    model: dict[str, Any] = {
        "name": "plate",
        "structure": {
            "kind": "matrices", "file": "plate.npz", "modes": modes, "regions": regions,
            "points_at": [
                {"point": number, "at": place.tolist(), "direction": "z"}
                for number, place in enumerate(plate.points, start=1)
            ],
        },
        "exciter": {"kind": "force", "point": plate.driven},
        "sensors": [
            {"quantity": "force", "point": "drive"},
            *({"quantity": "acceleration", "point": point} for point in range(1, len(plate.points) + 1)),
        ],
        "extraction": {"quantity": "acceleration", "linear_modes": 1},
    }  # fmt: skip
    yaml = YAML(typ="safe")
    yaml.dump(model, folder / "model.yaml")
    return folder / "model.yaml"


def recorded(plate: Plate, folder: Path, random: np.random.Generator) -> tuple[Path, Path]:
    """Model and bag: accelerances at all points over six modes, with noise, gains of 0.5 % and phases of 0.1°."""
    model = write_model(plate, folder)
    modes = modes_of(plate)
    hz = np.geomspace(0.6 * modes.omega[0], 0.5 * (modes.omega[5] + modes.omega[6]), LINES) / (2.0 * np.pi)
    segments = []
    for point, values in enumerate(accelerances(plate, modes, hz), start=1):
        gain = (1.0 + 0.005 * random.standard_normal()) * np.exp(1j * np.radians(0.1) * random.standard_normal())
        std = np.hypot(plate.noise * np.abs(values), 1e-3 * np.median(np.abs(values)))
        noisy = gain * values + std * (random.standard_normal(LINES) + 1j * random.standard_normal(LINES))
        np.savetxt(
            folder / f"p{point}.csv", np.column_stack([hz, noisy.real, noisy.imag]), delimiter=",",
            header="frequency_hz,real,imag", comments="",
        )  # fmt: skip
        segments.append(
            {"kind": "frf", "file": f"p{point}.csv", "unit": "m/s^2/N", "point": point, "drive_point": plate.driven}
        )
    yaml = YAML(typ="safe")
    yaml.dump({"rig": "model.yaml", "file": "p1.csv", "segments": segments}, folder / "data.yaml")
    import_data(folder / "data.yaml", folder / "bag")
    return model, folder / "bag"
