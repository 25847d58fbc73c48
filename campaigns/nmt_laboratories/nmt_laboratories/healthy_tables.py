"""Healthy tables of three laboratories whose stated uncertainties are 0.3 to 3 times the scatter that is there.

Made by ``python -m nmt_laboratories.campaign make --laboratory healthy``, diagnosed by ``./nmt blind laboratory``:
what it calls an alarm is an effect, or something unknown, where there is none. One structure after the other:

* clamped: a cantilever with a sticking and sliding joint, as laboratory one has it; its backbone by harmonic balance
  at the joint. In half of them the owner's joint slips at another force.
* beam, mast, strip: those of laboratory two, every second one with a model whose stiffness is off.
* free: the free beam of laboratory three in closed form, responses at three forces.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.linalg import eigh

from nmt_laboratories import laboratory_three as three
from nmt_laboratories import laboratory_two as two
from nmt_laboratories.epmc_by_receptance import nonlinear_modes

STRUCTURES = ("clamped", "beam", "free", "mast", "clamped", "strip", "free", "beam", "mast")
_ELEMENTS, _TIP = 12, 12
_TRUTH = {"kind": "healthy", "verdicts": ["none", "calibration"]}


def make_case(out: Path, seed: int) -> str:
    """Draw, measure and write the case of a seed, ``truth.yaml`` last; nothing where that is there.

    Args:
        out: gets the case's folder.
        seed: any; it chooses the structure, too.

    Returns:
        Name of the case.
    """
    draw = np.random.default_rng([seed, 0x4EA])
    structure = STRUCTURES[seed % len(STRUCTURES)]
    folder = out / f"{structure}_{seed:04d}"
    if (folder / "truth.yaml").is_file():
        return folder.name
    overstated = float(np.exp(draw.uniform(math.log(0.3), math.log(3.0))))
    folder.mkdir(parents=True, exist_ok=True)
    if structure == "clamped":
        model = clamped_beam(folder, overstated, draw)
    elif structure == "free":
        model = free_beam(folder, overstated, seed, draw)
    else:
        model = beam_mast_or_strip(folder, structure, overstated, draw)
    (folder / "model.yaml").write_text(yaml.safe_dump(model, sort_keys=False), encoding="utf-8")
    truth = _TRUTH | {"remark": f"stated uncertainties are {overstated:.2f} of the scatter"}
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth, sort_keys=False), encoding="utf-8")
    return folder.name


def beam_mast_or_strip(folder: Path, rig: str, overstated: float, draw: np.random.Generator) -> dict[str, Any]:
    """Write tables of a rig of laboratory two, and give its owner's model."""
    specimen = two.draw_specimen(rig, draw)
    injected = two.Injected(_TRUTH)
    chain = replace(two.draw_chain(specimen, draw), stated=True, overstated=overstated)
    shift = float(draw.choice((0.0, draw.uniform(0.02, 0.035) * draw.choice((-1.0, 1.0)))))
    model, _ = two.model_of(specimen, injected, shift, draw, by_modes=bool(draw.random() < 0.5))
    if rig == "strip":
        two.write_print(folder, specimen, injected, chain, draw)
    else:
        two.write_tables(folder, specimen, injected, chain, draw, absolute=False)
    return model


def free_beam(folder: Path, overstated: float, seed: int, draw: np.random.Generator) -> dict[str, Any]:
    """Write responses of laboratory three's beam about its first bending mode, and give its owner's model."""
    case = three.draw_case(seed)
    beam, chain, ratio = case["beam"], case["chain"], case["beam"].ratio(2)
    hertz = math.sqrt(beam.omega2[2]) / (2.0 * math.pi) * np.linspace(1.0 - 5.0 * ratio, 1.0 + 5.0 * ratio, 45)
    hertz, scatter = np.round(hertz, 4), float(np.exp(draw.uniform(math.log(1e-3), math.log(5e-3))))
    accelerances = [three.accelerance(beam, 2.0 * math.pi * float(f)) for f in hertz]
    segments = []
    for number, level in enumerate((0.2, 1.0, 3.0), 1):
        for sensor, point in enumerate(three.SENSORS, 1):
            turn = np.exp(-2j * math.pi * hertz * (chain["delays"][sensor] - chain["delays"][0]))
            measured = np.array([row[sensor - 1] for row in accelerances]) * turn
            measured = measured * chain["gains"][sensor] / chain["gains"][0]
            std = np.hypot(scatter * abs(measured), 2e-4 * abs(measured).max())
            measured = measured + std * (draw.standard_normal(hertz.size) + 1j * draw.standard_normal(hertz.size))
            file = f"level{number}_point{point}.csv"
            columns = [hertz, measured.real, measured.imag, overstated * std, overstated * std]
            two.print_table(folder / file, ["frequency_hz", "real", "imag", "real_std", "imag_std"], columns, 6)
            segments.append({"kind": "frf", "file": file, "unit": "m/s^2/N", "point": point, "level": level,
                             "drive_point": three.DRIVEN, "level_unit": "N", "direction": "up"})  # fmt: skip
    _write_sidecar(folder, segments)
    return three.owners_model(case["model"])


