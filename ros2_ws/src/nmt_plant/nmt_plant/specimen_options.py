"""Options of the simulated specimen's processes; nothing numerical is loaded for them."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of the process and of ``./nmt specimen``."""
    parser.add_argument("rig", metavar="RIG", help="name of a rig, or path of a rig file")
    parser.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[], help="change a value of the rig file"
    )
    parser.add_argument("--exciter", metavar="N", type=int, help="drive point (default: the rig's)")
    parser.add_argument("--bits", metavar="N", type=int, default=24, help="resolution of the converter (default: 24)")
    parser.add_argument(
        "--noise", metavar="V", type=float, default=2e-5, help="noise at a port of 10 V range, V rms (default: 2e-5)"
    )
    parser.add_argument(
        "--clock-ppm", metavar="PPM", type=float, default=0.0, help="error of the converter's clock (default: 0)"
    )
    parser.add_argument("--delay", metavar="N", type=int, default=0, help="further samples of delay (default: 0)")
    parser.add_argument(
        "--fault",
        metavar="NAME[:CHANNEL[@V]]",
        action="append",
        default=[],
        help="plant a fault, for a channel from a drive of V volts on; may be repeated",
    )
    parser.add_argument("--period", metavar="N", type=int, help="samples of a JACK period (default: half a block)")
    parser.add_argument("--name", default="nmt_specimen", help="of the JACK client (default: nmt_specimen)")
    parser.add_argument(
        "--record", metavar="FILE", type=Path, help="write what was at the drive port, V, and when (NumPy archive)"
    )
    parser.add_argument("--record-s", metavar="S", type=float, default=120.0, help="its length (default: 120)")
    parser.add_argument(
        "--address",
        metavar="HOST:PORT",
        default="127.0.0.1:31763",
        help="nidaqmx: of the server (default: 127.0.0.1:31763)",
    )
    parser.add_argument(
        "--stop-file",
        metavar="FILE",
        type=Path,
        help="nidaqmx: file whose existence is the external stop line (device.stop_input) asking for zero",
    )
    parser.add_argument("--log", metavar="FILE", type=Path, help="log of the JACK server")
