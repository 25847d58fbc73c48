"""A third laboratory: a free beam of thirteen points behind a stinger, with what every chain has and one cause.

It shares no code with the bench or the other laboratories. The beam is a Rayleigh–Ritz sum of Legendre polynomials
(free ends are natural), dampers at its ends make its damping non-proportional, and the method of Runge and Kutta of
fourth order integrates all modes up to half of the sampling rate: the model of its owner has the flexibility of all.
Beside the levels of a phase-resonance test there is a low random test or two taps of a hammer.

Every recording has gains, delays, noise and some hum in the force cell. The model of the beam's owner has twelve
finite elements and proportional damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numba import njit
from numpy.polynomial import legendre
from scipy.linalg import eigh

RATE = 4096.0
POINTS = 13
DRIVEN = 5
SENSORS = (1, 3, 5, 8, 10, 13)
KINDS = {"cubic": 0, "quadratic": 1, "gap": 2, "stop": 3, "drag": 4, "coulomb": 5, "eddy_brake": 6, "stribeck": 7}
FAMILIES = (
    "healthy", "hum_quadratic", "cubic", "hum_late", "gap", "healthy", "hum_clipped", "stop", "coulomb", "gain",
    "healthy", "cubic_and_gain", "late", "quadratic", "unnamed", "drag",
)  # fmt: skip
_DEGREE, _MODES = 23, 12
_FINE, _STEPS = 8, 16  # samples of a table and steps of the integration in one sample
_TURNS, _IN_PHASE = 2000, 0.01  # at most; rad
_FEWEST_LEVELS = 5
_MODULUS, _DENSITY, _WIDTH = 2.05e11, 7850.0, 0.03


@dataclass(frozen=True)
class Beam:
    """A free beam by its lowest modes, mass-normalised.

    Attributes:
        omega2: squares of the natural frequencies without dampers, (modes,).
        damping: modal damping matrix, not diagonal, (modes, modes).
        shapes: of all points, (points, modes).
    """

    omega2: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray

    def ratio(self, mode: int) -> float:
        """Damping ratio of a mode, coupling left out."""
        return float(self.damping[mode, mode] / (2.0 * math.sqrt(self.omega2[mode])))


def free_beam(
    length: float, height: float, beta: float, end_damper: float, suspension: float, modes: int = _MODES
) -> Beam:
    """Rayleigh–Ritz with Legendre polynomials in −1 … 1: ∫PᵢPⱼ is diagonal, ∫Pᵢ″Pⱼ″ exact by Gauss's rule."""
    area, inertia = _WIDTH * height, _WIDTH * height**3 / 12.0
    x, weights = legendre.leggauss(_DEGREE + 2)
    curved = np.array([legendre.legval(x, legendre.legder(row, 2)) for row in np.eye(_DEGREE + 1)])
    stiffness = _MODULUS * inertia * (2.0 / length) ** 3 * (curved * weights) @ curved.T
    mass = np.diag(_DENSITY * area * length / (2.0 * np.arange(_DEGREE + 1) + 1.0))
    ends = legendre.legvander(np.array([-1.0, 1.0]), _DEGREE)
    at_ends = ends.T @ ends
    omega2, vectors = eigh(stiffness + suspension * at_ends, mass)
    vectors = vectors[:, :modes]
    points = legendre.legvander(np.linspace(-1.0, 1.0, POINTS), _DEGREE) @ vectors
    return Beam(omega2[:modes], vectors.T @ (beta * stiffness + end_damper * at_ends) @ vectors, points)


def accelerance(beam: Beam, omega: float) -> np.ndarray:
    """Accelerations of the sensors over the force at an angular frequency without local forces, complex, (sensors,)."""
    dynamic = np.diag(beam.omega2 - omega**2) + 1j * omega * beam.damping
    modes = np.linalg.solve(dynamic, beam.shapes[DRIVEN - 1].astype(complex))
    found: np.ndarray = -(omega**2) * (beam.shapes[np.array(SENSORS) - 1] @ modes)
    return found


