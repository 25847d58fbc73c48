"""Predictions of a subspace model and of the diagnosis' model from one recording, for the study of identification."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import resample_poly

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import read_signals, segments
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import assemble, displacement_output
from nmt_rig.model.time_integration import IntegrationError, TimeIntegrator
from nmt_rig.reference import compute_reference
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_model import build_elements, build_structure
from nmt_study.case import StudyCase
from nmt_study.case_reference import case_rig
from nmt_study.nonlinear_subspace import (
    AMPLITUDES,
    ORDERS,
    POWERS,
    SAMPLE_RATE,
    SWEEP_HZ,
    PolynomialStateSpace,
    Recording,
    identify,
)  # fmt: skip

_HARMONICS = 9
_AMPLITUDES = 14
_KEPT = 0.8  # share of each recording that the subspace method is fitted to; the rest chooses its order


def predictions(case: StudyCase, bag: Path, model_overrides: Sequence[str], point: int, folder: Path) -> dict[str, Any]:
    """Identify both ways and predict.

    Args:
        case: the test with random excitation.
        bag: its recording.
        model_overrides: of the rig, for the model that the diagnosis begins with.
        point: of the nonlinear force.
        folder: for the recording of the sweep.

    Returns:
        ``reference`` (EPMC of the tested rig), ``methods`` (modal_amplitude, omega_rad_s, damping_ratio, sweep_error)
        and ``told``, the verdict of the diagnosis and the order of the subspace model; no ``levels``.
    """
    rig = case_rig(case)
    linear = linear_description(rig)
    grid = np.geomspace(*AMPLITUDES, _AMPLITUDES)
    wide = np.geomspace(0.7 * grid[0], 1.5 * grid[-1], 60)
    training = _windows(bag)
    sweep_force, sweep_motion, rate = _sweep(case, rig, folder)
    subspace, order = _identified(training, linear, point)
    outcome = diagnose_bags(
        load_rig(case.rig, [*model_overrides, f"exciter.point={case.exciter}"]), [bag], (),
        DiagnosisSettings(look_ahead=False),
    )  # fmt: skip
    methods = {
        "subspace": {
            **_subspace_backbone(subspace, linear, point, grid),
            "sweep_error": _subspace_sweep(subspace, linear, sweep_force, sweep_motion, rate),
        },
        "diagnosis": {
            **_backbone(outcome.model, grid),
            "sweep_error": _sweep_error(simulated(outcome.model, sweep_force), sweep_motion[_drive(linear)]),
        },
    }
    verdict = outcome.diagnosis.verdict.value
    named = f" ({outcome.diagnosis.ranking[0].effect})" if verdict == "effect" else ""
    return {
        "levels": [],
        "reference": _backbone(rig, wide),
        "methods": methods,
        "told": f"the diagnosis says {verdict}{named}; the subspace model has {order} states.",
    }


def _drive(linear: LinearDescription) -> int:
    return linear.points.index(linear.drive_point)


def _windows(bag: Path) -> list[Any]:
    """Signals of the windows of a run."""
    recorded = Bag.open(bag)
    found = [read_signals(recorded, segment.first_sample, segment.samples) for segment in segments(recorded)]
    if not found:
        raise BenchError(f"The bag {bag} has no window of random excitation.")
    return found


def _arrays(signals: Any, points: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Force (n,) and displacements (points, n)."""
    force = next(name for name, what in signals.quantities.items() if what is Quantity.FORCE)
    rows = []
    for point in points:
        rows.append(
            next(
                signals.channels[name]
                for name, what in signals.quantities.items()
                if what is Quantity.DISPLACEMENT and signals.points[name] == point
            )
        )
    return signals.channels[force], np.array(rows)


def _slower(values: FloatArray, rate: float) -> FloatArray:
    """Samples at the rate of the identification."""
    return np.asarray(resample_poly(values, 1, round(rate / SAMPLE_RATE), axis=-1))


