"""What drove a test, as one record: kind of test, exciters, what the levels are, controlled harmonics.

A consumer of tests (extraction, diagnosis, export, ...) says by a function ``covers(test)`` what it can take: an empty
text, or one sentence that says what it does not take and what to use instead. It is asked before a node starts and
before the samples of a recording are read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from nmt_core.kinds import SecondaryResonanceTest, kind_class
from nmt_core.messages.run_settings import RunSettings
from nmt_core.messages.secondary_resonance import resonance_of
from nmt_core.vocabulary import ControlKind, TestKind

UNKNOWN_EXCITER = ""
"""Kind of an unnamed exciter, as of imported data."""


@dataclass(frozen=True, kw_only=True)
class DrivenTest:
    """A test and what drives it.

    Attributes:
        kind: kind of test.
        exciters: kind of each exciter as in rig files, such as ``electrodynamic_shaker``; empty text = not known.
        control: what the levels are.
        controlled_harmonics: highest harmonic of the force that is controlled; 0 = none, 1 = as many as can be.
        resonance: label of a secondary resonance, such as ``3:1``; empty = none.
    """

    kind: TestKind = TestKind.PHASE_RESONANCE
    exciters: tuple[str, ...] = (UNKNOWN_EXCITER,)
    control: ControlKind = ControlKind.VOLTAGE
    controlled_harmonics: int = 0
    resonance: str = ""

    @classmethod
    def of(cls, asked: RunSettings, exciters: tuple[str, ...]) -> DrivenTest:
        """The test that a run is asked for, on a rig with these exciters."""
        kind, resonance = asked.kind, ""
        if isinstance(kind, SecondaryResonanceTest):
            resonance = resonance_of(kind.response_order, kind.force_order).label
        return cls(
            kind=kind.NUMBER,
            exciters=exciters,
            control=ControlKind(asked.control),
            controlled_harmonics=kind.controlled_harmonics,
            resonance=resonance,
        )

    @classmethod
    def of_run(cls, run: Mapping[str, Any] | None, rig: Mapping[str, Any] | None) -> DrivenTest:
        """The test that a run's description of itself and its rig file tell; what they leave open has its default.

        Args:
            run: content of run.json, None = there is none.
            rig: values of the rig file, None = there is none.

        Raises:
            BenchError: a kind or a resonance that this release does not know.
        """
        plan = (run or {}).get("plan")
        points = (run or {}).get("exciter_points")
        known = exciter_kinds(rig or {}) or (UNKNOWN_EXCITER,) * (len(points) if isinstance(points, list) else 1)
        return cls.of(RunSettings.described(plan), known) if isinstance(plan, Mapping) else cls(exciters=known)

    @property
    def has_several_exciters(self) -> bool:
        """Whether there is more than one."""
        return len(self.exciters) > 1

    @property
    def words(self) -> str:
        """As in a sentence: ``a random test with 2 exciters``."""
        name = f"{self.resonance} resonance" if self.resonance else kind_class(self.kind).words()
        parts = [f"a {name} test"]
        if self.has_several_exciters:
            parts.append(f"with {len(self.exciters)} exciters")
        if self.controlled_harmonics:
            parts.append("and controlled harmonics" if self.has_several_exciters else "with controlled harmonics")
        return " ".join(parts)


Covers = Callable[[DrivenTest], str]
"""What a consumer says of a test: empty = it takes it, else one sentence why not."""


def exciter_kinds(rig: Mapping[str, Any]) -> tuple[str, ...]:
    """Kind of each exciter that the values of a rig file name; empty where they name none."""
    sections = rig.get("exciters") or [rig.get("exciter")]
    kinds = [section.get("kind") for section in sections if isinstance(section, Mapping)]
    return tuple(kind for kind in kinds if isinstance(kind, str))
