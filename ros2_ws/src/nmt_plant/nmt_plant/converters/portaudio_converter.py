"""A sound card, or whatever PortAudio reaches (JACK, ALSA, ASIO, CoreAudio), as the converter of an output.

Full duplex in one stream: inputs and output share PortAudio's clock. The callback runs in PortAudio's own thread of the
process that owns the output. PortAudio is reached by the package sounddevice, which needs the system's library.

    python -m nmt_plant.converters.portaudio_converter

prints the devices as JSON; the command line asks so, since libraries of sound systems write to the terminal.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.steady_clock import STEADY_CLOCK, SteadyClock
from nmt_plant.converters.converter import Converter, Taken, Turn

if TYPE_CHECKING:
    from nmt_rig.device_sections import PortAudioSection
    from nmt_rig.rig import Rig

_MISSING = (
    "PortAudio is not installed (libportaudio.so.2); type 'sudo apt install libportaudio2', and 'jackd2' for JACK, "
    "then the command again."
)
_LATE_TURN = 0.8  # of a period, from which a turn counts as missed
_SLOWEST_CLOCK = 1e-3  # relative
_STALL = 2.0  # s without a callback after which the stream is taken for dead


def load_portaudio() -> ModuleType:
    """The package sounddevice with its library.

    Raises:
        BenchError: package or library is missing, with the command that fixes it.
    """
    try:
        import sounddevice
    except ModuleNotFoundError:
        raise BenchError("The package sounddevice is not installed; type: pip install sounddevice.") from None
    except OSError:
        raise BenchError(_MISSING) from None
    return sounddevice  # type: ignore[no-any-return]


def find_device(devices: Sequence[dict[str, Any]], name: str, host_api: str, inputs: int, outputs: int) -> int:
    """Number of the device of a name, or of a part of it, that has the ports; empty = the first that has them.

    Raises:
        BenchError: there is none, with the list of those that are there.
    """
    fitting = [
        number
        for number, device in enumerate(devices)
        if (not host_api or host_api.lower() in device["host_api"].lower())
        and device["inputs"] >= inputs
        and device["outputs"] >= outputs
    ]
    exact = [number for number in fitting if devices[number]["name"] == name]
    partly = [number for number in fitting if name.lower() in devices[number]["name"].lower()]
    if exact or partly:
        return (exact or partly)[0]
    listed = "; ".join(f"{each['name']} ({each['inputs']} in, {each['outputs']} out)" for each in devices) or "none"
    wanted = f"'{name}'" if name else "device"
    raise BenchError(
        f"PortAudio has no {wanted} with {inputs} inputs and {outputs} outputs; it lists: {listed}. Check the cable, "
        "the sound server (for JACK start 'jackd', for the simulated specimen './nmt specimen RIG'), and device.name."
    )


def find_rig_device(section: PortAudioSection, rig: Rig) -> None:
    """Refuse a device that PortAudio does not list, or a JACK server at another rate.

    Raises:
        BenchError: library or device is missing, with what fixes it.
    """
    ports = [max(int(entry.port) for entry in entries) for entries in (section.inputs, section.outputs)]
    devices = list_devices()
    found = devices[find_device(devices, section.name, section.host_api, *ports)]
    if "jack" in found["host_api"].lower() and round(found["rate"]) != round(rig.sample_rate_hz):
        raise BenchError(
            f"The JACK server runs at {found['rate']:g} Hz and rig {rig.name} at {rig.sample_rate_hz:g} Hz; write "
            f"--set sample_rate_hz={found['rate']:g}, or start the server at the rig's rate."
        )


def list_devices() -> list[dict[str, Any]]:
    """Name, host API, ports and default rate (Hz) of PortAudio's devices, asked in a process of its own.

    Raises:
        BenchError: PortAudio is missing.
    """
    asked = subprocess.run(
        [sys.executable, "-m", "nmt_plant.converters.portaudio_converter"], capture_output=True, text=True, timeout=30
    )
    if asked.returncode == 2:
        raise BenchError(asked.stdout.strip())
    try:
        found: list[dict[str, Any]] = json.loads(asked.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        raise BenchError("PortAudio does not start; look at the sound server and its log.") from None
    return found


def _devices(portaudio: ModuleType) -> list[dict[str, Any]]:
    apis = portaudio.query_hostapis()
    return [
        {
            "name": device["name"],
            "host_api": apis[device["hostapi"]]["name"],
            "inputs": device["max_input_channels"],
            "outputs": device["max_output_channels"],
            "rate": device["default_samplerate"],
        }
        for device in portaudio.query_devices()
    ]


class MissedTurns:
    """Finds turns of JACK that this client was left out of, by the time at which it is called.

    JACK tells of an xrun from another thread, which may come a turn too late. Turns are a period apart: a call that
    comes most of a period later than the earliest before it, in the clock of the periods, has missed one.
    """

    def __init__(self) -> None:
        self._base: float | None = None
        self._calls = 0.0  # s, of the turns so far

    def look(self, now: float, period: float) -> bool:
        """Whether turns were missed before this call.

        Args:
            now: s on the steady clock.
            period: s, of this turn.
        """
        late = now - self._calls
        self._calls += period
        if self._base is None or late < self._base:
            self._base = late
            return False
        missed = int((late - self._base) / period + 1.0 - _LATE_TURN)
        # The converter's clock may be slower than this computer's.
        self._base += missed * period + _SLOWEST_CLOCK * period
        return missed > 0


class PortAudioConverter(Converter):
    """Ports of one PortAudio device.

    Args:
        sample_rate: Hz.
        outputs: (port from 1, range in V, amplifier gain) of each.
        inputs: (port from 1, range in V) of each.
        name, host_api: of the device, see `find_device`.
        frames: samples of a callback; 0 = PortAudio's choice.
        latency: s that PortAudio is asked for; None = its low one.
        clock: by which turns are missed, and a stream stands still.

    Raises:
        BenchError: PortAudio, the device, its ports or its rate are not there.
    """

    def __init__(
        self,
        sample_rate: float,
        outputs: Sequence[Sequence[float]],
        inputs: Sequence[Sequence[float]],
        name: str = "",
        host_api: str = "",
        frames: int = 0,
        latency: float | None = None,
        clock: SteadyClock = STEADY_CLOCK,
    ) -> None:
        self._clock = clock
        self._portaudio = load_portaudio()
        self.outputs, self.inputs = len(outputs), len(inputs)
        self.delay = -1
        self._rate = sample_rate
        out_ports, in_ports = ([int(entry[0]) - 1 for entry in entries] for entries in (outputs, inputs))
        self._out_ports, self._in_ports = out_ports, in_ports
        self._out_scale = np.array([1.0 / (entry[1] * entry[2]) for entry in outputs])
        self._in_scale = np.array([float(entry[1]) for entry in inputs])
        channels = (max(in_ports) + 1, max(out_ports) + 1)
        number = find_device(_devices(self._portaudio), name, host_api, *channels)
        self._ended = threading.Event()
        self._turn: Turn | None = None
        self._failure: Exception | None = None
        self._called = 0
        apis = self._portaudio.query_hostapis()
        host = apis[self._portaudio.query_devices(number)["hostapi"]]["name"]
        self._missed = MissedTurns() if "jack" in host.lower() else None
        try:
            self._stream = self._portaudio.Stream(
                samplerate=sample_rate,
                blocksize=frames,
                device=(number, number),
                channels=channels,
                dtype="float32",
                latency="low" if latency is None else latency,
                callback=self._callback,
                clip_off=False,
                dither_off=True,
            )
        except self._portaudio.PortAudioError as error:
            device = self._portaudio.query_devices(number)
            raise BenchError(
                f"PortAudio does not open {device['name']} at {sample_rate:g} Hz (its rate is "
                f"{device['default_samplerate']:g} Hz): {error.args[0]}; set sample_rate_hz of the rig to the device's "
                "rate."
            ) from error

    def run(self, turn: Turn) -> None:
        """Put out and measure until ``turn`` gives None."""
        self._turn = turn
        with self._stream:
            called = -1
            while not self._clock.wait(self._ended, _STALL):
                if called == self._called:
                    raise RuntimeError(
                        "PortAudio's stream stands still; the sound server has ended or the cable is out"
                    )
                called = self._called
        if self._failure is not None:
            raise self._failure

    def _callback(self, measured: FloatArray, put_out: FloatArray, frames: int, time: Any, status: Any) -> None:
        put_out[:] = 0.0
        self._called += 1
        lost = bool(status)
        if self._missed is not None:
            lost = self._missed.look(self._clock.now(), frames / self._rate) or lost
        if self.stated < 0 and not status:
            self._take_stated_delay(frames, time)
        taken = Taken((measured[:, self._in_ports] * self._in_scale).T.astype(np.float64), lost)
        assert self._turn is not None
        try:
            values = self._turn(frames, taken)
        except Exception as error:
            self._failure = error
            self._ended.set()
            raise self._portaudio.CallbackAbort from error
        if values is None:
            self._ended.set()
            raise self._portaudio.CallbackStop
        put_out[:, self._out_ports] = (values.T * self._out_scale).astype(np.float32)

    def _take_stated_delay(self, frames: int, time: Any) -> None:
        """What the driver says, where it can be meant."""
        stated = round((time.outputBufferDacTime - time.inputBufferAdcTime) * self._rate)
        if time.inputBufferAdcTime > 0.0 and 0 <= stated < 2.0 * self._rate:
            self.stated = stated
            self.delay = max(stated - frames, 0)

    def close(self) -> None:
        """Release the device, its output at zero."""
        self._stream.close(ignore_errors=True)


def main() -> int:
    """Print the devices as JSON, or one sentence with exit code 2."""
    try:
        found = _devices(load_portaudio())
    except BenchError as error:
        sys.stdout.write(f"{error}\n")
        return 2
    sys.stdout.write(json.dumps(found) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
