"""Sections of a rig file, and the rig that they make."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from nmt_core.messages.blocks import Quantity
from nmt_rig.device_sections import AnyDevice
from nmt_rig.model.local_elements import AnyElement
from nmt_rig.rig_section import Name, NotNegative, Point, Positive, Section
from nmt_rig.structure_sections import AnyStructure


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
    coordinate: Literal["length", "angle"] = "length"
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
