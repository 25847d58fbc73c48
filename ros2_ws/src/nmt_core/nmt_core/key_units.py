"""Units that the names of a rig file's keys carry: ``stiffness_n_m3`` is in N/m³."""

from __future__ import annotations

import re

_BASE = {
    "n": "N", "ns": "N s", "ns2": "N s²", "nm": "N m", "kg": "kg", "m": "m", "s": "s", "v": "V", "pa": "Pa", "hz": "Hz",
    "ohm": "Ω", "h": "H", "a": "A", "rad": "rad",
}  # fmt: skip
_OTHER = {
    "_n_sp_mp": "N sᵖ/mᵖ", "_n_sa_m": "N sᵅ/m", "newton_per_volt": "N/V", "_per_s": "1/s", "_per_m": "1/m",
    "_per_m2": "1/m²",
}  # fmt: skip
_QUOTIENT = re.compile(r"_(n|ns|ns2|nm|kg|m|v|rad)_(m|s|rad|a|nm|n)([2-9]?)$")
_SINGLE = re.compile(r"_(n|kg|m|s|v|pa|hz|ohm|h)$")
_WORD = re.compile(r"[A-Za-zΩµ]+")
_TURNED = {"m": "rad", "N": "N·m", "kg": "kg·m²"}
_POWERS = str.maketrans("23456789", "²³⁴⁵⁶⁷⁸⁹")


def of_rotation(unit: str) -> str:
    """Unit of a parameter where the coordinate is an angle: rad for m, N·m for N, kg·m² for kg."""
    return _WORD.sub(lambda found: _TURNED.get(found[0], found[0]), unit)


def unit_of_key(key: str) -> str:
    """Unit that the name of a key carries; 1 where there is none."""
    for ending, unit in _OTHER.items():
        if key.endswith(ending):
            return unit
    if found := _QUOTIENT.search(key):
        return f"{_BASE[found[1]]}/{_BASE[found[2]]}{found[3].translate(_POWERS)}"
    found = _SINGLE.search(key)
    return _BASE[found[1]] if found else "1"
