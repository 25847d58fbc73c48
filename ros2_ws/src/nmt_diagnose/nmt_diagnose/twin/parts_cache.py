"""Rigs taken apart, remembered while a prediction needs them."""

from __future__ import annotations

from nmt_diagnose.evidence.conditions import MeasuredChannel
from nmt_plant.model.fourier_basis import FourierBasis
from nmt_plant.rig import Rig

from .rig_parts import RigParts, rig_parts, with_exciter_at
from .settings import TwinSettings


class PartsCache:
    """Parts of one rig for several tests and moments."""

    def __init__(self, settings: TwinSettings) -> None:
        self.settings = settings
        self._known: dict[tuple[object, ...], RigParts] = {}

    def parts(
        self,
        rig: Rig,
        drive_point: int,
        channels: tuple[MeasuredChannel, ...],
        basis: FourierBasis,
        seconds: float = 0.0,
        cycles: float = 0.0,
        ideal_force: bool = False,
    ) -> RigParts:
        """Parts of the rig driven at a point, at a moment of its drift."""
        drift = rig.drift
        if drift.slip_force_per_s == 0.0 and drift.stiffness_per_s == 0.0:
            seconds = 0.0
        if drift.slip_force_per_cycle == 0.0:
            cycles = 0.0
        key = (drive_point, channels, basis.size, seconds, cycles, ideal_force)
        found = self._known.get(key)
        if found is None:
            moved = with_exciter_at(rig, drive_point)
            found = rig_parts(moved, channels, basis, self.settings, seconds, cycles, ideal_force)
            self._known[key] = found
        return found
