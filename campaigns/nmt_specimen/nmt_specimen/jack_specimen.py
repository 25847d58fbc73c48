"""The simulated specimen on the other side of JACK's ports, in real time, in a process of its own.

    python -m nmt_specimen.jack_specimen RIG [options]

It registers as a JACK client with an input port for the drive of every exciter and an output port for every channel;
PortAudio lists it among its devices under that name. Without a running JACK server it starts one with the dummy driver
at the rig's sample rate, which needs no sound hardware, with real-time priority where the system allows it. It says
``ready`` when it answers, and ends with its standard input or a signal.
"""

from __future__ import annotations

import contextlib
import gc
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_plant.specimen import Specimen, write_port
from nmt_rig.device_sections import SPECIMEN
from nmt_specimen.specimen_options import PortOptions
from nmt_specimen.specimen_process import answer, hurry, main_of, specimen_of

_PRIORITY = 20
_START_TIME = 15.0
SERVER_VARIABLE = "JACK_DEFAULT_SERVER"


def real_time_allowed() -> bool:
    """Whether this user may run processes at a real-time priority."""
    allowed = subprocess.run(
        [sys.executable, "-c", f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({_PRIORITY}))"],
        capture_output=True,
    )
    return allowed.returncode == 0


class JackServer:
    """A JACK server with the dummy driver.

    Args:
        name: of the server.
        sample_rate: Hz.
        period: samples.
        log: file for what it says; None = nowhere.

    Raises:
        BenchError: jackd is not installed or does not start.
    """

    def __init__(self, name: str, sample_rate: int, period: int, log: Path | None = None) -> None:
        if shutil.which("jackd") is None:
            raise BenchError("JACK is not installed (jackd); type 'sudo apt install jackd2', then the command again.")
        self.real_time = real_time_allowed()
        priority = ["-R", "-P", str(_PRIORITY)] if self.real_time else ["-r"]
        command = ["jackd", *priority, "-n", name, "-d", "dummy", "-r", str(sample_rate), "-p", str(period)]
        command += ["-C", "0", "-P", "0"]
        with contextlib.ExitStack() as stack:
            output: Any = subprocess.DEVNULL if log is None else stack.enter_context(log.open("wb"))
            self.process = subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)
        end = time.monotonic() + _START_TIME
        while not is_running(name):
            if self.process.poll() is not None or time.monotonic() > end:
                self.close()
                raise BenchError(f"The JACK server '{name}' does not start; try 'jackd -d dummy -r {sample_rate}'.")

    def close(self) -> None:
        """End the server."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()


def is_running(name: str) -> bool:
    """Whether a JACK server of that name answers."""
    if shutil.which("jack_wait") is None:
        return False
    asked = subprocess.run(["jack_wait", "-c", "-s", name], capture_output=True, text=True)
    return "not running" not in asked.stdout and "running" in asked.stdout


def load_jack() -> Any:
    """The package JACK-Client with its library.

    Raises:
        BenchError: package or library is missing.
    """
    try:
        import jack
    except ModuleNotFoundError:
        raise BenchError("The package JACK-Client is not installed; type: pip install JACK-Client.") from None
    except OSError:
        raise BenchError("JACK is not installed (libjack); type 'sudo apt install jackd2'.") from None
    return jack


class JackSpecimen:
    """A specimen as a client of a JACK server.

    Args:
        specimen: what answers.
        name: of the client.
        record: most samples of the drive ports that are kept, to be looked at later; 0 = none.
    """

    def __init__(self, specimen: Specimen, name: str = SPECIMEN, record: int = 0) -> None:
        jack = load_jack()
        try:
            self._client = jack.Client(name, no_start_server=True)
        except jack.JackError as error:
            raise BenchError(f"The JACK server does not take the client {name}: {error}.") from None
        self.sample_rate = self._client.samplerate
        self._specimen = specimen
        self._ranges = [1.0 / value for value in specimen.input_ranges]
        names = ["drive", *(f"drive{number}" for number in range(2, specimen.outputs + 1))]
        self._drives = [self._client.inports.register(each) for each in names]
        self._output_ranges = np.array([[value] for value in specimen.output_ranges])
        self._ports = [self._client.outports.register(channel) for channel in specimen.channels]
        self._record = np.zeros((specimen.outputs, record), np.float32)
        self.recorded = 0
        self.record_times: list[tuple[float, int]] = []
        self.xruns = 0
        self.failure = ""
        self.gone = threading.Event()
        self._client.set_process_callback(self._process)
        self._client.set_xrun_callback(self._on_xrun)
        self._client.set_shutdown_callback(lambda *_: self.gone.set())

    def _on_xrun(self, _: float) -> None:
        self.xruns += 1

    def _process(self, frames: int) -> None:
        if self.failure:
            for port in self._ports:
                port.get_array()[:] = 0.0
            return
        drive = np.stack([port.get_array() for port in self._drives])
        if self.recorded + frames <= self._record.shape[1]:
            self._record[:, self.recorded : self.recorded + frames] = drive
            self.record_times.append((time.monotonic(), self.recorded + frames))
        self.recorded += frames
        try:
            answer = self._specimen.respond(drive.astype(np.float64) * self._output_ranges)
        except Exception as error:
            self.failure = str(error)
            return
        for port, scale, values in zip(self._ports, self._ranges, answer, strict=True):
            port.get_array()[:] = values * scale

    def start(self) -> None:
        """Answer from now on."""
        # Compiled, or loaded, before the first period is due.
        self._specimen.respond(np.zeros((len(self._drives), self._client.blocksize)))
        gc.collect()
        gc.freeze()
        gc.disable()
        self._client.activate()

    def close(self) -> None:
        """Leave the server."""
        with contextlib.suppress(Exception):
            self._client.deactivate()
            self._client.close()

    def write_record(self, path: Path) -> None:
        """Write what was at the drive ports, V, and when, as a NumPy archive; see `specimen.write_port`."""
        count = self.record_times[-1][1] if self.record_times else 0
        volts = self._output_ranges * self._record[:, :count].astype(np.float64)
        write_port(path, volts[0] if len(volts) == 1 else volts, self.record_times)


def run(options: PortOptions) -> int:
    """Start server and specimen, answer until told to end.

    Raises:
        BenchError: rig, option or JACK are refused.
    """
    rig, _, specimen, record = specimen_of(options, "portaudio", 1e-6 * options.clock_ppm)
    if rig.sample_rate_hz != round(rig.sample_rate_hz):
        raise BenchError(f"JACK needs a whole number of samples a second, got {rig.sample_rate_hz:g} Hz.")
    load_jack()
    server_name = os.environ.get(SERVER_VARIABLE, "default")
    server = None
    if not is_running(server_name):
        period = options.period or max(rig.block_samples // 2, 32)
        server = JackServer(server_name, int(rig.sample_rate_hz), period, options.log)
    try:
        client = JackSpecimen(specimen, options.name, record)
        if client.sample_rate != rig.sample_rate_hz:
            client.close()
            raise BenchError(
                f"The JACK server runs at {client.sample_rate} Hz and the rig at {rig.sample_rate_hz:g} Hz; write "
                f"--set sample_rate_hz={client.sample_rate}, or end the server."
            )
        hurry()  # a thread that holds the interpreter must not be held up itself while JACK's thread waits for it
        client.start()
        priority = "" if server is None else (", real-time priority" if server.real_time else ", no real-time priority")
        answer(
            f"{rig.name} behind JACK client {options.name}, {client.sample_rate} Hz, channels "
            f"{', '.join(specimen.channels)}{priority}",
            client.gone.is_set,
            lambda: bool(client.failure),
        )
        client.close()
        if options.record is not None:
            client.write_record(options.record)
        sys.stdout.write(
            f"ended: {client.recorded} samples, {client.xruns} xruns{client.failure and ', '}{client.failure}\n"
        )
        return 1 if client.failure else 0
    finally:
        if server is not None:
            server.close()


if __name__ == "__main__":
    sys.exit(main_of("jack_specimen", __doc__, run, None))
