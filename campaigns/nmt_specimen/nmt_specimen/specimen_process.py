"""What the simulated specimen's processes share, whichever converter they stand for."""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import signal
import stat
import sys
import threading
from collections.abc import Callable, Sequence

from nmt_core.errors import BenchError
from nmt_core.options import add_options, options_of
from nmt_plant.devices.hardware_rig import device_of
from nmt_plant.specimen import Specimen
from nmt_plant.specimen_faults import parse_fault
from nmt_rig.device_sections import AnyDevice
from nmt_rig.rig import Rig, load_rig
from nmt_specimen.specimen_options import PortOptions

_PRIORITY = 5


def specimen_of(options: PortOptions, kind: str, clock_error: float = 0.0) -> tuple[Rig, AnyDevice, Specimen, int]:
    """The rig, its converter, what answers behind the ports, and the most samples of the drive ports to keep.

    Args:
        options: of the ports.
        kind: of the converter.
        clock_error: as of `Specimen`.

    Raises:
        BenchError: rig or option are refused.
    """
    changes = [*options.set, *([f"exciter.point={options.exciter}"] if options.exciter is not None else [])]
    rig = load_rig(options.rig, changes)
    device = rig.device if rig.device is not None and rig.device.kind == kind else device_of(rig, kind)
    faults = [parse_fault(text) for text in options.fault]
    specimen = Specimen(rig, device, options.bits, options.noise, clock_error, options.delay, faults)
    return rig, device, specimen, 0 if options.record is None else round(options.record_s * rig.sample_rate_hz)


def hurry() -> None:
    """Ask for a real-time priority for this thread and those that it starts; nothing where it is not allowed."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))


def answer(ready: str, *ends: Callable[[], bool], meanwhile: Callable[[], None] = lambda: None) -> None:
    """Say that it is ready; return at a signal, at one of the ends, or at the end of a standard input that is a pipe.

    Args:
        ready: a line.
        *ends: asked ten times a second.
        meanwhile: done as often.
    """
    sys.stdout.write(f"ready: {ready}\n")
    sys.stdout.flush()
    told = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: told.set())
    follow = False
    with contextlib.suppress(OSError, ValueError):
        follow = stat.S_ISFIFO(os.fstat(sys.stdin.fileno()).st_mode)
    while not told.is_set() and not any(end() for end in ends):
        if follow and select.select([sys.stdin], [], [], 0.0)[0] and not os.read(sys.stdin.fileno(), 100):
            return
        meanwhile()
        told.wait(0.1)


def main_of(name: str, text: str | None, run: Callable[[PortOptions], int], arguments: Sequence[str] | None) -> int:
    """Run a specimen's process; one sentence and exit code 2 for what the user can fix.

    Args:
        name: of its module.
        text: its description.
        run: of the options; returns the exit code.
        arguments: of the process; None = the command line's.
    """
    parser = argparse.ArgumentParser(prog=f"nmt_plant.{name}", description=text)
    add_options(parser, PortOptions)
    try:
        return run(options_of(PortOptions, parser.parse_args(arguments)))
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return 2
