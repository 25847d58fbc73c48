"""Section ``device`` of a rig file: which converter, which of its ports carries what, and how many volts a unit makes.

A channel map belongs to one set-up; the rig's sensors say what is measured, the map says where and how. All voltages
are those at the converter's ports. The drive voltage of the bench is the one at the exciter: that of the port times
the amplifier's gain.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from nmt_core.messages.blocks import Quantity
from nmt_rig.rig_section import Name, NotNegative, Positive, Section

Date = Annotated[datetime.date, Field(strict=False)]
SPECIMEN = "nmt_specimen"
"""Name under which the simulated specimen appears among the devices of PortAudio and of NI."""
SPECIMEN_RANGE = 10.0
"""V, range of every port of the simulated specimen."""


class PortSection(Section):
    """A port of the converter and the channel that it carries."""

    channel: Name
    port: int | str
    range_v: Positive = 10.0


class OutputPortSection(PortSection):
    """A drive channel: `port` puts out ±`range_v`, the exciter sees `amplifier_gain` times as much."""

    amplifier_gain: float = 1.0

    @model_validator(mode="after")
    def _gain_is_there(self) -> OutputPortSection:
        if self.amplifier_gain == 0.0:
            raise ValueError("amplifier_gain must not be zero")
        return self


class InputPortSection(PortSection):
    """A measured channel: `sensitivity_v` volts at `port` for one unit of the sensor of that name, V/N, V per m/s².

    uncertainty: standard, relative, of the sensitivity; calibrated: date of the sheet it comes from.
    """

    sensitivity_v: float
    uncertainty: NotNegative | None = None
    calibrated: Date | None = None
    serial: str = ""
    coupling: Literal["dc", "ac"] = "dc"
    icp_ma: Annotated[float, Field(ge=0, le=20)] = 0.0

    @model_validator(mode="after")
    def _sensitivity_is_there(self) -> InputPortSection:
        if self.sensitivity_v == 0.0:
            raise ValueError("sensitivity_v must not be zero")
        return self


class StopInputSection(Section):
    """An analog input that carries the external stop line: the drive goes to zero while it is beyond `threshold_v`.

    stops: ``low`` = below the threshold, as of a line that a cut cable stops, too; ``high`` = above it.
    """

    port: str
    range_v: Positive = 10.0
    threshold_v: Positive = 2.5
    stops: Literal["low", "high"] = "low"

    @model_validator(mode="after")
    def _threshold_is_in_range(self) -> StopInputSection:
        if self.threshold_v >= self.range_v:
            raise ValueError(f"threshold_v must lie within the range of {self.range_v:g} V")
        return self


class DeviceSection(Section):
    """What all converters share.

    check_valid_hours: age up to which a passing check lets a test begin; settling_s: quiet time before the delay is
    measured; icp_settling_s: the same where a sensor has an ICP supply, whose bias takes seconds to settle.
    """

    outputs: Annotated[list[OutputPortSection], Field(min_length=1)]
    inputs: Annotated[list[InputPortSection], Field(min_length=1)]
    check_valid_hours: Positive = 24.0
    settling_s: NotNegative = 0.2
    icp_settling_s: NotNegative = 5.0

    @model_validator(mode="after")
    def _one_port_each(self) -> DeviceSection:
        both: dict[str, Sequence[PortSection]] = {"outputs": self.outputs, "inputs": self.inputs}
        for what, entries in both.items():
            for key in ("port", "channel"):
                values = [getattr(entry, key) for entry in entries]
                twice = [value for value in values if values.count(value) > 1]
                if twice:
                    raise ValueError(f"{what} has {key} {twice[0]} twice")
        if len(self.outputs) != 1:
            raise ValueError("outputs has more than one drive channel; the bench drives one exciter")
        return self

    @property
    def quiet_s(self) -> float:
        """Time before anything is measured, s."""
        return max(self.settling_s, self.icp_settling_s if any(entry.icp_ma for entry in self.inputs) else 0.0)

    @property
    def ports(self) -> tuple[PortSection, ...]:
        """Outputs and inputs."""
        return (*self.outputs, *self.inputs)

    @property
    def output(self) -> OutputPortSection:
        """The drive channel."""
        return self.outputs[0]


class PortAudioSection(DeviceSection):
    """A sound card, or whatever PortAudio reaches; ports are numbers from 1. name: as PortAudio lists it, or a part."""

    kind: Literal["portaudio"]
    name: str = ""
    host_api: str = ""
    latency_s: Positive | None = None

    @model_validator(mode="after")
    def _ports_are_numbers(self) -> PortAudioSection:
        for entry in self.ports:
            if not isinstance(entry.port, int) or entry.port < 1:
                raise ValueError(f"port of {entry.channel} must be a number from 1 on, got {entry.port!r}")
        return self


class NiDaqmxSection(DeviceSection):
    """NI hardware; ports are physical channels, Dev1/ai0. address: host:port of NI's gRPC device server."""

    kind: Literal["nidaqmx"]
    address: str = ""
    start_trigger: str = ""
    clock_source: str = ""
    buffer_blocks: Annotated[int, Field(ge=2, le=16)] = 3
    stop_input: StopInputSection | None = None

    @model_validator(mode="after")
    def _ports_are_names(self) -> NiDaqmxSection:
        for entry in self.ports:
            if not isinstance(entry.port, str) or "/" not in entry.port:
                raise ValueError(f"port of {entry.channel} must be a physical channel as in Dev1/ai0, got {entry.port}")
        stop = self.stop_input
        if stop is not None and (stop.port in [entry.port for entry in self.ports] or "/" not in stop.port):
            raise ValueError(f"port of stop_input must be a physical channel of its own, got {stop.port}")
        return self


