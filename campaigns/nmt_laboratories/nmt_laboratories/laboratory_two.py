"""A laboratory with four rigs: a beam at held forces, a mast on a shaking table, a tapped plate, a strip in print.

It shares no code with the bench and was written without a look at the diagnosis: modes in closed form, each with a
damping ratio of its own, integrated by :mod:`nmt_laboratories.modal_simulator`; own measuring chain, own tables. What
it leaves behind are folders that ``./nmt blind laboratory`` takes: data, sidecars, the model that the rig's owner
believes, and the truth.

* beam: pinned at both ends, three modes; the owner's model has twelve finite elements and damping by mode. Stepped
  sines at held forces, up and down.
* mast: a cantilever of three modes on a shaking table; the model has twelve finite elements as matrices, or one mode
  with its participation. Stepped sines at held accelerations.
* plate: simply supported, five modes; three measured modes at three points. Two taps with a hammer, recorded.
* strip: clamped at both ends, three modes; two measured modes. A printed backbone and a response at a low force.

Every chain has gains, delays and AC coupling of an ordinary laboratory, drawn, noise, and as many digits as are
printed. A third of the cases is healthy; of these half have a model whose stiffness is off.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.signal import bilinear, lfilter

from nmt_laboratories.modal_simulator import Element, Simulator, fundamental, iwan

RIGS = ("beam", "mast", "plate", "strip")
_STRUCTURE = ["structure", "joint", "boundary"]
_ELEMENTS = 12
_G = 9.80665


@dataclass(frozen=True)
class Specimen:
    """A linear structure as it is.

    Attributes:
        rig: one of ``RIGS``.
        frequencies_hz, ratios: of its modes, (modes,).
        shapes: mass-normalised, 1/√kg, (modes,), by point.
        driven: point of force or tap; of a mast where its response is counted from.
        sensors: points that are measured.
        largest: amplitude at ``driven`` at the highest level, m.
        participation: φᵀMr, √kg, (modes,); of a mast.
        size: length, width, height of the beams, of the plate length, width, thickness, m.
        modulus, density: Pa, kg/m³.
    """

    rig: str
    frequencies_hz: np.ndarray
    ratios: np.ndarray
    shapes: dict[int, np.ndarray]
    driven: int
    sensors: tuple[int, ...]
    largest: float
    size: tuple[float, float, float]
    modulus: float
    density: float
    participation: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def load(self) -> np.ndarray:
        """What a unit of drive does to each mode: a force at ``driven``, or the table's acceleration."""
        return -self.participation if self.rig == "mast" else self.shapes[self.driven]

    @property
    def mass(self) -> float:
        """Of the whole structure, kg."""
        return self.density * math.prod(self.size)


@dataclass(frozen=True)
class Chain:
    """What stands between the rig and the file.

    Attributes:
        gains, delays, corners: factor, delay (s) and corner of the AC coupling (Hz) of each sensor, by point.
        reference_gain: of the force cell or the table's accelerometer.
        noise: relative scatter of a line or a value; of a record over its largest value.
        hum: amplitude of 50 Hz over the largest value of a record, by point.
        clip: full scale over the largest value of a record, by point.
        digits: significant digits in print.
        gain_std: standard deviation that the gains were drawn with.
        stated: noise and gains are stated in the sidecar.
        overstated: stated uncertainty of a table over the scatter that is there.
        hold: scatter of the held amplitude.
    """

    gains: dict[int, float]
    delays: dict[int, float]
    corners: dict[int, float]
    reference_gain: float
    noise: float
    hum: dict[int, float]
    digits: int
    gain_std: float
    stated: bool
    hold: float = 0.003
    overstated: float = 1.0
    clip: dict[int, float] = field(default_factory=dict)

    def factor(self, point: int, frequency_hz: float) -> complex:
        """What a sensor makes of a line."""
        coupled = 1j * frequency_hz / (1j * frequency_hz + self.corners[point])
        found: complex = self.gains[point] * coupled * np.exp(-2j * np.pi * frequency_hz * self.delays[point])
        return found


@dataclass(frozen=True)
class Injected:
    """What a rig has beyond the model of its owner.

    Attributes:
        truth: content of ``truth.yaml``.
        elements: local forces.
        chain: what becomes of the measuring chain.
        levels: amplitudes over the highest.
        spread: shift of the resonance over its frequency at the highest level, for the band of a stepped sine.
        rest: stiffness of the elements at rest and its shape, which modes measured at low level contain.
    """

    truth: dict[str, Any]
    elements: tuple[Element, ...] = ()
    chain: Callable[[Chain], Chain] = lambda chain: chain
    levels: tuple[float, ...] = (0.08, 0.3, 0.6, 1.0)
    spread: float = 0.0
    rest: tuple[tuple[float, np.ndarray], ...] = ()


def bending_roots(clamped_end: bool, count: int) -> list[float]:
    """λ of a beam that is clamped at the left: cos λ cosh λ = −1 with a free right end, +1 with a clamped one."""
    sign = 1.0 if clamped_end else -1.0
    found = []
    for r in range(1, count + 1):
        middle = (r + 0.5) * math.pi if clamped_end else (r - 0.5) * math.pi
        found.append(float(brentq(lambda x: math.cos(x) - sign / math.cosh(x), middle - 0.5, middle + 0.5, xtol=1e-13)))
    return found


