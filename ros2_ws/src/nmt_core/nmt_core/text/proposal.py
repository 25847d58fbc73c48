"""The nearest known word to one that was mistyped."""

from __future__ import annotations

from collections.abc import Iterable


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Half a sentence that proposes what may have been meant; empty where nothing is near.

    Args:
        word: as typed.
        known: what there is.
    """
    import difflib  # takes longer than the rest of a command line that only prints its help

    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean '{near[0]}'" if near else ""
