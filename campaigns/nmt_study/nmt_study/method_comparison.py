"""Phase resonance compared with other methods on the joint resonator: ring-down, sweeps, stepped sines."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.quantity_format import plain, significant
from nmt_report.svg import INK, ReportFigure
from nmt_study.case import StudyCase
from nmt_study.study import Finding, Result, StudyOutput, StudyTable
from nmt_study.study_figures import COLOURS, MARKERS, percent
from nmt_study.study_table import at_amplitude, level_rows

TITLE = "Comparison of methods on the joint resonator"

RIG = "joint_resonator"
LINEAR_HZ = 370.0
DRIVE_SHAPE = 0.462
"""Target mode at the drive point, 1/√kg."""
NOISE = (1, 10, 100)
"""Factors on the standard deviation of the rig's sensor noise."""
RANGE = (45.0, 1700.0)
"""Modal accelerations ω̃²q that count, (m/s²)√kg; all methods reach them."""
RING_DOWN_VOLTS = 25.0
SWEEP_RATE = 0.2

METHODS: dict[str, str] = {
    "phase_resonance": "phase resonance",
    "long_windows": "phase resonance, windows of 400 periods",
    "paper": "phase resonance, paper's loop, 25 s a level",
    "ring_down": "one ring-down, force recorded",
    "ring_downs": "8 ring-downs, force recorded",
    "apparent": "8 ring-downs, no force (structure + exciter)",
    "sweeps": "force-controlled sweeps, single-mode fit",
    "half_power": "the same sweeps, half-power bandwidth",
    "stepped": "stepped sine, held force, single-mode fit",
    "held_response": "stepped sine, held response, single-mode fit",
}
WRONG_BY_CONSTRUCTION = ("apparent", "half_power")

_EXPECTED = np.array(
    [
        (42.0, 369.97, 0.106),
        (109.0, 369.93, 0.110),
        (215.0, 369.85, 0.119),
        (302.0, 369.80, 0.125),
        (425.0, 369.68, 0.158),
        (595.0, 369.31, 0.236),
        (833.0, 368.69, 0.337),
        (1165.0, 367.82, 0.453),
        (1626.0, 366.74, 0.560),
        (2268.0, 365.46, 0.683),
    ]
)
"""Modal acceleration, frequency (Hz), damping (%): what the other methods' frequencies and forces are chosen from."""
_FORCE_OFFSETS = (-1.5, -1.0, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.0, 1.5)
_RESPONSE_OFFSETS = (-1.0, -0.5, 0.0, 0.5, 1.0)


def cases(quick: bool) -> list[StudyCase]:
    """Five tests at three noise levels with several seeds, and the paper's 25 s a level; few and short if quick."""
    chosen = []
    for factor in (1,) if quick else NOISE:
        for seed in (1,) if quick else (1, 2, 3):
            for make in (_phase_resonance, _long_windows, _ring_downs, _sweeps, _stepped, _held_response):
                if (make is _sweeps and seed == 3) or (make is _long_windows and quick):
                    continue
                chosen.append(make(factor, seed, quick))
        if not quick:
            chosen.append(_paper(factor))
    return chosen


def _case(method: str, title: str, factor: int, seed: int, **values: Any) -> StudyCase:
    noise = (
        ()
        if factor == 1
        else (
            f"sensors.0.noise_psd={2.5e-9 * factor**2:.6g}",
            *(f"sensors.{k}.noise_psd={4.0e-8 * factor**2:.6g}" for k in (1, 2, 3)),
        )
    )
    return StudyCase(
        name=f"{method}_noise{factor}_seed{seed}",
        title=title + ("" if factor == 1 else f", noise x {factor}") + f", seed {seed}",
        rig=RIG,
        exciter=1,
        overrides=noise,
        seed=seed,
        harmonics=7,
        labels={"method": method, "noise": factor, "seed": seed},
        **values,
    )


