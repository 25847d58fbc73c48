"""Rigs with a cubic spring or an elastic Coulomb joint at phase resonance, seen by sensors with known errors.

The response to a force of one harmonic is found by harmonic balance at the one point where the local force acts; the
rest of the rig is three linear modes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from extract.sensor_errors import CHANNELS, DRIVE, PERIODS, RATE, Rig, Sensors
from extract.synthetic import lock_event
from numpy.random import Generator
from scipy.optimize import root

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_extract.modal.point import modal_point
from nmt_extract.modal.window import Window

ORDERS = np.array([1, 3, 5])
_STEPS = 128
_TURNS = np.exp(1j * np.outer(ORDERS, 2 * np.pi * np.arange(_STEPS) / _STEPS))


@dataclass(frozen=True)
class NonlinearRig:
    """Three linear modes, and a local force at a point.

    Attributes:
        linear: the modes.
        kind: ``cubic`` or ``joint``.
        point: where the local force acts.
        strength: N/m³ of the cubic spring; N of the joint's slip force.
        stiffness: N/m of the sticking joint, which the linear modes lack.
    """

    linear: Rig
    kind: str
    point: int
    strength: float
    stiffness: float = 0.0

    @classmethod
    def drawn(cls, kind: str, random: Generator) -> NonlinearRig:
        """A rig whose local force shifts the frequency by up to a tenth (cubic), or slips (joint)."""
        linear, point = Rig.drawn(random), int(random.integers(1, 5))
        phi = linear.shapes[point - 1, 0]
        amplitude = abs(linear.displacement(linear.omega[0])[point - 1])
        share = random.uniform(0.02, 0.2)  # of the first mode's stiffness
        stiffness = share * linear.omega[0] ** 2 / phi**2
        if kind == "cubic":
            return cls(linear, kind, point, stiffness / (0.75 * amplitude**2))
        # The sticking joint belongs to the linear modes: it is counted from there, as what it lacks when it slips.
        return cls(linear, kind, point, stiffness * amplitude * random.uniform(0.05, 0.6), stiffness)

    def local_force(self, harmonics: np.ndarray) -> np.ndarray:
        """Complex amplitudes of the local force (N) for those of the displacement (m), orders ``ORDERS``."""
        motion = np.real(harmonics @ _TURNS)
        if self.kind == "cubic":
            force = self.strength * motion**3
        else:
            stiffness, most, slider = self.stiffness, self.strength, 0.0
            pulls = []
            for x in 2 * motion.tolist():  # the second turn starts from the state that the first ended with
                pull = stiffness * (x - slider)
                if pull > most:
                    pull = most
                    slider = x - pull / stiffness
                elif pull < -most:
                    pull = -most
                    slider = x - pull / stiffness
                pulls.append(pull)
            force = np.array(pulls[_STEPS:])
            force = force - self.stiffness * motion
        return np.asarray(2.0 / _STEPS * (np.conj(_TURNS) @ force))

    def steady_state(self, shift: float) -> tuple[float, np.ndarray]:
        """Where the drive point's velocity leads the force by ``shift`` (rad).

        Returns:
            Frequency, rad/s; displacements of the points, m, shape ``(points, orders)``.

        Raises:
            ArithmeticError: no solution was found.
        """
        rig = self.linear
        size = abs(rig.displacement(rig.omega[0])[self.point - 1])
        start = rig.displacement(rig.omega[0])[self.point - 1] / size
        guess = np.array([start.real, 0.0, 0.0, start.imag, 0.0, 0.0, 1.0])

        def points(unknowns: np.ndarray, force: float) -> np.ndarray:
            omega = rig.omega[0] * unknowns[6]
            local = size * (unknowns[:3] + 1j * unknowns[3:6])
            forces = -self.local_force(local)[:, None] * rig.shapes[self.point - 1]
            forces[0] += force * rig.shapes[DRIVE - 1]
            w = omega * ORDERS[:, None]
            return np.asarray(rig.shapes @ (forces / (rig.omega**2 - w**2 + 2j * rig.zeta * rig.omega * w)).T)

        def apart(unknowns: np.ndarray, force: float) -> np.ndarray:
            found = points(unknowns, force)
            left = found[self.point - 1] / size - unknowns[:3] - 1j * unknowns[3:6]
            turned = 1j * found[DRIVE - 1, 0] * np.exp(-1j * shift)
            return np.concatenate((left.real, left.imag, [np.angle(turned)]))

        shares = np.linspace(0.1, 1.0, 10)
        guess[:6] *= shares[0]
        for share, following in zip(shares, [*shares[1:], 1.0], strict=True):
            found = root(apart, guess, args=(share * rig.force,), tol=1e-11)
            guess = found.x.copy()
            guess[:6] *= following / share
        if np.abs(found.fun).max() > 1e-7 or not 0.7 < found.x[6] < 1.3:
            raise ArithmeticError("no steady state found")
        return float(rig.omega[0] * found.x[6]), points(found.x, rig.force)


IDEAL = Sensors(np.ones(len(CHANNELS)), np.zeros(len(CHANNELS)), np.zeros(len(CHANNELS)), 0.0)


def measured(
    rig: NonlinearRig, sensors: Sensors, linear: LinearDescription, random: Generator, noise: float = 0.01
) -> ModalPoint:
    """The modal point of a window that these sensors recorded; the loop held the phase that they show.

    Args:
        rig: what is measured.
        sensors: how they err.
        linear: modes for the extraction.
        random: of the noise.
        noise: standard deviation of a sample beside the channel's amplitude.
    """
    omega = rig.linear.omega[0]
    for _ in range(2):  # the delays' share of the phase depends on the frequency a little
        turned = sensors.phases - omega * sensors.delays
        omega, shape = rig.steady_state(float(turned[0] - turned[DRIVE]))
    force = np.array([rig.linear.force, 0.0, 0.0])
    true = np.vstack((force, -((omega * ORDERS) ** 2) * shape))
    amplitudes = sensors.gains[:, None] * np.exp(
        1j * (sensors.phases[:, None] - omega * ORDERS * sensors.delays[:, None])
    ) * true  # fmt: skip
    seen = omega * (1.0 + sensors.clock)  # samples are counted by the converter's clock
    count = int(PERIODS * 2 * np.pi * RATE / seen) + 2
    cycles = seen * np.arange(count) / (2 * np.pi * RATE)
    data = np.real(amplitudes @ np.exp(2j * np.pi * np.outer(ORDERS, cycles)))
    data += noise * np.abs(amplitudes[:, :1]) * random.standard_normal(data.shape)
    lock = lock_event(0, count, PERIODS)
    return modal_point(Window(lock, RATE, CHANNELS, data, cycles, float(seen * count / RATE / (2 * np.pi))), linear)