def bending_shape(root: float, clamped_end: bool, x: np.ndarray | float) -> Any:
    """Mode of a beam that is clamped at the left, with a mean square of 1 over its length; x over the length."""
    c, s, ch, sh = math.cos(root), math.sin(root), math.cosh(root), math.sinh(root)
    sigma = (ch - c) / (sh - s) if clamped_end else (ch + c) / (sh + s)
    at = root * np.asarray(x, dtype=float)
    return np.cosh(at) - np.cos(at) - sigma * (np.sinh(at) - np.sin(at))


def draw_specimen(rig: str, draw: np.random.Generator) -> Specimen:
    """A structure of ordinary size and damping."""

    def near(value: float) -> float:
        return float(value * draw.uniform(0.85, 1.15))

    first = float(draw.uniform(0.003, 0.009))
    ratios = first * draw.uniform(0.7, 1.6, 5)
    ratios[0] = first
    if rig == "beam":
        size, modulus, density, count = (near(0.9), near(0.04), near(0.006)), 2.05e11, 7850.0, 3
        wave = _wave(size[2], modulus, density)
        frequencies = np.array([(r * math.pi / size[0]) ** 2 * wave for r in range(1, count + 1)])
        norm = math.sqrt(2.0 / (density * math.prod(size)))
        shapes = {
            p: norm * np.array([math.sin(r * math.pi * p / _ELEMENTS) for r in range(1, count + 1)])
            for p in range(1, _ELEMENTS)
        }
        return Specimen(rig, frequencies, ratios[:count], shapes, 4, (4, 6, 9), 2e-3, size, modulus, density)
    if rig == "plate":
        size, modulus, density = (near(0.5), near(0.4), near(0.003)), 7.0e10, 2700.0
        rigidity = modulus * size[2] ** 3 / (12.0 * (1.0 - 0.33**2))
        norm = math.sqrt(4.0 / (density * math.prod(size)))
        waves = sorted(
            (math.pi**2 * math.sqrt(rigidity / (density * size[2])) * ((i / size[0]) ** 2 + (j / size[1]) ** 2), i, j)
            for i in range(1, 5)
            for j in range(1, 5)
        )[:5]
        frequencies = np.array([omega / (2.0 * math.pi) for omega, _, _ in waves])
        places = {1: (0.5, 0.5), 2: (0.3, 0.4), 3: (0.65, 0.3)}
        shapes = {
            p: norm * np.array([math.sin(i * math.pi * x) * math.sin(j * math.pi * y) for _, i, j in waves])
            for p, (x, y) in places.items()
        }
        return Specimen(rig, frequencies, ratios, shapes, 1, (1, 2, 3), 5e-4, size, modulus, density)
    mast = rig == "mast"
    size = (near(0.6), near(0.03), near(0.005)) if mast else (near(0.5), near(0.025), near(0.003))
    modulus, density, count = (7.0e10, 2700.0, 3) if mast else (2.05e11, 7850.0, 3)
    roots = bending_roots(not mast, count)
    wave, mass = _wave(size[2], modulus, density), density * math.prod(size)
    frequencies = np.array([(root / size[0]) ** 2 * wave for root in roots])
    along = {p: p / _ELEMENTS for p in (3, 6, 9, 12)} if mast else {1: 0.5, 2: 0.25}
    shapes = {
        p: np.array([float(bending_shape(root, not mast, x)) for root in roots]) / math.sqrt(mass)
        for p, x in along.items()
    }
    if not mast:
        return Specimen(rig, frequencies, ratios[:count], shapes, 1, (1,), 1.5e-3, size, modulus, density)
    sigma = [(math.cosh(x) + math.cos(x)) / (math.sinh(x) + math.sin(x)) for x in roots]
    participation = math.sqrt(mass) * np.array([2.0 * s / x for s, x in zip(sigma, roots, strict=True)])
    return Specimen(
        rig, frequencies, ratios[:count], shapes, 12, (6, 9, 12), 8e-3, size, modulus, density, participation
    )


def _wave(height: float, modulus: float, density: float) -> float:
    """√(EI/ρA) / 2π, m²/s: times the square of a wave number it is a frequency."""
    return height * math.sqrt(modulus / (12.0 * density)) / (2.0 * math.pi)


def draw_chain(specimen: Specimen, draw: np.random.Generator) -> Chain:
    """A measuring chain of ordinary tolerances: gains of 1 to 3 %, where they are stated, else of 1 %."""
    stated = bool(draw.random() < 0.5)
    gain = float(draw.uniform(0.01, 0.03)) if stated and specimen.rig == "plate" else 0.01
    points, first = specimen.sensors, float(specimen.frequencies_hz[0])

    def normal(std: float) -> float:
        return float(std * np.clip(draw.standard_normal(), -2.0, 2.0))

    return Chain(
        gains={p: 1.0 + normal(gain) for p in points},
        delays={p: normal(1e-5) for p in points},
        corners={p: abs(normal(math.radians(0.15))) * first for p in points},
        reference_gain=1.0 + normal(0.01),
        noise=float(np.exp(draw.uniform(math.log(1e-3), math.log(5e-3)))),
        hum={p: float(draw.uniform(0.0, 5e-4)) for p in points},
        digits=int(draw.integers(4, 7)),
        gain_std=gain,
        stated=stated,
    )