def _phase_resonance(
    factor: int, seed: int, quick: bool, method: str = "phase_resonance", periods: int = 80
) -> StudyCase:
    volts = np.geomspace(0.25, 18.0, 4 if quick else 16)
    return _case(
        method, METHODS[method], factor, seed,
        levels=_rounded(volts), window_periods=periods, ramp=0.2, timeout=25.0, loop_values={"dwell_periods": 40.0},
    )  # fmt: skip


def _long_windows(factor: int, seed: int, quick: bool) -> StudyCase:
    return _phase_resonance(factor, seed, quick, "long_windows", 400)


def _paper(factor: int) -> StudyCase:
    loop = {"paper_gain": 20.0 * math.pi, "paper_waiting_time": 24.8}
    return _case(
        "paper", METHODS["paper"], factor, 1,
        levels=_rounded(np.geomspace(0.25, 18.0, 16)), window_periods=80, ramp=0.2, timeout=40.0, loop="paper",
        loop_values=loop,
    )  # fmt: skip


def _ring_downs(factor: int, seed: int, quick: bool) -> StudyCase:
    return _case(
        "ring_downs", "ring-downs", factor, seed,
        levels=(RING_DOWN_VOLTS,) * (2 if quick else 8), test="ring_down", duration=0.6, window_periods=80, ramp=0.2,
        timeout=25.0, loop_values={"dwell_periods": 40.0},
    )  # fmt: skip


def _forces() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ten forces (N), resonances (Hz) and damping ratios whose peaks are evenly spread over the amplitudes."""
    acceleration = np.geomspace(42.0, 2100.0, 10)
    frequency, damping = expected(acceleration)
    return 2.0 * damping * acceleration / DRIVE_SHAPE, frequency, damping


def _sweeps(factor: int, seed: int, quick: bool) -> StudyCase:
    force, frequency, damping = _forces()
    keep = slice(6, 8) if quick else slice(None)
    return _case(
        "sweeps", "sweeps", factor, seed,
        levels=_rounded(force[keep]), control="force", test="sweep",
        frequencies_hz=_rounded((frequency * (1.0 - 2.0 * damping))[keep], 7), frequency_end_hz=371.5,
        rate_hz_s=2.0 if quick else SWEEP_RATE, ramp=0.2,
    )  # fmt: skip


def _stepped(factor: int, seed: int, quick: bool) -> StudyCase:
    force, frequency, damping = _forces()
    levels, places = [], []
    for k in (6, 7) if quick else range(10):
        for offset in _FORCE_OFFSETS[1:-1:2] if quick else _FORCE_OFFSETS:
            levels.append(force[k])
            places.append(frequency[k] * (1.0 + offset * damping[k]))
    return _case(
        "stepped", "stepped sine, held force", factor, seed,
        levels=_rounded(levels), control="force", test="stepped_sine", frequencies_hz=_rounded(places, 7),
        window_periods=80, ramp=0.2,
    )  # fmt: skip


def _held_response(factor: int, seed: int, quick: bool) -> StudyCase:
    levels, places = [], []
    for acceleration in np.geomspace(300.0, 1200.0, 2) if quick else np.geomspace(44.0, 1800.0, 16):
        frequency, damping = expected(acceleration)
        for offset in _RESPONSE_OFFSETS:
            levels.append(float(DRIVE_SHAPE * acceleration))
            places.append(float(frequency * (1.0 + offset * damping)))
    return _case(
        "held_response", "stepped sine, held response", factor, seed,
        levels=_rounded(levels), control="response", test="stepped_sine", frequencies_hz=_rounded(places, 7),
        window_periods=80, ramp=0.2,
    )  # fmt: skip


def expected(acceleration: Any) -> tuple[Any, Any]:
    """Frequency (Hz) and damping ratio to expect at modal accelerations ω̃²q; a first ring-down tells them."""
    place, known = np.log(acceleration), np.log(_EXPECTED[:, 0])
    return np.interp(place, known, _EXPECTED[:, 1]), 0.01 * np.interp(place, known, _EXPECTED[:, 2])


def _rounded(values: Any, digits: int = 5) -> tuple[float, ...]:
    return tuple(float(f"{value:.{digits}g}") for value in values)


def evaluate(case: StudyCase, bag: Path) -> dict[str, Any]:
    """Every method's evaluation of the recording."""
    if case.test == "phase_resonance":
        return {}
    from nmt_study.comparison_analysis import compared_methods_of

    amplitudes = np.geomspace(42.0, 1830.0, 16) / (2.0 * math.pi * LINEAR_HZ) ** 2
    found = compared_methods_of(case, bag, amplitudes)
    main = found["methods"].pop(str(case.labels["method"]), {"levels": []})
    return {**found, "levels": main["levels"]}


