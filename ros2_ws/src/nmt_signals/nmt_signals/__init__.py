"""Evaluation of signals: arrays in, numbers with units and uncertainties out. No files, no rig, no messages.

* :mod:`nmt_signals.harmonics`, :mod:`nmt_signals.sine_fit`: periodic signals on the phase of their excitation;
  :mod:`nmt_signals.spectral_lines`: without it.
* :mod:`nmt_signals.frequency_responses`, :mod:`nmt_signals.local_responses`, :mod:`nmt_signals.rational_fit`:
  responses to a random drive, averaged, at chosen lines, and as a model around a resonance.
* :mod:`nmt_signals.decays`: frequency and damping over amplitude of free decays.
* :mod:`nmt_signals.channel_faults`: clipping, steps of a converter, lost samples, lines of the mains.
"""
