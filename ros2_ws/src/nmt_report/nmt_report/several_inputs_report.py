"""``report.html`` of a linear modal test with several exciters: responses to every input, partial coherence, modes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from nmt_core.numerics.arrays import FloatArray
from nmt_extract.several_inputs import InputModes, SeveralInputsTest
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.html_page import Table
from nmt_report.linear_report import phase_degrees, thinned
from nmt_report.quantity_format import plain, significant, uncertain
from nmt_report.response_page import ResponsePage, text_table
from nmt_report.svg import BLUE, GREEN, INK, MUTED, ORANGE, RED, ReportFigure, figure_style

if TYPE_CHECKING:
    from nmt_rig.rig import Rig

_COLOURS = (BLUE, ORANGE, GREEN, RED, INK, MUTED)
_STYLES = ("-", "--", "-.", ":")
_LOW_COHERENCE = 0.9
"""Mean partial coherence of a response and an input below which the page says so."""


def several_inputs_page(test: SeveralInputsTest, rig: Rig, run: Mapping[str, Any] | None = None) -> str:
    """The whole page.

    Args:
        test: of :func:`nmt_extract.several_inputs.evaluate_several_inputs`.
        rig: rig of the recording.
        run: the recording's description of its run.
    """
    run = run or {}
    with figure_style():
        responses = [_response_figure(test, row) for row in range(len(test.points))]
        coherences = [_coherence_figure(test, column) for column in range(len(test.exciter_points))]
    frequency, damping = test.modes.frequencies_hz[test.target], test.modes.damping_ratios[test.target]
    points = ", ".join(map(str, test.exciter_points))
    page = ResponsePage(
        kicker="Linear modal test, several exciters",
        heading=rig.name,
        subtitle=rig.description,
        verdict=(
            f"{test.modes.frequencies_hz.size} modes fitted and scaled, {len(test.exciter_points)} inputs",
            "good",
        ),
        cards=[
            (
                "Target mode",
                f"{plain(frequency, 4)} Hz",
                f"± {significant(test.modes.frequency_stds[test.target], 1)} Hz",
            ),
            (
                "Damping ratio",
                f"{plain(100 * damping, 4)} %",
                f"± {significant(100 * test.modes.damping_stds[test.target], 1)} %",
            ),
        ],
        facts=[
            ("Run", str(run.get("run_id") or "")),
            ("Started", str(run.get("started") or "").replace("T", " ")),
            ("Exciters", f"at points {points}"),
            ("Band", f"{test.frequency_hz[0]:.4g} to {test.frequency_hz[-1]:.4g} Hz"),
        ],
        notices=coherence_remarks(test),
        footer=Markup(
            "Accelerance: acceleration over force, H = S<sub>xf</sub> S<sub>ff</sub>⁻¹. Convention: x(t) = Re X "
            "e<sup>iωt</sup>. ± standard uncertainty. SI units."
        ),
    )
    return page.html(
        "several_inputs_report.html",
        mode_tables=[*_mode_tables(test), _shape_table(test)],
        responses=responses,
        coherences=coherences,
        input_table=_input_table(test),
    )


def coherence_remarks(test: SeveralInputsTest) -> list[str]:
    """A sentence for every response and input whose mean partial coherence is low."""
    mean = test.coherence.mean(axis=2)
    return [
        f"The partial coherence of point {point} with the exciter at point {exciter} is {mean[row, column]:.2f} in the "
        "mean: noise, or little of that force in the response."
        for column, exciter in enumerate(test.exciter_points)
        for row, point in enumerate(test.points)
        if mean[row, column] < _LOW_COHERENCE
    ]


# -- tables -----------------------------------------------------------------------------------------------------------


def _mode_tables(test: SeveralInputsTest) -> list[Table]:
    head = [("", ""), ("Frequency", "Hz"), ("Damping ratio", "%")]

    def rows(modes: InputModes, target: int | None) -> list[list[str]]:
        return [
            [
                f"mode {index + 1}{', target' if index == target else ''}",
                uncertain(modes.frequencies_hz[index], modes.frequency_stds[index]),
                uncertain(100 * modes.damping_ratios[index], 100 * modes.damping_stds[index]),
            ]
            for index in range(modes.frequencies_hz.size)
        ]

    misfit = significant(100 * float(np.max(test.modes.misfit)), 2)
    return [
        text_table(
            [("Structure, by the forces", ""), *head[1:]],
            rows(test.modes, test.target),
            f"Fitted to the whole record without window; at most {misfit} % of a response is not explained (rms).",
        ),
        text_table([("With exciters, by the voltages", ""), *head[1:]], rows(test.plant, None)),
    ]


def _shape_table(test: SeveralInputsTest) -> Table:
    head = [("Mass-normalised shape at", ""), *((f"mode {k + 1}", "1/√kg") for k in range(test.shapes.shape[1]))]
    rows = [
        [f"point {point}", *(significant(float(value), 4) for value in test.shapes[row])]
        for row, point in enumerate(test.points)
    ]
    return text_table(head, rows)


def _input_table(test: SeveralInputsTest) -> Table:
    """Force per volt at the target, and the mean partial coherence of every response."""
    line = int(np.argmin(np.abs(test.frequency_hz - test.modes.frequencies_hz[test.target])))
    head = [
        ("Exciter", ""),
        *((f"force per volt of exciter {point}", "N/V") for point in test.exciter_points),
        *((f"γ², point {point}", "mean") for point in test.points),
    ]
    rows = [
        [
            f"point {exciter}",
            *(significant(abs(value), 4) for value in test.force_per_volt[line, column]),
            *(plain(float(value), 4) for value in test.coherence[:, column].mean(axis=1)),
        ]
        for column, exciter in enumerate(test.exciter_points)
    ]
    return text_table(head, rows, f"Forces at {test.frequency_hz[line]:.5g} Hz; partial coherence over the whole band.")


# -- figures ----------------------------------------------------------------------------------------------------------


def _response_figure(test: SeveralInputsTest, row: int) -> ReportFigure:
    point = test.points[row]
    figure, (top, bottom) = plot_panels(
        (6.3, 4.6), 2, 1, {"sharex": True, "height_ratios": (1.8, 1)},
        left=0.13, right=0.97, bottom=0.11, top=0.97, hspace=0.1,
    )  # fmt: skip
    for column, exciter in enumerate(test.exciter_points):
        f, h = thinned(test.frequency_hz, test.accelerance[row, column])
        style = {"color": _COLOURS[column % len(_COLOURS)], "linestyle": _STYLES[column % len(_STYLES)]}
        top.loglog(f, np.abs(h), label=f"force at point {exciter}", linewidth=1.3, **style)
        bottom.semilogx(f, phase_degrees(h), linewidth=1.0, **style)
    bottom.set(xlabel="frequency (Hz)", ylabel="phase (°)", ylim=(-235, 145), yticks=[-180, -90, 0, 90])
    top.set_ylabel("accelerance (m/s²/N)")
    top.legend(loc="upper left")
    title = f"Responses of point {point} to every input"
    caption = f"Acceleration at point {point} over each force, the other forces at zero."
    return report_figure(figure, f"frf-{point}", title, caption, label=f"{title} over frequency")


def _coherence_figure(test: SeveralInputsTest, column: int) -> ReportFigure:
    exciter = test.exciter_points[column]
    figure, axes = plot_panels((6.3, 3.4), left=0.13, right=0.97, bottom=0.15, top=0.96)
    for row, point in enumerate(test.points):
        # Of every stretch the lowest value: 1 − γ² is what matters.
        f, rest = thinned(test.frequency_hz, (1.0 - test.coherence[row, column]).astype(np.complex128))
        lowest: FloatArray = 1.0 - rest.real
        axes.semilogx(f, lowest, color=_COLOURS[row % len(_COLOURS)], linewidth=1.0, label=f"point {point}")
    axes.set(ylim=(-0.02, 1.05), xlabel="frequency (Hz)", ylabel="partial coherence γ²")
    axes.legend(loc="lower left", ncols=3)
    title = f"Partial coherence with the force at point {exciter}"
    caption = "The other forces are removed. Lowest value of every stretch of frequency."
    return report_figure(figure, f"coherence-{exciter}", title, caption, label=f"{title} over frequency")
