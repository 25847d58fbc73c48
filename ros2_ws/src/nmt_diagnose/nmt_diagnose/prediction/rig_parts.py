"""A rig taken apart for the predictor: linear system, coordinates with nonlinear forces, channels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.effects.calibration import with_stiffness
from nmt_diagnose.effects.rig_edit import with_exciters
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.prediction.linear_model import LinearModel, OutputRows, linear_model, moved_model
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_tables import (
    DELAY,
    FACTOR_LINEAR,
    FACTOR_QUADRATIC,
    GAIN,
    HIGH_PASS,
    LOW_PASS,
    RigTables,
    local_tables,
)
from nmt_diagnose.prediction.timed_elements import TimedElements, TimedRow, timed_rows
from nmt_rig.model.aft import LocalTables
from nmt_rig.model.assembly import (
    ElectromechanicalSystem,
    acceleration_output,
    displacement_output,
    driven_by_force,
    velocity_output,
)
from nmt_rig.model.exciter import Exciter
from nmt_rig.model.forced_response import force_rows
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements import ELEMENTS
from nmt_rig.model.local_elements.element import SLIDER_STIFFNESS, LocalElement
from nmt_rig.model.structure import Structure
from nmt_rig.rig import (
    AnyExciter,
    BeamSection,
    ChainSection,
    ForceSection,
    Rig,
    SensorSection,
    ShakerSection,
    ShakingTableSection,
)
from nmt_rig.rig_model import (
    build_elements,
    build_exciter_elements,
    build_plain_structure,
    build_structure,
    build_system,
    build_table,
    completed_structure,
    inputs_per_volt,
)

_OUTPUTS = {
    Quantity.DISPLACEMENT: displacement_output,
    Quantity.VELOCITY: velocity_output,
    Quantity.ACCELERATION: acceleration_output,
}
_INTEGRATED = (Quantity.DISPLACEMENT, Quantity.VELOCITY)
_SOFT_HZ = 1e-3  # far below every test: at 10 Hz it leads by 0.01°
IDLE = "idle"  # key of the coordinate of a rig without local forces


@dataclass(frozen=True)
class RigParts:
    """What one test needs of a rig, at one moment.

    The inputs of ``linear`` are the ``coordinates`` local forces (as forces on the structure along their directions),
    then the exciters; its outputs are the local displacements, then the channels before their sensors.

    Attributes:
        linear: poles and residues.
        tables: nonlinear forces of the first ``elements`` coordinates, for the compiled kernels of nmt_plant.
        coordinates: number r of local coordinates; with a nonlinear force factor the last two are the coil's
            displacement and the current.
        force_factor: G, G b₁, G b₂ (N/A, N/(A m), N/(A m²)); zeros without a shaker.
        channels: sensor chains (c, 4): gain, delay (s), 1/(2π f_low) (s), 2π f_high (rad/s).
        limits: (c, 3) clipping level, quantisation step, noise deviation before the converter (infinity, 0, 0 = none).
        sections: sensor of each channel in the rig (None where the rig lacks it: an ideal one is assumed).
        input_per_volt: of each exciter (m,): N per V of an ideal one, 1 with a shaker.
        saturation: of each exciter's amplifier (m,), V; infinity where it does not saturate.
        clock: 1 + clock error.
        basis: harmonic orders.
        system: the linear system that ``linear`` was made of.
        inputs: (n, r + m) input vectors.
        rows: outputs.
        keys: identity of each coordinate, to carry solutions over to another rig.
        structure: the structure alone.
        plain: the same without the damping that its section says mode by mode, and without oscillators.
        bare: structure and exciter without local elements.
        forced: a shaking table was left out of ``bare``: the input is a force.
        rig: what was taken apart, as it is at that moment.
        timed: further nonlinear forces of the first coordinates, which only the stepping through a record predicts.
    """

    linear: LinearModel
    tables: LocalTables
    coordinates: int
    force_factor: FloatArray
    channels: FloatArray
    limits: FloatArray
    sections: tuple[SensorSection | None, ...]
    input_per_volt: FloatArray
    saturation: FloatArray
    clock: float
    basis: FourierBasis
    system: ElectromechanicalSystem
    inputs: FloatArray
    rows: OutputRows
    keys: tuple[str, ...]
    structure: Structure
    plain: Structure
    bare: ElectromechanicalSystem
    forced: bool
    rig: Rig
    timed: TimedElements

    @cached_property
    def kernel_tables(self) -> RigTables:
        """What the kernels of periodic motions know of it.

        Raises:
            BenchError: a local element is only stepped through records.
        """
        self.require_balanced()
        return RigTables(self.linear.tables, self.channels, self.force_factor, self.tables)

    def require_balanced(self) -> None:
        """Refuse elements that are only stepped through records.

        Raises:
            BenchError: there is one.
        """
        if self.timed.only_in_time:
            kinds = [section.kind_name() for section in self.rig.local_elements if section.without_harmonic_balance]
            raise BenchError(f"the diagnosis' model balances no {kinds[0]} over a period; give records.")

    @cached_property
    def first_input(self) -> ComplexArray:
        """Harmonics (n_orders, m) of the inputs where the first exciter's is a sine of amplitude one."""
        result = np.zeros((self.basis.orders.size, self.saturation.size), dtype=np.complex128)
        result[self.basis.fundamental, 0] = 1.0
        return result

    @cached_property
    def resting(self) -> tuple[FloatArray, FloatArray]:
        """Stiffness ∂g/∂w and damping ∂g/∂ẇ of the local forces at rest, (r,) each."""
        stiffness, damping = np.zeros(self.coordinates), np.zeros(self.coordinates)
        for total, timed in zip((stiffness, damping), self.timed.resting(), strict=False):
            total[: timed.size] += timed
        jenkins, jenkins_start, contacts, contacts_start, kinds, parameters, sampled_start = self.tables.elements
        for i in range(jenkins_start.size - 1):
            stiffness[i] += jenkins[jenkins_start[i] : jenkins_start[i + 1], SLIDER_STIFFNESS].sum()
            for contact_stiffness, gap, _side in contacts[contacts_start[i] : contacts_start[i + 1]]:
                # A gap is counted towards its stop, whatever the side: only a preloaded stop is closed at rest.
                stiffness[i] += contact_stiffness if gap < 0.0 else 0.0
            for number in range(sampled_start[i], sampled_start[i + 1]):
                element_class = next(element for element in ELEMENTS if element.kind == kinds[number])
                at_rest = element_class.response(*parameters[number, : len(element_class.parameter_names())], 0.0, 0.0)
                stiffness[i] += at_rest[1]
                damping[i] += at_rest[2]
        return stiffness, damping


