"""NI hardware as the converter of an output, by NI's own driver or by NI's gRPC device server on another computer.

The pattern is that of shaker controllers: continuous input and output on one sample clock, the output started by the
input's start trigger, no regeneration, an output buffer of a few blocks; the end writes zeros and waits until they are
out. Source: NI-DAQmx Help, "Synchronization" and "Regeneration".

    python -m nmt_plant.converters.nidaqmx_converter ADDRESS PORT...

looks for the devices of physical channels; the command line asks so, since a process that has used gRPC cannot start
others safely: its threads do not survive the fork.
"""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.steady_clock import STEADY_CLOCK, SteadyClock
from nmt_plant.converters.converter import Converter, Taken

if TYPE_CHECKING:
    from nmt_rig.device_sections import NiDaqmxSection
    from nmt_rig.rig import Rig

_CONNECT_TIME = 5.0  # s
_ASK_TIME = 60.0  # s
_MOST_RESTARTS = 5
_RESTARTS_WITHIN = 10.0  # s
_NOT_FED = -200290
_SAME = 1e-6
"""Relative difference up to which a setting counts as taken as it was asked for."""
_MODULE = 14659  # product category of a module, NI-DAQmx
_LOST_CODES = frozenset({-200279, -200278, _NOT_FED, -200621, -200016, -50411})
"""DAQmx errors of samples that came too late: input overwritten, output not fed in time (NI-DAQmx error codes)."""


def load_nidaqmx() -> ModuleType:
    """The package nidaqmx.

    Raises:
        BenchError: it is not installed.
    """
    try:
        import nidaqmx
    except ModuleNotFoundError:
        raise BenchError("The package nidaqmx is not installed; type: pip install 'nidaqmx[grpc]'.") from None
    return nidaqmx  # type: ignore[no-any-return]


def session_options(address: str, name: str) -> Any:
    """Options of a session with NI's gRPC device server; None for the driver of this computer.

    Raises:
        BenchError: the server does not answer.
    """
    if not address:
        return None
    try:
        import grpc
    except ModuleNotFoundError:
        raise BenchError("The package grpcio is not installed; type: pip install 'nidaqmx[grpc]'.") from None
    nidaqmx = load_nidaqmx()
    channel = grpc.insecure_channel(address)
    try:
        grpc.channel_ready_future(channel).result(timeout=_CONNECT_TIME)
    except grpc.FutureTimeoutError:
        channel.close()
        raise BenchError(
            f"No NI gRPC device server answers at {address}; start 'ni_grpc_device_server' on the NI computer, or for "
            "the simulated specimen './nmt specimen RIG --device nidaqmx'."
        ) from None
    return nidaqmx.GrpcSessionOptions(channel, name)


def find_rig_channels(section: NiDaqmxSection, rig: Rig) -> None:
    """:func:`find_channels` for the ports of a rig."""
    find_channels(section.address, [str(entry.port) for entry in section.ports])


def find_channels(address: str, ports: Sequence[str]) -> None:
    """Refuse physical channels whose device the driver does not know; asked in a process of its own.

    Raises:
        BenchError: driver, server or device is missing.
    """
    command = [sys.executable, "-m", "nmt_plant.converters.nidaqmx_converter", address, *ports]
    try:
        asked = subprocess.run(command, capture_output=True, text=True, timeout=_ASK_TIME)
    except subprocess.TimeoutExpired:
        raise BenchError(f"NI-DAQmx does not answer within {_ASK_TIME:g} s; look at its driver and server.") from None
    if asked.returncode == 2:
        raise BenchError(asked.stdout.strip())
    if asked.returncode:
        last = (asked.stderr.strip().splitlines() or ["no message"])[-1]
        raise BenchError(f"NI-DAQmx does not start ({last}); look at its driver and server.")


