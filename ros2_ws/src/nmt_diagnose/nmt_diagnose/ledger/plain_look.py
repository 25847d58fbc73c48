"""Compares recorded with predicted signals directly, without noise model, learnt scales or search.

A learnt noise scale absorbs a signal that is 57 times too large, and a search finds laws that imitate a turned sign.
So two checks come first: by which factor each channel is larger than the model predicts (a unit, a sign), and last,
which share of the signal of each channel the model leaves unexplained.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.mistaken_units import mistaken_units
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_core.text.number_words import significant
from nmt_diagnose.ledger.diagnosis import PlaceShare
from nmt_diagnose.measurements.measurement import Measurement, Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.thresholds import THRESHOLDS

# One damping alone is of a level that may be an exception.
_FEWEST_DAMPINGS = 2


@dataclass(frozen=True)
class Factor:
    """A channel that was recorded at another scale or sign than the model predicts.

    Attributes:
        test: name of the test.
        channel: name of the channel.
        factor: recorded over predicted.
        force: it is a force.
    """

    test: str
    channel: str
    factor: float
    force: bool = False

    @property
    def units(self) -> tuple[str, ...]:
        """Units that may have been mistaken; empty where the factor is none of two units."""
        return mistaken_units(self.factor)

    @property
    def sentence(self) -> str:
        """What is seen and what it may be."""
        size = abs(self.factor)
        guess = f": {' or '.join(self.units)}?" if self.units else "; look at its unit, its gain and its range."
        if self.factor < 0.0 and abs(math.log(size)) < math.log(THRESHOLDS.verdict.factor_ratio):
            return f"{self.test}: {self.channel} has the other sign than the model predicts; turn it, or its sensor."
        sign = "−" if self.factor < 0.0 else ""
        return f"{self.test}: {self.channel} is {sign}{significant(size, 3)} times what the model predicts{guess}"

    @property
    def place(self) -> PlaceShare:
        """The sensor."""
        return PlaceShare("force_sensor" if self.force else "response_sensor", self.channel, 1.0, 1.0)


def by_channel(found: Sequence[Factor]) -> tuple[Factor, ...]:
    """One finding for each channel that has the same in several tests."""
    same: dict[tuple[str, bool, tuple[str, ...]], list[Factor]] = {}
    for each in found:
        same.setdefault((each.channel, each.factor < 0.0, each.units), []).append(each)
    result = []
    for group in same.values():
        size = math.exp(float(np.mean([math.log(abs(each.factor)) for each in group])))
        tests = group[0].test if len(group) == 1 else f"{group[0].test} and {len(group) - 1} more"
        result.append(replace(group[0], test=tests, factor=math.copysign(size, group[0].factor)))
    return tuple(result)


def factors(
    observations: Observations, as_given: FloatArray, refitted: FloatArray, used: BoolArray
) -> tuple[Factor, ...]:
    """Channels that another unit or a turned sign explains before the model does.

    A factor between two units, or a sign, follows from the model as given. Any other factor has to remain after the
    parameters are refitted: a spring that is four times as stiff takes four times the force. It also has to be the same
    in every test: friction that the model lacks is many times its force at a low speed, few at a high one.

    Args:
        observations: the real side.
        as_given: predicted by the model as given, (m,).
        refitted: predicted with its parameters re-fitted, (m,).
        used: rows that take part, (m,).
    """
    left = {(found.test, found.channel) for found in _all_factors(observations, refitted, used)}
    return tuple(
        found
        for found in _all_factors(observations, as_given, used)
        if found.factor < 0.0
        or found.units
        or ((found.test, found.channel) in left and _in_every_test(observations, as_given, used, found))
    )


def _in_every_test(observations: Observations, predicted: FloatArray, used: BoolArray, found: Factor) -> bool:
    """Whether a channel has a factor in all tests that it was recorded in."""
    same = [
        _factor(observations, predicted, used, number, index)
        for number, test in enumerate(observations.tests)
        for index, channel in enumerate(test.channels)
        if channel.name == found.channel and channel is not test.given_channel and test.locked is None
    ]
    spread = THRESHOLDS.verdict.factor_spread
    return all(other > 0.0 and abs(math.log(other / found.factor)) <= spread for other in same)


def _driven_by_voltage(test: Measurement) -> bool:
    """Whether the voltage is given, or its rows refer to it."""
    by_voltage = test.record is not None and test.record.input_channel.quantity is Quantity.VOLTAGE
    return by_voltage or test.over_voltage


def _all_factors(observations: Observations, predicted: FloatArray, used: BoolArray) -> tuple[Factor, ...]:
    """Channels whose rows are all larger than predicted by one factor, or turned.

    Where a voltage drives and all channels are smaller by a factor, the drive is, which is a matter of amplifier and
    source: effects explain that. At phase resonance damping makes all motions smaller by one factor.
    """
    limit, found = math.log(THRESHOLDS.verdict.factor_ratio), []
    for number, test in enumerate(observations.tests):
        if test.locked is not None:
            continue
        of_test = [
            (channel, factor)
            for index, channel in enumerate(test.channels)
            if channel is not test.given_channel
            and math.isfinite(factor := _factor(observations, predicted, used, number, index))
        ]
        if _driven_by_voltage(test) and all(
            0.0 < factor * THRESHOLDS.verdict.factor_ratio < 1.0 for _, factor in of_test
        ):
            continue
        found += [
            Factor(test.name, channel.name, factor, channel.quantity is Quantity.FORCE)
            for channel, factor in of_test
            if factor < 0.0 or abs(math.log(factor)) > limit
        ]
    return tuple(found)


def _factor(observations: Observations, predicted: FloatArray, used: BoolArray, number: int, channel: int) -> float:
    """Recorded over predicted; NaN where the rows of a channel have no one factor."""
    rows, limits = observations.rows, THRESHOLDS.verdict
    here = used & np.isfinite(predicted) & (rows.test == number) & (rows.channel == channel)
    samples = here & (rows.part == Part.SAMPLE)
    if int(samples.sum()) >= limits.factor_fewest_rows:
        measured, model = observations.values[samples], predicted[samples]
        size = math.sqrt(float(measured @ measured) * float(model @ model))
        along = float(measured @ model)
        if size == 0.0 or abs(along) < limits.factor_correlation * size:
            return math.nan
        return along / float(model @ model)
    apart = observations.values - predicted
    sizes = apart[here & (rows.part == Part.LOG_MAGNITUDE) & (np.abs(rows.harmonic) == 1)]
    if sizes.size < limits.factor_fewest_rows:
        return math.nan
    middle = float(np.median(sizes))
    if float(np.median(np.abs(sizes - middle))) > limits.factor_spread:
        return math.nan
    cosines = np.cos(apart[here & (rows.part == Part.PHASE)])
    turned = cosines.size >= limits.factor_fewest_rows and np.median(cosines) < -math.cos(limits.factor_spread)
    return -math.exp(middle) if turned else math.exp(middle)


def share_left(observations: Observations, predicted: FloatArray, used: BoolArray) -> tuple[float, str]:
    """The largest unexplained share of a channel's signal, or of a test's damping, beyond noise; and its name.

    The noise is estimated from the recordings alone. A residual of up to several times that noise counts as zero.

    Args:
        observations: the real side, its uncertainties as they were read.
        predicted: by an explanation with the errors of its measuring chain, (m,).
        used: rows that take part, (m,).
    """
    rows, worst, whose = observations.rows, 0.0, ""
    for number, test in enumerate(observations.tests):
        for index, channel in enumerate(test.channels):
            here = used & np.isfinite(predicted) & (rows.test == number) & (rows.channel == index)
            share = 0.0
            for part in (Part.SAMPLE, Part.LOG_MAGNITUDE):
                which = here & (rows.part == part)
                if int(which.sum()) < THRESHOLDS.verdict.factor_fewest_rows:
                    continue
                left, noise = observations.values[which] - predicted[which], observations.sigma[which]
                if part is Part.SAMPLE:
                    signal = observations.values[which] - observations.values[which].mean()
                    size = max(float(np.std(signal)), 1e-300)
                    of_signal, of_noise = math.sqrt(float(np.mean(left**2))) / size, float(np.median(noise)) / size
                else:
                    of_signal, of_noise = float(np.median(np.abs(np.expm1(left)))), float(np.median(noise))
                if of_signal > THRESHOLDS.verdict.unexplained_noises * of_noise:
                    share = max(share, of_signal)
            if share > worst:
                worst, whose = share, f"the signal of {channel.name} in {test.name}"
        share = _share_of_damping(observations, predicted, used & (rows.test == number))
        if share > worst:
            worst, whose = share, f"the damping in {test.name}"
    return worst, whose


def _share_of_damping(observations: Observations, predicted: FloatArray, used: BoolArray) -> float:
    """Share of the damping that is left, in the median level: of the measured or the predicted, whichever is larger."""
    which = used & np.isfinite(predicted) & (observations.rows.part == Part.DAMPING)
    if int(which.sum()) < _FEWEST_DAMPINGS:
        return 0.0
    measured, noise = observations.values[which], observations.sigma[which]
    size = np.maximum(np.maximum(np.abs(measured), np.abs(predicted[which])), 1e-300)
    share = float(np.median(np.abs(measured - predicted[which]) / size))
    beyond_noise = share > THRESHOLDS.verdict.unexplained_noises * float(np.median(noise / size))
    return share if beyond_noise else 0.0
