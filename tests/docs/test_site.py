"""The documentation's site: its pages of names are those of the packages, its check sees broken links."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


site_hooks, check_site = load("site_hooks"), load("check_site")
NAMES = (DOCS / "reference" / "python.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("package", site_hooks.REGION.findall(NAMES), ids=lambda found: found[0])
def test_every_public_name_has_a_docstring_on_the_site(package: tuple[str, str]) -> None:
    name, table = package
    module = importlib.import_module(name)
    shown = dict(site_hooks.ROW.findall(table))
    assert set(shown) == {f"{name}.{public}" for public in module.__all__}
    for public, home in shown.items():
        folder, _, own = home.rpartition(".")
        value = getattr(importlib.import_module(folder), own)
        assert value is getattr(module, public.rpartition(".")[2])
        assert value.__doc__
        assert f"## {public}\n\n::: {home}\n" in site_hooks.package_pages(NAMES)[f"api/{name}.md"]


def test_names_lead_to_their_pages() -> None:
    linked = site_hooks.linked_names(NAMES)
    assert "* [`nmt.import_data`](../api/nmt.md#nmtimport_data) (`nmt_bench.data_import.import_data`)" in linked
    assert not site_hooks.ROW.search(linked)


def test_links_that_leave_the_folder() -> None:
    text = "[a](../reference/files.md) [b](../../examples/diagnosis.ipynb) [c](../../../elsewhere.md)"
    assert site_hooks.outside("how-to/page.md", text) == {"../../examples/diagnosis.ipynb": "examples/diagnosis.ipynb"}


def test_broken_links_are_seen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "index.html").write_text('<h1 id="here">b</h1><img src="missing.svg">')
    (tmp_path / "a.html").write_text(
        '<a href="b/">1</a><a href="b/#here">2</a><a href="b/index.html#there">3</a><a href="c.html">4</a>'
        '<a href="https://example.org/">5</a><a href="#own">6</a><p id="own"></p>'
    )
    assert check_site.broken_links(tmp_path) == [
        "a.html: b/index.html#there has no such anchor",
        "a.html: c.html leads nowhere",
        "b/index.html: missing.svg leads nowhere",
    ]
    assert check_site.main([str(tmp_path)]) == 1
    assert capsys.readouterr().out.endswith("2 pages, 3 broken links\n")
