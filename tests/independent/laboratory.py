"""A second laboratory: a chain of three masses on a shaker, written from the equations of motion alone.

It shares no code with the bench: its own equations, its own integrator (the classical Runge–Kutta method of fourth
order at a fixed step), its own phase loop, its own measuring chain. What it leaves behind is what a laboratory
leaves behind: a file of samples and a sidecar that says what the columns are.

The chain, with x₁ at the shaker's table, x₃ free, every mass on a soft suspension::

    m₁ẍ₁ + s(x₁, ẋ₁) + k₁(x₁ − x₂) + c₁(ẋ₁ − ẋ₂) = F
    m₂ẍ₂ + s(x₂, ẋ₂) − k₁(x₁ − x₂) − c₁(ẋ₁ − ẋ₂) + k₂(x₂ − x₃) + c₂(ẋ₂ − ẋ₃) = 0
    m₃ẍ₃ + s(x₃, ẋ₃) − k₂(x₂ − x₃) − c₂(ẋ₂ − ẋ₃) + N(x₃) = 0

with s(x, v) = k_g x + c_g v, the force F of the load cell between table and mass 1, and the shaker (Tomlinson 1979)::

    m_T ẍ₁ + k_T x₁ + c_T ẋ₁ − k_C(x_C − x₁) − c_C(ẋ_C − ẋ₁) = −F
    m_C ẍ_C + k_C(x_C − x₁) + c_C(ẋ_C − ẋ₁) = G i
    L di/dt + (R + R_s) i + G ẋ_C = u

The nonlinear force N at mass 3 is a sum of a cubic spring k₃x³, a one-sided stop k·max(x − g, 0) and a two-sided
gap k·max(|x| − g, 0)·sign x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numba import njit

CHANNELS = ("u", "f", "a1", "a2", "a3")
_STATES = 9  # x1 x2 x3 v1 v2 v3 xC vC i


@dataclass(frozen=True)
class Chain:
    """Parameters of structure and shaker; SI units.

    Attributes:
        masses: m₁, m₂, m₃, kg.
        springs: k₁, k₂, N/m.
        dampers: c₁, c₂, N s/m.
        ground_spring, ground_damper: of each mass, N/m, N s/m.
        cubic: N/m³.
        stop, stop_gap: one-sided stop, N/m and m.
        gap_stiffness, gap: two-sided gap, N/m and m.
        table: m_T kg, k_T N/m, c_T N s/m.
        coil: m_C kg, k_C N/m, c_C N s/m.
        force_factor: G, N/A.
        inductance: L, H.
        resistance: R, Ω.
        source_resistance: R_s of the amplifier, Ω.
    """

    masses: tuple[float, float, float] = (2.4, 0.9, 1.8)
    springs: tuple[float, float] = (6.0e5, 1.2e6)
    dampers: tuple[float, float] = (1.2, 1.8)
    ground_spring: float = 400.0
    ground_damper: float = 0.4
    cubic: float = 0.0
    stop: float = 0.0
    stop_gap: float = 0.0
    gap_stiffness: float = 0.0
    gap: float = 0.0
    table: tuple[float, float, float] = (0.06, 20707.0, 28.33)
    coil: tuple[float, float, float] = (0.08, 8.42e6, 57.17)
    force_factor: float = 15.48
    inductance: float = 140e-6
    resistance: float = 3.0
    source_resistance: float = 0.0

    def parameters(self) -> np.ndarray:
        """All numbers in the order that the kernel reads them, shape (25,)."""
        values = (
            *self.masses, *self.springs, *self.dampers, self.ground_spring, self.ground_damper,
            self.cubic, self.stop, self.stop_gap, self.gap_stiffness, self.gap,
            *self.table, *self.coil, self.force_factor, self.inductance, self.resistance + self.source_resistance,
        )  # fmt: skip
        return np.array(values, dtype=np.float64)

    def linear_matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mass, damping and stiffness matrix of the structure alone, shape (3, 3) each."""
        k1, k2 = self.springs
        c1, c2 = self.dampers
        kg, cg = self.ground_spring, self.ground_damper
        mass = np.diag(self.masses)
        stiffness = np.array([[kg + k1, -k1, 0], [-k1, kg + k1 + k2, -k2], [0, -k2, kg + k2]])
        damping = np.array([[cg + c1, -c1, 0], [-c1, cg + c1 + c2, -c2], [0, -c2, cg + c2]])
        return mass, damping, stiffness

    def rig(self, sample_rate: float, name: str = "foreign_chain") -> dict[str, Any]:
        """The linear model that a user of the bench would write of this rig, as the content of a rig file."""
        table, coil = self.table, self.coil
        return {
            "name": name,
            "description": "Three masses on a shaker",
            "sample_rate_hz": sample_rate,
            "block_samples": 100,
            "extraction": {"quantity": "acceleration", "harmonics": 5},
            "structure": {
                "kind": "chain",
                "masses_kg": list(self.masses),
                "springs_n_m": list(self.springs),
                "dampers_ns_m": list(self.dampers),
                "ground_springs_n_m": [self.ground_spring] * 3,
                "ground_dampers_ns_m": [self.ground_damper] * 3,
            },
            "exciter": {
                "kind": "electrodynamic_shaker",
                "point": 1,
                "table_mass_kg": table[0],
                "table_stiffness_n_m": table[1],
                "table_damping_ns_m": table[2],
                "coil_mass_kg": coil[0],
                "coil_stiffness_n_m": coil[1],
                "coil_damping_ns_m": coil[2],
                "force_factor_n_a": self.force_factor,
                "inductance_h": self.inductance,
                "resistance_ohm": self.resistance,
            },
            "sensors": [
                {"quantity": "force", "point": "drive"},
                *({"quantity": "acceleration", "point": point} for point in (1, 2, 3)),
                {"quantity": "voltage"},
            ],
        }


