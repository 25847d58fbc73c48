"""The simulated specimen inside a stand-in for NI's gRPC device server: NI's own client library drives it.

    python -m nmt_specimen.ni_specimen RIG [options]

It implements what a continuous measurement with analog outputs needs (tasks, channels, timing, start, read, write,
stop), and answers every other call with an empty response. It is as strict as a device: modules of a CompactDAQ
(``cDAQ1Mod1``) have the rates of a delta-sigma converter, a fixed range and one ICP current, and their terminals are
those of the chassis; other devices divide 100 MHz. Samples pass at their times on this computer's steady clock, with an
error of the clock if wanted; those that are due are made up for in the next call. An output that is not fed in time
stops and idles at zero volts where the client has asked for that, else it keeps its last value, as the hardware does.
"""

from __future__ import annotations

import gc
import math
import re
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent import futures
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.steady_clock import STEADY_CLOCK, SteadyClock
from nmt_plant.specimen import Specimen, write_port
from nmt_rig.device_sections import StopInputSection
from nmt_specimen.specimen_options import PortOptions
from nmt_specimen.specimen_process import answer, hurry, main_of, specimen_of

_MOST_AT_ONCE = 200  # samples
_HELD = 10.0  # s of input samples that are kept unread
_OVERWRITTEN, _TOO_LATE, _TIMEOUT = -200279, -200290, -200284
_NO_SHEET, _SERIAL = -200709, 0x21DC
_NOT_SUPPORTED, _NO_DEVICE, _NO_CHANNEL, _NO_TERMINAL = -200077, -200220, -200170, -89120
_LARGEST, _EXCITATION, _CATEGORY, _CHASSIS, _RATE = 0x17DD, 0x17F5, 0x29A9, 0x29B7, 0x1344
_MODULE, _BOARD = 14659, 14643
_DEVICE_NAMES, _IDLE_BEHAVIOUR, _ZERO_VOLTS = 0x193B, 0x2240, 12526
_WORDS = {
    _OVERWRITTEN: "The application is not able to keep up with the hardware acquisition.",
    _TOO_LATE: "The generation has stopped to prevent the regeneration of old samples.",
    _TIMEOUT: "Some or all of the samples requested have not yet been acquired.",
    _NOT_SUPPORTED: "Requested value is not a supported value for this property.",
    _NO_SHEET: "No TEDS sensor was detected on the physical channel.",
    _NO_DEVICE: "Device identifier is invalid.",
    _NO_CHANNEL: "Physical channel specified does not exist on this device.",
    _NO_TERMINAL: "Source terminal to be routed could not be found on the device.",
}


@dataclass(frozen=True)
class _Kind:
    """What a device can do: most Hz, what its clock divides, ranges in V, ICP currents in A."""

    highest_hz: float
    divided_hz: float
    most_divided: int
    ranges_v: tuple[float, ...]
    currents_a: tuple[float, ...]
    channels: int

    def rate(self, asked: float) -> float:
        """The next higher rate that it has; NaN beyond its highest."""
        divisor = min(int(self.divided_hz / asked * (1.0 + 1e-12)), self.most_divided)
        return self.divided_hz / divisor if divisor and 0.0 < asked <= self.highest_hz else math.nan


_MODULE_KIND = _Kind(51_200.0, 51_200.0, 31, (5.0,), (0.002,), 4)
_BOARD_KIND = _Kind(250_000.0, 100e6, 1 << 24, (0.2, 1.0, 5.0, 10.0), (0.002, 0.004, 0.010), 64)


def _parts(port: str, names: Sequence[str]) -> tuple[int, str, _Kind]:
    """Error code, the device with the terminals, and what the device of a physical channel can do."""
    device, _, channel = port.partition("/")
    module = re.fullmatch(r"(cDAQ\d+)Mod\d+", device)
    kind = _MODULE_KIND if module else _BOARD_KIND
    number = re.fullmatch(r"a[io](\d+)", channel)
    if device not in names:
        return _NO_DEVICE, device, kind
    return (0 if number and int(number[1]) < kind.channels else _NO_CHANNEL), module[1] if module else device, kind