def draw_truth(seed: int, specimen: Specimen, draw: np.random.Generator) -> Injected:
    """What the rig has beyond its model: nothing for every third seed, an effect of the library or another."""
    if seed % 3 == 0:
        shifted = (seed // 3) % 2 == 1
        return Injected({"kind": "healthy", "verdicts": ["calibration"] if shifted else ["none", "calibration"]})
    if draw.random() < 0.25:
        return inject(str(draw.choice(UNKNOWN)), specimen, draw)
    return inject(str(draw.choice(KNOWN[specimen.rig])), specimen, draw)


UNKNOWN = ("stribeck", "lugre", "bouc_wen", "backlash", "eddy_brake")
_NONLINEAR = ("cubic", "softening", "quintic", "gap", "stop", "slider", "iwan", "amplitude_damper", "drag")
KNOWN = {
    "beam": (*_NONLINEAR, "response_gain", "response_gain", "skew", "force_gain"),
    "mast": (*_NONLINEAR, "response_gain", "response_gain", "skew"),
    "plate": (*_NONLINEAR, "response_gain", "clipping", "clipping", "hum"),
    "strip": _NONLINEAR,
}


def inject(name: str, specimen: Specimen, draw: np.random.Generator) -> Injected:
    """An effect of a drawn strength at a drawn point.

    Strengths follow from first-order averaging of the first mode (Nayfeh and Mook, Nonlinear Oscillations): of a
    force g on a point of mass-normalised shape φ that moves by A cos ωt, Δω/ω = φ² Re G / (2 ω² A) and
    Δζ = φ² Im G / (2 ω² A), with G the complex amplitude of g.
    """
    if name in ("response_gain", "skew", "clipping", "hum", "force_gain"):
        return _faulty_chain(name, specimen, draw)
    point = _point(specimen, draw)
    shape = specimen.shapes[point]
    omega = 2.0 * math.pi * float(specimen.frequencies_hz[0])
    modal = specimen.largest / abs(specimen.shapes[specimen.driven][0])
    a = abs(shape[0]) * modal  # amplitude at the point, m
    speed, unit, zeta = omega * a, omega**2 / shape[0] ** 2, float(specimen.ratios[0])
    shift, loss = float(draw.uniform(0.006, 0.03)), zeta * float(draw.uniform(0.4, 1.2))
    k = 2.0 * shift * unit
    friction = 0.5 * math.pi * unit * a * zeta * float(draw.uniform(0.06, 0.12))  # N
    held = (0.3, 0.5, 0.75, 1.0)

    def known(effects: Sequence[str], partly: Sequence[str] = (), **values: float) -> dict[str, Any]:
        return {
            "kind": "effect",
            "verdicts": ["effect"],
            "effects": list(effects),
            "partly": list(partly),
            "place": _STRUCTURE,
            "parameters": {f"{effects[0]}@{point}.{key}": float(value) for key, value in values.items()},
        }

    def other(partly: Sequence[str], remark: str) -> dict[str, Any]:
        return {"kind": "unknown", "verdicts": ["unknown"], "partly": list(partly), "remark": f"{remark} at {point}"}

    def element(kind: str, *values: float, **more: Any) -> tuple[Element, ...]:
        return (Element(kind, shape, tuple(values), **more),)

    if name in ("cubic", "softening"):
        # Softening to half of it, far from where the restoring force turns.
        k3 = k / (0.75 * a**2) * (1.0 if name == "cubic" else -0.5)
        spread = shift if name == "cubic" else -0.5 * shift
        return Injected(known(["cubic_stiffness"], ["quintic_stiffness"], k=k3), element("cubic", k3), spread=spread)
    if name == "quintic":
        k5 = k / (0.625 * a**4)
        return Injected(known(["quintic_stiffness"], ["cubic_stiffness"], k=k5), element("quintic", k5), spread=shift)
    if name in ("gap", "stop"):
        own, like = ("two_sided_gap", "one_sided_stop") if name == "gap" else ("one_sided_stop", "two_sided_gap")
        gap = a * float(draw.uniform(0.3, 0.55))
        stiffness = k * (2.0 if name == "gap" else 4.0)
        # Tables of fundamentals do not tell one side from two; a record with its harmonics does.
        names, near = ([own], [like]) if specimen.rig == "plate" else ([own, like], [])
        return Injected(known(names, near, k=stiffness, gap=gap), element(name, stiffness, gap), spread=1.3 * shift)
    if name in ("slider", "iwan"):
        slip = a * float(draw.uniform(0.12, 0.3) if name == "slider" else draw.uniform(0.6, 1.5))
        sliders = ((k, k * slip),) if name == "slider" else iwan(k, slip)
        truth = (
            known(["second_friction_contact", "clamp_friction"], ["microslip"], kt=k, slip_force=k * slip)
            if name == "slider"
            else known(["microslip"], ["second_friction_contact", "clamp_friction"])
        )
        return Injected(truth, element("sliders", sliders=sliders), levels=held, spread=1.2 * shift, rest=((k, shape),))
    if name == "amplitude_damper":
        c = loss * 8.0 * unit / (omega * a**2)
        return Injected(known(["amplitude_damping"], ["power_law_damping", "air_drag"], c=c), element(name, c))
    if name == "drag":
        c = loss * 0.75 * math.pi * unit / (omega**2 * a)
        return Injected(known(["air_drag", "power_law_damping"], ["amplitude_damping"], c2=c), element(name, c))
    contact = ("second_friction_contact", "microslip", "clamp_friction", "power_law_damping")
    excess = float(draw.uniform(1.0, 2.5))
    if name == "stribeck":
        values: tuple[float, ...] = (friction, 0.005 * speed, excess, 0.35 * speed)
        return Injected(other(contact, "Stribeck friction"), element(name, *values), levels=held)
    if name == "lugre":
        stiffness = friction / (0.05 * a)
        values = (stiffness, 0.0, friction, friction * (1.0 + excess), 0.35 * speed)
        return Injected(
            other(contact, "LuGre friction"), element(name, *values), levels=held, rest=((stiffness, shape),)
        )
    if name == "bouc_wen":
        values = (k, a * float(draw.uniform(0.15, 0.35)), float(draw.uniform(1.0, 2.0)), 0.2)
        return Injected(
            other(contact, "Bouc-Wen hysteresis"), element(name, *values), levels=held, spread=1.2 * shift,
            rest=((k, shape),),
        )  # fmt: skip
    if name == "backlash":
        stiffness, gap = 2.0 * k, a * float(draw.uniform(0.3, 0.5))
        values = (stiffness, gap, stiffness * float(draw.uniform(0.4, 1.0)) / speed)
        truth = other(("two_sided_gap", "one_sided_stop"), "backlash with damping")
        return Injected(truth, element(name, *values), spread=1.3 * shift)
    c = 2.0 * omega * zeta * float(draw.uniform(0.6, 1.5)) / shape[0] ** 2
    truth = other(("viscous_damping", "second_friction_contact", "power_law_damping"), "eddy-current brake")
    return Injected(truth, element("eddy_brake", c, 0.25 * speed))


def _point(specimen: Specimen, draw: np.random.Generator) -> int:
    """A point that moves well in the first mode."""
    largest = max(abs(shape[0]) for shape in specimen.shapes.values())
    return int(draw.choice([p for p, shape in specimen.shapes.items() if abs(shape[0]) > 0.45 * largest]))


def _faulty_chain(name: str, specimen: Specimen, draw: np.random.Generator) -> Injected:
    point = int(draw.choice(specimen.sensors))
    strength = float(draw.uniform(0.07, 0.14) * draw.choice((-1.0, 1.0)))
    tau = math.radians(float(draw.uniform(3.0, 6.0))) / (2.0 * math.pi * float(specimen.frequencies_hz[0]))
    # The bench names a channel by the letter of its quantity and its point.
    place = [str(point), *(f"{letter}{point}" for letter in "axv")]
    effects, parameters = {
        "response_gain": (["response_gain"], {"g": strength}),
        "skew": (["channel_skew", "low_pass"], {"tau": tau}),
        "clipping": (["clipping"], {}),
        "hum": (["mains_hum"], {}),
        "force_gain": (["force_gain", "response_gain"], {"g": strength}),
    }[name]

    def faulty(chain: Chain) -> Chain:
        if name == "response_gain":
            return replace(chain, gains=chain.gains | {point: chain.gains[point] * (1.0 + strength)})
        if name == "skew":
            return replace(chain, delays=chain.delays | {point: chain.delays[point] + tau})
        if name == "clipping":
            return replace(chain, clip={point: 0.45 + 2.0 * abs(strength)})
        if name == "hum":
            return replace(chain, hum=chain.hum | {point: 0.3 * abs(strength)})
        return replace(chain, reference_gain=chain.reference_gain * (1.0 + strength))

    truth = {
        "kind": "effect",
        "verdicts": ["effect"],
        "effects": effects,
        "place": [] if name == "force_gain" else place,
        "parameters": parameters,
    }
    return Injected(truth, chain=faulty)


def stepped_sine(
    specimen: Specimen, elements: Sequence[Element], size: float, lines_hz: np.ndarray, draw: np.random.Generator,
    hold: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Step a sine through a resonance, in the order of the lines, and wait at each until it is steady.

    A structure without local forces is given in closed form.

    Args:
        size: amplitude that is held: force in N, or acceleration of the table in m/s².
        hold: relative scatter of what is held.

    Returns:
        Acceleration of the sensors over the drive, complex, (lines, sensors), relative to a table; amplitude of the
        drive, (lines,); and at how many lines the motion was not steady, shape (1,).
    """
    shapes = np.array([specimen.shapes[p] for p in specimen.sensors]).T
    if not elements:
        sizes = size * (1.0 + hold * draw.standard_normal(lines_hz.size))
        return linear_response(specimen, lines_hz) @ shapes, sizes, np.zeros(1)
    simulator = Simulator(specimen.frequencies_hz, specimen.ratios, specimen.load, elements)
    folds = 1.0 / (2.0 * math.pi * float(specimen.ratios[0]))  # periods in which a free decay falls by e
    unsteady, modes = 0, specimen.frequencies_hz.size
    found, drives = [], []
    for line, frequency in enumerate(lines_hz):
        now = size * (1.0 + hold * draw.standard_normal())
        simulator.sine(now, frequency, math.ceil((6.0 if line == 0 else 3.0) * folds))
        before = 0.0j
        for _ in range(12):
            rows, _ = simulator.sine(now, frequency, 6, per_period=64)
            drive = fundamental(rows[:, -1], 6)
            motion = np.array([fundamental(column, 6) for column in (rows[:, 2 * modes : 3 * modes] @ shapes).T])
            if abs(motion[-1] - before) < 5e-4 * abs(motion[-1]):
                break
            before = motion[-1]
            simulator.sine(now, frequency, math.ceil(folds))
        else:
            unsteady += 1
        found.append(motion / drive)
        drives.append(abs(drive))
    return np.array(found), np.array(drives), np.array([unsteady])


def linear_response(specimen: Specimen, lines_hz: np.ndarray) -> np.ndarray:
    """Acceleration of the modes over the drive without local forces, complex, (lines, modes)."""
    omega, own = 2.0 * math.pi * lines_hz[:, None], 2.0 * math.pi * specimen.frequencies_hz
    found: np.ndarray = -(omega**2) * specimen.load / (own**2 - omega**2 + 2j * specimen.ratios * own * omega)
    return found


def backbone(specimen: Specimen, elements: Sequence[Element], sizes: Sequence[float] | np.ndarray) -> np.ndarray:
    """Phase resonance of the first mode at forces of these amplitudes, N.

    Returns:
        Frequency (Hz), amplitude of the first sensor (m) and damping ratio, (levels, 3): the power that the force
        brings in, over ω³ q² (for a linear mode that is its ζ).
    """
    simulator = Simulator(specimen.frequencies_hz, specimen.ratios, specimen.load, elements)
    shape, modes = specimen.shapes[specimen.sensors[0]], specimen.frequencies_hz.size
    driven, frequency = specimen.shapes[specimen.driven], float(specimen.frequencies_hz[0])
    folds = 1.0 / (2.0 * math.pi * float(specimen.ratios[0]))
    # From a small motion, which leaves sliders where they are.
    simulator.state[modes] = 1e-3 * sizes[0] * driven[0] / (2.0 * specimen.ratios[0] * 2.0 * math.pi * frequency)
    simulator.state[-2] = simulator.state[modes] * driven[0]
    found = []
    for size in sizes:
        rate = 40.0 * frequency
        for wait in (6.0, 3.0, 3.0):
            simulator.tracked(size, frequency, math.ceil(wait * folds * 40), rate)
            rows, _ = simulator.tracked(size, frequency, 40 * 60, rate)
            frequency = frequency_of(rows[:, :modes] @ shape, rate)
        count = math.floor(60 * frequency / rate * 40 - 1e-9)
        kept = round(count * rate / frequency)
        turn = np.exp(-2j * np.pi * frequency / rate * np.arange(kept))
        amplitude = abs(2.0 * np.mean((rows[:kept, :modes] @ shape) * turn))
        modal = abs(2.0 * np.mean(rows[:kept, 0] * turn))
        power = float(np.mean(rows[:kept, -1] * (rows[:kept, modes : 2 * modes] @ driven)))
        found.append((frequency, amplitude, power / ((2.0 * math.pi * frequency) ** 3 * modal**2)))
    return np.array(found)


def frequency_of(signal: np.ndarray, rate: float) -> float:
    """Of a steady signal, Hz: by its upward crossings of the mean, then by the turn of its phase between its halves."""
    about = signal - signal.mean()
    before = np.flatnonzero((about[:-1] < 0.0) & (about[1:] >= 0.0))
    crossings = before + about[before] / (about[before] - about[before + 1])
    near_hz = rate * (crossings.size - 1) / (crossings[-1] - crossings[0])
    for _ in range(4):
        half = round(math.floor(signal.size / 2 * near_hz / rate) * rate / near_hz)
        turn = np.exp(-2j * np.pi * near_hz / rate * np.arange(half))
        first, second = np.sum(signal[:half] * turn), np.sum(signal[half : 2 * half] * turn)
        advance = np.angle(second / first * np.exp(-2j * np.pi * near_hz / rate * half))
        near_hz += float(advance) / (2.0 * math.pi) * rate / half
    return float(near_hz)


def model_of(
    specimen: Specimen, injected: Injected, shift: float, draw: np.random.Generator, by_modes: bool
) -> tuple[dict[str, Any], dict[str, float]]:
    """The rig file of the owner, and the true values of what is off in it.

    Args:
        shift: relative error of its stiffness.
        by_modes: of a mast, one mode with its participation in place of matrices.
    """

    def off(std: float) -> float:
        return float(1.0 + std * np.clip(draw.standard_normal(), -2.0, 2.0))

    damping = [float(f"{ratio * off(0.07):.3g}") for ratio in specimen.ratios]
    stiffness = (1.0 + shift) * off(0.003)
    rig, name = specimen.rig, f"owners_{specimen.rig}"
    length, width, height = specimen.size
    force = [{"quantity": "force", "point": "drive"}]
    seen = [{"quantity": "acceleration", "point": p} for p in specimen.sensors]
    extraction = {"quantity": "acceleration", "linear_modes": 2}
    if rig == "beam":
        omega = 2.0 * math.pi * specimen.frequencies_hz
        beta = 2.0 * damping[0] / omega[0]
        structure: dict[str, Any] = {
            "kind": "beam", "boundary": "pinned-pinned", "length_m": length, "width_m": width, "height_m": height,
            "youngs_modulus_pa": specimen.modulus * stiffness, "density_kg_m3": specimen.density,
            "elements": _ELEMENTS, "stiffness_damping_s": float(beta),
            "damping_factors": [float(2.0 * zeta / (beta * w)) for zeta, w in zip(damping, omega, strict=True)],
        }  # fmt: skip
        content = {"name": name, "structure": structure, "exciter": {"kind": "force", "point": specimen.driven},
                   "sensors": force + seen, "extraction": extraction}  # fmt: skip
        return content, {"structure.youngs_modulus_pa": specimen.modulus} if shift else {}
    if rig == "mast" and not by_modes:
        mass, rigidity, load = mast_matrices(specimen)
        structure = {
            "kind": "matrices", "mass_kg": mass.tolist(), "stiffness_n_m": (stiffness * rigidity).tolist(),
            "damping_ratios": damping, "base_vector": [1.0, 0.0] * _ELEMENTS, "base_load_kg": load.tolist(),
            "points_at": [{"point": p, "row": 2 * p - 2} for p in specimen.shapes],
        }  # fmt: skip
        content = {"name": name, "structure": structure, "exciter": {"kind": "shaking_table", "point": specimen.driven},
                   "sensors": [*force, *seen], "extraction": extraction}  # fmt: skip
        return content, {"structure.stiffness_factor": 1.0 / (1.0 + shift)} if shift else {}
    frequencies, shapes, participation = _measured_modes(specimen, injected)
    kept = {"mast": 1, "plate": 3, "strip": 2}[rig]
    modes = []
    for r in range(kept):
        scale = max((shapes[p][r] for p in specimen.shapes), key=abs)
        mode = {
            "frequency_hz": float(f"{frequencies[r] * math.sqrt(1.0 + shift) * off(0.001):.5g}"),
            "damping_ratio": damping[r],
            "modal_mass_kg": float(f"{off(0.01) / scale**2:.4g}"),
            "shape": [float(f"{shapes[p][r] / scale:.3f}") for p in specimen.shapes],
        }
        if rig == "mast":
            mode["participation"] = float(f"{participation[r] * scale * off(0.005):.4g}")
        modes.append(mode)
    structure = {"kind": "modal", "points": list(specimen.shapes), "modes": modes}
    exciter = {"kind": "shaking_table" if rig == "mast" else "force", "point": specimen.driven}
    true = {"structure.modes.0.frequency_hz": float(frequencies[0])} if shift else {}
    return {"name": name, "structure": structure, "exciter": exciter}, true


def mast_matrices(specimen: Specimen) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass and stiffness matrix of a cantilever of finite elements with cubic shapes, and its load by the table.

    The degrees at the clamp are left out; the load has their share.
    """
    step = specimen.size[0] / _ELEMENTS
    area = specimen.size[1] * specimen.size[2]
    bending = specimen.modulus * specimen.size[1] * specimen.size[2] ** 3 / 12.0
    stiffness = bending / step**3 * np.array(
        [[12, 6 * step, -12, 6 * step], [6 * step, 4 * step**2, -6 * step, 2 * step**2],
         [-12, -6 * step, 12, -6 * step], [6 * step, 2 * step**2, -6 * step, 4 * step**2]]
    )  # fmt: skip
    mass = specimen.density * area * step / 420.0 * np.array(
        [[156, 22 * step, 54, -13 * step], [22 * step, 4 * step**2, 13 * step, -3 * step**2],
         [54, 13 * step, 156, -22 * step], [-13 * step, -3 * step**2, -22 * step, 4 * step**2]]
    )  # fmt: skip
    whole = np.zeros((2, 2 * _ELEMENTS + 2, 2 * _ELEMENTS + 2))
    for e in range(_ELEMENTS):
        rows = slice(2 * e, 2 * e + 4)
        whole[0, rows, rows] += mass
        whole[1, rows, rows] += stiffness
    moved_along = np.tile([1.0, 0.0], _ELEMENTS + 1)
    return whole[0, 2:, 2:], whole[1, 2:, 2:], whole[0, 2:] @ moved_along


def _measured_modes(specimen: Specimen, injected: Injected) -> tuple[np.ndarray, dict[int, np.ndarray], np.ndarray]:
    """Modes as a test at low level finds them, with the elements as they are at rest."""
    stiffness = np.diag((2.0 * math.pi * specimen.frequencies_hz) ** 2)
    for k, shape in injected.rest:
        stiffness = stiffness + k * np.outer(shape, shape)
    values, turn = np.linalg.eigh(stiffness)
    turn = turn * np.where(np.diag(turn) < 0.0, -1.0, 1.0)
    shapes = {p: shape @ turn for p, shape in specimen.shapes.items()}
    participation = specimen.participation @ turn if specimen.participation.size else np.zeros(values.size)
    return np.sqrt(values) / (2.0 * math.pi), shapes, participation


def make_case(out: Path, seed: int) -> str:
    """Draw, measure and write the case of a seed, ``truth.yaml`` last; nothing where that is there.

    Args:
        out: gets the case's folder.
        seed: any; every third case is healthy.

    Returns:
        Name of the case: that of the rig and the seed, and nothing of what it has.
    """
    draw = np.random.default_rng([seed, 0x2AB])
    rig = str(draw.choice(RIGS))
    name = f"{rig}_{seed:04d}"
    folder = out / name
    if (folder / "truth.yaml").is_file():
        return name
    specimen = draw_specimen(rig, draw)
    injected = draw_truth(seed, specimen, draw)
    chain = injected.chain(draw_chain(specimen, draw))
    shifted = injected.truth["kind"] == "healthy" and injected.truth["verdicts"] == ["calibration"]
    shift = float(draw.uniform(0.02, 0.035) * draw.choice((-1.0, 1.0))) if shifted else 0.0
    by_modes = bool(draw.random() < 0.5)
    model, true = model_of(specimen, injected, shift, draw, by_modes)
    folder.mkdir(parents=True, exist_ok=True)
    if rig == "plate":
        _write_taps(folder, specimen, injected, chain, draw)
    elif rig == "strip":
        write_print(folder, specimen, injected, chain, draw)
    else:
        absolute = rig == "mast" and bool(draw.random() < 0.5)
        if absolute:
            model["exciter"] |= {"responses": "absolute"}
        write_tables(folder, specimen, injected, chain, draw, absolute)
    (folder / "model.yaml").write_text(yaml.safe_dump(model, sort_keys=False))
    truth = injected.truth | ({"parameters": true} if shifted else {})
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth, sort_keys=False))
    return name