@dataclass(frozen=True, eq=False)
class MethodOutcome:
    """What one method gave under one noise with one seed; arrays over the amplitudes that count.

    Attributes:
        method: key of :data:`METHODS`.
        noise: factor on the sensors' noise.
        seed: of the noise.
        bench_time: s.
        acceleration: modal acceleration ω̃²q, (m/s²)√kg.
        omega, damping: found.
        omega_error, damping_error: relative, against EPMC at the same q.
        omega_std, damping_std: relative standard uncertainties as stated.
        rest: relative distance of ω̃ and δ̃ to a perfect single-point phase resonance test at the same q, (2, k).
    """

    method: str
    noise: int
    seed: int
    bench_time: float
    acceleration: FloatArray
    omega: FloatArray
    damping: FloatArray
    omega_error: FloatArray
    damping_error: FloatArray
    omega_std: FloatArray
    damping_std: FloatArray
    rest: FloatArray


def derived_results(results: Sequence[Result]) -> list[Result]:
    """One result for each method: those of the runs, and those of further evaluations of the same recordings."""
    made: list[Result] = []
    for result in results:
        made.append(result)
        for method, values in result["extra"].get("methods", {}).items():
            case = dict(result["case"])
            case["name"] = case["name"].replace(str(case["labels"]["method"]), method, 1)
            case["title"] = METHODS[method]
            case["labels"] = {**case["labels"], "method": method}
            time = values["bench_time_s"]
            run = {**result["run"], **({} if time is None else {"bench_time_s": time})}
            made.append({**result, "case": case, "run": run, "levels": values["levels"], "extra": {}})
    return made


def outcomes(results: Sequence[Result]) -> list[MethodOutcome]:
    """Errors of every method over the amplitudes that count, in the order of :data:`METHODS`."""
    curve = next((r["single_point"]["curve"] for r in results if r["single_point"]["curve"]), None)
    found = [_outcome(result, curve) for result in derived_results(results)]
    order = list(METHODS)
    return sorted(found, key=lambda o: (order.index(o.method), o.noise, o.seed))


def _outcome(result: Result, curve: Mapping[str, Any] | None) -> MethodOutcome:
    labels = result["case"]["labels"]
    rows = []
    for level in result["levels"]:
        if level["status"] != PointStatus.OK or result["epmc"]["failure"]:
            continue
        q, omega, damping = level["modal_amplitude"], level["omega_rad_s"], level["damping_ratio"]
        reference = at_amplitude(result["epmc"], q)
        if reference is None or not RANGE[0] <= reference[0] ** 2 * q <= RANGE[1]:
            continue
        single = [math.nan, math.nan]
        if curve is not None:
            place = np.log(curve["modal_amplitude"])
            single = [
                float(np.interp(math.log(q), place, curve[name], left=math.nan, right=math.nan))
                for name in ("omega_rad_s", "damping_ratio")
            ]
        rows.append(
            (
                reference[0] ** 2 * q, omega, damping, omega / reference[0] - 1.0, damping / reference[1] - 1.0,
                _number(level.get("omega_rad_s_std")) / reference[0],
                _number(level.get("damping_ratio_std")) / reference[1],
                omega / single[0] - 1.0, damping / single[1] - 1.0,
            )
        )  # fmt: skip
    columns = np.array(rows, dtype=np.float64).reshape(-1, 9).T
    time = float(result["run"]["bench_time_s"])
    return MethodOutcome(
        labels["method"], labels["noise"], labels["seed"], time, columns[0], columns[1], columns[2], columns[3],
        columns[4], columns[5], columns[6], columns[7:],
    )  # fmt: skip


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def show(results: Sequence[Result]) -> StudyOutput:
    """Comparison, figures and findings."""
    found = outcomes(results)
    rows: list[Mapping[str, Any]] = []
    for made in derived_results(results):
        if not any(made is result for result in results):
            rows += level_rows("method_comparison", made)
    figures = [_overlay(results, found), _errors(found), _noise_figure(found), _time_figure(found)]
    tables = [_comparison(found), *_noise_tables(found)]
    return StudyOutput(figures, list(_findings(found)), [*_FAIRNESS, *_remarks(results)], rows, tables)