@dataclass(frozen=True)
class MeasuringChain:
    """What stands between the rig and the file.

    Attributes:
        gains: factor of each channel of ``CHANNELS``.
        phases: phase lead of each channel at all frequencies, rad.
        delays: of each channel, s; may be negative against a common reference.
        noise: white noise of each channel, rms in its unit.
        bits: of the converters; 0 = none.
        ranges: full scale of each channel, in its unit.
        hum: amplitude of the mains in each channel, in its unit.
        hum_hz: mains frequency.
        clock_error: true sample interval is (1 + clock_error) / sample_rate.
        hold: the drive is held over each output sample (a converter without a reconstruction filter).
        distortion: third harmonic of the drive over its fundamental.
    """

    gains: tuple[float, ...] = (1.0,) * 5
    phases: tuple[float, ...] = (0.0,) * 5
    delays: tuple[float, ...] = (0.0,) * 5
    noise: tuple[float, ...] = (1e-5, 2e-4, 2e-3, 2e-3, 2e-3)
    bits: int = 24
    ranges: tuple[float, ...] = (20.0, 200.0, 2000.0, 2000.0, 2000.0)
    hum: tuple[float, ...] = (0.0,) * 5
    hum_hz: float = 50.0
    clock_error: float = 0.0
    hold: bool = True
    distortion: float = 0.0

    @staticmethod
    def drawn(
        seed: int, gain: float = 0.01, phase_deg: float = 0.2, delay: float = 100e-6, distortion: float = 1e-3
    ) -> MeasuringChain:
        """A healthy chain of ordinary tolerances.

        Args:
            seed: of the draw.
            gain: standard deviation of the gains of force and accelerations.
            phase_deg: standard deviation of their phases, degrees.
            delay: half width of the delay that all sensors share against the voltage, s.
            distortion: of the drive.
        """
        draw = np.random.default_rng([seed, 0xC4A1])
        gains = (1.0, *(1.0 + gain * draw.standard_normal(4)))
        phases = (0.0, *(math.radians(phase_deg) * draw.standard_normal(4)))
        shared = float(draw.uniform(-delay, delay))
        return MeasuringChain(
            gains=tuple(float(value) for value in gains),
            phases=tuple(float(value) for value in phases),
            delays=(0.0, shared, shared, shared, shared),
            distortion=distortion,
            hum=(0.0, 1e-4, 1e-3, 1e-3, 1e-3),
            clock_error=float(20e-6 * draw.standard_normal()),
        )


