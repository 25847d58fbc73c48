"""Operating range of a set of tests, computed by the predictor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np
from scipy.linalg import eigh

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.measurements.backbone_table.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord
from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.measurements.locked_windows.predictor import PhaseResonancePredictor
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses.stepped_responses import SteppedResponses
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.prediction.lateness import lateness
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts, resting_tangent
from nmt_diagnose.prediction.rig_tables import GAIN
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import BeamSection, ChainSection, Rig
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
        observations: what was measured; tells the frequencies of a backbone, too. None = the model alone.

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
        motions = _motions(rig, test, (*channels, *probes), settings)
        if isinstance(test, BackboneTable | RecordedDecay) and test.amplitudes.size:
            motions = _given(rig, test, (*channels, *probes), settings, _frequency(rig, test, number, observations))
        motions = _as_measured(motions, (*channels, *probes), test, number, observations)
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
        omega = 2.0 * np.pi * _mode_under_test(rig)
    mass, inertia, pair_mass = _effective_masses(rig, omega)
    imposed = [scales for test in tests if (scales := _imposed_scales(test)) is not None]
    if len(imposed) == len(tests) and imposed:
        drive, force = (max(values) for values in zip(*imposed, strict=True))
        # No mode swings: what counts is the force that the motion takes, as the mass that would take it.
        moved = force / (omega**2 * drive)
        mass, pair_mass = dict.fromkeys(mass, moved), dict.fromkeys(pair_mass, moved)
        inertia = {point: moved * (drive / max(rotation[point], 1e-300)) ** 2 for point in inertia}
    start = [test.levels[0].start_s if isinstance(test, LockedWindows) else getattr(test, "start_s", 0.0)
             for test in tests if not (isinstance(test, LockedWindows) and not test.levels)]  # fmt: skip
    stop = [max((level.stop_s for level in test.levels), default=0.0) if isinstance(test, LockedWindows)
            else getattr(test, "stop_s", 0.0) for test in tests]  # fmt: skip
    cycles = [level.cycles_before for test in tests if isinstance(test, LockedWindows) for level in test.levels]
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
        duration_s=max(max(stop, default=0.0) - min(start, default=0.0), 1.0),
        cycles=max(max(cycles, default=0.0), 1.0),
        steps=_of_samples(observations, Part.STEP) if observations else {},
        limits=(_clipped_at(observations) if observations else {}) | _clipped_records(tests),
        unclipped=_unclipped(tests),
        delays=_late(observations, rig) if observations else {},
    )


def _late(observations: Observations, rig: Rig) -> dict[str, float]:
    """Delay of each channel against the voltage, or against the force where no test tells that, s."""
    found: dict[str, float] = {}
    for (number, channel), delay in lateness(observations, rig).items():
        test = observations.tests[number]
        assert isinstance(test, RandomResponses)
        name = test.channels[channel].name
        if name not in found or test.reference == "voltage":
            found[name] = delay
    return found


def _clipped_at(observations: Observations) -> dict[str, float]:
    return {name: 1.0 / value for name, value in _of_samples(observations, Part.LIMIT).items() if value > 0.0}


def _clipped_records(tests: Sequence[Measurement]) -> dict[str, float]:
    """Lowest level at which the samples of each channel of records stay, in its unit."""
    found: dict[str, float] = {}
    for test in tests:
        for channel, level in zip(test.channels, test.limits, strict=False) if isinstance(test, DrivenRecord) else ():
            if level > 0.0:
                found[channel.name] = min(found.get(channel.name, math.inf), float(level))
    return found


def _unclipped(tests: Sequence[Measurement]) -> frozenset[str]:
    """Channels of records alone whose samples stay at no level: where such a record ends, its signal turned back."""
    records = [test for test in tests if isinstance(test, DrivenRecord)]
    if len(records) < len(tests):
        return frozenset()
    known = {channel.name for test in records for channel, _ in zip(test.channels, test.limits, strict=False)}
    return frozenset(known - set(_clipped_records(tests)))


def _of_samples(observations: Observations, part: Part) -> dict[str, float]:
    """The largest row of a part for every channel whose samples were looked at, 0 where they show nothing."""
    rows = observations.rows
    found: dict[str, float] = {}
    for number, test in enumerate(observations.tests):
        if isinstance(test, LockedWindows):
            for index, channel in enumerate(test.channels):
                selected = (rows.test == number) & (rows.channel == index)
                if selected.any():
                    measured = observations.values[selected & (rows.part == part)]
                    found[channel.name] = max(found.get(channel.name, 0.0), float(measured.max(initial=0.0)))
    return found


Motion = tuple[RigParts, float, float, np.ndarray, np.ndarray]


def _motions(
    rig: Rig, test: Measurement, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings
) -> list[Motion]:
    """Parts, ω, drive, channel amplitudes and unknowns at the ends of a test."""
    if isinstance(test, LockedWindows):
        return _resonant(rig, test, channels, settings)
    if isinstance(test, SteppedResponses):
        return _stepped(rig, test, channels, settings)
    if isinstance(test, RandomResponses):
        return _noise(rig, test.drive_point, channels, settings, 2.0 * np.pi * test.lines_hz, test.drive_rms,
                      test.reference == "force")  # fmt: skip
    if isinstance(test, ImposedMotion):
        return _imposed(rig, test, channels, settings)
    if isinstance(test, DrivenRecord):
        lines = 2.0 * np.pi * np.geomspace(1e-3, 0.4, 200) * test.sample_rate
        ideal = test.input_channel.quantity == Quantity.FORCE
        return _noise(rig, test.drive_point, channels, settings, lines, float(np.std(test.input)), ideal)
    return []


def _imposed_scales(test: Measurement) -> tuple[float, float] | None:
    """Displacement (m) and force (N) of an imposed motion, the largest; None of other tests."""
    if isinstance(test, ImposedMotion):
        return test.size, test.force_n
    if isinstance(test, SteppedResponses) and test.imposed and test.reference == "force":
        order = MOTIONS[test.channels[0].quantity]
        force = float(np.max(test.levels / np.abs(test.measured[:, 0])))
        return float(np.max(test.levels / (2.0 * np.pi * test.lines_hz) ** order)), force
    return None


def _imposed(
    rig: Rig, test: ImposedMotion, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings
) -> list[Motion]:
    """Motion of the drive point at its middle frequency, in the shape that the system linearised at rest has there."""
    probe = next(i for i, c in enumerate(channels) if c.name == f"probe {test.drive_point}")
    parts = PartsCache(settings).parts(rig, Setup(test.drive_points, True, channels, FourierBasis.up_to(1)))
    omega = 2.0 * np.pi * test.frequency_hz
    q, y = _resting_response(parts, omega)
    scale = test.size / max(abs(y[probe]), 1e-300)
    return [(parts, omega, 0.0, y * scale, q * scale)]


def _resonant(
    rig: Rig, test: LockedWindows, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings
) -> list[Motion]:
    wider = LockedWindows(
        test.name, test.drive_points, test.response_channel,
        (*(c for c in channels), *(c for c in test.channels if c.name not in {k.name for k in channels})),
        test.harmonics, test.held, test.levels,
    )  # fmt: skip
    nothing = np.zeros(0, dtype=np.int64)
    empty = Rows(nothing, nothing, nothing, nothing, nothing, np.zeros(0), np.zeros(0), np.zeros(0))
    predictor = PhaseResonancePredictor(wider, empty, settings)
    cache = PartsCache(settings)
    found: list[Motion] = []
    solved = [
        (level, state)
        for level, state in zip(predictor.levels, predictor.solve(rig, cache, None), strict=True)
        if state is not None
    ]
    solved.sort(key=lambda pair: pair[1].drive)
    for level, state in {id(s): (lv, s) for lv, s in (solved[:1] + solved[-1:])}.values():
        parts = predictor.parts(rig, cache, level)
        unknowns = _unknowns(parts, state.omega, state.channels[: len(channels), 1], channels)
        found.append((parts, state.omega, state.drive, state.channels[: len(channels), 1], unknowns))
    return found


def _unknowns(
    parts: RigParts, omega: float, amplitudes: np.ndarray, channels: tuple[MeasuredChannel, ...]
) -> np.ndarray:
    """All unknowns, from the linearised system scaled to the largest probe."""
    system = parts.system
    tangent = np.abs(resting_tangent(parts, 1j * omega))
    impedance = system.stiffness + 1j * omega * system.damping - omega**2 * system.mass
    for value, direction in zip(tangent, parts.inputs.T[: parts.coordinates], strict=True):
        impedance = impedance + value * np.outer(direction, direction)
    q = np.linalg.solve(impedance, system.input_vector.astype(complex))
    probe = max(
        (i for i, channel in enumerate(channels) if channel.name.startswith("probe ")),
        key=lambda i: abs(amplitudes[i]),
    )
    return np.asarray(q * abs(amplitudes[probe]) / abs(system.motion(channels[probe].point, q)))


def _noise(
    rig: Rig,
    drive_point: int,
    channels: tuple[MeasuredChannel, ...],
    settings: PredictionSettings,
    omega: FloatArray,
    rms: float,
    ideal_force: bool,
) -> list[Motion]:
    """Rms of flat noise over the lines through the system linearised at rest."""
    cache = PartsCache(settings)
    parts = cache.parts(rig, Setup((drive_point,), ideal_force, channels, FourierBasis.up_to(1)))
    system = parts.system
    squares = np.zeros(len(channels))
    q_squares = np.zeros(system.size)
    weights = np.gradient(omega) if omega.size > 1 else np.ones(1)
    weights = weights / weights.sum()
    peak, top = omega[0], -1.0
    for w, weight in zip(omega, weights, strict=True):
        q, y = _resting_response(parts, w)
        squares += weight * np.abs(y) ** 2
        q_squares += weight * np.abs(q) ** 2
        largest = float(np.max(np.abs(q[: system.structure_size])))
        if largest > top:
            top, peak = largest, w
    scale = rms * parts.input_per_volt[0]
    amplitudes = np.sqrt(squares).astype(complex) * scale
    return [(parts, float(peak), rms, amplitudes, np.sqrt(q_squares) * scale)]


def _stepped(
    rig: Rig, test: SteppedResponses, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings
) -> list[Motion]:
    """Lines of largest and smallest motion, in the shape that the system linearised at rest has at its resonance."""
    lead = test.channels[0]
    order = MOTIONS[lead.quantity]
    motion = test.amplitudes / (2.0 * np.pi * test.lines_hz) ** order
    if not np.any(np.isfinite(motion)):
        return []
    every = (*channels, lead)
    parts = PartsCache(settings).parts(rig, Setup(test.drive_points, False, every, FourierBasis.up_to(1)))
    resting = _resting_frequencies(rig)
    found: list[Motion] = []
    for line in (int(np.nanargmax(motion)), int(np.nanargmin(motion))):
        omega = 2.0 * np.pi * _nearest(resting, float(test.lines_hz[line]))
        q, y = _resting_response(parts, omega)
        scale = float(motion[line]) * omega**order / max(abs(y[-1]), 1e-300)
        drive = float(test.levels[line]) if test.held == "voltage" else scale / parts.input_per_volt[0]
        found.append((parts, omega, drive, y[: len(channels)] * scale, q * scale))
    return found


def _given(
    rig: Rig,
    test: BackboneTable | RecordedDecay,
    channels: tuple[MeasuredChannel, ...],
    settings: PredictionSettings,
    frequency_hz: float,
) -> list[Motion]:
    """Largest and smallest of the amplitudes of a test, through the system linearised at rest at its resonance."""
    cache = PartsCache(settings)
    channel = next((c for c in channels if c.name == test.channel.name), None)
    every = channels if channel is not None else (*channels, test.channel)
    parts = cache.parts(rig, Setup(test.drive_points, False, every, FourierBasis.up_to(1)))
    resting = _resting_frequencies(rig)
    omega = 2.0 * np.pi * _nearest(resting, frequency_hz)
    q, y = _resting_response(parts, omega)
    size = abs(y[[c.name for c in every].index(test.channel.name)])
    found: list[Motion] = []
    for amplitude in (float(np.max(test.amplitudes)), float(np.min(test.amplitudes))):
        scale = amplitude / max(size, 1e-300)
        found.append((parts, omega, scale / parts.input_per_volt[0], y[: len(channels)] * scale, q * scale))
    return found


def _resting_response(parts: RigParts, omega: float) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns and channels per unit of input, of the system linearised at rest."""
    system, rows, r = parts.system, parts.rows, parts.coordinates
    tangent = resting_tangent(parts, 0j).real
    stiffness = system.stiffness + sum(
        value * np.outer(direction, direction)
        for value, direction in zip(tangent, parts.inputs.T[: parts.coordinates], strict=True)
    )
    q = np.linalg.solve(stiffness + 1j * omega * system.damping - omega**2 * system.mass, system.input_vector + 0j)
    s = 1j * omega
    y = (rows.displacement + s * rows.velocity + s * s * rows.acceleration)[r:] @ q + rows.feedthrough[r:, r]
    return q, y * parts.channels[:, GAIN]


