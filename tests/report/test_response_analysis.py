"""Force error of a table, sweeps that were given up, pages of responses."""

from __future__ import annotations

import numpy as np
import pytest
from markupsafe import Markup

from nmt_extract.curves.swept_response import FrequencyResponseTable
from nmt_report.response_analysis import held_force, until_given_up
from nmt_report.response_figures import Overlay, force_figure, response_figure, synthesis_figure
from nmt_report.response_page import ResponsePage, html_figures, html_table
from nmt_report.svg import figure_style


def table(force: np.ndarray, unit: str = "N") -> FrequencyResponseTable:
    hertz = 360.0 + 0.1 * np.arange(force.size)
    frf = (1.0 / (1.0 + 1j * (hertz - 365.0)))[None]
    return FrequencyResponseTable(
        10.0, unit, 0.2, hertz, force, ("a1",), frf, np.full(frf.shape, 1e-3), np.full(force.size, 2.0)
    )


def test_force_error() -> None:
    force = np.full(100, 10.0)
    force[40], force[50] = 9.8, 10.1
    held = held_force(table(force))
    assert held.worst == pytest.approx(-0.02)
    assert held.worst_at_hz == pytest.approx(364.0)
    assert held.rms == pytest.approx(np.sqrt((0.02**2 + 0.01**2) / 100))
    assert held_force(table(force, "V")) is None


def test_the_ramp_of_a_sweep_that_was_given_up_is_no_part_of_it() -> None:
    force = np.full(100, 10.0)
    force[80:] = np.linspace(9.0, 0.0, 20)
    kept = until_given_up(table(force))
    assert np.all(kept.force_n == 10.0)
    assert kept.frequency_hz.size == kept.frf.shape[1] == kept.voltage_v.size == 78
    whole = table(np.full(100, 10.0))
    assert until_given_up(whole) is whole


def test_page_is_one_file_with_what_it_is_given() -> None:
    measured = table(np.full(100, 10.0))
    overlay = Overlay("computed", 10.0, measured.frequency_hz, measured.frf * 10.0)
    with figure_style():
        figures = [
            force_figure([measured]), response_figure([measured], "a1", [overlay], "caption"),
            synthesis_figure([overlay], 0, "a1"),
        ]  # fmt: skip
    rows = html_table((("What", ""), ("much", "%")), [["<b>x</b>", "1"], [Markup("<b>y</b>"), "2"]], "note")
    page = ResponsePage("Kind", "Name <1>", "sub", ("fine", "good"), [("s", "S & T", html_figures(figures) + rows)])
    text = page.html()
    assert text == page.html()
    assert "Name &lt;1&gt;" in text
    assert "S &amp; T" in text
    assert '<td class="text">&lt;b&gt;x&lt;/b&gt;</td><td>1</td>' in text
    assert '<td class="text"><b>y</b></td><td>2</td>' in text
    assert text.count('<svg class="plot"') == 3
    assert "http" not in text.replace("http-equiv", "")
