"""From a rig and what is asked of it to a test plan, the same for nodes and for a session in one process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_core.kinds import KindOfTest, SelfExcitedTest, kind_named
from nmt_core.messages.run_settings import RunSettings
from nmt_core.vocabulary import ControlKind
from nmt_pll.loop_settings import LoopSettings
from nmt_rig.one_of_several import named_as_exciter
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_snapshot import rig_text
from nmt_sequencer.level_plan import parse_levels
from nmt_session.block_length import LevelTime, choose_block
from nmt_session.curve_loop import SHORTEST_BLOCK, curve_values
from nmt_session.plan_of_test import PlanSettings, TestPlan, as_plain


class TestSettings(PlanSettings, total=False):
    """Keyword arguments of :func:`plan_test`; those from ``band_hz`` on are settings of kinds of test."""

    test: str
    band_hz: Sequence[float] | None
    rate_hz_s: float | None
    frequency_end_hz: float | None
    duration: float | None
    harmonics_control: int | str | None
    harmonics_target: str | None
    resonance: str | None
    release: float | None
    refinement: float | None
    lag_deg: Sequence[float] | None
    spacing: float | None
    floquet: bool | None
    perturbation: float | None
    along: str | None
    strategy: str | None
    method: str | None
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
    test: str | KindOfTest = "phase_resonance",
    **settings: Any,
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
        test: kind of test, a name of :mod:`nmt_core.kinds`, or one with its settings.
        settings: those of :class:`nmt_session.plan_of_test.PlanSettings`, and the settings of the kind of test.

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
        with named_as_exciter(exciter):
            loaded = load_rig(str(rig), changes)
        text = rig_text(loaded, rig, changes)
    kind = test if isinstance(test, KindOfTest) else kind_of_rig(test, loaded, settings)
    settings.setdefault("control", kind.CONTROL.label)
    plan = _rig_levels(loaded, kind, settings["control"]) if levels is None else levels
    amplitudes = tuple(parse_levels(plan) if isinstance(plan, str) else plan)
    if kind.needs_frequencies and not kind.sweeps and len(amplitudes) == 1:
        amplitudes *= max(1, len(settings.get("frequencies_hz", ())))
    if compare:
        amplitudes, without = _with_comparison(amplitudes, compare)
        settings["levels_without"] = without
    planned = TestPlan.of(loaded, text, amplitudes, kind, **settings)
    if compare and not kind.controlled_harmonics:
        raise BenchError("A comparison needs control of the force's harmonics: give --harmonics-control.")
    if compare and len(settings.get("frequencies_hz", ())) > 1:
        raise BenchError("A comparison takes one frequency for all levels; leave out --compare.")
    return _with_chosen_block(planned) if _leaves_block_open(planned) else planned


def kind_of_rig(test: str, rig: Rig, settings: dict[str, Any]) -> KindOfTest:
    """A kind of test by its name, with its settings.

    Args:
        test: name of a kind that the bench does.
        rig: of it are the settings that are not given, or None.
        settings: in the words of Python; those of the plan and of the run stay, the others are taken out.

    Raises:
        BenchError: no such kind, or a setting that it has not or that is not understood.
    """
    kind = kind_named(test)
    of_plan = {item.name for record in (TestPlan, RunSettings) for item in fields(record)}
    chosen = {name: settings.pop(name) for name in list(settings) if name not in of_plan}
    chosen = {name: as_plain(value) for name, value in chosen.items() if value is not None}
    for name in kind.FROM_RIG:
        chosen.setdefault(name, getattr(rig.test, name))
    return kind.spelled(**chosen)


def _rig_levels(rig: Rig, kind: KindOfTest, control: str) -> Sequence[float] | str:
    """Levels of the rig for a kind of test.

    Raises:
        BenchError: it has none for it.
    """
    levels: Sequence[float] | str | None = getattr(rig.test, kind.RIG_LEVELS) if kind.RIG_LEVELS else None
    if not kind.RIG_LEVELS:
        raise BenchError(f"A {kind.words()} test needs levels: those of rig {rig.name} are for phase resonance.")
    if not levels or control != kind.CONTROL.label:
        raise BenchError(f"Levels of {control} are needed: those of rig {rig.name} are voltages; give --levels.")
    return levels


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
    """Whether the length of a block is not stated, and nothing but wall time depends on it.

    Blocks of hardware and of real time wait at its output; those of a latency are what the user has counted.
    """
    values = _loop_values(plan)
    return (
        "block_samples" not in plan.rig.model_fields_set
        and plan.pacing == "lockstep"
        and not plan.is_on_hardware
        and plan.lead_blocks == 0
        and plan.kind.closes_phase_loop
        and not isinstance(plan.kind, SelfExcitedTest)
        and not plan.ramps
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
    values = curve_values(plan.kind, linear, _loop_values(plan), plan.control)
    settings = LoopSettings(**{name: value for name, value in values.items() if name in known})
    asked = plan.asked
    window = plan.kind.window_s or asked.window_periods / linear.frequency_hz
    level = LevelTime(asked.ramp, window, plan.control is not ControlKind.VOLTAGE)
    rate = float(plan.rig.sample_rate_hz)
    quantities = [sensor.quantity for sensor in plan.rig.sensors]
    channels = max(quantities.count(quantity) for quantity in quantities)
    unstable = plan.kind.is_curve and plan.control is ControlKind.FORCE
    choice = choose_block(linear, settings, level, rate, channels, SHORTEST_BLOCK if unstable else 0.0)
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
        values = yaml_value(longer, "rig file")
    except BenchError:
        return rig_text(rig)
    only = isinstance(values, dict) and longer.count("block_samples:") == 1
    return longer if only and values.get("block_samples") == rig.block_samples else rig_text(rig)
