"""An electronic oscillator as a rig, and bags of its records, through the import of other people's data."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_rig.rig import Rig, load_rig

RATE = 1e7 / 2**14
NATURAL_HZ, RATIO = 68.6, 0.047
OMEGA = 2.0 * math.pi * NATURAL_HZ

RIG = f"""
name: oscillator
sample_rate_hz: {RATE!r}
structure:
  kind: chain
  masses_kg: [1.0]
  ground_springs_n_m: [{OMEGA**2!r}]
  ground_dampers_ns_m: [{2.0 * RATIO * OMEGA!r}]
exciter: {{kind: force, point: 1, newton_per_volt: {OMEGA**2!r}}}
sensors:
  - {{quantity: force, point: drive}}
  - {{quantity: displacement, point: 1}}
  - {{quantity: voltage}}
extraction: {{quantity: displacement, linear_modes: 1}}
"""


def rig_in(folder: Path) -> Rig:
    path = folder / "rig.yaml"
    path.write_text(RIG, encoding="utf-8")
    return load_rig(path)


def imported(folder: Path, u: FloatArray, y: FloatArray, spans: list[tuple[int, int]]) -> Path:
    """Bag of voltage and displacement with ``record`` segments of sample ranges."""
    np.savez(folder / "data.npz", u=u, y=y)
    segments = "".join(f"  - {{kind: record, start: {a / RATE!r}, stop: {b / RATE!r}}}\n" for a, b in spans)
    (folder / "sidecar.yaml").write_text(
        f"rig: oscillator\nsample_rate: {RATE!r}\nfile: data.npz\nchannels:\n"
        "  - {column: u, quantity: voltage, unit: V}\n"
        "  - {column: y, quantity: displacement, unit: m, point: 1}\n"
        f"segments:\n{segments}",
        encoding="utf-8",
    )
    return write_import(read_import(folder / "sidecar.yaml"), folder / "bag", "oscillator", RIG, {})


def band_noise(samples: int, seed: int, level: float) -> FloatArray:
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    frequency = np.arange(spectrum.size) * RATE / samples
    band = (frequency > 1.0) & (frequency < 150.0)
    spectrum[band] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=int(band.sum())))
    signal = np.fft.irfft(spectrum, samples)
    return level * signal / signal.std()