def clamped_beam(folder: Path, overstated: float, draw: np.random.Generator) -> dict[str, Any]:
    """Write the backbone of a cantilever with a joint that slides at the higher amplitudes, and give the model."""
    specimen = two.draw_specimen("mast", draw)
    mass, stiffness, _ = two.mast_matrices(specimen)
    at, first = int(draw.integers(4, 7)), 2.0 * math.pi * float(specimen.frequencies_hz[0])
    ratio = float(draw.uniform(0.003, 0.008))
    beta = 2.0 * ratio / first
    direction = np.eye(mass.shape[0])[2 * at - 2]
    bare = eigh(stiffness, mass, subset_by_index=[0, 0])[1][:, 0]
    joint = float(draw.uniform(0.05, 0.3)) * first**2 / float(bare[2 * at - 2]) ** 2
    squares, modes = eigh(stiffness + joint * np.outer(direction, direction), mass, subset_by_index=[0, 0])
    shape, omega = modes[:, 0], math.sqrt(squares[0])
    largest = specimen.largest * abs(float(shape[2 * at - 2] / shape[2 * _TIP - 2]))
    limit = joint * largest * float(draw.uniform(0.15, 0.5))
    start = (omega, beta * float(shape @ stiffness @ shape) / (2.0 * omega))
    found = nonlinear_modes(
        mass, beta * stiffness, stiffness, direction, joint, limit, largest * np.geomspace(0.05, 1.0, 34), start,
        tolerance=1e-7,
    )[::3]  # fmt: skip
    tip = np.array([abs(each.shape[2 * _TIP - 2]) for each in found])
    noise, losses, gain = 10 ** draw.uniform((-4.3, -2.0), (-3.5, -1.5)), 0.003, 1.0 + 0.01 * draw.standard_normal()
    truth = np.array([each.omega for each in found]) / (2.0 * math.pi), np.array([each.damping_ratio for each in found])
    hertz, damping = (
        value * (1.0 + size * draw.standard_normal(tip.size)) for value, size in zip(truth, noise, strict=True)
    )
    columns = [hertz, gain * tip * (1.0 + losses * draw.standard_normal(tip.size)), damping,
               overstated * noise[0] * hertz, overstated * losses * tip, overstated * noise[1] * damping]  # fmt: skip
    names = ["frequency_hz", "amplitude", "damping_ratio"]
    two.print_table(folder / "backbone.csv", names + [f"{name}_std" for name in names], columns, 6)
    _write_sidecar(folder, [{"kind": "backbone", "file": "backbone.csv", "unit": "m", "point": _TIP}])
    length, width, height = specimen.size
    slip_error = float(draw.choice((1.0, draw.uniform(0.75, 1.3))))
    return {
        "name": "clamped",
        "structure": {
            "kind": "beam", "length_m": length, "width_m": width, "height_m": height,
            "youngs_modulus_pa": specimen.modulus, "density_kg_m3": specimen.density, "elements": _ELEMENTS,
            "stiffness_damping_s": beta * (1.0 + 0.05 * float(draw.standard_normal())),
        },
        "local_elements": [
            {"name": "joint", "kind": "jenkins", "point": at, "tangential_stiffness_n_m": joint,
             "slip_force_n": limit * slip_error}
        ],
        "exciter": {"kind": "force", "point": 2},
        "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": "acceleration", "point": _TIP}],
        "extraction": {"quantity": "acceleration", "linear_modes": 1},
    }  # fmt: skip


def _write_sidecar(folder: Path, segments: list[dict[str, Any]]) -> None:
    content = {"rig": "model.yaml", "file": segments[0]["file"], "segments": segments}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