_FAIRNESS = (
    "All methods: same structure, exciter, sensors and converters; the same exact linear mode shapes for q; errors "
    f"against EPMC at the q each of them found, from ω̃²q = {RANGE[0]:g} to {RANGE[1]:g} (m/s²)√kg. Bench time: from "
    "the first ramp to the end of the last window; not counted: the linear test, which all need.",
    "Ring-downs: switched off at phase resonance from 25 V, above the range, within one period; 0.6 s of decay each; "
    "all sensors are used. The amplifier's output impedance is zero, so the coil is a closed circuit and brakes; an "
    "open circuit would brake less but leave the moving mass. In their favour: the force is recorded at the structure, "
    "with the phase of the accelerometers, so that the exciter can be taken out.",
    "Sweeps (0.2 Hz/s, as in the paper) and stepped sines (80 periods, as phase resonance has): 10 forces that spread "
    "the peaks evenly over the range, 10 frequencies a force within ± 1.5 half-power bandwidths, or 5 a held response "
    "within ± 1. In their favour: bands and forces are chosen from the known backbone; the time that finding them "
    "takes is not counted. The fit uses everything phase resonance uses (eq. 9 solved at every point).",
    "Half-power bandwidth: peak and band of each sweep at constant force, as for a linear structure.",
    "Phase resonance: the rig's own plan of 16 levels with 80 periods a window; with 400 each level gets as many "
    "periods as the five frequencies of a held response have. “Paper's loop”: its gain K = 20π and 25 s a level.",
    "Level of the other methods in the tables of levels: ω̃²q.",
)


def _remarks(results: Sequence[Result]) -> list[str]:
    texts = []
    for result in results:
        notes = [text.rstrip(".") for text in result["extra"].get("remarks") or []]
        counted = re.match(r"(\d+) of (\d+) levels locked", result["run"]["message"])
        what = [counted.group(0)] if counted and counted.group(1) != counted.group(2) else []
        what += [notes[0] + (f" (and {len(notes) - 1} more)" if len(notes) > 1 else "")] if notes else []
        if what:
            texts.append(f"{result['case']['title']}: {'; '.join(what)}.")
    return texts


def _finite(values: Sequence[FloatArray]) -> FloatArray:
    joined = np.concatenate(values) if values else np.empty(0)
    return np.asarray(joined[np.isfinite(joined)])


def _rms(values: Sequence[FloatArray]) -> float:
    joined = _finite(values)
    return float(np.sqrt(np.mean(joined**2))) if joined.size else math.nan


def _largest(values: Sequence[FloatArray]) -> float:
    joined = _finite(values)
    return float(np.abs(joined).max()) if joined.size else math.nan


def _of(found: Sequence[MethodOutcome], method: str, noise: int | None = None) -> list[MethodOutcome]:
    return [o for o in found if o.method == method and (noise is None or o.noise == noise)]


def _present(found: Sequence[MethodOutcome]) -> list[str]:
    return [method for method in METHODS if _of(found, method)]


def _bench_time(found: Sequence[MethodOutcome], method: str) -> float:
    lowest = min(o.noise for o in found)
    return float(np.mean([o.bench_time for o in _of(found, method, lowest)]))


