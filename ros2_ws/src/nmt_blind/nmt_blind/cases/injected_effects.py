"""What a rig may really have beyond its model: each a change of the rig file, with where and how strongly.

The names are those of the library of effects and, after them, of effects that no library has. Nothing else is shared
with the library: places, sizes and keys are chosen here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nmt_blind.cases.operating import Operating
from nmt_blind.cases.rig_edits import Edit
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


Spots = Callable[[Rig, Operating], tuple[Spot, ...]]
Edits = Callable[[Rig, Operating, Spot, float], tuple[Edit, ...]]
Guess = Callable[[Rig, Operating, Spot], float]


@dataclass(frozen=True)
class InjectedEffect:
    """One kind of truth.

    Attributes:
        name: fixed name.
        place: structure, boundary, joint, exciter, force_sensor, response_sensor, controller or time.
        unit: unit of the strength.
        spots: where it may act on a rig; none = not on this one.
        edits: what is changed at a strength.
        guess: a strength to start the search with.
        signed: the strength may be negative.
        largest: largest strength that makes sense; bound: the same where it depends on rig and spot.
        known: the library of the diagnosis is supposed to have it.
        proportional: its change of the observables grows in proportion to the strength, up to 64 σ.
    """

    name: str
    place: str
    unit: str
    spots: Spots
    edits: Edits
    guess: Guess
    signed: bool = False
    largest: float = math.inf
    known: bool = True
    proportional: bool = True
    bound: Guess | None = None

    def limit(self, rig: Rig, operating: Operating, spot: Spot) -> float:
        """Largest strength that makes sense at a spot of a rig."""
        return self.largest if self.bound is None else min(self.largest, self.bound(rig, operating, spot))

    def place_at(self, rig: Rig, spot: Spot) -> str:
        """Place, with channels sorted into force and response sensors."""
        if self.place == "response_sensor" and spot.sensor >= 0 and rig.sensors[spot.sensor].quantity == "force":
            return "force_sensor"
        return self.place


# Where ------------------------------------------------------------------------------------------------------------


def _everywhere(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    return (Spot(""),)


def _sites(shapes: tuple[float, ...] = (0.0,)) -> Spots:
    """Points that move: of a chain the last one and its first two neighbours, of others beyond the drive point."""

    def spots(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
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


def _points(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    ends = sorted({1, rig.structure.points[-1]})
    points = ends if isinstance(rig.structure, ChainSection) else _free_points(rig)
    return tuple(Spot(str(p), p) for p in points)


def _channels(*quantities: str) -> Spots:
    def spots(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
        return tuple(
            Spot(rig.sensor_channel(sensor), rig.sensor_point(sensor), sensor=index)
            for index, sensor in enumerate(rig.sensors)
            if sensor.quantity in quantities
        )

    return spots


def _some_channels(*quantities: str) -> Spots:
    """First and last channel of each quantity."""

    def spots(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
        found = []
        for quantity in quantities:
            own = _channels(quantity)(rig, operating)
            found += [own[0], own[-1]] if len(own) > 1 else list(own)
        return tuple(found)

    return spots


def _groups(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    """Responses of a quantity that several channels have: these share a conditioner."""
    count = {name: sum(sensor.quantity == name for sensor in rig.sensors) for name in RESPONSES}
    return tuple(Spot(f"{name} channels", option=name) for name in RESPONSES if count[name] > 1)


def _sensor_masses(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    first: dict[int, Spot] = {}
    for spot in _channels(*RESPONSES)(rig, operating):
        first.setdefault(spot.point, spot)
    return tuple(first.values())


def _crossings(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    """Each channel with the next measured point, the last with the one before."""
    points = sorted({rig.sensor_point(s) for s in rig.sensors if s.quantity in RESPONSES})
    if len(points) < 2:
        return ()
    found = []
    for spot in _channels(*RESPONSES)(rig, operating):
        place = points.index(spot.point)
        other = points[place + 1] if place + 1 < len(points) else points[place - 1]
        found.append(Spot(f"{spot.label}<{other}", spot.point, other, spot.sensor))
    return tuple(found)


def _clamped(rig: Rig) -> bool:
    return isinstance(rig.structure, BeamSection) and "clamped" in rig.structure.boundary


def _clamp(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    if not _clamped(rig):
        return ()
    return (Spot("rotation", option="rotation"), Spot("lateral", option="lateral"))


def _clamp_friction(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    if not _clamped(rig):
        return ()
    return tuple(
        Spot(f"{option} at {shape:g}", 1, option=option, shape=shape)
        for option in ("rotation", "lateral")
        for shape in (0.1, 0.4)
    )


def _stinger(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    lateral = Spot("lateral", rig.drive_point, option="lateral")
    if not isinstance(rig.structure, BeamSection):
        return (lateral,)
    return lateral, Spot("rotation", rig.drive_point, option="rotation")


def _shaker(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    return (Spot(""),) if isinstance(rig.exciter, ShakerSection) else ()


def _contacts(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    return _sites((0.1, 0.4))(rig, operating)


def _jenkins(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    return tuple(
        Spot(f"{element.name or element.point} with exponent {shape:g}", element.point, sensor=-1,
             option=str(index), shape=shape)
        for index, element in enumerate(rig.local_elements)
        if isinstance(element, JenkinsSection)
        for shape in (0.0, 0.4)
    )  # fmt: skip


def _joint(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    """The largest friction element of the model."""
    forces = [getattr(element, "slip_force_n", 0.0) for element in rig.local_elements]
    if not forces or max(forces) <= 0.0:
        return ()
    index = forces.index(max(forces))
    element = rig.local_elements[index]
    return (Spot("joint", element.point, element.other_point or 0, option=str(index)),)


# What -------------------------------------------------------------------------------------------------------------


def _element(rig: Rig, spot: Spot, kind: str, **keys: Any) -> tuple[Edit, ...]:
    section: dict[str, Any] = {"kind": kind, "point": spot.point, **keys}
    if spot.other:
        section["other_point"] = spot.other
    return (Edit(("local_elements",), section, "append"),)


def _one_key(kind: str, key: str) -> Edits:
    return lambda rig, operating, spot, value: _element(rig, spot, kind, **{key: value})


# Density of air, kg/m³; drag coefficient of a plate that swings by about its width (Keulegan and Carpenter 1958); mass
# of a plate by its area where the rig file has no area, kg/m²: 2 mm of aluminium.
_AIR, _DRAG_COEFFICIENT, _PLATE = 1.2, 10.0, 5.4


def _largest_drag(rig: Rig, operating: Operating, spot: Spot) -> float:
    """What air can do, ½ ρ C_d A: beyond it the same force has another cause, and another name."""
    if isinstance(rig.structure, BeamSection):
        area = rig.structure.length_m * rig.structure.width_m
    else:
        area = operating.stiffness[spot.point] / operating.omega**2 / _PLATE
    return 0.5 * _AIR * _DRAG_COEFFICIENT * area


_EXPONENT = 1.5
"""Of a power-law damper: between viscous damping and drag."""


def _power_law(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    """A damper that takes a force, in newtons, at the largest speed of its spot."""
    speed = operating.omega * operating.size(spot.point, spot.other)
    return _element(rig, spot, "power_law_damper", coefficient_n_sp_mp=value / speed**_EXPONENT, exponent=_EXPONENT)


def _late_group(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    return tuple(
        Edit(("sensors", index, "delay_s"), sensor.delay_s + value)
        for index, sensor in enumerate(rig.sensors)
        if sensor.quantity == spot.option
    )


def _stop(kind: str) -> Edits:
    def edits(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
        gap = spot.shape * operating.size(spot.point, spot.other)
        return _element(rig, spot, kind, stiffness_n_m=value, gap_m=gap)

    return edits


def _friction(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    if spot.option == "rotation":
        reach = spot.shape * operating.rotation[spot.point]
        return _element(rig, spot, "jenkins", tangential_stiffness_n_m=value, slip_force_n=value * reach, rotation=True)
    reach = spot.shape * operating.size(spot.point, spot.other)
    return _element(rig, spot, "jenkins", tangential_stiffness_n_m=value, slip_force_n=value * reach)


def _compliance(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    key = "clamp_rotational_stiffness_nm_rad" if spot.option == "rotation" else "clamp_lateral_stiffness_n_m"
    return (Edit(("structure", key), 1.0 / value),)


def _compliance_guess(rig: Rig, operating: Operating, spot: Spot) -> float:
    beam = rig.structure
    assert isinstance(beam, BeamSection)
    bending = beam.youngs_modulus_pa * beam.width_m * beam.height_m**3 / 12.0
    power = 1 if spot.option == "rotation" else 3
    return 0.003 * beam.length_m**power / bending


def _microslip(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    index = int(spot.option)
    return (
        Edit(("local_elements", index, "kind"), "iwan"),
        Edit(("local_elements", index, "exponent"), spot.shape),
        Edit(("local_elements", index, "stiffness_ratio"), 1.0 / value),
        Edit(("local_elements", index, "sliders"), 30),
    )


def _stinger_edits(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    rotation = {"rotation": True} if spot.option == "rotation" else {}
    return _element(rig, spot, "linear_spring", stiffness_n_m=value, side="exciter", **rotation)


def _stinger_guess(rig: Rig, operating: Operating, spot: Spot) -> float:
    stiffness = 0.01 * operating.stiffness[rig.drive_point]
    if spot.option != "rotation":
        return stiffness
    return stiffness * (operating.displacement[spot.point] / operating.rotation[spot.point]) ** 2


def _suspension(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    at = Spot("", rig.drive_point)
    return _element(rig, at, "cubic_spring", stiffness_n_m3=value, side="exciter")


def _exciter_key(key: str, value_of: Callable[[float], float] = lambda value: value) -> Edits:
    return lambda rig, operating, spot, value: (Edit(("exciter", key), value_of(value)),)


def _sensor_key(key: str, value_of: Callable[[SensorSection, float], Any]) -> Edits:
    def edits(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
        return (Edit(("sensors", spot.sensor, key), value_of(rig.sensors[spot.sensor], value)),)

    return edits


def _clipped(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    largest = operating.peaks[spot.label]
    return (Edit(("sensors", spot.sensor, "clip"), largest * math.exp(-value)),)


_COARSE_BITS = 22


def _quantised(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    return (
        Edit(("sensors", spot.sensor, "bits"), _COARSE_BITS),
        Edit(("sensors", spot.sensor, "range"), value * 2.0 ** (_COARSE_BITS - 1)),
    )


def _gain(sensor: SensorSection, value: float) -> float:
    return sensor.gain * (1.0 + value)


def _transverse(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    return (Edit(("sensors", spot.sensor, "transverse"), {"point": spot.other, "fraction": value}),)


def _drift(key: str, sign: float) -> Edits:
    return lambda rig, operating, spot, value: (Edit(("drift", spot.option or key), sign * value),)


def _losses(rig: Rig, operating: Operating) -> tuple[Spot, ...]:
    if not _joint(rig, operating):
        return ()
    return (Spot("time", option="slip_force_per_s"), Spot("cycles", option="slip_force_per_cycle"))


def _loss_guess(rig: Rig, operating: Operating, spot: Spot) -> float:
    return 0.03 / (operating.duration if spot.label == "time" else operating.cycles)


def _loop_key(key: str) -> Edits:
    return lambda rig, operating, spot, value: (Edit(("pll",), {key: value}, "merge"),)


def _share(rig: Rig, spot: Spot, value: float, section: dict[str, Any]) -> tuple[Edit, ...]:
    """A share of the joint's friction taken from the model's element and given to another law."""
    index = int(spot.option)
    path = ("local_elements", index)
    return (
        Edit((*path, "tangential_stiffness_n_m"), 1.0 - value, "scale"),
        Edit((*path, "slip_force_n"), 1.0 - value, "scale"),
        *_element(rig, spot, **section),
    )


def _joint_figures(rig: Rig, spot: Spot) -> tuple[float, float]:
    element = rig.local_elements[int(spot.option)]
    stiffness = float(element.tangential_stiffness_n_m)  # type: ignore[union-attr]
    slip = float(element.slip_force_n)  # type: ignore[union-attr]
    return stiffness, slip


def _bouc_wen(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    stiffness, slip = _joint_figures(rig, spot)
    section = {
        "kind": "bouc_wen",
        "stiffness_n_m": value * stiffness,
        "yield_displacement_m": slip / stiffness,
        "exponent": 1.0,
        "shape": 0.8,
    }
    return _share(rig, spot, value, section)


def _lugre(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    stiffness, slip = _joint_figures(rig, spot)
    section = {
        "kind": "lugre",
        "bristle_stiffness_n_m": value * stiffness,
        "coulomb_force_n": 0.8 * value * slip,
        "static_force_n": 1.4 * value * slip,
        "stribeck_velocity_m_s": 0.2 * operating.omega * operating.size(spot.point, spot.other),
    }
    return _share(rig, spot, value, section)


def _backlash(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    gap = spot.shape * operating.size(spot.point, spot.other)
    damping = value * 0.5 / operating.omega / max(gap, 1e-12)
    return _element(rig, spot, "backlash_damper", stiffness_n_m=value, damping_ns_m2=damping, gap_m=gap)


def _eddy(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    critical = 0.3 * operating.omega * operating.size(spot.point, spot.other)
    return _element(rig, spot, "eddy_brake", damping_ns_m=value, critical_velocity_m_s=critical)


def _coupling(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    mass = 0.01 * operating.modal_stiffness(spot.point, spot.other) / operating.omega**2
    frequency = 2.0 * operating.omega / (2.0 * math.pi)
    return _element(
        rig, spot, "tuned_mass_quadratic", mass_kg=mass, frequency_hz=frequency, damping_ratio=0.02, coupling_n_m2=value
    )


def _coupling_guess(rig: Rig, operating: Operating, spot: Spot) -> float:
    size = operating.size(spot.point, spot.other)
    return 0.01 * operating.modal_stiffness(spot.point, spot.other) / size


def _rattle(rig: Rig, operating: Operating, spot: Spot, value: float) -> tuple[Edit, ...]:
    gap = spot.shape * operating.size(spot.point, spot.other)
    stiffness = value * (8.0 * operating.omega) ** 2
    return _element(
        rig, spot, "rattling_mass", mass_kg=value, gap_m=gap, contact_stiffness_n_m=stiffness,
        contact_damping_ns_m2=0.2 * stiffness / operating.omega / gap, friction_ns_m=0.3 * value * operating.omega,
    )  # fmt: skip


# Guesses ----------------------------------------------------------------------------------------------------------


def _elastic(share: float, power: int) -> Guess:
    """A force of so many parts of the modal one at the largest amplitude, growing with a power of it."""

    def guess(rig: Rig, operating: Operating, spot: Spot) -> float:
        size = operating.size(spot.point, spot.other)
        return share * operating.modal_stiffness(spot.point, spot.other) / size ** (power - 1)

    return guess


def _viscous(share: float, power: int) -> Guess:
    def guess(rig: Rig, operating: Operating, spot: Spot) -> float:
        speed = operating.omega * operating.size(spot.point, spot.other)
        size = operating.size(spot.point, spot.other)
        return share * operating.modal_stiffness(spot.point, spot.other) * size / speed**power

    return guess


def _clamp_friction_guess(rig: Rig, operating: Operating, spot: Spot) -> float:
    stiffness = 0.02 * operating.stiffness[1]
    if spot.option != "rotation":
        return stiffness
    return stiffness * (operating.displacement[1] / operating.rotation[1]) ** 2


def _mass_guess(rig: Rig, operating: Operating, spot: Spot) -> float:
    return 0.003 * operating.stiffness[spot.point] / operating.omega**2


def _drive_guess(share: float, power: int) -> Guess:
    return lambda rig, operating, spot: share / operating.displacement[rig.drive_point] ** power


def _constant(value: float) -> Guess:
    return lambda rig, operating, spot: value


def _per_omega(share: float) -> Guess:
    return lambda rig, operating, spot: share / operating.omega


def _of_channel(share: float) -> Guess:
    return lambda rig, operating, spot: share * operating.channels[spot.label]


def _of_noise(share: float) -> Guess:
    return lambda rig, operating, spot: share * operating.noise[spot.label]


def _positive_rate(rig: Rig, operating: Operating, spot: Spot) -> float:
    return 0.002 / operating.duration


_ANY = (*RESPONSES, "force")
_GAPS = (0.35, 0.75)

KNOWN: tuple[InjectedEffect, ...] = (
    InjectedEffect("cubic_stiffness", "structure", "N/m³", _sites(), _one_key("cubic_spring", "stiffness_n_m3"),
          _elastic(0.01, 3), signed=True),
    InjectedEffect("quintic_stiffness", "structure", "N/m⁵", _sites(), _one_key("quintic_spring", "stiffness_n_m5"),
          _elastic(0.01, 5), signed=True),
    InjectedEffect("quadratic_stiffness", "structure", "N/m²", _sites(), _one_key("quadratic_spring", "stiffness_n_m2"),
          _elastic(0.01, 2), signed=True),
    InjectedEffect("air_drag", "structure", "N s²/m²", _points, _one_key("quadratic_drag", "drag_ns2_m2"),
          _viscous(0.002, 2),
          bound=_largest_drag),
    InjectedEffect("amplitude_damping", "structure", "N s/m³", _sites(), _one_key("amplitude_damper", "damping_ns_m3"),
          lambda rig, operating, spot: (
              0.005 * operating.modal_stiffness(spot.point, spot.other)
              / (operating.omega * operating.size(spot.point, spot.other) ** 2)
          )),
    InjectedEffect("power_law_damping", "structure", "N", _sites(), _power_law,
          lambda rig, operating, spot: (
              0.002 * operating.modal_stiffness(spot.point, spot.other) * operating.size(spot.point, spot.other)
          )),
    InjectedEffect("structural_damping", "structure", "1", _everywhere,
          lambda rig, operating, spot, value: (Edit(("structure", "loss_factor"), value),), _constant(0.003),
          largest=0.1),
    InjectedEffect("viscous_damping", "structure", "N s/m", _sites(), _one_key("linear_damper", "damping_ns_m"),
          _viscous(0.002, 1)),
    InjectedEffect("added_mass", "structure", "kg", _points,
          lambda rig, operating, spot, value: (
              Edit(("structure", "added_masses"), {"point": spot.point, "mass_kg": value}, "append"),
          ), _mass_guess),
    InjectedEffect("one_sided_stop", "structure", "N/m", _sites(_GAPS), _stop("unilateral_stop"), _elastic(0.05, 1)),
    InjectedEffect("two_sided_gap", "structure", "N/m", _sites(_GAPS), _stop("two_sided_gap"), _elastic(0.05, 1)),
    InjectedEffect("clamp_compliance", "boundary", "rad/(N m) or m/N", _clamp, _compliance, _compliance_guess),
    InjectedEffect("clamp_friction", "boundary", "N/m or N m/rad", _clamp_friction, _friction, _clamp_friction_guess),
    InjectedEffect("microslip", "joint", "1", _jenkins, _microslip, _constant(0.1), largest=50.0, proportional=False),
    InjectedEffect("second_friction_contact", "joint", "N/m", _contacts, _friction, _elastic(0.02, 1)),
    InjectedEffect("preload_loss", "time", "1/s or 1/period", _losses, _drift("slip_force_per_s", -1.0), _loss_guess),
    InjectedEffect("temperature_drift", "time", "1/s", _everywhere, _drift("stiffness_per_s", 1.0), _positive_rate,
          signed=True),
    InjectedEffect("stinger_stiffness", "exciter", "N/m or N m/rad", _stinger, _stinger_edits, _stinger_guess),
    InjectedEffect("amplifier_saturation", "exciter", "1/V²", _shaker,
          _exciter_key("amplifier_saturation_v", lambda value: value**-0.5),
          lambda rig, operating, spot: 0.01 / operating.voltage**2),
    InjectedEffect("source_impedance", "exciter", "Ω", _shaker, _exciter_key("source_resistance_ohm"), _constant(0.2)),
    InjectedEffect("suspension_cubic", "exciter", "N/m³", _shaker, _suspension,
          lambda rig, operating, spot: (
              0.01 * operating.stiffness[rig.drive_point] / operating.displacement[rig.drive_point] ** 2
          ), signed=True),
    InjectedEffect("force_factor_symmetric", "exciter", "1/m²", _shaker, _exciter_key("force_factor_quadratic_per_m2"),
          _drive_guess(0.02, 2), signed=True),
    InjectedEffect("force_factor_asymmetric", "exciter", "1/m", _shaker, _exciter_key("force_factor_linear_per_m"),
          _drive_guess(0.02, 1), signed=True),
    InjectedEffect("force_gain", "force_sensor", "1", _channels("force"), _sensor_key("gain", _gain), _constant(0.003),
          signed=True, largest=0.5),
    InjectedEffect("force_cell_mass", "force_sensor", "kg", _channels("force"), _sensor_key("mass_kg", lambda s, v: v),
          _mass_guess),
    InjectedEffect("response_gain", "response_sensor", "1", _channels(*RESPONSES), _sensor_key("gain", _gain),
          _constant(0.003),
          signed=True, largest=0.5),
    InjectedEffect("transverse_sensitivity", "response_sensor", "1", _crossings, _transverse, _constant(0.003),
          signed=True,
          largest=0.3),
    InjectedEffect("sensor_mass", "response_sensor", "kg", _sensor_masses, _sensor_key("mass_kg", lambda s, v: v),
          _mass_guess),
    InjectedEffect("channel_skew", "response_sensor", "s", _some_channels(*_ANY), _sensor_key("delay_s", lambda s,
          v: v),
          _per_omega(0.003), largest=0.002),
    InjectedEffect("shared_delay", "response_sensor", "s", _groups, _late_group, _per_omega(0.003), largest=0.002),
    InjectedEffect("low_pass", "response_sensor", "s", _some_channels(*_ANY),
          _sensor_key("low_pass_hz", lambda s, v: 1.0 / (2.0 * math.pi * v)), _per_omega(0.003), largest=0.003),
    InjectedEffect("charge_high_pass", "response_sensor", "Hz", _some_channels(*_ANY),
          _sensor_key("high_pass_hz", lambda s, v: v),
          lambda rig, operating, spot: 0.003 * operating.omega / (2.0 * math.pi), largest=20.0),
    InjectedEffect("clipping", "response_sensor", "1", _some_channels(*_ANY), _clipped, _constant(0.05), largest=3.0,
          proportional=False),
    InjectedEffect("quantisation", "response_sensor", "channel", _some_channels(*_ANY), _quantised, _of_noise(5.0),
          proportional=False),
    InjectedEffect("mains_hum", "response_sensor", "channel", _some_channels(*_ANY),
          _sensor_key("hum_amplitude", lambda s, v: v), _of_noise(0.05)),
    InjectedEffect("clock_error", "response_sensor", "1", _everywhere,
          lambda rig, operating, spot, value: (Edit(("clock_error",), value),), _constant(1e-3), signed=True,
          largest=0.05),
    InjectedEffect("phase_offset", "controller", "rad", _everywhere, _loop_key("phase_offset_rad"), _constant(5e-3),
          signed=True, largest=0.5),
    InjectedEffect("loop_latency", "controller", "s", _everywhere, _loop_key("loop_latency_s"), _per_omega(5e-3),
          signed=True),
)  # fmt: skip

OPEN: tuple[InjectedEffect, ...] = (
    InjectedEffect("bouc_wen_joint", "joint", "share", _joint, _bouc_wen, _constant(0.1), largest=0.98,
          proportional=False, known=False),
    InjectedEffect("lugre_joint", "joint", "share", _joint, _lugre, _constant(0.1), largest=0.98,
          proportional=False, known=False),
    InjectedEffect("fractional_damper", "structure", "N s^0.5/m", _sites(),
          lambda rig, operating, spot, value: _element(
              rig, spot, "fractional_damper", coefficient_n_sa_m=value, order=0.5, low_hz=0.5,
              high_hz=0.5 * rig.sample_rate_hz,
          ),
          lambda rig, operating, spot: (
              0.003 * operating.modal_stiffness(spot.point, spot.other) / math.sqrt(operating.omega)
          ), known=False),
    InjectedEffect("backlash_damper", "structure", "N/m", _sites((0.4,)), _backlash, _elastic(0.05, 1), known=False,
          proportional=False),
    InjectedEffect("eddy_brake", "structure", "N s/m", _points, _eddy, _viscous(0.005, 1), known=False),
    InjectedEffect("mode_coupling", "structure", "N/m²", _sites(), _coupling, _coupling_guess, known=False,
          proportional=False),
    InjectedEffect("cable_rattle", "structure", "kg", _sites((0.5,)), _rattle,
          lambda rig, operating, spot: 0.01 * operating.modal_stiffness(spot.point, spot.other) / operating.omega**2,
          known=False, proportional=False),
    InjectedEffect("loose_accelerometer", "response_sensor", "channel", _channels("acceleration"),
          _sensor_key("dead_zone", lambda s, v: v), _of_channel(0.003), proportional=False, known=False),
    InjectedEffect("dropped_samples", "response_sensor", "share", _some_channels(*_ANY),
          _sensor_key("dropped_fraction", lambda s, v: v), _constant(0.03), largest=0.9,
          proportional=False, known=False),
    InjectedEffect("ground_loop", "response_sensor", "channel/V", _some_channels(*_ANY),
          _sensor_key("crosstalk_per_volt", lambda s, v: v),
          lambda rig, operating, spot: 0.001 * operating.channels[spot.label] / operating.voltage,
          signed=True, known=False),
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


def injected_effect_named(name: str) -> InjectedEffect:
    """Injected effect of a name.

    Raises:
        KeyError: there is none.
    """
    return INJECTED_EFFECTS[name]


# What is to be estimated -------------------------------------------------------------------------------------------

Figures = Callable[[Operating, Spot, float], dict[str, float]]


def _named(name: str, value_of: Callable[[float], float] = lambda value: value) -> Figures:
    return lambda operating, spot, value: {name: value_of(value)}


def _stop_figures(operating: Operating, spot: Spot, value: float) -> dict[str, float]:
    return {"k": value, "gap": spot.shape * operating.size(spot.point, spot.other)}


def _friction_figures(operating: Operating, spot: Spot, value: float) -> dict[str, float]:
    turning = spot.option == "rotation"
    size = operating.rotation[spot.point] if turning else operating.size(spot.point, spot.other)
    return {"kt": value, "slip_force": value * spot.shape * size}


_FIGURES: dict[str, Figures] = {
    **dict.fromkeys(
        ("cubic_stiffness", "quintic_stiffness", "quadratic_stiffness", "stinger_stiffness", "suspension_cubic"),
        _named("k"),
    ),
    **dict.fromkeys(("added_mass", "sensor_mass", "force_cell_mass"), _named("m")),
    **dict.fromkeys(("force_gain", "response_gain"), _named("g")),
    **dict.fromkeys(("channel_skew", "shared_delay", "loop_latency"), _named("tau")),
    **dict.fromkeys(("one_sided_stop", "two_sided_gap"), _stop_figures),
    **dict.fromkeys(("clamp_friction", "second_friction_contact"), _friction_figures),
    "air_drag": _named("c2"),
    "structural_damping": _named("eta"),
    **dict.fromkeys(("viscous_damping", "amplitude_damping"), _named("c")),
    "power_law_damping": lambda operating, spot, value: {"p": _EXPONENT},
    "clamp_compliance": _named("k", lambda value: 1.0 / value),
    "preload_loss": _named("rate", lambda value: -value),
    "temperature_drift": _named("rate"),
    "amplifier_saturation": _named("V", lambda value: value**-0.5),
    "source_impedance": _named("R"),
    "force_factor_symmetric": _named("b2"),
    "force_factor_asymmetric": _named("b1"),
    "transverse_sensitivity": _named("s"),
    "low_pass": _named("low_pass_hz", lambda value: 1.0 / (2.0 * math.pi * value)),
    "charge_high_pass": _named("f_h"),
    "quantisation": _named("lsb"),
    "mains_hum": _named("amplitude"),
    "clock_error": _named("e"),
    "phase_offset": _named("phi0"),
}


def figures_of(truth: InjectedEffect, operating: Operating, spot: Spot, value: float) -> dict[str, float]:
    """True values of the parameters that a diagnosis reports, by the names of the effects' equations.

    Empty where a truth has none in the same terms: what nobody names, and what counts from the model's amplitude.
    """
    found = _FIGURES.get(truth.name)
    return {} if found is None else found(operating, spot, value)
