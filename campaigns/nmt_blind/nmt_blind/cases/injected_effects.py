"""What a rig may really have beyond its model: each a change of the rig file, with where and how strongly.

The names are those of the library of effects and, after them, of effects that no library has. What one local element
does stands with the element, its size in a blind case too; places and all else are chosen here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from nmt_blind.cases.operating import Operating
from nmt_blind.cases.rig_edits import Edit
from nmt_core.key_units import unit_of_key
from nmt_rig.model.element_uses import ElementEffect
from nmt_rig.model.local_elements import SECTIONS
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.model.local_elements.friction import JenkinsSection
from nmt_rig.rig import BeamSection, ChainSection, Rig, SensorSection, ShakerSection

RESPONSES = ("displacement", "velocity", "acceleration")


@dataclass(frozen=True)
class Spot:
    """Where and in which form a truth acts.

    Attributes:
        label: point, channel or form.
        point: measurement point; other: its neighbour in a chain; 0 = none.
        sensor: index of the sensor; -1 = none.
        option: which of several keys.
        shape: second parameter, relative to the motion at the spot.
    """

    label: str
    point: int = 0
    other: int = 0
    sensor: int = -1
    option: str = ""
    shape: float = 0.0


@dataclass(frozen=True)
class At:
    """A spot of a rig in its backbone test."""

    rig: Rig
    operating: Operating
    spot: Spot

    @property
    def omega(self) -> float:
        """Of the motion, rad/s."""
        return self.operating.omega

    @property
    def size(self) -> float:
        """Amplitude at the spot, m."""
        return self.operating.size(self.spot.point, self.spot.other)

    @property
    def reach(self) -> float:
        """Displacement, m, or rotation at which a gap closes or a slider slips: the spot's share of the motion."""
        turning = self.spot.option == "rotation"
        return self.spot.shape * (self.operating.rotation[self.spot.point] if turning else self.size)

    @property
    def stiffness(self) -> float:
        """Stiffness of the mode there, N/m."""
        return self.operating.modal_stiffness(self.spot.point, self.spot.other)

    @property
    def sensor(self) -> SensorSection:
        """The sensor."""
        return self.rig.sensors[self.spot.sensor]


Spots = Callable[[Rig], tuple[Spot, ...]]
Edits = Callable[[At, float], tuple[Edit, ...]]
Guess = Callable[[At], float]
Figures = Callable[[At, float], dict[str, float]]


