"""What the live page shows of the signals: strips, waveforms, orbit, spectrum, averaged response, channels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from nmt_bench.page.channels import Levels, TopicSignals, channel_levels
from nmt_bench.page.decimation import min_max
from nmt_bench.page.signal_views import (
    HARMONICS,
    PERIODS,
    amplitude_spectrum,
    deflection,
    fundamental_amplitudes,
    harmonic_amplitudes,
    paired_periods,
    velocity_of,
    whole_periods,
)
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.records import LevelCommand, LoopStatus
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import LoopState, Quantity
from nmt_report.columns import unit_text
from nmt_signals.frequency_responses import RunningFrf

MOST_SHOWN = 8
MOST_LISTED = 400
_WAVE_BUCKETS = 200
_ORBIT_POINTS = 400
_SPECTRUM_SAMPLES, _LEAST_SPECTRUM = 8192, 256
_FRF_SECONDS = 1.0
RESPONSES = (Quantity.ACCELERATION, Quantity.DISPLACEMENT, Quantity.VELOCITY)


class LiveSignals:
    """The newest signals of a run, and frames of them.

    Attributes:
        topics: signals by quantity.
        status: newest state of the loop; level: level that holds.
        rate: Hz, NaN before the first block.
        gaps: blocks that did not follow the one before.
    """

    def __init__(self, run: Mapping[str, Any], rig: Mapping[str, Any]) -> None:
        self.topics: dict[Quantity, TopicSignals] = {}
        self.status: LoopStatus | None = None
        self.level: LevelCommand | None = None
        self.rate = math.nan
        self.gaps = 0
        self._limits: dict[Quantity, list[Levels]] = {}
        self._frf: RunningFrf | None = None
        self._averaged = 0
        self.describe(run, rig)

    def describe(self, run: Mapping[str, Any], rig: Mapping[str, Any]) -> None:
        """Take a run's description of itself and its rig file, parsed."""
        self._run, self._rig = run, rig
        self._limits = {quantity: self._levels_of(signals) for quantity, signals in self.topics.items()}

    def begin_level(self, level: LevelCommand) -> None:
        """A level begins, which ends the average."""
        self.level, self._frf = level, None

    @property
    def is_broad_band(self) -> bool:
        """Whether the drive of the level has a band and no one frequency."""
        return self.level is not None and kind_class(self.level.test).is_broad_band

    def take(self, block: SampleBlock) -> bool:
        """Take a block; whether the channels are others now."""
        changed = False
        signals = self.topics.get(block.quantity)
        if signals is None or not signals.fits(block):
            if not block.samples or block.quantity is Quantity.UNKNOWN:
                return False
            signals = self.topics[block.quantity] = TopicSignals(block)
            self._limits[block.quantity] = self._levels_of(signals)
            self.rate = block.sample_rate
            changed = True
        elif block.first_sample > signals.recent.end_sample:
            self.gaps += 1
        signals.add(block)
        if block.quantity in RESPONSES and self.is_broad_band:
            self._average(signals)
        return changed

    def _average(self, response: TopicSignals) -> None:
        """Average force and response while a random window is open; both must have come up to the same sample."""
        force = self.topics.get(Quantity.FORCE)
        status = self.status
        if force is None or response is not self.response or status is None or status.state != LoopState.LOCKED:
            return
        if self._frf is None:
            self._frf = RunningFrf(2 * round(0.5 * _FRF_SECONDS * response.sample_rate), response.sample_rate)
            self._averaged = max(force.recent.end_sample, response.recent.end_sample)
            return
        end = min(force.recent.end_sample, response.recent.end_sample)
        count = end - self._averaged
        if count <= 0:
            return
        rows = self._row(force), self._row(response)
        a, b = (
            signals.recent.last(signals.recent.end_sample - self._averaged)[row]
            for signals, row in zip((force, response), rows, strict=True)
        )
        length = min(a.size, b.size, count)
        if length == count:
            self._frf.add(self._averaged, np.array(a[:count]), np.array(b[:count]))
        self._averaged = end

    @property
    def response(self) -> TopicSignals | None:
        """Topic of the response that the loop controls, or the first there is."""
        wanted = self.status.response_unit if self.status is not None else ""
        present = [self.topics[quantity] for quantity in RESPONSES if quantity in self.topics]
        return next((signals for signals in present if signals.unit == wanted), present[0] if present else None)

    @property
    def _drive_point(self) -> int:
        point = self._run.get("exciter_point")
        if isinstance(point, int):
            return point
        force = self.topics.get(Quantity.FORCE)
        return force.points[0] if force is not None and force.points else 0

    def _row(self, signals: TopicSignals) -> int:
        point = self._drive_point
        return signals.points.index(point) if point in signals.points else 0

    def _levels_of(self, signals: TopicSignals) -> list[Levels]:
        limits = self._rig.get("limits")
        section = limits if isinstance(limits, Mapping) else {}
        return [channel_levels(section, signals.quantity, name) for name in signals.channels]

    def shown(self) -> list[tuple[TopicSignals, int]]:
        """Channels whose signals are drawn: force, drive-point response, voltage, then the others in their order.

        Forces and voltages of further exciters come before the other responses.
        """
        first = [self.topics.get(Quantity.FORCE), self.response, self.topics.get(Quantity.VOLTAGE)]
        chosen = [(signals, self._row(signals)) for signals in first if signals is not None]
        if first[2] is not None and len(first[2].channels) > 1:
            for signals in (first[0], first[2]):
                if signals is not None:
                    chosen += [(signals, row) for row in range(len(signals.channels)) if (signals, row) not in chosen]
        for quantity in Quantity:
            signals = self.topics.get(quantity)
            if signals is not None:
                chosen += [(signals, row) for row in range(len(signals.channels)) if (signals, row) not in chosen]
        return chosen[:MOST_SHOWN]

    def channel_rows(self) -> list[dict[str, Any]]:
        """Channels with their levels, for the table."""
        shown = self.shown()
        rows = []
        for quantity in sorted(self.topics):
            signals = self.topics[quantity]
            for row, name in enumerate(signals.channels):
                levels = self._limits[quantity][row]
                rows.append(
                    {
                        "name": name,
                        "quantity": quantity.topic,
                        "unit": unit_text(signals.unit),
                        "point": signals.points[row] if row < len(signals.points) else 0,
                        "shown": next((n for n, item in enumerate(shown) if item == (signals, row)), -1),
                        "warning_peak": levels.warning_peak,
                        "abort_peak": levels.abort_peak,
                        "warning_rms": levels.warning_rms,
                        "abort_rms": levels.abort_rms,
                    }
                )
        return rows[:MOST_LISTED]

    def newest_stretch(self) -> int:
        """Number of the newest stretch of the strips."""
        return max((signals.strip.newest for signals in self.topics.values()), default=-1)

    def newest_sample(self) -> int:
        """Sample after the newest one."""
        return max((signals.recent.end_sample for signals in self.topics.values()), default=0)

    def facts(self) -> dict[str, Any]:
        """What stays as long as the channels do."""
        response = self.response
        first = self.topics[min(self.topics)].strip if self.topics else None
        return {
            "response_unit": unit_text(response.unit) if response else "",
            "channels": self.channel_rows(),
            "sample_rate": self.rate,
            "strip_seconds": first.length / self.rate if first else 0.0,
            "strip_stretches": first.stretches if first else 0,
        }

    def add_to(self, head: dict[str, Any], arrays: dict[str, Any], since: int, spectrum: bool) -> None:
        """Add what moves to a frame.

        Args:
            head, arrays: of the frame.
            since: number of the first stretch of the strips that is wanted.
            spectrum: whether spectrum and averaged response are wanted too.
        """
        ordered = [self.topics[quantity] for quantity in sorted(self.topics)]
        if ordered:
            for name in ("peak", "floor", "rms"):
                arrays[name] = np.concatenate([getattr(signals, name) for signals in ordered])[:MOST_LISTED]
        self._add_strips(head, arrays, since)
        self._add_waves(head, arrays)
        if spectrum:
            self._add_spectrum(head, arrays)
            self._add_response(arrays)

    def exciter_amplitudes(self) -> list[tuple[int, str, float, float]]:
        """Point, name of the voltage channel, and amplitudes of force (N) and voltage (V) of every exciter.

        Over the newest periods; empty where there is only one, point 0 and force NaN where not known.
        """
        force, voltage = self.topics.get(Quantity.FORCE), self.topics.get(Quantity.VOLTAGE)
        if force is None or voltage is None or len(voltage.channels) < 2:
            return []
        forces, voltages = (fundamental_amplitudes(*whole_periods(signals)) for signals in (force, voltage))
        rows = []
        for number, point in enumerate(self._exciter_points(force, len(voltage.channels))):
            row = force.points.index(point) if point in force.points else -1
            amplitude = float(forces[row]) if row >= 0 else math.nan
            rows.append((point, voltage.channels[number], amplitude, float(voltages[number])))
        return rows

    def _exciter_points(self, force: TopicSignals, count: int) -> list[int]:
        """Points of the exciters in the order of their voltages, by the rig file or else by the forces; 0 = unknown."""
        listed = self._rig.get("exciters")
        sections = listed if isinstance(listed, list) else []
        points = [section.get("point") if isinstance(section, Mapping) else None for section in sections]
        known = [point for point in points if isinstance(point, int)]
        if len(known) == len(points) == count:
            return known
        return list(force.points) if len(force.points) == count else [0] * count

    def _add_strips(self, head: dict[str, Any], arrays: dict[str, Any], since: int) -> None:
        shown = self.shown()
        head["strips"] = []
        for number, (signals, row) in enumerate(shown):
            first, low, high = signals.strip.since(since)
            head["strips"].append(first)
            arrays[f"low{number}"], arrays[f"high{number}"] = low[row], high[row]

    def _add_waves(self, head: dict[str, Any], arrays: dict[str, Any]) -> None:
        cut: dict[int, tuple[FloatArray, float]] = {}
        for number, (signals, row) in enumerate(self.shown()):
            if id(signals) not in cut:
                cut[id(signals)] = whole_periods(signals)
            arrays[f"wave{number}"] = min_max(cut[id(signals)][0][row], _WAVE_BUCKETS)
        force, response = self.topics.get(Quantity.FORCE), self.response
        head["periods"] = PERIODS
        head["wave_seconds"] = 0.1
        if force is None or response is None:
            return
        frequency = (cut.get(id(response)) or whole_periods(response))[1]
        if not math.isfinite(frequency):
            head["periods"] = 0
            return
        head["wave_seconds"] = PERIODS / frequency
        periods = cut[id(response)][0] if id(response) in cut else whole_periods(response)[0]
        arrays["shape_points"] = np.array(response.points, dtype=np.float64)
        arrays["shape"] = deflection(periods, response.points)
        forces, responses, frequency = paired_periods(force, response)
        if not math.isfinite(frequency):
            return
        stride = max(1, forces.shape[1] // _ORBIT_POINTS)
        moved = responses[self._row(response)]
        arrays["orbit_force"] = forces[self._row(force)][::stride]
        arrays["orbit_response"] = moved[::stride]
        arrays["orbit_velocity"] = velocity_of(moved, response.quantity, PERIODS, frequency)[::stride]

    def _add_spectrum(self, head: dict[str, Any], arrays: dict[str, Any]) -> None:
        status = self.status
        fundamental = status.frequency_hz if status is not None and status.frequency_hz > 0 else math.nan
        top = (HARMONICS + 1.5) * fundamental if math.isfinite(fundamental) else math.inf
        if self.is_broad_band and self.level is not None:
            top, fundamental = 1.2 * self.level.band_high_hz, math.nan
        shown = [("force", self.topics.get(Quantity.FORCE)), ("response", self.response)]
        data = {
            name: signals.recent.last(_SPECTRUM_SAMPLES)[self._row(signals)]
            for name, signals in shown
            if signals is not None
        }
        length = min(
            (part.size for part in data.values()), default=0
        )  # after a gap one topic may have more than another
        for name, part in data.items() if length >= _LEAST_SPECTRUM else ():
            frequency, amplitude = amplitude_spectrum(part[-length:], self.rate, min(top, 0.5 * self.rate))
            arrays[f"spectrum_{name}_f"], arrays[f"spectrum_{name}"] = frequency, amplitude
            arrays[f"harmonics_{name}"] = harmonic_amplitudes(frequency, amplitude, fundamental)
        head["fundamental"] = fundamental

    def _add_response(self, arrays: dict[str, Any]) -> None:
        level = self.level
        if self._frf is None or level is None:
            return
        frequency, magnitude, coherence = self._frf.estimate(level.band_low_hz, level.band_high_hz)
        stride = max(1, frequency.size // 1000)
        arrays["frf_f"], arrays["frf"], arrays["coherence"] = (
            frequency[::stride],
            magnitude[::stride],
            coherence[::stride],
        )
        arrays["averages"] = [self._frf.averages]
