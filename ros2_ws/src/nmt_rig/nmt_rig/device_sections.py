"""Section ``device`` of a rig file: which converter, which of its ports carries what, and how many volts a unit makes.

A channel map belongs to one set-up; the rig's sensors say what is measured, the map says where and how. All voltages
are those at the converter's ports. The drive voltage of the bench is the one at the exciter: that of the port times
the amplifier's gain.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast, get_args

from pydantic import Field, model_validator

from nmt_core.errors import BenchError
from nmt_core.files.yaml_document import YamlDocument
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
    """What all converters share, and how a kind of converter describes itself.

    A kind is a subclass with its keys, `driver`, `finder` and `driver_arguments`, in the list `AnyDevice` below. The
    schema, the choices of ``--device``, the check and the reference take it from there; driver and finder are loaded
    by their names where they are used.

    Attributes:
        driver: ``module:Class`` of the `nmt_plant.converters.converter.Converter`.
        finder: ``module:function`` that is called with section and rig, and raises BenchError where the converter is
            not there; empty = nothing is searched for.
        addressed: whether ``--device KIND@HOST:PORT`` names an address of it.
        by_contract: whether its check begins with the contract of a converter, because it is untried.
        outputs: drive channels: one for every exciter, in their order
        inputs: measured channels: one for every sensor; a ``voltage`` sensor without one is what was put out
        check: what must have passed before a test: ``rig`` = every channel against the rig's model, ``converter`` =
            the contract of the converter alone, where what it measures does not follow the drive as the model does
        check_valid_hours: age up to which a passing ``./nmt check`` lets a test begin
        settling_s: quiet time before the delay is measured
        icp_settling_s: the same where an input has an ICP supply: its bias settles in seconds
    """

    driver: ClassVar[str]
    finder: ClassVar[str] = ""
    addressed: ClassVar[bool] = False
    by_contract: ClassVar[bool] = False

    outputs: Annotated[list[OutputPortSection], Field(min_length=1)]
    inputs: Annotated[list[InputPortSection], Field(min_length=1)]
    check: Literal["rig", "converter"] = "rig"
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
        return self

    def driver_arguments(self, sample_rate: float, block_samples: int) -> dict[str, Any]:
        """Keyword arguments of the driver, as JSON allows them.

        Args:
            sample_rate: Hz.
            block_samples: samples in a block.

        Raises:
            NotImplementedError: the kind does not describe itself.
        """
        raise NotImplementedError(f"{type(self).__name__} does not say the arguments of its driver")

    @classmethod
    def of_specimen(
        cls, outputs: list[dict[str, Any]], inputs: list[dict[str, Any]], address: str = ""
    ) -> DeviceSection | None:
        """The section that reaches the simulated specimen.

        Args:
            outputs, inputs: ports, numbered from 1, without what the kind needs besides.
            address: of ``--device KIND@HOST:PORT``.

        Returns:
            The section; None = the specimen cannot stand behind this kind.
        """
        return None

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
        """The drive channel; of several exciters the first."""
        return self.outputs[0]

    def _output_list(self) -> list[list[Any]]:
        """Port, range (V) and amplifier gain of each output."""
        return [[entry.port, entry.range_v, entry.amplifier_gain] for entry in self.outputs]


class PortAudioSection(DeviceSection):
    """A sound card, or whatever PortAudio reaches, as JACK; ports are numbers from 1.

    Attributes:
        name: of the device as PortAudio lists it, or a part of the name; empty = the first that has the ports
        host_api: of PortAudio, or a part of its name: JACK, ALSA
        latency_s: asked of PortAudio; none = its low one
    """

    driver: ClassVar = "nmt_plant.converters.portaudio_converter:PortAudioConverter"
    finder: ClassVar = "nmt_plant.converters.portaudio_converter:find_rig_device"

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

    def driver_arguments(self, sample_rate: float, block_samples: int) -> dict[str, Any]:
        """As the base class."""
        return {
            "sample_rate": sample_rate,
            "outputs": self._output_list(),
            "inputs": [[entry.port, entry.range_v] for entry in self.inputs],
            "name": self.name,
            "host_api": self.host_api,
            "frames": 0,
            "latency": self.latency_s,
        }

    @classmethod
    def of_specimen(
        cls, outputs: list[dict[str, Any]], inputs: list[dict[str, Any]], address: str = ""
    ) -> DeviceSection:
        """The specimen as a client of JACK."""
        return cls.model_validate({"kind": "portaudio", "outputs": outputs, "inputs": inputs, "name": SPECIMEN})


class NiDaqmxSection(DeviceSection):
    """NI hardware; ports are physical channels, ``Dev1/ai0``.

    Attributes:
        address: host:port of NI's gRPC device server; empty = the driver of this computer
        start_trigger: terminal that starts the output; empty = that of the first input's device or its chassis
        clock_source: terminal of the output's sample clock; empty = that of the first input's device or chassis
        buffer_blocks: blocks that the output's buffer holds
        stop_input: analog input of the external stop line; left out = none
    """

    driver: ClassVar = "nmt_plant.converters.nidaqmx_converter:NiDaqmxConverter"
    finder: ClassVar = "nmt_plant.converters.nidaqmx_converter:find_rig_channels"
    addressed: ClassVar = True

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

    def driver_arguments(self, sample_rate: float, block_samples: int) -> dict[str, Any]:
        """As the base class."""
        stop = self.stop_input
        return {
            "sample_rate": sample_rate,
            "outputs": self._output_list(),
            "inputs": [[each.port, each.range_v, each.coupling, each.icp_ma, each.serial] for each in self.inputs],
            "block_samples": block_samples,
            "address": self.address,
            "start_trigger": self.start_trigger,
            "clock_source": self.clock_source,
            "buffer_blocks": self.buffer_blocks,
            "stop": None if stop is None else [stop.port, stop.range_v, stop.threshold_v, stop.stops == "low"],
        }

    @classmethod
    def of_specimen(
        cls, outputs: list[dict[str, Any]], inputs: list[dict[str, Any]], address: str = ""
    ) -> DeviceSection:
        """The specimen as a device of NI's server."""
        for what, entries in (("ao", outputs), ("ai", inputs)):
            for number, entry in enumerate(entries):
                entry["port"] = f"{SPECIMEN}/{what}{number}"
        return cls.model_validate({"kind": "nidaqmx", "outputs": outputs, "inputs": inputs, "address": address})


