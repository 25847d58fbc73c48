"""Compiled dispatch: the formulas of all local elements by the number of their class.

A call is ``formula(kind, p, e, …)`` with the parameters of element e in p[e]. Kernels that call these carry them inside
themselves, and their cache is keyed by them: :mod:`nmt_core.numerics.kernels`.
"""

from __future__ import annotations

from typing import Any

from nmt_core.numerics.kernels import njit
from nmt_rig.model.local_elements import ELEMENTS


def _dispatch(formula: str, arguments: str, otherwise: str = "", **how: Any) -> Any:
    """Compiled function that calls one formula of the element of a kind, or returns `otherwise` where it has none.

    Without `otherwise` the last one is called whatever the kind.
    """
    how = how or {"forceinline": True}
    names: dict[str, Any] = {**globals()}
    kinds: dict[Any, list[int]] = {}
    for element in ELEMENTS:
        if hasattr(element, formula):
            kinds.setdefault(getattr(element, formula), []).append(element.kind)
    lines = [f"def {formula}(kind, p, e, {arguments}):"]
    for position, (own, numbers) in enumerate(kinds.items(), 1):
        names[f"formula_{position}"] = njit(own, **how)
        count = own.__code__.co_argcount - len(arguments.split(", "))
        call = ", ".join([f"p[e, {number}]" for number in range(count)] + [arguments])
        asked = " or ".join(f"kind == {number}" for number in numbers)
        last = not otherwise and position == len(kinds)
        lines.append(f"    {'' if last else f'if {asked}: '}return formula_{position}({call})")
    exec("\n".join([*lines, f"    return {otherwise}"]), names)
    return njit(names[formula], **how)


response = _dispatch("response", "w, v", "0.0, 0.0, 0.0")
frozen = _dispatch("frozen", "branch, w, v, slider", "response(kind, p, e, w, v)")
# Copied into their callers: a tenth of a step where many sliders share a place.
next_branch = _dispatch("next_branch", "branch, w, v, slider", "0", inline="always")
piece = _dispatch("piece", "branch, slider", inline="always")
