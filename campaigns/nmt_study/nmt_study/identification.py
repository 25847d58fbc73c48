"""Nonlinear system identification compared with the diagnosis: each predicts the backbone and a sweep it has not seen.

Both get the same recordings of random excitation. The subspace method knows the place of the nonlinear force, no more;
the diagnosis has a rig file that is wrong, and knows no place.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.quantity_format import significant
from nmt_report.svg import INK, ReportFigure
from nmt_study.case import StudyCase
from nmt_study.nonlinear_subspace import ORDERS, SAMPLE_RATE
from nmt_study.study import Finding, Result, StudyOutput, StudyTable
from nmt_study.study_figures import COLOURS, MARKERS, percent
from nmt_study.study_table import at_amplitude

TITLE = "Nonlinear system identification on the same recordings"

METHODS = {
    "subspace": "nonlinear subspace identification (N4SID, w² to w⁵)",
    "diagnosis": "the diagnosis' fitted model",
}
BAND_HZ = (10.0, 60.0)
_SENSORS = [
    {"quantity": "force", "point": "drive"},
    *({"quantity": "displacement", "point": point} for point in (2, 3, 4, 6)),
    {"quantity": "voltage"},
]
_STRUCTURES: dict[str, tuple[str, list[dict[str, Any]], list[dict[str, Any]], int]] = {
    "cubic": (
        "cubic spring at point 6; the model lacks it",
        [{"kind": "cubic_spring", "point": 6, "stiffness_n_m3": 2e7}],
        [],
        6,
    ),
    "friction": (
        "friction joint at point 3; the model's is 10 % too stiff and slips at 70 % of the force",
        [{"kind": "jenkins", "point": 3, "tangential_stiffness_n_m": 8000.0, "slip_force_n": 1.0}],
        [{"kind": "jenkins", "point": 3, "tangential_stiffness_n_m": 8800.0, "slip_force_n": 0.7}],
        3,
    ),
}
"""Title, local elements of the tested rig and of the model, and the point of the nonlinear force."""


def cases(quick: bool) -> list[StudyCase]:
    """Both structures under random excitation at three levels; one structure and two short levels if quick."""
    return [
        StudyCase(
            name=name,
            title=title,
            exciter=2,
            levels=(0.3, 1.0) if quick else (0.1, 0.5, 1.5),
            overrides=_overrides(elements),
            test="random",
            band_hz=BAND_HZ,
            duration=8.0 if quick else 30.0,
            epmc=False,
            labels={"structure": name},
        )
        for name, (title, elements, _, _) in list(_STRUCTURES.items())[: 1 if quick else None]
    ]


def _overrides(elements: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    return (f"local_elements={json.dumps(elements)}", f"sensors={json.dumps(_SENSORS)}")


def evaluate(case: StudyCase, bag: Path) -> dict[str, Any]:
    """What both methods predict, with the EPMC backbone and a further recording."""
    from nmt_study.identification_analysis import predictions

    _, _, model, point = _STRUCTURES[str(case.labels["structure"])]
    with tempfile.TemporaryDirectory(prefix="nmt-sweep-") as folder:
        return predictions(case, bag, _overrides(model), point, Path(folder))


def show(results: Sequence[Result]) -> StudyOutput:
    """Table, figures and findings."""
    rows = [row for result in results for row in _rows(result)]
    columns = (
        ("Structure", ""), ("Method", ""), ("ω̃ rms", "%"), ("ω̃ largest", "%"), ("δ̃ rms", "%"), ("δ̃ largest", "%"),
        ("Amplitudes", "of all"), ("Sweep, drive point", "% rms"),
    )  # fmt: skip
    note = (
        "Backbone: errors against EPMC at the same q. Sweep: rms of predicted less recorded displacement over that of "
        "the recorded one, for the recorded force, at a level between the trained ones."
    )
    return StudyOutput(
        [_backbones(results)], list(_findings(results)), list(_remarks(results)), (),
        [StudyTable("What each predicts", columns, rows, note)],
    )  # fmt: skip


def errors(result: Result, method: str) -> FloatArray:
    """Relative errors of ω̃ and δ̃ against EPMC at the amplitudes that a method found, (2, k)."""
    extra = result["extra"]
    found = extra["methods"][method]
    values = []
    for q, omega, damping in zip(found["modal_amplitude"], found["omega_rad_s"], found["damping_ratio"], strict=True):
        reference = None if q is None else at_amplitude(extra["reference"], q)
        if reference is not None and omega is not None:
            values.append((omega / reference[0] - 1.0, damping / reference[1] - 1.0))
    return np.array(values, dtype=np.float64).reshape(-1, 2).T


def _rows(result: Result) -> Iterator[list[str]]:
    for method, title in METHODS.items():
        found = result["extra"]["methods"][method]
        off = 100.0 * np.abs(errors(result, method))
        rms = [math.nan if not row.size else float(np.sqrt(np.mean(row**2))) for row in off]
        largest = [math.nan if not row.size else float(row.max()) for row in off]
        sweep = found["sweep_error"]
        yield [
            result["case"]["title"], title, significant(rms[0], 2), significant(largest[0], 2),
            significant(rms[1], 2), significant(largest[1], 2), f"{off.shape[1]} of {len(found['modal_amplitude'])}",
            significant(100.0 * (math.nan if sweep is None else sweep), 2),
        ]  # fmt: skip


def _backbones(results: Sequence[Result]) -> ReportFigure:
    figure, panels = plot_panels(
        (9.6, 3.4 * len(results) + 0.6), len(results), 2, {"squeeze": False},
        left=0.085, right=0.985, bottom=0.3 / len(results), top=0.95, wspace=0.22, hspace=0.3,
    )  # fmt: skip
    for line, result in enumerate(results):
        extra = result["extra"]
        for axes, name, scale, label in (
            (panels[line][0], "omega_rad_s", 0.5 / math.pi, r"$\tilde\omega / 2\pi$ / Hz"),
            (panels[line][1], "damping_ratio", 100.0, r"$\tilde\delta$ / %"),
        ):
            reference = extra["reference"]
            axes.plot(
                reference["modal_amplitude"], scale * np.array(reference[name]), color=INK, linewidth=1.2, label="EPMC"
            )
            for number, (method, title) in enumerate(METHODS.items()):
                found = extra["methods"][method]
                axes.plot(
                    np.array(found["modal_amplitude"], dtype=np.float64),
                    scale * np.array(found[name], dtype=np.float64), linestyle="none", markersize=4.0,
                    markerfacecolor="none", color=COLOURS[number], marker=MARKERS[number], label=title,
                )  # fmt: skip
            axes.set_xscale("log")
            axes.set_ylabel(label)
            axes.set_title(str(result["case"]["labels"]["structure"]))
            axes.set_xlabel(r"$q$ / m$\sqrt{\mathrm{kg}}$")
    caption = "Backbones that both predict from random excitation, with EPMC of the tested rig."
    return report_figure(figure, "identification", "Backbones", caption, True, legend=2)


def _findings(results: Sequence[Result]) -> Iterator[Finding]:
    for result in results:
        name = result["case"]["labels"]["structure"]
        for method, title in METHODS.items():
            off = errors(result, method)
            if not off.size:
                yield Finding(f"{name}: {title} has a backbone.", "none was found", False)
                continue
            omega, damping = (float(np.abs(row).max()) for row in off)
            yield Finding(
                f"{name}, {title}: every ω̃ within 0.5 % and every δ̃ within 10 % of EPMC.",
                f"largest errors {percent(omega)} and {percent(damping)}",
                omega <= 5e-3 and damping <= 0.1,
            )


def _remarks(results: Sequence[Result]) -> Iterator[str]:
    yield (
        "Subspace: force and displacements of the structure at "
        f"{SAMPLE_RATE:g} Hz; A and C by N4SID (nfoursid) of the largest motion, inputs by least squares over all "
        f"levels; order of {', '.join(map(str, ORDERS))} by the error on the last fifth of the recordings. In its "
        "favour: the place of the nonlinear force is given, and its displacement is measured."
    )
    yield (
        "Backbone of the subspace model: phase resonance at the drive point under a harmonic force, by harmonic "
        "balance; q and δ̃ as the bench has them, with the linear shapes. That of the diagnosis' model: EPMC."
    )
    for result in results:
        yield f"{result['case']['title']}: {result['extra']['told']}"