@njit(cache=True)
def derivative(y, u, p, out):  # pragma: no cover - compiled
    """State derivative of rig and shaker; returns the force of the load cell."""
    m1, m2, m3, k1, k2, c1, c2, kg, cg = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]
    cubic, stop, stop_gap, gap_k, gap = p[9], p[10], p[11], p[12], p[13]
    mt, kt, ct, mc, kc, cc = p[14], p[15], p[16], p[17], p[18], p[19]
    factor, inductance, resistance = p[20], p[21], p[22]
    x1, x2, x3, v1, v2, v3, xc, vc, current = y[0], y[1], y[2], y[3], y[4], y[5], y[6], y[7], y[8]
    inner1 = k1 * (x1 - x2) + c1 * (v1 - v2)
    inner2 = k2 * (x2 - x3) + c2 * (v2 - v3)
    nonlinear = cubic * x3 * x3 * x3
    if x3 > stop_gap:
        nonlinear += stop * (x3 - stop_gap)
    if x3 > gap:
        nonlinear += gap_k * (x3 - gap)
    elif x3 < -gap:
        nonlinear += gap_k * (x3 + gap)
    structure1 = kg * x1 + cg * v1 + inner1
    coil = kc * (xc - x1) + cc * (vc - v1)
    a1 = (coil - kt * x1 - ct * v1 - structure1) / (m1 + mt)
    out[0], out[1], out[2] = v1, v2, v3
    out[3] = a1
    out[4] = (inner1 - inner2 - kg * x2 - cg * v2) / m2
    out[5] = (inner2 - kg * x3 - cg * v3 - nonlinear) / m3
    out[6] = vc
    out[7] = (factor * current - coil) / mc
    out[8] = (u - resistance * current - factor * vc) / inductance
    return m1 * a1 + structure1


@njit(cache=True)
def integrate(y, drive, step, p, out):  # pragma: no cover - compiled
    """Advance over ``drive`` (volts at every half step, shape (2 n + 1,)); ``out`` gets (n, 4): F, ẍ₁, ẍ₂, ẍ₃."""
    k1, k2, k3, k4 = np.empty(9), np.empty(9), np.empty(9), np.empty(9)
    for n in range(out.shape[0]):
        force = derivative(y, drive[2 * n], p, k1)
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = force, k1[3], k1[4], k1[5]
        derivative(y + 0.5 * step * k1, drive[2 * n + 1], p, k2)
        derivative(y + 0.5 * step * k2, drive[2 * n + 1], p, k3)
        derivative(y + step * k3, drive[2 * n + 2], p, k4)
        y += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@dataclass
