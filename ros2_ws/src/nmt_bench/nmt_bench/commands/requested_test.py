"""The command that carries out a test that is asked for as a value."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

from nmt_core.errors import BenchError
from nmt_core.kinds import PhaseResonanceTest, RandomTest, ResponseCurveTest, SelfExcitedTest
from nmt_core.kinds.request import TestRequest
from nmt_core.kinds.response_curve import ALONG, FLOQUET_PERTURBATION
from nmt_core.vocabulary import AUTOMATIC, HarmonicsTarget

_SAME_LEVEL = 5e-4
"""Relative distance from even steps within which levels are written by their ends."""


def command_text(request: TestRequest) -> str:
    """``./nmt …`` that carries the test out; empty where no command does."""
    try:
        return f"./nmt {shlex.join(command_words(request, request.name))}"
    except BenchError:
        return ""


def command_words(request: TestRequest, out: str = "") -> tuple[str, ...]:
    """Words after ``./nmt``.

    Args:
        request: the test.
        out: folder of the results; empty = the words name none.

    Raises:
        BenchError: no command does such a test, or it is not known on what rig.
    """
    if not request.rig:
        raise BenchError("It is not known on which rig the test is to be made.")
    if request.sensors or len(request.exciters) > 1 or request.frequencies_hz:
        raise BenchError("No command has options for sensors, several exciters or frequencies of a test.")
    random = isinstance(request.kind, RandomTest)
    words = ["linear" if random else "run", request.rig, *_of_kind(request)]
    words += [word for point in request.exciters for word in ("--exciter", str(point))]
    words += [word for key, value in request.changes for word in ("--set", f"{key}={value}")]
    if request.direction != "given":
        words += ["--direction", request.direction]
    if request.levels and not random:
        words += ["--levels", levels_text(request.levels)]
    words += ["--out", out] if out else []
    words += ["--periods", str(request.periods)] if request.periods else []
    words += ["--linear", request.linear] if request.linear else []
    return tuple(words)


def levels_text(levels: Sequence[float]) -> str:
    """Levels as ``--levels`` takes them: ``a:b:n`` for three or more in geometric steps, else a list."""
    count = len(levels)
    steps = [math.log(level / levels[0]) for level in levels]
    even = [steps[-1] * number / max(1, count - 1) for number in range(count)]
    if count > 2 and all(abs(one - other) < _SAME_LEVEL for one, other in zip(steps, even, strict=True)):
        return f"{levels[0]:.4g}:{levels[-1]:.4g}:{count}"
    return ",".join(f"{level:.6g}" for level in levels)


def _of_kind(request: TestRequest) -> list[str]:
    """Options for the settings of a kind of test.

    Raises:
        BenchError: no command does this kind, or one of its settings.
    """
    kind = request.kind
    if isinstance(kind, RandomTest):
        if len(request.levels) > 1:
            raise BenchError("'./nmt linear' takes one level, and half of it.")
        words = ["--level", f"{request.levels[0]:.6g}"] if request.levels else []
        words += ["--duration", f"{kind.duration:g}"] if kind.duration else []
        return [*words, *(["--band", f"{kind.band_low_hz:g}:{kind.band_high_hz:g}"] if kind.band_high_hz else [])]
    if not isinstance(kind, PhaseResonanceTest | SelfExcitedTest | ResponseCurveTest):
        raise BenchError(f"No command does a {kind.words()} test; nmt_session.plan_test does.")
    words = [] if isinstance(kind, PhaseResonanceTest) else ["--kind", kind.label()]
    words += ["--control", request.control.label] if request.control is not kind.CONTROL else []
    if isinstance(kind, ResponseCurveTest):
        words += ["--lag", f"{math.degrees(kind.lag_from):g}:{math.degrees(kind.lag_to):g}"]
        words += ["--spacing", f"{kind.spacing:g}", "--along", ALONG[kind.along]]
        words += ["--release", f"{kind.release:g}"] if kind.release else []
        if kind.perturbation not in (0.0, FLOQUET_PERTURBATION):
            raise BenchError(f"No command perturbs a response curve by {kind.perturbation:g}; --floquet has its own.")
        words += ["--floquet"] if kind.perturbation else []
    elif isinstance(kind, SelfExcitedTest):
        words += ["--method", kind.method, "--duration", f"{kind.duration:g}"]
    else:
        words += ["--strategy", kind.strategy] if kind.strategy != "stepped" else []
        words += ["--refine", f"{kind.refinement:g}"] if kind.refinement else []
        if highest := kind.harmonics_control:
            words += ["--harmonics-control", "auto" if highest == AUTOMATIC else str(highest)]
            modal = kind.harmonics_target == HarmonicsTarget.MODAL
            words += ["--harmonics-target", "modal" if modal else "force"]
    return words