def _identified(training: Sequence[Any], linear: LinearDescription, point: int) -> tuple[PolynomialStateSpace, int]:
    """The subspace model whose order predicts the ends of the recordings best, and that order."""
    place = np.array([1.0 if own == point else 0.0 for own in linear.points])
    first, last = [], []
    for signals in training:
        force, motion = _arrays(signals, linear.points)
        force, motion = (_slower(values, signals.sample_rate) for values in (force, motion))
        cut = round(_KEPT * force.size)
        first.append(Recording(force[:cut], motion[:, :cut]))
        last.append(Recording(force, motion))
    best: tuple[float, PolynomialStateSpace, int] | None = None
    for order in ORDERS:
        try:
            model = identify(first, place, POWERS, order, SAMPLE_RATE)
        except (BenchError, np.linalg.LinAlgError):
            continue
        off = 0.0
        for part, whole in zip(first, last, strict=True):
            predicted, cut = model.simulate(whole.force), part.force.size
            scale = float(np.sqrt(np.mean(whole.outputs[:, cut:] ** 2)))
            off += float(np.sqrt(np.mean((predicted - whole.outputs)[:, cut:] ** 2))) / scale
        if math.isfinite(off) and (best is None or off < best[0]):
            best = off, model, order
    if best is None:
        raise BenchError("No subspace model stays bounded on the recordings; choose a lower order or fewer powers.")
    return best[1], best[2]


def _subspace_backbone(
    model: PolynomialStateSpace, linear: LinearDescription, point: int, grid: FloatArray
) -> dict[str, list[float]]:
    shapes = np.array(linear.shapes)
    target = shapes[:, linear.target_mode]
    amplitudes = grid * abs(target[linear.points.index(point)])
    drive = _drive(linear)
    found = model.phase_resonance(amplitudes, drive, linear.frequencies_rad_s[linear.target_mode], _HARMONICS)
    count = len(target)
    omega, force = found[:, 0], found[:, 1]
    motion = found[:, 2 : 2 + count] + 1j * found[:, 2 + count :]
    q = np.sqrt(np.sum(np.abs(motion @ np.linalg.pinv(shapes).T) ** 2, axis=1))
    # Power of the force = that of the modal damping, δ̃ ω̃³ q².
    damping = np.abs(force * motion[:, drive]) / (2.0 * omega**2 * q**2)
    return {"modal_amplitude": q.tolist(), "omega_rad_s": omega.tolist(), "damping_ratio": damping.tolist()}


def _backbone(rig: Rig, amplitudes: FloatArray) -> dict[str, list[float]]:
    reference = compute_reference(rig, _HARMONICS, amplitudes)
    return {
        "modal_amplitude": amplitudes.tolist(),
        "omega_rad_s": reference.omega_rad_s.tolist(),
        "damping_ratio": reference.damping_ratio.tolist(),
    }


def _sweep(case: StudyCase, rig: Rig, folder: Path) -> tuple[FloatArray, FloatArray, float]:
    """Force, displacements and sample rate of a sweep at a level between those of the case, from rest on."""
    from nmt_session import Session, plan_test

    level = math.sqrt(case.levels[0] * case.levels[-1])
    plan = plan_test(
        case.rig, [level], overrides=case.overrides, exciter=case.exciter, seed=case.seed + 100, test="sweep",
        frequencies_hz=[SWEEP_HZ[0]], frequency_end_hz=SWEEP_HZ[1], rate_hz_s=1.0, run_id="sweep",
    )  # fmt: skip
    with Session(plan, folder) as session:
        result = session.run()
    if result.bag is None:
        raise BenchError(f"The sweep was not recorded: {result.message}")
    recorded = Bag.open(result.bag)
    (window,) = segments(recorded)
    signals = read_signals(recorded, 0, window.end_sample)
    force, motion = _arrays(signals, linear_description(rig).points)
    return force, motion, signals.sample_rate


def _subspace_sweep(
    model: PolynomialStateSpace, linear: LinearDescription, force: FloatArray, motion: FloatArray, rate: float
) -> float:
    predicted = model.simulate(_slower(force, rate))
    return _sweep_error(predicted[_drive(linear)], _slower(motion[_drive(linear)], rate))


def simulated(rig: Rig, force: FloatArray) -> FloatArray:
    """Displacement (n,) of the drive point of a rig's structure under a recorded force (n,), from rest."""
    structure = build_structure(rig)
    system = assemble(structure, build_elements(rig, structure), rig.drive_point)
    integrator = TimeIntegrator(system, rig.sample_rate_hz, [displacement_output(system, rig.drive_point)])
    try:
        return np.asarray(integrator.advance(np.append(force, force[-1]))[0])
    except IntegrationError:
        return np.full(force.size, math.nan)


def _sweep_error(predicted: FloatArray, recorded: FloatArray) -> float:
    return float(np.sqrt(np.mean((predicted - recorded) ** 2) / np.mean(recorded**2)))