class Laboratory:
    """The rig with its shaker, drive and sensors, driven block by block.

    Args:
        chain: structure and shaker as they really are.
        measuring: the measuring chain.
        sample_rate: Hz, as the laboratory believes it.
        substeps: steps of the integration per sample.
        seed: of the noise.
    """

    chain: Chain
    measuring: MeasuringChain = field(default_factory=MeasuringChain)
    sample_rate: float = 5000.0
    substeps: int = 24
    seed: int = 1

    def __post_init__(self) -> None:
        self._state = np.zeros(_STATES)
        self._parameters = self.chain.parameters()
        self._cycles = 0.0
        self._index = 0
        self._noise = np.random.default_rng([self.seed, 0x9E37])
        self._fine: list[np.ndarray] = []  # (n, 5) at the fine step: u, F, a1, a2, a3

    def play(self, amplitude: float, frequency: float, samples: int, start: float | None = None) -> np.ndarray:
        """Drive with a sine for some samples, the amplitude going there from ``start`` along a half cosine.

        Returns:
            True values at the sampling instants, shape (samples, 5), before the measuring chain.
        """
        chain, per = self.measuring, self.substeps
        true_rate = self.sample_rate / (1.0 + chain.clock_error)
        fine = np.arange(2 * per * samples + 1) / (2 * per)  # in samples
        first = amplitude if start is None else start
        if chain.hold:
            fine = np.minimum(np.floor(fine + 1e-9), samples - 1.0)
        phase = 2.0 * np.pi * (self._cycles + frequency / self.sample_rate * fine)
        weight = 0.5 - 0.5 * np.cos(np.pi * np.clip(fine / samples, 0.0, 1.0))
        size = first + (amplitude - first) * weight
        drive = size * (np.cos(phase) + chain.distortion * np.cos(3.0 * phase))
        self._cycles = (self._cycles + frequency / self.sample_rate * samples) % 1.0
        out = np.empty((per * samples, 4))
        integrate(self._state, drive, 1.0 / (true_rate * per), self._parameters, out)
        self._fine.append(np.column_stack([drive[:-1:2], out]))
        return self._fine[-1][::per]

    def random(self, rms: float, band: tuple[float, float], samples: int) -> None:
        """Drive with band-limited noise of a constant spectrum, random phases, periodic in ``samples``."""
        per = 1 if self.measuring.hold else 2 * self.substeps
        lines = np.fft.rfftfreq(per * samples, 1.0 / (per * self.sample_rate))
        inside = (lines >= band[0]) & (lines <= band[1])
        draw = np.random.default_rng([self.seed, 0x52])
        spectrum = np.zeros(lines.size, dtype=complex)
        spectrum[inside] = np.exp(2j * np.pi * draw.random(int(inside.sum())))
        signal = np.fft.irfft(spectrum, per * samples)
        signal *= rms / np.sqrt(np.mean(signal**2))
        ramp = np.minimum(1.0, np.arange(signal.size) / (0.2 * per * self.sample_rate))
        signal *= np.sin(0.5 * np.pi * ramp) ** 2
        held = np.repeat(signal, 2 * self.substeps // per)
        drive = np.append(held, 0.0)
        true_rate = self.sample_rate / (1.0 + self.measuring.clock_error)
        out = np.empty((self.substeps * samples, 4))
        integrate(self._state, drive, 1.0 / (true_rate * self.substeps), self._parameters, out)
        self._fine.append(np.column_stack([drive[:-1:2], out]))

    @property
    def samples(self) -> int:
        """Number of samples so far."""
        return sum(part.shape[0] for part in self._fine) // self.substeps

    def resonate(
        self, amplitude: float, frequency: float, settle: int = 40, window: int = 80
    ) -> tuple[float, int, int]:
        """Step to an amplitude, find phase resonance, and stay there for a window of whole periods.

        The loop is this laboratory's own: the phase of force against acceleration over ten periods by least squares
        of a sine, and a secant step of the frequency.

        Returns:
            Frequency, Hz (as believed), first sample and number of samples of the window.
        """
        rate = self.sample_rate
        last = getattr(self, "_amplitude", 0.0)
        self.play(amplitude, frequency, round(settle * rate / frequency), start=last)
        self._amplitude = amplitude
        history: list[tuple[float, float]] = []
        for _ in range(40):
            self.play(amplitude, frequency, round(settle * rate / frequency))
            block = self.play(amplitude, frequency, round(10 * rate / frequency))
            error = _phase_between(block[:, 1], block[:, 2], frequency / rate)
            history.append((frequency, error))
            if abs(error) < 2e-4 and len(history) > 2:
                break
            frequency = _next_frequency(history)
        samples = round(window * rate / frequency)
        self.play(amplitude, frequency, round(settle * rate / frequency))
        first = self.samples
        self.play(amplitude, frequency, samples)
        return frequency, first, samples

    def recording(self) -> np.ndarray:
        """Everything so far as the converters give it, shape (samples, 5), columns ``CHANNELS``."""
        chain, per = self.measuring, self.substeps
        fine = np.concatenate(self._fine)
        count = fine.shape[0] // per
        position = np.arange(count, dtype=float) * per
        true_rate = self.sample_rate / (1.0 + chain.clock_error)
        columns = []
        for index in range(len(CHANNELS)):
            signal = fine[:, index]
            if chain.phases[index]:
                signal = _turned(signal, chain.phases[index])
            at = position - chain.delays[index] * true_rate * per
            values = np.interp(at, np.arange(signal.size), signal) * chain.gains[index]
            time = np.arange(count) / true_rate
            values = values + chain.hum[index] * np.sin(2.0 * np.pi * chain.hum_hz * time + index)
            values = values + chain.noise[index] * self._noise.standard_normal(count)
            if chain.bits:
                step = 2.0 * chain.ranges[index] / 2**chain.bits
                values = np.clip(np.round(values / step) * step, -chain.ranges[index], chain.ranges[index])
            columns.append(values)
        return np.column_stack(columns)


def _phase_between(force: np.ndarray, acceleration: np.ndarray, cycles_per_sample: float) -> float:
    """Phase of the force against the velocity, rad in (−π, π]; zero at phase resonance."""
    phase = 2.0 * np.pi * cycles_per_sample * np.arange(force.size)
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones(force.size)])
    f, a = np.linalg.lstsq(basis, np.column_stack([force, acceleration]), rcond=None)[0][:2].T
    turn = complex(f[0], -f[1]) / (complex(a[0], -a[1]) / 1j)
    return math.atan2(turn.imag, turn.real)


