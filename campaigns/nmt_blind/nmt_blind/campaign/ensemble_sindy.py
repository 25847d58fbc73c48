"""Ensemble SINDy as a baseline: sparse regression of what the modal equation of the model leaves, over bootstraps.

In every locked window the motion of the target mode is synthesised from its harmonics, and
φ_d f - q̈ - 2ζω q̇ - ω² q - (friction of the model) is regressed on a library of terms with sequentially thresholded
least squares (Brunton, Proctor, Kutz, PNAS 113 (2016) 3932); the share of bootstrapped ensembles that keep a term ranks
it (Fasel, Kutz, Brunton, Brunton, Proc. R. Soc. A 478 (2022) 20210904).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import TestKind
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Signals, read_stretches, segments
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_model import build_elements, build_resting_elements, build_structure
from nmt_signals.harmonics import segment_moments, solve_moments

HARMONICS = 7
SAMPLES = 64
ENSEMBLES = 100
THRESHOLD = 0.1
"""Terms whose share of the residual's size is smaller are dropped."""
RIDGE = 0.03
"""On columns of unit norm: terms that look alike share the residual instead of cancelling one another."""
KEPT = 0.5
"""Share of the ensembles that a term must survive in."""


def sparse_terms(model: Path, bags: Sequence[Path], seed: int = 0) -> dict[str, Any]:
    """Terms that sparse regression finds in the locked windows.

    Returns:
        ``terms``, best first, each with effect and share of the ensembles; ``score``, the share of the residual's
        energy that they take; empty where there are too few windows.
    """
    rig = load_rig(model)
    windows = []
    for bag in map(Bag.open, bags):
        locked = [
            segment for segment in segments(bag) if segment.kind is TestKind.PHASE_RESONANCE and not segment.fault
        ]
        # One pass over the bag, however many windows it has.
        stretches = [(segment.first_sample, segment.samples) for segment in locked]
        windows += [_window(signals, rig) for signals in (read_stretches(bag, stretches) if stretches else ())]
    if len(windows) < 3:
        return {}
    residual = [window[0] for window in windows]
    library = [window[1] for window in windows]
    names = list(library[0])
    rows = [np.stack([terms[name] for name in names], axis=1) for terms in library]
    generator = np.random.default_rng(seed)
    counts = np.zeros(len(names))
    for _ in range(ENSEMBLES):
        chosen = generator.integers(len(rows), size=len(rows))
        counts += _thresholded(np.concatenate([rows[i] for i in chosen]), np.concatenate([residual[i] for i in chosen]))
    shares = counts / ENSEMBLES
    a, b = np.concatenate(rows), np.concatenate(residual)
    kept = np.flatnonzero(shares >= KEPT)
    scale: FloatArray = np.asarray(np.linalg.norm(a[:, kept], axis=0) + 1e-300, dtype=np.float64)
    weights = _ridge(a[:, kept] / scale, b)
    fitted = (a[:, kept] / scale) @ weights
    strength = {int(k): abs(float(w)) for k, w in zip(kept, weights, strict=True)}
    order = sorted(strength, key=lambda k: -shares[k] * strength[k])
    return {
        "terms": [{"effect": names[k], "share": round(float(shares[k]), 3)} for k in order],
        "score": float(1.0 - np.sum((b - fitted) ** 2) / max(float(b @ b), 1e-300)),
    }


def _thresholded(a: FloatArray, b: FloatArray) -> FloatArray:
    """Which columns sequentially thresholded least squares keeps, (k,) of 0 and 1."""
    scale = np.linalg.norm(a, axis=0) + 1e-300
    target = float(np.linalg.norm(b)) + 1e-300
    active = np.ones(a.shape[1], dtype=bool)
    for _ in range(10):
        weights = np.zeros(a.shape[1])
        if active.any():
            weights[active] = _ridge(a[:, active] / scale[active], b / target)
        keep = np.abs(weights) > THRESHOLD
        if (keep == active).all():
            break
        active = keep
    return active.astype(np.float64)


