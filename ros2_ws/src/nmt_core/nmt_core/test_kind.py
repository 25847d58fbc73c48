"""What the loop does at a level: the kinds of test."""

from __future__ import annotations

from enum import IntEnum

from nmt_core.errors import BenchError


class TestKind(IntEnum):
    """Kind of test; values as in ``nmt_msgs/Level``.

    Attributes:
        UNKNOWN: as recorded by benches that knew one kind only; read as PHASE_RESONANCE.
        PHASE_RESONANCE: phase-locked excitation, one window of whole periods at each level.
        RANDOM: band-limited random excitation, one window of a given duration.
        SWEEP: frequency moves at a given rate with an amplitude held; the window is the whole sweep.
        STEPPED_SINE: fixed frequency with an amplitude held; one window of whole periods.
        RING_DOWN: phase-locked excitation that is switched off at the lock; the window is the free decay.
        RECORD: any excitation, in imported data only; the bench does no such test.
    """

    UNKNOWN = 0
    PHASE_RESONANCE = 1
    RANDOM = 2
    SWEEP = 3
    STEPPED_SINE = 4
    RING_DOWN = 5
    RECORD = 6

    @classmethod
    def of(cls, value: int) -> TestKind:
        """Kind of a message's number: UNKNOWN is PHASE_RESONANCE.

        Raises:
            BenchError: no such kind.
        """
        try:
            return cls(value or cls.PHASE_RESONANCE)
        except ValueError:
            raise BenchError(f"Test kind {value} is not known; known are 1 to {max(cls)}.") from None

    @classmethod
    def named(cls, name: str) -> TestKind:
        """Kind by its name in small letters, such as ``ring_down``.

        Raises:
            BenchError: no such kind.
        """
        kinds = {kind.label: kind for kind in cls if kind not in (cls.UNKNOWN, cls.RECORD)}
        if name not in kinds:
            raise BenchError(f"Test '{name}' is not known; use {', '.join(kinds)}.")
        return kinds[name]

    @property
    def label(self) -> str:
        """Name in small letters."""
        return self.name.lower()

    @property
    def closes_phase_loop(self) -> bool:
        """Whether the frequency is controlled by the phase, which needs a linear description."""
        return self in (TestKind.UNKNOWN, TestKind.PHASE_RESONANCE, TestKind.RING_DOWN)

    @property
    def gives_modal_points(self) -> bool:
        """Whether its windows are extracted while the test runs."""
        return self in (TestKind.UNKNOWN, TestKind.PHASE_RESONANCE)


TestKind.__test__ = False  # type: ignore[attr-defined]  # not a collection of tests
