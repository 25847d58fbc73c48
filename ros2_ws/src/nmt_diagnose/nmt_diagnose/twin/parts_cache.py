"""Rigs taken apart, remembered while a prediction needs them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from nmt_diagnose.evidence.conditions import MeasuredChannel
from nmt_diagnose.twin.rig_parts import (
    RigParts,
    channel_sections,
    channel_table,
    limit_table,
    rig_parts,
    with_exciter_at,
)
from nmt_diagnose.twin.settings import TwinSettings
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig


@dataclass(frozen=True)
class Setup:
    """What tests have in common that can share one linear model.

    Attributes:
        drive_point: point of the exciter.
        ideal_force: the exciter is left out.
        channels: all channels of these tests.
        basis: harmonic orders.
    """

    drive_point: int
    ideal_force: bool
    channels: tuple[MeasuredChannel, ...]
    basis: FourierBasis

    def index(self, channels: Iterable[MeasuredChannel]) -> list[int]:
        """Positions of a test's channels."""
        return [self.channels.index(channel) for channel in channels]


def joint_setup(setups: Iterable[Setup]) -> Setup:
    """One setup for several with the same drive point."""
    every = list(setups)
    channels = tuple(dict.fromkeys(channel for setup in every for channel in setup.channels))
    basis = max((setup.basis for setup in every), key=lambda basis: basis.size)
    return Setup(every[0].drive_point, every[0].ideal_force, channels, basis)


class PartsCache:
    """Parts of one rig at several moments.

    Args:
        settings: of the twin.
        base: parts of a rig that this one may share most with.
    """

    def __init__(self, settings: TwinSettings, base: PartsCache | None = None) -> None:
        self.settings = settings
        self._base = base
        self._known: dict[tuple[int, float, float], tuple[Rig, RigParts]] = {}

    def parts(self, rig: Rig, setup: Setup, seconds: float = 0.0, cycles: float = 0.0) -> RigParts:
        """Parts of the rig in a setup, at a moment of its drift."""
        drift = rig.drift
        if drift.slip_force_per_s == 0.0 and drift.stiffness_per_s == 0.0:
            seconds = 0.0
        if drift.slip_force_per_cycle == 0.0:
            cycles = 0.0
        key = (id(setup), seconds, cycles)
        found = self._known.get(key)
        if found is None:
            parts = self._shared(rig, setup, key)
            if parts is None:
                parts = rig_parts(
                    with_exciter_at(rig, setup.drive_point), setup.channels, setup.basis, self.settings, seconds,
                    cycles, setup.ideal_force,
                )  # fmt: skip
            found = (rig, parts)
            self._known[key] = found
        return found[1]

    def _shared(self, rig: Rig, setup: Setup, key: tuple[int, float, float]) -> RigParts | None:
        """Parts of the base with other sensors, where nothing else has changed."""
        known = None if self._base is None else self._base._known.get(key)
        if known is None:
            return None
        other, parts = known
        same = (
            rig.structure is other.structure
            and rig.local_elements is other.local_elements
            and rig.exciter is other.exciter
            and rig.drift is other.drift
            and (
                rig.sensors is other.sensors
                or all(
                    a is b or (a.mass_kg == b.mass_kg and a.transverse == b.transverse)
                    for a, b in zip(rig.sensors, other.sensors, strict=True)
                )
            )
        )
        if not same:
            return None
        sections = channel_sections(with_exciter_at(rig, setup.drive_point), setup.channels)
        return replace(
            parts,
            channels=channel_table(sections),
            limits=limit_table(sections, rig.sample_rate_hz),
            sections=sections,
            clock=1.0 + rig.clock_error,
        )