def _comparison(found: Sequence[MethodOutcome]) -> StudyTable:
    lowest = min(o.noise for o in found)
    rows = []
    for method in _present(found):
        own = _of(found, method, lowest)
        rows.append(
            [
                METHODS[method],
                plain(_bench_time(found, method), 1),
                plain(float(np.mean([o.acceleration.size for o in own])), 0),
                *(significant(100.0 * _rms([o.omega_error for o in own]), 2),),
                significant(100.0 * _largest([o.omega_error for o in own]), 2),
                significant(100.0 * _rms([o.damping_error for o in own]), 2),
                significant(100.0 * _largest([o.damping_error for o in own]), 2),
                significant(100.0 * float(np.median(np.concatenate([o.damping_std for o in own]))), 2),
                significant(100.0 * _rms([o.rest[0] for o in own]), 2),
                significant(100.0 * _rms([o.rest[1] for o in own]), 2),
            ]
        )
    columns = (
        ("Method", ""), ("Bench time", "s"), ("Amplitudes", "in range"), ("ω̃ rms", "%"), ("ω̃ largest", "%"),
        ("δ̃ rms", "%"), ("δ̃ largest", "%"), ("δ̃ stated", "%, median"), ("ω̃ rms", "% to test"), ("δ̃ rms", "% to test"),
    )  # fmt: skip
    note = (
        "At the rig's own sensor noise, all seeds. Errors against EPMC at the same q; stated: median of the standard "
        "uncertainties given with the values; to test: distance to what a perfect single-point phase resonance test of "
        "this rig would find at the same q."
    )
    return StudyTable("Time and accuracy", columns, rows, note)


def _noise_tables(found: Sequence[MethodOutcome]) -> list[StudyTable]:
    noises = sorted({o.noise for o in found})
    common = max(float(o.acceleration.min()) for o in found if o.acceleration.size and o.method != "half_power")
    damping, others = [], []
    for method in _present(found):
        first, second = [METHODS[method]], [METHODS[method]]
        for noise in noises:
            own = _of(found, method, noise)
            lowest = [float(o.acceleration.min()) for o in own if o.acceleration.size]
            high = [o.damping_error[o.acceleration >= common] for o in own]
            first += [
                significant(100.0 * _rms([o.damping_error for o in own]), 2),
                significant(100.0 * _rms(high), 2),
                plain(float(np.mean(lowest)) if lowest else math.nan, 0),
            ]
            second += [
                significant(100.0 * _rms([o.omega_error for o in own]), 2),
                plain(float(np.mean([o.bench_time for o in own])) if own else math.nan, 0),
            ]
        damping.append(first)
        others.append(second)
    columns: list[tuple[str, str]] = [("Method", "")]
    for noise in noises:
        columns += [(f"x {noise}: all", "%"), (f"from {common:.0f}", "%"), ("lowest", "(m/s²)√kg")]
    note = (
        "Root mean square of the errors of δ̃ over amplitudes and seeds: over all amplitudes that were found, and over "
        f"modal accelerations from {common:.0f} (m/s²)√kg on, which every method but the half-power bandwidth found at "
        "every noise. Lowest: lowest modal acceleration found, mean over the seeds. Noise x 1 is 5 mN and 0.02 m/s² "
        "rms a sample; x 100 is 0.5 N, more than the force at the lowest levels, and 2 m/s²."
    )
    tables = [StudyTable("Sensitivity of δ̃ to noise", columns, damping, note)]
    columns = [("Method", "")]
    for noise in noises:
        columns += [(f"x {noise}: ω̃ rms", "%"), ("Bench time", "s")]
    note = "Levels that do not lock use up their time-out; stepped sines at held forces lose most of them to noise."
    tables.append(StudyTable("ω̃ and bench time with noise", columns, others, note))
    return tables


def _style(method: str) -> dict[str, Any]:
    k = list(METHODS).index(method)
    colours = (*COLOURS, "#c0569b", "#7a8f3c")
    return {"color": colours[k % len(colours)], "marker": MARKERS[k % len(MARKERS)]}


