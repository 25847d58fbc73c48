"""Operating range of a set of tests, computed by the predictor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np
from scipy.linalg import eigh

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import with_exciters
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Measurement, Observations, locked_levels
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.lateness import lateness
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import Motion, mode_under_test, ratio_if_far_off
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.rig import BeamSection, ChainSection, ForceSection, Rig
from nmt_rig.rig_model import build_system


def operating_range(
    rig: Rig,
    tests: Sequence[Measurement],
    settings: PredictionSettings | None = None,
    observations: Observations | None = None,
) -> OperatingRange:
    """Largest motion over the tests, by the model as it is.

    Phase-resonant tests by their highest and lowest level; a random test or a record by its rms through the system
    linearised at rest; an imposed motion by what it spans; backbones and decays by the amplitudes that they are given
    over, and frequency responses at a held amplitude by their largest and smallest motion, with the shape of the
    resting mode. Where windows and lines show motions less than half or more than twice as large, these are taken.
    Without any test whose motion is known, 1 mm at the mode under test.

    Args:
        rig: the model.
        tests: the tests.
        settings: of the predictor; None = a coarse mesh.
        observations: what was measured, with the frequencies of a backbone; None = the model alone.

    Raises:
        BenchError: the rig does not fit the tests.
    """
    settings = PredictionSettings(mesh_refinement=1) if settings is None else settings
    channels = tuple(
        MeasuredChannel(rig.sensor_channel(s), Quantity[s.quantity.upper()], rig.sensor_point(s)) for s in rig.sensors
    )
    points = list(rig.structure.points)
    probes = tuple(MeasuredChannel(f"probe {point}", Quantity.DISPLACEMENT, point) for point in points)
    # Without a drift: its rates are per duration, which is not known yet.
    largest: dict[str, float] = {}
    lowest: dict[str, float] = {}
    displacement = dict.fromkeys(points, 0.0)
    pairs: dict[tuple[int, int], float] = {}
    omega, force, voltage, coil, best = 0.0, 0.0, 0.0, 0.0, -1.0
    rotation = dict.fromkeys(points, 0.0)
    for number, test in enumerate(tests):
        motions = test.motions(rig, (*channels, *probes), settings, _frequency(test, number, observations))
        motions = as_measured(motions, (*channels, *probes), test, number, observations)
        for parts, frequency, drive, amplitudes, unknowns in motions:
            values = {c.name: abs(a) for c, a in zip((*channels, *probes), amplitudes, strict=True)}
            for channel, (gain, *_rest) in zip(channels, parts.channels, strict=False):
                size = values[channel.name] / abs(gain)
                largest[channel.name] = max(largest.get(channel.name, 0.0), size)
                lowest[channel.name] = min(lowest.get(channel.name, np.inf), size)
                if channel.quantity == Quantity.FORCE:
                    force = max(force, size)
            probe_values = np.array([values[f"probe {point}"] for point in points])
            complex_own = amplitudes[len(channels) :]
            for point, value in zip(points, probe_values, strict=True):
                displacement[point] = max(displacement[point], float(value))
            for (i, point), (j, other) in combinations(enumerate(points), 2):
                apart = float(abs(complex_own[j] - complex_own[i]))
                pairs[point, other] = max(pairs.get((point, other), 0.0), apart)
            voltage = max(voltage, drive)
            system = parts.system
            if system.coil is not None:
                coil = max(coil, float(abs(unknowns[system.coil])))
            if isinstance(rig.structure, BeamSection):
                for point in points:
                    rotation[point] = max(rotation[point], float(abs(unknowns[system.points[point] + 1])))
            if probe_values.max() > best:
                best, omega = float(probe_values.max()), frequency
    if best <= 0.0:
        displacement = dict.fromkeys(points, 1e-3)
        if isinstance(rig.structure, BeamSection):
            rotation = dict.fromkeys(points, 1e-3 / rig.structure.length_m)
        omega = 2.0 * np.pi * mode_under_test(rig)
    mass, inertia, pair_mass = _effective_masses(rig, omega)
    imposed = [scales for test in tests if (scales := test.imposed_scales) is not None]
    if len(imposed) == len(tests) and imposed:
        drive, force = (max(values) for values in zip(*imposed, strict=True))
        # No mode swings: what counts is the force that the motion takes, as the mass that would take it.
        moved = force / (omega**2 * drive)
        mass, pair_mass = dict.fromkeys(mass, moved), dict.fromkeys(pair_mass, moved)
        inertia = {point: moved * (drive / max(rotation[point], 1e-300)) ** 2 for point in inertia}
    spans = [span for test in tests if (span := test.span_s) is not None]
    start, stop = min((span[0] for span in spans), default=0.0), max((span[1] for span in spans), default=0.0)
    cycles = [level.cycles_before for level in locked_levels(tests)]
    return OperatingRange(
        omega=omega,
        displacement=displacement,
        rotation=rotation if isinstance(rig.structure, BeamSection) else {},
        effective_mass=mass,
        effective_inertia=inertia,
        pairs={key: (pairs.get(key, 1e-3), pair_mass[key]) for key in pair_mass},
        coil_displacement=coil if coil > 0.0 else displacement[rig.drive_point],
        total_mass=_total_mass(rig),
        voltage=float(voltage) if voltage > 0.0 else 1.0,
        force=float(force),
        channels={name: float(value) for name, value in largest.items()},
        channels_low={name: float(value) for name, value in lowest.items() if np.isfinite(value)},
        duration_s=max(stop - start, 1.0),
        cycles=max(max(cycles, default=0.0), 1.0),
        steps=_of_samples(observations, Part.STEP) if observations else {},
        limits=(_clipped_at(observations) if observations else {}) | _clipped_records(tests),
        unclipped=_unclipped(tests),
        delays=_late(observations, rig) if observations else {},
    )


def receptances(rig: Rig, pole: complex, ideal_force: bool) -> dict[int, complex]:
    """Receptance of each point of a rig at rest by a force there, at a complex frequency, m/N.

    Args:
        rig: the model.
        pole: rad/s.
        ideal_force: without its exciters.

    Raises:
        BenchError: the rig has no model.
    """
    if ideal_force:
        rig = with_exciters(rig, [ForceSection(kind="force", point=point) for point in rig.exciter_points])
    system = build_system(rig)
    stiffness = system.sticking_stiffness()
    dynamic = pole * (pole * system.mass + system.damping) + stiffness
    selectors = np.array([system.selector(point) for point in rig.structure.points])
    found = np.einsum("pn,np->p", selectors, np.linalg.solve(dynamic, selectors.T))
    return dict(zip(rig.structure.points, map(complex, found), strict=True))


def _late(observations: Observations, rig: Rig) -> dict[str, float]:
    """Delay of each channel against the voltage, or against the force where no test determines that, s."""
    found: dict[str, float] = {}
    for (number, channel), delay in lateness(observations, rig).items():
        test = observations.tests[number]
        name = test.channels[channel].name
        if name not in found or test.over_voltage:
            found[name] = delay
    return found


def _clipped_at(observations: Observations) -> dict[str, float]:
    return {name: 1.0 / value for name, value in _of_samples(observations, Part.LIMIT).items() if value > 0.0}


def _clipped_records(tests: Sequence[Measurement]) -> dict[str, float]:
    """Lowest level at which the samples of each channel of records stay, in its unit."""
    found: dict[str, float] = {}
    for channel, level in _limits(tests):
        if level > 0.0:
            found[channel] = min(found.get(channel, math.inf), level)
    return found


def _unclipped(tests: Sequence[Measurement]) -> frozenset[str]:
    """Channels of records alone whose samples stay at no level: where such a record ends, its signal turned back."""
    if any(test.record is None for test in tests):
        return frozenset()
    return frozenset({channel for channel, _ in _limits(tests)} - set(_clipped_records(tests)))


def _limits(tests: Sequence[Measurement]) -> list[tuple[str, float]]:
    """Channels of records and the level at which the samples of each stay, in its unit; 0 = nowhere."""
    records = [test.record for test in tests if test.record is not None]
    return [
        (c.name, float(level)) for record in records for c, level in zip(record.channels, record.limits, strict=False)
    ]


def _of_samples(observations: Observations, part: Part) -> dict[str, float]:
    """The largest row of a part for every channel whose samples were looked at, 0 where they show nothing."""
    rows = observations.rows
    found: dict[str, float] = {}
    for number, test in enumerate(observations.tests):
        for index, channel in enumerate(test.channels if part in test.unexcited else ()):
            selected = (rows.test == number) & (rows.channel == index)
            if selected.any():
                measured = observations.values[selected & (rows.part == part)]
                found[channel.name] = max(found.get(channel.name, 0.0), float(measured.max(initial=0.0)))
    return found


def _frequency(test: Measurement, number: int, observations: Observations | None) -> float:
    """Frequency of a test's smallest amplitude, Hz; NaN where it is not known."""
    if observations is None:
        return math.nan
    rows = observations.rows
    selected = np.flatnonzero(rows.test == number)
    return float(rows.frequency_hz[selected[np.argmin(rows.amplitude[selected])]]) if selected.size else math.nan


