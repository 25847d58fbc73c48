"""From a rig and what is asked of it to a test plan, the same for nodes and for a session in one process."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.linear_description import LinearDescription
from nmt_core.vocabulary import TestKind
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_snapshot import rig_text
from nmt_sequencer.level_plan import parse_levels
from nmt_session.node_plan import TestPlan


def plan_test(
    rig: str | Path | Rig,
    levels: Sequence[float] | str | None = None,
    *,
    overrides: Sequence[str] = (),
    exciter: int | None = None,
    seed: int | None = None,
    pacing: str = "lockstep",
    latency_blocks: int = 0,
    window_periods: int | None = None,
    ramp: float | None = None,
    timeout: float | None = None,
    stop_on_lost_lock: bool = False,
    run_id: str | None = None,
    linear: LinearDescription | None = None,
    node_values: Mapping[str, Mapping[str, Any]] | None = None,
    control: str = "voltage",
    strategy: str = "stepped",
    test: str = "phase_resonance",
    frequencies_hz: Sequence[float] = (),
    band_hz: tuple[float, float] | None = None,
    rate_hz_s: float = 0.0,
    frequency_end_hz: float = 0.0,
    duration: float = 0.0,
    device: str = "",
    device_address: str = "",
) -> TestPlan:
    """A test of a rig.

    Args:
        rig: name of a rig that comes with the bench, path of a rig file, or a loaded rig.
        levels: drive amplitudes in V, the notation of ``--levels``, or None for the rig's own.
        overrides: ``key=value`` texts applied to the rig file.
        exciter: drive point; None = the rig's own.
        seed: seed of all noise; None = the rig's own.
        pacing: ``lockstep`` or ``realtime``.
        latency_blocks: blocks of buffering between command and excitation.
        window_periods, ramp, timeout: None = the rig's own; periods, s, s.
        stop_on_lost_lock: end at the first level that does not lock.
        run_id: name of the run; None = from the clock.
        linear: linear description for loop and extraction; None = from the rig's model.
        node_values: further parameters by node name.
        control: what the levels are: ``voltage`` (V), ``response`` (m or m/s²) or ``force`` (N).
        strategy: ``stepped`` or ``ramp``, see :class:`nmt_session.node_plan.TestPlan`.
        test, frequencies_hz, band_hz, rate_hz_s, frequency_end_hz, duration: kind of test and its settings, see there.
            A stepped sine with several frequencies and one level is run at that level at each of them.
        device, device_address: what is driven, see there.

    Raises:
        BenchError: the rig, the levels or a setting is refused.
    """
    changes = list(overrides)
    if exciter is not None:
        changes.append(f"exciter.point={exciter}")
    if seed is not None:
        changes.append(f"seed={seed}")
    if isinstance(rig, Rig):
        if changes:
            raise BenchError("Overrides need a rig by name or path; this one is loaded already.")
        loaded, text = rig, rig_text(rig)
    else:
        loaded = load_rig(str(rig), changes)
        text = rig_text(loaded, rig, changes)
    if levels is None and control != "voltage":
        raise BenchError(f"Levels of {control} are needed: those of rig {loaded.name} are voltages; give --levels.")
    kind = TestKind.named(test)
    if levels is None and not kind.closes_phase_loop:
        label = kind.label.replace("_", " ")
        raise BenchError(f"A {label} test needs levels: those of rig {loaded.name} are for phase resonance.")
    plan = loaded.test.levels if levels is None else levels
    amplitudes = tuple(parse_levels(plan) if isinstance(plan, str) else plan)
    if kind is TestKind.STEPPED_SINE and len(amplitudes) == 1:
        amplitudes *= max(1, len(frequencies_hz))
    return TestPlan(
        rig=loaded,
        rig_yaml=text,
        levels=amplitudes,
        run_id=run_id or time.strftime(f"{loaded.name}-%Y%m%d-%H%M%S"),
        pacing=pacing,
        latency_blocks=latency_blocks,
        window_periods=window_periods,
        ramp=ramp,
        timeout=timeout,
        stop_on_lost_lock=stop_on_lost_lock,
        linear=linear,
        node_values=node_values or {},
        control=control,
        strategy=strategy,
        test=test,
        frequencies_hz=tuple(frequencies_hz),
        band_hz=band_hz,
        rate_hz_s=rate_hz_s,
        frequency_end_hz=frequency_end_hz,
        duration=duration,
        device=device,
        device_address=device_address,
    )
