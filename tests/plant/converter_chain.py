"""Both converters on a clock of the test, from the device of the plant node to the specimen behind the ports.

Nothing is left out but processes, JACK and the network: the process that owns the output is a thread, PortAudio is an
object with the few calls that are made of it, and NI's own client library calls the stand-in for NI's server directly.
"""

from __future__ import annotations

import functools
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import Any

import grpc
import nidaqmx
import numpy as np
import pytest
from node.converter_bench import Port
from plant.turned_clock import TurnedClock

from nmt_core.numerics.arrays import FloatArray
from nmt_plant.converters import nidaqmx_converter, portaudio_converter
from nmt_plant.converters.converter import load_converter
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_plant.output_process.output_owner import OutputOwner, OwnerSettings
from nmt_plant.output_process.owner_process import OwnerProcess
from nmt_plant.output_process.shared_samples import SharedSamples
from nmt_plant.specimen import Specimen
from nmt_rig.device_sections import SPECIMEN
from nmt_rig.rig import load_rig
from nmt_specimen.ni_specimen import Hardware, make_calls

KINDS = ("portaudio", "nidaqmx")
RATE, BLOCK, PERIOD = 10_000.0, 200, 100
OWNER = "owner"
_NO_PROCESS = 1 << 30


class OwnerThread(OwnerProcess):
    """The owner of an output as a participant of a clock."""

    def __init__(
        self,
        clock: TurnedClock,
        settings: OwnerSettings,
        channel: socket.socket,
        samples: SharedSamples,
        converter: str,
        arguments: Any,
        stop_input: int | None,
    ) -> None:
        self.pid = _NO_PROCESS
        self.owner: OutputOwner | None = None
        self._clock, self._channel, self._words = clock, channel.dup(), ""

        def work() -> None:
            try:
                made = load_converter(converter, {**arguments, "clock": clock})
                self.owner = OutputOwner(settings, self._channel, samples, made, stop_input, clock=clock)
                self.owner.run()
            except Exception as error:
                self._words = str(error).rstrip(".")
            finally:
                self._channel.close()

        self._ended = clock.start(OWNER, work)

    @property
    def has_ended(self) -> bool:
        return self._ended.is_set()

    def wait(self, seconds: float) -> bool:
        return self._clock.wait(self._ended, seconds)

    def kill(self) -> None:
        self._clock.kill(OWNER)
        self._clock.wait(self._ended, 1.0)
        self._channel.close()

    def last_words(self) -> str:
        return self._words or "it does not answer"

    def close(self) -> None:
        pass


class PortAudio:
    """What is called of the package sounddevice, with a JACK server behind it; its turns come from a participant.

    A client that is stopped misses turns, and its last period is repeated; the ports of one that has gone are silent.

    Args:
        clock: of the test.
        specimen: behind the ports.
        clock_error: of the server's clock, relative.
        tells: whether the callback hears of missed turns from PortAudio, too.

    Attributes:
        stands_still: the server has ended: no turn comes any more, and nothing is at the port.
        late: s, by which the next turns come late, as on a busy computer.
        port, times: what was at the output ports, (outputs, samples) V, and (s, samples) as in
            `node.converter_bench.Port`.
    """

    class PortAudioError(Exception):
        """As PortAudio's."""

    class CallbackStop(Exception):  # noqa: N818 - PortAudio's name
        """As PortAudio's."""

    class CallbackAbort(Exception):  # noqa: N818 - PortAudio's name
        """As PortAudio's."""

    def __init__(self, clock: TurnedClock, specimen: Specimen, clock_error: float = 0.0, tells: bool = True) -> None:
        self._clock, self._specimen, self._tells = clock, specimen, tells
        self._period = PERIOD / (RATE * (1.0 + clock_error))
        self._callback: Callable[..., None] | None = None
        self._put_out = np.zeros((PERIOD, specimen.outputs), np.float32)
        self._ranges = np.array([[value] for value in specimen.output_ranges])
        self.stands_still = False
        self.late: Iterator[float] = iter(())
        self.port: list[FloatArray] = []
        self.times: list[tuple[float, int]] = []
        clock.start("jack", self._run)

    def query_hostapis(self) -> Sequence[dict[str, Any]]:
        return [{"name": "JACK Audio Connection Kit"}]

    def query_devices(self, number: int | None = None) -> Any:
        one = {"name": SPECIMEN, "hostapi": 0, "max_input_channels": 20, "max_output_channels": 2}
        one["default_samplerate"] = RATE
        return [one] if number is None else one

    def Stream(self, **options: Any) -> Any:  # noqa: N802 - PortAudio's name
        if options["samplerate"] != RATE:
            raise self.PortAudioError("Invalid sample rate [PaErrorCode -9997]")
        self._channels, callback = options["channels"], options["callback"]
        jack = self

        class Stream:
            def __enter__(self) -> None:
                jack._callback = callback

            def __exit__(self, *_: Any) -> None:
                self.close()

            def close(self, ignore_errors: bool = True) -> None:
                jack._clock.check()
                jack._callback = None

        return Stream()

    def _run(self) -> None:
        due, missed = self._clock.now(), False
        answer = np.zeros((self._specimen.inputs, PERIOD))
        while True:
            due += self._period
            self._clock.sleep(due - self._clock.now() + next(self.late, 0.0))
            if self._callback is not None and OWNER not in self._clock.killed and self._clock.is_stopped(OWNER):
                missed = True
            elif self.stands_still:
                self._put_out[:] = 0.0
            else:
                self._turn(answer, "output underflow" if missed and self._tells else "")
                missed = False
            port = self._put_out.T.astype(np.float64) * self._ranges
            answer = self._specimen.respond(port)
            self.port.append(port)
            self.times.append((due, len(self.port) * PERIOD))

    def _turn(self, answer: FloatArray, status: str) -> None:
        self._put_out[:] = 0.0
        if self._callback is None or OWNER in self._clock.killed:
            return
        measured = np.zeros((PERIOD, self._channels[0]), np.float32)
        measured[:, : answer.shape[0]] = (answer / np.array([self._specimen.input_ranges]).T).T
        now = self._clock.now()
        stamps = SimpleNamespace(inputBufferAdcTime=now, outputBufferDacTime=now + 2 * PERIOD / RATE)
        try:
            self._callback(measured, self._put_out, PERIOD, stamps, status)
        except (self.CallbackStop, self.CallbackAbort):
            self._put_out[:] = 0.0
            self._callback = None


