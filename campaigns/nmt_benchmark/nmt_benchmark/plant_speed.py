"""Speed of the plant: the compiled time loop against scipy's solve_ivp on the same problem."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from nmt_core.messages.records import DriveCommand
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import ElectromechanicalSystem, assemble, displacement_output
from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.propagator import state_space
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.rig import Rig, SensorSection, load_rig
from nmt_rig.rig_model import build_system

_LOOK = 1e-3  # s, as often as the plant node looks in real time


@dataclass(frozen=True)
class PlantBenchmark:
    """Speeds as multiples of real time on one core, by processor time of the thread.

    Attributes:
        simulated_seconds: length of the timed run of the rig, s.
        kernel: time integration alone, blocks of the rig's length.
        device: oscillator, time integration, sensors, safety: `read` and `write` of the device.
        step_nanoseconds: wall time of one step of the time integration, ns.
        peer: solve_ivp (Radau, rtol 1e-6, corners as events) on the same equations.
        peer_seconds: length of the peer's run, s.
    """

    simulated_seconds: float
    kernel: float
    device: float
    step_nanoseconds: float
    peer: float
    peer_seconds: float


def solve_ivp_peer(
    system: ElectromechanicalSystem,
    frequency: float,
    amplitude: float,
    duration: float,
    rtol: float = 1e-6,
    atol: float = 1e-9,
    method: str = "Radau",
) -> tuple[FloatArray, FloatArray]:
    """The same motion by scipy: sine input from rest.

    The corners of the Jenkins element, of which there may be one, are terminal events.

    Args:
        system: assembled system whose only nonlinear element, if any, is a Jenkins element.
        frequency: rad/s.
        amplitude: of the input a cos(ωt).
        duration: s.
        rtol, atol: tolerances of solve_ivp.
        method: of solve_ivp; the coil's circuit is stiff.

    Returns:
        Times (n,) and states (N, n) at the solver's own steps.

    Raises:
        ValueError: more than one nonlinear element, or one that is not a Jenkins element.
        RuntimeError: solve_ivp failed.
    """
    space = state_space(system)
    if len(space.elements) > 1 or not all(isinstance(element, Jenkins) for element in space.elements):
        raise ValueError("the peer knows systems with at most one Jenkins element")
    m = space.mechanical_size
    port, w_row, v_row = np.zeros(space.size), np.zeros(space.size), np.zeros(space.size)
    stiffness, slip = 0.0, np.inf
    if space.elements:
        port = space.b_ports[:, 0]
        stiffness, slip = space.elements[0].parameters[:2]
        w_row[:m] = v_row[m : 2 * m] = space.directions[0, :m]
    stuck = space.a + stiffness * np.outer(port, w_row)
    slider, branch = 0.0, 0
    state, now = np.zeros(space.size), 0.0
    times, states = [np.zeros(1)], [np.zeros((space.size, 1))]
    while now < duration:
        matrix = space.a if branch else stuck
        constant = port * (branch * slip if branch else -stiffness * slider)

        def rate(t: float, y: Any, matrix: Any = matrix, constant: Any = constant) -> Any:
            return matrix @ y + space.b_inputs[:, 0] * (amplitude * np.cos(frequency * t)) + constant

        def corner(t: float, y: Any, branch: int = branch, slider: float = slider) -> Any:
            if branch:
                return branch * (v_row @ y)
            return slip - abs(stiffness * (w_row @ y - slider)) if np.isfinite(slip) else 1.0

        corner.terminal = True  # type: ignore[attr-defined]
        corner.direction = -1.0  # type: ignore[attr-defined]
        solution = solve_ivp(rate, (now, duration), state, method, rtol=rtol, atol=atol, jac=matrix, events=corner)
        if not solution.success:
            raise RuntimeError(solution.message)
        times.append(solution.t[1:])
        states.append(solution.y[:, 1:])
        state, now = solution.y[:, -1], float(solution.t[-1])
        if solution.status == 1:
            w = float(w_row @ state)
            if branch:
                slider, branch = w - branch * slip / stiffness, 0
            else:
                branch = 1 if w > slider else -1
    return np.concatenate(times), np.concatenate(states, axis=1)


def run_benchmark(rig: Rig, seconds: float = 10.0, peer_seconds: float = 0.3) -> PlantBenchmark:
    """Time the rig at its target mode's frequency and a middle level.

    Args:
        rig: with at most one nonlinear element (the peer's limit).
        seconds: simulated time for the rig.
        peer_seconds: simulated time for the peer.
    """
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
    begin = time.thread_time()
    for k in range(blocks):
        integrator.advance(drive[k * n : (k + 1) * n + 1])
    kernel_wall = time.thread_time() - begin
    steps = integrator.steps

    device.start()
    command = DriveCommand(Waveform.SINE, frequency, amplitude)
    begin = time.thread_time()
    for _ in range(blocks):
        device.write(command)
        device.read()
    device_wall = time.thread_time() - begin
    device.close()

    begin = time.thread_time()
    solve_ivp_peer(build_system(rig), 2 * np.pi * frequency, amplitude, peer_seconds)
    peer_wall = time.thread_time() - begin
    return PlantBenchmark(
        simulated_seconds=duration,
        kernel=duration / kernel_wall,
        device=duration / device_wall,
        step_nanoseconds=1e9 * kernel_wall / max(steps, 1),
        peer=peer_seconds / peer_wall,
        peer_seconds=peer_seconds,
    )


@dataclass(frozen=True)
class OwnedOutputCost:
    """Processor time that an output in a process of its own takes, as a share of real time.

    Attributes:
        device: thread that reads the device in real time, its rig included.
        owner: the process that owns the output.
        late: longest time in s from a block put out to its `read`.
    """

    device: float
    owner: float
    late: float


def owned_output_cost(rig: Rig, seconds: float = 2.0, lead_blocks: int = 25) -> OwnedOutputCost:
    """Run the rig in real time with an output that a process of its own owns.

    Args:
        rig: the rig.
        seconds: how long.
        lead_blocks: blocks that wait at the output; many, so that a busy machine stops nothing.
    """
    device = SimulatedRig(rig, owned=True, lead_blocks=lead_blocks)
    device.configure()
    device.start()
    try:
        command = DriveCommand(Waveform.SINE, linear_description(rig).frequency_hz, 1.0, 0.1)
        device.write(command)
        device.read()
        process = device.output_pid
        blocks = max(round(seconds * rig.sample_rate_hz / rig.block_samples), 1)
        duration = blocks * rig.block_samples / rig.sample_rate_hz
        own, owner, late = time.thread_time(), _process_time(process), 0.0
        for _ in range(blocks):
            device.write(command)
            while not device.is_ready:
                time.sleep(_LOOK)
            late = max(late, device.lateness)
            device.read()
        own, owner = time.thread_time() - own, _process_time(process) - owner
    finally:
        device.close()
    return OwnedOutputCost(own / duration, owner / duration, late)


def _process_time(process: int | None) -> float:
    """Processor time of another process so far, s."""
    words = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def contact_speed(places: int, seconds: float = 0.5) -> float:
    """Multiple of real time of the time integration of a cantilever of 50 elements with sliders along it that slip.

    10 kHz, driven at 20 Hz at point 14; by processor time of the thread.

    Args:
        places: sliders, at most 49, whose stiffnesses add up to 8000 N/m.
        seconds: simulated time.
    """
    rate, block = 10_000.0, 200
    beam = euler_bernoulli_beam(0.7, 0.00527668, 0.01156978, 185e9, 7830.0, 50, 1e-4)
    points = np.round(np.linspace(2, 50, places)).astype(int)
    elements = [Jenkins(beam.selector(int(point)), 8000.0 / places, 0.5 / places) for point in points]
    system = assemble(beam, elements, 14)
    integrator = TimeIntegrator(system, rate, [displacement_output(system, 50)])
    integrator.advance(np.zeros(2))  # compiles or loads the kernel
    blocks = max(round(seconds * rate / block), 1)
    drive = 2.0 * np.sin(2 * np.pi * 20.0 * np.arange(blocks * block + 1) / rate)
    begin = time.thread_time()
    for k in range(blocks):
        integrator.advance(drive[k * block : (k + 1) * block + 1])
    return blocks * block / rate / (time.thread_time() - begin)


def channel_speed(channels: int, seconds: float = 0.5) -> float:
    """Multiple of real time of the whole device: the rig `beam` with 49 elements at 51.2 kHz, blocks of 40 ms.

    By processor time of the thread.

    Args:
        channels: force, voltage and accelerometers along the beam.
        seconds: simulated time.

    Raises:
        ValueError: fewer than 3 channels, or more than 51.
    """
    if not 3 <= channels <= 51:
        raise ValueError(f"3 to 51 channels, got {channels}")
    rig = load_rig(
        "beam",
        [
            "sample_rate_hz=51200",
            "structure.elements=49",
            "local_elements.0.point=21",
            "exciter.point=14",
        ],
    )
    points = np.round(np.linspace(1, 49, channels - 2)).astype(int)
    sensors = [SensorSection(quantity="force", point="drive"), SensorSection(quantity="voltage")]
    sensors += [SensorSection(quantity="acceleration", point=int(point)) for point in points]
    block = 2048
    device = SimulatedRig(rig.model_copy(update={"sensors": sensors}), block)
    device.configure()
    device.start()
    device.write(DriveCommand(Waveform.SINE, linear_description(rig).frequency_hz, 1.0))
    device.read()
    blocks = max(round(seconds * rig.sample_rate_hz / block), 1)
    begin = time.thread_time()
    for _ in range(blocks):
        device.read()
    spent = time.thread_time() - begin
    device.close()
    return blocks * block / rig.sample_rate_hz / spent
