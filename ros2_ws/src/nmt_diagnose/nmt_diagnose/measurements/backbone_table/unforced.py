"""Observables of phase resonance whose force nobody recorded, such as limit cycles: frequency over amplitude."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.observations.bag_windows import BagWindows, Window
from nmt_diagnose.observations.observables import Observations, empty, joined
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_tables import table_observations
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_signals.harmonics import harmonic_amplitudes
from nmt_signals.sine_fit import fit_frequency

_PARTS = 6
"""Parts of a window whose scatter tells the uncertainty of its frequency."""


def unforced_observations(bag: BagWindows) -> list[Observations]:
    """Observables of windows of phase resonance of one exciter that no force was recorded of; takes them out.

    Several exciters hold a mode among neighbours by the ratio of their forces, which a backbone of one point lacks.
    """
    windows = [it for it in bag.of_kind(TestKind.PHASE_RESONANCE) if it.stretch.find(Quantity.FORCE) is None]
    if not windows or len(bag.model.all_exciters) > 1:
        return []
    name = bag.part_named(windows, "unforced")
    found = _backbone(name, windows, bag)
    bag.note_few_levels(name, len(found.rows))
    bag.take(windows)
    return [found]


def _backbone(name: str, windows: Sequence[Window], bag: BagWindows) -> Observations:
    """Rows of a backbone, one a window: frequency of the motion at the amplitude of its fundamental, and no damping.

    At phase resonance, forced or in a limit cycle, that is the frequency of the nonlinear mode; how much power it takes
    only a force could tell.
    """
    view, settings = bag.view, bag.settings
    notes, rows = [], []
    responses = [c for c in bag.channels.values() if c.quantity in MOTIONS]
    if not responses:
        return empty((f"{name}: left out: it has no response channel that the model {view.rig.name} has too.",))
    at_drive = [c for c in responses if c.point == view.rig.drive_point]
    channel = (at_drive or responses)[0]
    for window in windows:
        segment, stretch = window.segment, window.stretch
        where = f"{name}: level {segment.level_index}"
        if channel.name in stretch.faults or channel.name not in [c.name for c in stretch.channels]:
            notes.append(f"{where} is left out: it lacks channel {channel.name}.")
            continue
        signal = stretch.row(channel.name)
        try:
            rows.append(_row(signal - float(np.mean(signal)), stretch.sample_rate, segment.frequency_hz, settings))
        except BenchError as error:
            notes.append(f"{where} is left out: its motion tells no frequency ({str(error).rstrip('.')}).")
    if not rows:
        return empty(notes)
    notes.append(f"{name}: no force was recorded, so that it tells frequencies over amplitudes and no damping.")
    columns = dict(zip(("frequency_hz", "frequency_hz_std", "amplitude"), np.array(rows).T, strict=True))
    units = {"amplitude": "rad" if channel.turns else "m"}
    table = ObservableTable(
        TableKind.BACKBONE, columns, units, channel.quantity, point=channel.point, drive_point=view.rig.drive_point
    )
    return joined([empty(notes), table_observations(name, [table], view.rig, settings)])


def _row(signal: FloatArray, rate: float, guess_hz: float, settings: ObservationSettings) -> tuple[float, float, float]:
    """Frequency and its standard uncertainty, Hz, and amplitude of the fundamental."""
    if not np.ptp(signal) > 0.0:
        raise BenchError("it stands still")
    frequency = fit_frequency(signal, rate, guess_hz)
    periods = signal.size * frequency / rate
    if periods < settings.fewest_periods:
        raise BenchError(f"{periods:.1f} periods, of at least {settings.fewest_periods}")
    cycles = np.arange(signal.size, dtype=np.float64) * frequency / rate
    amplitude = abs(harmonic_amplitudes(cycles, signal[None, :], 3)[0, 1])
    parts = [fit_frequency(part, rate, frequency) for part in np.array_split(signal, min(_PARTS, int(periods // 2)))]
    return frequency, float(np.std(parts, ddof=1)) / math.sqrt(len(parts)), float(amplitude)
