"""A made-up run with all that a report can show: softening backbone, damping peak, failed level."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import MEASURED, ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_report.run_data import (
    Excerpt,
    FileEntry,
    LevelStart,
    LockMark,
    LoopHistory,
    ReferenceCurve,
    RunReportData,
    SignalEnvelope,
)

SAMPLE_RATE = 10_000.0
BLOCK = 200
OMEGA_LINEAR = 139.42
POINTS = (2, 4, 5, 6)
LINEAR = LinearDescription(
    source="model",
    drive_point=2,
    target_mode=0,
    points=POINTS,
    frequencies_rad_s=(OMEGA_LINEAR, 762.3),
    damping_ratios=(0.0051, 0.035),
    shapes=((0.35, -1.4), (1.05, -1.9), (1.5, -0.9), (1.95, 0.6)),
    drive_point_shape=0.35,
    plant_frequency_rad_s=140.9,
    plant_damping_ratio=0.0089,
    moving_mass_kg=0.043,
)


def omega_of(q: float) -> float:
    return OMEGA_LINEAR * (1.0 - 0.16 / (1.0 + (3e-4 / q) ** 2))


def damping_of(q: float) -> float:
    ratio = q / 3.6e-4
    return 0.0051 + 0.117 * ratio**2 / (1.0 + ratio**2) ** 1.5 * 0.75


def synthetic_run(levels: int = 10, failed: int | None = 6, reference: bool = True, seed: int = 1) -> RunReportData:
    random = np.random.default_rng(seed)
    amplitudes = np.geomspace(0.05, 1.5, levels)
    amounts = np.geomspace(3e-5, 2.4e-3, levels)
    points, excerpts, locks, starts = [], [], [], []
    sample = 10_000
    samples, hertz, phase, state, drive = [], [], [], [], []
    frequency = OMEGA_LINEAR / (2 * math.pi)

    def go(count: int, target: float, kind: int, error: float, amplitude: float) -> None:
        nonlocal sample, frequency
        for _ in range(count):
            sample += BLOCK
            frequency += (target - frequency) * 0.06
            samples.append(sample - 1)
            hertz.append(frequency if amplitude else 0.0)
            phase.append(math.nan if not amplitude else error + (frequency - target) * 0.4 + 1e-4 * random.normal())
            state.append(kind)
            drive.append(amplitude)

    sample = 0
    go(40, frequency, 1, 0.0, 0.0)
    for index, (level, q) in enumerate(zip(amplitudes, amounts, strict=True)):
        omega, damping = omega_of(q), damping_of(q)
        target = omega / (2 * math.pi)
        starts.append(LevelStart(index, float(level), sample))
        common = {"level_index": index, "level": float(level), "level_unit": "V"}
        if index == failed:
            go(300, target * 1.01, 2, 0.3, level)
            go(120, target * 1.01, 4, math.nan, level * 0.1)
            points.append(
                ModalPoint(
                    **common,
                    status=PointStatus.NOT_LOCKED,
                    reason="phase error stayed at 17° until the time-out of 11 s",
                )
            )
            continue
        go(180, target, 2, 0.02 / (index + 1), level)
        periods = 200
        window = round(periods / target * SAMPLE_RATE)
        locks.append(LockMark(index, float(level), "V", sample, target, sample + BLOCK, window, periods))
        go(-(-window // BLOCK) + 2, target, 3, 0.0, level)
        points.append(
            ModalPoint(
                **common,
                **_point(index, q, omega, damping, random),
                status=PointStatus.OK,
                reason="",
                window_first_sample=sample,
                window_samples=window,
                window_periods=periods,
            )
        )
        time = np.arange(round(3 * SAMPLE_RATE / target)) / SAMPLE_RATE
        force = 2.2 * level * (np.cos(omega * time) + 0.03 * np.cos(3 * omega * time + 1.0))
        response = 0.35 * q * np.sin(omega * time)
        excerpts.append(Excerpt(index, float(level), "V", target, SAMPLE_RATE, force, response, "$x_2$", "m"))
    go(60, frequency, 1, math.nan, 0.0)
    history = LoopHistory(np.array(samples), np.array(hertz), np.array(phase), np.array(state), np.array(drive))
    centre = history.sample.astype(float) - BLOCK / 2
    envelopes = [
        SignalEnvelope(name, symbol, unit, centre, -factor * history.drive_amplitude, factor * history.drive_amplitude)
        for name, symbol, unit, factor in (("u", "$u$", "V", 1.0), ("f2", "$F$", "N", 2.2), ("x2", "$x_2$", "m", 4e-4))
    ]
    curve = np.geomspace(1e-5, 5e-3, 120)
    return RunReportData(
        points=points,
        sample_rate=SAMPLE_RATE,
        run={
            "run_id": "2026-11-20T12-00-00_beam",
            "rig": "beam",
            "seed": 1,
            "started": "2026-11-20T12:00:00+00:00",
            "plan": {"control": "voltage", "levels": amplitudes.tolist(), "window_periods": 200},
            "versions": {"nmt": "0.1.0", "python": "3.11.2", "ros": "jazzy"},
            "extraction": {"harmonics": 10},
            "parameters": {"pll": {"lock_tolerance_deg": 1.0}},
        },
        rig={
            "name": "beam",
            "description": "Cantilever beam with a friction joint, virtual experiment of Scheel et al. 2018",
            "assumptions": [
                "The cross-section is not in the paper; 11.56978 mm × 5.27668 mm reproduces its three frequencies.",
                "Damping is proportional to the beam's stiffness alone, β = 1e-4 s.",
                "The phase-locked loop's block diagram is missing in the paper; an adaptive filter is used.",
            ],
        },
        stop={"exit": {"state": "done", "reason": "every level was worked through"}, "counts": {"force": len(samples)}},
        linear=LINEAR,
        history=history,
        envelopes=envelopes,
        excerpts=excerpts,
        levels=starts,
        locks=locks,
        reference=ReferenceCurve(
            "EPMC reference", curve, np.array([omega_of(q) for q in curve]), np.array([damping_of(q) for q in curve])
        )
        if reference
        else None,
        files=[FileEntry("bag/bag_0.mcap", 123_456_789, "ab" * 32), FileEntry("modal.csv", 4_321, "0c" * 32)],
        end_sample=sample,
    )


def _values(value: float) -> dict[str, float]:
    return {key: value for name in MEASURED for key in (name, f"{name}_std")}


def _point(index: int, q: float, omega: float, damping: float, random: np.random.Generator) -> dict[str, object]:
    force = 2.2 * 0.05 * 1.45**index
    measured = omega * (1 + 3e-5 * random.normal())
    values = _values(math.nan)
    main = {
        "frequency_hz": (measured / (2 * math.pi), 2e-4),
        "omega_rad_s": (measured, 1.2e-3),
        "damping_ratio": (damping * (1 + 0.006 * random.normal()), damping * 0.006),
        "modal_amplitude": (q, q * 3e-4),
        "self_excitation": (2 * omega * damping, 0.01),
        "force_n": (force, force * 1e-4),
        "active_power": (0.1 * force, 1e-4),
        "apparent_power": (0.1 * force, 1e-4),
        "pbmif": (1.0 - 0.002 * (index + 1), 2e-4),
        "gamma_force": (1.0 - 0.001 * index**1.5, 1e-4),
        "gamma_acceleration": (1.0 - 0.0004 * index, 1e-4),
        "mac": (1.0 - 1e-4 * index, 1e-5),
        "phase_error": (1e-4, 5e-5),
    }
    for name, (value, std) in main.items():
        values[name], values[f"{name}_std"] = value, std
    decay = 10.0 ** -np.arange(11) * np.array([0, *([1.0, 0.02] * 5)])
    shape = np.array([0.35, 1.05, 1.5, 1.95]) * (1 - 0.01 * index) * np.exp(1j * 0.004 * index * np.arange(4))
    return values | {
        "harmonics": 10,
        "points": POINTS,
        "force_harmonics": force * (decay * (2 + index) + 1e-6) * 10 + 0j,
        "shape_harmonics": np.outer(decay * 10 + 1e-7, q * shape) * -1j,
        "normalised_shape": shape * -1j,
        "participation": np.array([1.0, 0.01 * (index + 1) * np.exp(1j)]) * -1j,
    }
