"""Writers of the files that finite-element programs make of one small structure, each by the rules of its format."""

from __future__ import annotations

import struct

import numpy as np
from matrix.element_structures import ElementStructure
from scipy import sparse
from scipy.linalg import eigh

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


KEPT_WORDS = ("K", "M"), ("KAAX", "MAAX"), ("K40", "M40"), ("K2", "M2"), ("KXX", "MXX")
REPORTED = ("dmig twice", "dmig mnemonics", "harwell-boeing", "comsol 7.3", "lagrange", "no number", "included")
"""Kinds of files that users brought; each is generated by a seed."""


def drawn_structure(generator):
    """A random rod, beam, chain or membrane with the names of its rows."""
    kind = ("rod", "beam", "chain", "membrane")[generator.integers(4)]
    mass, stiffness, rows = ElementStructure(
        kind, int(generator.integers(4, 9)), bool(generator.integers(2))
    ).matrices()
    nodes = int(generator.integers(0, 10**6)) + rows[:, 0]
    return mass.toarray(), stiffness.toarray(), list(zip(nodes.tolist(), rows[:, 1].tolist(), strict=True))


def reported(kind, seed, folder):
    """Paths of a file of a reported kind, and what must come: the lowest angular frequencies, or words of a refusal."""
    generator = np.random.default_rng([seed, REPORTED.index(kind)])
    mass, stiffness, rows = drawn_structure(generator)
    squares = 1.0 / eigh(mass, stiffness, eigvals_only=True)[::-1][:2]
    right = np.sqrt(squares)
    if kind == "harwell-boeing":
        for letter, matrix in (("k", stiffness), ("m", mass)):
            ending = ("matrix", "rsa", "txt")[seed % 3]
            harwell_boeing(folder / f"job_{letter}.{ending}", matrix, generator)
        return {"stiffness_file": folder / f"job_k.{ending}", "mass_file": folder / f"job_m.{ending}"}, "MMF of APDL"
    if kind == "comsol 7.3":
        names = (("Kc", "Ec"), ("K", "E"), ("K", "M"), ("stiffness", "mass"))[seed % 4]
        matlab_sparse(folder / "model.mat", dict(zip(names, (stiffness, mass), strict=True)))
        return {"file": folder / "model.mat"}, right
    if kind == "lagrange":
        return _tied(folder, mass, stiffness, rows, generator), "is a Lagrange multiplier"
    if kind == "no number":
        which = (mass, stiffness)[generator.integers(2)]
        at = generator.integers(len(rows), size=2) if generator.integers(2) else [generator.integers(len(rows))] * 2
        which[at[0], at[1]] = which[at[1], at[0]] = (np.nan, np.inf)[generator.integers(2)]
        if seed % 3 == 0:
            entry_list(folder / "job_STIF1.mtx", stiffness, rows)
            entry_list(folder / "job_MASS1.mtx", mass, rows)
            return {"file": folder / "job_STIF1.mtx"}, "finite|not a number"
        if seed % 3 == 1:
            named_npz(folder / "model.npz", {"stiffness": stiffness, "mass": mass}, rows, np.zeros((0, 4)))
            return {"file": folder / "model.npz"}, "not finite numbers"
    name = dict(zip(("stiffness", "mass"), KEPT_WORDS[generator.integers(len(KEPT_WORDS))], strict=True))
    path, cards = folder / f"model.{('pch', 'bdf', 'dat')[seed % 3]}", []
    for quantity, matrix in (("stiffness", stiffness), ("mass", mass)):
        cards.append(bulk(name[quantity], matrix, rows, generator))
    text = "$ punched\n" + "\n".join(cards) + "\n"
    if kind == "dmig twice":
        one = bulk(name["mass"], mass, rows, generator)
        more = (text, one + "\n", one.split("\n", 1)[1] + "\n")[generator.integers(3)]
        path.write_text(text + more)
        return {"file": path}, "twice"
    if kind == "included":
        statement = ("INCLUDE 'more.bdf'", "include more.bdf", "INCLUDE\t'a/b/more.pch'")[generator.integers(3)]
        path.write_text(f"{statement}\n{text}" if generator.integers(2) else f"{text}{statement}\n")
        return {"file": path}, "it includes .*more"
    path.write_text(text)
    return {"file": path}, right if kind == "dmig mnemonics" else "finite"