class Hardware:
    """Converter and specimen: samples pass while both tasks run. Calls may come from any thread.

    Args:
        specimen: behind the ports.
        sample_rate: Hz, nominal.
        clock_error: relative.
        record: most samples of the output ports that are kept.
        stop_line: V at the input of the external stop line, the last one; None = there is no such input.
        clock: by which samples pass.

    Attributes:
        space: samples that the output's buffer holds.
        sheets: serial number in the electronic data sheet of the sensor at each physical channel that has one.
        idles_at_zero: whether an output that has stopped goes to zero, else it keeps its last value.
    """

    def __init__(
        self,
        specimen: Specimen,
        sample_rate: float,
        clock_error: float = 0.0,
        record: int = 0,
        stop_line: Callable[[], float] | None = None,
        clock: SteadyClock = STEADY_CLOCK,
    ) -> None:
        self._specimen = specimen
        self._stop_line = stop_line
        self._rate = sample_rate * (1.0 + clock_error)
        self._clock, self._lock = clock, threading.Lock()
        self._begun, self._passed = clock.now(), 0
        self._outputs = specimen.outputs
        self._record = np.zeros((self._outputs, record))
        self.recorded = 0
        self.record_times: list[tuple[float, int]] = []
        self.sheets: dict[str, int] = {}
        self.idles_at_zero = False
        self.space = 1 << 30
        self._level = np.zeros((self._outputs, 1))
        self._forget()

    def _forget(self) -> None:
        self._input_runs = self._output_armed = False
        self._output_failed = self._input_failed = 0
        self._pending = np.zeros((self._outputs, 0))
        self._measured: list[FloatArray] = []
        self._unread = 0

    def _catch_up(self) -> None:
        """Let the samples pass that are due by now."""
        due = int((self._clock.now() - self._begun) * self._rate) - self._passed
        while due > 0:
            count = min(due, _MOST_AT_ONCE)
            self._passed += count
            self._pass(count)
            due -= count

    def keep_up(self) -> None:
        """Let samples pass while nobody calls; now and then, so that the next call need not make up for many."""
        with self._lock:
            self._catch_up()

    def _wait(self, samples: int, end: float) -> bool:
        """Sleep for as long as so many samples take; whether the time has come to give up."""
        left = end - self._clock.now()
        self._clock.sleep(min(samples / self._rate, left))
        return left <= 0.0

    def _pass(self, count: int) -> None:
        """The samples of a step: what is fed goes out, what the specimen answers is kept."""
        port = np.repeat(self._level, count, axis=1)
        if self._input_runs and self._output_armed and not self._output_failed:
            fed = min(count, self._pending.shape[1])
            port[:, :fed] = self._pending[:, :fed]
            self._pending = self._pending[:, fed:]
            if fed < count:
                self._output_failed = _TOO_LATE
                port[:, fed:] = 0.0 if self.idles_at_zero else (port[:, fed - 1 : fed] if fed else self._level)
        elif self.idles_at_zero:
            port[:] = 0.0
        self._level = port[:, -1:]
        answer = self._specimen.respond(port)
        if self._stop_line is not None:
            answer = np.vstack([answer, np.full(count, self._stop_line())])
        kept = port[:, : max(self._record.shape[1] - self.recorded, 0)]
        self._record[:, self.recorded : self.recorded + kept.shape[1]] = kept
        self.recorded += kept.shape[1]
        if kept.size:
            self.record_times.append((self._begun + self._passed / self._rate, self.recorded))
        if self._input_runs:
            self._measured.append(answer)
            self._unread += count
            if self._unread > _HELD * self._rate:
                self._input_failed = _OVERWRITTEN

    def start(self, is_input: bool) -> None:
        """Start the input, which triggers the output, or arm the output."""
        with self._lock:
            self._catch_up()
            if is_input:
                self._input_runs = True
            else:
                self._output_armed = True

    def read(self, count: int, timeout: float) -> tuple[int, FloatArray]:
        """Error code, and (channels, count) V when they are there."""
        end = self._clock.now() + timeout
        while True:
            with self._lock:
                self._catch_up()
                if self._input_failed:
                    return self._input_failed, np.zeros((0, 0))
                if self._unread >= count:
                    whole = np.concatenate(self._measured, axis=1)
                    self._measured = [whole[:, count:]]
                    self._unread -= count
                    return 0, whole[:, :count]
                missing = count - self._unread
            if self._wait(missing, end):
                return _TIMEOUT, np.zeros((0, 0))

    def write(self, values: FloatArray, timeout: float) -> int:
        """Error code for (outputs, n) V; waits for space in the buffer."""
        end = self._clock.now() + timeout
        while True:
            with self._lock:
                self._catch_up()
                if self._output_failed:
                    return self._output_failed
                missing = self._pending.shape[1] + values.shape[1] - self.space
                if missing <= 0 or not self._input_runs:
                    self._pending = np.concatenate([self._pending, values], axis=1)
                    return 0
            if self._wait(missing, end):
                return _TIMEOUT

    def stop(self) -> None:
        """Both tasks end; what waits is thrown away."""
        with self._lock:
            self._catch_up()
            self._forget()

    def at_the_port(self) -> tuple[FloatArray, FloatArray]:
        """What was at the output ports until now, V, and when: (n, 2) as of `specimen.write_port`."""
        self.keep_up()
        kept = self._record[:, : self.recorded]
        return kept[0] if self._outputs == 1 else kept, np.array(self.record_times).reshape(-1, 2)


