"""Converters of hardware: NI, PortAudio, two without a device; their clock and delay."""