def sliding(parts: RigParts) -> tuple[FloatArray, FloatArray]:
    """As ``RigParts.resting`` where all sliders slip: they add no stiffness, (r,) each."""
    stiffness, damping = parts.resting
    elements = parts.tables.elements
    starts = elements.jenkins_start
    stuck = np.zeros(parts.coordinates)
    for i in range(starts.size - 1):
        stuck[i] = elements.jenkins[starts[i] : starts[i + 1], SLIDER_STIFFNESS].sum()
    timed = parts.timed.resting()[2]
    stuck[: timed.size] += timed
    return stiffness - stuck, damping


def resting_tangent(parts: RigParts, s: complex) -> ComplexArray:
    """∂g/∂w + s ∂g/∂ẇ at rest of each coordinate (r,)."""
    stiffness, damping = parts.resting
    return stiffness + complex(s) * damping


def rig_parts(
    rig: Rig,
    channels: Sequence[MeasuredChannel],
    basis: FourierBasis,
    settings: PredictionSettings,
    seconds: float = 0.0,
    cycles: float = 0.0,
    ideal_force: bool = False,
    near: RigParts | None = None,
    others: Sequence[RigParts] = (),
) -> RigParts:
    """Take a rig apart, as it is ``seconds`` and ``cycles`` after the start of a test.

    Args:
        rig: rig with its exciter where the test had it.
        channels: channels of the test.
        basis: harmonic orders of the local forces.
        settings: reduction and mesh.
        seconds, cycles: bench time and drive periods for the drift of slip forces and stiffness.
        ideal_force: leave out the exciter; the input is the force on the structure, N.
        near: parts of a rig from which this one differs by an infinitesimal step: its poles are followed; None = found.
        others: parts of rigs from which structures are taken where they are the same.

    Raises:
        BenchError: the rig has something the predictor does not cover.
    """
    rig = _prepared(rig, settings, seconds, ideal_force, channels)
    forced = ideal_force and isinstance(rig.exciter, ShakingTableSection)
    plain, structure, bare = _bare(rig, forced, others if near is None else (near, *others))
    system, size = bare, bare.size

    stiffness, damping = system.stiffness, system.damping
    ports = system.exciters
    forces = [list(force_rows(system, port)) for port in ports]
    local = _local_elements(rig, structure, size, seconds, cycles)
    for element, measured in local.linear:
        outer = np.outer(element.direction, element.direction)
        stiffness = stiffness + element.linear_stiffness * outer
        damping = damping + element.linear_damping * outer
        if measured:
            # What is on the side of an exciter is on that of the first.
            forces[0][0] = forces[0][0] - element.linear_stiffness * element.direction
            forces[0][1] = forces[0][1] - element.linear_damping * element.direction
    system = replace(system, stiffness=stiffness, damping=damping)

    groups, first_outside = local.groups, local.first_outside
    tables = local_tables(list(groups.values()), basis, settings.samples)
    drive = system.selector(system.drive_point)
    directions = np.array([local.directions.get(key, drive) for key in groups])
    keys = list(groups)
    elements = directions.shape[0]
    factor, varying = _force_factor(rig)
    if varying:
        extra = np.zeros((2, size))
        extra[0, cast(int, ports[0].coil)] = 1.0
        extra[1, cast(int, ports[0].current)] = 1.0
        directions = np.vstack((directions, extra))
        keys += ["coil", "current"]
    r = directions.shape[0]
    inputs = np.column_stack((directions.T, *(port.input_vector for port in ports)))

    feeds = np.zeros((len(ports), r + len(ports)))
    for number, port in enumerate(ports):
        feeds[number, r + number] = port.force.feedthrough
    feeds[0, first_outside:elements] = 1.0
    if varying:
        feeds[0, r - 2] = 1.0
    zero = np.zeros(size)
    sections = channel_sections(rig, channels)
    outputs: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = [
        (direction, zero, zero, np.zeros(r + len(ports))) for direction in directions
    ]
    volts = np.array([1.0] if forced else inputs_per_volt(rig))
    exciters = [
        _Exciter(port, (rows[0], rows[1], rows[2], feed), float(gain))
        for port, rows, feed, gain in zip(ports, forces, feeds, volts, strict=True)
    ]
    for channel, sensor in zip(channels, sections, strict=True):
        outputs.append(_channel_rows(system, channel, sensor, exciters))
    rows = OutputRows(*(np.array([row[i] for row in outputs]) for i in range(4)))
    linear = None if near is None else moved_model(near.linear, near.system, system, inputs, rows)
    return RigParts(
        linear=linear or linear_model(system, inputs, rows, settings.kept_modes, settings.full_size),
        tables=tables,
        coordinates=r,
        force_factor=factor,
        channels=channel_table(sections),
        limits=limit_table(sections, rig.sample_rate_hz),
        sections=sections,
        input_per_volt=volts,
        saturation=np.array([_saturation(exciter) for exciter in rig.all_exciters]),
        clock=1.0 + rig.clock_error,
        basis=basis,
        system=system,
        inputs=inputs,
        rows=rows,
        keys=tuple(keys),
        structure=structure,
        plain=plain,
        bare=bare,
        forced=forced,
        rig=rig,
        timed=local.timed,
    )