def _frequency(rig: Rig, test: BackboneTable | RecordedDecay, number: int, observations: Observations | None) -> float:
    """Frequency of a test's smallest amplitude, Hz."""
    if isinstance(test, RecordedDecay):
        return test.frequency_hz
    if observations is not None:
        rows = observations.rows
        selected = rows.frequency_hz[(rows.test == number) & (rows.level == int(np.argmin(test.amplitudes)))]
        if selected.size and selected[0] > 0.0:
            return float(selected[0])
    return _mode_under_test(rig)


def _as_measured(
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
            for name, size in _measured_sizes(observations, test, number, drive).items()
            if name in names and abs(amplitudes[names.index(name)]) > 0.0
        ]
        ratio = float(np.median(ratios)) if ratios else 1.0
        factor = (
            ratio
            if ratio > 0.0
            and not 1.0 / THRESHOLDS.prediction.far_off_ratio <= ratio <= THRESHOLDS.prediction.far_off_ratio
            else 1.0
        )
        result.append((parts, omega, drive, amplitudes * factor, unknowns * factor))
    return result


def _measured_sizes(observations: Observations, test: Measurement, number: int, drive: float) -> dict[str, float]:
    """Amplitude, or rms, of each motion channel of a test: of a phase-resonant one at the level next to a drive."""
    rows, values = observations.rows, observations.values
    if isinstance(test, BackboneTable | RecordedDecay | DrivenRecord | SteppedResponses):
        return {}
    sizes: dict[str, float] = {}
    for index, channel in enumerate(test.channels):
        if channel.quantity not in MOTIONS:
            continue
        selected = (rows.test == number) & (rows.channel == index)
        selected &= (rows.part == Part.LOG_MAGNITUDE) & (rows.harmonic == 1)
        if not selected.any():
            continue
        if isinstance(test, LockedWindows):
            selected = np.flatnonzero(selected)
            sizes[channel.name] = math.exp(float(values[selected[np.argmin(np.abs(rows.amplitude[selected] - drive))]]))
        elif isinstance(test, RandomResponses) and int(selected.sum()) == test.lines_hz.size > 1:
            magnitude = np.empty(test.lines_hz.size)
            magnitude[rows.level[selected]] = np.exp(values[selected])
            weights = np.gradient(test.lines_hz)
            sizes[channel.name] = test.drive_rms * math.sqrt(float(weights @ magnitude**2 / weights.sum()))
    return sizes


