"""Rows of masses that a measured force drives, with a missing force at one place or at two, by average acceleration.

Newmark's rule with the missing forces solved for at the end of each step, in turn, twenty steps to a sample: stiff
friction is as stable as a spring. Nothing here comes from the bench.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numba import njit

Array = np.ndarray
RATE, SECONDS, STEPS = 250.0, 32.0, 20
FRICTION, SLIDER, BACKLASH, DAHL, LUGRE, POWER, CUBE, GAP, STOP, COGGING, STRIBECK, SOFT = range(12)


@njit(cache=True)
def force_of(kind: int, x: float, v: float, a: float, b: float, before: float, step: float) -> tuple[float, float]:
    """Force of a law of unit size and its memory after a step; a, b are its numbers."""
    if kind == FRICTION:
        return math.tanh(v / a), before
    if kind in (SLIDER, BACKLASH):
        anchor = min(max(before, x - a), x + a)
        z = x - anchor
        if kind == SLIDER:
            return z / a, anchor
        return math.copysign(max(abs(z) - b * a, 0.0), z) / (a * (1.0 - b)), anchor
    if kind in (DAHL, LUGRE):
        reach = a if kind == DAHL else a * (0.5 + 0.5 * math.exp(-((v / b) ** 2)))
        z = (before + step * v) / (1.0 + step * abs(v) / reach)
        return z / a, z
    if kind == POWER:
        return math.copysign(abs(v / a) ** b, v), before
    if kind == CUBE:
        return b * (x / a) ** 3, before
    if kind == GAP:
        return math.copysign(max(abs(x) - a, 0.0), x) / (b - a), before
    if kind == STOP:
        return max(x - a, 0.0) / (b - a), before
    if kind == COGGING:
        return math.cos(2.0 * math.pi * (x / a + b)), before
    if kind == STRIBECK:
        return math.tanh(v / a) * (0.5 + 0.5 * math.exp(-((v / b) ** 2))), before
    return v / math.hypot(v, a), before


@njit(cache=True)
def missing_force(
    kinds: Array, numbers: Array, memory: Array, after: Array, x: float, v: float, step: float, here: Array
) -> float:
    """Sum of the laws of one place; numbers are their sizes and two numbers each."""
    total = 0.0
    for k in range(kinds.size):
        if here[k]:
            value, after[k] = force_of(kinds[k], x, v, numbers[k, 1], numbers[k, 2], memory[k], step)
            total += numbers[k, 0] * value
    return total


@njit(cache=True)
def balanced(
    x0: float,
    v0: float,
    compliance: float,
    kinds: Array,
    numbers: Array,
    memory: Array,
    after: Array,
    step: float,
    here: Array,
) -> float:
    """Force g of one place, at which it moves by x₀ and v₀ less what g accelerates it by, ``compliance`` for 1 N."""
    size = numbers[:, 0].sum() + 1e-30
    # Of the residual g − law(x(g), v(g)): it grows with g.
    g, low, high = 0.0, -1e4 * size, 1e4 * size
    below, above = low, high
    for turn in range(200):
        x, v = x0 - 0.25 * step**2 * compliance * g, v0 - 0.5 * step * compliance * g
        law = missing_force(kinds, numbers, memory, after, x, v, step, here)
        if abs(g - law) <= 1e-10 * size:
            break
        if g > law:
            high = g
            above = g - law
        else:
            low = g
            below = g - law
        if turn % 3 == 2 or high - low > 100.0 * size:
            g = law if low < law < high and turn < 2 else 0.5 * (low + high)
        else:
            g = low - below * (high - low) / (above - below)
    return g


@njit(cache=True)
def integrated(
    m: Array, c: Array, k: Array, at: Array, drive: Array, kinds: Array, numbers: Array, owners: Array, step: float,
    every: int,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Displacements, speeds and accelerations (samples, n) and the missing forces (samples, places) at every so many
    steps; ``owners`` are the places of the laws, ``at`` (places, n)."""
    (places, n), count = at.shape, drive.size
    left = np.linalg.inv(m + 0.5 * step * c + 0.25 * step**2 * k)
    pushed = at @ left
    compliance = pushed @ at.T
    q, rate = np.zeros(n), np.zeros(n)
    memory, after = np.zeros(kinds.size), np.zeros(kinds.size)
    first = np.zeros(n)
    first[0] = drive[0]
    acceleration = np.linalg.inv(m) @ first
    samples = (count + every - 1) // every
    found_q, found_v, found_a = np.zeros((samples, n)), np.zeros((samples, n)), np.zeros((samples, n))
    found_g, g = np.zeros((samples, places)), np.zeros(places)
    size = numbers[:, 0].sum() + 1e-30
    for number in range(count):
        if number > 0:
            go_q = q + step * rate + 0.25 * step**2 * acceleration
            go_v = rate + 0.5 * step * acceleration
            right = -(c @ go_v) - k @ go_q
            right[0] += drive[number]
            free = left @ right
            for _ in range(50 if places > 1 else 1):
                moved = 0.0
                for place in range(places):
                    pull = at[place] @ free
                    for other in range(places):
                        if other != place:
                            pull -= compliance[place, other] * g[other]
                    x0 = at[place] @ go_q + 0.25 * step**2 * pull
                    v0 = at[place] @ go_v + 0.5 * step * pull
                    found = balanced(
                        x0, v0, compliance[place, place], kinds, numbers, memory, after, step, owners == place
                    )
                    moved = max(moved, abs(found - g[place]))
                    g[place] = found
                if moved <= 1e-9 * size:
                    break
            acceleration = free - g @ pushed
            q = go_q + 0.25 * step**2 * acceleration
            rate = go_v + 0.5 * step * acceleration
            for i in range(kinds.size):
                memory[i] = after[i]
        if number % every == 0:
            sample = number // every
            found_q[sample], found_v[sample], found_a[sample], found_g[sample] = q, rate, acceleration, g
    return found_q, found_v, found_a, found_g


