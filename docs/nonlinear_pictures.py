"""Pictures of the tests where one shaker at one sine cannot go, drawn by ``make_pictures.py`` from results folders."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_diagnose.law.reading import read_law
from nmt_extract.curves.backbone_jumps import find_jumps
from nmt_extract.curves.limit_cycles import limit_cycles
from nmt_extract.modal.table import read_json
from nmt_report.law_figures import drawn_loops
from nmt_report.svg import figure_style
from nmt_rig.reference import compute_reference, point_shapes
from nmt_rig.rig import load_rig

INK, LINE, ACCENT, SECOND = "#1c2733", "#5b6b7b", "#c0392b", "#1f77b4"
FALLING = (4, "stribeck", (0.004, 4e-3, 1.0, 0.1), ())
_SMALL: dict[str, Any] = {"fontsize": 8, "color": INK}


def locked_points(folder: Path) -> list[ModalPoint]:
    """Points of a results folder that locked and were accepted."""
    return [point for point in read_json(folder / "modal.json")[0] if point.status is PointStatus.OK]


def two_panels() -> tuple[Figure, Any, Any]:
    """An empty figure with two panels side by side."""
    matplotlib.rcParams.update({"svg.hashsalt": "nmt", "font.family": "DejaVu Sans"})
    figure = Figure(figsize=(9.6, 3.3), facecolor="white")
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.065, right=0.985, top=0.95, bottom=0.15, wspace=0.2)
    for axes in (left, right):
        axes.tick_params(labelsize=8, colors=INK)
        axes.grid(alpha=0.25, linewidth=0.5)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return figure, left, right


def save(figure: Figure, target: Path) -> None:
    """Write a figure without the date, so that the same results give the same file."""
    figure.savefig(target, metadata={"Date": None} if target.suffix == ".svg" else {})


def draw_self_excited(results: Path, target: Path) -> None:
    """Frequency and damping ratio of a self-excited rig with its limit cycles, beside the computed mode."""
    points = locked_points(results)
    q = np.array([point.modal_amplitude for point in points])
    computed = compute_reference(load_rig(results / "rig.yaml"), 15, np.linspace(0.3 * q.min(), 1.04 * q.max(), 150))
    figure, left, right = two_panels()
    hertz = [point.omega_rad_s / (2.0 * np.pi) for point in points]
    percent = [100.0 * point.damping_ratio for point in points]
    right.axhline(0.0, color=INK, linewidth=0.6)
    for axes, line, values, label in (
        (left, computed.omega_rad_s / (2.0 * np.pi), hertz, "modal frequency, Hz"),
        (right, 100.0 * computed.damping_ratio, percent, "damping ratio, %"),
    ):
        axes.plot(1e3 * computed.modal_amplitude, line, color=LINE, linewidth=1.2, label="computed (EPMC)")
        axes.plot(1e3 * q, values, "o", color=ACCENT, markersize=4.5, label="measured (simulated rig)")
        axes.set_xlabel("modal amplitude, 10⁻³ m√kg", **_SMALL)
        axes.set_ylabel(label, **_SMALL)
    for cycle in limit_cycles(points):
        kind = "stable limit cycle" if cycle.stable else "unstable limit cycle"
        style = {"color": INK, "markersize": 8, "markerfacecolor": INK if cycle.stable else "white", "label": kind}
        left.plot([1e3 * cycle.modal_amplitude], [cycle.omega_rad_s / (2.0 * np.pi)], "o", **style)
        right.plot([1e3 * cycle.modal_amplitude], [0.0], "o", **style)
    right.legend(fontsize=8, frameon=False, loc="upper left")
    save(figure, target)


def draw_law(target: Path) -> None:
    """The missing force of a chain with friction that weakens with speed; its levels were integrated elsewhere."""
    from diagnose.simulated_levels import chain_of_masses, held

    reading = read_law(chain_of_masses(), held([FALLING], forces=np.geomspace(0.05, 0.4, 6)))
    if reading is None or not reading.is_stated:
        raise RuntimeError("the law of the picture is not read")
    with figure_style(), matplotlib.rc_context({"svg.hashsalt": "nmt", "figure.facecolor": "white"}):
        save(drawn_loops(reading.laws[0]), target)


def draw_resonances(passed: Path, jumping: Path, primary: Path, isola: Path, subharmonic: Path, target: Path) -> None:
    """Internal resonance with and without a jump; the isola of a subharmonic with the tip that was held."""
    figure, left, right = two_panels()
    for folder, colour, label in ((passed, LINE, "1 % of damping, up and down"), (jumping, ACCENT, "0.2 %, upwards")):
        points = locked_points(folder)
        place = {id(point): (1e3 * point.level, point.frequency_hz) for point in points}
        style = {"markersize": 4.5, "color": colour, "linestyle": "none"}
        left.plot(*np.array(list(place.values())).T, "o", label=label, **style)
        for jump in find_jumps(points):
            arrow = {"arrowstyle": "-|>", "color": ACCENT, "linewidth": 1.2, "shrinkA": 4, "shrinkB": 4}
            left.annotate("", place[id(jump.after)], place[id(jump.before)], arrowprops=arrow)
            left.annotate("jump", place[id(jump.after)], (-26, 2), textcoords="offset points", **_SMALL)
    left.set_xlabel("response amplitude at the drive point, mm", **_SMALL)
    left.set_ylabel("excitation frequency, Hz", **_SMALL)
    left.legend(fontsize=8, frameon=False, loc="upper left")

    with (isola / "secondary.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["place"] == "isola"]
    curve = np.array([(float(row["excitation_hz"]), float(row["drive_point_m"])) for row in rows]).T
    right.plot(curve[0], 1e3 * curve[1], color=LINE, linewidth=1.2, label="isola, from the measured backbone")
    points = locked_points(primary)
    backbone = np.array([(3.0 * point.frequency_hz, point.level) for point in points]).T
    right.plot(backbone[0], 1e3 * backbone[1], "o", color=SECOND, markersize=4.5, label="backbone, at 3 × frequency")
    for point in locked_points(subharmonic):
        amplitude = 1e3 * abs(point.normalised_shape[0]) * point.modal_amplitude
        right.plot([point.frequency_hz], [amplitude], "s", color=ACCENT, markersize=7, label="tip, held by the loop")
    right.set_xlabel("excitation frequency Ω, Hz", **_SMALL)
    right.set_ylabel("response amplitude at Ω/3, mm", **_SMALL)
    right.legend(fontsize=8, frameon=False, loc="upper left")
    save(figure, target)


def draw_exciters(two: Path, one: Path, target: Path) -> None:
    """MAC with the nonlinear mode and damping ratio of a frame with two close modes: one shaker beside two."""
    figure, left, right = two_panels()
    rig = load_rig(two / "rig.yaml")
    runs = [(two, ACCENT, "o", "two shakers"), (one, SECOND, "s", "one shaker")]
    every = np.array([point.modal_amplitude for folder, *_ in runs for point in locked_points(folder)])
    line = compute_reference(rig, 15, np.geomspace(0.8 * every.min(), 1.2 * every.max(), 150))
    right.plot(
        1e3 * line.modal_amplitude, 100.0 * line.damping_ratio, color=LINE, linewidth=1.2, label="computed (EPMC)"
    )
    shapes = point_shapes(rig, line)
    fundamental = shapes.shape[:, shapes.orders.index(1), :]
    for folder, colour, marker, label in runs:
        points = locked_points(folder)
        q = np.array([point.modal_amplitude for point in points])
        mac = []
        for point in points:
            nearest = int(np.argmin(np.abs(np.log(line.modal_amplitude / point.modal_amplitude))))
            mode = fundamental[nearest, [shapes.points.index(number) for number in point.points]]
            found = point.normalised_shape
            mac.append(abs(np.vdot(mode, found)) ** 2 / (np.vdot(mode, mode) * np.vdot(found, found)).real)
        style = {"color": colour, "markersize": 4.5, "linewidth": 0.9, "label": label}
        left.plot(1e3 * q, mac, marker + "-", **style)
        right.plot(1e3 * q, [100.0 * point.damping_ratio for point in points], marker, **style)
    left.set_ylabel("MAC with the nonlinear mode", **_SMALL)
    right.set_ylabel("damping ratio, %", **_SMALL)
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xticks((0.1, 0.2, 0.5, 1.0, 2.0), ("0.1", "0.2", "0.5", "1", "2"))
        axes.minorticks_off()
        axes.set_xlabel("modal amplitude, 10⁻³ m√kg", **_SMALL)
        axes.legend(fontsize=8, frameon=False, loc="best")
    save(figure, target)