def drive_for(specimen: Specimen) -> float:
    """Amplitude of the drive that moves ``driven`` by ``largest`` at the first resonance of the linear structure."""
    omega, shape = 2.0 * math.pi * float(specimen.frequencies_hz[0]), specimen.shapes[specimen.driven]
    return float(2.0 * specimen.ratios[0] * omega**2 * specimen.largest / abs(shape[0] * specimen.load[0]))


def write_tables(
    folder: Path, specimen: Specimen, injected: Injected, chain: Chain, draw: np.random.Generator, absolute: bool
) -> None:
    """Frequency responses at held levels, up and at the two highest down, a file for each level and direction."""
    first, zeta, table = float(specimen.frequencies_hz[0]), float(specimen.ratios[0]), specimen.rig == "mast"
    low, high = min(injected.spread, 0.0), max(injected.spread, 0.0)
    lines = np.round(first * np.linspace(1.0 - 5.0 * zeta + 1.4 * low, 1.0 + 5.0 * zeta + 1.4 * high, 45), 3)
    segments, top, column = [], drive_for(specimen), bool(draw.random() < 0.5) and not table
    level_unit, unit = ("m/s^2", "m/s^2/(m/s^2)" if absolute else "m/(m/s^2)") if table else ("N", "m/s^2/N")
    for number, share in enumerate(injected.levels):
        level = float(f"{share * top:.3g}")
        for direction in ("up", "down") if number >= len(injected.levels) - 2 else ("up",):
            order = lines if direction == "up" else lines[::-1]
            # The controller holds what the reference sensor reads.
            responses, sizes, _ = stepped_sine(
                specimen, injected.elements, level / chain.reference_gain, order, draw, chain.hold
            )
            if absolute:
                responses = responses + 1.0
            elif table:
                responses = responses / -((2.0 * math.pi * order[:, None]) ** 2)
            for index, point in enumerate(specimen.sensors):
                seen = responses[:, index] * [chain.factor(point, f) for f in order] / chain.reference_gain
                std = np.hypot(chain.noise * abs(seen), 2e-4 * abs(seen).max())
                seen = seen + std * (draw.standard_normal(order.size) + 1j * draw.standard_normal(order.size))
                head, columns = ["frequency_hz", "real", "imag"], [order, seen.real, seen.imag]
                if chain.stated:
                    head, columns = (
                        [*head, "real_std", "imag_std"],
                        [*columns, chain.overstated * std, chain.overstated * std],
                    )
                if column:
                    head, columns = [*head, "force_n"], [*columns, sizes * chain.reference_gain]
                file = f"level{number + 1}_{direction}_point{point}.csv"
                print_table(folder / file, head, columns, chain.digits)
                segments.append(
                    {"kind": "frf", "file": file, "unit": unit, "point": point}
                    | ({} if table else {"drive_point": specimen.driven})
                    | {"level": level, "level_unit": level_unit, "direction": direction}
                )
    sidecar = {"rig": "model.yaml", "file": segments[0]["file"], "segments": segments}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False))