def _resting_frequencies(rig: Rig) -> FloatArray:
    """Frequencies of the modes at rest, friction sticking, exciter attached, Hz; those of a free body left out."""
    system = build_system(rig)
    n = system.mechanical_size
    stiffness = system.sticking_stiffness()[:n, :n]
    squares = eigh(0.5 * (stiffness + stiffness.T), system.mass[:n, :n], eigvals_only=True)
    result: FloatArray = np.sqrt(squares[squares > 1e-9 * squares[-1]]) / (2.0 * np.pi)
    return result


def _nearest(resting: FloatArray, frequency_hz: float) -> float:
    """The resting frequency nearest to another one, Hz; that one itself where nothing swings."""
    return float(resting[np.argmin(np.abs(np.log(resting / frequency_hz)))]) if resting.size else frequency_hz


def _mode_under_test(rig: Rig) -> float:
    """Resting frequency of the mode that the rig file says is tested, Hz."""
    frequencies = _resting_frequencies(rig)
    if not frequencies.size:
        return 1.0
    return float(frequencies[min(max(rig.test.mode, 1), frequencies.size) - 1])


def _total_mass(rig: Rig) -> float:
    structure = rig.structure
    if isinstance(structure, BeamSection):
        return structure.density_kg_m3 * structure.length_m * structure.width_m * structure.height_m
    if isinstance(structure, ChainSection):
        return float(sum(structure.masses_kg))
    return np.inf  # modes and matrices do not tell the mass along one direction


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
    pairs = {(a, b): seen(motion[b] - motion[a], floor) for a, b in _joined(rig, system)}
    return mass, inertia, pairs


def _joined(rig: Rig, system: ElectromechanicalSystem) -> list[tuple[int, int]]:
    """Points that an element may join: neighbours in a chain; any two of modes or matrices with a few points.

    Fewer modes than points hold the motions of the points together: what joins two of them acts as to the ground.
    """
    points = list(system.point_numbers)
    if isinstance(rig.structure, ChainSection):
        return list(pairwise(points))
    few = len(points) <= min(THRESHOLDS.prediction.most_joined_points, system.structure_size)
    return list(combinations(points, 2)) if few and not isinstance(rig.structure, BeamSection) else []
