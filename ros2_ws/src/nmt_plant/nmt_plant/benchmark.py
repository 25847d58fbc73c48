"""Speed of the plant: the compiled time loop beside scipy's solve_ivp on the same problem."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from nmt_core.blocks import FloatArray

from .device import DriveCommand, Waveform
from .model.assembly import ElectromechanicalSystem
from .model.propagator import state_space
from .rig import Rig
from .rig_model import build_system
from .simulated_rig import SimulatedRig


@dataclass(frozen=True)
class PlantBenchmark:
    """Speeds as multiples of real time on one core.

    Attributes:
        simulated_seconds: length of the timed run of the rig, s.
        kernel: time integration alone, blocks of the rig's length.
        device: oscillator, time integration, sensors, safety: `read` and `write` of the device.
        step_nanoseconds: wall time of one step of the time integration, ns.
        peer: solve_ivp (LSODA, rtol 1e-6) on the same equations.
        peer_seconds: length of the peer's run, s.
    """

    simulated_seconds: float
    kernel: float
    device: float
    step_nanoseconds: float
    peer: float
    peer_seconds: float

    @property
    def kernel_over_peer(self) -> float:
        """How many times faster than the peer the time integration is."""
        return self.kernel / self.peer


def solve_ivp_peer(
    system: ElectromechanicalSystem,
    frequency: float,
    amplitude: float,
    times: FloatArray,
    rtol: float = 1e-6,
    method: str = "LSODA",
) -> FloatArray:
    """The same motion by scipy: sine input from rest, at most one Jenkins element, its force as a rate equation.

    Args:
        system: assembled system whose only nonlinear element, if any, is a Jenkins element.
        frequency: rad/s.
        amplitude: of the input a cos(ωt).
        times: (n,) s, from 0.
        rtol: relative tolerance of solve_ivp.
        method: of solve_ivp.

    Returns:
        (N + 1, n) states and the element's force.

    Raises:
        ValueError: more than one nonlinear element.
        RuntimeError: solve_ivp failed.
    """
    space = state_space(system)
    if len(space.elements) > 1:
        raise ValueError("the peer knows systems with at most one nonlinear element")
    n = space.size
    port = np.zeros(n)
    stiffness, slip = 0.0, np.inf
    if space.elements:
        port = space.b_ports[:, 0]
        stiffness, slip = space.elements[0].parameters[:2]
        m = space.mechanical_size
        velocity = np.zeros(n)
        velocity[m : 2 * m] = space.directions[0, :m]

    def rate(t: float, y: Any) -> Any:
        s, g = y[:n], min(max(y[n], -slip), slip)
        result = np.empty(n + 1)
        result[:n] = space.a @ s + space.b_input * (amplitude * np.cos(frequency * t)) + port * g
        v = velocity @ s if space.elements else 0.0
        result[n] = 0.0 if (g >= slip and v > 0) or (g <= -slip and v < 0) else stiffness * v
        return result

    step = np.pi / (50.0 * frequency)
    solution = solve_ivp(
        rate, (0.0, float(times[-1])), np.zeros(n + 1), method, times, rtol=rtol, atol=1e-12, max_step=step
    )
    if not solution.success:
        raise RuntimeError(solution.message)
    return np.asarray(solution.y)


def run_benchmark(rig: Rig, seconds: float = 10.0, peer_seconds: float = 0.3) -> PlantBenchmark:
    """Time the rig at its target mode's frequency and a middle level.

    Args:
        rig: with at most one nonlinear element (the peer's limit).
        seconds: simulated time for the rig.
        peer_seconds: simulated time for the peer.
    """
    from .linear_description import linear_description

    frequency = linear_description(rig).frequency_hz
    amplitude = 1.0
    n = rig.block_samples
    blocks = max(round(seconds * rig.sample_rate_hz / n), 1)
    duration = blocks * n / rig.sample_rate_hz

    device = SimulatedRig(rig)
    device.configure()
    integrator = device.integrator
    integrator.reset()
    drive = amplitude * np.cos(2 * np.pi * frequency * np.arange(blocks * n + 1) / rig.sample_rate_hz)
    begin = time.perf_counter()
    for k in range(blocks):
        integrator.advance(drive[k * n : (k + 1) * n + 1])
    kernel_wall = time.perf_counter() - begin
    steps = integrator.steps

    device.start()
    command = DriveCommand(Waveform.SINE, frequency, amplitude)
    begin = time.perf_counter()
    for _ in range(blocks):
        device.write(command)
        device.read()
    device_wall = time.perf_counter() - begin
    device.close()

    times = np.arange(0.0, peer_seconds, 1.0 / rig.sample_rate_hz)
    begin = time.perf_counter()
    solve_ivp_peer(build_system(rig), 2 * np.pi * frequency, amplitude, times)
    peer_wall = time.perf_counter() - begin
    return PlantBenchmark(
        simulated_seconds=duration,
        kernel=duration / kernel_wall,
        device=duration / device_wall,
        step_nanoseconds=1e9 * kernel_wall / max(steps, 1),
        peer=peer_seconds / peer_wall,
        peer_seconds=peer_seconds,
    )
