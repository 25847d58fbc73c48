"""What the site has beyond the pages of this folder; run by mkdocs, see mkdocs.yml.

* A page for each package on reference/python.md, whose tables docs/make_reference.py writes: every public name with the
  docstring that its source has.
* Files of the project outside this folder that a page links to, as they are.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
NAMES_PAGE = "reference/python.md"
REGION = re.compile(r"<!-- generated: python (\w+) -->\n(.*?)<!-- end -->", re.S)
ROW = re.compile(r"^\* `([\w.]+)` \(`([\w.]+)`\)", re.M)
LINK = re.compile(r"(!?\[[^\]]*\]\()((?:\.\./)+[^()\s#]+)")
ROLE = re.compile(r":(?:mod|func|class|meth|data|attr):(?=<code>)")


def package_pages(text: str) -> dict[str, str]:
    """Pages of the packages by their path on the site.

    Args:
        text: of reference/python.md.
    """
    pages = {}
    for package, table in REGION.findall(text):
        lines = [f"# {package}", "", f"[All packages](../{NAMES_PAGE})", ""]
        for name, home in ROW.findall(table):
            lines += [f"## {name}", "", f"::: {home}", ""]
        pages[f"api/{package}.md"] = "\n".join(lines)
    return pages


def linked_names(text: str) -> str:
    """reference/python.md with every name leading to the page of its package."""

    def linked(region: re.Match[str]) -> str:
        package = region[1]
        return ROW.sub(
            lambda row: f"* [`{row[1]}`](../api/{package}.md#{row[1].replace('.', '').lower()}) (`{row[2]}`)",
            region[0],
        )

    return REGION.sub(linked, text)


def outside(page: str, text: str) -> dict[str, str]:
    """Links of a page that leave this folder: link -> path of the file in the project.

    Args:
        page: its path, relative to this folder.
        text: its Markdown.
    """
    found = {}
    for _, link in LINK.findall(text):
        path = (DOCS / page).parent.joinpath(link).resolve()
        if not path.is_relative_to(DOCS) and path.is_relative_to(ROOT):
            found[link] = path.relative_to(ROOT).as_posix()
    return found


def on_files(files: Any, config: Any) -> Any:
    """Add the packages' pages and the files that pages link to."""
    from mkdocs.structure.files import File

    for path, text in package_pages((DOCS / NAMES_PAGE).read_text(encoding="utf-8")).items():
        files.append(File.generated(config, path, content=text))
    for page in list(files.documentation_pages()):
        source = DOCS / page.src_uri
        if source.is_file():
            for path in outside(page.src_uri, source.read_text(encoding="utf-8")).values():
                if (ROOT / path).is_file() and files.get_file_from_path(f"project/{path}") is None:
                    files.append(File.generated(config, f"project/{path}", abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead names to their pages, and links out of this folder to the copies."""
    here = page.file.src_uri
    if here == NAMES_PAGE:
        return linked_names(markdown)
    up = "../" * len(PurePosixPath(here).parent.parts)
    for link, path in outside(here, markdown).items():
        markdown = markdown.replace(f"]({link}", f"]({up}project/{path}")
    return markdown


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Docstrings name what they refer to by a role, ``:func:`name```: the name is enough."""
    return ROLE.sub("", html) if page.file.src_uri.startswith("api/") else html