class NiChannel:
    """Calls of NI's client library go to the stand-in for its server, without a network.

    Attributes:
        refused: name of a call -> code and words of the error that it ends with.
    """

    def __init__(self, clock: TurnedClock, hardware: Hardware, names: str = SPECIMEN) -> None:
        self._clock, self._calls = clock, make_calls(hardware, names)
        self.refused: dict[str, tuple[int, str]] = {}

    def unary_unary(self, path: str, **_: Any) -> Callable[..., Any]:
        name = path.rpartition("/")[2]
        call = getattr(self._calls, name)

        def invoke(request: Any, metadata: Any = None) -> Any:
            self._clock.check()
            context = NiContext()
            if name in self.refused:
                code, words = self.refused[name]
                context.set_trailing_metadata([("ni-error", str(code))])
                context.abort(grpc.StatusCode.UNKNOWN, words)
            return call(request, context)

        return invoke

    def unary_stream(self, path: str, **_: Any) -> None:
        """Events are not asked for."""


class NiContext(grpc.RpcError):
    """Of a call, and the error that it ends with."""

    _details, _metadata = "", ()

    def set_trailing_metadata(self, entries: Sequence[tuple[str, str]]) -> None:
        self._metadata = tuple(SimpleNamespace(key=key, value=value) for key, value in entries)

    def abort(self, code: grpc.StatusCode, details: str) -> None:
        self._code, self._details = code, details
        raise self

    def code(self) -> grpc.StatusCode:
        return self._code

    def details(self) -> str:
        return self._details

    def trailing_metadata(self) -> tuple[Any, ...]:
        return self._metadata


class Chain:
    """A device at its converter, the specimen behind it, and the clock of both.

    Attributes:
        clock: of the test.
        device: not configured yet.
        jack, hardware, channel: the driver of the kind.
        owners: as they were started.
    """

    def __init__(
        self,
        kind: str,
        patch: pytest.MonkeyPatch,
        ppm: float = 0.0,
        tells: bool = True,
        lead_blocks: int = 8,
        changes: Sequence[str] = ("watchdog.blocks=0",),
        section: dict[str, Any] | None = None,
        stop_line: Callable[[], float] | None = None,
        output: dict[str, Any] | None = None,
        name: str = "beam",
        **specimen: Any,
    ) -> None:
        self.kind, self.clock = kind, TurnedClock()
        rig = load_rig(name, list(changes))
        device = device_of(rig, kind, "server").model_copy(update=section or {})
        made = Specimen(rig, device, **specimen)
        self.owners: list[OwnerThread] = []
        if kind == "portaudio":
            self.jack = PortAudio(self.clock, made, 1e-6 * ppm, tells)
            patch.setattr(portaudio_converter, "load_portaudio", lambda: self.jack)
        else:
            self.hardware = Hardware(made, RATE, 1e-6 * ppm, 1_000_000, stop_line, self.clock)
            self.channel = NiChannel(self.clock, self.hardware)
            options = functools.partial(nidaqmx.GrpcSessionOptions, self.channel)
            patch.setattr(nidaqmx_converter, "session_options", lambda _, name: options(name))
        settings = {"clock": self.clock, "start": self._start_owner, **(output or {})}
        self.device = HardwareRig(rig, device, lead_blocks, **settings)

    def _start_owner(self, *arguments: Any) -> OwnerThread:
        self.owners.append(OwnerThread(self.clock, *arguments))
        return self.owners[-1]

    @property
    def owner(self) -> OutputOwner:
        """The one that was started last."""
        made = self.owners[-1].owner
        assert made is not None
        return made

    def stop_owner(self, at: Sequence[float], seconds: float) -> None:
        """Stop the owner's process after so many s from now, each time for so many."""

        def work() -> None:
            begun = self.clock.now()
            for each in at:
                self.clock.sleep(begun + each - self.clock.now())
                self.clock.stop(OWNER, seconds)

        self.clock.start("trouble", work)

    def start(self) -> HardwareRig:
        """Configure and start the device."""
        self.device.configure()
        self.device.start()
        return self.device

    @property
    def port(self) -> Port:
        """What was at the first output port until now."""
        return self.ports[0]

    @property
    def ports(self) -> list[Port]:
        """What was at every output port until now."""
        if self.kind == "portaudio":
            values, times = np.concatenate(self.jack.port, axis=1), np.array(self.jack.times)
        else:
            values, times = self.hardware.at_the_port()
        return [Port(row, times, RATE) for row in np.atleast_2d(values)]


@contextmanager
def chain(kind: str, **options: Any) -> Iterator[Chain]:
    """A chain whose end leaves nothing behind, and its output at zero."""
    with ExitStack() as stack:
        made = Chain(kind, stack.enter_context(pytest.MonkeyPatch.context()), **options)
        stack.callback(made.clock.close)
        yield made
        made.device.close()
        made.clock.sleep(0.1)
        for port in made.ports:
            assert not port.values[-int(0.05 * RATE) :].any(), "the output was left at zero"
        assert made.clock.failures == []
