"""Rig files: what a rig consists of, validated; every number carries its unit in the name of its key."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError, model_validator

from nmt_core.errors import BenchError
from nmt_core.files.validation_sentence import validation_sentence
from nmt_core.messages.blocks import Quantity
from nmt_rig.device_sections import AnyDevice, with_driver_folder
from nmt_rig.device_sections import InputPortSection as InputPortSection
from nmt_rig.device_sections import NiDaqmxSection as NiDaqmxSection
from nmt_rig.device_sections import OutputPortSection as OutputPortSection
from nmt_rig.device_sections import PortAudioSection as PortAudioSection
from nmt_rig.device_sections import StopInputSection as StopInputSection
from nmt_rig.model.local_elements import AnyElement
from nmt_rig.model.local_elements.attachments import AttachmentSection
from nmt_rig.one_of_several import with_one_exciter
from nmt_rig.rig_file import KeyPath, RigDocument, apply_overrides, read_document
from nmt_rig.rig_places import RIG_PATH_VARIABLE as RIG_PATH_VARIABLE
from nmt_rig.rig_places import find_rig as find_rig
from nmt_rig.rig_places import rig_names as rig_names
from nmt_rig.rig_section import Name, NotNegative, Point, Positive
from nmt_rig.rig_section import Section as Section
from nmt_rig.structure_files import completed, names_files, with_channels, with_file_contents
from nmt_rig.structure_sections import AddedMassSection as AddedMassSection
from nmt_rig.structure_sections import AnyStructure, point_words
from nmt_rig.structure_sections import BeamSection as BeamSection
from nmt_rig.structure_sections import ChainSection as ChainSection
from nmt_rig.structure_sections import MatricesSection as MatricesSection
from nmt_rig.structure_sections import MatrixPointSection as MatrixPointSection
from nmt_rig.structure_sections import ModalSection as ModalSection
from nmt_rig.structure_sections import ModeSection as ModeSection
from nmt_rig.structure_sections import ResidualSection as ResidualSection
from nmt_rig.structure_sections import StructureSection as StructureSection


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


class ShakingTableSection(Section):
    """Table that moves all supports of the structure; a volt asks for an acceleration (see model/shaking_table.py).

    The force channel of such a rig is the force at `point` that does the base motion's power on the target mode,
    -effective_mass_kg times the table's acceleration.
    """

    kind: Literal["shaking_table"]
    point: Point
    acceleration_per_volt_m_s2: Positive = 1.0
    effective_mass_kg: float | None = None
    bandwidth_hz: Positive | None = None
    suspension_hz: Positive | None = None
    suspension_damping_ratio: NotNegative = 0.7
    responses: Literal["relative", "absolute"] = "relative"

    @model_validator(mode="after")
    def _mass_is_there(self) -> ShakingTableSection:
        if self.effective_mass_kg == 0.0:
            raise ValueError("effective_mass_kg must not be zero; leave it out to have it computed")
        return self


AnyExciter = ShakerSection | ForceSection | ShakingTableSection


class TransverseSection(Section):
    """Share of the same quantity at another point that a sensor records as well."""

    point: Point
    fraction: float


class SensorSection(Section):
    """One channel. Noise: density S in units²/Hz, variance S / correlation time (see sensors.py)."""

    quantity: Literal["force", "displacement", "velocity", "acceleration", "voltage", "current"]
    point: Point | Literal["drive"] | None = None
    exciter: Annotated[int, Field(ge=1)] | None = None
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
        if self.exciter is not None and self.quantity not in ("voltage", "current"):
            raise ValueError(f"exciter says whose voltage or current it is; remove it from a {self.quantity} sensor")
        if self.bits is not None and self.range is None:
            raise ValueError("bits needs range, the converter's full scale")
        if self.gain == 0.0:
            raise ValueError("gain must not be zero, got 0")
        if self.quantity in ("voltage", "current") and (self.mass_kg != 0.0 or self.transverse is not None):
            raise ValueError(f"a {self.quantity} sensor moves with no point; remove mass_kg and transverse")
        if self.quantity == "force" and self.transverse is not None:
            raise ValueError("the force is measured at one point; remove transverse")
        return self


class ChannelLimitSection(Section):
    """Levels of one channel in its SI unit; abort levels take the drive to zero, warning levels are reported."""

    channel: Name
    abort_peak: Positive | None = None
    abort_rms: Positive | None = None
    warning_peak: Positive | None = None
    warning_rms: Positive | None = None

    @model_validator(mode="after")
    def _levels_fit(self) -> ChannelLimitSection:
        if not (self.abort_peak or self.abort_rms or self.warning_peak or self.warning_rms):
            raise ValueError("has no level; give abort_peak, abort_rms, warning_peak or warning_rms")
        for kind, warning, abort in (
            ("peak", self.warning_peak, self.abort_peak),
            ("rms", self.warning_rms, self.abort_rms),
        ):
            if warning is not None and abort is not None and warning > abort:
                raise ValueError(f"warning_{kind} must not be larger than abort_{kind}")
        return self


class OpenLoopSection(Section):
    """The drive is on and a channel does not respond: the drive goes to zero."""

    channel: Name
    least: Positive
    drive_v: Positive
    time_s: Positive = 0.5


class LimitSection(Section):
    """Amplitudes beyond which the drive ramps to zero and stays there until reset; left out = no limit."""

    voltage_v: Positive | None = None
    slew_v_s: Positive | None = None
    rise_from_v: Positive | None = None
    drive_maximum_v: Positive | None = None
    force_n: Positive | None = None
    acceleration_m_s2: Positive | None = None
    velocity_m_s: Positive | None = None
    displacement_m: Positive | None = None
    channels: list[ChannelLimitSection] = Field(default_factory=list)
    open_loop: list[OpenLoopSection] = Field(default_factory=list)
    warning_share: Annotated[float, Field(gt=0, le=1)] = 0.8
    rms_time_s: Positive = 1.0
    ramp_s: NotNegative = 0.1

    @model_validator(mode="after")
    def _maximum_is_reached(self) -> LimitSection:
        if self.voltage_v is not None and self.drive_maximum_v is not None and self.drive_maximum_v > self.voltage_v:
            raise ValueError("drive_maximum_v must not be larger than voltage_v, which no drive passes")
        return self


class WatchdogSection(Section):
    """Drive to zero after `blocks` blocks without a command; 0 turns the watchdog off."""

    blocks: Annotated[int, Field(ge=0)] = 50
    ramp_s: NotNegative = 0.5


class TestSection(Section):
    """Defaults of a test on this rig: target mode (from 1), levels in volts of drive amplitude.

    ``response_levels``: amplitudes of the response at the drive point for a self-excited test.
    """

    __test__ = False
    mode: Annotated[int, Field(ge=1)] = 1
    levels: Annotated[str, Field(pattern=r"^[-+0-9.eE:, ]+$")] = "0.05:1.5:10"
    response_levels: Annotated[str, Field(pattern=r"^[-+0-9.eE:, ]*$")] = ""
    ramp_s: Positive = 0.5
    window_periods: Annotated[int, Field(ge=3)] = 200
    lock_timeout_s: Positive = 60.0
    harmonics_control: Annotated[int, Field(ge=0, le=50)] | Literal["auto"] = 0
    harmonics_target: Literal["force", "modal"] = "force"


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
    quantity: Literal["displacement", "velocity", "acceleration"] = "displacement"
    hysteresis: HysteresisSection | None = None


class DriftSection(Section):
    """Slow relative changes with bench time: of all slip forces (per second, per drive period), of the stiffness."""

    slip_force_per_s: float = 0.0
    slip_force_per_cycle: float = 0.0
    stiffness_per_s: float = 0.0


class RecordingSection(Section):
    """How samples are kept: significant bits of their values (24 as in single precision), compression of the bag."""

    sample_bits: Annotated[int, Field(ge=16, le=53)] = 24
    compression: Literal["none", "lz4", "zstd"] = "zstd"


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
    assumptions: Annotated[list[str], Field(default_factory=list)]
    seed: Annotated[int, Field(ge=0)] = 0
    sample_rate_hz: Positive = 10_000.0
    block_samples: Annotated[int, Field(ge=1, le=5000)] = 200
    substeps: Annotated[int, Field(ge=1, le=64)] = 1
    structure: Annotated[AnyStructure, Field(discriminator="kind")]
    local_elements: Annotated[list[AnyElement], Field(default_factory=list)]
    exciter: Annotated[AnyExciter, Field(discriminator="kind")]
    exciters: list[Annotated[AnyExciter, Field(discriminator="kind")]] | None = None
    sensors: Annotated[list[SensorSection], Field(min_length=1)]
    limits: LimitSection = LimitSection()
    watchdog: WatchdogSection = WatchdogSection()
    test: TestSection = TestSection()
    extraction: ExtractionSection = ExtractionSection()
    pll: Annotated[dict[str, Annotated[Any, AfterValidator(_plain_setting)]], Field(default_factory=dict)]
    clock_error: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0
    drift: DriftSection = DriftSection()
    recording: RecordingSection | None = None
    device: Annotated[AnyDevice, Field(discriminator="kind")] | None = None

    @model_validator(mode="before")
    @classmethod
    def _first_of_several(cls, values: Any) -> Any:
        """Of several exciters the first is the exciter that all tests with one know."""
        if isinstance(values, dict) and isinstance(values.get("exciters"), list) and values["exciters"]:
            return {"exciter": values["exciters"][0], **values}
        return values

    @model_validator(mode="after")
    def _exciters_agree(self) -> Rig:
        if self.exciters is not None and (not self.exciters or self.exciters[0] != self.exciter):
            raise ValueError("give either exciter or exciters, a list of which the first is the reference")
        return self

    @property
    def drive_point(self) -> int:
        """Point number of the exciter, of several the first."""
        return self.exciter.point

    @property
    def all_exciters(self) -> tuple[AnyExciter, ...]:
        """Every exciter, in the order of the file."""
        return (self.exciter,) if self.exciters is None else tuple(self.exciters)

    @property
    def exciter_points(self) -> tuple[int, ...]:
        """Point number of every exciter."""
        return tuple(exciter.point for exciter in self.all_exciters)

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
            number = "" if sensor.exciter in (None, 1) else str(sensor.exciter)
            return {"voltage": "u", "current": "i"}[sensor.quantity] + number
        return f"{letter}{self.sensor_point(sensor)}"

    def response_points(self, quantity: Quantity) -> tuple[int, ...]:
        """Points of the sensors of one quantity, in the order of the file."""
        return tuple(self.sensor_point(s) for s in self.sensors if Quantity[s.quantity.upper()] == quantity)


_HYSTERESIS_POINTS = ("excited_point", "middle_point", "free_point")


def _points_used(rig: Rig) -> Iterator[tuple[KeyPath, int]]:
    if rig.exciters is None:
        yield ("exciter", "point"), rig.exciter.point
    for index, exciter in enumerate(rig.exciters or ()):
        yield ("exciters", index, "point"), exciter.point
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
                f"{document.place(path)}: {_dotted(path)} is {point}, but the structure has {point_words(points)}."
            )
    for index, element in enumerate(rig.local_elements):
        if element.other_point == element.point:
            path = ("local_elements", index, "other_point")
            raise BenchError(f"{document.place(path)}: {_dotted(path)} must differ from point.")
        _check_element(rig, index, element, document)
    _check_exciters(rig, document)
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
        _check_exciter_of(rig, index, sensor, document)
    limited = {
        "channels": [entry.channel for entry in rig.limits.channels],
        "open_loop": [entry.channel for entry in rig.limits.open_loop],
    }
    for key, names in limited.items():
        for index, name in enumerate(names):
            if name not in seen:
                limit_path = ("limits", key, index, "channel")
                raise BenchError(
                    f"{document.place(limit_path)}: {_dotted(limit_path)} is {name}, but there is no such channel; the "
                    f"channels are {', '.join(seen)}."
                )
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
    if isinstance(rig.structure, ModalSection) and rig.extraction.linear_modes > len(rig.structure.modes):
        place = document.place(("extraction", "linear_modes"))
        raise BenchError(
            f"{place}: extraction.linear_modes is {rig.extraction.linear_modes}, but the structure has "
            f"{len(rig.structure.modes)} modes; lower it."
        )
    if isinstance(rig.exciter, ShakingTableSection) and rig.exciters is None:
        _check_table(rig, rig.exciter, document)
    _check_hysteresis(rig, document)
    _check_device(rig, document, seen)


def _check_exciter_of(rig: Rig, index: int, sensor: SensorSection, document: RigDocument) -> None:
    """A force is measured at an exciter; voltage and current belong to one that is there."""
    place = document.place(("sensors", index))
    if sensor.quantity == "force" and rig.sensor_point(sensor) not in rig.exciter_points:
        raise BenchError(
            f"{place}: sensors.{index}: force is measured at the drive point; write point: drive"
            + (f", or one of {', '.join(map(str, rig.exciter_points))}." if rig.exciters else ".")
        )
    if sensor.quantity not in ("voltage", "current"):
        return
    number = sensor.exciter or 1
    if number > len(rig.all_exciters):
        raise BenchError(
            f"{place}: sensors.{index}.exciter is {number}, but the rig has {len(rig.all_exciters)}; give a number "
            "from 1 on, or leave it out for the first."
        )
    if sensor.quantity == "current" and not isinstance(rig.all_exciters[number - 1], ShakerSection):
        raise BenchError(f"{place}: a current sensor needs an electrodynamic_shaker.")


def _check_exciters(rig: Rig, document: RigDocument) -> None:
    """Several exciters stand at different points, each with its force and its response measured."""
    if rig.exciters is None:
        return
    measured = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    forces = rig.response_points(Quantity.FORCE)
    for index, exciter in enumerate(rig.exciters):
        place = document.place(("exciters", index))
        if isinstance(exciter, ShakingTableSection):
            raise BenchError(
                f"{place}: exciters.{index}: a shaking_table moves everything; it can only be the exciter."
            )
        if rig.exciter_points.index(exciter.point) != index:
            raise BenchError(f"{place}: exciters.{index}: another exciter is at point {exciter.point} already.")
        if exciter.point not in forces or exciter.point not in measured:
            lacking = "force" if exciter.point not in forces else rig.extraction.quantity
            raise BenchError(
                f"{place}: exciters.{index}: no {lacking} is measured at point {exciter.point}; add "
                f"{{quantity: {lacking}, point: {exciter.point}}} to the sensors."
            )
    if len(rig.exciters) > rig.extraction.linear_modes:
        raise BenchError(
            f"{document.place(('extraction', 'linear_modes'))}: extraction.linear_modes must be at least the number of "
            f"exciters ({len(rig.exciters)}), got {rig.extraction.linear_modes}."
        )


def _check_table(rig: Rig, table: ShakingTableSection, document: RigDocument) -> None:
    """A shaking table needs a structure that says how its base moves it, and takes no part of another exciter."""
    if isinstance(rig.structure, ModalSection):
        for index, mode in enumerate(rig.structure.modes):
            if mode.participation is None:
                place = document.place(("structure", "modes", index))
                raise BenchError(
                    f"{place}: structure.modes.{index} lacks participation; a shaking_table needs it of every mode."
                )
    if isinstance(rig.structure, MatricesSection) and rig.structure.base_load_kg is rig.structure.base_vector is None:
        raise BenchError(
            f"{document.place(('structure',))}: a shaking_table needs structure.base_vector, the displacement of every "
            "row for a unit displacement of the base (or r in the file)."
        )
    for index, element in enumerate(rig.local_elements):
        if element.side == "exciter" or (isinstance(element, AttachmentSection) and element.element.inertial):
            raise BenchError(
                f"{document.place(('local_elements', index))}: local_elements.{index} ({element.kind}) does not go "
                "with a shaking_table: no element on the side of the exciter, and none with a mass of its own."
            )


def _check_device(rig: Rig, document: RigDocument, channels: dict[str, int]) -> None:
    """Every sensor but a drive voltage has a port, every port a sensor, and the drive's limit is within its range."""
    device = rig.device
    if device is None:
        return
    for index, entry in enumerate(device.inputs):
        if entry.channel not in channels:
            path: KeyPath = ("device", "inputs", index, "channel")
            raise BenchError(
                f"{document.place(path)}: {_dotted(path)} is {entry.channel}, but there is no such sensor; the sensors "
                f"are {', '.join(channels)}."
            )
    mapped = {entry.channel for entry in device.inputs}
    for name, row in channels.items():
        if name not in mapped and rig.sensors[row].quantity != "voltage":
            raise BenchError(
                f"{document.place(('device', 'inputs'))}: device.inputs has no port for sensor {name}; add one, or "
                "remove the sensor."
            )
    exciters = len(rig.all_exciters)
    if len(device.outputs) != exciters:
        raise BenchError(
            f"{document.place(('device', 'outputs'))}: device.outputs has {len(device.outputs)} drive channels for "
            f"{exciters} exciter{'s' if exciters > 1 else ''}; give one for each, in their order."
        )
    limit = rig.limits.voltage_v
    output = min(device.outputs, key=lambda entry: abs(entry.amplifier_gain) * entry.range_v)
    if limit is None or limit > abs(output.amplifier_gain) * output.range_v * (1.0 + 1e-9):
        raise BenchError(
            f"{document.place(('limits',))}: limits.voltage_v must be there for hardware and at most "
            f"{abs(output.amplifier_gain) * output.range_v:g} V, what the output reaches (range_v, amplifier_gain)."
        )


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


