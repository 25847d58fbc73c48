"""Any excitation, in data that was recorded elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds.kind_of_test import KindOfTest
from nmt_core.vocabulary import TestKind


@dataclass(frozen=True, kw_only=True)
class RecordedTest(KindOfTest):
    """A record; the bench does no such test."""

    NUMBER: ClassVar[TestKind] = TestKind.RECORD

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) to do it."""
        raise BenchError("The bench does no record test; choose another kind of test.")
