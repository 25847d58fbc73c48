"""Records of a motion that was imposed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel, with_magnitudes
from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord
from nmt_diagnose.measurements.imposed_motion.predictor import ImposedMotionPredictor
from nmt_diagnose.observations.observables import Rows
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    resting_response,
)
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

POSITION = "displacement"

if TYPE_CHECKING:
    from nmt_diagnose.observations.bag_windows import BagWindows
    from nmt_diagnose.observations.observables import Observations


@dataclass(frozen=True)
class ImposedMotion(DrivenRecord):
    """A record whose motion was imposed: the model is moved as measured, and force and further responses follow.

    The input is the recorded motion of the drive point in its unit; the observables keep their means.

    Attributes:
        motion: displacement, velocity and acceleration of the drive point at the samples of the input, shape (3, n),
            m, m/s, m/s².
        gain_std: relative standard uncertainty of the gain of the motion and of each channel.
        frequency_hz: middle frequency of the motion, rms velocity over rms displacement, Hz.
        size: half of what the displacement spans, m.
        force_n: largest measured force, N.
        force: measured force at the recorded samples, N; NaN where it is no observable.
    """

    WORDS: ClassVar[str] = "imposed motion, its force predicted"

    motion: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))
    gain_std: float = 0.0
    frequency_hz: float = math.nan
    size: float = math.nan
    force_n: float = math.nan
    force: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def signals(self) -> dict[str, FloatArray]:
        """Measured channels that the strength of a force may follow; the displacement of the drive point is one."""
        return with_magnitudes({POSITION: self.motion[0], **self.followed})

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Windows of an import whose motion someone held; no other kind reads them."""
        from nmt_diagnose.measurements.imposed_motion.reading import imposed_motion_observations  # late: it makes them

        return imposed_motion_observations(bag)

    def with_zero(self, steps: float) -> FloatArray:
        """The motion with the zero of its sensor off by so many standard deviations, shape (3, n)."""
        order = MOTIONS[self.input_channel.quantity]
        moved = self.motion.copy()
        time = np.arange(self.input.size) / self.sample_rate
        for row in range(order + 1):
            moved[row] += steps * self.zeros[0] * time ** (order - row) / math.factorial(order - row)
        return moved

    def with_gain(self, steps: float) -> FloatArray:
        """The motion larger by so many standard deviations of its gain, shape (3, n)."""
        return self.motion * (1.0 + steps * self.gain_std)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> ImposedMotionPredictor:
        """What predicts its rows."""
        return ImposedMotionPredictor(self, rows, settings)

    @property
    def imposed_scales(self) -> tuple[float, float] | None:
        """Displacement (m) and force (N), the largest."""
        return self.size, self.force_n

    @property
    def moved_as(self) -> ImposedMotion:
        """Itself: its force is a law of its motion."""
        return self

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Motion of the drive point at its middle frequency, in the shape of the system linearised at rest."""
        probe = next(i for i, c in enumerate(channels) if c.name == f"probe {self.drive_point}")
        setup = Setup(self.drive_points, True, channels, FourierBasis.up_to(1))
        parts, omega = PartsCache(settings).parts(rig, setup), 2.0 * np.pi * self.frequency_hz
        q, y = resting_response(parts, omega)
        scale = self.size / max(abs(y[probe]), 1e-300)
        return [(parts, omega, 0.0, y * scale, q * scale)]