def _bare(rig: Rig, forced: bool, others: Sequence[RigParts]) -> tuple[Structure, Structure, ElectromechanicalSystem]:
    """Structure without what completes it, with that, and with its exciter; of others where they have the same."""
    without = rig.model_copy(update={"local_elements": []})
    alike = [parts for parts in others if same_masses(rig, parts.rig)]
    equal = [parts for parts in alike if _equal_structures(rig, parts.rig)]
    if equal:
        plain, structure = equal[0].plain, equal[0].structure
    else:
        same = (parts.plain for parts in alike if _equal_structures(rig, parts.rig, but_for=_COMPLETED))
        plain = next(same, None) or build_plain_structure(without)
        structure = completed_structure(plain, without)
    known = (parts.bare for parts in equal if rig.all_exciters == parts.rig.all_exciters and parts.forced == forced)
    bare = next(known, None)
    if bare is None:
        bare = build_system(without, structure)
        bare = driven_by_force(bare) if forced else bare
    return plain, structure, bare


_COMPLETED = frozenset(("damping_factors", "frequency_factors", "loss_factor", "oscillators"))


def _equal_structures(rig: Rig, other: Rig, but_for: frozenset[str] = frozenset()) -> bool:
    """Whether the sections of two structures are equal, but for some keys."""
    a, b = rig.structure, other.structure
    return a is b or (
        type(a) is type(b) and all(value == getattr(b, key) for key, value in a.__dict__.items() if key not in but_for)
    )