class NiCalls:
    """What the calls of NI's server do that mean something here, and the fields of their answers.

    Args:
        hardware: behind them.
        names: of the devices, as NI lists them.
        grpc: the package.
    """

    def __init__(self, hardware: Hardware, names: str, grpc: Any) -> None:
        self.hardware, self.names, self.grpc = hardware, names, grpc
        self.devices = [name.strip() for name in names.split(",")]
        # Channels (V), excitation (A), rate (Hz), device with the terminals, of each task.
        self.tasks: dict[str, dict[str, Any]] = {}

    def _new_channel(self, request: Any, context: Any) -> None:
        code, terminals, kind = _parts(request.physical_channel, self.devices)
        fitting = [reach for reach in kind.ranges_v if reach >= request.max_val * (1.0 - 1e-9)]
        self._refuse(context, code or (0 if fitting else _NOT_SUPPORTED), "read")
        task = self.tasks.setdefault(request.task.name, {"channels": {}, "excitation": {}})
        task["terminals"], task["kind"] = terminals, kind
        task["channels"][request.physical_channel] = fitting[0]

    def _check_terminal(self, context: Any, task: str, source: str, own: str) -> None:
        known = {f"/{each['terminals']}/{own}" for each in self.tasks.values() if "terminals" in each}
        self._refuse(context, 0 if source in known or re.fullmatch(r"/\w+/PFI\d+", source) else _NO_TERMINAL, "read")

    def _refuse(self, context: Any, code: int, what: str) -> None:
        """End a call as NI's server does: a gRPC error with NI's code."""
        if code:
            context.set_trailing_metadata((("ni-error", str(code)), (f"ni-samps-per-chan-{what}", "0")))
            context.abort(self.grpc.StatusCode.UNKNOWN, _WORDS[code])

    def _create_output(self, request: Any, context: Any) -> None:
        code, terminals, kind = _parts(request.physical_channel, self.devices)
        self._refuse(context, code or (0 if request.max_val <= 10.0 else _NOT_SUPPORTED), "read")
        self.tasks.setdefault(request.task.name, {"channels": {}}).update(terminals=terminals, kind=kind)

    def _set_excitation(self, request: Any, context: Any) -> None:
        task = self.tasks[request.task.name]
        if request.attribute_raw == _EXCITATION:
            known = any(math.isclose(request.value, own) for own in task["kind"].currents_a)
            self._refuse(context, 0 if known else _NOT_SUPPORTED, "read")
            task["excitation"][request.channel] = request.value

    def _get_range_or_excitation(self, request: Any, _: Any) -> dict[str, Any]:
        held = self.tasks[request.task.name]["channels" if request.attribute_raw == _LARGEST else "excitation"]
        return {"value": held.get(request.channel, 0.0)}

    def _set_clock(self, request: Any, context: Any) -> None:
        task = self.tasks[request.task.name]
        if request.source:
            self._check_terminal(context, request.task.name, request.source, "ai/SampleClock")
        task["rate"] = task["kind"].rate(request.rate)
        self._refuse(context, _NOT_SUPPORTED if math.isnan(task["rate"]) else 0, "read")

    def _get_rate(self, request: Any, _: Any) -> dict[str, Any]:
        return {"value": self.tasks[request.task.name]["rate"] if request.attribute_raw == _RATE else 0.0}

    def _get_category(self, request: Any, _: Any) -> dict[str, Any]:
        category = _MODULE if "Mod" in request.device_name else _BOARD
        return {"value_raw": category if request.attribute_raw == _CATEGORY else 0}

    def _get_chassis(self, request: Any, _: Any) -> dict[str, Any]:
        return {"value": request.device_name.partition("Mod")[0] if request.attribute_raw == _CHASSIS else ""}

    def _get_serial(self, request: Any, _: Any) -> dict[str, Any]:
        sheet = self.hardware.sheets.get(request.physical_channel, 0)
        return {"value": sheet if request.attribute_raw == _SERIAL else 0}

    def _set_idle(self, request: Any, _: Any) -> None:
        if request.attribute_raw == _IDLE_BEHAVIOUR:
            self.hardware.idles_at_zero = request.value_raw == _ZERO_VOLTS

    def _set_space(self, request: Any, _: Any) -> None:
        self.hardware.space = int(request.value)

    def _read(self, request: Any, context: Any) -> dict[str, Any]:
        count = request.num_samps_per_chan
        code, values = self.hardware.read(count, request.timeout)
        self._refuse(context, code, "read")
        return {"read_array": values.ravel(), "samps_per_chan_read": count}

    def _write(self, request: Any, context: Any) -> dict[str, Any]:
        values = np.array(request.write_array).reshape(-1, request.num_samps_per_chan)
        self._refuse(context, self.hardware.write(values, request.timeout), "written")
        return {"samps_per_chan_written": request.num_samps_per_chan}

    @property
    def by_name(self) -> dict[str, Callable[[Any, Any], dict[str, Any] | None]]:
        """Call with a request and a context, by its name."""
        return {
            "CreateTask": lambda request, _: {"new_session_initialized": True, "task": {"name": request.session_name}},
            "GetSystemInfoAttributeString": lambda request, _: {
                "value": self.names if request.attribute_raw == _DEVICE_NAMES else ""
            },
            "CreateAIVoltageChan": self._new_channel,
            "CreateAOVoltageChan": self._create_output,
            "SetChanAttributeDouble": self._set_excitation,
            "GetChanAttributeDouble": self._get_range_or_excitation,
            "CfgSampClkTiming": self._set_clock,
            "GetTimingAttributeDouble": self._get_rate,
            "CfgDigEdgeStartTrig": lambda request, context: self._check_terminal(
                context, request.task.name, request.trigger_source, "ai/StartTrigger"
            ),
            "GetDeviceAttributeInt32": self._get_category,
            "GetDeviceAttributeString": self._get_chassis,
            "ConfigureTEDS": lambda request, context: self._refuse(
                context, 0 if request.physical_channel in self.hardware.sheets else _NO_SHEET, "read"
            ),
            "GetPhysicalChanAttributeUInt32": self._get_serial,
            "SetChanAttributeInt32": self._set_idle,
            "SetBufferAttributeUInt32": self._set_space,
            "StartTask": lambda request, _: self.hardware.start(request.task.name.endswith("input")),
            "StopTask": lambda _, __: self.hardware.stop(),
            "ReadAnalogF64": self._read,
            "WriteAnalogF64": self._write,
        }