@njit(cache=True)
def _rates(
    t: float,
    y: Any,
    omega2: Any,
    damping: Any,
    load: Any,
    table: Any,
    rate: float,
    sine: Any,
    kind: int,
    shape: Any,
    p: Any,
) -> Any:
    """State derivative; the force is a sine (amplitude, ω, phase) or samples joined by straight lines."""
    n = omega2.size
    out = np.empty(2 * n)
    if table.size:
        at = min(max(t * rate, 0.0), table.size - 1.001)
        k = int(at)
        force = table[k] + (at - k) * (table[k + 1] - table[k])
    else:
        force = sine[0] * math.cos(sine[1] * t + sine[2])
    w = v = g = 0.0
    for r in range(n):
        w += shape[r] * y[r]
        v += shape[r] * y[n + r]
    if kind == 0:
        g = p[0] * w**3
    elif kind == 1:
        g = p[0] * w**2
    elif kind == 2:
        g = p[0] * (max(w - p[1], 0.0) + min(w + p[1], 0.0))
    elif kind == 3:
        g = p[0] * max(w - p[1], 0.0)
    elif kind == 4:
        g = p[0] * v * abs(v)
    elif kind == 5:
        g = p[0] * math.tanh(v / p[1])
    elif kind == 6:
        g = p[0] * v / (1.0 + (v / p[1]) ** 2)
    elif kind == 7:
        g = p[0] * math.tanh(v / p[1]) * (1.0 + p[2] * math.exp(-((v / p[3]) ** 2)))
    for r in range(n):
        out[r] = y[n + r]
        out[n + r] = load[r] * force - omega2[r] * y[r] - shape[r] * g
        for s in range(n):
            out[n + r] -= damping[r, s] * y[n + s]
    return out


@njit(cache=True)
def _advance(
    y: Any, t: float, times: Any, omega2: Any, damping: Any, load: Any, table: Any, rate: float, sine: Any, kind: int,
    shape: Any, p: Any,
) -> Any:  # fmt: skip
    """States at the times, (times, 2·modes), from the state at a time before them."""
    found = np.empty((times.size, y.size))
    for at in range(times.size):
        steps = max(1, math.ceil((times[at] - t) * _STEPS * RATE))
        h = (times[at] - t) / steps
        for step in range(steps):
            now = t + step * h
            k1 = _rates(now, y, omega2, damping, load, table, rate, sine, kind, shape, p)
            k2 = _rates(now + 0.5 * h, y + 0.5 * h * k1, omega2, damping, load, table, rate, sine, kind, shape, p)
            k3 = _rates(now + 0.5 * h, y + 0.5 * h * k2, omega2, damping, load, table, rate, sine, kind, shape, p)
            k4 = _rates(now + h, y + h * k3, omega2, damping, load, table, rate, sine, kind, shape, p)
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        t = times[at]
        found[at] = y
    return found