@dataclass(frozen=True)
class Law:
    """Families and terms: kind, and its two numbers from largest displacement, largest speed and a random number."""

    families: tuple[str, ...]
    terms: tuple[tuple[int, Any], ...]


SLID, DRY, WEAK = "friction of a slider behind a spring", "dry friction", "dry friction that weakens with speed"
PINCHED, DRAG, CLEARANCE = "friction with pinched loops", "damping that grows with speed", "clearance"
ENDS, HARD = "stop on one side", "hardening spring"
LIBRARY = {
    "friction": Law((DRY,), ((FRICTION, lambda a, s, r: (s * (0.003 + 0.017 * r), 0.0)),)),
    "slider": Law((SLID,), ((SLIDER, lambda a, s, r: (a * (0.03 + 0.25 * r), 0.0)),)),
    "backlash": Law((PINCHED,), ((BACKLASH, lambda a, s, r: (a * (0.05 + 0.2 * r), 0.3 + 0.4 * r)),)),
    "dahl": Law((SLID,), ((DAHL, lambda a, s, r: (a * (0.03 + 0.17 * r), 0.0)),)),
    "drag": Law((DRAG,), ((POWER, lambda a, s, r: (s, 2.0)),)),
    "cubic": Law((HARD,), ((CUBE, lambda a, s, r: (a, 1.0)),)),
    "clearance": Law((CLEARANCE,), ((GAP, lambda a, s, r: (a * (0.3 + 0.4 * r), a)),)),
    "stop": Law((ENDS,), ((STOP, lambda a, s, r: (a * (0.2 + 0.4 * r), a)),)),
    "cogging": Law(("cogging",), ((COGGING, lambda a, s, r: (a * (0.2 + 0.8 * r), r)),)),
    "friction and drag": Law(
        (DRY, DRAG), ((FRICTION, lambda a, s, r: (0.01 * s, 0.0)), (POWER, lambda a, s, r: (s, 2.0)))
    ),
    "slider and stop": Law(
        (SLID, ENDS), ((SLIDER, lambda a, s, r: (0.1 * a, 0.0)), (STOP, lambda a, s, r: (0.4 * a, a)))
    ),
}
OUTSIDE = {
    "Stribeck": Law((WEAK,), ((STRIBECK, lambda a, s, r: (0.005 * s, 0.15 * s)),)),
    "LuGre": Law((WEAK,), ((LUGRE, lambda a, s, r: (0.05 * a, 0.2 * s)),)),
    "power of speed": Law((DRAG,), ((POWER, lambda a, s, r: (s, 1.4 + 0.4 * r)),)),
    "softening": Law(("softening spring",), ((CUBE, lambda a, s, r: (a, -0.5)),)),
    "soft friction": Law((DRY,), ((SOFT, lambda a, s, r: (0.02 * s, 0.0)),)),
}


