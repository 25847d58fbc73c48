"""The simulated specimen inside a stand-in for NI's gRPC device server: NI's own client library drives it.

    python -m nmt_plant.ni_specimen RIG [options]

It implements what a continuous measurement with one analog output needs (tasks, channels, timing, start, read, write,
stop) and answers every other call with an empty response. Samples pass at their times on this computer's steady clock,
with an error of the clock if wanted. An output that is not fed in time stops and idles at zero volts where the client
has asked for that, else it keeps its last value, as the hardware does.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent import futures
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_core.errors import BenchError
from nmt_plant.hardware_rig import device_of
from nmt_plant.jack_specimen import follow_input
from nmt_plant.specimen import Specimen, write_port
from nmt_plant.specimen_faults import parse_fault
from nmt_plant.specimen_options import add_options
from nmt_rig.device_sections import NiDaqmxSection, StopInputSection
from nmt_rig.rig import load_rig

_STEP = 0.002  # s, of the samples that pass at once
_HELD = 10.0  # s of input samples that are kept unread
_OVERWRITTEN, _TOO_LATE, _TIMEOUT = -200279, -200290, -200284
_DEVICE_NAMES, _IDLE_BEHAVIOUR, _ZERO_VOLTS = 0x193B, 0x2240, 12526
_WORDS = {
    _OVERWRITTEN: "The application is not able to keep up with the hardware acquisition.",
    _TOO_LATE: "The generation has stopped to prevent the regeneration of old samples.",
    _TIMEOUT: "Some or all of the samples requested have not yet been acquired.",
}


class Hardware:
    """Converter and specimen: samples pass while both tasks run.

    Args:
        specimen: behind the ports.
        sample_rate: Hz, nominal.
        clock_error: relative.
        record: most samples of the output port that are kept.
        stop_line: V at the input of the external stop line, the last one; None = there is no such input.
    """

    def __init__(
        self,
        specimen: Specimen,
        sample_rate: float,
        clock_error: float = 0.0,
        record: int = 0,
        stop_line: Callable[[], float] | None = None,
    ) -> None:
        self._specimen = specimen
        self._stop_line = stop_line
        self._rate = sample_rate * (1.0 + clock_error)
        self.changed = threading.Condition()
        self._record = np.zeros(record)
        self.recorded = 0
        self.record_times: list[tuple[float, int]] = []
        self.idles_at_zero = False
        self._level = 0.0
        self._end = False
        self._forget()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _forget(self) -> None:
        self.input_runs = self.output_armed = False
        self.output_failed = self.input_failed = 0
        self._pending = np.zeros(0)
        self._measured: list[FloatArray] = []
        self.unread = 0
        self.space = 1 << 30

    def _run(self) -> None:
        step = max(1, int(_STEP * self._rate))
        due = time.monotonic()
        while not self._end:
            due = max(due, time.monotonic() - 0.5) + step / self._rate
            time.sleep(max(0.0, due - time.monotonic()))
            with self.changed:
                self._pass(step)
                self.changed.notify_all()

    def _pass(self, count: int) -> None:
        """The samples of a step: what is fed goes out, what the specimen answers is kept."""
        port = np.full(count, self._level)
        if self.input_runs and self.output_armed and not self.output_failed:
            fed = min(count, self._pending.size)
            port[:fed] = self._pending[:fed]
            self._pending = self._pending[fed:]
            if fed < count:
                self.output_failed = _TOO_LATE
                port[fed:] = 0.0 if self.idles_at_zero else (port[fed - 1] if fed else self._level)
        elif self.idles_at_zero:
            port[:] = 0.0
        self._level = float(port[-1])
        answer = self._specimen.respond(port)
        if self._stop_line is not None:
            answer = np.vstack([answer, np.full(count, self._stop_line())])
        kept = port[: max(self._record.size - self.recorded, 0)]
        self._record[self.recorded : self.recorded + kept.size] = kept
        self.recorded += kept.size
        if kept.size:
            self.record_times.append((time.monotonic(), self.recorded))
        if self.input_runs:
            self._measured.append(answer)
            self.unread += count
            if self.unread > _HELD * self._rate:
                self.input_failed = _OVERWRITTEN

    def read(self, count: int, timeout: float) -> tuple[int, FloatArray]:
        """Error code, and (channels, count) V when they are there."""
        end = time.monotonic() + timeout
        with self.changed:
            while self.unread < count and not self.input_failed:
                if not self.changed.wait(max(0.0, end - time.monotonic())):
                    return _TIMEOUT, np.zeros((0, 0))
            if self.input_failed:
                return self.input_failed, np.zeros((0, 0))
            whole = np.concatenate(self._measured, axis=1)
            self._measured = [whole[:, count:]]
            self.unread -= count
            return 0, whole[:, :count]

    def write(self, values: FloatArray, timeout: float) -> int:
        """Error code; waits for space in the buffer."""
        end = time.monotonic() + timeout
        with self.changed:
            while self._pending.size + values.size > self.space and self.input_runs and not self.output_failed:
                if not self.changed.wait(max(0.0, end - time.monotonic())):
                    return _TIMEOUT
            if self.output_failed:
                return self.output_failed
            self._pending = np.concatenate([self._pending, values])
            return 0

    def stop(self) -> None:
        """Both tasks end; what waits is thrown away."""
        with self.changed:
            space = self.space
            self._forget()
            self.space = space

    def close(self) -> None:
        """End the thread."""
        self._end = True
        self._thread.join(2.0)

    def write_record(self, path: Path) -> None:
        """Write what was at the output port, V, and when, as a NumPy archive; see `specimen.write_port`."""
        write_port(path, self._record[: self.recorded], self.record_times)


def make_server(hardware: Hardware, names: str, address: str) -> tuple[Any, int]:
    """A gRPC server of the calls, and its port.

    Args:
        hardware: behind it.
        names: of the devices, as NI lists them.
        address: host:port; port 0 = any that is free.

    Raises:
        BenchError: the package is missing, or the address is taken.
    """
    try:
        import grpc
        from nidaqmx._stubs import nidaqmx_pb2, nidaqmx_pb2_grpc
    except ModuleNotFoundError:
        raise BenchError("The package nidaqmx is not installed; type: pip install 'nidaqmx[grpc]'.") from None

    base = nidaqmx_pb2_grpc.NiDAQmxServicer

    class Servicer(base):  # type: ignore[misc,valid-type]
        """The calls that mean something here."""

        def CreateTask(self, request: Any, _: Any) -> Any:  # noqa: N802 - NI's names
            response = nidaqmx_pb2.CreateTaskResponse(new_session_initialized=True)
            response.task.name = request.session_name
            return response

        def GetSystemInfoAttributeString(self, request: Any, _: Any) -> Any:  # noqa: N802
            known = request.attribute_raw == _DEVICE_NAMES
            return nidaqmx_pb2.GetSystemInfoAttributeStringResponse(value=names if known else "")

        def SetChanAttributeInt32(self, request: Any, _: Any) -> Any:  # noqa: N802
            if request.attribute_raw == _IDLE_BEHAVIOUR:
                hardware.idles_at_zero = request.value_raw == _ZERO_VOLTS
            return nidaqmx_pb2.SetChanAttributeInt32Response()

        def SetBufferAttributeUInt32(self, request: Any, _: Any) -> Any:  # noqa: N802
            hardware.space = int(request.value)
            return nidaqmx_pb2.SetBufferAttributeUInt32Response()

        def StartTask(self, request: Any, _: Any) -> Any:  # noqa: N802
            with hardware.changed:
                if request.task.name.endswith("input"):
                    hardware.input_runs = True
                else:
                    hardware.output_armed = True
            return nidaqmx_pb2.StartTaskResponse()

        def StopTask(self, _: Any, __: Any) -> Any:  # noqa: N802
            hardware.stop()
            return nidaqmx_pb2.StopTaskResponse()

        def ReadAnalogF64(self, request: Any, context: Any) -> Any:  # noqa: N802
            count = request.num_samps_per_chan
            code, values = hardware.read(count, request.timeout)
            refuse(context, code, "read")
            return nidaqmx_pb2.ReadAnalogF64Response(read_array=values.ravel(), samps_per_chan_read=count)

        def WriteAnalogF64(self, request: Any, context: Any) -> Any:  # noqa: N802
            refuse(context, hardware.write(np.array(request.write_array), request.timeout), "written")
            return nidaqmx_pb2.WriteAnalogF64Response(samps_per_chan_written=request.num_samps_per_chan)

    def refuse(context: Any, code: int, what: str) -> None:
        """End a call as NI's server does: a gRPC error with NI's code beside it."""
        if code:
            context.set_trailing_metadata((("ni-error", str(code)), (f"ni-samps-per-chan-{what}", "0")))
            context.abort(grpc.StatusCode.UNKNOWN, _WORDS[code])

    def empty(name: str) -> Any:
        return lambda _self, _request, _context: getattr(nidaqmx_pb2, f"{name}Response")()

    for name in dir(base):
        if not name.startswith("_") and name not in vars(Servicer) and hasattr(nidaqmx_pb2, f"{name}Response"):
            setattr(Servicer, name, empty(name))
    server = grpc.server(futures.ThreadPoolExecutor(max_workers=4))
    nidaqmx_pb2_grpc.add_NiDAQmxServicer_to_server(Servicer(), server)
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


def run(arguments: argparse.Namespace) -> int:
    """Serve until told to end.

    Raises:
        BenchError: rig, option or address are refused.
    """
    changes = [*arguments.set, *([f"exciter.point={arguments.exciter}"] if arguments.exciter is not None else [])]
    rig = load_rig(arguments.rig, changes)
    device = rig.device if isinstance(rig.device, NiDaqmxSection) else device_of(rig, "nidaqmx")
    specimen = Specimen(
        rig,
        device,
        bits=arguments.bits,
        noise=arguments.noise,
        delay=arguments.delay,
        faults=[parse_fault(text) for text in arguments.fault],
    )
    specimen.respond(np.zeros(32))  # compiled, or loaded, before the first sample is due
    # Before there are threads, which inherit it.
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
    record = 0 if arguments.record is None else round(arguments.record_s * rig.sample_rate_hz)
    stop = getattr(device, "stop_input", None)
    line = None if stop is None else _stop_line(stop, arguments.stop_file)
    hardware = Hardware(specimen, float(rig.sample_rate_hz), 1e-6 * arguments.clock_ppm, record, line)
    names = sorted({str(entry.port).partition("/")[0] for entry in device.ports})
    server, port = make_server(hardware, ", ".join(names), arguments.address)
    gc.collect()
    gc.freeze()
    told = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: told.set())
    host = arguments.address.rpartition(":")[0]
    sys.stdout.write(
        f"ready: {rig.name} behind {', '.join(names)} at {host}:{port}, {rig.sample_rate_hz:g} Hz, channels "
        f"{', '.join(specimen.channels)}\n"
    )
    sys.stdout.flush()
    follow_input(told)
    server.stop(0.5)
    hardware.close()
    if arguments.record is not None:
        hardware.write_record(arguments.record)
    return 0


def _stop_line(section: StopInputSection, path: Path | None) -> Callable[[], float]:
    """V at the stop line: it asks for zero while a file exists."""
    beyond, within = (0.0, section.range_v) if section.stops == "low" else (section.range_v, 0.0)
    return lambda: beyond if path is not None and path.exists() else within


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; one sentence and exit code 2 for what the user can fix."""
    parser = argparse.ArgumentParser(prog="nmt_plant.ni_specimen", description=__doc__)
    add_options(parser)
    try:
        return run(parser.parse_args(arguments))
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