@dataclass
class Run:
    """A beam with one local force on the way through its tests.

    Attributes:
        beam: the beam.
        kind, point, parameters: of the local force; kind −1 = none.
        state: modal displacements and velocities; none = at rest.
    """

    beam: Beam
    kind: int = -1
    point: int = 1
    parameters: tuple[float, ...] = (0.0, 1.0, 0.0, 1.0)
    state: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not self.state.size:
            self.stop()

    def stop(self) -> None:
        """Begin at rest."""
        self.state = np.zeros(2 * self.beam.omega2.size)

    def _system(self, table: np.ndarray, sine: np.ndarray) -> tuple[Any, ...]:
        """Arguments of the rates after time and state, for samples of the force or a sine."""
        beam, p = self.beam, np.array([*self.parameters, 0.0, 1.0, 0.0, 1.0][:4], dtype=float)
        load, shape = np.ascontiguousarray(beam.shapes[DRIVEN - 1]), np.ascontiguousarray(beam.shapes[self.point - 1])
        return beam.omega2, beam.damping, load, table, _FINE * RATE, sine, self.kind, shape, p

    def _run(self, seconds: float, at: np.ndarray, table: np.ndarray, sine: np.ndarray) -> np.ndarray:
        """States at the times ``at``, (times, 2·modes); goes on from where the last call ended."""
        times = at if at.size and at[-1] == seconds else np.append(at, seconds)
        found = _advance(self.state, 0.0, times, *self._system(table, sine))
        if not np.all(np.isfinite(found[-1])):
            raise RuntimeError(f"the motion under {self.kind} at {self.point} ends")
        self.state = found[-1].copy()
        states: np.ndarray = found[: at.size]
        return states

    def accelerations(self, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """At all sensors, (times, sensors), from states and the force."""
        none, modes = np.zeros(0), self.beam.omega2.size
        found = [
            _rates(0.0, y, *self._system(none, np.array([f, 0.0, 0.0])))[modes:]
            for y, f in zip(states, force, strict=True)
        ]
        at_sensors: np.ndarray = np.array(found) @ self.beam.shapes[np.array(SENSORS) - 1].T
        return at_sensors

    def driven_by(self, force: np.ndarray) -> np.ndarray:
        """Accelerations under samples of a force, joined as a signal without content above half of the rate."""
        at = np.arange(force.size) / RATE
        fine = np.fft.irfft(_FINE * np.fft.rfft(force), _FINE * force.size)
        return self.accelerations(self._run(float(at[-1]), at, fine, np.zeros(3)), force)

    def resonance(self, size: float, omega: float, settle: int, window: int) -> tuple[float, np.ndarray, np.ndarray]:
        """A level of phase resonance: force and velocity at the driven point brought into phase, then held.

        Args:
            size: amplitude of the force, N.
            omega: angular frequency to begin with, rad/s.
            settle: periods that a motion takes to die down: so long the phase must have been right.
            window: periods of the window.

        Returns:
            Angular frequency, force and accelerations; of the last ``settle`` and ``window`` periods the frequency is
            constant.

        Raises:
            RuntimeError: the phase does not come right.
        """
        phase, forces, found, right = 0.0, [], [], 0
        held = False
        beam, driven = self.beam, self.beam.shapes[DRIVEN - 1]
        first = 0.0  # time of the next sample after the begin of the turn
        for _ in range(_TURNS):
            turns = window if held else 4 if right < settle else settle
            seconds = turns * 2.0 * math.pi / omega
            at = np.arange(first, seconds, 1.0 / RATE)
            states = self._run(seconds, at, np.zeros(0), np.array([size, omega, phase]))
            force = size * np.cos(omega * at + phase)
            forces.append(force)
            found.append(self.accelerations(states, force))
            columns = np.stack([np.cos(omega * at + phase), np.sin(omega * at + phase)], axis=1)
            part = np.linalg.lstsq(columns, states[:, driven.size :] @ driven, rcond=None)[0]
            first = at[-1] + 1.0 / RATE - seconds
            phase = float((omega * seconds + phase) % (2.0 * math.pi))
            if held:
                return omega, np.concatenate(forces), np.concatenate(found)
            lag = math.atan2(part[1], part[0])  # of velocity behind force; above the resonance it lags
            in_phase = abs(lag) < _IN_PHASE
            held = in_phase and right >= settle
            right = right + turns if in_phase else 0
            if right < settle:
                mode = int(np.argmin(np.abs(np.sqrt(beam.omega2) - omega)))
                omega -= 0.25 * math.tan(float(np.clip(lag, -1.2, 1.2))) * beam.ratio(mode) * omega
        raise RuntimeError(f"phase resonance at {size:.3g} N is not found")


def draw_case(seed: int, modes: int = _MODES) -> dict[str, Any]:
    """Family, beam and chain of a seed."""
    draw = np.random.default_rng([3, seed])
    length, height = float(draw.uniform(0.9, 1.1)), float(draw.uniform(0.007, 0.009))
    ratio = float(draw.uniform(0.004, 0.008))
    omega = 22.373 / length**2 * math.sqrt(_MODULUS / _DENSITY * height**2 / 12.0)
    mass = _DENSITY * _WIDTH * height * length
    beta = 2.0 * ratio / omega
    suspension = float(mass * (2.0 * math.pi * 10.0) ** 2 / 2.0)
    damper = 0.01 * suspension / (2.0 * math.pi * 10.0)
    # Each end moves by 2/√m in the first bending mode: what both dampers add to its damping.
    extra = float(draw.uniform(0.0, 0.02)) * 2.0 * ratio * omega * mass / 8.0
    chain = {
        "gains": (1.0 + 0.01 * np.clip(draw.standard_normal(len(SENSORS) + 1), -2, 2)).tolist(),
        "delays": (1e-5 * np.clip(draw.standard_normal(len(SENSORS) + 1), -2, 2)).tolist(),
        "hum": float(draw.uniform(1e-5, 6e-4)),
        "taps": bool(draw.random() < 0.4),
    }
    size = {"length": length, "height": height, "beta": beta, "suspension": suspension, "damper": damper}
    beam = free_beam(length, height, beta, damper + extra, suspension, modes)
    return {"family": FAMILIES[seed % len(FAMILIES)], "draw": draw, "chain": chain, "ratio": ratio, "mass": mass,
            "beam": beam, "model": size}  # fmt: skip


def _law(case: dict[str, Any]) -> tuple[Run, dict[str, Any]]:
    """The beam with its local force, and the truth."""
    draw, beam, family = case["draw"], case["beam"], case["family"]
    point = int(draw.choice((2, 3, 5, 8, 9, 11)))
    phi, omega2 = float(beam.shapes[point - 1, 2]), float(beam.omega2[2])
    w = abs(phi) * case["largest"]  # amplitude of the point at the highest level, m
    shift = float(np.exp(draw.uniform(math.log(0.004), math.log(0.04))))  # Δω/ω there, by averaging
    # The mean force of a quadratic spring pushes the beam on its suspension; at twice as much it has no equilibrium.
    share = float(draw.uniform(0.2, 0.4))

    def effect(name: str, *others: str) -> dict[str, Any]:
        return {"kind": "effect", "verdicts": ["effect"], "effects": [name, *others], "place": [f"{point}"]}

    none = (Run(beam), {"kind": "healthy", "verdicts": ["none", "calibration"]})
    laws: dict[str, Any] = {
        "cubic": ("cubic", (8.0 * shift * omega2 / (3.0 * phi**2 * w**2),), effect("cubic_stiffness")),
        "quadratic": ("quadratic", (share * 3950.0 * case["mass"] / w,), effect("quadratic_stiffness")),
        "gap": ("gap", (5.0 * shift * omega2 / phi**2, 0.5 * w), effect("two_sided_gap")),
        "stop": ("stop", (10.0 * shift * omega2 / phi**2, 0.5 * w), effect("one_sided_stop")),
        "drag": ("drag", (0.75 * math.pi * 0.3 * 2.0 * case["ratio"] / (phi**2 * w),), effect("air_drag")),
        "coulomb": (
            "coulomb",
            (0.25 * math.pi * 0.4 * 2.0 * case["ratio"] * omega2 * 0.2 * w / phi**2, 1e-3 * w * math.sqrt(omega2)),
            effect("second_friction_contact", "microslip"),
        ),
    }
    name = {"hum_quadratic": "quadratic", "cubic_and_gain": "cubic"}.get(family, family)
    if family == "unnamed":
        speed = w * math.sqrt(omega2)
        c = 1.2 * case["ratio"] * math.sqrt(omega2) / phi**2
        truth = {"kind": "unknown", "verdicts": ["unknown"], "place": [f"{point}"],
                 "partly": ["viscous_damping", "second_friction_contact", "power_law_damping"]}  # fmt: skip
        return Run(beam, KINDS["eddy_brake"], point, (c, 0.25 * speed)), truth
    if name in laws:
        kind, parameters, truth = laws[name]
        if family == "cubic_and_gain":
            truth["effects"] = ["cubic_stiffness + response_gain"]
            truth["partly"] = ["cubic_stiffness"]
        return Run(beam, KINDS[kind], point, parameters), truth
    return none


def _through_chain(case: dict[str, Any], signal: np.ndarray, number: int, sizes: np.ndarray) -> np.ndarray:
    """A channel as recorded: delay in the frequency domain, gain, clipping, noise; number 0 is the force."""
    chain, draw = case["chain"], case["draw"]
    lines = np.fft.rfft(signal)
    turn = np.exp(-2j * math.pi * np.fft.rfftfreq(signal.size, 1.0 / RATE) * chain["delays"][number])
    seen = np.fft.irfft(lines * turn, signal.size) * chain["gains"][number]
    if number in case.get("clipped", {}):
        limit = case["clipped"][number] * float(np.abs(seen).max())
        seen = np.clip(seen, -limit, limit)
    if number == 0:
        seen = seen + chain["hum"] * np.sin(2.0 * math.pi * 50.0 * np.arange(seen.size) / RATE + 1.0)
    noisy: np.ndarray = seen + sizes[number] * draw.standard_normal(seen.size)
    return noisy


def make_case(out: Path, seed: int) -> str:
    """Write one case: model, data, sidecar and truth; the same seed gives the same.

    Returns:
        Its name.
    """
    case = draw_case(seed)
    name = f"{case['family']}_{seed:04d}"
    folder = out / name
    if (folder / "truth.yaml").exists():
        return name
    folder.mkdir(parents=True, exist_ok=True)
    beam, draw, chain, omega = case["beam"], case["draw"], case["chain"], math.sqrt(case["beam"].omega2[2])
    tip = 1.5e-3
    case["largest"] = tip / abs(float(beam.shapes[0, 2]))
    test, truth = _law(case)
    top = 2.0 * beam.ratio(2) * omega**2 * abs(case["largest"] / float(beam.shapes[DRIVEN - 1, 2]))
    sensor = int(draw.integers(1, len(SENSORS) + 1))
    place = [f"a{SENSORS[sensor - 1]}"]
    named = {"kind": "effect", "verdicts": ["effect"], "place": place}
    if case["family"] in ("hum_late", "late"):
        chain["delays"][sensor] = 3e-4
        truth = {**named, "effects": ["channel_skew", "low_pass"]}
    elif case["family"] == "hum_clipped":
        case["clipped"] = {sensor: float(draw.uniform(0.6, 0.85))}
        truth = {**named, "effects": ["clipping"]}
    elif case["family"] == "gain":
        chain["gains"][sensor] *= 0.93
        truth = {**named, "effects": ["response_gain"]}
    elif case["family"] == "cubic_and_gain":
        chain["gains"][sensor] *= 0.94
    if case["family"].startswith("hum_"):
        chain["hum"] = float(draw.uniform(5e-4, 8e-4))
    forces, found, segments, begin = [], [], [], 0.0

    def add(force: np.ndarray, accelerations: np.ndarray) -> float:
        nonlocal begin
        forces.append(force)
        found.append(accelerations)
        begin += force.size / RATE
        return begin

    if chain["taps"]:
        for share in (1.0, 0.5):
            force, length = np.zeros(round(3.0 * RATE)), round(0.004 * RATE)
            at = round(0.05 * RATE)
            force[at : at + length] = share * 12.0 * np.sin(math.pi * np.arange(length) / length)
            test.stop()
            start = begin
            stop = add(force, test.driven_by(force))
            segments.append({"kind": "record", "start": round(start, 6), "stop": round(stop - 1.5 / RATE, 6)})
        test.stop()
    else:
        lines = np.fft.rfft(draw.standard_normal(round(24.0 * RATE)))
        hertz = np.fft.rfftfreq(round(24.0 * RATE), 1.0 / RATE)
        lines[(hertz < 12.0) | (hertz > 700.0)] = 0.0
        force = 0.06 * top * np.fft.irfft(lines, round(24.0 * RATE))
        segments.append({"kind": "random", "start": 0.0, "stop": round(add(force, test.driven_by(force)), 6)})
    settle, window = round(6.0 / (2.0 * math.pi * beam.ratio(2))), 50
    for number, level in enumerate(np.geomspace(0.06, 1.0, 9)):
        try:
            omega, force, accelerations = test.resonance(float(level * top), omega, settle, window)
        except RuntimeError:
            # A laboratory ends its plan at a level that its loop does not hold.
            if number < _FEWEST_LEVELS:
                raise
            break
        start = begin
        stop = add(force, accelerations)
        seconds = window * 2.0 * math.pi / omega
        segments.append({"kind": "phase_resonance", "level": float(f"{level * top:.6g}"), "level_unit": "N",
                         "start": round(start, 6), "stop": round(stop - 1.0 / RATE, 6),
                         "window": [round(stop - seconds, 6), round(stop - 1.0 / RATE, 6)]})  # fmt: skip
    force, rows = np.concatenate(forces), np.concatenate(found)
    sizes = np.array([2e-4, *[3e-4 * float(np.abs(rows).max()) / 10.0] * len(SENSORS)])
    if chain["taps"]:
        sizes[0] = 0.002
    columns: dict[str, Any] = {"f": _through_chain(case, force, 0, sizes)}
    for k, point in enumerate(SENSORS):
        columns[f"a{point}"] = _through_chain(case, rows[:, k], k + 1, sizes)
    np.savez(folder / "data.npz", **columns)
    channels = [{"column": "f", "quantity": "force", "unit": "N", "point": DRIVEN}]
    channels += [{"column": f"a{p}", "quantity": "acceleration", "unit": "m/s^2", "point": p} for p in SENSORS]
    sidecar = {"rig": "model.yaml", "sample_rate": RATE, "file": "data.npz", "channels": channels, "segments": segments}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False), encoding="utf-8")
    (folder / "model.yaml").write_text(yaml.safe_dump(owners_model(case["model"]), sort_keys=False), encoding="utf-8")
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth, sort_keys=False), encoding="utf-8")
    return name


def owners_model(size: dict[str, float]) -> dict[str, Any]:
    """What the beam's owner believes."""
    return {
        "name": "free_beam",
        "sample_rate_hz": RATE,
        "structure": {
            "kind": "beam", "boundary": "free-free", "length_m": size["length"], "width_m": _WIDTH,
            "height_m": size["height"], "youngs_modulus_pa": _MODULUS, "density_kg_m3": _DENSITY, "elements": 12,
            "stiffness_damping_s": size["beta"], "suspension_stiffness_n_m": size["suspension"],
            "suspension_damping_ns_m": size["damper"],
        },
        "exciter": {"kind": "force", "point": DRIVEN},
        "sensors": [
            {"quantity": "force", "point": "drive", "channel": "f"},
            *({"quantity": "acceleration", "point": p, "channel": f"a{p}"} for p in SENSORS),
        ],
        "test": {"mode": 3},
        "extraction": {"quantity": "acceleration", "linear_modes": 5},
    }  # fmt: skip