def bulk(name, matrix, rows, generator):
    """DMIG of a lower triangle in the large or the small form, with or without names of the continuations."""
    # Three to five figures are a structure only where neighbours alone are coupled.
    large = bool(generator.integers(2)) or np.any(np.triu(np.nan_to_num(matrix), 2))
    named = bool(generator.integers(2))
    heading = f"DMIG    {name:<8}{0:>8}{6:>8}{2:>8}{0:>8}{'':8}{'':8}{len(rows):>8}"
    lines, count, letter = [heading], 0, name[:1]
    width, star = (16, "*") if large else (8, "")
    for j, (node, direction) in enumerate(rows):
        below = [i for i in range(j, len(rows)) if matrix[i, j] != 0.0]
        if not below:
            continue
        mark = f"{'*' if large else '+'}{letter}{count:05d}" if named else f"{'*' if large else '':<8}"
        fields = f"{f'DMIG{star}':<8}{name:<{width}}{node:>{width}}{direction:>{width}}{'':{width}}"
        if large:
            lines.append(fields + (mark if named else ""))
            later = below
        else:
            first, later = below[0], below[1:]
            fields += f"{rows[first][0]:>8}{rows[first][1]:>8}{short(matrix[first, j]):>8}"
            lines.append(f"{fields:<72}{mark if named else ''}")
        for i in later:
            value = short(matrix[i, j]) if not large else nastran_word(matrix[i, j], generator)
            count += 1
            new = f"{'*' if large else '+'}{letter}{count:05d}" if named else ""
            fields = f"{mark:<8}{rows[i][0]:>{width}}{rows[i][1]:>{width}}{value:>{width}}"
            lines.append(f"{fields:<72}{new}".rstrip())
            mark = new or mark
        count += 1
    return "\n".join(lines)


def short(value):
    """Eight characters, as 1.234+5 or -1.23-4."""
    if not np.isfinite(value):
        return "1+9999" if value > 0 else str(value)
    for digits in range(6, 0, -1):
        mantissa, _, exponent = f"{value:.{digits}e}".partition("e")
        word = f"{mantissa}{int(exponent):+d}"
        if len(word) <= 8:
            return word
    raise AssertionError(value)


def nastran_word(value, generator):
    """A real of sixteen characters in one of the ways that programs write them."""
    if not np.isfinite(value):
        return "1+9999" if value > 0 else str(value)
    return (nastran(value), f"{value:.9E}", f"{value:.8E}".replace("E", ""))[generator.integers(3)]


def harwell_boeing(path, matrix, generator):
    """A lower triangle by columns, as HBMAT of Ansys writes it."""
    part = sparse.csc_matrix(np.tril(matrix))
    lists = (part.indptr + 1, "%14d"), (part.indices + 1, "%14d"), (part.data, "%25.15e")
    blocks = [[form % value for value in values.tolist()] for values, form in lists]
    counts = "".join(f"{n:14d}" for n in (sum(map(len, blocks)), *map(len, blocks), 0))
    kind = ("rsa", "RSA", "rua")[generator.integers(3)]
    head = [f"{'Matrix dumped from file.full':<72}{'matrix':<8}", counts]
    head.append(f"{kind:<14}" + "".join(f"{n:14d}" for n in (*matrix.shape, part.nnz, 0)))
    head.append(f"{'(1i14)':<16}{'(1i14)':<16}{'(1e25.15)':<20}")
    path.write_text("\n".join([*head, *(word for block in blocks for word in block)]) + "\n")


def matlab_sparse(path, matrices):
    """Sparse matrices as MATLAB writes them with -v7.3: columns, and the number of rows as an attribute."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, matrix in matrices.items():
            part, group = sparse.csc_matrix(matrix), file.create_group(name)
            group.attrs["MATLAB_class"], group.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(part.shape[0])
            group["data"], group["ir"] = part.data, part.indices.astype("u8")
            group["jc"] = part.indptr.astype("u8")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def _tied(folder, mass, stiffness, rows, generator):
    """A node that is tied to a free mass by a multiplier, as Abaqus lists it."""
    node, direction = rows[generator.integers(len(rows))]
    multiplier = int(-generator.integers(1, 9)) if generator.integers(2) else 9_000_000
    entry_list(folder / "job_STIF1.mtx", stiffness, rows)
    entry_list(folder / "job_MASS1.mtx", mass, rows)
    tie = f"{multiplier},1, {node},{direction}, 1.0\n{multiplier},1, 8000000,3, -1.0\n8000000,3, 8000000,3, 0.0\n"
    with (folder / "job_STIF1.mtx").open("a") as file:
        file.write(tie)
    with (folder / "job_MASS1.mtx").open("a") as file:
        file.write("8000000,3, 8000000,3, 0.05\n")
    return {"file": folder / "job_STIF1.mtx"}
