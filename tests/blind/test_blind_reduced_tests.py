"""Tables and decays of the generator against closed forms: a linear mode, and a Duffing oscillator."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmt_blind.cases.blind_rigs import blind_rig
from nmt_blind.cases.injected_effects import INJECTED_EFFECTS
from nmt_blind.cases.operating import operating_point
from nmt_blind.cases.reduced_tests import (
    BenchRig,
    backbone_of,
    free_decay,
    fundamental,
    record_ring_down,
    record_tables,
    settle,
    stepped_lines,
)
from nmt_blind.cases.rig_edits import Edit, with_edits
from nmt_core.vocabulary import TestKind
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.reduced.observables import observable_tables
from nmt_record.windows.segments import segments
from nmt_rig.rig import ModalSection, Rig

BLIND = blind_rig("modal_beam")
MODEL = BLIND.model()
CUBIC = 2e9


def quiet(rig: Rig) -> Rig:
    sensors = [s.model_copy(update={"noise_psd": 0.0, "bits": None, "range": None}) for s in rig.sensors]
    return rig.model_copy(update={"sensors": sensors, "substeps": 4})


LINEAR = quiet(MODEL)
DUFFING = with_edits(
    LINEAR, (Edit(("local_elements",), {"kind": "cubic_spring", "point": 4, "stiffness_n_m3": CUBIC}, "append"),)
)


def response(frequencies: np.ndarray, point: int, drive: int) -> np.ndarray:
    """Acceleration over force of the modal model, by the sum over its modes."""
    structure = MODEL.structure
    assert isinstance(structure, ModalSection)
    row = {number: place for place, number in enumerate(structure.points)}
    omega = 2.0 * np.pi * frequencies
    total = np.zeros(omega.size, dtype=complex)
    for mode in structure.modes:
        own = 2.0 * np.pi * mode.frequency_hz
        shape = mode.shape[row[point]] * mode.shape[row[drive]]
        total += -(omega**2) * shape / (own**2 - omega**2 + 2j * mode.damping_ratio * own * omega)
    return total


def test_stepped_lines_are_those_of_the_modes() -> None:
    frequencies = np.array([113.0, 115.2, 115.67, 116.3, 118.5])
    lines, forces = stepped_lines(LINEAR, MODEL, 0.05, frequencies, "a3", 1)
    np.testing.assert_allclose(forces, 0.05, rtol=1e-9)
    exact = response(frequencies, 3, 3)
    assert np.abs(lines - exact).max() < 4e-3 * np.abs(exact).max()


def test_a_decay_has_the_frequency_and_damping_of_its_mode() -> None:
    decay = free_decay(LINEAR, MODEL, 0.2, 1)
    assert decay.frequency_hz == pytest.approx(115.67, rel=2e-5)
    signal = decay.data[decay.names.index("x4")]
    frequency, amplitude, damping = backbone_of(signal, decay.frequency_hz, MODEL.sample_rate_hz)
    assert amplitude.size >= 8
    assert amplitude[0] / amplitude[-1] > 5.0
    np.testing.assert_allclose(frequency, 115.67 * math.sqrt(1.0 - 0.004**2), rtol=3e-5)
    np.testing.assert_allclose(damping, 0.004, rtol=5e-3)


def test_a_decay_follows_the_backbone_of_a_duffing_oscillator() -> None:
    decay = free_decay(DUFFING, MODEL, 0.1, 1)
    signal = decay.data[decay.names.index("x4")]
    frequency, amplitude, _ = backbone_of(signal, decay.frequency_hz, MODEL.sample_rate_hz)
    # One mode: ω = ω0 + 3/8 κ a² / ω0 with κ = k3 φ² seen from the point itself.
    omega = 2.0 * np.pi * 115.67
    expected = omega + 0.375 * CUBIC * 5.191**2 * amplitude**2 / omega
    rise = 2.0 * np.pi * frequency / omega - 1.0
    assert rise[0] > 3e-3
    np.testing.assert_allclose(rise, expected / omega - 1.0, rtol=0.03, atol=2e-5)


def test_settling_finds_phase_resonance_of_a_hardening_rig() -> None:
    rig = BenchRig(DUFFING, 1)
    found = settle(rig, 0.1, 115.67, 0.004)
    assert found > 116.0
    data = rig.drive(0.1, found, 2000)
    line = fundamental(data, found / MODEL.sample_rate_hz)
    force, response = line[rig.names.index("f3")], line[rig.names.index("a3")]
    assert abs(np.angle(response / force / 1j)) < 0.01


@pytest.mark.campaign
def test_cases_have_tables_and_decays_that_the_importer_reads(tmp_path: Path) -> None:
    assert record_tables(tmp_path / "tables", DUFFING, MODEL, BLIND.bench, 5).trouble == ""
    tables = observable_tables(Bag.open(tmp_path / "tables"))
    assert [table.kind for table in tables] == ["backbone", "frf", "frf", "frf", "frf"]
    backbone, *responses = tables
    assert {"frequency_hz_std", "damping_ratio_std", "amplitude_std"} <= set(backbone.columns)
    assert [table.level_unit for table in responses] == ["N"] * 4
    assert [table.direction for table in responses] == ["up", "up", "up", "down"]
    levels = [table.level for table in responses]
    assert levels[0] < levels[1] < levels[2] == pytest.approx(levels[3], rel=1e-3)
    up, down = (table.columns for table in responses[2:])
    assert (np.diff(up["frequency_hz"]) > 0.0).all()
    assert (np.diff(down["frequency_hz"]) < 0.0).all()
    # A hardening resonance jumps later on the way up.
    peaks = [c["frequency_hz"][np.hypot(c["real"], c["imag"]).argmax()] for c in (up, down)]
    assert peaks[0] > 1.005 * peaks[1]
    assert record_ring_down(tmp_path / "decay", DUFFING, MODEL, BLIND.bench, 5).trouble == ""
    (segment,) = segments(Bag.open(tmp_path / "decay"))
    assert segment.kind is TestKind.RING_DOWN


@pytest.mark.parametrize("points", [[7], [3, 9]])
def test_truths_find_places_on_any_rig(points: list[int]) -> None:
    values = MODEL.model_dump(mode="json", exclude_none=True)
    modes = [{**mode, "shape": mode["shape"][: len(points)]} for mode in values["structure"]["modes"][:1]]
    sensors = [s for s in values["sensors"] if s["quantity"] in ("force", "voltage")]
    sensors += [{"quantity": "acceleration", "point": point} for point in points]
    rig = Rig.model_validate({
        **values, "structure": {"kind": "modal", "points": points, "modes": modes}, "sensors": sensors,
        "exciter": {**values["exciter"], "point": points[0]}, "extraction": {**values["extraction"], "linear_modes": 1},
    })  # fmt: skip
    bench = replace(BLIND.bench, levels=(0.02, 0.05), window_periods=10, duration=1.0)
    motion = operating_point(rig, bench)
    assert set(motion.displacement) == set(points)
    for point, shape in zip(points, modes[0]["shape"], strict=True):  # ω² times the mass that a point sees
        seen = modes[0].get("modal_mass_kg", 1.0) / shape**2
        assert motion.stiffness[point] == pytest.approx(motion.omega**2 * seen)
    for name in ("cubic_stiffness", "added_mass", "two_sided_gap", "response_gain", "air_drag"):
        truth = INJECTED_EFFECTS[name]
        spots = truth.spots(rig)
        assert spots
        for spot in spots:
            with_edits(rig, truth.edits(rig, motion, spot, truth.value(rig, motion, spot, 1.0)))
    assert bool(INJECTED_EFFECTS["transverse_sensitivity"].spots(rig)) == (len(points) > 1)
    assert not INJECTED_EFFECTS["clamp_compliance"].spots(rig)
