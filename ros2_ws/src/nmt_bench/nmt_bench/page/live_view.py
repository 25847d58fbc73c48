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

from nmt_bench.page.channels import FLOOR_SHARE, LEAST
from nmt_bench.page.frames import write_frame
from nmt_bench.page.live_signals import LiveSignals
from nmt_bench.page.loop_track import LoopTrack
from nmt_core.errors import BenchError
from nmt_core.kinds import KINDS, KindOfTest, PhaseResonanceTest, kind_class
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.linear_description import LinearDescription
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
from nmt_extract.curves.response_curve import is_of_curve, response_curves
from nmt_extract.modal.mode_identity import mode_verdict
from nmt_report.columns import shown_columns, status_text, unit_text
from nmt_report.quantity_format import duration, engineering_exponent, plain, power_of_ten, significant
from nmt_report.run_verdict import run_verdict

_SILENT = 3.0  # s without a heartbeat
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
        self._linear: LinearDescription | None = None
        self._stop: DriveStop | None = None
        self._forget()

    def _forget(self) -> None:
        self._signals = LiveSignals(self._run, self._rig)
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
        self._began = math.nan
        self.version += 1

    # -- what comes in -------------------------------------------------------------------------------------------

    def begin(self, run: Mapping[str, Any], rig: Mapping[str, Any]) -> None:
        """Take the start record of a run: its description of itself and its rig file, parsed.

        Both may come from strangers; what is not as expected counts as missing.
        """
        with self._lock:
            self._run = run if isinstance(run, Mapping) else {}
            self._rig = rig if isinstance(rig, Mapping) else {}
            self._linear = _linear(self._run)
            plan = self._run.get("plan")
            levels = plan.get("levels") if isinstance(plan, Mapping) else None
            if isinstance(levels, list) and not any(act.taken for act in self._acts):
                self._plan = [float(item) for item in levels if isinstance(item, int | float)]
            self._signals.describe(self._run, self._rig)
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
                self.version += self._signals.take(record)
            elif isinstance(record, LoopStatus):
                self._take_status(record)
            elif isinstance(record, RunState):
                self._take_state(record)
            elif isinstance(record, LevelCommand):
                if record.amplitude > 0.0:
                    self._levels[record.index] = record
                    self._signals.begin_level(record)
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
            if isinstance(record, LevelCommand) and index < max(self._levels, default=-1) and index not in known:
                self._levels[index] = record  # an older level ends no average
                self.version += 1
            elif index not in known:
                self.take(record)

    def take_health(self, name: str, level: int, message: str, values: Mapping[str, str]) -> None:
        """Take a node's heartbeat: its level (0 good, 1 warning, 2 error), words and counters."""
        with self._lock:
            if len(self._health) < 50 or name in self._health:
                self._health[name] = (self._clock(), level, message[:300], dict(list(values.items())[:100]))

    def _take_status(self, status: LoopStatus) -> None:
        if self._status is not None and status.last_sample < self._status.last_sample:
            return
        if status.state == LoopState.LOCK_LOST and status.reason:
            self._lost[status.level_index] = status.reason
            self.version += 1
        if self._status is None or status.state != self._status.state:
            self.version += 1
        self._status = self._signals.status = status
        if self._signals.rate > 0.0:
            self._track.add(status, self._signals.rate)

    def _take_state(self, state: RunState) -> None:
        before = self._state
        if before is not None and state.run_id != before.run_id and before.run_id:
            self._forget()
            self._run, self._rig, self._linear = {}, {}, None
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
        response = self._signals.response
        quantity = response.quantity if response is not None else Quantity.UNKNOWN
        try:
            return ControlKind(control).level_unit(quantity)
        except ValueError:
            return ""

    def facts(self) -> bytes:
        """The frame of lasting content."""
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
            curves = response_curves(points) if is_of_curve(points) else ()
            held = all(curve.holds_force for curve in curves)
            for name, columns in (
                ("curve_f", [curve.frequency_hz for curve in curves]),
                ("curve_y", [curve.response if held else curve.force for curve in curves]),
                ("curve_stable", [curve.stable for curve in curves]),
                ("curve_number", [np.full(curve.lag.size, float(k)) for k, curve in enumerate(curves)]),
            ):
                arrays[name] = np.concatenate([*columns, np.empty(0)])
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
                    "gives_points": self._test.gives_modal_points,
                    "is_curve": self._test.is_curve,
                    "phase": self._state.phase.name.lower() if self._state else "idle",
                    "result": self._state.result_code.name if self._state and self._state.result_code else "",
                    "reason": self._state.reason if self._state else "",
                    "verdict": run_verdict(points, len(self._plan), self._linear) if points else None,
                    "modes": mode_verdict(points, self._linear) if self._linear is not None else "",
                    "stopped": self._stop_text(),
                    "stop_state": "" if self._stop is None else self._stop.cause.name.lower(),
                    "level_unit": unit_text(self._level_unit),
                    "curve_axis": "response at the drive point / m" if held else "force / N",
                    "plan": self._plan_rows(),
                    "point_levels": [point.level_index + 1 for point in good],
                    "table_head": head,
                    "table": rows,
                    "acts": [self._act_text(act) for act in self._acts[-50:]],
                    **self._signals.facts(),
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

    # -- many times a second -------------------------------------------------------------------------------------

    def newest_stretch(self) -> int:
        """Number of the newest stretch of the strips."""
        with self._lock:
            return self._signals.newest_stretch()

    def live(self, since: int, spectrum: bool = True) -> bytes:
        """The frame of changing content.

        Args:
            since: number of the first stretch of the strips that is wanted.
            spectrum: whether spectrum, averaged response and history of the loop are wanted too.
        """
        with self._lock:
            head: dict[str, Any] = {"kind": "live", "version": self.version, **self._numbers()}
            arrays: dict[str, Any] = {}
            self._signals.add_to(head, arrays, since, spectrum)
            if spectrum:
                arrays.update(self._track.arrays())
            return write_frame(head, arrays)

    def _numbers(self) -> dict[str, Any]:
        state, status = self._state, self._status
        now = self._clock()
        progress = state.progress if state else 0.0
        left = math.nan
        if state and state.phase in (RunPhase.RUNNING, RunPhase.PAUSED) and progress > 0.01:
            left = (now - self._began) * (1.0 - progress) / progress
        sample = self._signals.newest_sample()
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
        for signals in self._signals.topics.values():
            flags |= signals.flags
        return {
            "phase": state.phase.name.lower() if state else "idle",
            "level_index": state.level_index if state else -1,
            "level": self._with_unit(state.level if state else math.nan, unit_text(self._level_unit)),
            "progress": progress,
            "sample": sample,
            "bench_time": duration(sample / self._signals.rate) if self._signals.rate > 0 else "—",
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
            "gaps": self._signals.gaps,
            "nodes": nodes,
            "tripped": plant.get("tripped", ""),
            "warnings": plant.get("warnings", ""),
            "real_time": plant.get("real_time_margin", ""),
        }

    def _exciter_rows(self) -> list[dict[str, Any]]:
        """Amplitudes of force and voltage of every exciter over the newest periods; empty where there is only one."""
        return [
            {
                "name": f"Exciter {number}, point {point}" if point else f"Exciter {number}",
                "drive": self._told(f"drive {channel}", voltage, "V"),
                "force": self._told(f"force {number}", force, "N"),
            }
            for number, (point, channel, force, voltage) in enumerate(self._signals.exciter_amplitudes(), start=1)
        ]

    def _told(self, name: str, value: float, unit: str) -> str:
        """An amplitude with its unit; below the size of rounding only that."""
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


def _linear(run: Mapping[str, Any]) -> LinearDescription | None:
    """Linear modes that a run names; None where it names none that can be used."""
    described = run.get("linear")
    try:
        return LinearDescription.from_mapping(dict(described)) if isinstance(described, Mapping) else None
    except BenchError:
        return None


_HELD = "The drive is at zero and stays there until it is released"
_OUTPUT_WORDS = {
    OutputState.NOT_KNOWN: "Nobody can tell what the output does: use the switch at the amplifier",
    OutputState.AT_ZERO: _HELD,
    OutputState.HELD: _HELD,
    OutputState.ENDED: _HELD,
}