class LoopbackSection(DeviceSection):
    """No device: what the output puts out comes back at every input; for trying a rig file and the commands.

    Attributes:
        delay_samples: from a sample put out to the same sample measured
    """

    driver: ClassVar = "nmt_plant.converters.converter:LoopbackConverter"
    by_contract: ClassVar = True

    kind: Literal["loopback"]
    check: Literal["rig", "converter"] = "converter"
    delay_samples: Annotated[int, Field(ge=0, le=100_000)] = 0

    @model_validator(mode="after")
    def _one_output(self) -> LoopbackSection:
        if len(self.outputs) != 1:
            raise ValueError(
                f"outputs has {len(self.outputs)} drive channels, but a loopback wires one output to all inputs; use "
                "another kind of converter for several exciters"
            )
        return self

    def driver_arguments(self, sample_rate: float, block_samples: int) -> dict[str, Any]:
        """As the base class."""
        gain = 1.0 / self.output.amplifier_gain
        return {"sample_rate": sample_rate, "inputs": len(self.inputs), "delay": self.delay_samples, "gain": gain}

    @classmethod
    def of_specimen(
        cls, outputs: list[dict[str, Any]], inputs: list[dict[str, Any]], address: str = ""
    ) -> DeviceSection:
        """No specimen, but as many inputs as it has."""
        return cls.model_validate({"kind": "loopback", "outputs": outputs, "inputs": inputs})