def as_measured(
    motions: list[Motion],
    channels: tuple[MeasuredChannel, ...],
    test: Measurement,
    number: int,
    observations: Observations | None,
) -> list[Motion]:
    """Motions of a test, scaled to what its own motion channels show where the model is off by more than a factor."""
    if observations is None or not motions:
        return motions
    names = [channel.name for channel in channels]
    result: list[Motion] = []
    for parts, omega, drive, amplitudes, unknowns in motions:
        ratios = [
            size / abs(amplitudes[names.index(name)])
            for name, size in test.measured_sizes(observations, number, drive).items()
            if name in names and abs(amplitudes[names.index(name)]) > 0.0
        ]
        factor = ratio_if_far_off(ratios)
        result.append((parts, omega, drive, amplitudes * factor, unknowns * factor))
    return result


def _total_mass(rig: Rig) -> float:
    structure = rig.structure
    if isinstance(structure, BeamSection):
        return structure.density_kg_m3 * structure.length_m * structure.width_m * structure.height_m
    if isinstance(structure, ChainSection):
        return float(sum(structure.masses_kg))
    return np.inf  # modes and matrices do not contain the mass along one direction


def _effective_masses(
    rig: Rig, omega: float
) -> tuple[dict[int, float], dict[int, float], dict[tuple[int, int], float]]:
    """1/φ² of the mode nearest to ω, as points, rotations and joined pairs see it (at rest, with exciter)."""
    system = build_system(rig)
    n = system.mechanical_size
    stiffness = system.sticking_stiffness()[:n, :n]
    squares, shapes = eigh(0.5 * (stiffness + stiffness.T), system.mass[:n, :n])
    nearest = int(np.argmin(np.abs(np.sqrt(np.maximum(squares, 0.0)) - omega)))
    shape = shapes[:, nearest]
    # A point at a node has no mass of its own: limited to a thousand times that of the largest.
    motion = {point: float(system.selector(point)[:n] @ shape) for point in system.point_numbers}
    floor = 1e-3 * max(abs(value) for value in motion.values()) ** 2

    def seen(value: float, least: float) -> float:
        return float(1.0 / max(value**2, least))

    mass = {point: seen(value, floor) for point, value in motion.items()}
    inertia: dict[int, float] = {}
    if isinstance(rig.structure, BeamSection):
        least = 1e-3 * max(shape[index + 1] ** 2 for index in system.points.values())
        inertia = {point: seen(shape[index + 1], least) for point, index in system.points.items()}
    pairs = {(a, b): seen(motion[b] - motion[a], floor) for a, b in joined_points(rig, system)}
    return mass, inertia, pairs


def joined_points(rig: Rig, system: ElectromechanicalSystem) -> list[tuple[int, int]]:
    """Points that an element may join: neighbours in a chain; any two of modes or matrices with a few points.

    Fewer modes than points hold the motions of the points together: what joins two of them acts as to the ground.
    """
    points = list(system.point_numbers)
    if isinstance(rig.structure, ChainSection):
        return list(pairwise(points))
    few = len(points) <= min(THRESHOLDS.prediction.most_joined_points, system.structure_size)
    return list(combinations(points, 2)) if few and not isinstance(rig.structure, BeamSection) else []