def _look_for(address: str, ports: Sequence[str]) -> None:
    """The same in this process."""
    nidaqmx = load_nidaqmx()
    from nidaqmx.system import System

    options = session_options(address, "")
    try:
        system = System.remote(options) if options is not None else System.local()
        names = list(system.devices.device_names)
    except nidaqmx.errors.DaqNotFoundError:
        raise BenchError(
            "NI's driver NI-DAQmx is not installed here; install it from ni.com, or give the address of NI's gRPC "
            "device server (device.address, or --device nidaqmx@HOST:PORT)."
        ) from None
    except nidaqmx.errors.Error as error:
        raise BenchError(f"NI-DAQmx refuses: {_first_line(error)}.") from None
    for port in ports:
        if port.partition("/")[0] not in names:
            raise BenchError(
                f"NI-DAQmx knows no device {port.partition('/')[0]} (channel {port}); it lists "
                f"{', '.join(names) or 'none'}."
            )


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")


class NiDaqmxConverter(Converter):
    """Analog input and output of NI hardware on one clock.

    Args:
        sample_rate: Hz.
        outputs: (physical channel, range in V, amplifier gain) of each.
        inputs: (physical channel, range in V, coupling ``dc`` or ``ac``, ICP current in mA or 0, serial number of the
            sensor or empty) of each; a sensor with an electronic data sheet (TEDS, IEEE 1451.4) must have that number.
        block_samples: samples of a call.
        address: of NI's gRPC device server; empty = this computer's driver.
        start_trigger: terminal that starts the output; empty = the start trigger of the first input's device, or of its
            chassis: a module of a CompactDAQ has no such terminals.
        clock_source: terminal of the sample clock of the output; empty = that of the input.
        buffer_blocks: blocks that the output buffer holds.
        stop: physical channel, range in V, threshold in V, and whether below it (else above) the external stop line
            asks for zero; None = none.
        clock: by which losses follow each other, and on which the end waits.

    Raises:
        BenchError: the driver refuses a setting, or takes another rate, range or ICP current than was asked for, or
            another sensor is connected.
    """

    def __init__(
        self,
        sample_rate: float,
        outputs: Sequence[Sequence[Any]],
        inputs: Sequence[Sequence[Any]],
        block_samples: int,
        address: str = "",
        start_trigger: str = "",
        clock_source: str = "",
        buffer_blocks: int = 3,
        stop: Sequence[Any] | None = None,
        clock: SteadyClock = STEADY_CLOCK,
    ) -> None:
        self._clock = clock
        self._daq = load_nidaqmx()
        self.outputs, self.inputs = len(outputs), len(inputs)
        self.chunk_samples = block_samples
        self._blocks = buffer_blocks
        self.delay = buffer_blocks * block_samples
        self.stated = self.delay + block_samples
        self._rate = sample_rate
        self._scale = np.array([[1.0 / entry[2]] for entry in outputs])
        self._stop_line = stop
        self._stop_asked = False
        self._measured = np.zeros((self.inputs + (stop is not None), block_samples))
        self._running = False
        self._restarts: list[float] = []
        device = str(inputs[0][0]).partition("/")[0]
        self._tasks: list[Any] = []
        try:
            self._set_up(
                outputs,
                inputs,
                address,
                start_trigger,
                clock_source,
                device,
            )
        except self._daq.errors.DaqNotFoundError:
            raise BenchError(
                "NI's driver NI-DAQmx is not installed here; install it, or give device.address."
            ) from None
        except BenchError:
            self.close()
            raise
        except self._daq.errors.Error as error:
            self.close()
            raise BenchError(f"NI-DAQmx refuses the channels or their settings: {_first_line(error)}.") from None

    @contextlib.contextmanager
    def _asking(self, what: str, remedy: str) -> Iterator[None]:
        """Say what the driver refused, and where the setting is."""
        try:
            yield
        except self._daq.errors.DaqNotFoundError:
            raise
        except self._daq.errors.Error as error:
            raise BenchError(f"NI-DAQmx refuses {what} ({_first_line(error)}); {remedy}.") from None

    @staticmethod
    def _same(what: str, asked: float, taken: float, unit: str, key: str) -> None:
        """Refuse what the device has put in the place of a setting."""
        if abs(taken - asked) > _SAME * abs(asked):
            raise BenchError(f"The device takes {taken:.10g} {unit} for {what}, not {asked:.10g}; write {key}.")

    def _compare_sheet(self, port: str, serial: str, options: Any) -> None:
        """Refuse a sensor whose data sheet has another serial number than the table; many sensors have none."""
        from nidaqmx.system.physical_channel import PhysicalChannel

        wanted = re.findall(r"\d+", serial)
        if not wanted:
            return
        found = PhysicalChannel(port, grpc_options=options)
        try:
            found.configure_teds()
            own = int(found.teds_serial_num)
        except self._daq.errors.Error:
            return
        if own and own != int(wanted[-1]):
            raise BenchError(
                f"The sensor at {port} has the serial number {own} (TEDS), not {serial}; look at its cable, or correct "
                "serial and sensitivity_v."
            )

    def _clock_device(self, address: str, device: str) -> str:
        """The device that has the terminals: of a module its chassis."""
        from nidaqmx.system import System

        options = session_options(address, "")
        system = System.remote(options) if options is not None else System.local()
        with self._asking(f"the device {device}", "look at its name in NI MAX"):
            found = system.devices[device]
            category = found._interpreter.get_device_attribute_int32(device, 0x29A9)
            return str(found.compact_daq_chassis_device.name) if category == _MODULE else device

    def _set_up(
        self,
        outputs: Sequence[Sequence[Any]],
        inputs: Sequence[Sequence[Any]],
        address: str,
        start_trigger: str,
        clock_source: str,
        device: str,
    ) -> None:
        from nidaqmx import constants
        from nidaqmx.stream_readers import AnalogMultiChannelReader
        from nidaqmx.stream_writers import AnalogMultiChannelWriter

        continuous = constants.AcquisitionType.CONTINUOUS
        block = self.chunk_samples

        def task(name: str) -> Any:
            made = self._daq.Task(name, grpc_options=session_options(address, name))
            self._tasks.append(made)
            return made

        self._input = task("nmt_input")
        entries = [*inputs, *([] if self._stop_line is None else [(*self._stop_line[:2], "dc", 0.0, "")])]
        channels = []
        for port, reach, coupling, current, _ in entries:
            with self._asking(f"±{reach:g} V at {port}", "correct its port or range_v"):
                channel = self._input.ai_channels.add_ai_voltage_chan(str(port), min_val=-reach, max_val=reach)
            channels.append(channel)
            if coupling == "ac":
                with self._asking(f"AC coupling at {port}", "write coupling: dc"):
                    channel.ai_coupling = constants.Coupling.AC
            if current:
                with self._asking(
                    f"an ICP current of {current:g} mA at {port}", "give one that the module has (icp_ma)"
                ):
                    channel.ai_excit_src = constants.ExcitationSource.INTERNAL
                    channel.ai_excit_voltage_or_current = constants.ExcitationVoltageOrCurrent.USE_CURRENT
                    channel.ai_excit_val = 1e-3 * float(current)
        with self._asking(f"{self._rate:g} Hz", "give a sample_rate_hz that all its modules have"):
            self._input.timing.cfg_samp_clk_timing(
                self._rate, sample_mode=continuous, samps_per_chan=max(20 * block, int(self._rate))
            )
            self._input.control(constants.TaskMode.TASK_VERIFY)
            taken = float(self._input.timing.samp_clk_rate)
        self._same("the sample rate", self._rate, taken, "Hz", f"sample_rate_hz: {taken:.10g} into the rig file")
        for port, *_, serial in entries:
            self._compare_sheet(str(port), str(serial), session_options(address, ""))
        for channel, (port, reach, _, current, _) in zip(channels, entries, strict=True):
            own = float(channel.ai_max)
            self._same(f"the range of {port}", float(reach), own, "V", f"range_v: {own:.10g}")
            if current:
                icp = 1e3 * float(channel.ai_excit_val)
                self._same(f"the ICP current of {port}", float(current), icp, "mA", f"icp_ma: {icp:.10g}")
        own_clock = start_trigger and clock_source
        terminals = device if own_clock else self._clock_device(address, device)
        start_trigger = start_trigger or f"/{terminals}/ai/StartTrigger"
        clock_source = clock_source or f"/{terminals}/ai/SampleClock"
        self._output = task("nmt_output")
        for port, reach, _ in outputs:
            with self._asking(f"±{reach:g} V at {port}", "correct its port or range_v"):
                channel = self._output.ao_channels.add_ao_voltage_chan(str(port), min_val=-reach, max_val=reach)
            with contextlib.suppress(self._daq.errors.Error):  # not every device can; see the guide
                channel.ao_idle_output_behavior = constants.AOIdleOutputBehavior.ZERO_VOLTS
        with self._asking(f"the clock {clock_source} for the output", "correct device.clock_source, or leave it out"):
            self._output.timing.cfg_samp_clk_timing(
                self._rate, source=clock_source, sample_mode=continuous, samps_per_chan=self._blocks * block
            )
        self._output.out_stream.regen_mode = constants.RegenerationMode.DONT_ALLOW_REGENERATION
        self._output.out_stream.output_buf_size = self._blocks * block
        with self._asking(f"the start trigger {start_trigger}", "correct device.start_trigger, or leave it out"):
            self._output.triggers.start_trigger.cfg_dig_edge_start_trig(start_trigger)
            self._output.control(constants.TaskMode.TASK_VERIFY)
        self._reader = AnalogMultiChannelReader(self._input.in_stream)
        self._writer = AnalogMultiChannelWriter(self._output.out_stream, auto_start=False)
        self._reader.verify_array_shape = self._writer.verify_array_shape = False

    def _start(self) -> None:
        """Fill the buffer with zeros, arm the output, start the input, which triggers it."""
        self._write(np.zeros((self.outputs, self._blocks * self.chunk_samples)))
        self._output.start()
        self._input.start()
        self._running = True

    @property
    def _timeout(self) -> float:
        return 1.0 + 4.0 * self._blocks * self.chunk_samples / self._rate

    def _write(self, values: FloatArray) -> None:
        written = self._writer.write_many_sample(np.ascontiguousarray(values * self._scale), timeout=self._timeout)
        if written != values.shape[1]:
            raise self._daq.errors.DaqWriteError("Samples were not taken.", _NOT_FED, written)

    def exchange(self, values: FloatArray) -> Taken:
        """Write a block, read a block; starts over where the driver says that samples were lost."""
        try:
            if not self._running:
                self._start()
            self._write(values)
            self._reader.read_many_sample(self._measured, values.shape[1], timeout=self._timeout)
        except self._daq.errors.DaqError as error:
            if error.error_code not in _LOST_CODES:
                raise RuntimeError(f"NI-DAQmx: {_first_line(error)}") from error
            self._start_over(error)
            return Taken(np.zeros((self.inputs, values.shape[1])), True)
        if self._stop_line is not None:
            _, _, threshold, below = self._stop_line
            level = self._measured[-1]
            self._stop_asked = bool(np.median(level) < threshold if below else np.median(level) > threshold)
        return Taken(self._measured[: self.inputs].copy())

    def stop_requested(self) -> bool:
        """Whether the stop line asked for zero in most of the samples of the last block."""
        return self._stop_asked

    def _start_over(self, error: Exception) -> None:
        now = self._clock.now()
        self._restarts = [*(at for at in self._restarts if now - at < _RESTARTS_WITHIN), now]
        if len(self._restarts) > _MOST_RESTARTS:
            raise RuntimeError(
                f"NI-DAQmx lost samples {len(self._restarts)} times within {_RESTARTS_WITHIN:g} s "
                f"({_first_line(error)}); give larger blocks (block_samples) or a larger output buffer (buffer_blocks)"
            ) from error
        self._stop()

    def _stop(self) -> None:
        self._running = False
        for task in (self._output, self._input):
            with contextlib.suppress(self._daq.errors.Error):
                task.stop()

    def close(self) -> None:
        """Write zeros, wait until they are out, release the device."""
        if self._running:
            with contextlib.suppress(self._daq.errors.Error):
                for _ in range(self._blocks + 1):
                    self._write(np.zeros((self.outputs, self.chunk_samples)))
                self._clock.sleep(self._blocks * self.chunk_samples / self._rate)
            self._stop()
        for task in self._tasks:
            with contextlib.suppress(self._daq.errors.Error):
                task.close()
        self._tasks = []


def main(arguments: Sequence[str] | None = None) -> int:
    """Look for the devices of physical channels; one sentence with exit code 2 for what is missing."""
    address, *ports = sys.argv[1:] if arguments is None else arguments
    try:
        _look_for(address, ports)
    except BenchError as error:
        sys.stdout.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
