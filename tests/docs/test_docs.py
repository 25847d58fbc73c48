"""The documentation holds together: links resolve, generated tables are up to date, examples compile."""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.util
import pkgutil
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import get_args

import pytest

from nmt_bench.cli import all_commands, build_parser
from nmt_core import bench_version
from nmt_rig.device_sections import DEVICES
from nmt_rig.model import local_elements

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
REFERENCE = sorted((DOCS / "reference").glob("*.md"))
IDS = [str(page.relative_to(ROOT)) for page in PAGES]
LINK = re.compile(r"!?\[[^\]]*\]\(([^()\s]+)\)")
PYTHON = (
    "nmt", "nmt_blind", "nmt_diagnose", "nmt_extract", "nmt_pll", "nmt_record", "nmt_report", "nmt_rig", "nmt_session",
)  # fmt: skip
WITHOUT_ROS = importlib.util.find_spec("rclpy") is None


def load_generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_reference", DOCS / "make_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


make_reference = load_generator()


def without_code(text: str) -> str:
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^ *```.*?^ *```", "", text, flags=re.S | re.M))


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as the common Markdown renderers make them."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    headings = re.findall(r"^#+ +(.+)$", text, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def python_blocks() -> list[tuple[str, str]]:
    found = []
    for page, name in zip(PAGES, IDS, strict=True):
        for number, match in enumerate(
            re.finditer(r"^( *)```python\n(.*?)^ *```", page.read_text("utf-8"), re.S | re.M)
        ):
            indent = match.group(1)
            code = "\n".join(line.removeprefix(indent) for line in match.group(2).splitlines())
            found.append((f"{name} block {number + 1}", code))
    return found


def test_links_resolve() -> None:
    for page in PAGES:
        for target in LINK.findall(without_code(page.read_text(encoding="utf-8"))):
            if target.startswith(("http://", "https://")):
                continue
            name, _, anchor = target.partition("#")
            linked = (page.parent / name).resolve() if name else page
            assert linked.exists(), f"{page}: {target} leads nowhere"
            assert linked.is_relative_to(ROOT), f"{page}: {target} leads out of the project"
            if anchor:
                assert anchor in anchors(linked), f"{page}: {target}: no such heading"


def test_every_page_is_reached_from_the_map() -> None:
    reached, waiting = set(), [ROOT / "README.md", DOCS / "index.md"]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        for target in LINK.findall(without_code(page.read_text(encoding="utf-8"))):
            linked = (page.parent / target.partition("#")[0]).resolve()
            if linked.suffix == ".md" and linked.exists():
                waiting.append(linked)
    assert set(PAGES) <= reached


def test_python_examples_compile_and_import_what_exists() -> None:
    nodes = [(place, node) for place, code in python_blocks() for node in ast.walk(ast.parse(code, filename=place))]
    for place, node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("nmt_"):
            if WITHOUT_ROS and ("harness" in node.module or "_node" in node.module or "nmt_msgs" in node.module):
                continue
            module = importlib.import_module(node.module)
            for alias in node.names:
                assert hasattr(module, alias.name), f"{place}: {node.module} has no {alias.name}"


def test_the_rig_of_the_guide_loads(tmp_path: Path) -> None:
    from nmt_rig.rig import load_rig

    text = (DOCS / "how-to" / "write-a-rig-file.md").read_text(encoding="utf-8")
    complete = re.search(r"```yaml\n(name:.*?)```", text, re.S)
    assert complete is not None
    path = tmp_path / "duffing.yaml"
    path.write_text(complete.group(1), encoding="utf-8")
    assert load_rig(path).name == "duffing_chain"


