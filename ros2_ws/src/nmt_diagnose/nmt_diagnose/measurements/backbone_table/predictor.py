"""Backbone tables: phase resonance at given amplitudes of a response, and the damping ratio of its power balance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_level import LockedLevel
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.measurements.locked_windows.predictor import PeriodicLevels
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.periodic_state import PeriodicState
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_rig.rig import Rig, ShakerSection

if TYPE_CHECKING:
    from nmt_diagnose.measurements.backbone_table.backbone_table import BackboneTable


class BackbonePredictor(PeriodicLevels):
    """Predicts a backbone: frequency and damping over the amplitude of a response.

    A table is the nonlinear mode's own, as from free decays: only the sensor of the amplitudes has a part in it.
    The damping ratio is that of the method, δ̃ = P₁ / (ω̃³ φ̃ᴴ M φ̃) with the structure's own mass matrix.

    Args:
        test: the table.
        rows: its rows.
        settings: of the predictor.
    """

    def __init__(self, test: BackboneTable, rows: Rows, settings: PredictionSettings) -> None:
        levels = []
        for position, amplitude in enumerate(test.amplitudes):
            frequency_hz = rows.frequency_hz[rows.level == position]
            frequency = float(frequency_hz[0]) if frequency_hz.size else np.nan
            levels.append(LockedLevel(position, float(amplitude), 0.0, 0.0, frequency, 0.0, 0.0, 0.0, 1))
        probe = MeasuredChannel("motion", Quantity.DISPLACEMENT, test.drive_point, ideal=True)
        force = MeasuredChannel("force", Quantity.FORCE, test.drive_point, ideal=True)
        channels = tuple(dict.fromkeys((test.channel, force, probe)))
        inner = LockedWindows(
            test.name, test.drive_points, probe.name, channels, settings.harmonics, "response", tuple(levels)
        )
        super().__init__(inner, rows, settings)

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the test's rows."""
        count = len(self.levels)
        log_omega, damping = np.full(count, np.nan), np.full(count, np.nan)
        groups: dict[int, tuple[RigParts, list[int]]] = {}
        for position, state in enumerate(states):
            if state is not None and state.omega > 0.0:  # one Newton step may lead anywhere
                log_omega[position] = np.log(state.omega / (1.0 + rig.clock_error))
                parts = self.parts(rig, cache, self.levels[position])
                groups.setdefault(id(parts), (parts, []))[1].append(position)
        if np.any(self.rows.part == Part.DAMPING):
            for parts, positions in groups.values():
                solved = [state for position in positions if (state := states[position]) is not None]
                damping[positions] = self._damping(rig, parts, solved)
        result = np.full(len(self.rows), np.nan)
        for kind, values in ((Part.LOG_FREQUENCY, log_omega), (Part.DAMPING, damping)):
            which = self.rows.part == kind
            result[which] = values[self.rows.level[which]]
        return result

    def _damping(self, rig: Rig, parts: RigParts, states: Sequence[PeriodicState]) -> FloatArray:
        """Damping ratios of some levels of one rig, (levels,)."""
        shapes, force = self.fundamental_unknowns(parts, states)
        omega = np.array([state.omega for state in states])
        system = parts.system
        n = system.structure_size
        mass = system.mass[:n, :n]
        if isinstance(rig.exciter, ShakerSection):
            drive = system.selector(system.drive_point)[:n]
            mass = mass - rig.exciter.table_mass_kg * np.outer(drive, drive)
        velocity = 1j * omega * np.array([system.motion(system.drive_point, shape) for shape in shapes])
        power = 0.5 * (velocity * np.conj(force)).real
        moving = np.einsum("la,ab,lb->l", np.conj(shapes[:, :n]), mass, shapes[:, :n]).real
        return np.asarray(power / (omega**3 * moving))