def _check_element(rig: Rig, index: int, element: AnyElement, document: RigDocument) -> None:
    """Side and rotation fit exciter and structure."""
    if element.side == "exciter" and isinstance(element, AttachmentSection):
        place = document.place(("local_elements", index, "side"))
        raise BenchError(f"{place}: local_elements.{index} ({element.kind}) can only be on the side of the structure.")
    if element.side == "exciter" and (element.point != rig.drive_point or element.other_point is not None):
        place = document.place(("local_elements", index, "side"))
        raise BenchError(
            f"{place}: local_elements.{index} is on the side of the exciter, so its point must be the drive point "
            f"({rig.drive_point}) and it must not have an other_point."
        )
    if element.rotation and not isinstance(rig.structure, BeamSection):
        turning = {
            entry.point
            for entry in (rig.structure.points_at if isinstance(rig.structure, MatricesSection) else ())
            if entry.rotation_row is not None
        }
        if not {element.point, element.other_point} - {None} <= turning:
            place = document.place(("local_elements", index, "rotation"))
            raise BenchError(
                f"{place}: local_elements.{index}.rotation needs a beam, or matrices whose points have a rotation_row; "
                f"the points of this {rig.structure.kind} do not rotate."
            )


def _dotted(path: Sequence[str | int]) -> str:
    return ".".join(str(part) for part in path)


