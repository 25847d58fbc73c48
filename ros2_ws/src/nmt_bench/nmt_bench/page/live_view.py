"""What the page shows of a test: messages of the bench in, frames for the browser out; free of ROS and of the network.

Two kinds of frame: ``facts`` whenever something happened that stays (levels, points, acts), ``live`` many times a
second (numbers, the newest stretches of the strips, waveforms, orbit, spectrum). Texts have the units and digits of the
report.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from nmt_bench.page.channels import FLOOR_SHARE, LEAST, Levels, TopicSignals, channel_levels
from nmt_bench.page.decimation import min_max
from nmt_bench.page.frames import write_frame
from nmt_bench.page.loop_track import LoopTrack
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
from nmt_core.kinds import KINDS, KindOfTest, PhaseResonanceTest, kind_class
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import DriveStop, LevelCommand, LockEvent, LoopStatus, RunState, Steering
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import (
    BlockFlag,
    ControlKind,
    LoopState,
    OutputState,
    PointStatus,
    Quantity,
    RunPhase,
    SteeringAct,
    StopCause,
)
from nmt_report.columns import shown_columns, status_text, unit_text
from nmt_report.quantity_format import duration, engineering_exponent, plain, power_of_ten, significant
from nmt_report.run_verdict import run_verdict
from nmt_signals.frequency_responses import RunningFrf

MOST_SHOWN = 8
MOST_LISTED = 400
_WAVE_BUCKETS = 200
_ORBIT_POINTS = 400
_SPECTRUM_SAMPLES, _LEAST_SPECTRUM = 8192, 256
_FRF_SECONDS = 1.0
_SILENT = 3.0  # s without a heartbeat
_RESPONSES = (Quantity.ACCELERATION, Quantity.DISPLACEMENT, Quantity.VELOCITY)
_LOOP_WORDS = {
    LoopState.UNKNOWN: "no state",
    LoopState.FIXED: "not controlled",
    LoopState.ACQUIRING: "acquiring",
    LoopState.LOCKED: "locked",
    LoopState.LOCK_LOST: "lock lost",
}
_ACT_WORDS = {
    SteeringAct.UNKNOWN: "unknown act",
    SteeringAct.PAUSE: "paused",
    SteeringAct.RESUME: "resumed",
    SteeringAct.SKIP_LEVEL: "level {level} skipped",
    SteeringAct.REPEAT_LEVEL: "level {level} to be repeated",
    SteeringAct.CHANGE_LEVELS: "levels to come changed",
    SteeringAct.END: "end with a ramp",
}


class LiveView:
    """Gathers what the page shows; safe to be fed in one thread and read in another.

    Args:
        replay: the messages come from a bag.
        clock: s, monotonic.
    """

    FRAME_PERIOD = 0.05
    PAGE = "index.html"

    def __init__(self, replay: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._replay = replay
        self._lock = threading.RLock()
        self.version = 0
        """Counts what has changed in the facts."""
        self._reference: Sequence[FloatArray] = ()
        self._health: dict[str, tuple[float, int, str, dict[str, str]]] = {}
        self._run: Mapping[str, Any] = {}
        self._rig: Mapping[str, Any] = {}
        self._stop: DriveStop | None = None
        self._forget()

    def _forget(self) -> None:
        self._topics: dict[Quantity, TopicSignals] = {}
        self._limits: dict[Quantity, list[Levels]] = {}
        self._plan: list[float] = []
        self._levels: dict[int, LevelCommand] = {}
        self._locks: dict[int, LockEvent] = {}
        self._points: dict[int, ModalPoint] = {}
        self._lost: dict[int, str] = {}
        self._acts: list[Steering] = []
        self._state: RunState | None = None
        self._status: LoopStatus | None = None
        self._track = LoopTrack()
        self._largest: dict[str, float] = {}
        self._frf: RunningFrf | None = None
        self._began = math.nan
        self._rate = math.nan
        self._gaps = 0
        self.version += 1

    # -- what comes in -------------------------------------------------------------------------------------------

    def begin(self, run: Mapping[str, Any], rig: Mapping[str, Any]) -> None:
        """Take the start record of a run: its description of itself and its rig file, parsed.

        Both may come from strangers; what is not as expected counts as missing.
        """
        with self._lock:
            self._run = run if isinstance(run, Mapping) else {}
            self._rig = rig if isinstance(rig, Mapping) else {}
            plan = self._run.get("plan")
            levels = plan.get("levels") if isinstance(plan, Mapping) else None
            if isinstance(levels, list) and not any(act.taken for act in self._acts):
                self._plan = [float(item) for item in levels if isinstance(item, int | float)]
            for quantity, signals in self._topics.items():
                self._limits[quantity] = self._levels_of(signals)
            self.version += 1

    def set_reference(self, modal_amplitude: FloatArray, frequency_hz: FloatArray, damping_ratio: FloatArray) -> None:
        """Take the backbone of the model: m√kg, Hz, 1."""
        with self._lock:
            self._reference = (modal_amplitude, frequency_hz, damping_ratio)
            self.version += 1

    def take(self, record: Any) -> None:
        """Take a message of the bench as its record; others are passed over."""
        with self._lock:
            if isinstance(record, SampleBlock):
                self._take_block(record)
            elif isinstance(record, LoopStatus):
                self._take_status(record)
            elif isinstance(record, RunState):
                self._take_state(record)
            elif isinstance(record, LevelCommand):
                if record.amplitude > 0.0:
                    self._levels[record.index] = record
                    self._frf = None
                    self.version += 1
            elif isinstance(record, LockEvent):
                self._locks[record.level_index] = record
                self.version += 1
            elif isinstance(record, ModalPoint):
                self._points[record.level_index] = record
                self.version += 1
            elif isinstance(record, Steering):
                self._acts.append(record)
                if record.taken:
                    self._plan = list(record.levels)
                self.version += 1
            elif isinstance(record, DriveStop):
                self._stop = record  # latched: neither the end of the run nor another run releases the drive
                self.version += 1

    def take_missed(self, record: Any) -> None:
        """Take a message from before the page was there, unless what it tells is known better."""
        with self._lock:
            if isinstance(record, Steering):
                if all(record.sequence != act.sequence for act in self._acts):
                    self._acts = sorted([*self._acts, record], key=lambda act: act.sequence)
                    if record is self._acts[-1] and record.taken:
                        self._plan = list(record.levels)
                    self.version += 1
                return
            if isinstance(record, DriveStop):
                return  # latched
            index = record.index if isinstance(record, LevelCommand) else record.level_index
            stores: dict[type, dict[int, Any]] = {
                LevelCommand: self._levels,
                LockEvent: self._locks,
                ModalPoint: self._points,
            }
            known = stores[type(record)]
            if index not in known:
                newest = max(self._levels, default=-1)
                frf = self._frf
                self.take(record)
                if isinstance(record, LevelCommand) and index < newest:
                    self._frf = frf  # an older level ends no average

    def take_health(self, name: str, level: int, message: str, values: Mapping[str, str]) -> None:
        """Take a node's heartbeat: its level (0 good, 1 warning, 2 error), words and counters."""
        with self._lock:
            if len(self._health) < 50 or name in self._health:
                self._health[name] = (self._clock(), level, message[:300], dict(list(values.items())[:100]))

    def _take_block(self, block: SampleBlock) -> None:
        signals = self._topics.get(block.quantity)
        if signals is None or not signals.fits(block):
            if not block.samples or block.quantity is Quantity.UNKNOWN:
                return
            signals = self._topics[block.quantity] = TopicSignals(block)
            self._limits[block.quantity] = self._levels_of(signals)
            self._rate = block.sample_rate
            self.version += 1
        elif block.first_sample > signals.recent.end_sample:
            self._gaps += 1
        signals.add(block)
        if block.quantity in _RESPONSES and self._test.is_noise:
            self._average(signals)

    def _average(self, response: TopicSignals) -> None:
        """Average force and response while a random window is open; both must have come up to the same sample."""
        force = self._topics.get(Quantity.FORCE)
        status = self._status
        if force is None or response is not self._response or status is None or status.state != LoopState.LOCKED:
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

    def _take_status(self, status: LoopStatus) -> None:
        if self._status is not None and status.last_sample < self._status.last_sample:
            return
        if status.state == LoopState.LOCK_LOST and status.reason:
            self._lost[status.level_index] = status.reason
            self.version += 1
        if self._status is None or status.state != self._status.state:
            self.version += 1
        self._status = status
        if self._rate > 0.0:
            self._track.add(status, self._rate)

    def _take_state(self, state: RunState) -> None:
        before = self._state
        if before is not None and state.run_id != before.run_id and before.run_id:
            self._forget()
            self._run, self._rig = {}, {}
            before = None
        self._state = state
        if state.phase == RunPhase.RUNNING and math.isnan(self._began):
            self._began = self._clock()
        key = (state.phase, state.level_index, state.level_count, state.result_code, state.reason)
        if before is None or key != (
            before.phase, before.level_index, before.level_count, before.result_code, before.reason,
        ):  # fmt: skip
            self.version += 1

    def seek(self) -> None:
        """Forget the signals and what came after a moment: a replay starts over at another place."""
        with self._lock:
            run, rig, reference = self._run, self._rig, self._reference
            self._forget()
            self._reference, self._stop = reference, None
            self.begin(run, rig)

    # -- facts ---------------------------------------------------------------------------------------------------

    @property
    def run_id(self) -> str:
        """Name of the run; empty before the first state."""
        with self._lock:
            return self._state.run_id if self._state else str(self._run.get("run_id", ""))

    @property
    def run_plan(self) -> Mapping[str, Any]:
        """Plan of the newest run as its bag describes it; empty if none is known."""
        with self._lock:
            plan = self._run.get("plan")
            return dict(plan) if isinstance(plan, Mapping) else {}

    @property
    def active(self) -> bool:
        """Whether a run is under way."""
        with self._lock:
            return self._state is not None and self._state.phase in (
                RunPhase.RUNNING,
                RunPhase.PAUSED,
                RunPhase.STOPPING,
            )

    @property
    def _test(self) -> type[KindOfTest]:
        if self._levels:
            return kind_class(self._levels[max(self._levels)].test)
        plan = self._run.get("plan")
        name = plan.get("test") if isinstance(plan, Mapping) else None
        return next((kind for kind in KINDS.values() if kind.label() == name), PhaseResonanceTest)

    @property
    def _level_unit(self) -> str:
        for lock in self._locks.values():
            return lock.level_unit
        control = self._levels[max(self._levels)].control if self._levels else ControlKind.VOLTAGE
        response = self._response
        quantity = response.quantity if response is not None else Quantity.UNKNOWN
        try:
            return ControlKind(control).level_unit(quantity)
        except ValueError:
            return ""

    @property
    def _response(self) -> TopicSignals | None:
        """Topic of the response that the loop controls, or the first there is."""
        wanted = self._status.response_unit if self._status is not None else ""
        present = [self._topics[quantity] for quantity in _RESPONSES if quantity in self._topics]
        return next((signals for signals in present if signals.unit == wanted), present[0] if present else None)

    @property
    def _drive_point(self) -> int:
        point = self._run.get("exciter_point")
        if isinstance(point, int):
            return point
        force = self._topics.get(Quantity.FORCE)
        return force.points[0] if force is not None and force.points else 0

    def _row(self, signals: TopicSignals) -> int:
        point = self._drive_point
        return signals.points.index(point) if point in signals.points else 0

    def _levels_of(self, signals: TopicSignals) -> list[Levels]:
        limits = self._rig.get("limits")
        section = limits if isinstance(limits, Mapping) else {}
        return [channel_levels(section, signals.quantity, name) for name in signals.channels]

    def _shown(self) -> list[tuple[TopicSignals, int]]:
        """Channels whose signals are drawn: force, drive-point response, voltage, then the others in their order.

        Forces and voltages of further exciters come before the other responses.
        """
        first = [self._topics.get(Quantity.FORCE), self._response, self._topics.get(Quantity.VOLTAGE)]
        chosen = [(signals, self._row(signals)) for signals in first if signals is not None]
        if first[2] is not None and len(first[2].channels) > 1:
            for signals in (first[0], first[2]):
                if signals is not None:
                    chosen += [(signals, row) for row in range(len(signals.channels)) if (signals, row) not in chosen]
        for quantity in Quantity:
            signals = self._topics.get(quantity)
            if signals is not None:
                chosen += [(signals, row) for row in range(len(signals.channels)) if (signals, row) not in chosen]
        return chosen[:MOST_SHOWN]

    def facts(self) -> bytes:
        """The frame of what stays."""
        with self._lock:
            points = [self._points[index] for index in sorted(self._points)]
            arrays = dict(zip(("reference_q", "reference_f", "reference_d"), self._reference, strict=False))
            good = [point for point in points if point.status is PointStatus.OK]
            for name, values in (
                ("point_q", [point.modal_amplitude for point in good]),
                ("point_f", [point.omega_rad_s / (2.0 * math.pi) for point in good]),
                ("point_d", [100.0 * point.damping_ratio for point in good]),
                ("point_q_std", [point.modal_amplitude_std for point in good]),
                ("point_f_std", [point.omega_rad_s_std / (2.0 * math.pi) for point in good]),
                ("point_d_std", [100.0 * point.damping_ratio_std for point in good]),
            ):
                arrays[name] = np.array(values, dtype=np.float64)
            if "reference_d" in arrays:
                arrays["reference_d"] = 100.0 * arrays["reference_d"]
            head, rows = self._table(points)
            return write_frame(
                {
                    "kind": "facts",
                    "version": self.version,
                    "replay": self._replay,
                    "run": self.run_id,
                    "rig": str(self._run.get("rig", "")),
                    "test": self._test.label(),
                    "phase": self._state.phase.name.lower() if self._state else "idle",
                    "result": self._state.result_code.name if self._state and self._state.result_code else "",
                    "reason": self._state.reason if self._state else "",
                    "verdict": run_verdict(points, len(self._plan)) if points else None,
                    "stopped": self._stop_text(),
                    "stop_state": "" if self._stop is None else self._stop.cause.name.lower(),
                    "response_unit": unit_text(self._response.unit) if self._response else "",
                    "level_unit": unit_text(self._level_unit),
                    "plan": self._plan_rows(),
                    "point_levels": [point.level_index + 1 for point in good],
                    "table_head": head,
                    "table": rows,
                    "acts": [self._act_text(act) for act in self._acts[-50:]],
                    "channels": self._channel_rows(),
                    "sample_rate": self._rate,
                    "strip_seconds": self._topics[min(self._topics)].strip.length / self._rate if self._topics else 0.0,
                    "strip_stretches": self._topics[min(self._topics)].strip.stretches if self._topics else 0,
                },
                arrays,
            )

    def _stop_text(self) -> str:
        """Why the drive is held at zero, and what its output does; empty if it is not held."""
        stop = self._stop
        if stop is None or stop.cause is StopCause.RELEASED:
            return ""
        reason = stop.reason.rstrip(".") or stop.cause.name.lower().replace("_", " ")
        what = _OUTPUT_WORDS.get(stop.output, "The drive goes to zero and stays there until it is released")
        return f"{reason[0].upper()}{reason[1:]}. {what}."

    def _plan_rows(self) -> list[dict[str, Any]]:
        state = self._state
        present = state.level_index if state is not None and state.run_id else -1
        amplitudes = {index: level.amplitude for index, level in self._levels.items()}
        count = max([len(self._plan), *(index + 1 for index in amplitudes)], default=0)
        rows = []
        for index in range(count):
            amplitude = amplitudes.get(index, self._plan[index] if index < len(self._plan) else math.nan)
            what, why = self._outcome(index, present)
            rows.append({"index": index, "value": amplitude, "text": significant(amplitude), "state": what, "why": why})
        return rows

    def _outcome(self, index: int, present: int) -> tuple[str, str]:
        """What has become of a level: waiting, present, done, rejected, not locked or skipped, and why."""
        point = self._points.get(index)
        if point is not None and point.status is PointStatus.OK:
            return "done", point.reason
        for act in reversed(self._acts):
            given_up = act.act in (SteeringAct.SKIP_LEVEL, SteeringAct.REPEAT_LEVEL)
            if act.taken and given_up and act.level_index == index < present:
                return "skipped", f"{_ACT_WORDS[act.act].format(level=index + 1)} by {act.source}"
        if point is not None:
            return status_text(point.status), point.reason
        if index in self._lost:
            return "not locked", self._lost[index]
        ended = self._state is not None and self._state.phase == RunPhase.DONE
        if index > present or (index == present and ended and index not in self._locks):
            return "waiting", ""
        if index == present and not ended:
            return "present", ""
        return "done", ""

    def _table(self, points: Sequence[ModalPoint]) -> tuple[list[str], list[dict[str, Any]]]:
        """Modal properties as in the report: heads and rows."""
        good = [point for point in points if point.status is PointStatus.OK]
        columns = [column for column in shown_columns(good) if column.shown.live]
        exponents = {column.name: column.exponent(good) for column in columns}
        head = [f"level / {unit_text(self._level_unit) or 'V'}"] + [
            " / ".join(filter(None, (column.shown.symbol, column.unit(exponents[column.name])))) for column in columns
        ]
        rows = []
        for point in points:
            cells = [significant(point.level)]
            if point.status is PointStatus.OK:
                cells += [column.cell(point, exponents[column.name]) for column in columns]
            reason = "" if point.status is PointStatus.OK else f"{status_text(point.status)}: {point.reason}"
            rows.append({"index": point.level_index, "cells": cells, "reason": reason})
        return head, rows

    def _act_text(self, act: Steering) -> str:
        words = _ACT_WORDS[act.act].format(level=act.level_index + 1)
        when = duration(act.time_ns / 1e9)
        refused = f"; not taken: {act.reason}" if not act.taken else ""
        return f"{when}, sample {act.apply_at_sample}: {words} by {act.source}{refused}"

    def _channel_rows(self) -> list[dict[str, Any]]:
        shown = self._shown()
        rows = []
        for quantity in sorted(self._topics):
            signals = self._topics[quantity]
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

    # -- many times a second -------------------------------------------------------------------------------------

    def newest_stretch(self) -> int:
        """Number of the newest stretch of the strips."""
        with self._lock:
            return max((signals.strip.newest for signals in self._topics.values()), default=-1)

    def live(self, since: int, spectrum: bool = True) -> bytes:
        """The frame of what moves.

        Args:
            since: number of the first stretch of the strips that is wanted.
            spectrum: whether spectrum, averaged response and history of the loop are wanted too.
        """
        with self._lock:
            head: dict[str, Any] = {"kind": "live", "version": self.version, **self._numbers()}
            arrays: dict[str, Any] = {}
            quantities = sorted(self._topics)
            if quantities:
                arrays["peak"] = np.concatenate([self._topics[quantity].peak for quantity in quantities])[:MOST_LISTED]
                arrays["floor"] = np.concatenate([self._topics[quantity].floor for quantity in quantities])[
                    :MOST_LISTED
                ]
                arrays["rms"] = np.concatenate([self._topics[quantity].rms for quantity in quantities])[:MOST_LISTED]
            self._add_strips(head, arrays, since)
            self._add_waves(head, arrays)
            if spectrum:
                self._add_spectrum(head, arrays)
                self._add_response(arrays)
                arrays.update(self._track.arrays())
            return write_frame(head, arrays)

    def _numbers(self) -> dict[str, Any]:
        state, status = self._state, self._status
        now = self._clock()
        progress = state.progress if state else 0.0
        left = math.nan
        if state and state.phase in (RunPhase.RUNNING, RunPhase.PAUSED) and progress > 0.01:
            left = (now - self._began) * (1.0 - progress) / progress
        drive = status.drive_amplitude if status else math.nan
        limit = self._drive_limit
        nodes = []
        for name in sorted(self._health):
            seen, level, message, _ = self._health[name]
            silent = now - seen > _SILENT and not self._replay
            nodes.append(
                {
                    "name": name,
                    "level": 2 if silent else level,
                    "text": f"silent for {duration(now - seen)}" if silent else message,
                }
            )
        plant = next((values for name, (*_, values) in self._health.items() if name.split("/")[-1] == "plant"), {})
        flags = 0
        for signals in self._topics.values():
            flags |= signals.flags
        return {
            "phase": state.phase.name.lower() if state else "idle",
            "level_index": state.level_index if state else -1,
            "level": self._with_unit(state.level if state else math.nan, unit_text(self._level_unit)),
            "progress": progress,
            "sample": self._newest_sample(),
            "bench_time": duration(self._newest_sample() / self._rate) if self._rate > 0 else "—",
            "left": f"{duration(left)}" if math.isfinite(left) else "—",
            "loop": LoopState(status.state).name.lower() if status else "unknown",
            "loop_text": _LOOP_WORDS[LoopState(status.state)] if status else "no state",
            "frequency": self._with_unit(
                status.frequency_hz if status and status.frequency_hz > 0 else math.nan, "Hz", 4
            ),
            "phase_error": self._with_unit(math.degrees(status.phase_error) if status else math.nan, "°", 2),
            "phase_error_deg": math.degrees(status.phase_error) if status else math.nan,
            "drive": self._told("drive", drive, "V"),
            "drive_share": drive / limit if limit > 0 else math.nan,
            "drive_limit": self._with_unit(limit, "V"),
            "force": self._told("force", status.force_amplitude if status else math.nan, "N"),
            "response": self._told(
                "response",
                status.response_amplitude if status else math.nan,
                unit_text(status.response_unit) if status else "",
            ),
            "exciters": self._exciter_rows(),
            "flags": [flag.name.lower().replace("_", " ") for flag in BlockFlag if flag and flags & flag and flag.name],
            "gaps": self._gaps,
            "nodes": nodes,
            "tripped": plant.get("tripped", ""),
            "warnings": plant.get("warnings", ""),
            "real_time": plant.get("real_time_margin", ""),
        }

    def _exciter_rows(self) -> list[dict[str, Any]]:
        """Amplitudes of force and voltage of every exciter over the newest periods; empty where there is only one."""
        force, voltage = self._topics.get(Quantity.FORCE), self._topics.get(Quantity.VOLTAGE)
        if force is None or voltage is None or len(voltage.channels) < 2:
            return []
        forces, voltages = (fundamental_amplitudes(*whole_periods(signals)) for signals in (force, voltage))
        points = self._exciter_points(force, len(voltage.channels))
        rows = []
        for number, point in enumerate(points):
            row = force.points.index(point) if point in force.points else -1
            channel = voltage.channels[number]
            rows.append(
                {
                    "name": f"Exciter {number + 1}, point {point}" if point else f"Exciter {number + 1}",
                    "drive": self._told(f"drive {channel}", voltages[number], "V"),
                    "force": self._told(f"force {number}", forces[row] if row >= 0 else math.nan, "N"),
                }
            )
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

    def _told(self, name: str, value: float, unit: str) -> str:
        """An amplitude with its unit; below what is told from rounding only that."""
        if math.isfinite(value):
            self._largest[name] = max(self._largest.get(name, 0.0), abs(value))
        floor = max(FLOOR_SHARE * self._largest.get(name, 0.0), LEAST)
        if 0.0 < abs(value) < floor:
            return f"below {self._with_unit(float(f'{floor:.1g}'), unit)}"
        return self._with_unit(value, unit)

    @staticmethod
    def _with_unit(value: float, unit: str, decimals: int | None = None) -> str:
        if decimals is not None:
            text = plain(value, decimals)
        elif abs(value) < LEAST:
            text = "0"
        elif not 1e-3 <= abs(value) < 1e5 and math.isfinite(value):
            exponent = engineering_exponent([value])
            text = f"{significant(value / 10.0**exponent)}·{power_of_ten(exponent)}"
        else:
            text = significant(value)
        return f"{text}\u202f{unit}" if unit and text != "—" else text

    @property
    def _drive_limit(self) -> float:
        limits = self._rig.get("limits")
        section = limits if isinstance(limits, Mapping) else {}
        for key in ("drive_maximum_v", "voltage_v"):
            value = section.get(key)
            if isinstance(value, int | float) and value > 0:
                return float(value)
        return math.nan

    def _newest_sample(self) -> int:
        return max((signals.recent.end_sample for signals in self._topics.values()), default=0)

    def _add_strips(self, head: dict[str, Any], arrays: dict[str, Any], since: int) -> None:
        shown = self._shown()
        head["strips"] = []
        for number, (signals, row) in enumerate(shown):
            first, low, high = signals.strip.since(since)
            head["strips"].append(first)
            arrays[f"low{number}"], arrays[f"high{number}"] = low[row], high[row]

    def _add_waves(self, head: dict[str, Any], arrays: dict[str, Any]) -> None:
        cut: dict[int, tuple[FloatArray, float]] = {}
        for number, (signals, row) in enumerate(self._shown()):
            if id(signals) not in cut:
                cut[id(signals)] = whole_periods(signals)
            arrays[f"wave{number}"] = min_max(cut[id(signals)][0][row], _WAVE_BUCKETS)
        force, response = self._topics.get(Quantity.FORCE), self._response
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
        status = self._status
        fundamental = status.frequency_hz if status is not None and status.frequency_hz > 0 else math.nan
        top = (HARMONICS + 1.5) * fundamental if math.isfinite(fundamental) else math.inf
        if self._test.is_noise and self._levels:
            top, fundamental = 1.2 * self._levels[max(self._levels)].band_high_hz, math.nan
        shown = [("force", self._topics.get(Quantity.FORCE)), ("response", self._response)]
        data = {
            name: signals.recent.last(_SPECTRUM_SAMPLES)[self._row(signals)]
            for name, signals in shown
            if signals is not None
        }
        length = min(
            (part.size for part in data.values()), default=0
        )  # after a gap one topic may have more than another
        for name, part in data.items() if length >= _LEAST_SPECTRUM else ():
            frequency, amplitude = amplitude_spectrum(part[-length:], self._rate, min(top, 0.5 * self._rate))
            arrays[f"spectrum_{name}_f"], arrays[f"spectrum_{name}"] = frequency, amplitude
            arrays[f"harmonics_{name}"] = harmonic_amplitudes(frequency, amplitude, fundamental)
        head["fundamental"] = fundamental

    def _add_response(self, arrays: dict[str, Any]) -> None:
        level = self._levels[max(self._levels)] if self._levels else None
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


_HELD = "The drive is at zero and stays there until it is released"
_OUTPUT_WORDS = {
    OutputState.NOT_KNOWN: "Nobody can tell what the output does: use the switch at the amplifier",
    OutputState.AT_ZERO: _HELD,
    OutputState.HELD: _HELD,
    OutputState.ENDED: _HELD,
}