@dataclass(frozen=True)
class InjectedEffect:
    """One kind of truth.

    Attributes:
        name: fixed name.
        place: structure, boundary, joint, exciter, force_sensor, response_sensor, controller or time.
        unit: unit of the value.
        spots: where it may act on a rig; none = not on this one.
        changes: what is changed at a value.
        natural: the value of size 1: a share of the mode's own force at the largest amplitude, or what a
            laboratory would call large.
        estimated: what a diagnosis has to find, see `figures`.
        signed: the value may be negative.
        largest: largest value that makes sense; bound: the same where it depends on rig and spot.
        known: the library of the diagnosis is supposed to have it.
    """

    name: str
    place: str
    unit: str
    spots: Spots
    changes: Edits
    natural: Guess
    estimated: Figures = lambda at, value: {}
    signed: bool = False
    largest: float = math.inf
    known: bool = True
    bound: Guess | None = None

    def edits(self, rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
        """What is changed at a value."""
        return self.changes(At(rig, operating, spot), value)

    def value(self, rig: Rig, operating: Operating, spot: Spot, size: float) -> float:
        """The value of a size, at most what makes sense there."""
        return min(size * self.natural(At(rig, operating, spot)), self.limit(rig, operating, spot))

    def figures(self, rig: Rig, operating: Operating, spot: Spot, value: float) -> dict[str, float]:
        """True values of the parameters that a diagnosis reports, by the names of the effects' equations.

        Empty where a truth has none in the same terms: what nobody names, and what counts from the model's amplitude.
        """
        return self.estimated(At(rig, operating, spot), value)

    def limit(self, rig: Rig, operating: Operating, spot: Spot) -> float:
        """Largest value that makes sense at a spot of a rig."""
        return self.largest if self.bound is None else min(self.largest, self.bound(At(rig, operating, spot)))

    def place_at(self, rig: Rig, spot: Spot) -> str:
        """Place, with channels sorted into force and response sensors."""
        if self.place == "response_sensor" and spot.sensor >= 0 and rig.sensors[spot.sensor].quantity == "force":
            return "force_sensor"
        return self.place


# Where ------------------------------------------------------------------------------------------------------------


def _everywhere(rig: Rig) -> tuple[Spot, ...]:
    return (Spot(""),)


def _sites(shapes: tuple[float, ...] = (0.0,)) -> Spots:
    """Points that move: of a chain the last one and its first two neighbours, of others beyond the drive point."""

    def spots(rig: Rig) -> tuple[Spot, ...]:
        found: list[Spot] = []
        for shape in shapes:
            ending = f" at {shape:g}" if shape else ""
            if isinstance(rig.structure, ChainSection):
                last = rig.structure.points[-1]
                found.append(Spot(f"{last}{ending}", last, shape=shape))
                if last > 1:
                    found.append(Spot(f"1-2{ending}", 1, 2, shape=shape))
            else:
                found += [Spot(f"{p}{ending}", p, shape=shape) for p in _free_points(rig)]
        return tuple(found)

    return spots


def _free_points(rig: Rig) -> tuple[int, ...]:
    """The next two points beyond the drive point, and the last; the joint's is left to the joint.

    Where there is none beyond the drive point, those before it; a rig of one point has that one.
    """
    points = sorted(rig.structure.points)
    joints = {element.point for element in rig.local_elements}
    free = [p for p in points if p not in joints] or points
    beyond = [p for p in free if p > rig.drive_point] or [p for p in free if p != rig.drive_point] or free
    return tuple(sorted({*beyond[:2], beyond[-1]}))


def _points(rig: Rig) -> tuple[Spot, ...]:
    ends = sorted({1, rig.structure.points[-1]})
    points = ends if isinstance(rig.structure, ChainSection) else _free_points(rig)
    return tuple(Spot(str(p), p) for p in points)


def _channels(*quantities: str) -> Spots:
    def spots(rig: Rig) -> tuple[Spot, ...]:
        return tuple(
            Spot(rig.sensor_channel(sensor), rig.sensor_point(sensor), sensor=index)
            for index, sensor in enumerate(rig.sensors)
            if sensor.quantity in quantities
        )

    return spots


def _some_channels(*quantities: str) -> Spots:
    """First and last channel of each quantity."""

    def spots(rig: Rig) -> tuple[Spot, ...]:
        found = []
        for quantity in quantities:
            channels = _channels(quantity)(rig)
            found += [channels[0], channels[-1]] if len(channels) > 1 else list(channels)
        return tuple(found)

    return spots


def _groups(rig: Rig) -> tuple[Spot, ...]:
    """Responses of a quantity that several channels have: these share a conditioner."""
    count = {name: sum(sensor.quantity == name for sensor in rig.sensors) for name in RESPONSES}
    return tuple(Spot(f"{name} channels", option=name) for name in RESPONSES if count[name] > 1)


def _sensor_masses(rig: Rig) -> tuple[Spot, ...]:
    first: dict[int, Spot] = {}
    for spot in _channels(*RESPONSES)(rig):
        first.setdefault(spot.point, spot)
    return tuple(first.values())


def _crossings(rig: Rig) -> tuple[Spot, ...]:
    """Each channel with the next measured point, the last with the one before."""
    points = sorted({rig.sensor_point(s) for s in rig.sensors if s.quantity in RESPONSES})
    if len(points) < 2:
        return ()
    found = []
    for spot in _channels(*RESPONSES)(rig):
        place = points.index(spot.point)
        other = points[place + 1] if place + 1 < len(points) else points[place - 1]
        found.append(Spot(f"{spot.label}<{other}", spot.point, other, spot.sensor))
    return tuple(found)


def _clamped(rig: Rig) -> bool:
    return isinstance(rig.structure, BeamSection) and "clamped" in rig.structure.boundary


def _clamp(rig: Rig) -> tuple[Spot, ...]:
    if not _clamped(rig):
        return ()
    return (Spot("rotation", option="rotation"), Spot("lateral", option="lateral"))


def _clamp_friction(rig: Rig) -> tuple[Spot, ...]:
    if not _clamped(rig):
        return ()
    return tuple(
        Spot(f"{option} at {shape:g}", 1, option=option, shape=shape)
        for option in ("rotation", "lateral")
        for shape in (0.1, 0.4)
    )


def _stinger(rig: Rig) -> tuple[Spot, ...]:
    lateral = Spot("lateral", rig.drive_point, option="lateral")
    if not isinstance(rig.structure, BeamSection):
        return (lateral,)
    return lateral, Spot("rotation", rig.drive_point, option="rotation")


def _shaker(rig: Rig) -> tuple[Spot, ...]:
    return (Spot(""),) if isinstance(rig.exciter, ShakerSection) else ()


def _jenkins(rig: Rig) -> tuple[Spot, ...]:
    return tuple(
        Spot(f"{element.name or element.point} with exponent {shape:g}", element.point, sensor=-1,
             option=str(index), shape=shape)
        for index, element in enumerate(rig.local_elements)
        if isinstance(element, JenkinsSection)
        for shape in (0.0, 0.4)
    )  # fmt: skip


def _joint(rig: Rig) -> tuple[Spot, ...]:
    """The largest friction element of the model."""
    forces = [getattr(element, "slip_force_n", 0.0) for element in rig.local_elements]
    if not forces or max(forces) <= 0.0:
        return ()
    index = forces.index(max(forces))
    element = rig.local_elements[index]
    return (Spot("joint", element.point, element.other_point or 0, option=str(index)),)


# What -------------------------------------------------------------------------------------------------------------


def _element(at: At, kind: str, **keys: Any) -> tuple[Edit, ...]:
    section: dict[str, Any] = {"kind": kind, "point": at.spot.point, **keys}
    if at.spot.other:
        section["other_point"] = at.spot.other
    if at.spot.option == "rotation":
        section["rotation"] = True
    return (Edit(("local_elements",), section, "append"),)


def _set(*path: str, value_of: Callable[[float], float] = lambda value: value) -> Edits:
    """One key of the rig file."""
    return lambda at, value: (Edit(path, value_of(value)),)


def _sensor(**keys: Callable[[At, float], Any]) -> Edits:
    """Keys of the spot's sensor."""
    return lambda at, value: tuple(
        Edit(("sensors", at.spot.sensor, key), value_of(at, value)) for key, value_of in keys.items()
    )


def _own(at: At, value: float) -> float:
    return value


# Density of air, kg/m³; drag coefficient of a plate that swings by about its width (Keulegan and Carpenter 1958); mass
# of a plate by its area where the rig file has no area, kg/m²: 2 mm of aluminium.
_AIR, _DRAG_COEFFICIENT, _PLATE = 1.2, 10.0, 5.4


def _largest_drag(at: At) -> float:
    """What air can do, ½ ρ C_d A: beyond it the same force has another cause, and another name."""
    beam = at.rig.structure
    if isinstance(beam, BeamSection):
        area = beam.length_m * beam.width_m
    else:
        area = at.operating.stiffness[at.spot.point] / at.omega**2 / _PLATE
    return 0.5 * _AIR * _DRAG_COEFFICIENT * area


_EXPONENT = 1.5
"""Of a power-law damper: between viscous damping and drag."""


def _power_law(at: At, value: float) -> tuple[Edit, ...]:
    """A damper that takes a force, in newtons, at the largest speed of its spot."""
    speed = at.omega * at.size
    return _element(at, "power_law_damper", coefficient_n_sp_mp=value / speed**_EXPONENT, exponent=_EXPONENT)


def _late_group(at: At, value: float) -> tuple[Edit, ...]:
    return tuple(
        Edit(("sensors", index, "delay_s"), sensor.delay_s + value)
        for index, sensor in enumerate(at.rig.sensors)
        if sensor.quantity == at.spot.option
    )


def _friction(at: At, value: float) -> tuple[Edit, ...]:
    return _element(at, "jenkins", tangential_stiffness_n_m=value, slip_force_n=value * at.reach)


def _compliance(at: At, value: float) -> tuple[Edit, ...]:
    turning = at.spot.option == "rotation"
    key = "clamp_rotational_stiffness_nm_rad" if turning else "clamp_lateral_stiffness_n_m"
    return (Edit(("structure", key), 1.0 / value),)


def _compliance_guess(at: At) -> float:
    beam = at.rig.structure
    assert isinstance(beam, BeamSection)
    bending = beam.youngs_modulus_pa * beam.width_m * beam.height_m**3 / 12.0
    power = 1 if at.spot.option == "rotation" else 3
    return 0.003 * beam.length_m**power / bending


def _microslip(at: At, value: float) -> tuple[Edit, ...]:
    path = ("local_elements", int(at.spot.option))
    joint = {"kind": "iwan", "exponent": at.spot.shape, "stiffness_ratio": 1.0 / value, "sliders": 30}
    return tuple(Edit((*path, key), entry) for key, entry in joint.items())


def _at_rotation(share: float, point_of: Callable[[At], int]) -> Guess:
    """A share of the mode's stiffness at a point, of its rotation where that is what turns."""

    def guess(at: At) -> float:
        point, motion = point_of(at), at.operating
        stiffness = share * motion.stiffness[point]
        if at.spot.option != "rotation":
            return stiffness
        return stiffness * (motion.displacement[point] / motion.rotation[point]) ** 2

    return guess


_COARSE_BITS = 22


def _drift(key: str, sign: float) -> Edits:
    return lambda at, value: (Edit(("drift", at.spot.option or key), sign * value),)


def _losses(rig: Rig) -> tuple[Spot, ...]:
    if not _joint(rig):
        return ()
    return (Spot("time", option="slip_force_per_s"), Spot("cycles", option="slip_force_per_cycle"))


def _loop_key(key: str) -> Edits:
    return lambda at, value: (Edit(("pll",), {key: value}, "merge"),)


def _share(at: At, value: float, kind: str, **keys: Any) -> tuple[Edit, ...]:
    """A share of the joint's friction taken from the model's element and given to another law."""
    path = ("local_elements", int(at.spot.option))
    return (
        Edit((*path, "tangential_stiffness_n_m"), 1.0 - value, "scale"),
        Edit((*path, "slip_force_n"), 1.0 - value, "scale"),
        *_element(at, kind, **keys),
    )


def _joint_figures(at: At) -> tuple[float, float]:
    element = at.rig.local_elements[int(at.spot.option)]
    stiffness = float(element.tangential_stiffness_n_m)  # type: ignore[union-attr]
    slip = float(element.slip_force_n)  # type: ignore[union-attr]
    return stiffness, slip


def _bouc_wen(at: At, value: float) -> tuple[Edit, ...]:
    stiffness, slip = _joint_figures(at)
    return _share(
        at, value, "bouc_wen",
        stiffness_n_m=value * stiffness, yield_displacement_m=slip / stiffness, exponent=1.0, shape=0.8,
    )  # fmt: skip


def _lugre(at: At, value: float) -> tuple[Edit, ...]:
    stiffness, slip = _joint_figures(at)
    return _share(
        at, value, "lugre",
        bristle_stiffness_n_m=value * stiffness, coulomb_force_n=0.8 * value * slip, static_force_n=1.4 * value * slip,
        stribeck_velocity_m_s=0.2 * at.omega * at.size,
    )  # fmt: skip


def _backlash(at: At, value: float) -> tuple[Edit, ...]:
    damping = value * 0.5 / at.omega / max(at.reach, 1e-12)
    return _element(at, "backlash_damper", stiffness_n_m=value, damping_ns_m2=damping, gap_m=at.reach)


def _coupling(at: At, value: float) -> tuple[Edit, ...]:
    return _element(
        at, "tuned_mass_quadratic", mass_kg=0.01 * at.stiffness / at.omega**2,
        frequency_hz=2.0 * at.omega / (2.0 * math.pi), damping_ratio=0.02, coupling_n_m2=value,
    )  # fmt: skip


def _rattle(at: At, value: float) -> tuple[Edit, ...]:
    stiffness = value * (8.0 * at.omega) ** 2
    return _element(
        at, "rattling_mass", mass_kg=value, gap_m=at.reach, contact_stiffness_n_m=stiffness,
        contact_damping_ns_m2=0.2 * stiffness / at.omega / at.reach, friction_ns_m=0.3 * value * at.omega,
    )  # fmt: skip


# Guesses ----------------------------------------------------------------------------------------------------------


def _elastic(share: float, power: int) -> Guess:
    """A force of so many parts of the modal one at the largest amplitude, growing with a power of it."""
    return lambda at: share * at.stiffness / at.size ** (power - 1)


def _viscous(share: float, power: int) -> Guess:
    return lambda at: share * at.stiffness * at.size / (at.omega * at.size) ** power


def _mass_guess(at: At) -> float:
    return 0.003 * at.operating.stiffness[at.spot.point] / at.omega**2


def _drive_guess(power: int) -> Guess:
    return lambda at: 0.02 / at.operating.displacement[at.rig.drive_point] ** power


def _constant(value: float) -> Guess:
    return lambda at: value


def _per_omega(share: float) -> Guess:
    return lambda at: share / at.omega


def _of_noise(share: float) -> Guess:
    return lambda at: share * at.operating.noise[at.spot.label]


# What is to be estimated -------------------------------------------------------------------------------------------


def _named(name: str, value_of: Callable[[float], float] = lambda value: value) -> Figures:
    return lambda at, value: {name: value_of(value)}


def _friction_figures(at: At, value: float) -> dict[str, float]:
    turning = at.spot.option == "rotation"
    size = at.operating.rotation[at.spot.point] if turning else at.size
    return {"kt": value, "slip_force": value * at.spot.shape * size}


_ANY = (*RESPONSES, "force")
_GAPS = (0.35, 0.75)
_CONTACTS = _sites((0.1, 0.4))


def _of_element(section: type[ElementSection], effect: ElementEffect) -> InjectedEffect:
    """A truth that is one local element; its shapes are shares of the motion."""
    strength, *shapes = effect.parameters
    keys = effect.parameters

    def figures(at: At, value: float) -> dict[str, float]:
        return {strength: value, **dict.fromkeys(shapes, at.reach)}

    return InjectedEffect(
        effect.name, "structure", unit_of_key(keys[strength]), _sites(_GAPS if shapes else (0.0,)),
        lambda at, value: _element(
            at, section.kind_name(), **{keys[name]: own for name, own in figures(at, value).items()}
        ),
        lambda at: effect.strength(effect.drawn_share * at.stiffness, at.size, at.omega), figures, signed=effect.signed,
    )  # fmt: skip


_STRUCTURAL_DAMPING = InjectedEffect(
    "structural_damping", "structure", "1", _everywhere, _set("structure", "loss_factor"), _constant(0.003),
    _named("eta"), largest=0.1,
)  # fmt: skip
_ADDED_MASS = InjectedEffect(
    "added_mass", "structure", "kg", _points,
    lambda at, value: (Edit(("structure", "added_masses"), {"point": at.spot.point, "mass_kg": value}, "append"),),
    _mass_guess, _named("m"),
)  # fmt: skip
_MORE: dict[str, Callable[[InjectedEffect], tuple[InjectedEffect, ...]]] = {
    "air_drag": lambda drag: (replace(drag, spots=_points, bound=_largest_drag),),
    "power_law_damping": lambda damper: (
        replace(damper, unit="N", spots=_sites(), changes=_power_law, estimated=lambda at, value: {"p": _EXPONENT}),
        _STRUCTURAL_DAMPING,
    ),
    "viscous_damping": lambda damper: (damper, _ADDED_MASS),
}
"""What a truth is beyond its element; and, next to those that they are like, truths that are none."""


def _of_elements() -> Iterator[InjectedEffect]:
    """Truths of the structure."""
    for section in SECTIONS:
        if section.effect is not None:
            truth = _of_element(section, section.effect)
            yield from _MORE[truth.name](truth) if truth.name in _MORE else (truth,)


KNOWN: tuple[InjectedEffect, ...] = (
    *_of_elements(),
    InjectedEffect("clamp_compliance", "boundary", "rad/(N m) or m/N", _clamp, _compliance, _compliance_guess,
          _named("k", lambda value: 1.0 / value)),
    InjectedEffect("clamp_friction", "boundary", "N/m or N m/rad", _clamp_friction, _friction,
          _at_rotation(0.02, lambda at: 1), _friction_figures),
    InjectedEffect("microslip", "joint", "1", _jenkins, _microslip, _constant(0.1), largest=50.0),
    InjectedEffect("second_friction_contact", "joint", "N/m", _CONTACTS, _friction, _elastic(0.02, 1),
          _friction_figures),
    InjectedEffect("preload_loss", "time", "1/s or 1/period", _losses, _drift("slip_force_per_s", -1.0),
          lambda at: 0.03 / (at.operating.duration if at.spot.label == "time" else at.operating.cycles),
          _named("rate", lambda value: -value)),
    InjectedEffect("temperature_drift", "time", "1/s", _everywhere, _drift("stiffness_per_s", 1.0),
          lambda at: 0.002 / at.operating.duration, _named("rate"), signed=True),
    InjectedEffect("stinger_stiffness", "exciter", "N/m or N m/rad", _stinger,
          lambda at, value: _element(at, "linear_spring", stiffness_n_m=value, side="exciter"),
          _at_rotation(0.01, lambda at: at.rig.drive_point), _named("k")),
    InjectedEffect("amplifier_saturation", "exciter", "1/V²", _shaker,
          _set("exciter", "amplifier_saturation_v", value_of=lambda value: value**-0.5),
          lambda at: 0.01 / at.operating.voltage**2, _named("V", lambda value: value**-0.5)),
    InjectedEffect("source_impedance", "exciter", "Ω", _shaker, _set("exciter", "source_resistance_ohm"),
          _constant(0.2), _named("R")),
    InjectedEffect("suspension_cubic", "exciter", "N/m³", _shaker,
          lambda at, value: _element(
              replace(at, spot=Spot("", at.rig.drive_point)), "cubic_spring", stiffness_n_m3=value, side="exciter"
          ),
          lambda at: (
              0.01 * at.operating.stiffness[at.rig.drive_point] / at.operating.displacement[at.rig.drive_point] ** 2
          ), _named("k"), signed=True),
    InjectedEffect("force_factor_symmetric", "exciter", "1/m²", _shaker,
          _set("exciter", "force_factor_quadratic_per_m2"), _drive_guess(2), _named("b2"), signed=True),
    InjectedEffect("force_factor_asymmetric", "exciter", "1/m", _shaker, _set("exciter", "force_factor_linear_per_m"),
          _drive_guess(1), _named("b1"), signed=True),
    InjectedEffect("force_gain", "force_sensor", "1", _channels("force"),
          _sensor(gain=lambda at, value: at.sensor.gain * (1.0 + value)), _constant(0.003), _named("g"),
          signed=True, largest=0.5),
    InjectedEffect("force_cell_mass", "force_sensor", "kg", _channels("force"), _sensor(mass_kg=_own), _mass_guess,
          _named("m")),
    InjectedEffect("response_gain", "response_sensor", "1", _channels(*RESPONSES),
          _sensor(gain=lambda at, value: at.sensor.gain * (1.0 + value)), _constant(0.003), _named("g"),
          signed=True, largest=0.5),
    InjectedEffect("transverse_sensitivity", "response_sensor", "1", _crossings,
          _sensor(transverse=lambda at, value: {"point": at.spot.other, "fraction": value}), _constant(0.003),
          _named("s"), signed=True, largest=0.3),
    InjectedEffect("sensor_mass", "response_sensor", "kg", _sensor_masses, _sensor(mass_kg=_own), _mass_guess,
          _named("m")),
    InjectedEffect("channel_skew", "response_sensor", "s", _some_channels(*_ANY), _sensor(delay_s=_own),
          _per_omega(0.003), _named("tau"), largest=0.002),
    InjectedEffect("shared_delay", "response_sensor", "s", _groups, _late_group, _per_omega(0.003), _named("tau"),
          largest=0.002),
    InjectedEffect("low_pass", "response_sensor", "s", _some_channels(*_ANY),
          _sensor(low_pass_hz=lambda at, value: 1.0 / (2.0 * math.pi * value)), _per_omega(0.003),
          _named("low_pass_hz", lambda value: 1.0 / (2.0 * math.pi * value)), largest=0.003),
    InjectedEffect("charge_high_pass", "response_sensor", "Hz", _some_channels(*_ANY), _sensor(high_pass_hz=_own),
          lambda at: 0.003 * at.omega / (2.0 * math.pi), _named("f_h"), largest=20.0),
    InjectedEffect("clipping", "response_sensor", "1", _some_channels(*_ANY),
          _sensor(clip=lambda at, value: at.operating.peaks[at.spot.label] * math.exp(-value)), _constant(0.05),
          largest=3.0),
    InjectedEffect("quantisation", "response_sensor", "channel", _some_channels(*_ANY),
          _sensor(bits=lambda at, value: _COARSE_BITS, range=lambda at, value: value * 2.0 ** (_COARSE_BITS - 1)),
          _of_noise(5.0), _named("lsb")),
    InjectedEffect("mains_hum", "response_sensor", "channel", _some_channels(*_ANY), _sensor(hum_amplitude=_own),
          _of_noise(0.05), _named("amplitude")),
    InjectedEffect("clock_error", "response_sensor", "1", _everywhere, _set("clock_error"), _constant(1e-3),
          _named("e"), signed=True, largest=0.05),
    InjectedEffect("phase_offset", "controller", "rad", _everywhere, _loop_key("phase_offset_rad"), _constant(5e-3),
          _named("phi0"), signed=True, largest=0.5),
    InjectedEffect("loop_latency", "controller", "s", _everywhere, _loop_key("loop_latency_s"), _per_omega(5e-3),
          _named("tau"), signed=True),
)  # fmt: skip

OPEN: tuple[InjectedEffect, ...] = (
    InjectedEffect("bouc_wen_joint", "joint", "share", _joint, _bouc_wen, _constant(0.1), largest=0.98, known=False),
    InjectedEffect("lugre_joint", "joint", "share", _joint, _lugre, _constant(0.1), largest=0.98, known=False),
    InjectedEffect("fractional_damper", "structure", "N s^0.5/m", _sites(),
          lambda at, value: _element(
              at, "fractional_damper", coefficient_n_sa_m=value, order=0.5, low_hz=0.5,
              high_hz=0.5 * at.rig.sample_rate_hz,
          ),
          lambda at: 0.003 * at.stiffness / math.sqrt(at.omega), known=False),
    InjectedEffect("backlash_damper", "structure", "N/m", _sites((0.4,)), _backlash, _elastic(0.05, 1), known=False),
    InjectedEffect("eddy_brake", "structure", "N s/m", _points,
          lambda at, value: _element(
              at, "eddy_brake", damping_ns_m=value, critical_velocity_m_s=0.3 * at.omega * at.size
          ), _viscous(0.005, 1), known=False),
    InjectedEffect("mode_coupling", "structure", "N/m²", _sites(), _coupling, _elastic(0.01, 2), known=False),
    InjectedEffect("cable_rattle", "structure", "kg", _sites((0.5,)), _rattle,
          lambda at: 0.01 * at.stiffness / at.omega**2, known=False),
    InjectedEffect("loose_accelerometer", "response_sensor", "channel", _channels("acceleration"),
          _sensor(dead_zone=_own), lambda at: 0.003 * at.operating.channels[at.spot.label],
          known=False),
    InjectedEffect("dropped_samples", "response_sensor", "share", _some_channels(*_ANY), _sensor(dropped_fraction=_own),
          _constant(0.03), largest=0.9, known=False),
    InjectedEffect("ground_loop", "response_sensor", "channel/V", _some_channels(*_ANY),
          _sensor(crosstalk_per_volt=_own),
          lambda at: 0.001 * at.operating.channels[at.spot.label] / at.operating.voltage, signed=True, known=False),
)  # fmt: skip

INJECTED_EFFECTS: dict[str, InjectedEffect] = {truth.name: truth for truth in (*KNOWN, *OPEN)}

NEAR_TWINS: tuple[tuple[str, str], ...] = (
    ("channel_skew", "low_pass"),
    ("phase_offset", "loop_latency"),
    ("clamp_compliance", "stinger_stiffness"),
    ("added_mass", "stinger_stiffness"),
    ("suspension_cubic", "force_factor_symmetric"),
    ("force_gain", "response_gain"),
    ("added_mass", "sensor_mass"),
    ("structural_damping", "viscous_damping"),
    ("cubic_stiffness", "quintic_stiffness"),
    ("air_drag", "power_law_damping"),
    ("amplitude_damping", "power_law_damping"),
    ("channel_skew", "shared_delay"),
    ("response_gain", "transverse_sensitivity"),
)
"""Pairs that are hard to distinguish."""
