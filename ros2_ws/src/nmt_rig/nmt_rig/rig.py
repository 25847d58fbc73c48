"""Rig files: what a rig consists of, validated; every number carries its unit in the name of its key."""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from nmt_core.blocks import Quantity
from nmt_core.errors import BenchError
from nmt_rig.rig_file import KeyPath, RigDocument, apply_overrides, read_document

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Point = Annotated[int, Field(ge=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]

# Environment variable with folders, separated as in PATH, that are searched for rigs by name first.
RIG_PATH_VARIABLE = "NMT_RIG_PATH"


class Section(BaseModel):
    """Base of all sections: unknown keys, NaN, infinities and wrong types are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class AddedMassSection(Section):
    """Mass fixed to a point; negative where the model has too much."""

    point: Point
    mass_kg: float


class StructureSection(Section):
    """Common keys of structures: masses added at points, and hysteretic damping K (1 + iη)."""

    added_masses: list[AddedMassSection] = []
    loss_factor: NotNegative = 0.0


class BeamSection(StructureSection):
    """Cantilever of Euler-Bernoulli elements; points 1..elements from the clamp outward."""

    kind: Literal["beam"]
    length_m: Positive
    width_m: Positive
    height_m: Positive
    youngs_modulus_pa: Positive
    density_kg_m3: Positive
    elements: Annotated[int, Field(ge=1, le=200)]
    stiffness_damping_s: NotNegative = 0.0
    mesh_refinement: Annotated[int, Field(ge=1, le=20)] = 1
    clamp_rotational_stiffness_nm_rad: Positive | None = None
    clamp_lateral_stiffness_n_m: Positive | None = None

    @property
    def points(self) -> range:
        """Numbers of the measurement points."""
        return range(1, self.elements + 1)


class ChainSection(StructureSection):
    """Lumped masses in a row; point i = mass i."""

    kind: Literal["chain"]
    masses_kg: Annotated[list[Positive], Field(min_length=1, max_length=200)]
    springs_n_m: list[NotNegative] = []
    dampers_ns_m: list[NotNegative] | None = None
    ground_springs_n_m: list[NotNegative] | None = None
    ground_dampers_ns_m: list[NotNegative] | None = None

    @property
    def points(self) -> range:
        """Numbers of the measurement points."""
        return range(1, len(self.masses_kg) + 1)

    @model_validator(mode="after")
    def _lengths_fit(self) -> ChainSection:
        n = len(self.masses_kg)
        for key, count in (
            ("springs_n_m", n - 1),
            ("dampers_ns_m", n - 1),
            ("ground_springs_n_m", n),
            ("ground_dampers_ns_m", n),
        ):
            value = getattr(self, key)
            if value is not None and len(value) != count:
                raise ValueError(f"{key} needs {count} values for {n} masses, got {len(value)}")
        return self


class ElementSection(Section):
    """Common keys of local elements: between `point` and `other_point`, the ground when that is left out.

    side: an element on the side of the exciter acts on the drive point behind the force sensor, so its force is part
    of the measured one. rotation: it acts on the rotation of the beam's cross-section (N m and rad instead of N and m).
    """

    name: Name | None = None
    point: Point
    other_point: Point | None = None
    side: Literal["structure", "exciter"] = "structure"
    rotation: bool = False


class JenkinsSection(ElementSection):
    """Elastic Coulomb element."""

    kind: Literal["jenkins"]
    tangential_stiffness_n_m: Positive
    slip_force_n: Positive


class IwanSection(ElementSection):
    """Joint with micro-slip: a distribution of Jenkins elements side by side (see model/iwan.py)."""

    kind: Literal["iwan"]
    tangential_stiffness_n_m: Positive
    slip_force_n: Positive
    exponent: Annotated[float, Field(gt=-1)] = 0.0
    stiffness_ratio: NotNegative = 0.0
    onset_ratio: Annotated[float, Field(ge=0, lt=1)] = 0.0
    sliders: Annotated[int, Field(ge=1, le=200)] = 12
    remaining_stiffness_n_m: NotNegative = 0.0


class CubicSpringSection(ElementSection):
    """g = k3 w³."""

    kind: Literal["cubic_spring"]
    stiffness_n_m3: float


class QuinticSpringSection(ElementSection):
    """g = k5 w⁵."""

    kind: Literal["quintic_spring"]
    stiffness_n_m5: float


class QuadraticSpringSection(ElementSection):
    """g = k2 w²."""

    kind: Literal["quadratic_spring"]
    stiffness_n_m2: float


class UnilateralStopSection(ElementSection):
    """g = k max(w - gap, 0)."""

    kind: Literal["unilateral_stop"]
    stiffness_n_m: Positive
    gap_m: float


class TwoSidedGapSection(ElementSection):
    """Stops on both sides at distance gap."""

    kind: Literal["two_sided_gap"]
    stiffness_n_m: Positive
    gap_m: NotNegative


class QuadraticDragSection(ElementSection):
    """g = c2 v |v|."""

    kind: Literal["quadratic_drag"]
    drag_ns2_m2: float


class LinearSpringSection(ElementSection):
    """g = k w."""

    kind: Literal["linear_spring"]
    stiffness_n_m: float


class LinearDamperSection(ElementSection):
    """g = c v."""

    kind: Literal["linear_damper"]
    damping_ns_m: float


class TanhFrictionSection(ElementSection):
    """g = μN tanh(v / v0)."""

    kind: Literal["tanh_friction"]
    slip_force_n: Positive
    reference_velocity_m_s: Positive


class EddyBrakeSection(ElementSection):
    """g = c v / (1 + (v / v_c)²)."""

    kind: Literal["eddy_brake"]
    damping_ns_m: NotNegative
    critical_velocity_m_s: Positive


class BacklashDamperSection(ElementSection):
    """Free play with a spring and a damper behind it: g = max(e (k + λ ė), 0), e = |w| - gap > 0, to both sides."""

    kind: Literal["backlash_damper"]
    stiffness_n_m: Positive
    damping_ns_m2: NotNegative
    gap_m: NotNegative


class BoucWenSection(ElementSection):
    """g = k (a w + (1 - a) z), ż = v (1 - |z / z_y|^n (b sign(v z) + 1 - b))."""

    kind: Literal["bouc_wen"]
    stiffness_n_m: Positive
    yield_displacement_m: Positive
    exponent: Annotated[float, Field(ge=1, le=20)] = 1.0
    post_yield_ratio: Annotated[float, Field(ge=0, le=1)] = 0.0
    shape: Annotated[float, Field(ge=0, le=1)] = 0.5


class LuGreSection(ElementSection):
    """g = σ₀ z + σ₁ ż + σ₂ v, ż = v - σ₀ |v| z / s(v), s = F_C + (F_S - F_C) exp(-(v / v_S)²)."""

    kind: Literal["lugre"]
    bristle_stiffness_n_m: Positive
    bristle_damping_ns_m: NotNegative = 0.0
    viscous_damping_ns_m: NotNegative = 0.0
    coulomb_force_n: Positive
    static_force_n: Positive
    stribeck_velocity_m_s: Positive

    @model_validator(mode="after")
    def _static_is_larger(self) -> LuGreSection:
        if self.static_force_n < self.coulomb_force_n:
            raise ValueError("static_force_n must not be smaller than coulomb_force_n")
        return self


class FractionalDamperSection(ElementSection):
    """g = c dᵅw/dtᵅ between two frequencies, as a ladder of Maxwell elements."""

    kind: Literal["fractional_damper"]
    coefficient_n_sa_m: Positive
    order: Annotated[float, Field(gt=0, lt=1)] = 0.5
    low_hz: Positive = 0.1
    high_hz: Positive = 10_000.0

    @model_validator(mode="after")
    def _band(self) -> FractionalDamperSection:
        if self.low_hz >= self.high_hz:
            raise ValueError("low_hz must be smaller than high_hz")
        return self


class TunedMassQuadraticSection(ElementSection):
    """Oscillator beside the structure with the coupling energy κ w² y: 1:2 resonance where it is tuned to 2 ω."""

    kind: Literal["tuned_mass_quadratic"]
    mass_kg: Positive
    frequency_hz: Positive
    damping_ratio: NotNegative = 0.0
    coupling_n_m2: float


class RattlingMassSection(ElementSection):
    """Loose mass with free play: strikes at |w - y| = gap, is carried by viscous friction alone in between."""

    kind: Literal["rattling_mass"]
    mass_kg: Positive
    gap_m: Positive
    contact_stiffness_n_m: Positive
    contact_damping_ns_m2: NotNegative = 0.0
    friction_ns_m: NotNegative = 0.0


AnyElement = Annotated[
    JenkinsSection
    | IwanSection
    | CubicSpringSection
    | QuinticSpringSection
    | QuadraticSpringSection
    | UnilateralStopSection
    | TwoSidedGapSection
    | QuadraticDragSection
    | LinearSpringSection
    | LinearDamperSection
    | TanhFrictionSection
    | EddyBrakeSection
    | BacklashDamperSection
    | BoucWenSection
    | LuGreSection
    | FractionalDamperSection
    | TunedMassQuadraticSection
    | RattlingMassSection,
    Field(discriminator="kind"),
]


class ShakerSection(Section):
    """Electrodynamic shaker, its table joined to `point` by a rigid stinger; driven by a voltage."""

    kind: Literal["electrodynamic_shaker"]
    point: Point
    table_mass_kg: Positive
    table_stiffness_n_m: NotNegative
    table_damping_ns_m: NotNegative
    coil_mass_kg: Positive
    coil_stiffness_n_m: Positive
    coil_damping_ns_m: NotNegative
    force_factor_n_a: Positive
    inductance_h: Positive
    resistance_ohm: Positive
    source_resistance_ohm: float = 0.0
    amplifier_saturation_v: Positive | None = None
    force_factor_linear_per_m: float = 0.0
    force_factor_quadratic_per_m2: float = 0.0

    @model_validator(mode="after")
    def _circuit_loses(self) -> ShakerSection:
        if not self.resistance_ohm + self.source_resistance_ohm > 0:
            raise ValueError("resistance_ohm and source_resistance_ohm must have a positive sum")
        return self


class ForceSection(Section):
    """Ideal force at `point`, `newton_per_volt` times the drive voltage."""

    kind: Literal["force"]
    point: Point
    newton_per_volt: Positive = 1.0


class TransverseSection(Section):
    """Share of the same quantity at another point that a sensor records as well."""

    point: Point
    fraction: float


class SensorSection(Section):
    """One channel. Noise: density S in units²/Hz, variance S / correlation time (see sensors.py)."""

    quantity: Literal["force", "displacement", "velocity", "acceleration", "voltage", "current"]
    point: Point | Literal["drive"] | None = None
    channel: Name | None = None
    gain: float = 1.0
    noise_psd: NotNegative = 0.0
    noise_correlation_time_s: NotNegative = 0.0
    range: Positive | None = None
    bits: Annotated[int, Field(ge=2, le=32)] | None = None
    mass_kg: float = 0.0
    transverse: TransverseSection | None = None
    dead_zone: NotNegative = 0.0
    low_pass_hz: Positive | None = None
    high_pass_hz: Positive | None = None
    delay_s: float = 0.0
    hum_amplitude: NotNegative = 0.0
    hum_hz: Positive = 50.0
    crosstalk_per_volt: float = 0.0
    clip: Positive | None = None
    dropped_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> SensorSection:
        if self.quantity in ("displacement", "velocity", "acceleration") and self.point is None:
            raise ValueError(f"point is missing; a {self.quantity} sensor needs a point number or drive")
        if self.quantity in ("voltage", "current") and self.point is not None:
            raise ValueError(f"a {self.quantity} sensor belongs to no point; remove point")
        if self.quantity == "force" and self.point not in (None, "drive"):
            raise ValueError("force is measured at the drive point; write point: drive")
        if self.bits is not None and self.range is None:
            raise ValueError("bits needs range, the converter's full scale")
        if self.gain == 0.0:
            raise ValueError("gain must not be zero, got 0")
        if self.quantity in ("voltage", "current") and (self.mass_kg != 0.0 or self.transverse is not None):
            raise ValueError(f"a {self.quantity} sensor moves with no point; remove mass_kg and transverse")
        if self.quantity == "force" and self.transverse is not None:
            raise ValueError("the force is measured at one point; remove transverse")
        return self


class LimitSection(Section):
    """Amplitudes beyond which the drive ramps to zero and stays there until reset; left out = no limit."""

    voltage_v: Positive | None = None
    force_n: Positive | None = None
    acceleration_m_s2: Positive | None = None
    displacement_m: Positive | None = None
    ramp_s: NotNegative = 0.1


class WatchdogSection(Section):
    """Drive to zero after `blocks` blocks without a command; 0 turns the watchdog off."""

    blocks: Annotated[int, Field(ge=0)] = 50
    ramp_s: NotNegative = 0.5


class TestSection(Section):
    """Defaults of a test on this rig: target mode (from 1), levels in volts of drive amplitude."""

    __test__ = False
    mode: Annotated[int, Field(ge=1)] = 1
    levels: Annotated[str, Field(pattern=r"^[-+0-9.eE:, ]+$")] = "0.05:1.5:10"
    ramp_s: Positive = 0.5
    window_periods: Annotated[int, Field(ge=3)] = 200
    lock_timeout_s: Positive = 60.0


class HysteresisSection(Section):
    """Chain m1 - leaf spring - m2 - joint - m3 whose hysteresis loops are evaluated; masses as weighed.

    Nothing is evaluated in tests whose exciter is at another point than m1.
    """

    excited_point: Point
    middle_point: Point
    free_point: Point
    excited_mass_kg: Positive
    free_mass_kg: Positive

    @model_validator(mode="after")
    def _three_points(self) -> HysteresisSection:
        if len({self.excited_point, self.middle_point, self.free_point}) != 3:
            raise ValueError("needs three different points: excited_point, middle_point and free_point")
        return self


class ExtractionSection(Section):
    """Harmonics of the extraction and how many linear modes Φ has (no more than response points)."""

    harmonics: Annotated[int, Field(ge=1, le=50)] = 7
    linear_modes: Annotated[int, Field(ge=1)] = 2
    quantity: Literal["displacement", "acceleration"] = "displacement"
    hysteresis: HysteresisSection | None = None


class DriftSection(Section):
    """Slow relative changes with bench time: of all slip forces (per second, per drive period), of the stiffness."""

    slip_force_per_s: float = 0.0
    slip_force_per_cycle: float = 0.0
    stiffness_per_s: float = 0.0


def _plain_setting(value: Any) -> Any:
    """One setting of the loop: a finite number, a word, or true or false; the loop itself checks the rest."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"must be a finite number, got {value}")
    if not isinstance(value, bool | int | float | str):
        raise ValueError(f"must be a number, a word, or true or false, got {value!r}")
    return value


class Rig(Section):
    """A rig file. See the beam's file for the meaning of every key."""

    name: Name
    description: str = ""
    assumptions: list[str] = []
    seed: Annotated[int, Field(ge=0)] = 0
    sample_rate_hz: Positive = 10_000.0
    block_samples: Annotated[int, Field(ge=1, le=5000)] = 200
    substeps: Annotated[int, Field(ge=1, le=64)] = 1
    structure: Annotated[BeamSection | ChainSection, Field(discriminator="kind")]
    local_elements: list[AnyElement] = []
    exciter: Annotated[ShakerSection | ForceSection, Field(discriminator="kind")]
    sensors: Annotated[list[SensorSection], Field(min_length=1)]
    limits: LimitSection = LimitSection()
    watchdog: WatchdogSection = WatchdogSection()
    test: TestSection = TestSection()
    extraction: ExtractionSection = ExtractionSection()
    pll: dict[str, Annotated[Any, AfterValidator(_plain_setting)]] = {}
    clock_error: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0
    drift: DriftSection = DriftSection()

    @property
    def drive_point(self) -> int:
        """Point number of the exciter."""
        return self.exciter.point

    def sensor_point(self, sensor: SensorSection) -> int:
        """Point of a sensor, 0 for voltage and current."""
        if sensor.quantity in ("voltage", "current"):
            return 0
        return sensor.point if isinstance(sensor.point, int) else self.drive_point

    def sensor_channel(self, sensor: SensorSection) -> str:
        """Channel name: as given, or f, x, v, a with the point, u for voltage, i for current."""
        if sensor.channel is not None:
            return sensor.channel
        letter = {"force": "f", "displacement": "x", "velocity": "v", "acceleration": "a"}.get(sensor.quantity)
        if letter is None:
            return {"voltage": "u", "current": "i"}[sensor.quantity]
        return f"{letter}{self.sensor_point(sensor)}"

    def response_points(self, quantity: Quantity) -> tuple[int, ...]:
        """Points of the sensors of one quantity, in the order of the file."""
        return tuple(self.sensor_point(s) for s in self.sensors if Quantity[s.quantity.upper()] == quantity)


_HYSTERESIS_POINTS = ("excited_point", "middle_point", "free_point")


def _points_used(rig: Rig) -> Iterator[tuple[KeyPath, int]]:
    yield ("exciter", "point"), rig.exciter.point
    for index, element in enumerate(rig.local_elements):
        yield ("local_elements", index, "point"), element.point
        if element.other_point is not None:
            yield ("local_elements", index, "other_point"), element.other_point
    for index, mass in enumerate(rig.structure.added_masses):
        yield ("structure", "added_masses", index, "point"), mass.point
    for index, sensor in enumerate(rig.sensors):
        if isinstance(sensor.point, int):
            yield ("sensors", index, "point"), sensor.point
        if sensor.transverse is not None:
            yield ("sensors", index, "transverse", "point"), sensor.transverse.point
    if rig.extraction.hysteresis is not None:
        for name in _HYSTERESIS_POINTS:
            yield ("extraction", "hysteresis", name), getattr(rig.extraction.hysteresis, name)


def _check_references(rig: Rig, document: RigDocument) -> None:
    """What one section says about another: points exist, channels are unique, a current needs a shaker."""
    points = rig.structure.points
    for path, point in _points_used(rig):
        if point not in points:
            raise BenchError(
                f"{document.place(path)}: {_dotted(path)} is {point}, but the structure has points 1 to {points[-1]}."
            )
    for index, element in enumerate(rig.local_elements):
        if element.other_point == element.point:
            path = ("local_elements", index, "other_point")
            raise BenchError(f"{document.place(path)}: {_dotted(path)} must differ from point.")
        _check_element(rig, index, element, document)
    seen: dict[str, int] = {}
    for index, sensor in enumerate(rig.sensors):
        channel = rig.sensor_channel(sensor)
        path = ("sensors", index)
        if channel in seen:
            raise BenchError(
                f"{document.place(path)}: channel {channel} exists already (sensors.{seen[channel]}); "
                "remove one or give it another channel name."
            )
        seen[channel] = index
        if sensor.delay_s < -1.0 / rig.sample_rate_hz:
            place = document.place((*path, "delay_s"))
            raise BenchError(
                f"{place}: sensors.{index}.delay_s is {sensor.delay_s:g}; a channel can lead by one sampling interval "
                f"({1.0 / rig.sample_rate_hz:g} s) at most; delay the other channels instead."
            )
        if sensor.quantity == "current" and not isinstance(rig.exciter, ShakerSection):
            raise BenchError(f"{document.place(path)}: a current sensor needs an electrodynamic_shaker.")
    if not any(sensor.quantity == "force" for sensor in rig.sensors):
        raise BenchError(f"{document.place(('sensors',))}: sensors needs a force sensor at the drive point.")
    responses = len(rig.response_points(Quantity[rig.extraction.quantity.upper()]))
    if responses == 0:
        raise BenchError(
            f"{document.place(('extraction', 'quantity'))}: extraction.quantity is "
            f"{rig.extraction.quantity}, but there is no such sensor."
        )
    if rig.extraction.linear_modes > responses or rig.test.mode > rig.extraction.linear_modes:
        place = document.place(("extraction", "linear_modes"))
        raise BenchError(
            f"{place}: extraction.linear_modes must be between test.mode ({rig.test.mode}) and the number of "
            f"{rig.extraction.quantity} sensors ({responses}), got {rig.extraction.linear_modes}."
        )
    _check_hysteresis(rig, document)


def _check_hysteresis(rig: Rig, document: RigDocument) -> None:
    """The loops need the motion of all three masses."""
    section = rig.extraction.hysteresis
    if section is None:
        return
    measured = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    for name in _HYSTERESIS_POINTS:
        path = ("extraction", "hysteresis", name)
        point = getattr(section, name)
        if point not in measured:
            raise BenchError(
                f"{document.place(path)}: {_dotted(path)} is {point}, where there is no "
                f"{rig.extraction.quantity} sensor."
            )


def _check_element(rig: Rig, index: int, element: ElementSection, document: RigDocument) -> None:
    """Side and rotation fit exciter and structure."""
    if element.side == "exciter" and isinstance(
        element,
        BoucWenSection | LuGreSection | FractionalDamperSection | TunedMassQuadraticSection | RattlingMassSection,
    ):
        place = document.place(("local_elements", index, "side"))
        raise BenchError(f"{place}: local_elements.{index} ({element.kind}) can only be on the side of the structure.")
    if element.side == "exciter" and (element.point != rig.drive_point or element.other_point is not None):
        place = document.place(("local_elements", index, "side"))
        raise BenchError(
            f"{place}: local_elements.{index} is on the side of the exciter, so its point must be the drive point "
            f"({rig.drive_point}) and it must not have an other_point."
        )
    if element.rotation and not isinstance(rig.structure, BeamSection):
        place = document.place(("local_elements", index, "rotation"))
        raise BenchError(f"{place}: local_elements.{index}.rotation needs a beam; points of a chain do not rotate.")


def _dotted(path: Sequence[str | int]) -> str:
    return ".".join(str(part) for part in path)


def _plain_path(location: Sequence[str | int], values: Any) -> KeyPath:
    """pydantic's location without the tags of unions."""
    path: list[str | int] = []
    node = values
    rest = list(location)
    while rest:
        part = rest.pop(0)
        known = isinstance(node, dict) and part in node
        if known or (isinstance(node, list) and isinstance(part, int) and part < len(node)):
            node = node[part]
        elif rest or not isinstance(node, dict | list):
            continue
        path.append(part)
    return tuple(path)


_SENTENCES = {
    "greater_than": "must be positive",
    "finite_number": "must be a finite number",
    "float_type": "must be a number in the unit that its name says",
    "float_parsing": "must be a number in the unit that its name says",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "string_type": "must be a text",
    "list_type": "must be a list",
    "dict_type": "must be a mapping of keys to values",
    "model_type": "must be a mapping of keys to values",
    "model_attributes_type": "must be a mapping of keys to values",
}


def _suggestion(key: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"known keys are {', '.join(known)}."


def _known_keys(values: Any, path: KeyPath) -> list[str]:
    """Keys of the section that contains the last part of `path`."""
    section: Any = Rig
    node = values
    for part in path[:-1]:
        node = node[part]
        if isinstance(part, int):
            section = _variant(section, node)
            continue
        annotation = section.model_fields[part].annotation
        section = _variant(annotation, node)
    return list(section.model_fields) if hasattr(section, "model_fields") else []


def _variant(annotation: Any, node: Any) -> Any:
    """The section class that `node` is an instance of, or the annotation of a list's entries."""
    arguments = getattr(annotation, "__args__", ())
    metadata = getattr(annotation, "__metadata__", None)
    if metadata is not None:
        return _variant(annotation.__origin__, node)
    if isinstance(node, list):
        return arguments[0] if arguments else annotation
    for candidate in arguments:
        field = candidate.model_fields.get("kind") if hasattr(candidate, "model_fields") else None
        if field is not None and isinstance(node, dict) and node.get("kind") in field.annotation.__args__:
            return candidate
    return annotation


def _sentence(error: ErrorDetails, document: RigDocument) -> str:
    path = _plain_path(error["loc"], document.values)
    kind = error["type"]
    name = _dotted(path) or "the rig"
    given = error["input"]
    shown = "null" if given is None else repr(given) if isinstance(given, str) else f"{given}"
    if len(shown) > 60:
        shown = shown[:57] + "..."
    context = error.get("ctx", {})
    if kind == "extra_forbidden":
        known = _known_keys(document.values, path)
        return f"{document.place(path)}: unknown key {name}; {_suggestion(str(path[-1]), known)}"
    if kind == "missing":
        return f"{document.place(path)}: {name} is missing; add it."
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        # The location of a discriminated union is the section; the key at fault is its `kind`.
        expected = context.get("expected_tags") or "one of the known kinds"
        tag = given.get("kind") if isinstance(given, dict) else None
        end = f"got {tag!r}" if tag is not None else "it is missing"
        return f"{document.place((*path, 'kind'))}: {name}.kind must be one of {expected}; {end}."
    if kind == "value_error":
        return f"{document.place(path)}: {name} {context.get('error', error['msg'])}."
    if kind == "greater_than" and context.get("gt") not in (0, 0.0):
        sentence = f"must be greater than {context['gt']}"
    elif kind == "greater_than_equal":
        bound = context["ge"]
        sentence = "must not be negative" if bound == 0 else f"must be at least {bound:g}"
    elif kind == "less_than_equal":
        sentence = f"must be at most {context['le']:g}"
    elif kind == "literal_error":
        sentence = f"must be {context['expected']}"
    elif kind == "string_pattern_mismatch":
        sentence = f"does not have the form {context['pattern']}"
    elif kind in ("too_short", "too_long"):
        sentence = "has too few entries" if kind == "too_short" else "has too many entries"
        shown = f"{context.get('actual_length')}"
    else:
        sentence = _SENTENCES.get(kind, error["msg"].replace("Input should", "should"))
    return f"{document.place(path)}: {name} {sentence}, got {shown}."


def validate_rig(document: RigDocument) -> Rig:
    """Rig from a parsed file.

    Raises:
        BenchError: the first thing that is wrong, with file and line, and how many more there are.
    """
    try:
        rig = Rig.model_validate(document.values)
    except ValidationError as failure:
        # A misspelt key is also a missing one: name what is there and wrong first.
        errors = sorted(failure.errors(include_url=False), key=lambda error: error["type"] != "extra_forbidden")
        sentence = _sentence(errors[0], document)
        more = len(errors) - 1
        raise BenchError(sentence + (f" ({more} more like this)" if more else "")) from failure
    _check_references(rig, document)
    return rig


def _rig_folders() -> list[Path]:
    folders = [Path(part) for part in os.environ.get(RIG_PATH_VARIABLE, "").split(os.pathsep) if part]
    folders.append(Path(__file__).parent / "rigs")
    return folders


def rig_names() -> list[str]:
    """Names of the rigs that can be loaded without a path."""
    return sorted({path.stem for folder in _rig_folders() for path in folder.glob("*.yaml")})


def find_rig(path_or_name: str | Path) -> Path:
    """File of a rig given by path, or by name: NMT_RIG_PATH first, then the shipped rigs.

    Raises:
        BenchError: there is no such rig.
    """
    path = Path(path_or_name)
    if os.path.isfile(path):  # unlike Path.is_file it does not raise for a name that is too long
        return path
    if re.fullmatch(r"[A-Za-z0-9_-]+", str(path_or_name)):
        for folder in _rig_folders():
            candidate = folder / f"{path_or_name}.yaml"
            if candidate.is_file():
                return candidate
    known = ", ".join(rig_names()) or "none"
    raise BenchError(f"there is no rig {path_or_name}; give the path of a rig file or one of: {known}.")


def load_rig(path_or_name: str | Path, overrides: Sequence[str] = ()) -> Rig:
    """Load and validate a rig.

    Args:
        path_or_name: path of a YAML file, or the name of a shipped rig.
        overrides: `a.b.c=value`, validated like the file itself; `exciter.point` takes the elements on its side along.

    Raises:
        BenchError: no such rig, anything wrong in it or in an override, with the line, or a model that cannot be
            computed.
    """
    document = read_document(find_rig(path_or_name))
    changed = apply_overrides(document, overrides)
    _move_exciter_elements(document.values, changed.values)
    rig = validate_rig(changed)
    from nmt_rig.dry_run import check_physics  # it needs the models, which need this module

    check_physics(rig, changed)
    return rig


def _move_exciter_elements(before: Any, after: Any) -> None:
    """Elements on the side of the exciter go with it where an override moves its point; `after` is changed."""
    try:
        old, new = before["exciter"]["point"], after["exciter"]["point"]
        elements = after.get("local_elements") or []
        for element in elements:
            if element.get("side") == "exciter" and element.get("point") == old:
                element["point"] = new
    except (AttributeError, KeyError, TypeError):
        return  # not a rig: validation says what is wrong
