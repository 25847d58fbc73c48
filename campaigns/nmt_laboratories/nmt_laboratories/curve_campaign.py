"""Measures response curves on several rigs and compares them with :mod:`nmt_laboratories.forced_balance`.

Run in ``./nmt shell``::

    python -m nmt_laboratories.curve_campaign --out curves [CASE …]

A case that is measured already is compared anew and not measured again. Every point is compared with the balance at
the measured lag and with the measured harmonics of the force; folds with those of the balance; the stability with the
direction in which the balance's frequency goes.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.response_curve import PlaceKind, ResponseCurve, response_curves
from nmt_extract.modal.table import write_results
from nmt_laboratories.campaign_frame import command_parser
from nmt_laboratories.epmc_by_receptance import coulomb_force
from nmt_laboratories.forced_balance import OneElement, cantilever, chain_of_one, cubic, of_modes, stops
from nmt_session import Session, plan_test

_DAMPING = 2.5298221281347035
_MODES = 2.0 * math.pi * np.array([20.0, 61.2, 160.0])
_SHAPES = np.array([[0.3, 0.6, 1.0], [0.7, 0.5, -0.9], [0.9, -0.6, 0.8]])
_NOISE = ("sensors.0.noise_psd=2.0e-9", "sensors.1.noise_psd=4.5e-16")


@dataclass(frozen=True)
class Case:
    """A test and its balance.

    Attributes:
        rig: rig that comes with the bench.
        balance: what it is compared with.
        forces: N.
        changes: of the rig file.
        settings: of the test.
    """

    rig: str
    balance: OneElement
    forces: tuple[float, ...]
    changes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)


def _three(ratio: float) -> OneElement:
    return of_modes(_MODES, [ratio] * 3, _SHAPES[:, 2], _SHAPES[:, 1], cubic(1.0e8), samples=256)


def _joint(w: np.ndarray, v: np.ndarray) -> np.ndarray:
    return coulomb_force(w, 8000.0, 1.0)


_STRONG = chain_of_one(16000.0, _DAMPING, cubic(1.6e10), samples=128)
_BEAM = cantilever(
    7, 0.7, 0.00527668, 0.01156978, 185.0e9, 7830.0, 1.0e-4, 3, 2, _joint, highest=11, samples=1024
)  # fmt: skip
_QUICK = {"window_periods": 16, "ramp": 0.3}
_FLOQUET = {"window_periods": 40, "ramp": 0.3, "spacing": 0.7, "floquet": True}
_BLOCK = "block_samples=25"
_STOPS = ("local_elements=[{name: stops, kind: two_sided_gap, point: 1, stiffness_n_m: 8000.0, gap_m: 0.3e-3}]",)
CASES = {
    "hardening": Case("strong_cubic", _STRONG, (0.16, 0.48, 1.6), settings={**_QUICK, "lag_deg": (12.0, 177.0)}),
    "softening cubic": Case(
        "strong_cubic", chain_of_one(16000.0, _DAMPING, cubic(-4.0e9), samples=128), (0.08, 0.24),
        ("local_elements.0.stiffness_n_m3=-4.0e9",), {**_QUICK, "lag_deg": (12.0, 168.0)},
    ),
    "clearance": Case(
        "strong_cubic", chain_of_one(16000.0, _DAMPING, stops(8000.0, 0.3e-3), highest=25), (0.08, 0.32),
        _STOPS,
        {**_QUICK, "lag_deg": (12.0, 168.0)},
    ),
    "friction": Case(
        "beam", _BEAM, (0.3, 1.0), settings={**_QUICK, "lag_deg": (20.0, 160.0), "harmonics_control": "auto"},
    ),
    "internal 1 %": Case("internal_resonance", _three(0.01), (0.3, 1.2), settings={**_QUICK, "lag_deg": (15.0, 165.0)}),
    "internal 0.5 %": Case(
        "internal_resonance", _three(0.005), (0.15, 0.6), ("structure.damping_factors=[0.5,0.5,0.5]",),
        {**_QUICK, "lag_deg": (15.0, 165.0)},
    ),
    "internal 0.2 %": Case(
        "internal_resonance", _three(0.002), (0.06, 0.24), ("structure.damping_factors=[0.2,0.2,0.2]",),
        {**_QUICK, "lag_deg": (15.0, 165.0)},
    ),
    "latency 0": Case("strong_cubic", _STRONG, (0.32,), (_BLOCK,), {**_QUICK, "lag_deg": (20.0, 168.0)}),
    "latency 1": Case(
        "strong_cubic", _STRONG, (0.32,), (_BLOCK,), {**_QUICK, "lag_deg": (20.0, 168.0), "latency_blocks": 1}
    ),
    "latency 3": Case(
        "strong_cubic", _STRONG, (0.32,), (_BLOCK,), {**_QUICK, "lag_deg": (20.0, 168.0), "latency_blocks": 3}
    ),
    "exponents, hardening": Case(
        "strong_cubic", _STRONG, (0.32,),
        settings={**_FLOQUET, "lag_deg": (50.0, 160.0)},
    ),
    "exponents, clearance": Case(
        "strong_cubic", chain_of_one(16000.0, _DAMPING, stops(8000.0, 0.3e-3), highest=25), (0.32,), _STOPS,
        {**_FLOQUET, "lag_deg": (50.0, 150.0)},
    ),
    "exponents, internal": Case(
        "internal_resonance", _three(0.01), (1.2,), settings={**_FLOQUET, "lag_deg": (50.0, 140.0)}
    ),
    "exponents, noise": Case(
        "strong_cubic", _STRONG, (0.32,), _NOISE, {**_FLOQUET, "lag_deg": (50.0, 160.0), "perturbation": 0.03}
    ),
    "noise": Case("strong_cubic", _STRONG, (0.32,), _NOISE, {**_QUICK, "window_periods": 40, "lag_deg": (20.0, 168.0)}),
    "friction, noise": Case(
        "beam", _BEAM, (1.0,), _NOISE, {**_QUICK, "lag_deg": (20.0, 160.0), "harmonics_control": "auto"}
    ),
}  # fmt: skip


def measure(name: str, folder: Path) -> dict[str, Any]:
    """Runs a case, unless it has been run; what ``measured.json`` has."""
    kept = folder / "measured.json"
    if kept.exists():
        found: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    case = CASES[name]
    plan = plan_test(case.rig, case.forces, overrides=case.changes, test="response_curve", **case.settings)
    begins: dict[int, int] = {}
    began = time.process_time()

    def listen(topic: str, record: Any) -> None:
        if topic == "level" and record.amplitude > 0.0:
            begins[record.index] = record.apply_at_sample

    with Session(plan, folder, listener=listen) as session:
        result = session.run()
    write_results(result.points, folder)
    rate = float(plan.rig.sample_rate_hz)
    points = [point for point in result.points if point.status is PointStatus.OK]
    found = {
        "message": result.message, "bench_s": result.bench_time, "cpu_s": time.process_time() - began,
        "lost": [
            [p.level, math.degrees(p.held_phase) + 90.0, p.reason]
            for p in result.points if p.status is not PointStatus.OK
        ],
        "periods": [
            (p.window_first_sample + p.window_samples - begins[p.level_index]) / rate * p.frequency_hz for p in points
        ],
        "harmonics": [[[f.real, f.imag] for f in p.force_harmonics.tolist()] for p in points],
        "held": [[p.level, p.held_phase] for p in points],
    }  # fmt: skip
    curves = response_curves(result.points)
    found["curves"] = [_plain(curve) for curve in curves]
    kept.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


def _plain(curve: ResponseCurve) -> dict[str, Any]:
    names = ("lag", "lag_std", "frequency_hz", "frequency_hz_std", "response", "response_std", "force", "stable")
    found: dict[str, Any] = {name: getattr(curve, name).tolist() for name in names} | {"level": curve.level}
    found["exponents"] = [
        [[p.floquet_growth, p.floquet_growth_std], [p.floquet_second_growth, p.floquet_second_growth_std],
         [p.floquet_frequency, p.floquet_frequency_std]]
        for p in curve.points
    ]  # fmt: skip
    found["harmonics"] = [[[f.real, f.imag] for f in point.force_harmonics.tolist()] for point in curve.points]
    places = [*curve.folds, *([curve.tip] if curve.tip else [])]
    found["places"] = [
        {"place": p.place.value, "lag": p.lag, "lag_std": p.lag_std, "frequency_hz": p.frequency_hz,
         "frequency_hz_std": p.frequency_hz_std, "response": p.response, "response_std": p.response_std}
        for p in places
    ]  # fmt: skip
    return found


def _forces(balance: OneElement, harmonics: Sequence[Sequence[float]]) -> np.ndarray:
    """F_n of the odd orders with the phase of F₁ at zero, N."""
    measured = np.array([complex(*value) for value in harmonics])
    turn = np.exp(-1j * np.angle(measured[1]))
    found = np.zeros(balance.orders.size, complex)
    for k, order in enumerate(balance.orders):
        if order < measured.size:
            found[k] = measured[order] * turn**order
    return found


def compare(name: str, curve: dict[str, Any]) -> dict[str, Any]:
    """Largest errors of one curve."""
    balance, lag = CASES[name].balance, np.array(curve["lag"])
    errors, sigmas, wrong, unstable, missing = [], [], 0, 0, 0
    folds = [place for place in curve["places"] if place["place"] == PlaceKind.FOLD.value]
    for k, place in enumerate(lag):
        force = _forces(balance, curve["harmonics"][k])
        hertz, response = curve["frequency_hz"][k], curve["response"][k]
        try:
            orbit = balance.at_lag(place, force, 2.0 * math.pi * hertz, response * np.exp(-1j * place))
            slope = balance.slope(orbit, place, force)
        except (ArithmeticError, np.linalg.LinAlgError):
            missing += 1
            continue
        errors.append([hertz * 2.0 * math.pi / orbit.omega - 1.0, response / orbit.response - 1.0])
        stds = curve["frequency_hz_std"][k] / hertz, curve["response_std"][k] / response
        sigmas.append([abs(e) / max(s, 1e-12) for e, s in zip(errors[-1], stds, strict=True)])
        stable = curve["stable"][k]
        unstable += int(slope < 0.0)
        far = all(abs(place - fold["lag"]) > 2.0 * math.hypot(fold["lag_std"], curve["lag_std"][k]) for fold in folds)
        wrong += int(far and not math.isnan(stable) and (stable == 1.0) != (slope > 0.0))
    pure = np.zeros(balance.orders.size, complex)
    pure[0] = curve["level"]
    turns = []
    for number, fold in enumerate(sorted(folds, key=lambda item: item["lag"])):
        sign = _turn(lag, np.array(curve["frequency_hz"]), fold["lag"])
        try:
            at, orbit = balance.fold(fold["lag"], pure, 2.0 * math.pi * fold["frequency_hz"], fold["response"], sign)
        except ArithmeticError:
            continue
        turns.append(
            {"number": number, "lag": at, "frequency": fold["frequency_hz"] * 2.0 * math.pi / orbit.omega - 1.0,
             "sigmas": abs(fold["frequency_hz"] - orbit.omega / 2.0 / math.pi) / max(fold["frequency_hz_std"], 1e-12)}
        )  # fmt: skip
    table = np.abs(np.array(errors)) if errors else np.full((1, 2), math.nan)
    return {
        "points": lag.size, "unstable": unstable, "missing": missing, "wrong": wrong,
        "frequency": float(table[:, 0].max()), "response": float(table[:, 1].max()),
        "sigmas": float(np.max(sigmas)) if sigmas else math.nan,
        "last": math.degrees(lag.max()), "first": math.degrees(lag.min()), "folds": turns,
    }  # fmt: skip


def exponents(name: str, curve: dict[str, Any]) -> list[str]:
    """Measured and computed exponents of each point, a row each; nothing where they were not measured."""
    balance, rows = CASES[name].balance, []
    for k, measured in enumerate(curve.get("exponents", ())):
        if math.isnan(measured[0][0]):
            continue
        lag, force = curve["lag"][k], _forces(balance, curve["harmonics"][k])
        motion = curve["response"][k] * np.exp(-1j * lag)
        orbit = balance.at_lag(lag, force, 2.0 * math.pi * curve["frequency_hz"][k], motion)
        near = np.array(measured)[:, 0]
        every = balance.exponents(orbit)
        own = every[np.argsort(np.abs(every.real - near[0]) + np.abs(np.abs(every.imag) - near[2]))[0]]
        others = every[every != own]
        other = others[np.argsort(np.abs(others.real - near[1]) + np.abs(np.abs(others.imag) - near[2]))[0]]
        expected = (own.real, other.real, abs(own.imag))
        worst = [
            min(abs(value - true) / abs(own), abs(value - true) / (20.0 * std) if std else math.inf)
            for (value, std), true in zip(measured, expected, strict=True)
        ]
        words = ", ".join(
            f"{value:.3f} ± {std:.3f} ({true:.3f})" for (value, std), true in zip(measured, expected, strict=True)
        )
        rows.append(f"    {math.degrees(lag):.1f}°: {words} {'within' if max(worst) <= 0.1 else 'OUTSIDE'}")
    return rows


def _turn(lag: np.ndarray, frequency: np.ndarray, place: float) -> float:
    """1 where the measured frequency has a maximum near a lag, −1 at a minimum."""
    near = np.argsort(np.abs(lag - place))[:4]
    return float(-np.sign(np.polyfit(lag[near] - place, frequency[near], 2)[0]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures and prints one row for each curve."""
    parser = command_parser(__doc__)
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}")
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args(arguments)
    print(
        "| case | force / N | points | unstable | lags | frequency | response | folds | σ | stability wrong | periods |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name in chosen.cases or CASES:
        measured = measure(name, chosen.out / name.replace(" ", "_").replace("%", "percent").replace(",", ""))
        levels = np.array([held[0] for held in measured["held"]])
        for curve in measured["curves"]:
            row = compare(name, curve)
            folds = ", ".join(f"{fold['frequency']:.1e}" for fold in row["folds"]) or "none"
            periods = float(np.median(np.array(measured["periods"])[levels == curve["level"]]))
            print(
                f"| {name} | {curve['level']:g} | {row['points']} | {row['unstable']} | {row['first']:.0f}-"
                f"{row['last']:.0f} | {row['frequency']:.1e} | {row['response']:.1e} | {folds} | {row['sigmas']:.1f} | "
                f"{row['wrong']}{' (' + str(row['missing']) + ' missing)' if row['missing'] else ''} | {periods:.0f} |",
                flush=True,
            )
            print("\n".join(exponents(name, curve)), flush=True)
        for level, lag, reason in measured["lost"]:
            print(f"    {name}, {level:g} N, {lag:.1f}°: {reason}", flush=True)


if __name__ == "__main__":
    main()