def same_motion(rig: Rig, other: Rig) -> bool:
    """Whether two rigs have equal systems with equal local elements: no more than sensors and clock differ."""
    return (
        _equal_structures(rig, other)
        and rig.all_exciters == other.all_exciters
        and rig.local_elements == other.local_elements
        and rig.drift == other.drift
        and same_masses(rig, other)
    )


def same_masses(rig: Rig, other: Rig) -> bool:
    """Whether two rigs have equal masses of sensors on their structures, and exciters at the same points."""
    if rig.exciter_points != other.exciter_points:
        return False
    return rig.sensors is other.sensors or (
        len(rig.sensors) == len(other.sensors)
        and all(
            a is b or (a.quantity, a.point, a.mass_kg) == (b.quantity, b.point, b.mass_kg)
            for a, b in zip(rig.sensors, other.sensors, strict=True)
        )
    )


def with_elements_of(
    parts: RigParts, rig: Rig, settings: PredictionSettings, seconds: float = 0.0, cycles: float = 0.0
) -> RigParts:
    """Parts of a rig that differs from that of ``parts`` in numbers of its nonlinear elements or their drift only."""
    local = _local_elements(rig, parts.structure, parts.system.size, seconds, cycles)
    tables = local_tables(list(local.groups.values()), parts.basis, settings.samples)
    return replace(parts, tables=tables, timed=local.timed)


@dataclass(frozen=True)
class _Local:
    """Local elements of a rig.

    Attributes:
        groups: nonlinear elements by the coordinate they act on; keys name coordinates across meshes and rigs.
        directions: of each coordinate that has a force.
        first_outside: number of the first coordinate on the exciter's side.
        linear: springs and dampers, and whether the force sensor measures them.
        timed: what only the stepping through a record predicts, by coordinate.
    """

    groups: dict[str, list[LocalElement]]
    directions: dict[str, FloatArray]
    first_outside: int
    linear: list[tuple[LocalElement, bool]]
    timed: TimedElements


def _local_elements(rig: Rig, structure: Structure, size: int, seconds: float, cycles: float) -> _Local:
    slip = (1.0 + rig.drift.slip_force_per_s * seconds) * (1.0 + rig.drift.slip_force_per_cycle * cycles)
    slip = max(slip, 1e-6)
    inside: dict[str, list[LocalElement]] = {}
    outside: dict[str, list[LocalElement]] = {}
    linear: list[tuple[LocalElement, bool]] = []
    timed: dict[str, list[TimedRow]] = {}
    directions: dict[str, FloatArray] = {}
    for section in rig.local_elements:
        rows = timed_rows(section, structure)
        if section.without_harmonic_balance and not rows:
            raise BenchError(
                f"the diagnosis' model does not cover local element {section.kind}; leave it out of the model."
            )
        behind = section.side == "exciter"
        # The lateral force that the sensor measures does not include a moment.
        measured = behind and not section.rotation
        groups = outside if measured else inside
        key = f"{section.point} {section.other_point} {section.rotation} {section.reversed} {measured}"
        direction = np.zeros(size)
        along = section.direction(structure)
        direction[: along.shape[0]] = along
        directions[key] = direction
        if rows:
            groups.setdefault(key, [])
            timed.setdefault(key, []).extend(rows)
        if section.without_harmonic_balance:
            continue
        build = build_exciter_elements if behind else build_elements
        for element in build(rig.model_copy(update={"local_elements": [section]}), structure):
            if element.linear:
                linear.append((element.along(direction), measured))
                continue
            groups.setdefault(key, []).append(element.with_slip_force(slip).along(direction))
    groups = {**inside, **outside}
    # One coordinate without force keeps the kernels free of special cases.
    first_outside = len(inside) if groups else 1
    groups = groups or {IDLE: []}
    return _Local(
        groups, directions, first_outside, linear, TimedElements(tuple(tuple(timed.get(key, ())) for key in groups))
    )