def _first(found: Sequence[MethodOutcome], method: str, noise: int) -> MethodOutcome | None:
    own = _of(found, method, noise)
    return own[0] if own and own[0].acceleration.size else None


def _overlay(results: Sequence[Result], found: Sequence[MethodOutcome]) -> ReportFigure:
    figure, panels = plot_panels((9.6, 5.2), 1, 2, left=0.085, right=0.985, bottom=0.33, top=0.96, wspace=0.22)
    lowest = min(o.noise for o in found)
    epmc = max(
        (r["epmc"] for r in results if not r["epmc"]["failure"]), key=lambda e: np.ptp(np.log(e["modal_amplitude"]))
    )
    omega = np.array(epmc["omega_rad_s"])
    place = omega**2 * np.array(epmc["modal_amplitude"])
    panels[0].plot(place, omega / (2.0 * math.pi), color=INK, linewidth=1.2, label="EPMC (harmonic balance)")
    panels[1].plot(place, 100.0 * np.array(epmc["damping_ratio"]), color=INK, linewidth=1.2)
    for method in _present(found):
        own = _first(found, method, lowest)
        if own is None:
            continue
        for axes, values, std in (
            (panels[0], own.omega / (2.0 * math.pi), own.omega_std * own.omega / (2.0 * math.pi)),
            (panels[1], 100.0 * own.damping, 100.0 * own.damping_std * own.damping),
        ):
            axes.errorbar(
                own.acceleration, values, yerr=np.nan_to_num(std), linestyle="none", markersize=3.8, elinewidth=0.8,
                capsize=1.5, label=METHODS[method], markerfacecolor="none", markeredgewidth=0.9, **_style(method),
            )  # fmt: skip
    panels[0].set_ylabel(r"$\tilde\omega / 2\pi$ / Hz")
    panels[1].set_ylabel(r"$\tilde\delta$ / %")
    panels[1].set_ylim(bottom=0.0)
    for axes in panels:
        _acceleration_axis(axes)
    caption = (
        "Frequency and damping over the modal acceleration, all methods at the rig's own noise (first seed), with "
        "standard uncertainties."
    )
    return report_figure(figure, "methods", "All methods", caption, True, legend=2)


def _errors(found: Sequence[MethodOutcome]) -> ReportFigure:
    noises = sorted({o.noise for o in found})
    figure, panels = plot_panels(
        (9.6, 6.4), 2, len(noises), {"squeeze": False, "sharex": True},
        left=0.085, right=0.985, bottom=0.235, top=0.94, wspace=0.3, hspace=0.12,
    )  # fmt: skip
    methods = [method for method in _present(found) if method not in WRONG_BY_CONSTRUCTION]
    for column, noise in enumerate(noises):
        for line, (values, std, label) in enumerate(
            (
                ("omega_error", "omega_std", r"error of $\tilde\omega$ / %"),
                ("damping_error", "damping_std", r"error of $\tilde\delta$ / %"),
            )
        ):
            axes = panels[line][column]
            axes.axhline(0.0, color=INK, linewidth=0.8)
            for method in methods:
                own = _first(found, method, noise)
                if own is None:
                    continue
                axes.errorbar(
                    own.acceleration, 100.0 * getattr(own, values), yerr=100.0 * np.nan_to_num(getattr(own, std)),
                    linestyle="-", linewidth=0.5, markersize=3.2, elinewidth=0.7, label=METHODS[method],
                    markerfacecolor="none", markeredgewidth=0.8, **_style(method),
                )  # fmt: skip
            if column == 0:
                axes.set_ylabel(label)
            if line == 0:
                axes.set_title(f"noise x {noise}")
            else:
                _acceleration_axis(axes)
    caption = (
        "Errors against EPMC at the same amplitude with stated standard uncertainties, first seed. Left out: what is "
        "wrong by construction (apparent values of structure and exciter, half-power bandwidth). Mind the "
        "different scales."
    )
    return report_figure(figure, "method-errors", "Errors and noise", caption, True, legend=2)


