"""``./nmt specimen``: the simulated rig behind a converter's ports."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.options import option
from nmt_specimen.specimen_options import PortOptions

SUMMARY = "the simulated rig behind a converter's ports, in real time: hardware to try without hardware"


@dataclass(frozen=True, kw_only=True)
class SpecimenOptions(PortOptions):
    """Stands in for amplifier, exciter, structure, sensors and cables: a JACK client that answers in real time (with a
    JACK server of its own where none runs), or a stand-in for NI's gRPC device server. Start it in one terminal and
    './nmt check RIG --device KIND' and './nmt run RIG --device KIND' in another, with the same --set. Ctrl-C ends
    it."""

    device: str = option("portaudio", "kind of ports (default: portaudio)", choices=("portaudio", "nidaqmx"))


def run(options: SpecimenOptions) -> int:
    """Answer until Ctrl-C.

    Raises:
        BenchError: rig or option are refused, or JACK or NI's package is missing.
    """
    if options.device == "portaudio":
        from nmt_specimen.jack_specimen import run as serve
    else:
        from nmt_specimen.ni_specimen import run as serve
    return serve(options)
