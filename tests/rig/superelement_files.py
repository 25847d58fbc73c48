"""Writers of the files that finite-element programs make of one small structure, each by the rules of its format."""

from __future__ import annotations

import struct

import numpy as np
from scipy import sparse

from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_structure

NAMES = ("stiffness", "mass")


def cantilever():
    """Mass and stiffness of the shipped beam's elements, with node and direction (z 3, ry 5) of each row, and nodes."""
    structure = build_structure(load_rig("beam"))
    pairs = {}
    for point in structure.points:
        pairs[structure.points[point]] = (10 * point, 3)
        pairs[structure.rotations[point]] = (10 * point, 5)
    rows = [pairs[row] for row in range(structure.mass.shape[0])]
    nodes = np.array([[10 * point, 0.1 * point, 0.0, 0.0] for point in structure.points])
    return {"mass": structure.mass, "stiffness": structure.stiffness}, rows, nodes


def entry_list(path, matrix, rows, upper=False):
    """node,dof, node,dof, value: *MATRIX OUTPUT, FORMAT=MATRIX INPUT of Abaqus, one triangle."""
    lines = [
        f"{rows[i][0]},{rows[i][1]}, {rows[j][0]},{rows[j][1]}, {matrix[i, j]:23.16e}"
        for i, j in zip(*np.nonzero(matrix), strict=True)
        if (j >= i if upper else j <= i)
    ]
    path.write_text("\n".join(lines) + "\n")


def substructure(path, matrices, rows):
    """*USER ELEMENT and lower triangles, four numbers a line, nodes of two degrees of freedom."""
    nodes = [rows[k][0] for k in range(0, len(rows), 2)]
    lines = ["**", "** ELEMENT NUMBER 1", f"*USER ELEMENT, NODES= {len(nodes)}, LINEAR", "** ELEMENT NODES"]
    for start in range(0, len(nodes), 4):
        lines.append("** " + ", ".join(map(str, nodes[start : start + 4])))
    lines.append("3, 5")
    for name, matrix in matrices.items():
        lines.append(f"*MATRIX,TYPE={name.upper()}")
        for row in range(len(rows)):
            for start in range(0, row + 1, 4):
                numbers = matrix[row, start : min(start + 4, row + 1)]
                lines.append(" ,".join(f"{x:.16e}" for x in numbers) + " ,")
    path.write_text("\n".join(lines) + "\n")


def calculix(folder, matrices, rows):
    """job.sti, job.mas with the upper triangle, job.dof."""
    for name, ending in (("stiffness", "sti"), ("mass", "mas")):
        matrix = matrices[name]
        lines = [f"{i + 1} {j + 1} {matrix[i, j]:23.16e}" for i, j in zip(*np.nonzero(matrix), strict=True) if j >= i]
        (folder / f"job.{ending}").write_text("\n".join(lines) + "\n")
    (folder / "job.dof").write_text("".join(f"{node}.{direction}\n" for node, direction in rows))


def dmig(path, matrices, rows, nodes, form="large"):
    """Punched DMIG with GRID cards, large fields of 16 characters, small of 8, or free."""
    lines = ["$ BULK DATA"]
    lines += [f"GRID    {int(n):<16d}{x:<8.4f}{y:<8.4f}{z:<8.4f}" for n, x, y, z in nodes]
    for name, title in (("stiffness", "KAAX"), ("mass", "MAAX")):
        matrix = matrices[name]
        lines.append(f"DMIG    {title:<8}{0:>8}{6:>8}{2:>8}{0:>8}{'':8}{len(rows):>8}")
        for j, (node, direction) in enumerate(rows):
            below = [i for i in range(j, len(rows)) if matrix[i, j] != 0.0]
            if form == "large":
                lines.append(f"DMIG*   {title:<16}{node:>16}{direction:>16}")
                for i in below:
                    lines.append(f"*       {rows[i][0]:>16}{rows[i][1]:>16}{nastran(matrix[i, j]):>16}")
            else:
                lines.append(f"DMIG,{title},{node},{direction},,{triple(rows, matrix, below[0], j)}")
                lines += [f",{triple(rows, matrix, i, j)}" for i in below[1:]]
    path.write_text("\n".join(lines) + "\n")