_IN_ITS_UNIT = dict.fromkeys(("float_type", "float_parsing"), "must be a number in the unit that its name says")


def validate_rig(document: RigDocument, folder: Path | None = None) -> Rig:
    """Rig from a parsed file.

    Args:
        document: the file.
        folder: where files that its structure names are looked for; the working directory when None.

    Raises:
        BenchError: the first thing that is wrong, with file and line, and how many more there are.
    """
    document = completed(with_file_contents(document, folder or Path()))
    try:
        rig = Rig.model_validate(document.values)
    except ValidationError as failure:
        errors = failure.errors(include_url=False)
        raise BenchError(validation_sentence(errors, document, Rig, "the rig", words=_IN_ITS_UNIT)) from failure
    _check_references(rig, document)
    return rig


def load_rig(path_or_name: str | Path, overrides: Sequence[str] = ()) -> Rig:
    """Load and validate a rig.

    Args:
        path_or_name: path of a YAML file, or the name of a shipped rig.
        overrides: `a.b.c=value`, validated like the file itself; `exciter.point` takes the elements on its side along.

    Raises:
        BenchError: no such rig, anything wrong in it or in an override, with the line, or a model that cannot be
            computed.

    Examples:
        >>> rig = load_rig("beam")
        >>> rig.drive_point, rig.sample_rate_hz
        (2, 10000.0)
        >>> load_rig("beam", ["exciter.point=4", "local_elements.0.slip_force_n=2"]).local_elements[0].slip_force_n
        2.0
        >>> load_rig("wing")
        Traceback (most recent call last):
        nmt_core.errors.BenchError: there is no rig wing...
    """
    path = find_rig(path_or_name)
    document, overrides = with_one_exciter(read_document(path), overrides)
    # What the structure's files hold can be changed too: those that say which file come first.
    first = [text for text in overrides if names_files(text.partition("=")[0].strip())]
    whole = with_file_contents(apply_overrides(document, first), path.parent)
    read = with_channels(with_driver_folder(whole, path.parent))
    changed = apply_overrides(read, [text for text in overrides if text not in first])
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