def _noise_figure(found: Sequence[MethodOutcome]) -> ReportFigure:
    noises = sorted({o.noise for o in found})
    figure, panels = plot_panels((9.6, 4.8), 1, 2, left=0.085, right=0.985, bottom=0.37, top=0.96, wspace=0.22)
    for axes, name, label in (
        (panels[0], "omega_error", r"rms error of $\tilde\omega$ / %"),
        (panels[1], "damping_error", r"rms error of $\tilde\delta$ / %"),
    ):
        for method in _present(found):
            rms = [100.0 * _rms([getattr(o, name) for o in _of(found, method, noise)]) for noise in noises]
            axes.plot(noises, rms, linewidth=0.9, markersize=4.5, label=METHODS[method], **_style(method))
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("sensor noise, times that of the rig")
        axes.set_ylabel(label)
    caption = "Root mean square of the errors over amplitudes and seeds, over the sensor noise."
    return report_figure(figure, "method-noise", "Sensitivity to noise", caption, True, legend=2)


def _time_figure(found: Sequence[MethodOutcome]) -> ReportFigure:
    methods = [method for method in _present(found) if method not in WRONG_BY_CONSTRUCTION][::-1]
    times = [_bench_time(found, method) for method in methods]
    figure, axes = plot_panels((6.3, 3.2), left=0.46, right=0.9, bottom=0.17, top=0.97)
    axes.barh(range(len(methods)), times, color=[_style(method)["color"] for method in methods], height=0.6)
    axes.set_yticks(range(len(methods)), [METHODS[method] for method in methods])
    for k, time in enumerate(times):
        axes.annotate(f" {time:.3g}", (time, k), va="center", ha="left")
    axes.set_xscale("log")
    axes.set_xlim(left=1.0)
    axes.minorticks_off()
    axes.set_xlabel("bench time / s")
    caption = "Bench time of a whole backbone at the rig's own noise."
    return report_figure(figure, "method-time", "Bench time", caption)


def _acceleration_axis(axes: Any) -> None:
    axes.set_xscale("log")
    axes.set_xlim(RANGE[0] / 1.15, RANGE[1] * 1.15)
    axes.set_xticks([50, 100, 200, 500, 1000], ["50", "100", "200", "500", "1000"])
    axes.minorticks_off()
    axes.set_xlabel(r"modal acceleration $\tilde\omega^2 q$ / (m/s²)$\sqrt{\mathrm{kg}}$")


def _findings(found: Sequence[MethodOutcome]) -> Iterator[Finding]:
    lowest, highest = min(o.noise for o in found), max(o.noise for o in found)
    for method in _present(found):
        own = _of(found, method, lowest)
        omega = _largest([o.omega_error for o in own])
        damping = _largest([o.damping_error for o in own])
        yield Finding(
            f"{METHODS[method]}: every ω̃ within 0.1 % and every δ̃ within 3 % of EPMC.",
            f"largest errors {percent(omega)} and {percent(damping)}, {_bench_time(found, method):.1f} s of bench time",
            bool(omega <= 1e-3 and damping <= 0.03) if math.isfinite(omega) else None,
        )
    for method in ("phase_resonance", "ring_downs", "stepped", "held_response"):
        own = _of(found, method, highest)
        ratios = [
            np.concatenate([getattr(o, f"{name}_error") / getattr(o, f"{name}_std") for o in own] or [np.empty(0)])
            for name in ("omega", "damping")
        ]
        if highest == lowest or not ratios[0].size:
            continue
        typical = [float(np.median(np.abs(values[np.isfinite(values)]))) for values in ratios]
        yield Finding(
            f"{METHODS[method]}, noise x {highest}: the stated uncertainties are those of the errors.",
            f"median of |error| over standard uncertainty {typical[0]:.2f} for ω̃, {typical[1]:.2f} for δ̃ (0.67 "
            "expected)",
            all(0.33 < value < 1.35 for value in typical),
        )
