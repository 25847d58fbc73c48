"""Robustness against wrong linear mode shapes (paper, section 3.3): one recorded run, extracted again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus
from nmt_report.figure_parts import report_figure
from nmt_report.svg import INK, ReportFigure
from nmt_study.case import StudyCase
from nmt_study.study import Finding, Result, StudyOutput
from nmt_study.study_figures import (
    COLOURS,
    backbone_figures,
    finish_q,
    linear_frequency,
    measured,
    percent,
    plot_axes,
)
from nmt_study.study_table import level_rows

TITLE = "Robustness against erroneous linear modes"
SCALES = (0.9, 1.1)
ERRORS = (0.05, 0.10)
DRAWS = 100


def cases(quick: bool) -> list[StudyCase]:
    """One test; everything else is extraction."""
    levels = tuple(float(f"{v:.5g}") for v in np.geomspace(0.05, 1.5, 3 if quick else 12))
    return [
        StudyCase(
            name="point_2",
            title="exact shapes",
            exciter=2,
            levels=levels,
            window_periods=20 if quick else 200,
            labels={"draws": 5 if quick else DRAWS},
        )
    ]


def evaluate(case: StudyCase, bag: Path) -> dict[str, Any]:
    """Amplitude and damping of every level with wrong shapes.

    Scales go through the extraction of the bag. Random errors follow from the harmonics that the extraction
    found, by the equations of the extraction, because shapes do not act on the harmonics; the first draw is
    checked against an extraction of the bag.
    """
    from nmt_extract.offline import extract_bag

    base = extract_bag(bag)
    points = [point for point in base.points if point.status is PointStatus.OK]
    linear = base.linear
    phi = linear.shape_matrix
    scaled = {}
    for scale in SCALES:
        changed = replace(linear, shapes=tuple(tuple(row) for row in (scale * phi).tolist()))
        again = [p for p in extract_bag(bag, linear=changed).points if p.status is PointStatus.OK]
        scaled[f"{scale:g}"] = {
            "modal_amplitude": [p.modal_amplitude for p in again],
            "damping_ratio": [p.damping_ratio for p in again],
            "omega_rad_s": [p.omega_rad_s for p in again],
        }
    rng = np.random.default_rng(case.seed)
    random: dict[str, Any] = {}
    witness = 0.0
    for level in ERRORS:
        amplitudes, dampings = [], []
        for draw in range(int(case.labels["draws"])):
            shapes = distorted(phi, level, rng)
            q, damping = amplitude_and_damping(points, shapes)
            amplitudes.append(q.tolist())
            dampings.append(damping.tolist())
            if draw == 0:
                changed = replace(linear, shapes=tuple(tuple(row) for row in shapes.tolist()))
                again = [p for p in extract_bag(bag, linear=changed).points if p.status is PointStatus.OK]
                difference = np.abs(damping / np.array([p.damping_ratio for p in again]) - 1.0)
                witness = max(witness, float(difference.max()))
        random[f"{level:g}"] = {"modal_amplitude": amplitudes, "damping_ratio": dampings}
    return {"scaled": scaled, "random": random, "witness": witness}


def distorted(shapes: FloatArray, level: float, rng: np.random.Generator) -> FloatArray:
    """Shapes with independent normal errors whose expected norm is ``level`` times that of the shapes (Frobenius).

    Args:
        shapes: Φ, (points, modes).
        level: size of the error relative to ‖Φ‖.
        rng: source of the errors.
    """
    deviation = level * float(np.linalg.norm(shapes)) / np.sqrt(shapes.size)
    return np.asarray(shapes + deviation * rng.standard_normal(shapes.shape), dtype=np.float64)


def amplitude_and_damping(points: Sequence[Any], shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """q (m√kg) and δ̃ of modal points with other linear shapes (points, modes); method, eq. 4."""
    inverse = np.linalg.pinv(shapes)
    fundamental = np.array([point.shape_harmonics[1] for point in points])
    q = np.linalg.norm(fundamental @ inverse.T, axis=1)
    power = np.array([point.active_power for point in points])
    omega = np.array([point.omega_rad_s for point in points])
    return np.asarray(q, dtype=np.float64), np.asarray(power / (omega**3 * q**2), dtype=np.float64)


def show(results: Sequence[Result]) -> StudyOutput:
    """Figures and findings."""
    base = results[0]
    figures = backbone_figures("scale", [base, *_scaled_results(base)], "scaled shapes κΦ")
    figures += [_band_figure(base, "omega_rad_s"), _band_figure(base, "damping_ratio")]
    rows: list[Mapping[str, Any]] = []
    for changed in [*_scaled_results(base), *_random_results(base)]:
        rows += level_rows("linear_modes", changed)
    return StudyOutput(figures, list(_findings(base)), [_NOTE], rows)


_NOTE = (
    "Random errors: independent and normal on every element of Φ at the sensors, with an expected Frobenius norm of 5 "
    "or 10 % of that of Φ (the paper does not say how it scales them)."
)


def _with_values(base: Result, name: str, title: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """The base result with other values in the levels that gave a point."""
    levels, k = [], 0
    for row in base["levels"]:
        if row["status"] == PointStatus.OK:
            levels.append({**row, **{key: column[k] for key, column in values.items()}})
            k += 1
        else:
            levels.append(row)
    return {**base, "case": {**base["case"], "name": name, "title": title}, "levels": levels}


def _scaled_results(base: Result) -> list[dict[str, Any]]:
    scaled = base["extra"]["scaled"]
    return [_with_values(base, f"kappa_{scale}", f"κ = {scale}", values) for scale, values in scaled.items()]


def _random_results(base: Result) -> list[dict[str, Any]]:
    made = []
    for level, values in base["extra"]["random"].items():
        for draw in range(len(values["modal_amplitude"])):
            chosen = {name: column[draw] for name, column in values.items()}
            title = f"{100 * float(level):g} % of ‖Φ‖, draw {draw + 1}"
            made.append(_with_values(base, f"random_{level}_{draw + 1:03d}", title, chosen))
    return made


def _band_figure(base: Result, name: str) -> ReportFigure:
    omega = name == "omega_rad_s"
    scale = 1.0 / linear_frequency(base) if omega else 100.0
    figure, axes = plot_axes()
    q0, y0 = measured(base, "modal_amplitude"), scale * measured(base, name)
    for k, (level, values) in enumerate(reversed(base["extra"]["random"].items())):
        q = np.array(values["modal_amplitude"])
        y = np.broadcast_to(y0, q.shape) if omega else scale * np.array(values[name])
        label = f"errors of {100 * float(level):g} % of $\\Vert\\Phi\\Vert$"
        colour = COLOURS[1 - k % 2]
        for one_q, one_y in zip(q, y, strict=True):
            axes.plot(one_q, one_y, color=colour, linewidth=0.5, alpha=0.35)
        axes.plot([], [], color=colour, linewidth=2.0, label=label)
    axes.plot(q0, y0, "o-", color=INK, markersize=3.5, linewidth=1.2, label="exact shapes")
    axes.set_ylabel(r"$\tilde\omega^*$" if omega else r"$\tilde\delta$ / %")
    if not omega:
        axes.set_ylim(bottom=0.0)
    amplitudes = [np.ravel(values["modal_amplitude"]) for values in base["extra"]["random"].values()]
    finish_q(axes, amplitudes)
    what = "Natural frequency" if omega else "Damping ratio"
    caption = f"{what} with random errors of the linear shapes, one thin line a draw."
    key = "shape-errors-omega" if omega else "shape-errors-damping"
    return report_figure(figure, key, f"{what}: random shape errors", caption)


def _findings(base: Result) -> Iterator[Finding]:
    damping = measured(base, "damping_ratio")
    for scale, values in base["extra"]["scaled"].items():
        kappa = float(scale)
        ratio = np.array(values["damping_ratio"]) / damping
        yield Finding(
            f"κ = {scale} multiplies the damping ratio by κ² ({percent(kappa**2 - 1.0)}).",
            f"damping changes by {percent(float(ratio.mean()) - 1.0, 4)}, at every level the same to "
            f"{percent(float(np.ptp(ratio)), 1)}",
            bool(np.allclose(ratio, kappa**2, rtol=1e-6)),
        )
    omega = measured(base, "omega_rad_s")
    same = all(np.allclose(v["omega_rad_s"], omega, rtol=1e-12) for v in base["extra"]["scaled"].values())
    yield Finding(
        "The natural frequencies do not depend on the shapes.", "equal to all digits" if same else "they do", same
    )
    spread = {}
    for level, values in base["extra"]["random"].items():
        relative = np.array(values["damping_ratio"]) / damping - 1.0
        spread[float(level)] = float(np.sqrt(np.mean(relative**2))), float(np.abs(relative).max())
    yield Finding(
        "Relative errors of the modal properties are much smaller than those of the shapes.",
        "; ".join(
            f"errors of {percent(level)}: damping off by {percent(rms)} (root mean square), {percent(most)} at most"
            for level, (rms, most) in spread.items()
        ),
        all(rms < 0.5 * level for level, (rms, _) in spread.items()),
    )
    yield Finding(
        "Extraction of the bag with distorted shapes gives the same as the equations.",
        f"largest relative difference of the damping {base['extra']['witness']:.1g}",
        base["extra"]["witness"] < 1e-9,
    )
