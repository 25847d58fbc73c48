"""``./nmt specimen``: the simulated rig behind a converter's ports."""

from __future__ import annotations

import argparse

from nmt_bench.command_parser import Subparsers

KINDS = ("portaudio", "nidaqmx")


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    from nmt_plant.specimen_options import add_options

    parser = subparsers.add_parser(
        "specimen",
        help="the simulated rig behind a converter's ports, in real time",
        description=(
            "Stands in for amplifier, exciter, structure, sensors and cables: a JACK client that answers in real time "
            "(with a JACK server of its own where none runs), or a stand-in for NI's gRPC device server. Start it in "
            "one terminal and './nmt check RIG --device KIND' and './nmt run RIG --device KIND' in another, with the "
            "same --set. Ctrl-C ends it."
        ),
    )
    parser.add_argument("--device", choices=KINDS, default="portaudio", help="kind of ports (default: portaudio)")
    add_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Answer until Ctrl-C.

    Raises:
        BenchError: rig or option are refused, or JACK or NI's package is missing.
    """
    if arguments.device == "portaudio":
        from nmt_plant.jack_specimen import run as serve
    else:
        from nmt_plant.ni_specimen import run as serve
    return serve(arguments)
