"""Linear frequency responses that an analyser has reduced, made by the closed form and measured as laboratories do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmt_bench.cli import main

# Frequency, damping ratio and mass-normalised shape at three points of a thin clamped beam.
MODES = (
    (115.67, 0.004, (2.8212, 4.5227, 5.1910)),
    (318.84, 0.003, (4.7227, 3.9926, 0.0)),
    (625.06, 0.003, (4.4806, -0.8455, -4.5956)),
)
DRIVEN = 1  # the second point
WIDE = np.arange(60.0, 700.0, 2.0)
NARROW = np.arange(100.0, 135.0, 0.25)
NOISE, NOISE_EVERYWHERE = 5e-3, 2e-3


def receptance(hz: np.ndarray, point: int, mass: float = 0.0) -> np.ndarray:
    """Displacement over force, with a mass added at the first point (Sherman and Morrison's formula)."""
    omega = 2.0 * np.pi * hz

    def plain(one: int, other: int) -> np.ndarray:
        return np.asarray(
            sum(
                shape[one] * shape[other] / ((2 * np.pi * f) ** 2 - omega**2 + 4j * np.pi * f * ratio * omega)
                for f, ratio, shape in MODES
            )
        )

    inertia = -(omega**2) * mass
    return plain(point, DRIVEN) - plain(point, 0) * inertia / (1.0 + inertia * plain(0, 0)) * plain(0, DRIVEN)


def diagnosed(
    folder: Path,
    seed: int,
    hz: np.ndarray = WIDE,
    modes: int = 3,
    stated: bool = True,
    gain: float = 1.0,
    skew: float = 0.0,
    mass: float = 0.0,
) -> dict[str, Any]:
    """The diagnosis of accelerations at two points and a displacement at the third.

    Gains scatter by 1 %, phases by 0.2°, single delays by 5 µs; sensors of a kind are up to 100 µs late. ``gain`` and
    ``skew`` are those of the first channel beyond that.
    """
    random = np.random.default_rng(seed)
    late_force, late_acceleration, late_displacement = random.uniform(-1e-4, 1e-4, 3)
    shape = "".join(
        f"    - {{frequency_hz: {f}, damping_ratio: {z}, shape: {list(own)}}}\n" for f, z, own in MODES[:modes]
    )
    (folder / "model.yaml").write_text(
        f"name: thin_beam\nstructure:\n  kind: modal\n  points: [1, 2, 3]\n  modes:\n{shape}"
        "exciter: {kind: force, point: 2, newton_per_volt: 1.0}\n"
        "sensors:\n  - {quantity: force, point: drive}\n  - {quantity: acceleration, point: 1}\n"
        "  - {quantity: acceleration, point: 2}\n  - {quantity: displacement, point: 3}\n"
        f"extraction: {{quantity: acceleration, harmonics: 3, linear_modes: {min(modes, 2)}}}\n",
        encoding="utf-8",
    )
    segments = []
    for point in range(3):
        accelerates = point < 2
        delay = (late_acceleration if accelerates else late_displacement) - late_force + 5e-6 * random.standard_normal()
        factor = (1.0 + 0.01 * random.standard_normal()) * np.exp(1j * np.radians(0.2) * random.standard_normal())
        if point == 0:
            factor, delay = factor * gain, delay + skew
        omega = 2.0 * np.pi * hz
        response = receptance(hz, point, mass) * factor * np.exp(-1j * omega * delay)
        if accelerates:
            response = response * -(omega**2)
        std = np.hypot(NOISE * np.abs(response), NOISE_EVERYWHERE * np.median(np.abs(response)))
        response = response + std * (random.standard_normal(hz.size) + 1j * random.standard_normal(hz.size))
        columns = [hz, response.real, response.imag, *([std, std] if stated else [])]
        header = "frequency_hz,real,imag" + (",real_std,imag_std" if stated else "")
        np.savetxt(folder / f"p{point + 1}.csv", np.column_stack(columns), delimiter=",", header=header, comments="")
        unit = "m/s^2/N" if accelerates else "m/N"
        segments.append(
            f"  - {{kind: frf, file: p{point + 1}.csv, unit: {unit}, point: {point + 1}, drive_point: 2, "
            f"name: point {point + 1}}}\n"
        )
    (folder / "sidecar.yaml").write_text(
        "rig: model.yaml\nfile: p1.csv\nsegments:\n" + "".join(segments), encoding="utf-8"
    )
    assert main(["import", str(folder / "sidecar.yaml"), "--out", str(folder / "imported")]) == 0
    words = ["--model", str(folder / "model.yaml"), "--real", str(folder / "imported")]
    assert main(["diagnose", "--quiet", "--jobs", "1", *words, "--out", str(folder / "diagnosis")]) in (0, 1)
    found: dict[str, Any] = json.loads((folder / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    return found


@pytest.mark.campaign
@pytest.mark.parametrize(("seed", "stated"), [(100, True), (100, False), (101, True), (101, False)])
def test_sensors_within_their_tolerances_are_no_gap(tmp_path: Path, seed: int, stated: bool) -> None:
    found = diagnosed(tmp_path, seed, stated=stated)
    assert found["verdict"] in ("none", "calibration")
    assert not found["warnings"]


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [101, 106])
def test_modes_outside_the_band_are_no_gap(tmp_path: Path, seed: int) -> None:
    """The model has the first mode only; the others add a tenth to a third of it at the ends of the band."""
    assert diagnosed(tmp_path, seed, NARROW, modes=1)["verdict"] in ("none", "calibration")


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("label", "wrong"),
    [
        ("response_gain", {"gain": 0.9}),
        ("channel_skew", {"skew": 4e-4}),
        ("added_mass", {"mass": 2e-3}),
        # Resonances a tenth lower, by ten of their widths and more.
        ("added_mass", {"mass": 1e-2}),
    ],
)
def test_what_leaves_the_tolerances_is_named(tmp_path: Path, label: str, wrong: dict[str, float]) -> None:
    found = diagnosed(tmp_path, 100, **wrong)
    assert found["verdict"] == "effect"
    first = found["ranking"][0]
    assert label == first["effect"] or label in first["equivalents"]
    assert first["probability"] > 0.6
