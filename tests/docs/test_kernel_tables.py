"""Compiled kernels are readable: tables and their columns have names, functions are short and take few arguments."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Names that tuples of tables go by, in the kernels and where they are made.
TABLES = {"tables", "kernel_tables", "rig", "model", "elements", "transfers", "fractions", "memory"}
# Arrays whose columns mean different things.
COLUMNS = {
    "parameters",
    "jenkins",
    "contacts",
    "factor",
    "force_factor",
    "chain",
    "chains",
    "counters",
    "phases",
    "phase",
}
MOST_LINES, MOST_ARGUMENTS = 80, 12


def compiled_modules() -> list[Path]:
    """Modules of the bench with compiled functions, and those that make tables for them."""
    texts = {
        path: path.read_text(encoding="utf-8")
        for path in (*ROOT.glob("ros2_ws/src/nmt_*/nmt_*/**/*.py"), *ROOT.glob("campaigns/nmt_*/nmt_*/**/*.py"))
        if "nmt_laboratories" not in path.parts
    }
    return [path for path, text in texts.items() if "njit" in text or path.parent.name in ("prediction", "model")]


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


def compiled_functions(tree: ast.Module) -> list[ast.FunctionDef]:
    """Functions that numba compiles: decorated with njit, or with a name that stands for it."""
    names = {"njit", "loop_step"}
    for node in tree.body:
        if isinstance(node, ast.Assign) and "njit(" in ast.unparse(node.value):
            names |= {ast.unparse(target) for target in node.targets}
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any(ast.unparse(decorator).partition("(")[0] in names for decorator in node.decorator_list)
    ]


def too_large(tree: ast.Module) -> list[str]:
    """Compiled functions with too many lines or arguments."""
    found = []
    for function in compiled_functions(tree):
        lines = (function.end_lineno or 0) - function.lineno + 1
        arguments = len(function.args.args)
        if lines > MOST_LINES or arguments > MOST_ARGUMENTS:
            found.append(f"{function.name}: {lines} lines, {arguments} arguments")
    return found


def nameless(tree: ast.AST) -> list[str]:
    """Columns that a whole number picks, and kinds that are compared with one."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and ast.unparse(node.value).rpartition(".")[2] in COLUMNS:
            column = node.slice.elts[-1] if isinstance(node.slice, ast.Tuple) else node.slice
            rows = isinstance(node.slice, ast.Slice)
            if is_position(column) and not rows:
                found.append(f"line {node.lineno}: {ast.unparse(node)}")
        if isinstance(node, ast.Compare) and re.match(r"(\w+\.)*kinds?(\[.*\])?$", ast.unparse(node.left)):
            found += [f"line {node.lineno}: {ast.unparse(node)}" for other in node.comparators if is_position(other)]
    return found


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


def test_a_column_without_a_name_is_found():
    for text in (
        "jenkins[e, 0]",
        "tables.contacts[3, 2]",
        "factor[1]",
        "memory.counters[0]",
        "kinds[e] == 2",
        "kind == 1",
    ):
        assert nameless(ast.parse(text)), text
    for text in ("jenkins[e, SLIP]", "jenkins.shape[0]", "factor[LINEAR]", "kinds[e] == JENKINS", "kinds.size == 0"):
        assert not nameless(ast.parse(text)), text


def test_a_long_function_and_a_wide_one_are_found():
    long = "\n".join(["@njit(cache=True)", "def long(a):", *["    a += 1"] * MOST_LINES])
    wide = f"_step = njit(cache=True)\n@_step\ndef wide({', '.join(f'a{n}' for n in range(MOST_ARGUMENTS + 1))}): pass"
    assert too_large(ast.parse(long)) == ["long: 81 lines, 1 arguments"]
    assert too_large(ast.parse(wide)) == ["wide: 1 lines, 13 arguments"]
    assert not too_large(ast.parse(long.replace("@njit(cache=True)\n", "")))


def test_no_column_is_picked_and_no_kind_compared_by_a_number():
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in compiled_modules()}
    found = {path.name: again for path, tree in trees.items() if (again := nameless(tree))}
    assert found == {}


def test_compiled_functions_are_short_and_take_few_arguments():
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in compiled_modules()}
    assert sum(len(compiled_functions(tree)) for tree in trees.values()) > 100
    found = {path.name: again for path, tree in trees.items() if (again := too_large(tree))}
    assert found == {}