def _prepared(
    rig: Rig, settings: PredictionSettings, seconds: float, ideal_force: bool, channels: Sequence[MeasuredChannel]
) -> Rig:
    """Mesh as fine as wanted, stiffness as it is now, ideal force if asked for."""
    update: dict[str, object] = {}
    structure = rig.structure
    change: dict[str, object] = {}
    if isinstance(structure, BeamSection) and structure.mesh_refinement < settings.mesh_refinement:
        change["mesh_refinement"] = settings.mesh_refinement
    factor = 1.0 + rig.drift.stiffness_per_s * seconds
    if factor != 1.0:
        change.update(_scaled_stiffness(rig, factor))
    if change:
        update["structure"] = structure.model_copy(update=change)
    if ideal_force and any(isinstance(exciter, ShakerSection) for exciter in rig.all_exciters):
        rig = with_exciters(rig, [ForceSection(kind="force", point=point) for point in rig.exciter_points])
    if isinstance(rig.exciter, ShakingTableSection):
        table = build_table(rig, build_structure(rig))
        assert table is not None
        dynamic = rig.exciter.bandwidth_hz is not None or rig.exciter.suspension_hz is not None
        by_voltage = any(channel.quantity == Quantity.VOLTAGE for channel in channels)
        if dynamic and by_voltage and not ideal_force:
            raise BenchError(
                "the diagnosis' model takes the shaking table as ideal: leave bandwidth_hz and suspension_hz out of "
                "the model, or the voltage out of the recording."
            )
        # The effective mass is that of the whole rig: the joints are taken out of it later.
        # Where an absolute displacement is measured the table has a position: that of one on a suspension so soft that
        # its lead is none. Sensors of the rig count, too, for which the bench's own table has a stiffer one.
        quantities = {c.quantity for c in channels} | {Quantity[s.quantity.upper()] for s in rig.sensors}
        absolute = rig.exciter.responses == "absolute" and not quantities.isdisjoint(_INTEGRATED)
        suspension = _SOFT_HZ if absolute else None
        ideal = {"bandwidth_hz": None, "suspension_hz": suspension, "effective_mass_kg": table.effective_mass}
        update["exciter"] = rig.exciter.model_copy(update=ideal)
    return rig.model_copy(update=update) if update else rig


def _scaled_stiffness(rig: Rig, factor: float) -> dict[str, object]:
    """Keys of the structure with all its stiffness times ``factor`` and its damping as it was."""
    structure = rig.structure
    if isinstance(structure, BeamSection):
        change: dict[str, object] = {
            "youngs_modulus_pa": structure.youngs_modulus_pa * factor,
            "stiffness_damping_s": structure.stiffness_damping_s / factor,
        }
        for key in ("clamp_rotational_stiffness_nm_rad", "clamp_lateral_stiffness_n_m"):
            value = getattr(structure, key)
            if value is not None:
                change[key] = value * factor
        return change
    if not isinstance(structure, ChainSection):
        return with_stiffness(structure, factor)
    change = {"springs_n_m": [value * factor for value in structure.springs_n_m]}
    if structure.ground_springs_n_m is not None:
        change["ground_springs_n_m"] = [value * factor for value in structure.ground_springs_n_m]
    return change


def exciter_of(sensor: SensorSection | None) -> int:
    """Number of the exciter that a voltage or current belongs to, from 0."""
    return 0 if sensor is None or sensor.exciter is None else sensor.exciter - 1


@dataclass(frozen=True)
class _Exciter:
    """An exciter among inputs and outputs: rows and feedthrough of its force, input for 1 V."""

    port: Exciter
    force: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
    volts: float


def _force_factor(rig: Rig) -> tuple[FloatArray, bool]:
    """G, G b₁, G b₂ of the shaker, and whether it varies."""
    factor = np.zeros(3)
    for exciter in rig.all_exciters:
        if isinstance(exciter, ShakerSection):
            g = exciter.force_factor_n_a
            factor[:] = g, g * exciter.force_factor_linear_per_m, g * exciter.force_factor_quadratic_per_m2
            if np.any(factor[[FACTOR_LINEAR, FACTOR_QUADRATIC]]) and len(rig.all_exciters) > 1:
                raise BenchError(
                    "the diagnosis' model covers a force factor that varies with one exciter only; leave "
                    "force_factor_linear_per_m and force_factor_quadratic_per_m2 out of the model."
                )
    return factor, bool(factor[FACTOR_LINEAR] != 0.0 or factor[FACTOR_QUADRATIC] != 0.0)


def _saturation(exciter: AnyExciter) -> float:
    value = exciter.amplifier_saturation_v if isinstance(exciter, ShakerSection) else None
    return math.inf if value is None else float(value)


def _sensor(rig: Rig, channel: MeasuredChannel, named: dict[str, SensorSection]) -> SensorSection | None:
    """The rig's sensor of a channel: by name, else by quantity and point."""
    if channel.ideal:
        return None
    if channel.name in named:
        return named[channel.name]
    for sensor in rig.sensors:
        if Quantity[sensor.quantity.upper()] == channel.quantity and (
            rig.sensor_point(sensor) == channel.point
            or (channel.quantity == Quantity.FORCE and len(rig.all_exciters) == 1)
        ):
            return sensor
    return None