def _next_frequency(history: list[tuple[float, float]]) -> float:
    """Secant step towards phase zero, bounded to half a percent; a first step of a tenth of a percent."""
    frequency, error = history[-1]
    step = 1e-3 * frequency * (1.0 if error < 0.0 else -1.0)
    if len(history) > 1:
        before, previous = history[-2]
        slope = (error - previous) / (frequency - before) if frequency != before else 0.0
        if slope > 0.0:
            step = -error / slope
    return frequency + max(-5e-3 * frequency, min(5e-3 * frequency, step))


def _turned(signal: np.ndarray, angle: float) -> np.ndarray:
    """The signal with all its frequencies led by an angle (rad), by its analytic signal."""
    size = 1 << (signal.size - 1).bit_length()
    spectrum = np.fft.rfft(signal, size)
    spectrum[1:] *= np.exp(1j * angle)
    return np.fft.irfft(spectrum, size)[: signal.size]


@dataclass(frozen=True)
class Recorded:
    """A recording on disk.

    Attributes:
        sidecar: what ``./nmt import`` takes.
        model: rig file of the linear model.
        frequencies: found by the laboratory's own loop, Hz.
    """

    sidecar: Path
    model: Path
    frequencies: tuple[float, ...]


def record(
    folder: Path,
    chain: Chain,
    measuring: MeasuringChain,
    levels: tuple[float, ...],
    *,
    believed: Chain | None = None,
    start_hz: float,
    random_rms: float = 0.05,
    band: tuple[float, float] = (20.0, 400.0),
    random_seconds: float = 20.0,
    seed: int = 1,
) -> Recorded:
    """A random test and a backbone of phase resonances, as files.

    Args:
        folder: an existing folder.
        chain: the rig as it is.
        measuring: the measuring chain.
        levels: drive amplitudes, V.
        believed: the rig as its owner's model has it; None = the same without nonlinear forces and source resistance.
        start_hz: frequency that the loop starts at.
        random_rms: V.
        band: of the random drive, Hz.
        random_seconds: its duration.
        seed: of the noise.
    """
    lab = Laboratory(chain, measuring, seed=seed)
    rate = lab.sample_rate
    segments: list[dict[str, Any]] = []
    frequency = start_hz
    found = []
    for level in levels:
        begin = lab.samples
        frequency, first, samples = lab.resonate(level, frequency)
        found.append(frequency)
        segments.append(
            {
                "kind": "phase_resonance",
                "level": float(level),
                "level_unit": "V",
                "start": begin / rate,
                "stop": lab.samples / rate,
                "window": [first / rate, (first + samples) / rate],
            }
        )
    lab.play(0.0, frequency, round(0.5 * rate), start=levels[-1])
    lab.play(0.0, frequency, round(2.0 * rate))
    begin = lab.samples
    count = round(random_seconds * rate)
    lab.random(random_rms, band, count)
    segments.append(
        {
            "kind": "random",
            "level": random_rms,
            "level_unit": "V",
            "start": begin / rate,
            "stop": lab.samples / rate,
            "window": [begin / rate + 2.0, lab.samples / rate],
        }
    )
    data = lab.recording()
    np.savez(folder / "data.npz", **{name: data[:, index] for index, name in enumerate(CHANNELS)})
    model = folder / "model.yaml"
    plain = believed or replace(chain, cubic=0.0, stop=0.0, gap_stiffness=0.0, source_resistance=0.0)
    model.write_text(yaml.safe_dump(plain.rig(rate), sort_keys=False))
    content = {
        "rig": str(model),
        "sample_rate": rate,
        "file": "data.npz",
        "channels": [
            {"column": "u", "quantity": "voltage", "unit": "V"},
            {"column": "f", "quantity": "force", "unit": "N", "point": 1},
            *({"column": f"a{p}", "quantity": "acceleration", "unit": "m/s^2", "point": p} for p in (1, 2, 3)),
        ],
        "segments": segments,
    }
    sidecar = folder / "sidecar.yaml"
    sidecar.write_text(yaml.safe_dump(content, sort_keys=False))
    return Recorded(sidecar, model, tuple(found))