AnyDevice = PortAudioSection | NiDaqmxSection
DEVICE_KINDS = ("portaudio", "nidaqmx")
SIMULATED = "simulated"
SIMULATED_OR_CONVERTERS = (SIMULATED, *DEVICE_KINDS)


def specimen_device(
    kind: str, channels: Sequence[tuple[str, Quantity]], limits: dict[Quantity, float], address: str = ""
) -> AnyDevice:
    """The ports of the simulated specimen: the sensors in their order, the limit of each quantity at the full range.

    Args:
        kind: ``portaudio`` or ``nidaqmx``.
        channels: name and quantity of each sensor, the drive voltage included.
        limits: of the rig, SI.
        address: of NI's device server, ``nidaqmx`` only.
    """
    fallback = {Quantity.VELOCITY: 10.0, Quantity.CURRENT: 50.0, Quantity.VOLTAGE: SPECIMEN_RANGE}
    scale = {quantity: limits.get(quantity) or fallback.get(quantity, 100.0) for _, quantity in channels}
    ni = kind == "nidaqmx"
    inputs = [
        InputPortSection(
            channel=name,
            port=f"{SPECIMEN}/ai{number}" if ni else number + 1,
            range_v=SPECIMEN_RANGE,
            sensitivity_v=SPECIMEN_RANGE / scale[quantity],
            uncertainty=0.01,
        )
        for number, (name, quantity) in enumerate(channels)
    ]
    drive = limits.get(Quantity.VOLTAGE) or SPECIMEN_RANGE
    outputs = [
        OutputPortSection(
            channel="u",
            port=f"{SPECIMEN}/ao0" if ni else 1,
            range_v=SPECIMEN_RANGE,
            amplifier_gain=drive / SPECIMEN_RANGE,
        )
    ]
    if ni:
        return NiDaqmxSection(kind="nidaqmx", outputs=outputs, inputs=inputs, address=address)
    return PortAudioSection(kind="portaudio", outputs=outputs, inputs=inputs, name=SPECIMEN)
