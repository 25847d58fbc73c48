"""Formulas of figures are parsed once, not again for every figure.

matplotlib keeps what it has parsed with the renderer of one figure, and the figures of a report have many formulas in
common (labels of axes, powers of ten): reading them again takes a tenth of its time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.mathtext import MathTextParser

MOST_KEPT = 2000
_PARSE = "_parse_cached"
_SETTINGS = tuple(key for key in matplotlib.rcParamsDefault if key.startswith("mathtext."))
kept: dict[Any, Any] = {}


@contextmanager
def kept_formulas() -> Iterator[None]:
    """While figures are drawn; nothing of matplotlib stays changed. Without effect where its parser is another one."""
    parser: Any = MathTextParser
    parse = getattr(parser, _PARSE, None)
    if parse is None or parse is _parsed:
        yield
        return
    _parsed.parse = parse  # type: ignore[attr-defined]
    setattr(parser, _PARSE, _parsed)
    try:
        yield
    finally:
        setattr(parser, _PARSE, parse)


def _parsed(parser: Any, *arguments: Any) -> Any:
    """What matplotlib's parser gives, which depends on the arguments and on the settings for formulas."""
    settings = tuple(str(matplotlib.rcParams[key]) for key in _SETTINGS)
    key = (getattr(parser, "_output_type", parser), settings, arguments)
    if key not in kept:
        if len(kept) >= MOST_KEPT:
            kept.clear()
        kept[key] = _parsed.parse(parser, *arguments)  # type: ignore[attr-defined]
    return kept[key]
