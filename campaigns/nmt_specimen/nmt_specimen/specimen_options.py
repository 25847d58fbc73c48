"""Options of the simulated specimen's processes; nothing numerical is loaded for them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nmt_core.options import argument, option


@dataclass(frozen=True, kw_only=True)
class PortOptions:
    """Of ``./nmt specimen`` and of the processes behind it."""

    rig: str = argument("name of a rig, or path of a rig file", metavar="RIG")
    set: tuple[str, ...] = option((), "change a value of the rig file", metavar="KEY=VALUE")
    exciter: int | None = option(None, "drive point (default: the rig's)", metavar="N")
    bits: int = option(24, "resolution of the converter (default: 24)", metavar="N")
    noise: float = option(2e-05, "noise at a port of 10 V range, V rms (default: 2e-5)", metavar="V")
    clock_ppm: float = option(0.0, "error of the converter's clock (default: 0)", metavar="PPM")
    delay: int = option(0, "further samples of delay (default: 0)", metavar="N")
    fault: tuple[str, ...] = option(
        (), "plant a fault, for a channel from a drive of V volts on; may be repeated", metavar="NAME[:CHANNEL[@V]]"
    )
    period: int | None = option(None, "samples of a JACK period (default: half a block)", metavar="N")
    name: str = option("nmt_specimen", "of the JACK client (default: nmt_specimen)", metavar="NAME")
    record: Path | None = option(None, "write what was at the drive port, V, and when (NumPy archive)", metavar="FILE")
    record_s: float = option(120.0, "its length (default: 120)", metavar="S")
    address: str = option("127.0.0.1:31763", "nidaqmx: of the server (default: 127.0.0.1:31763)", metavar="HOST:PORT")
    stop_file: Path | None = option(
        None,
        "nidaqmx: file whose existence is the external stop line (device.stop_input) asking for zero",
        metavar="FILE",
    )
    log: Path | None = option(None, "log of the JACK server", metavar="FILE")