EFFECTS = {
    "friction": ("second_friction_contact",), "slider": ("second_friction_contact", "microslip"),
    "drag": ("air_drag", "power_law_damping"), "cubic": ("cubic_stiffness",), "clearance": ("two_sided_gap",),
    "stop": ("one_sided_stop",),
}  # fmt: skip
"""Laws that the diagnosis has as effects, with their names."""


def make(folder: Path, seed: int, group: str, noise: float = 0.003) -> None:
    """One case: rig file, record, sidecar and truth.

    A pair has two laws of the library at two places, and 1 to 5 % of white noise on every channel.
    """
    random = np.random.default_rng(seed)
    count = max(int(random.integers(1, 5)), 2 if group == "pair" else 1)
    masses = 10.0 ** random.uniform(-0.7, 0.7) * random.uniform(0.6, 1.4, count)
    slowest = 2.0 * math.pi * random.uniform(1.5, 5.0)
    springs = float(masses.mean()) * slowest**2 * random.uniform(2.0, 5.0, count - 1)
    ground = np.zeros(count)
    ground[0] = float(masses.sum()) * slowest**2 * random.uniform(1.0, 2.0)
    dampers = 2.0 * random.uniform(0.01, 0.03) * np.sqrt(springs * masses[: count - 1])
    ground_damper = 2.0 * random.uniform(0.01, 0.04) * math.sqrt(ground[0] * masses.sum())
    place = (int(random.integers(1, count + 1)), 0)
    if count > 1 and random.random() < 0.4:
        lower = int(random.integers(1, count))
        place = (lower + 1, lower)
    bare = random.random() < 0.2 and count > 1
    k, c = (np.zeros((count, count)) for _ in range(2))
    for matrix, between, first in ((k, springs, ground[0]), (c, dampers, ground_damper)):
        matrix[0, 0] += first
        for i, value in enumerate(between):
            matrix[i : i + 2, i : i + 2] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])
    places = [place]
    if group == "pair":
        bare = False
        others = [(p, 0) for p in range(1, count + 1)] + [(p + 1, p) for p in range(1, count)]
        others = [other for other in others if other != place]
        places.append(others[int(random.integers(len(others)))])
        noise = response_noise = float(np.exp(random.uniform(math.log(0.01), math.log(0.05))))
    else:
        response_noise = 3e-4
    at = np.zeros((len(places), count))
    for row, (point, other) in zip(at, places, strict=True):
        row[point - 1] = 1.0
        if other:
            row[other - 1] = -1.0
    time_s = np.arange(int(RATE * SECONDS) * STEPS) / (RATE * STEPS)
    natural = np.sqrt(np.linalg.eigvals(np.linalg.solve(np.diag(masses), k)).real) / (2.0 * math.pi)
    drive = np.zeros_like(time_s)
    for frequency in natural:
        turns = frequency * (random.uniform(0.8, 1.2) * time_s + random.uniform(0.02, 0.1) * np.sin(0.5 * time_s))
        drive += random.uniform(0.5, 1.0) * np.sin(2.0 * math.pi * turns + random.uniform(0.0, 6.3))
    drive *= 10.0 ** random.uniform(-1.0, 1.0) * (0.4 + 0.6 * time_s / SECONDS)
    kinds, numbers = np.zeros(0, np.int64), np.zeros((0, 3))
    families: list[str] = []
    owners = np.zeros(0, np.int64)
    exact, times = (np.diag(masses), c, k, at, drive), (1.0 / (RATE * STEPS), STEPS)
    q, v, acceleration, missing = integrated(*exact, kinds, numbers, owners, *times)
    share, chosen = random.uniform(0.2, 0.8), float(random.random())
    if group != "healthy":
        table = OUTSIDE if group == "outside" else LIBRARY
        names = sorted(table) if group != "pair" else list(EFFECTS)
        laws = [table[names[int(random.integers(len(names)))]] for _ in places]
        families = [family for law in laws for family in law.families]
        terms = [(owner, *term) for owner, law in enumerate(laws) for term in law.terms]
        owners, kinds = np.array([owner for owner, _, _ in terms]), np.array([kind for _, kind, _ in terms])
        # The law changes the motion that its numbers are shares of.
        for _ in range(3):
            a, s = np.abs(q @ at.T).max(axis=0), np.abs(v @ at.T).max(axis=0)
            size = share * float(np.std(drive)) / len(kinds)
            rows = [(size * (2.0 if kind in (POWER, CUBE, GAP, STOP) else 1.0), *term(a[owner], s[owner], chosen))
                    for owner, kind, term in terms]  # fmt: skip
            numbers = np.array(rows, dtype=float)
            q, v, acceleration, missing = integrated(*exact, kinds, numbers, owners, *times)
    force = drive[::STEPS] * (1.0 + 0.004 * random.standard_normal())
    columns: dict[str, Any] = {"f": force + noise * float(np.std(force)) * random.standard_normal(force.size)}
    channels = [("f", "force", "N", 1)]
    quantities = {"displacement": (q, "m"), "acceleration": (acceleration, "m/s^2"), "velocity": (v, "m/s")}
    quantity = ("displacement", "displacement", "acceleration", "velocity")[int(random.integers(4))]
    hidden = place[0] if bare else 0
    for point in range(1, count + 1):
        if point == hidden:
            continue
        values, unit = quantities[quantity]
        values = values[:, point - 1]
        columns[f"y{point}"] = values + response_noise * float(np.std(values)) * random.standard_normal(values.size)
        channels.append((f"y{point}", quantity, unit, point))
    folder.mkdir(parents=True)
    np.savez(folder / "data.npz", **columns)
    off = 1.0 + 0.003 * random.standard_normal(4)
    chain = {
        "kind": "chain", "masses_kg": list(masses * off[0]), "springs_n_m": list(springs * off[1]),
        "dampers_ns_m": list(dampers), "ground_springs_n_m": list(ground * off[2]),
        "ground_dampers_ns_m": [ground_damper, *[0.0] * (count - 1)],
    }  # fmt: skip
    sensors = [{"quantity": what, "point": point} for _, what, _, point in channels[1:]]
    model = {
        "name": "driven", "sample_rate_hz": RATE, "structure": chain, "exciter": {"kind": "force", "point": 1},
        "sensors": [{"quantity": "force", "point": "drive"}, *sensors],
        "extraction": {"quantity": quantity, "linear_modes": 1},
    }  # fmt: skip
    text = yaml.safe_dump(_plain(model))
    (folder / "model.yaml").write_text(text, encoding="utf-8")
    sidecar = {
        "rig": "model.yaml", "sample_rate": RATE, "file": "data.npz",
        "channels": [{"column": c, "quantity": w, "unit": u, "point": p} for c, w, u, p in channels],
        "segments": [{"kind": "record", "start": 0.0, "stop": SECONDS, "held": "force"}],
    }  # fmt: skip
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar), encoding="utf-8")
    np.savez(folder / "truth.npz", x=q @ at[0], v=v @ at[0], missing=missing[:, 0], channel=np.zeros(force.size))
    labels = [f"{point}-{other}" if other else f"{point}" for point, other in places]
    truth = {
        "group": group, "families": families, "seed": seed, "place": labels[0], "places": labels, "bare": bool(hidden),
        "masses": count, "quantity": quantity, "noise": noise,
        "shares": [float(np.std(missing[:, k]) / np.std(drive)) for k in range(len(places))],
    }  # fmt: skip
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth), encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return float(value) if isinstance(value, np.floating) else value