class CustomSection(DeviceSection):
    """A driver of your own ([how](../how-to/bring-your-converter.md)), loaded in the process that owns the output.

    Attributes:
        converter: ``module:Class``
        folder: where the module is, from the rig file on, besides Python's own places
        arguments: keyword arguments of the class, besides sampling rate and ports
    """

    driver: ClassVar = "nmt_plant.converters.custom_converter:CustomConverter"
    finder: ClassVar = "nmt_plant.converters.custom_converter:find_rig_driver"
    by_contract: ClassVar = True

    kind: Literal["custom"]
    converter: str
    folder: str = "."
    arguments: Annotated[dict[str, Any], Field(default_factory=dict)]

    @model_validator(mode="after")
    def _converter_is_a_class(self) -> CustomSection:
        if not re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", self.converter):
            raise ValueError(f"converter must be module:Class, as in my_driver:MyDriver, got '{self.converter}'")
        taken = sorted({"sample_rate", "outputs", "inputs"} & set(self.arguments))
        if taken:
            raise ValueError(f"arguments has {taken[0]}, which the class gets from the rig file; leave it out")
        return self

    def driver_arguments(self, sample_rate: float, block_samples: int) -> dict[str, Any]:
        """As the base class."""
        return {
            "converter": self.converter,
            "folder": self.folder,
            "sample_rate": sample_rate,
            "outputs": self._output_list(),
            "inputs": [[entry.port, entry.range_v] for entry in self.inputs],
            "arguments": dict(self.arguments),
        }


AnyDevice = PortAudioSection | NiDaqmxSection | LoopbackSection | CustomSection

DEVICES: dict[str, type[DeviceSection]] = {
    get_args(section.model_fields["kind"].annotation)[0]: section for section in get_args(AnyDevice)
}
"""Every kind of converter by its name in ``device.kind``."""

DEVICE_KINDS = tuple(DEVICES)
SIMULATED = "simulated"
SIMULATED_OR_CONVERTERS = (SIMULATED, *DEVICE_KINDS)


def with_driver_folder(document: YamlDocument, folder: Path) -> YamlDocument:
    """The document with the folder of its driver from the root on, so that its text says it wherever it is put.

    Args:
        document: a rig file.
        folder: where relative paths start.
    """
    device = document.values.get("device")
    if not isinstance(device, Mapping) or device.get("kind") != "custom":
        return document
    given = device.get("folder", ".")
    if not isinstance(given, str):
        return document  # validation says what is wrong
    values = {**document.values, "device": {**device, "folder": str((folder / given).resolve())}}
    return YamlDocument(document.name, values, document.places)


def specimen_device(
    kind: str,
    channels: Sequence[tuple[str, Quantity]],
    limits: dict[Quantity, float],
    address: str = "",
    exciters: int = 1,
) -> AnyDevice:
    """The ports of the simulated specimen: the sensors in their order, the limit of each quantity at the full range.

    Args:
        kind: of :data:`DEVICES`.
        channels: name and quantity of each sensor, the drive voltage included.
        limits: of the rig, SI.
        address: of ``--device KIND@HOST:PORT``.
        exciters: number of exciters, each with an output.

    Raises:
        BenchError: no such kind, or one behind which the specimen cannot stand.
    """
    if kind not in DEVICES:
        raise BenchError(f"There is no kind of converter '{kind}'; use {', '.join(DEVICE_KINDS)}.")
    fallback = {Quantity.VELOCITY: 10.0, Quantity.CURRENT: 50.0, Quantity.VOLTAGE: SPECIMEN_RANGE}
    scale = {quantity: limits.get(quantity) or fallback.get(quantity, 100.0) for _, quantity in channels}
    inputs: list[dict[str, Any]] = [
        {
            "channel": name,
            "port": number,
            "range_v": SPECIMEN_RANGE,
            "sensitivity_v": SPECIMEN_RANGE / scale[quantity],
            "uncertainty": 0.01,
        }
        for number, (name, quantity) in enumerate(channels, start=1)
    ]
    drive = limits.get(Quantity.VOLTAGE) or SPECIMEN_RANGE
    outputs: list[dict[str, Any]] = [
        {
            "channel": "u" if number == 1 else f"u{number}",
            "port": number,
            "range_v": SPECIMEN_RANGE,
            "amplifier_gain": drive / SPECIMEN_RANGE,
        }
        for number in range(1, exciters + 1)
    ]
    section = DEVICES[kind].of_specimen(outputs, inputs, address)
    if section is None:
        raise BenchError(
            f"A converter of kind '{kind}' needs a section 'device' in the rig file; write its ports there."
        )
    return cast(AnyDevice, section)
