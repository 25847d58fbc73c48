"""Page of a linear test with several exciters: responses to every input, partial coherence, modes."""

from __future__ import annotations

import re

import numpy as np
import pytest

from nmt_extract.several_inputs import InputModes, SeveralInputsTest
from nmt_report.several_inputs_report import coherence_remarks, several_inputs_page
from nmt_rig.rig import load_rig

FREQUENCY = np.linspace(20.0, 400.0, 191)


def modes(frequencies: tuple[float, float], damping: float) -> InputModes:
    return InputModes(
        np.array(frequencies), np.array([damping, 1.5 * damping]), np.full(2, 2e-4), np.full(2, 3e-6),
        np.ones((4, 2, 2), dtype=complex), np.array([0.01, 0.018, 0.01, 0.01]),
    )  # fmt: skip


@pytest.fixture
def measured() -> SeveralInputsTest:
    """Two inputs, four responses; the response of point i to input j is 10 i + j in size, and γ² 0.99."""
    sizes = np.add.outer(10.0 * np.arange(1, 5), np.arange(1.0, 3.0))
    accelerance = np.repeat(sizes[..., np.newaxis].astype(complex), FREQUENCY.size, axis=2)
    per_volt = np.broadcast_to(np.array([[1.5, 0.25], [0.125, 0.75]], dtype=complex), (FREQUENCY.size, 2, 2))
    return SeveralInputsTest(
        (1, 2), (1, 2, 3, 4), FREQUENCY, accelerance, np.full(accelerance.shape, 0.99), per_volt,
        modes((99.98, 101.98), 0.003), np.array([[0.39, 0.62], [0.6, -0.38], [0.37, 0.59], [0.57, -0.36]]),
        modes((100.4, 102.3), 0.046), 0, np.array([1e-5, 2e-5], dtype=complex),
    )  # fmt: skip


def test_every_input_has_its_responses_and_its_coherence(measured: SeveralInputsTest) -> None:
    page = several_inputs_page(measured, load_rig("frame"), {"run_id": "two-shakers"})
    for point in measured.points:
        assert f"Responses of point {point} to every input" in page
    for exciter in measured.exciter_points:
        assert f"Partial coherence with the force at point {exciter}" in page
        assert f"force at point {exciter}" in page
    words = re.sub(r"<[^>]+>", " ", page)
    assert "two-shakers" in words
    assert "99.9800" in words
    assert "0.3000 %" in words
    rows = re.findall(r"<tr>.*?</tr>", page, re.DOTALL)
    cells = [re.sub(r"<[^>]+>", " ", row).split() for row in rows]
    assert ["point", "1", "1.5", "0.25", "0.9900", "0.9900", "0.9900", "0.9900"] in cells
    assert ["point", "2", "0.125", "0.75", "0.9900", "0.9900", "0.9900", "0.9900"] in cells


def test_a_low_partial_coherence_is_named_with_its_input(measured: SeveralInputsTest) -> None:
    assert coherence_remarks(measured) == []
    measured.coherence[2, 1] = 0.4
    (sentence,) = coherence_remarks(measured)
    assert sentence.startswith("The partial coherence of point 3 with the exciter at point 2 is 0.40")
    assert sentence in several_inputs_page(measured, load_rig("frame"))
