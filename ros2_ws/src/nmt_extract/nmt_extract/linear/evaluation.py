"""Evaluation of a recorded linear modal test: the windows of random excitation in a bag to modes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.wire import LEVEL
from nmt_core.processes.work_progress import tell
from nmt_extract.linear.file import Linearity, linear_mapping, linearity
from nmt_extract.linear.identification import linear_test
from nmt_extract.linear.results import LinearTest, LinearTestSettings
from nmt_extract.modal.coverage import refuse_other_tests
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Segment, read_signals, segments
from nmt_signals.thresholds import SIGNAL_FITS

DEFAULT_BAND_HZ = (10.0, 2000.0)
"""Band to look for modes in where neither the caller nor the recording says one, as far as the sampling rate reaches,
Hz."""


@dataclass(frozen=True, eq=False)
class LinearTestResult:
    """What a recording of random excitation gives.

    Attributes:
        test: evaluation of the highest level.
        level: its level, V rms; None if the recording does not say.
        check: comparison with the lowest level; None if there is one level only.
        run: the recording's description of itself; empty if it has none.
        remarks: sentences on what was left out or noticed.
    """

    test: LinearTest
    level: float | None
    check: Linearity | None
    run: Mapping[str, Any]
    remarks: tuple[str, ...]

    def to_mapping(self) -> dict[str, Any]:
        """Content of ``linear.json``."""
        values = linear_mapping(self.test, self.check, self.level)
        values["quality"]["remarks"] = list(self.remarks)
        return values


def evaluate_linear_test(
    bag: Bag,
    *,
    band_hz: tuple[float, float] | None = None,
    modes: int = 2,
    mode: int | None = None,
    near_hz: float | None = None,
    rig_mode: int = 1,
    exciter_points: Sequence[int] | None = None,
    quantity: Quantity | None = None,
    segment_s: float | None = None,
) -> LinearTestResult:
    """Evaluate the random windows of a recording: the highest level, and the lowest against it.

    No model enters: everything comes from the recorded force, responses and voltage.

    Args:
        bag: the recording.
        band_hz: lower and upper edge of the band to look for modes in, Hz; None = the recording's band of excitation,
            else :data:`DEFAULT_BAND_HZ`.
        modes: most modes to keep (never more than response points).
        mode: the target's number among the fitted modes, from 1; None = see ``rig_mode``.
        near_hz: the target is the fitted mode nearest to this frequency, Hz; goes before ``mode``.
        rig_mode: the target's number among all modes of the rig, one of the suspension below the band included.
        exciter_points: points of the exciters, in the order of their voltages; None = what the recording says, else
            the point of its first force channel.
        quantity: responses that give the shapes; None, or not recorded = acceleration where it is recorded, else
            displacement, else velocity.
        segment_s: length of an averaged segment, s; None = a tenth of the record.

    Returns:
        Modes with their standard uncertainties (Hz, 1, 1/√kg), residuals, and the plant with its exciters.

    Raises:
        BenchError: a setting out of its range, no whole window of random excitation, or a record that cannot be
            evaluated.

    Examples:
        >>> result = nmt.linear(nmt.Bag.open("out/random"), modes=1, near_hz=370.0)
        >>> round(result.test.modes[0].frequency_hz)
        370
        >>> result.level
        0.5
        >>> nmt.linear(nmt.Bag.open("out/demo"))
        Traceback (most recent call last):
        nmt_core.errors.BenchError: The bag out/demo cannot be evaluated so: The linear test needs random ...
    """
    if modes < 1:
        raise BenchError(f"The number of modes to keep must be at least 1, got {modes}.")
    for name, value in (("frequency near the target", near_hz), ("length of a segment", segment_s)):
        if value is not None and not 0.0 < value < math.inf:
            raise BenchError(f"The {name} must be positive, got {value:g}.")
    if band_hz is not None and not 0.0 < band_hz[0] < band_hz[1] < math.inf:
        raise BenchError(f"The band must be two rising frequencies in Hz, got {band_hz[0]:g} and {band_hz[1]:g}.")
    refuse_other_tests(bag, covers)
    windows = [segment for segment in segments(bag) if kind_class(segment.kind).is_broad_band]
    whole = [segment for segment in windows if not segment.fault]
    if not whole:
        fault = f" ({windows[0].fault})" if windows else ""
        raise BenchError(
            f"The bag {bag.path} has no whole window of random excitation{fault}; record one with './nmt linear'."
        )
    run = bag.run_start or {}
    main = max(whole, key=lambda segment: segment.level)
    settings = LinearTestSettings(
        exciter_points=_exciter_points(bag, run) if exciter_points is None else tuple(exciter_points),
        quantity=_quantity(bag, quantity),
        band_hz=_band(bag, run, main) if band_hz is None else band_hz,
        modes=modes,
        mode=mode,
        near_hz=near_hz,
        rig_mode=rig_mode,
        segment_s=segment_s,
    )
    lowest = min(whole, key=lambda segment: segment.level)
    levels = 2 if lowest.level < main.level else 1
    tell("fitting modes to the levels", 0, levels)
    test = linear_test(read_signals(bag, main.first_sample, main.samples), settings)
    check, remarks = None, list(test.remarks)
    if levels == 2:
        tell("fitting modes to the levels", 1, levels)
        try:
            lower = linear_test(read_signals(bag, lowest.first_sample, lowest.samples), settings)
            check = linearity(test, lower, main.level, lowest.level)
        except BenchError as error:
            remarks.append(f"The lower level of {lowest.level:g} V rms could not be evaluated: {error}")
    if test.reference == "force":
        remarks.append("No voltage was recorded: the exciter's share of the plant is not known.")
    return LinearTestResult(test, main.level if main.level > 0.0 else None, check, run, tuple(remarks))


def _quantity(bag: Bag, asked: Quantity | None) -> Quantity:
    """The response quantity asked for where it is recorded, else one that is."""
    order = [*([asked] if asked else []), Quantity.ACCELERATION, Quantity.DISPLACEMENT, Quantity.VELOCITY]
    return next((quantity for quantity in order if quantity.name.lower() in bag.topics), order[0])


def _band(bag: Bag, run: Mapping[str, Any], main: Segment) -> tuple[float, float]:
    plan = run.get("plan") or {}
    if plan.get("band_low_hz") and plan.get("band_high_hz"):
        return float(plan["band_low_hz"]), float(plan["band_high_hz"])
    for level in bag.records("level", LEVEL):
        if level.index == main.level_index and 0.0 < level.band_low_hz < level.band_high_hz:
            return level.band_low_hz, level.band_high_hz
    low, high = DEFAULT_BAND_HZ
    rate = read_signals(bag, main.first_sample, main.samples).sample_rate
    highest = SIGNAL_FITS.highest_share * rate
    return (low, min(high, highest)) if highest > 2.0 * low else (0.05 * highest, highest)


def covers(test: DrivenTest) -> str:
    """What the linear modal test does not take of a test, and what to use instead; empty = it takes it."""
    if kind_class(test.kind).is_broad_band:
        return ""
    return (
        f"The linear test needs random excitation, and this is a {kind_class(test.kind).words()} test; record one with "
        "'./nmt linear'."
    )


def _exciter_points(bag: Bag, run: Mapping[str, Any]) -> tuple[int, ...]:
    known = run.get("exciter_points") or run.get("exciter_point")
    if known is not None:
        return tuple(map(int, known)) if isinstance(known, list) else (int(known),)
    block = next(iter(bag.blocks("force")), None)
    return (block.points[0] if block is not None else 0,)