def make_calls(hardware: Hardware, names: str) -> Any:
    """The calls of NI's server, as gRPC takes them.

    Args:
        hardware: behind them.
        names: of the devices, as NI lists them.

    Raises:
        BenchError: the package is missing.
    """
    try:
        import grpc
        from nidaqmx._stubs import nidaqmx_pb2, nidaqmx_pb2_grpc
    except ModuleNotFoundError:
        raise BenchError("The package nidaqmx is not installed; type: pip install 'nidaqmx[grpc]'.") from None

    base, calls = nidaqmx_pb2_grpc.NiDAQmxServicer, NiCalls(hardware, names, grpc).by_name

    def method(name: str) -> Any:
        answer, call = getattr(nidaqmx_pb2, f"{name}Response"), calls.get(name, lambda _, __: None)
        return lambda _, request, context: answer(**(call(request, context) or {}))

    known = [name for name in dir(base) if not name.startswith("_") and hasattr(nidaqmx_pb2, f"{name}Response")]
    return type("Servicer", (base,), {name: method(name) for name in known})()


def make_server(hardware: Hardware, names: str, address: str) -> tuple[Any, int]:
    """A gRPC server of the calls, and its port.

    Args:
        hardware: behind it.
        names: of the devices, as NI lists them.
        address: host:port; port 0 = any that is free.

    Raises:
        BenchError: the package is missing, or the address is taken.
    """
    calls = make_calls(hardware, names)
    import grpc
    from nidaqmx._stubs import nidaqmx_pb2_grpc

    server = grpc.server(futures.ThreadPoolExecutor(max_workers=4))
    nidaqmx_pb2_grpc.add_NiDAQmxServicer_to_server(calls, server)
    try:
        port = server.add_insecure_port(address)
    except RuntimeError:
        port = 0
    if not port:
        raise BenchError(
            f"The address {address} cannot be listened on; another program has it; give another with --address."
        )
    server.start()
    return server, port


