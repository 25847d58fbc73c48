"""Tables that stand as text in a program: a line an entry."""

from __future__ import annotations


def entries(table: str) -> list[tuple[str, str]]:
    """Marks and words of every entry: two spaces stand between them, and indented lines go on with the words."""
    found: list[list[str]] = []
    for line in table.splitlines():
        if line.startswith(" "):
            found[-1][1] += f" {line.strip()}"
        elif line:
            head, _, words = line.partition("  ")
            found.append([head, words.strip()])
    return [(head, words.strip()) for head, words in found]
