"""Linear rigs at phase resonance whose sensors are wrong by known amounts, from closed forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from extract.synthetic import lock_event
from numpy.random import Generator
from scipy.optimize import brentq

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_extract.modal.point import modal_point
from nmt_extract.modal.window import Channel, Window
from nmt_record.exchange.sidecar.channel_tolerances import ChannelTolerance, Tolerances

POINTS = (1, 2, 3, 4)
DRIVE = 2
CHANNELS = (
    Channel("f2", Quantity.FORCE, DRIVE),
    *(Channel(f"a{point}", Quantity.ACCELERATION, point) for point in POINTS),
)
RATE, PERIODS = 4000.0, 80
GAIN, PHASE, DELAY, CLOCK = 0.01, 0.004, 5e-6, 3e-5


@dataclass(frozen=True)
class Rig:
    """Three modes (rad/s, damping ratios), mass-normalised shapes at four points (1/√kg), a force (N)."""

    omega: np.ndarray
    zeta: np.ndarray
    shapes: np.ndarray
    force: float

    @classmethod
    def drawn(cls, random: Generator) -> Rig:
        first = 2 * np.pi * random.uniform(30.0, 60.0)
        shapes = random.uniform(0.5, 1.5, (4, 3)) * np.where(random.random((4, 3)) < 0.3, -1.0, 1.0)
        return cls(first * np.array([1.0, 4.0, 9.0]), random.uniform(0.003, 0.02, 3), shapes, random.uniform(0.5, 5.0))

    def displacement(self, omega: float) -> np.ndarray:
        """Complex amplitudes (m) at the points for the real force."""
        below = self.omega**2 - omega**2 + 2j * self.zeta * self.omega * omega
        return np.asarray(self.shapes @ (self.shapes[DRIVE - 1] * self.force / below))

    def resonance(self, shift: float) -> float:
        """Frequency (rad/s) at which the drive point's velocity leads the force by so much (rad)."""

        def apart(omega: float) -> float:
            return float(np.angle(1j * self.displacement(omega)[DRIVE - 1] * np.exp(-1j * shift)))

        return float(brentq(apart, 0.97 * self.omega[0], 1.03 * self.omega[0], xtol=1e-9))

    def description(self, source: str, sensors: Sensors, random: Generator) -> LinearDescription:
        """The linear modes: of a model, or as a test with the same sensors finds them, with noise of the shapes."""
        shapes, stds = self.shapes.copy(), np.zeros_like(self.shapes)
        if source == "test":
            shapes *= sensors.gains[1:, None] / np.sqrt(sensors.gains[0] * sensors.gains[DRIVE])
            stds = 0.003 * np.abs(shapes)
            shapes = shapes + stds * random.standard_normal(shapes.shape)
        return LinearDescription(
            source, DRIVE, 0, POINTS, tuple(self.omega), tuple(self.zeta), tuple(map(tuple, shapes)),
            float(shapes[DRIVE - 1, 0]), float(self.omega[0]), float(self.zeta[0]), 0.0,
            shape_stds=tuple(map(tuple, stds)),
        )  # fmt: skip


@dataclass(frozen=True)
class Sensors:
    """Gains, phases (rad) and delays (s) of the channels, force first, and what the clock is off by."""

    gains: np.ndarray
    phases: np.ndarray
    delays: np.ndarray
    clock: float

    @classmethod
    def drawn(cls, random: Generator) -> Sensors:
        normal = random.standard_normal((3, len(CHANNELS)))
        return cls(1.0 + GAIN * normal[0], PHASE * normal[1], DELAY * normal[2], CLOCK * random.standard_normal())

    @property
    def tolerances(self) -> Tolerances:
        """What a calibration sheet states of such sensors."""
        return Tolerances({}, ChannelTolerance(GAIN, PHASE, DELAY), CLOCK)


def true_point(rig: Rig) -> dict[str, float]:
    """What ideal sensors would have found, with the loop at phase resonance."""
    omega = rig.resonance(0.0)
    shape = rig.displacement(omega)
    q = float(np.linalg.norm(np.linalg.pinv(rig.shapes) @ shape))
    power = float(0.5 * np.real(1j * omega * shape[DRIVE - 1] * rig.force))
    return {
        "omega_rad_s": omega, "modal_amplitude": q, "damping_ratio": power / (omega**3 * q**2), "force_n": rig.force,
    }  # fmt: skip


def measured(rig: Rig, sensors: Sensors, linear: LinearDescription, random: Generator) -> ModalPoint:
    """The modal point of a window that these sensors recorded; the loop held the phase that they show."""
    omega = rig.resonance(0.0)
    for _ in range(3):  # the delays' share of the phase depends on the frequency a little
        turned = sensors.phases - omega * sensors.delays
        omega = rig.resonance(float(turned[0] - turned[DRIVE]))
    turned = sensors.phases - omega * sensors.delays
    true = np.concatenate([[rig.force], -(omega**2) * rig.displacement(omega)])
    amplitudes = sensors.gains * np.exp(1j * turned) * true
    seen = omega * (1.0 + sensors.clock)  # samples are counted by the converter's clock
    count = int(PERIODS * 2 * np.pi * RATE / seen) + 2
    time = np.arange(count) / RATE
    data = np.real(amplitudes[:, None] * np.exp(1j * seen * time))
    data += 0.01 * np.abs(amplitudes)[:, None] * random.standard_normal(data.shape)
    cycles = seen * time / (2 * np.pi)
    lock = lock_event(0, count, PERIODS)
    return modal_point(Window(lock, RATE, CHANNELS, data, cycles, float(seen * count / RATE / (2 * np.pi))), linear)