def run(options: PortOptions) -> int:
    """Serve until told to end.

    Raises:
        BenchError: rig, option or address are refused.
    """
    rig, device, specimen, record = specimen_of(options, "nidaqmx")
    specimen.respond(np.zeros((specimen.outputs, 32)))  # compiled, or loaded, before the first sample is due
    hurry()  # before there are threads, which inherit it
    stop = getattr(device, "stop_input", None)
    line = None if stop is None else _stop_line(stop, options.stop_file)
    hardware = Hardware(specimen, float(rig.sample_rate_hz), 1e-6 * options.clock_ppm, record, line)
    names = sorted({str(entry.port).partition("/")[0] for entry in device.ports})
    server, port = make_server(hardware, ", ".join(names), options.address)
    gc.collect()
    gc.freeze()
    host = options.address.rpartition(":")[0]
    answer(
        f"{rig.name} behind {', '.join(names)} at {host}:{port}, {rig.sample_rate_hz:g} Hz, channels "
        f"{', '.join(specimen.channels)}",
        meanwhile=hardware.keep_up,
    )
    server.stop(0.5)
    if options.record is not None:
        write_port(options.record, *hardware.at_the_port())
    return 0


def _stop_line(section: StopInputSection, path: Path | None) -> Callable[[], float]:
    """V at the stop line: it asks for zero while a file exists."""
    beyond, within = (0.0, section.range_v) if section.stops == "low" else (section.range_v, 0.0)
    return lambda: beyond if path is not None and path.exists() else within


if __name__ == "__main__":
    sys.exit(main_of("ni_specimen", __doc__, run, None))