def _ridge(a: FloatArray, b: FloatArray) -> FloatArray:
    normal = a.T @ a + RIDGE * np.eye(a.shape[1])
    return np.asarray(np.linalg.solve(normal, a.T @ b), dtype=np.float64)


def _window(signals: Signals | None, rig: Rig) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Residual of the modal equation and library of terms over a period, both relative to the window's q̈."""
    if signals is None:
        raise BenchError("a window without samples")
    force = signals.named(Quantity.FORCE)
    quantity = Quantity[rig.extraction.quantity.upper()]
    motion = signals.named(quantity)
    if signals.oscillator is None or not force or not motion:
        raise BenchError("a window without phase, force or motion")
    data = np.stack([signals.channels[name] for name in (force[0], *motion)])
    bounds = np.array([0, signals.samples], dtype=np.int64)
    harmonics = solve_moments(segment_moments(signals.oscillator, data, HARMONICS, bounds))[0]
    cycles = float(signals.oscillator[-1] - signals.oscillator[0])
    omega = 2.0 * np.pi * cycles / (signals.samples - 1) * signals.sample_rate
    structure = build_structure(rig)
    modes = sticking_modes(structure, build_resting_elements(rig, structure), rig.extraction.linear_modes)
    target = rig.test.mode - 1
    points = [signals.points[name] for name in motion]
    shapes = modes.shapes[[modes.points.index(point) for point in points]]
    response = harmonics[1:]
    orders = np.arange(HARMONICS + 1)
    if quantity is Quantity.ACCELERATION:
        response = response / np.where(orders == 0, np.inf, -((orders * omega) ** 2))
    modal = np.linalg.pinv(shapes) @ response
    angle = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    q, v, acceleration = (_in_time(modal[target] * (1j * orders * omega) ** power, angle) for power in (0, 1, 2))
    drive = modes.shapes[modes.points.index(rig.drive_point), target]
    driving = drive * _in_time(harmonics[0], angle)
    frequency, damping = float(modes.frequencies[target]), float(modes.damping_ratios[target])
    left = driving - acceleration - 2.0 * damping * frequency * v - frequency**2 * q
    for element in build_elements(rig, structure):
        if isinstance(element, Jenkins):
            w = element.direction @ modes.full_shapes @ modal
            motion_in_time = _in_time(w, angle)
            slip = _jenkins(motion_in_time, element) - element.tangential_stiffness * motion_in_time
            left -= float(element.direction @ modes.full_shapes[:, target]) * slip
    size = float(np.sqrt(np.mean(acceleration**2))) + 1e-300
    gap = 0.5 * float(np.abs(q).max())
    terms = {
        "clamp_compliance": q,
        "viscous_damping": v,
        "added_mass": acceleration,
        "force_gain": driving,
        "quadratic_stiffness": q**2,
        "cubic_stiffness": q**3,
        "quintic_stiffness": q**5,
        "air_drag": v * np.abs(v),
        "second_friction_contact": np.sign(v),
        "one_sided_stop": np.maximum(q - gap, 0.0),
        "two_sided_gap": np.maximum(q - gap, 0.0) - np.maximum(-q - gap, 0.0),
    }
    return left / size, {name: term / size for name, term in terms.items()}


def _in_time(harmonics: ComplexArray, angle: FloatArray) -> FloatArray:
    orders = np.arange(harmonics.size)
    result: FloatArray = (harmonics[:, np.newaxis] * np.exp(1j * orders[:, np.newaxis] * angle)).real.sum(axis=0)
    return result


def _jenkins(w: FloatArray, element: Jenkins) -> FloatArray:
    """Force of the element over a period, after one period to forget its start."""
    reach = element.slip_force / element.tangential_stiffness
    slider = 0.0
    force = np.empty_like(w)
    for k, value in enumerate(np.concatenate([w, w])):
        slider = min(max(slider, value - reach), value + reach)
        force[k % w.size] = element.tangential_stiffness * (value - slider)
    return force
