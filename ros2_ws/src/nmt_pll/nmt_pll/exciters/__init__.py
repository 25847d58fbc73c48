"""Amplitude, phase and harmonics of several exciters."""
