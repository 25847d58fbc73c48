"""The rigs of the how-tos load, and what the how-tos say about them is so."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import assemble
from nmt_rig.model.shaking_table import ShakingTable
from nmt_rig.reference import compute_reference, single_point_reference
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_structure

GUIDES = Path(__file__).resolve().parents[2] / "docs" / "how-to"


def rigs_of(page: str) -> dict[str, str]:
    texts = re.findall(r"```yaml\n(name:.*?)```", (GUIDES / page).read_text(encoding="utf-8"), re.S)
    return {text.split("\n")[0].removeprefix("name: "): text for text in texts}


def written(tmp_path, text):
    file = tmp_path / "rig.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_peak_of_a_frequency_response_gives_the_modal_mass(tmp_path):
    rigs = rigs_of("one-mode-model.md")
    rig = load_rig(written(tmp_path, rigs["one_mode"]))
    structure = build_structure(rig)
    omega = 2.0 * np.pi * 133.1
    q, _ = assemble(structure, [], 1).response(omega)
    peak = abs(structure.motion(1, q)) * omega**2
    assert peak == pytest.approx(142.9, abs=0.05)
    lines = np.linspace(0.98, 1.02, 20001) * omega
    response = np.array([abs(assemble(structure, [], 1).response(w)[0][0]) for w in lines[::20]])
    above = lines[::20][response >= response.max() / np.sqrt(2.0)]
    assert (above[-1] - above[0]) / (2.0 * np.pi) == pytest.approx(0.93, abs=0.02)
    two = load_rig(written(tmp_path, rigs["two_modes"]))
    np.testing.assert_allclose(np.array(linear_description(two).frequencies_rad_s) / (2 * np.pi), [133.1, 371.0])


def test_a_finite_element_model_is_read_as_the_guide_says(tmp_path):
    n = 3500
    index = np.arange(n)
    diagonal = np.full(n, 2.0)
    entries = {"indptr": np.concatenate([[0], np.cumsum(np.where((index == 0) | (index == n - 1), 2, 3))])}
    columns, values = [], []
    for i in index:
        for j, value in ((i - 1, -1.0), (i, diagonal[i]), (i + 1, -1.0)):
            if 0 <= j < n:
                columns.append(j)
                values.append(value)
    np.savez(
        tmp_path / "plate.npz",
        K_data=1e9 * np.array(values), K_indices=np.array(columns), K_indptr=entries["indptr"], K_shape=[n, n],
        M_data=np.full(n, 1e-3), M_indices=index, M_indptr=np.arange(n + 1), M_shape=[n, n],
    )  # fmt: skip
    rig = load_rig(written(tmp_path, rigs_of("one-mode-model.md")["plate"]))
    linear = linear_description(rig)
    exact = 2.0 * np.sqrt(1e9 / 1e-3) * np.sin(np.pi * np.array([1.0, 2.0]) / (2.0 * (n + 1)))
    np.testing.assert_allclose(linear.frequencies_rad_s, exact, rtol=5e-3)
    np.testing.assert_allclose(linear.damping_ratios, [0.002, 0.002], rtol=1e-9)


def test_the_peak_over_the_tables_acceleration_gives_the_participation(tmp_path):
    rig = load_rig(written(tmp_path, rigs_of("base-excitation.md")["on_table"]))
    omega = 2.0 * np.pi * 31.4
    system = assemble(build_structure(rig), [], 1, table=ShakingTable(1.57))
    q, force = system.response(omega)
    assert abs(system.motion(1, q)) * omega**2 == pytest.approx(1.57 / (2.0 * 0.004), rel=1e-9)
    assert force == pytest.approx(-1.57)


def test_the_clamped_beam_stretches_as_its_file_says():
    """k3 = E A / (2 L) (∫ φ'² dx)² with the closed form of the first shape, and the backbone of one Duffing mode."""
    rig = load_rig("clamped_beam")
    section = rig.structure
    length, area = section.length_m, section.width_m * section.height_m
    x = np.linspace(0.0, 1.0, 20001)
    root = 4.730040745
    sigma = (np.cosh(root) - np.cos(root)) / (np.sinh(root) - np.sin(root))
    shape = np.cosh(root * x) - np.cos(root * x) - sigma * (np.sinh(root * x) - np.sin(root * x))
    shape /= shape[10000]
    slope = np.gradient(shape, x)
    cubic = section.youngs_modulus_pa * area / (2.0 * length) * (np.trapezoid(slope**2, x) / length) ** 2
    assert rig.local_elements[0].stiffness_n_m3 == pytest.approx(cubic, rel=0.02)

    mass = section.density_kg_m3 * area * length * np.trapezoid(shape**2, x)
    bending = section.youngs_modulus_pa * section.width_m * section.height_m**3 / 12.0
    rest = root**2 / length**2 * np.sqrt(bending / (section.density_kg_m3 * area))
    amplitudes = np.array([1e-5, 5e-5, 1e-4])  # m√kg: up to half a millimetre
    reference = compute_reference(rig, 5, amplitudes)
    exact = np.sqrt(rest**2 + 0.75 * rig.local_elements[0].stiffness_n_m3 * amplitudes**2 / mass**2)
    np.testing.assert_allclose(reference.omega_rad_s, exact, rtol=1e-3)
    assert exact[-1] / exact[0] > 1.01


def test_a_rig_of_velocity_sensors_has_its_description_and_reference(tmp_path):
    """A laser vibrometer instead of accelerometers: what the rest of the bench asks a rig for."""
    text = rigs_of("one-mode-model.md")["two_modes"]
    text += (
        "sensors: [{quantity: force, point: drive}, {quantity: velocity, point: 1}, {quantity: velocity, point: 7}]\n"
    )
    text += "extraction: {quantity: velocity}\n"
    rig = load_rig(written(tmp_path, text))
    linear = linear_description(rig)
    assert linear.points == (1, 7)
    np.testing.assert_allclose(np.abs(linear.shape_matrix[:, 0]), [1.0, 0.8], rtol=1e-9)
    mode = single_point_reference(rig, None, [0.1]).mode
    assert mode.omega_rad_s[0] == pytest.approx(2.0 * np.pi * 133.1, rel=1e-3)
    device = SimulatedRig(rig)
    device.configure()
    device.start()
    device.read()
    device.write(DriveCommand(Waveform.SINE, 100.0, 1.0, 0.0))
    for _ in range(3):
        blocks = {block.quantity: block for block in device.read()}
    device.close()
    assert blocks[Quantity.VELOCITY].channels == ("v1", "v7")
    assert blocks[Quantity.VELOCITY].unit == "m/s"
    assert np.abs(blocks[Quantity.VELOCITY].data).max() > 0.0
