"""From a rig and what is asked of it to a test plan, the same for nodes and for a session in one process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Unpack

import yaml

from nmt_core.errors import BenchError
from nmt_core.vocabulary import TestKind
from nmt_pll.loop_settings import LoopSettings
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_snapshot import rig_text
from nmt_sequencer.level_plan import parse_levels
from nmt_session.block_length import LevelTime, choose_block
from nmt_session.node_plan import PlanSettings, TestPlan


class TestSettings(PlanSettings, total=False):
    """Keyword arguments of :func:`plan_test`."""

    overrides: Sequence[str]
    exciter: int | None
    seed: int | None
    compare: int


def plan_test(
    rig: str | Path | Rig,
    levels: Sequence[float] | str | None = None,
    *,
    overrides: Sequence[str] = (),
    exciter: int | None = None,
    seed: int | None = None,
    compare: int = 0,
    **settings: Unpack[PlanSettings],
) -> TestPlan:
    """A test of a rig.

    Where the rig does not say how long a block is, a phase resonance test of a simulated rig in lockstep gets blocks of
    a length chosen for it, see :mod:`nmt_session.block_length`.

    Args:
        rig: name of a rig that comes with the bench, path of a rig file, or a loaded rig.
        levels: amplitudes, the notation of ``--levels``, or None for the rig's own. A stepped sine with several
            frequencies and one level is run at that level at each of them.
        overrides: ``key=value`` texts applied to the rig file.
        exciter: drive point; None = the rig's own.
        seed: seed of all noise; None = the rig's own.
        compare: with control of the force's harmonics, every so manyth level is run without it first; 0 = none.
        settings: fields of :class:`nmt_session.node_plan.TestPlan`.

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
    kind = TestKind.named(settings.get("test", "phase_resonance"))
    if kind is TestKind.SELF_EXCITED:
        settings.setdefault("control", "response")
        levels = loaded.test.response_levels or None if levels is None else levels
    control = settings.get("control", "voltage")
    if levels is None and control != "voltage":
        raise BenchError(f"Levels of {control} are needed: those of rig {loaded.name} are voltages; give --levels.")
    if levels is None and (not kind.closes_phase_loop or kind is TestKind.SECONDARY_RESONANCE):
        label = kind.label.replace("_", " ")
        raise BenchError(f"A {label} test needs levels: those of rig {loaded.name} are for phase resonance.")
    plan = loaded.test.levels if levels is None else levels
    amplitudes = tuple(parse_levels(plan) if isinstance(plan, str) else plan)
    if kind is TestKind.STEPPED_SINE and len(amplitudes) == 1:
        amplitudes *= max(1, len(settings.get("frequencies_hz", ())))
    if compare:
        amplitudes, without = _with_comparison(amplitudes, compare)
        settings["levels_without"] = without
    planned = TestPlan(loaded, text, amplitudes, **settings)
    if compare and not planned.controlled_harmonics:
        raise BenchError("A comparison needs control of the force's harmonics: give --harmonics-control.")
    if compare and len(planned.frequencies_hz) > 1:
        raise BenchError("A comparison takes one frequency for all levels; leave out --compare.")
    return _with_chosen_block(planned) if _leaves_block_open(planned) else planned


def _with_comparison(levels: Sequence[float], every: int) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """Levels with every so manyth once more before itself, and the indices of those.

    Raises:
        BenchError: the number is negative.
    """
    if every < 0:
        raise BenchError(f"A comparison at every {every}th level is not possible; give 1 or more.")
    expanded: list[float] = []
    without: list[int] = []
    for place, level in enumerate(levels):
        if place % every == 0:
            without.append(len(expanded))
            expanded.append(level)
        expanded.append(level)
    return tuple(expanded), tuple(without)


def _leaves_block_open(plan: TestPlan) -> bool:
    """Whether nobody has said how long a block is, and nothing but wall time depends on it.

    Blocks of hardware and of real time wait at its output; those of a latency are what the user has counted.
    """
    kind = TestKind.named(plan.test)
    values = _loop_values(plan)
    return (
        "block_samples" not in plan.rig.model_fields_set
        and plan.pacing == "lockstep"
        and not plan.is_on_hardware
        and plan.lead_blocks == 0
        and kind.closes_phase_loop
        and not plan.is_self_excited
        and plan.strategy == "stepped"
        and values.get("loop", "adaptive") == "adaptive"
        and not values.get("proportional")
        and not any("block_samples" in items or "tick_blocks" in items for items in plan.node_values.values())
    )


def _loop_values(plan: TestPlan) -> dict[str, Any]:
    """Settings of the loop that the rig and the test give."""
    return {**plan.rig.pll, **plan.node_values.get("pll", {})}


def _with_chosen_block(plan: TestPlan) -> TestPlan:
    """The plan with the block length that suits its mode and its loop, in the rig and in its text."""
    linear = plan.used_linear
    assert linear is not None  # every test that closes the phase loop has one
    known = {item.name for item in fields(LoopSettings)}
    settings = LoopSettings(**{name: value for name, value in _loop_values(plan).items() if name in known})
    asked = plan.run_settings
    window = plan.duration or asked.window_periods / linear.frequency_hz
    level = LevelTime(asked.ramp, window, plan.control != "voltage")
    rate = float(plan.rig.sample_rate_hz)
    quantities = [sensor.quantity for sensor in plan.rig.sensors]
    channels = max(quantities.count(quantity) for quantity in quantities)
    choice = choose_block(linear, settings, level, rate, channels)
    rig = plan.rig.model_copy(update={"block_samples": choice.block_samples})
    return replace(
        plan,
        rig=rig,
        rig_yaml=_text_with_block(plan.rig_yaml, rig),
        linear=linear,
        tick_blocks=choice.tick_blocks,
        block_reason=choice.reason,
    )


def _text_with_block(text: str, rig: Rig) -> str:
    """The rig's text with its block length; comments stay where the text can simply be gone on with."""
    line = f"block_samples: {rig.block_samples}\n"
    longer = f"{text.rstrip()}\n\n# Chosen for the test in which this rig was used.\n{line}"
    try:
        values = yaml.safe_load(longer)
    except yaml.YAMLError:
        return rig_text(rig)
    only = isinstance(values, dict) and longer.count("block_samples:") == 1
    return longer if only and values.get("block_samples") == rig.block_samples else rig_text(rig)
