"""Makes the measurements of the three folders beside it, each of a specimen that its model does not describe.

    python examples/measured_data.py

Nothing of the bench takes part: a Duffing oscillator in closed form, a planar arm by Lagrange's equations, a strip by
scikit-fem with one part softer than in the model.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
Array = NDArray[np.float64]

CUBIC = 2.4e9
"""Cubic stiffness of the oscillator over its mass, N/(kg m³); its model is linear."""
FRICTION = 1.4
"""Coulomb friction of the elbow, N·m; the file of the arm has 0.5."""
ROOT_FACTOR = 0.7
"""Stiffness of the strip's first 50 mm over that of its model."""


def bench(folder: Path) -> None:
    """Sine stepped up and down through the resonance at four forces (Nayfeh and Mook 1979, section 4.1)."""
    omega_0, damping = 2 * np.pi * 50, 2 * 0.01 * 2 * np.pi * 50
    random = np.random.default_rng(1)
    segments = []
    for force in (0.5, 1.0, 2.0, 3.0):
        for direction, branch in (("up", -1), ("down", 0)):
            rows = ["frequency_hz,real,imag"]
            for hz in np.linspace(47, 54, 141):
                omega = 2 * np.pi * hz
                a, b = omega_0**2 - omega**2, 0.75 * CUBIC
                squares = np.roots([b * b, 2 * a * b, a * a + (damping * omega) ** 2, -(force**2)])
                states = sorted(z.real for z in squares if abs(z.imag) < 1e-9 * abs(z))
                response = -(omega**2) / (a + b * states[branch] + 1j * damping * omega)
                response *= np.exp(0.005 * (random.standard_normal() + 1j * random.standard_normal()))
                rows.append(f"{hz:g},{response.real:.6g},{response.imag:.6g}")
            name = f"{direction}_{force:g}N.csv"
            (folder / name).write_text("\n".join(rows) + "\n", encoding="utf-8")
            segments.append(
                f"  - {{kind: frf, file: {name}, unit: m/s^2/N, point: 1, drive_point: 1, level: {force:g}, "
                f"level_unit: N, direction: {direction}, noise: 0.5, name: {force:g} N {direction}}}"
            )
    sidecar = "rig: one_mode.yaml\nfile: up_0.5N.csv\nsegments:\n" + "\n".join(segments) + "\n"
    (folder / "measured.yaml").write_text(sidecar, encoding="utf-8")
    (folder / "one_mode.yaml").write_text(
        "name: one_mode\n"
        "structure: {kind: modal, modes: [{frequency_hz: 50.0, damping_ratio: 0.01, modal_mass_kg: 1.0}]}\n",
        encoding="utf-8",
    )


MASSES, LENGTHS, INERTIAS = (1.6, 0.9), (0.32, 0.26), (0.02, 0.008)
ARMATURES, DAMPINGS, FRICTIONS, GRAVITY = (0.04, 0.03), (0.3, 0.2), (0.6, 0.5), 9.81


