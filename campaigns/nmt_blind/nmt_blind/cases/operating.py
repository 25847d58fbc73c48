"""How far a rig moves in its backbone test: sizes of gaps, slip and injected effects follow from it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from nmt_blind.cases.laboratory import BenchSettings
from nmt_blind.cases.quiet_tests import play_backbone, play_random, quiet
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.rig import Rig, SensorSection
from nmt_rig.rig_model import build_resting_elements, build_structure


@dataclass(frozen=True)
class Operating:
    """Motion at the highest level, by the model.

    Attributes:
        omega: rad/s.
        displacement: amplitude of each point, m.
        relative: amplitude between each point and the next higher one, m.
        rotation: slope between a point's neighbours, rad per m of spacing 1 (beams: divided by the spacing).
        stiffness: ω² times the mass of the target mode as seen from each point, N/m.
        relative_stiffness: the same as seen between each point and the next.
        channels: amplitude of each channel, recorded units; peaks: its largest value in any test.
        noise: standard deviation of each channel's noise, recorded units.
        voltage: largest drive, V.
        duration: bench time of the backbone test, s.
        cycles: drive periods in that time.
    """

    omega: float
    displacement: dict[int, float]
    relative: dict[int, float]
    rotation: dict[int, float]
    stiffness: dict[int, float]
    relative_stiffness: dict[int, float]
    channels: dict[str, float]
    peaks: dict[str, float]
    noise: dict[str, float]
    voltage: float
    duration: float
    cycles: float

    def size(self, point: int, other: int) -> float:
        """Amplitude at a point, or between it and its neighbour `other`, m."""
        return self.relative[min(point, other)] if other else self.displacement[point]

    def modal_stiffness(self, point: int, other: int) -> float:
        """Stiffness of the mode at a point, or between it and its neighbour, N/m."""
        return self.relative_stiffness[min(point, other)] if other else self.stiffness[point]


def operating_point(model: Rig, bench: BenchSettings) -> Operating:
    """Play the backbone test without noise, with a displacement probe at every point."""
    points = sorted(model.structure.points)
    probes = [SensorSection(quantity="displacement", point=point, channel=f"probe{point}") for point in points]
    rig = quiet(model, model)
    rig = rig.model_copy(update={"sensors": [*rig.sensors, *probes]})
    windows = play_backbone(rig, model, bench)
    last = max(windows)
    window = windows[last]
    amplitude = {name: abs(value) for name, value in zip(window.channels, window.amplitudes[:, 1], strict=True)}
    motion = dict(zip(window.channels, window.amplitudes[:, 1], strict=True))
    displacement = {point: float(amplitude[f"probe{point}"]) for point in points}
    following = dict(itertools.pairwise(points))
    relative = {one: float(abs(motion[f"probe{other}"] - motion[f"probe{one}"])) for one, other in following.items()}
    spacing = getattr(model.structure, "length_m", float(len(points))) / len(points)
    rotation = {}
    for place, point in enumerate(points):
        before = motion[f"probe{points[place - 1]}"] if place else 0.0
        after = motion[f"probe{following[point]}"] if point in following else None
        step = 2.0 if after is not None else 1.0
        after = motion[f"probe{point}"] if after is None else after
        rotation[point] = float(abs(after - before)) / (step * spacing)
    structure = build_structure(model)
    modes = sticking_modes(structure, build_resting_elements(model, structure), model.test.mode)
    omega = float(modes.frequencies[-1])
    shape = dict(zip(modes.points, modes.shapes[:, -1], strict=True))
    channels = {name: float(value) for name, value in amplitude.items() if not name.startswith("probe")}
    # A random test may have larger values than all locked windows.
    record = play_random(model, model, bench)
    peaks = {n: float(v) for n, v in zip(record.channels, np.abs(record.data).max(axis=1), strict=True)}
    for found in windows.values():
        for n, v in zip(found.channels, found.peaks, strict=True):
            if n in peaks:
                peaks[n] = max(peaks[n], float(v))
    return Operating(
        omega=omega,
        displacement=displacement,
        relative=relative,
        rotation=rotation,
        stiffness={point: float(omega**2 / shape[point] ** 2) for point in points},
        relative_stiffness={
            one: float(omega**2 / max((shape[other] - shape[one]) ** 2, 1e-30)) for one, other in following.items()
        },
        channels=channels,
        peaks=peaks,
        noise={model.sensor_channel(sensor): noise_deviation(model, sensor) for sensor in model.sensors},
        voltage=max(bench.levels),
        duration=window.stop_s,
        cycles=window.stop_s * omega / (2.0 * np.pi),
    )


def noise_deviation(rig: Rig, sensor: SensorSection) -> float:
    """Standard deviation of a sensor's noise, recorded units."""
    held = sensor.noise_correlation_time_s or 1.0 / rig.sample_rate_hz
    return float(np.sqrt(sensor.noise_psd / held))
