"""A finding on the log: what it is, how large, and what of the gap it takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Finding:
    """What was found in a log.

    Attributes:
        key: name in files.
        sentence: for people.
        size, std: its value and standard uncertainty; NaN where it has none.
        unit: of both.
        share: of the torque that the plain reading leaves over, taken by it; NaN where that is not known.
        joints: whose it is; empty = the log's, all joints share it.
        fault: whether it is one; else it is only said.
        instead: keys of terms of the joints that would do as well, so that it is one of a class.
    """

    key: str
    sentence: str
    size: float = float("nan")
    std: float = float("nan")
    unit: str = ""
    share: float = float("nan")
    joints: tuple[str, ...] = field(default=())
    fault: bool = True
    instead: tuple[str, ...] = field(default=())

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "key": self.key,
            "sentence": self.sentence,
            "size": self.size,
            "std": self.std,
            "unit": self.unit,
            "share": self.share,
            "joints": list(self.joints),
            "fault": self.fault,
            "instead": list(self.instead),
        }


def is_known(value: float) -> bool:
    """Whether a number is one."""
    return bool(np.isfinite(value))