def write_print(folder: Path, specimen: Specimen, injected: Injected, chain: Chain, draw: np.random.Generator) -> None:
    """A backbone as a paper prints it, and the response at a low force about the resonance."""
    lowest = injected.levels[0]
    top = drive_for(specimen)
    rows = backbone(specimen, injected.elements, top * np.geomspace(min(lowest, 0.12), 1.0, 10))
    point = specimen.sensors[0]
    damping_noise, frequency_noise = float(draw.uniform(0.01, 0.03)), float(draw.uniform(2e-5, 1e-4))
    count = rows.shape[0]
    frequency = rows[:, 0] * (1.0 + frequency_noise * draw.standard_normal(count))
    amplitude = rows[:, 1] * chain.gains[point] * (1.0 + chain.noise * draw.standard_normal(count))
    damping = rows[:, 2] * chain.reference_gain / chain.gains[point]
    damping = damping * (1.0 + damping_noise * draw.standard_normal(count))
    names = {"frequency_hz": "f_Hz", "amplitude": "a_mm", "damping_ratio": "zeta_percent"}
    units = {"damping_ratio": "%"}
    printed = [
        [f"{f:.2f}", f"{1e3 * a:.3g}", f"{100.0 * z:.3g}"]
        for f, a, z in zip(frequency, amplitude, damping, strict=True)
    ]
    if chain.stated:
        names |= {"frequency_hz_std": "f_std", "damping_ratio_std": "zeta_std"}
        units |= {"damping_ratio_std": "%"}
        for row, f, z in zip(printed, frequency, damping, strict=True):
            std = (
                chain.overstated * math.hypot(f * frequency_noise, 0.003),
                chain.overstated * 100.0 * z * damping_noise,
            )
            row += [f"{std[0]:.4f}", f"{std[1]:.2g}"]
    with (folder / "backbone.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([list(names.values()), *printed])
    first, zeta = float(rows[0, 0]), float(specimen.ratios[0])
    lines = np.round(first * np.linspace(1.0 - 6.0 * zeta, 1.0 + 6.0 * zeta, 41), 3)
    size = float(f"{0.5 * min(lowest, 0.12) * top:.3g}")
    responses, _, _ = stepped_sine(specimen, injected.elements, size, lines, draw)
    seen = responses[:, 0] * [chain.factor(point, f) for f in lines] / chain.reference_gain
    scatter = chain.noise * abs(seen)
    seen = seen + scatter * (draw.standard_normal(lines.size) + 1j * draw.standard_normal(lines.size))
    print_table(folder / "frf.csv", ["frequency_hz", "real", "imag"], [lines, seen.real, seen.imag], chain.digits)
    stated = 100.0 * chain.overstated * chain.noise
    segments = [
        {"kind": "backbone", "unit": "mm", "point": point, "columns": names, "units": units},
        {"kind": "frf", "file": "frf.csv", "unit": "m/s^2/N", "point": point, "drive_point": specimen.driven,
         "level": size, "level_unit": "N", "direction": "up", "noise": float(f"{stated:.2g}")},
    ]  # fmt: skip
    sidecar = {"rig": "model.yaml", "file": "backbone.csv", "segments": segments}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False))