def channel_sections(rig: Rig, channels: Sequence[MeasuredChannel]) -> tuple[SensorSection | None, ...]:
    """The rig's sensor of each channel; None where it has none."""
    named = {rig.sensor_channel(sensor): sensor for sensor in rig.sensors}
    return tuple(_sensor(rig, channel, named) for channel in channels)


def channel_table(sections: Sequence[SensorSection | None]) -> FloatArray:
    """Sensor chains (c, 4): gain, delay (s), time constant of the low-pass (s), corner of the high-pass (rad/s)."""
    table = np.zeros((len(sections), 4))
    table[:, GAIN] = 1.0
    for row, sensor in zip(table, sections, strict=True):
        if sensor is None:
            continue
        if sensor.dead_zone > 0.0 or sensor.dropped_fraction > 0.0 or sensor.crosstalk_per_volt != 0.0:
            raise BenchError(
                f"the diagnosis' model does not cover a {sensor.quantity} sensor with dead_zone, dropped_fraction or "
                "crosstalk_per_volt; leave these keys out of the model."
            )
        row[GAIN] = sensor.gain
        row[DELAY] = sensor.delay_s
        row[LOW_PASS] = 0.0 if sensor.low_pass_hz is None else 1.0 / (2.0 * np.pi * sensor.low_pass_hz)
        row[HIGH_PASS] = 0.0 if sensor.high_pass_hz is None else 2.0 * np.pi * sensor.high_pass_hz
    return table


def limit_table(sections: Sequence[SensorSection | None], sample_rate: float) -> FloatArray:
    """Clipping level, quantisation step and noise deviation of each channel (c, 3)."""
    table = np.zeros((len(sections), 3))
    table[:, 0] = np.inf
    for row, sensor in zip(table, sections, strict=True):
        if sensor is None:
            continue
        levels = [value for value in (sensor.clip, sensor.range) if value is not None]
        if levels:
            row[0] = min(levels)
        if sensor.bits is not None and sensor.range is not None:
            row[1] = 2.0 * sensor.range / 2.0**sensor.bits
        held = sensor.noise_correlation_time_s or 1.0 / sample_rate
        row[2] = math.sqrt(sensor.noise_psd / held)
    return table


def _channel_rows(
    system: ElectromechanicalSystem,
    channel: MeasuredChannel,
    sensor: SensorSection | None,
    exciters: Sequence[_Exciter],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Displacement, velocity, acceleration rows and feedthrough of a channel before its sensor's electronics."""
    zero = np.zeros(system.size)
    feed = np.zeros_like(exciters[0].force[3])
    inputs = feed.size - len(exciters)
    quantity = channel.quantity
    if quantity == Quantity.FORCE:
        mass = 0.0 if sensor is None else sensor.mass_kg
        # One exciter has one force, whatever point its channel names.
        at = next((exciter for exciter in exciters if exciter.port.point == channel.point), exciters[0])
        displacement, velocity, acceleration, through = at.force
        return displacement, velocity, acceleration + mass * system.selector(at.port.point), through
    number = exciter_of(sensor)
    if quantity == Quantity.VOLTAGE:
        feed[inputs + number] += 1.0 / exciters[number].volts
        return zero, zero, zero, feed
    if quantity == Quantity.CURRENT:
        current = exciters[number].port.current
        if current is None:
            raise BenchError(f"channel {channel.name} is a current, but the model has no electrodynamic_shaker.")
        row = zero.copy()
        row[current] = 1.0
        return row, zero, zero, feed
    if channel.point not in system.point_numbers:
        raise BenchError(
            f"channel {channel.name} sits at point {channel.point}, but the model's structure has points 1 to "
            f"{max(system.point_numbers)}; give the model of this rig."
        )
    output = _OUTPUTS.get(quantity)
    if output is None:
        raise BenchError(f"channel {channel.name} is of a quantity that no sensor measures.")
    try:
        motion = output(system, channel.point)
        if sensor is not None and sensor.transverse is not None:
            motion = motion.plus(output(system, sensor.transverse.point), sensor.transverse.fraction)
    except ValueError as error:
        raise BenchError(f"the diagnosis' model does not cover channel {channel.name}: {error}.") from error
    feed[inputs] += motion.feedthrough
    return motion.displacement, motion.velocity, motion.acceleration, feed