@pytest.mark.parametrize("page", REFERENCE, ids=[page.name for page in REFERENCE])
def test_generated_tables_are_up_to_date(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    kinds = {kind for kind, _ in make_reference.regions(text)}
    if kinds == {"parameters"} and WITHOUT_ROS:
        pytest.skip("The tables of node parameters need ROS 2.")
    fresh = make_reference.render(text, frozenset({"parameters"} if WITHOUT_ROS else ()))
    assert fresh == text, f"{page.name} is stale: run python docs/make_reference.py"


def test_outside_the_shell_the_generator_says_where_to_run_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(make_reference.importlib.util, "find_spec", lambda name: None)
    assert make_reference.main(["--check"]) == 2
    assert capsys.readouterr().err.count("./nmt shell") == 1


def test_every_message_section_node_and_command_has_its_table() -> None:
    from nmt_diagnose.effects.library import library
    from nmt_rig import rig

    shown = {region for page in REFERENCE for region in make_reference.regions(page.read_text(encoding="utf-8"))}
    files = [
        f"{path.parent.name}/{path.name}"
        for path in make_reference.MESSAGES.glob("*/*.*")
        if path.suffix in (".msg", ".action", ".srv")
    ]
    assert len(files) > 5
    wanted = {("message", name) for name in files}
    wanted |= {("parameters", name) for name in ("common", *make_reference.NODE_SETTINGS)}
    wanted |= {("options", name) for name in (*all_commands(), "shared")}
    sections = {name for name, kind in vars(rig).items() if isinstance(kind, type) and issubclass(kind, rig.Section)}
    sections -= {"AttachmentSection", *(section.__name__ for section in DEVICES.values())}
    files = (name for _, name, _ in pkgutil.iter_modules(local_elements.__path__))
    wanted |= {("elements", name) for name in files}
    wanted |= {("rig", name) for name in sections - {"Section"}}
    wanted |= {("python", name) for name in PYTHON}
    wanted |= {("effects", effect.place) for effect in library()} | {("priors", "all"), ("quantities", "modal")}
    wanted |= {("devices", "all"), ("statements", "all"), ("tolerances", "all")}
    wanted.add(("matrix", "tests"))
    assert {region for region in shown if region[0] != "keys"} == wanted


def test_every_rig_key_has_a_meaning_and_no_other() -> None:
    from nmt_rig import rig

    for name, meanings in make_reference.RIG_MEANINGS.items():
        fields = set(getattr(rig, name).model_fields)
        if issubclass(getattr(rig, name), rig.StructureSection) and name != "StructureSection":
            fields -= set(rig.StructureSection.model_fields)
        assert set(meanings) == fields, name
    for section in get_args(get_args(local_elements.AnyElement)[0]):
        assert list(make_reference._attributes(section)) == section.own_keys(), section


def test_every_command_and_option_is_on_the_page() -> None:
    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    launcher = ("test", "doctor", "setup", "shell", "ros")
    for name in all_commands():
        assert f"`./nmt {name}`" in text, name
    for name in launcher:
        assert f"`./nmt {name}" in text, name
    for line in build_parser().format_help().splitlines():
        match = re.match(r"^ {2,4}([a-z]+)(?: {2,}|$)", line)
        if match:
            assert re.search(rf"\b{match.group(1)}\b", text), match.group(1)


def test_tests_named_on_the_page_of_claims_exist() -> None:
    claims = re.findall(r"`(?:\./nmt test )?(tests/[^`]*)`", (DOCS / "verified.md").read_text(encoding="utf-8"))
    assert len(claims) > 50
    for claim in claims:
        words = claim.split()
        if "PATH" in words:
            continue
        chosen = words[words.index("-k") + 1] if "-k" in words else ""
        paths = [ROOT / word for word in words if word.startswith("tests/")]
        assert paths, claim
        for path in paths:
            assert path.exists(), path
        if chosen:
            assert any(re.search(rf"def test_\w*{chosen}", path.read_text(encoding="utf-8")) for path in paths), chosen


FOREIGN_PACKAGE = re.compile(r"\b(?:pip3?|pipx|uvx?|poetry|conda) [^\n`]*?(?<![\w./=-])nmt(?![\w/-]|\.\w|==?\s)")
"""A line that installs what the package index calls ``nmt``, which is another project."""


def test_nothing_installs_the_foreign_package_of_the_same_name() -> None:
    assert all(
        FOREIGN_PACKAGE.search(line)
        for line in (
            "pip install nmt",
            "pip install 'nmt[robots]'",
            'pip install "nmt[dask]"',
            "python -m pip install --force-reinstall nmt.",
            "pip install nmt>=0.3",
            "uv pip install nmt",
        )
    )
    places = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "pyproject.toml", *(ROOT / ".ci").glob("*")]
    for folder, kinds in (("docs", "md py"), ("examples", "ipynb"), ("requirements", "py in")):
        places += [path for kind in kinds.split() for path in (ROOT / folder).rglob(f"*.{kind}")]
    for folder in ("ros2_ws/src", "campaigns"):
        places += [path for kind in ("py", "html", "js", "yaml", "xml") for path in (ROOT / folder).rglob(f"*.{kind}")]
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in places
        if path.is_file()
        for line in path.read_text(encoding="utf-8").splitlines()
        if FOREIGN_PACKAGE.search(line)
    ]
    assert not found, "\n".join(found)


def test_the_version_is_asked_of_the_distribution_that_the_wheel_is(monkeypatch: pytest.MonkeyPatch) -> None:
    (name,) = re.findall(r'^name = "(.+?)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M)
    asked = []

    def version(distribution: str) -> str:
        asked.append(distribution)
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(importlib.metadata, "version", version)
    monkeypatch.setattr(bench_version, "_PACKAGE_FILE", "")
    assert bench_version.bench_version() == ""
    assert name == "nonlinear-modal-testing"
    assert asked == ["nmt_bench", name]
