"""``report.html`` of a computed backbone: frequency, damping, shapes and harmonics over the modal amplitude."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from nmt_core.numerics.arrays import FloatArray
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.html_page import PageColumn, Row, Table, part
from nmt_report.quantity_format import plain, significant
from nmt_report.response_page import ResponsePage, html_figures
from nmt_report.run_data import ReferenceCurve
from nmt_report.svg import BLUE, INK, ORANGE, ReportFigure, figure_style, level_colours

if TYPE_CHECKING:
    from nmt_rig.reference import PointShapes, Reference
    from nmt_rig.rig import Rig

_SHAPES = 5
_ROWS = 12
_NEGLIGIBLE = 1e-6


def reference_page(rig: Rig, reference: Reference, shapes: PointShapes, compared: ReferenceCurve | None = None) -> str:
    """The whole page.

    Args:
        rig: rig that was computed.
        reference: of :func:`nmt_rig.reference.compute_reference`.
        shapes: of :func:`nmt_rig.reference.point_shapes`.
        compared: table that is drawn next to it.
    """
    q, omega, damping = reference.modal_amplitude, reference.omega_rad_s, reference.damping_ratio
    hertz = omega / (2.0 * np.pi)
    with figure_style():
        backbone = [
            _curve(reference, hertz, "frequency", "Modal frequency", "modal frequency (Hz)", compared),
            _curve(reference, 100.0 * damping, "damping", "Modal damping ratio", "modal damping ratio (%)", compared),
        ]
        details = [_shape_figure(reference, shapes), _harmonics_figure(reference, shapes)]
    (f0, d0, q0), (f1, d1, q1), (f2, d2, q2) = (
        (f"{plain(hertz[k], 4)} Hz", f"{plain(100 * damping[k], 3)} %", f"{significant(q[k], 3)} m√kg")
        for k in (0, -1, int(damping.argmax()))
    )
    cards = [
        ("Lowest amplitude", f0, f"{d0} at {q0}"),
        ("Highest amplitude", f1, f"{d1} at {q1}"),
        ("Highest damping", d2, f"{f2} at {q2}"),
    ]
    notices = [] if reference.single_valued else ["The backbone folds over the amplitude; the first crossing is given."]
    page = ResponsePage(
        kicker="Computed backbone",
        heading=rig.name,
        subtitle=rig.description,
        verdict=("Nonlinear mode of the rig's model (EPMC, harmonic balance)", "good"),
        cards=cards,
        facts=[
            ("Mode", str(rig.test.mode)),
            ("Harmonics", f"0 to {reference.harmonics}"),
            ("Amplitudes", f"{q.size}, {significant(q[0], 3)} to {significant(q[-1], 3)} m√kg"),
            ("Compared with", "" if compared is None else compared.label),
        ],
        notices=notices,
        footer=Markup(
            "Extended periodic motion concept: free periodic motion of the structure with its local elements, without "
            "exciter; mass-proportional negative damping keeps it periodic. Shapes: φ̃₁ᴴ M φ̃₁ = 1. SI units."
        ),
        sections=[
            ("backbone", "Backbone", html_figures(backbone)),
            ("shapes", "Shapes and harmonics", html_figures(details)),
            ("table", "Table", part("table", _table(reference))),
        ],
    )
    return page.html()


def _curve(
    reference: Reference,
    values: FloatArray,
    name: str,
    title: str,
    label: str,
    compared: ReferenceCurve | None,
) -> ReportFigure:
    figure, axes = _axes()
    axes.semilogx(reference.modal_amplitude, values, color=BLUE, label=f"{reference.harmonics} harmonics")
    caption = f"{title} of the nonlinear mode over the modal amplitude."
    if compared is not None:
        own = compared.omega_rad_s / (2.0 * np.pi) if name == "frequency" else 100.0 * compared.damping_ratio
        axes.semilogx(compared.modal_amplitude, own, color=ORANGE, linestyle="--", label=compared.label)
        axes.legend(loc="best")
    axes.set_xlabel("modal amplitude (m√kg)")
    axes.set_ylabel(label)
    return report_figure(figure, name, title, caption, label=f"{title} over modal amplitude")


def _shape_figure(reference: Reference, shapes: PointShapes) -> ReportFigure:
    """Fundamental shape at a few amplitudes; the phase that brings the largest entry to the real axis is taken out."""
    figure, axes = _axes()
    fundamental = shapes.shape[:, shapes.orders.index(1)]
    rows = np.unique(np.linspace(0, reference.modal_amplitude.size - 1, _SHAPES).round().astype(int))
    for row, colour in zip(rows, level_colours(rows.size), strict=True):
        shape = fundamental[row]
        turned = shape * np.exp(-1j * np.angle(shape[np.argmax(np.abs(shape))]))
        label = f"{significant(float(reference.modal_amplitude[row]), 3)} m√kg"
        axes.plot(shapes.points, turned.real, "o-", color=colour, markersize=3, label=label)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.set_xlabel("point")
    axes.set_ylabel("shape of the fundamental (1/√kg)")
    axes.legend(loc="best")
    caption = "Real part, in phase with the largest entry, at amplitudes from the lowest to the highest."
    label = "Mode shape at several amplitudes"
    return report_figure(figure, "shapes", "Shape of the fundamental", caption, label=label)


def _harmonics_figure(reference: Reference, shapes: PointShapes) -> ReportFigure:
    """Norm of every harmonic's shape over that of the fundamental."""
    figure, axes = _axes()
    norms = np.linalg.norm(shapes.shape, axis=2)
    share = norms / norms[:, [shapes.orders.index(1)]]
    present = [k for k, order in enumerate(shapes.orders) if order != 1 and (share[:, k] > _NEGLIGIBLE).any()]
    for k, colour in zip(present, level_colours(max(len(present), 2)), strict=False):
        seen = share[:, k] > _NEGLIGIBLE
        label = f"order {shapes.orders[k]}"
        axes.loglog(reference.modal_amplitude[seen], share[seen, k], color=colour, label=label)
    axes.set_xlabel("modal amplitude (m√kg)")
    axes.set_ylabel("harmonic / fundamental")
    if present:
        axes.legend(loc="best")
    caption = (
        "Euclidean norm of each harmonic's shape over that of the fundamental."
        if present
        else f"No harmonic reaches {_NEGLIGIBLE:g} of the fundamental."
    )
    label = "Harmonics over modal amplitude"
    return report_figure(figure, "harmonics", "Harmonics of the motion", caption, label=label)


def _table(reference: Reference) -> Table:
    rows = np.unique(np.linspace(0, reference.modal_amplitude.size - 1, _ROWS).round().astype(int))
    cells = [
        [
            significant(float(reference.modal_amplitude[k]), 5),
            plain(float(reference.omega_rad_s[k]) / (2.0 * np.pi), 5),
            plain(100.0 * float(reference.damping_ratio[k]), 4),
        ]
        for k in rows
    ]
    columns = [
        PageColumn("q", "m√kg", ""),
        PageColumn("modal frequency", "Hz", ""),
        PageColumn("modal damping ratio", "%", ""),
    ]
    return Table(columns, [Row(row) for row in cells], "All amplitudes are in reference.csv, the shapes in shapes.csv.")


def _axes() -> tuple[Figure, Any]:
    return plot_panels((6.3, 3.6), left=0.15, right=0.97, bottom=0.15, top=0.96)