def _write_taps(folder: Path, specimen: Specimen, injected: Injected, chain: Chain, draw: np.random.Generator) -> None:
    """Two taps of different strength at the first point, recorded at three: one velocity, two accelerations."""
    first, zeta = float(specimen.frequencies_hz[0]), float(specimen.ratios[0])
    omega, length, rate = 2.0 * math.pi * first, 0.5 / first, 25.0 * first
    rate = float(2 ** math.ceil(math.log2(rate)))
    shape = specimen.shapes[specimen.driven]
    # A half sine of half a period moves a mode by 2.5 times what the same force does at rest, less than an impulse.
    size = specimen.largest * omega**2 / (shape[0] ** 2) * 0.65
    before, scales = round(0.05 * rate), dict[int, float]()
    for number, share in enumerate((1.0, 0.35)):
        count = round(5.5 / (zeta * omega) * rate)
        simulator = Simulator(specimen.frequencies_hz, specimen.ratios, specimen.load, injected.elements)
        rows, _ = simulator.tap(share * size, length, 4 * count, 4.0 * rate)
        modes, time = specimen.frequencies_hz.size, np.arange(before + count) / rate
        fine = np.concatenate([np.zeros((4 * before, rows.shape[1])), rows])
        at = np.arange(fine.shape[0]) / (4.0 * rate)
        columns, channels = [time], list[dict[str, Any]]()
        for index, point in enumerate(specimen.sensors):
            velocity = index == 0
            begin = modes if velocity else 2 * modes
            signal = fine[:, begin : begin + modes] @ specimen.shapes[point]
            signal = _recorded(signal, at, time, point, chain, scales, draw)
            columns.append(signal)
            quantity, unit = ("velocity", "m/s") if velocity else ("acceleration", "m/s^2")
            channel = {"column": f"ch{index + 1}", "quantity": quantity, "unit": unit, "point": point}
            if chain.stated:
                channel["gain_std"] = float(f"{chain.gain_std:.2g}")
            channels.append(channel)
        file = f"tap{number + 1}.csv"
        print_table(folder / file, ["time_s", *(c["column"] for c in channels)], columns, 7)
        sidecar = {
            "rig": "model.yaml",
            "file": file,
            "time": "time_s",
            "channels": channels,
            "segments": [{"kind": "ring_down", "start": 0.0, "stop": float(f"{time[-1]:.6f}")}],
        }
        (folder / f"sidecar_{number + 1}.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False))


def _recorded(
    signal: np.ndarray,
    at: np.ndarray,
    time: np.ndarray,
    point: int,
    chain: Chain,
    scales: dict[int, float],
    draw: np.random.Generator,
) -> np.ndarray:
    """A signal at a fine rate as the converter gives it; its range is that of the first record."""
    rate = 1.0 / (time[1] - time[0])
    largest = scales.setdefault(point, float(abs(signal).max()))
    seen = CubicSpline(at, signal)(time - chain.delays[point]) * chain.gains[point]
    numerator, denominator = bilinear([1.0, 0.0], [1.0, 2.0 * math.pi * chain.corners[point]], rate)
    seen = lfilter(numerator, denominator, seen)
    seen = seen + largest * chain.hum[point] * np.sin(2.0 * math.pi * (50.0 * time + draw.random()))
    seen = seen + 0.1 * chain.noise * largest * draw.standard_normal(time.size)
    if point in chain.clip:
        seen = np.clip(seen, -chain.clip[point] * largest, chain.clip[point] * largest)
    step = 2.0 * 1.5 * largest / 2**16
    rounded: np.ndarray = np.round(seen / step) * step
    return rounded


def print_table(path: Path, head: Sequence[str], columns: Sequence[np.ndarray], digits: int) -> None:
    """A text table; frequencies and times with all their digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        for row in zip(*columns, strict=True):
            writer.writerow([f"{row[0]:.8g}", *(f"{value:.{digits}g}" for value in row[1:])])