def robot(folder: Path) -> None:
    """A planar arm that hangs, both joints driven towards commands by known gains, 30 s at 500 Hz."""
    joint = '<joint name="{}" type="hinge" axis="0 1 0" armature="{}" damping="{}" frictionloss="{}"/>'
    inertia = '<inertial pos="0 0 {}" mass="{}" diaginertia="{} {} {}"/>'
    upper, fore = (
        inertia.format(-length / 2, mass, *3 * (about,)) + joint.format(name, *drive)
        for name, length, mass, about, drive in zip(
            ("shoulder", "elbow"),
            LENGTHS,
            MASSES,
            INERTIAS,
            zip(ARMATURES, DAMPINGS, FRICTIONS, strict=True),
            strict=True,
        )
    )
    (folder / "arm.xml").write_text(
        f'<mujoco model="arm">\n  <compiler angle="radian"/>\n  <worldbody>\n    <body name="upper">{upper}\n'
        f'      <body name="fore" pos="0 0 {-LENGTHS[0]}">{fore}</body>\n    </body>\n  </worldbody>\n  <actuator>\n'
        '    <motor joint="shoulder" ctrlrange="-40 40"/>\n    <motor joint="elbow" ctrlrange="-40 40"/>\n'
        "  </actuator>\n</mujoco>\n",
        encoding="utf-8",
    )
    rate, fine = 500, 8
    time = np.arange(30 * rate * fine) / (rate * fine)
    phase = 2 * np.pi * (0.15 * time + 0.01 * time**2)
    command = np.column_stack(
        [
            0.5 * np.sin(phase) + 0.2 * np.sin(2.3 * phase + 1.0),
            0.4 + 0.6 * np.sin(1.3 * phase + 0.5) + 0.15 * np.sin(0.41 * phase),
        ]
    )
    gains = np.array([[80.0, 2.0], [50.0, 1.2]])
    angle, speed = command[0].copy(), np.zeros(2)
    friction = np.array([FRICTIONS[0], FRICTION])
    angles, speeds = np.empty((2, len(time), 2))
    torque = np.zeros(2)
    step = time[1]
    for row in range(len(time)):
        if row % fine == 0:
            torque = gains[:, 0] * (command[row] - angle) - gains[:, 1] * speed
        angles[row], speeds[row] = angle, speed
        mass, loads = equations(angle, speed)
        speed = speed + np.linalg.solve(mass, step * (torque - loads - np.array(DAMPINGS) * speed))
        # Friction takes speed up to its limit, joint after joint until both agree (projected Gauss-Seidel).
        impulse, free = np.zeros(2), speed.copy()
        mobility = np.linalg.inv(mass)
        for _ in range(20):
            for k in (0, 1):
                wanted = impulse[k] - (free + mobility @ impulse)[k] / mobility[k, k]
                impulse[k] = np.clip(wanted, -step * friction[k], step * friction[k])
        speed = free + mobility @ impulse
        angle = angle + step * speed
    rows = slice(None, None, fine)
    noise = 2e-5 * np.random.default_rng(2).standard_normal((len(time) // fine, 2))
    np.savez_compressed(
        folder / "log.npz",
        joints=np.array(["shoulder", "elbow"]),
        time=time[rows],
        pos=(angles[rows] + noise).astype(np.float32),
        vel=speeds[rows].astype(np.float32),
        des_pos=command[rows].astype(np.float32),
        kp=gains[:, 0],
        kd=gains[:, 1],
    )


def equations(angle: Array, speed: Array) -> tuple[Array, Array]:
    """Mass matrix (2, 2), and torque of gravity and of rotation (2,), of two links whose angles are relative."""
    (m1, m2), (l1, l2), (i1, i2) = MASSES, LENGTHS, INERTIAS
    r1, r2 = l1 / 2, l2 / 2
    cosine, sine = np.cos(angle[1]), np.sin(angle[1])
    last = i2 + m2 * r2**2
    mixed = last + m2 * l1 * r2 * cosine
    first = i1 + m1 * r1**2 + m2 * l1**2 + last + 2 * m2 * l1 * r2 * cosine
    mass = np.array([[first + ARMATURES[0], mixed], [mixed, last + ARMATURES[1]]])
    bend = m2 * l1 * r2 * sine
    outer = m2 * GRAVITY * r2 * np.sin(angle.sum())
    inner = (m1 * r1 + m2 * l1) * GRAVITY * np.sin(angle[0])
    return mass, np.array([-bend * (2 * speed[0] + speed[1]) * speed[1] + inner + outer, bend * speed[0] ** 2 + outer])


def strip(folder: Path) -> None:
    """A clamped strip of aluminium in mm, t and N: matrices of the model, of its root, and responses of the "
    "specimen."""
    from scipy.linalg import eigh
    from skfem import Basis, BilinearForm, ElementTetP2, ElementVector, MeshTet
    from skfem.helpers import dot
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    mesh = MeshTet.init_tensor(np.linspace(0, 300, 13), np.linspace(0, 40, 3), np.linspace(0, 6, 2))
    element = ElementVector(ElementTetP2())
    basis = Basis(mesh, element)
    root = Basis(mesh, element, elements=np.flatnonzero(mesh.p[0][mesh.t].mean(axis=0) < 50))
    places, number = np.unique(basis.doflocs.T.round(6), axis=0, return_inverse=True)
    rows = np.stack([number.ravel() + 1, np.zeros(basis.N, int)], axis=1)
    for dofs in (basis.nodal_dofs, basis.edge_dofs):
        rows[dofs, 1] = np.arange(1, 4)[:, None]
    free = basis.complement_dofs(basis.get_dofs(lambda x: x[0] == 0))
    common = {"rows": rows[free], "nodes": np.column_stack([np.arange(1, len(places) + 1), places])}
    elastic = linear_elasticity(*lame_parameters(70e3, 0.33))
    inert = BilinearForm(lambda u, v, w: 2.7e-9 * dot(u, v))
    matrices = {}
    for name, part in (("strip", basis), ("root", root)):
        arrays = dict(common)
        for key, form in (("K", elastic), ("M", inert)):
            matrix = form.assemble(part)[free][:, free].tocsr()
            matrix.eliminate_zeros()
            matrices[name, key] = matrix
            arrays |= {f"{key}_{field}": getattr(matrix, field) for field in ("data", "indices", "indptr", "shape")}
        np.savez_compressed(folder / f"{name}.npz", **arrays)

    stiffness = matrices["strip", "K"] + (ROOT_FACTOR - 1.0) * matrices["root", "K"]
    squares, shapes = eigh(stiffness.toarray(), matrices["strip", "M"].toarray())
    points = [
        int(np.flatnonzero((rows[free] == (node, 3)).all(axis=1))[0])
        for place in ((150, 20, 6), (300, 20, 6))
        for node in (1 + int(np.abs(places - place).sum(axis=1).argmin()),)
    ]
    hertz = np.linspace(20, 1100, 1081)
    omega = 2 * np.pi * hertz[:, None]
    terms = shapes[points[0]] / (squares - omega**2 + 2j * 0.003 * omega * np.sqrt(squares))
    random = np.random.default_rng(3)
    for point, row in enumerate(points, 1):
        response = -(omega[:, 0] ** 2) * (terms @ shapes[row]) / 1000.0  # m/s² per N
        response *= 1.0 + 0.01 * (random.standard_normal(len(hertz)) + 1j * random.standard_normal(len(hertz)))
        lines = [f"{f:g},{h.real:.6g},{h.imag:.6g}" for f, h in zip(hertz, response, strict=True)]
        (folder / f"a{point}.csv").write_text("frequency_hz,real,imag\n" + "\n".join(lines) + "\n", encoding="utf-8")
    (folder / "measured.yaml").write_text(
        "rig: strip.yaml\nfile: a1.csv\nsegments:\n"
        + "".join(
            f"  - {{kind: frf, file: a{point}.csv, unit: m/s^2/N, point: {point}, drive_point: 1, noise: 1.4, "
            f"name: point {point}}}\n"
            for point in (1, 2)
        ),
        encoding="utf-8",
    )


if __name__ == "__main__":
    for make in (bench, robot, strip):
        (HERE / make.__name__).mkdir(exist_ok=True)
        make(HERE / make.__name__)
