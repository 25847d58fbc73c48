"""Tables of compiled kernels are read by name: no whole number picks one of a tuple of them."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Names that tuples of tables go by, in the kernels and where they are made.
TABLES = {"tables", "kernel_tables", "rig", "model", "elements", "transfers", "fractions", "memory"}


def compiled_modules() -> list[Path]:
    """Modules with compiled functions, and those that make tables for them."""
    texts = {
        path: path.read_text(encoding="utf-8")
        for path in (*ROOT.glob("ros2_ws/src/nmt_*/nmt_*/**/*.py"), *ROOT.glob("campaigns/nmt_*/nmt_*/**/*.py"))
    }
    return [path for path, text in texts.items() if "njit" in text or path.parent.name in ("twin", "model")]


def named_tuples(trees: dict[Path, ast.Module]) -> set[str]:
    """Classes that are named tuples."""
    return {
        node.name
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and any(ast.unparse(base) == "NamedTuple" for base in node.bases)
    }


def is_position(index: ast.expr) -> bool:
    """Whether an index is a whole number, or a range of such."""
    if isinstance(index, ast.UnaryOp):
        return is_position(index.operand)
    if isinstance(index, ast.Slice):
        return any(end is not None and is_position(end) for end in (index.lower, index.upper))
    return isinstance(index, ast.Constant) and type(index.value) is int


def positions(tree: ast.AST, classes: set[str]) -> list[str]:
    """Whole numbers that pick something from a named tuple, or from a name that tuples of tables go by."""
    found = []
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        every = [*function.args.args, *function.args.kwonlyargs]
        annotated = {a.arg for a in every if a.annotation is not None and ast.unparse(a.annotation) in classes}
        plain = {a.arg for a in every if a.annotation is not None and "Array" in ast.unparse(a.annotation)}
        for node in ast.walk(function):
            if isinstance(node, ast.Subscript) and is_position(node.slice):
                name = ast.unparse(node.value)
                own = name.rpartition(".")[2].lstrip("_")
                if name in annotated or (own in TABLES and name not in plain):
                    found.append(f"line {node.lineno}: {ast.unparse(node)}")
    return found


def test_a_position_is_found():
    kernel = "def f(rig, own: SteppedModel, x: FloatArray):\n    return {}"
    for text in ("rig[3][1][-1] + 2", "tables[10]", "self.tables[3:10]", "own[2]", "rig[0][4].shape[1]", "tables[:2]"):
        assert positions(ast.parse(kernel.format(text)), {"SteppedModel"}), text
    for text in ("rig.local.offsets[-1] + 2", "x[2]", "tables[k]", "tables.values[0]", "own.decay[3]"):
        assert not positions(ast.parse(kernel.format(text)), {"SteppedModel"}), text


def test_no_table_is_picked_by_its_position():
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in compiled_modules()}
    classes = named_tuples(trees)
    assert {"LocalTables", "RigTables", "LinearTables", "SteppedModel"} <= classes
    found = {path.name: again for path, tree in trees.items() if (again := positions(tree, classes))}
    assert found == {}