def triple(rows, matrix, i, j):
    return f"{rows[i][0]},{rows[i][1]},{matrix[i, j]:.16E}"


def nastran(value):
    """Sixteen characters with a D or without a letter, as Nastran writes them."""
    return f"{value:.9E}".replace("E", "D") if value > 0.0 else f"{value:.10E}".replace("E", "")


def op2(path, matrices):
    """OUTPUT2 of double precision without a label: records between their lengths, columns as runs of numbers."""
    content = bytearray()

    def record(*parts):
        body = b"".join(parts)
        content.extend(struct.pack("<i", len(body)) + body + struct.pack("<i", len(body)))

    def keys(*values):
        for value in values:
            record(struct.pack("<i", value))

    for number, (name, matrix) in enumerate(matrices.items(), start=101):
        n = matrix.shape[0]
        title = f"{name:<8}".encode()
        keys(2)
        record(title)
        keys(-1, 7)
        record(struct.pack("<7i", number, n, n, 6, 2, 2 * n, 10_000))
        keys(-2, 1, 0, 4)
        record(title, bytes(8))
        for column in range(n):
            keys(-3 - column, 1, 1)
            filled = np.flatnonzero(matrix[:, column])
            for run in np.split(filled, np.flatnonzero(np.diff(filled) > 1) + 1):
                keys(2 * run.size)
                record(struct.pack("<i", int(run[0]) + 1), matrix[run, column].astype("<f8").tobytes())
        keys(-3 - n, 1, 0, 0)
    keys(0)
    path.write_bytes(content)


def named_npz(path, matrices, rows, nodes):
    arrays = {letter: matrices[name] for letter, name in (("K", "stiffness"), ("M", "mass"))}
    np.savez(path, **arrays, rows=np.array(rows), nodes=nodes)


def sdynpy(path, matrices, rows):
    coordinate = np.array([(node, direction) for node, direction in rows], dtype=[("node", "<u8"), ("direction", "i1")])
    np.savez(path, **matrices, damping=0.0 * matrices["mass"], transformation=np.eye(len(rows)), coordinate=coordinate)


def write(form, folder):
    """Files of one form of the cantilever; what the rig file names of them."""
    matrices, rows, nodes = cantilever()
    if form == "abaqus entries":
        entry_list(folder / "job_STIF1.mtx", matrices["stiffness"], rows)
        entry_list(folder / "job_MASS1.mtx", matrices["mass"], rows, upper=True)
        return {"file": folder / "job_STIF1.mtx"}
    if form == "abaqus substructure":
        substructure(folder / "sub.mtx", matrices, rows)
        return {"file": folder / "sub.mtx"}
    if form == "calculix":
        calculix(folder, matrices, rows)
        return {"file": folder / "job.sti"}
    if form.startswith("dmig"):
        dmig(folder / "model.pch", matrices, rows, nodes, form.removeprefix("dmig "))
        return {"file": folder / "model.pch"}
    if form == "npz":
        named_npz(folder / "model.npz", matrices, rows, nodes)
        return {"file": folder / "model.npz"}
    if form == "sdynpy":
        sdynpy(folder / "system.npz", matrices, rows)
        return {"file": folder / "system.npz"}
    assert form == "rows beside a sparse matrix"
    for name in NAMES:
        sparse.save_npz(folder / f"{name}.npz", sparse.csr_matrix(matrices[name]))
    (folder / "rows.txt").write_text("".join(f"{node}.{direction}\n" for node, direction in rows))
    (folder / "nodes.csv").write_text("node,x,y,z\n" + "".join(f"{int(n)},{x},{y},{z}\n" for n, x, y, z in nodes))
    return {
        "mass_file": folder / "mass.npz", "stiffness_file": folder / "stiffness.npz", "rows_file": folder / "rows.txt",
        "nodes_file": folder / "nodes.csv",
    }  # fmt: skip


FORMS = (
    "abaqus entries", "abaqus substructure", "calculix", "dmig large", "dmig free", "npz", "sdynpy",
    "rows beside a sparse matrix",
)  # fmt: skip
