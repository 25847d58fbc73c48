"""No gap is said beside no figure that contradicts it, and is said where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.court.small_rigs import backbone, chain_rig, chain_tables, diagnosed, one_mode_rig
from tiers import with_quick

from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.thresholds import THRESHOLDS


def contradicts_itself(found: Diagnosis) -> bool:
    """Whether no gap is said of data that lie further from the model than noise, by what matters."""
    return found.sentences[0].startswith("There is no gap that the noise") and (
        found.gap.as_given > THRESHOLDS.verdict.left_over_scale
    )


def altered(kind: str) -> Diagnosis:
    """A table whose point 3 is not what the model says: another course of its size, or of its phase."""
    tables = chain_tables(8)
    for number, table in enumerate(tables):
        if table.point != 3:
            continue
        columns, hertz = dict(table.columns), table.columns["frequency_hz"]
        response = columns["real"] + 1j * columns["imag"]
        bend = 0.4 * np.sin((hertz - 6.0) / 14.0 * 2.0 * np.pi)
        response = response * (np.exp(bend) if kind == "size" else np.exp(1j * bend))
        columns["real"], columns["imag"] = response.real, response.imag
        tables[number] = replace(table, columns=columns)
    return diagnosed(chain_rig(), tables)


@pytest.mark.court(not_said="no gap")
@pytest.mark.parametrize("kind", with_quick(["size", "phase"], "phase"))
def test_no_gap_is_said_beside_no_figure_that_contradicts_it(kind: str) -> None:
    """The course of one channel is smooth and wrong by tens of per cent: no scatter, and no noise of any scale."""
    found = altered(kind)
    assert found.verdict in (Verdict.UNKNOWN, Verdict.EFFECT)
    assert not contradicts_itself(found)


@pytest.mark.court(not_said="no gap")
def test_no_gap_is_not_said_of_limit_cycles() -> None:
    """Two amplitudes that a self-excited structure keeps: their damping is zero, and that of the model is not."""
    (table,) = backbone(11)
    columns = {name: table.columns[name][[3, 6]] for name in ("frequency_hz", "amplitude")}
    table = replace(table, columns={**columns, "damping_ratio": np.zeros(2)})
    found = diagnosed(one_mode_rig(), [table])
    assert found.verdict is Verdict.UNKNOWN
    assert "% of the damping in test 0" in found.sentences[0]


@pytest.mark.court(said="no gap")
@pytest.mark.parametrize("seed", with_quick([9, 10], 9))
def test_no_gap_is_said_of_a_healthy_table(seed: int) -> None:
    found = diagnosed(chain_rig(), chain_tables(seed))
    assert found.verdict is Verdict.NONE
    assert not contradicts_itself(found)


@pytest.mark.parametrize("damping", [True, False])
def test_no_gap_in_frequencies_alone_says_that_nothing_is_known_of_damping(damping: bool) -> None:
    (table,) = backbone(13)
    kept = {name: values for name, values in table.columns.items() if damping or not name.startswith("damping")}
    found = diagnosed(one_mode_rig(), [replace(table, columns=kept)])
    assert found.verdict is Verdict.NONE
    assert any(it.startswith("Only frequencies were compared") for it in found.sentences) is not damping
