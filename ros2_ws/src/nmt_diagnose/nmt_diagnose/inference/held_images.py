"""Whether images of a held drive are in measured responses: converters with anti-alias filters let none through.

A response to a random test refers to the samples of the drive. Where the drive is held and nothing is filtered, it is
H(f) + Σ_m e^{2πimθ} I_m(f), with I_m the model's response to the image of order m; θ is where within a held sample the
channel is sampled, much the same for all channels of a kind. Both descriptions, with these images and without, are
fitted to the lines of all channels, and the one that leaves clearly less is right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from nmt_core.arrays import ComplexArray, FloatArray
from nmt_diagnose.observations.conditions import RandomTest, Test
from nmt_diagnose.observations.drive_hold import zero_order_images
from nmt_diagnose.observations.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Observations, Part
from nmt_rig.rig import Rig

SEEN_ORDERS = tuple(sign * order for order in range(1, 41) for sign in (-1, 1))
"""Orders of the images: those of a force that has no resonance fall off with their order only."""
# Of the sample rate, up to which anti-alias filters pass nearly everything; standard deviation of a line that counts.
_BELOW_FILTERS, _CLEAR_LINE = 0.3, 0.01
_FEWEST_LINES = 20
_TURNS = 6
_ANGLES = np.linspace(0.0, 1.0, 80, endpoint=False)
_DELAYS_S = np.linspace(-1e-3, 1e-3, 401)
# Errors of a model go smoothly over so many lines.
_ALIKE = 4.0
# Twice the logarithm of likelihoods: what the images must matter to be looked for, to be sure that they are not there,
# and that they are; share of it by which they must then worsen the description, or improve it.
_CLEARLY, _ABSENT, _THERE, _SURE = 10.0, 40.0, 80.0, 1.2
_AT_STEP = 0.025  # samples
# What the delay of a channel tells of the moment, samples; how far off it may be.
_LEAD_STD, _NEAR = 0.1, 0.5
_LEAST_SPREAD = 1e-5
_SAME_MOMENT = 0.02  # samples


class MeasuredResponse(NamedTuple):
    """One channel of a random test.

    Attributes:
        frequency_hz: shape (lines,).
        measured, plain: response and the model's to a held drive, but for images, shape (lines,).
        images: what the images of each of `SEEN_ORDERS` add to the model's, shape (orders, lines).
    """

    frequency_hz: FloatArray
    measured: ComplexArray
    plain: ComplexArray
    images: ComplexArray


class DetectedImages(NamedTuple):
    """What was found in responses.

    Attributes:
        there: whether they are in the responses; None = that is not clear.
        sampled_at: when each channel is sampled if they are, in samples after the drive has moved on.
    """

    there: bool | None
    sampled_at: tuple[float, ...]


class ImageOptions(NamedTuple):
    """The observations as they are if images of a held drive are in them, and if they are not.

    Attributes:
        options: the more credible one first; empty where images hardly matter.
        sure: whether the first is much more credible.
    """

    options: tuple[Observations, ...]
    sure: bool


def with_detected_images(observations: Observations, rig: Rig) -> tuple[Observations, ...]:
    """The observations with what its first random test shows of a held drive; arguments as for `image_options`.

    Returns:
        One; two, with images and without, where that is not clear; none where images hardly matter.
    """
    found = image_options(observations, rig)
    return found.options[:1] if found.sure else found.options


def image_options(observations: Observations, rig: Rig) -> ImageOptions:
    """What the first random test shows of a held drive.

    Without images none are looked for in any test of that rate. Images that are there become part of what the model
    predicts for that random test.

    Args:
        observations: the real side.
        rig: the model, near enough to the rig.
    """
    for number, test in enumerate(observations.tests):
        chain = observations.chains[number] if number < len(observations.chains) else None
        if chain is None or not isinstance(test, RandomTest) or not may_hold_images(test, chain):
            continue
        rate = chain.hold_hz
        apart = rate * max(chain.of(channel.name).delay_s for channel in test.channels)
        responses = [_response(observations, number, test, k, rig, rate) for k in range(len(test.channels))]
        found = detected_images(responses, rate, apart, [channel.quantity for channel in test.channels])
        if found is None:
            continue
        first = found.sampled_at[0]
        late = tuple((own - first) / rate for own in found.sampled_at)
        seen = replace(test, drive_hold_hz=rate, sampled_at=first, late_s=late if any(late) else ())
        with_images = replace(
            observations,
            tests=tuple(seen if k == number else own for k, own in enumerate(observations.tests)),
            chains=tuple(
                replace(chain, images=False) if k == number else own for k, own in enumerate(observations.chains)
            ),
        )
        chains = tuple(
            replace(own, images=False) if own is not None and own.hold_hz == rate else own
            for own in observations.chains
        )
        without = replace(observations, chains=chains)
        options = (without, with_images) if found.there is False else (with_images, without)
        return ImageOptions(options, found.there is not None)
    return ImageOptions((), False)


def same_images(one: Observations, other: Observations) -> bool:
    """Whether both descriptions of the same recordings have the same images, sampled at nearly the same moment."""
    held = [[chain is not None and chain.images for chain in own.chains] for own in (one, other)]
    moments = [
        np.array([math.nan if t.sampled_at is None else t.sampled_at for t in own.tests if isinstance(t, RandomTest)])
        for own in (one, other)
    ]
    late = [
        np.array([rate for t in own.tests if isinstance(t, RandomTest) for rate in _late_samples(t)])
        for own in (one, other)
    ]
    return held[0] == held[1] and all(
        np.allclose(mine, yours, rtol=0.0, atol=_SAME_MOMENT, equal_nan=True) for mine, yours in (moments, late)
    )


def _late_samples(test: RandomTest) -> FloatArray:
    late = np.array(test.late_s or (0.0,) * len(test.channels))
    return late * test.drive_hold_hz if late.any() else late


def may_hold_images(test: Test, chain: MeasuringChain | None) -> bool:
    """Whether a test is a random one over a voltage that may be held, and nothing says whether its images are there."""
    return (
        isinstance(test, RandomTest)
        and test.reference == "voltage"
        and bool(test.channels)
        and chain is not None
        and chain.images
        and math.isfinite(chain.hold_hz)
    )


def _response(
    observations: Observations, number: int, test: RandomTest, channel: int, rig: Rig, rate: float
) -> MeasuredResponse:
    """One channel of a random test, line by line."""
    rows = observations.rows
    mine = (rows.test == number) & (rows.channel == channel) & (rows.frequency_hz < _BELOW_FILTERS * rate)
    mine &= observations.std < _CLEAR_LINE
    size, turn = (np.flatnonzero(mine & (rows.part == part)) for part in (Part.LOG_MAGNITUDE, Part.PHASE))
    frequency, one, other = np.intersect1d(rows.frequency_hz[size], rows.frequency_hz[turn], return_indices=True)
    view, own = ModelView.of(rig, test.drive_point), (test.channels[channel],)
    images = [zero_order_images(view, own, frequency, rate, (order,))[0] for order in SEEN_ORDERS]
    return MeasuredResponse(
        frequency,
        np.exp(observations.values[size[one]] + 1j * observations.values[turn[other]]),
        zero_order_images(view, own, frequency, rate, (0,))[0],
        np.array(images),
    )


def detected_images(
    responses: Sequence[MeasuredResponse], rate: float, apart: float, kinds: Sequence[object] = ()
) -> DetectedImages | None:
    """Whether responses hold images of a held drive, and how they are turned; None where they hardly matter.

    Every response may have a gain, a phase, a delay, a high-pass and a roll-off of its own. Errors of the model near
    its resonances are taken as outliers. The images are there if including them improves the description by more than
    it would lose without them; they are not if including them makes it worse by as much.

    Args:
        responses: of one random test, one for each channel.
        rate: of the drive's samples, Hz.
        apart: standard deviation of the delays of the channels of a kind, samples.
        kinds: of the channels: those of a kind share a delay; empty = all share one.
    """
    kinds = kinds or [None] * len(responses)
    usable = [k for k, own in enumerate(responses) if own.frequency_hz.size >= _FEWEST_LINES]
    if not usable:
        return None
    turns = np.exp(2j * np.pi * np.outer(_ANGLES, SEEN_ORDERS))
    found = {
        kind: _Kind.of([responses[k] for k in usable if kinds[k] == kind], rate, apart, turns)
        for kind in dict.fromkeys(kinds[k] for k in usable)
    }
    sharpest = max(found.values(), key=lambda own: own.sharpness)
    moments = {kind: own.moment(sharpest.own_moment) for kind, own in found.items()}
    gained = lost = 0.0
    for kind, own in found.items():
        better, worse = own.told(moments[kind], turns)
        gained, lost = gained + better, lost + worse
    if lost <= _CLEARLY:
        return None
    # Half the step, as at the very moment of it, looks like a mass or a filter; a channel sees one side or the other.
    sure = lost > (_THERE if gained > 0.0 else _ABSENT) and abs(gained) > _SURE * lost
    sure = sure and any(abs(moment - round(moment)) > _AT_STEP for moment in moments.values())
    return DetectedImages(
        gained > 0.0 if sure else None, tuple(moments.get(kind, sharpest.own_moment) for kind in kinds)
    )


@dataclass(frozen=True)
class _Kind:
    """Channels of a kind, described with images at every angle.

    Attributes:
        responses: of the channels.
        rate: of the drive's samples, Hz.
        delays: turns that delays make up for, of each channel, (delays, lines).
        held: descriptions with images of each channel at each angle.
        weighed: (channels, angles, angles) costs of the angles of each channel where the angle of all is another.
        costs: (angles,) of the angle of all.
        lead: what the delays of the channels tell of the moment, samples.
    """

    responses: list[MeasuredResponse]
    rate: float
    delays: list[ComplexArray]
    held: list[list[_Description]]
    weighed: FloatArray
    costs: FloatArray
    lead: float

    @classmethod
    def of(cls, responses: list[MeasuredResponse], rate: float, apart: float, turns: ComplexArray) -> _Kind:
        """Describe channels; arguments as for `detected_images`, ``turns`` of the images at every angle."""
        distance = np.abs(_ANGLES[:, np.newaxis] - _ANGLES)
        distance = np.minimum(distance, 1.0 - distance) / max(apart, 1.0 / _ANGLES.size)
        delays = [np.exp(2j * np.pi * np.outer(_DELAYS_S, own.frequency_hz)) for own in responses]
        held = [
            [_fitted(own.frequency_hz, own.measured, own.plain + turn @ own.images, late) for turn in turns]
            for own, late in zip(responses, delays, strict=True)
        ]
        costs = np.array([[_cost(each) for each in of_channel] for of_channel in held])
        # Each channel has the angle that suits it best, and that is near to the angle of all.
        weighed = costs[:, np.newaxis, :] + distance**2
        together = np.sum(np.min(weighed, axis=2), axis=0)
        best = np.argmin(weighed[:, int(np.argmin(together))], axis=1)
        lead = float(np.median([-rate * own[k].delay_s for own, k in zip(held, best, strict=True)]))
        return cls(responses, rate, delays, held, weighed, together, lead)

    @property
    def sharpness(self) -> float:
        """How much worse the angles a tenth of a sample beside the best one are."""
        best, apart = int(np.argmin(self.costs)), round(0.1 * self.costs.size)
        beside = [self.costs[(best + step) % self.costs.size] for step in (-apart, apart)]
        return float(min(beside) - self.costs[best])

    @property
    def own_moment(self) -> float:
        """The moment that suits these channels best, samples."""
        # Where images hardly matter the delay tells more than they do.
        beside = _ANGLES - self.lead
        costs = self.costs + ((beside - np.round(beside)) / _LEAD_STD) ** 2 * (self.sharpness < _CLEARLY)
        angle = _between(costs, int(np.argmin(costs)))
        return angle + round(self.lead - angle)

    def moment(self, common: float) -> float:
        """A moment that other channels have where it suits these nearly as well as their own."""
        at = round(common * _ANGLES.size) % _ANGLES.size
        lead = float(np.median([-self.rate * own[at].delay_s for own in self.held]))
        near = abs(common - lead) < _NEAR
        return common if near and self.costs[at] < self.costs.min() + _CLEARLY else self.own_moment

    def told(self, moment: float, turns: ComplexArray) -> tuple[float, float]:
        """By how much images at a moment improve the description, and by how much leaving them out would worsen it."""
        at = round(moment * _ANGLES.size) % _ANGLES.size
        gained = lost = 0.0
        for own, late, of_channel, near in zip(
            self.responses, self.delays, self.held, self.weighed[:, at], strict=True
        ):
            suits = int(np.argmin(near))
            plain = _fitted(own.frequency_hz, own.measured, own.plain, late)
            missed = _fitted(own.frequency_hz, own.plain + turns[suits] @ own.images, own.plain, late)
            least = min(plain.spread, of_channel[suits].spread)
            gained += _cost(plain) - _cost(of_channel[suits])
            lost += _cost(missed._replace(spread=least)) - _cost(missed._replace(left=0.0 * missed.left, spread=least))
        return gained, lost


def _between(costs: FloatArray, best: int) -> float:
    """The angle of least cost, by a parabola through the best one of the grid and its neighbours."""
    before, at, after = (float(costs[(best + step) % costs.size]) for step in (-1, 0, 1))
    bend = before - 2.0 * at + after
    step = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float((_ANGLES[best] + min(max(step, -0.5), 0.5) / costs.size) % 1.0)


class _Description(NamedTuple):
    """What a description leaves of a response: over the sum of both sizes, (lines,), typically, and its delay, s."""

    left: FloatArray
    spread: float
    delay_s: float


def _cost(found: _Description) -> float:
    """Minus twice the log likelihood of what a description leaves, but for constants; large errors are outliers."""
    return float(2.0 * np.sum(np.log(found.spread**2 + 0.1 * found.left**2)) / _ALIKE)


def _fitted(hertz: FloatArray, measured: ComplexArray, expected: ComplexArray, delays: ComplexArray) -> _Description:
    """What a response leaves of a measured one with the best gain, phase, delay, high-pass and roll-off.

    ``delays`` are the turns that each of the delays tried makes up for, (delays, lines).
    """
    ratio = measured / expected
    # A sensor may be the other way round, but has no other phase at all frequencies.
    best = int(np.argmax(np.abs(np.real(delays @ (ratio / np.abs(ratio))))))
    late = delays[best]
    # Over the size of both, so that neither a resonance nor a zero of the model weighs more than all else.
    size = np.abs(expected) + np.abs(measured)
    model, values = expected / late / size, measured / size
    mean = hertz.mean()
    over = hertz / mean
    # A filter's roll-off and the bend of its phase go with the second and the third power.
    own = [model * factor for factor in (np.ones(hertz.size), 1j, 1j * over, 1j / over, over**2, 1j * over**3)]
    design = np.concatenate([np.real(own), np.imag(own)], axis=1).T
    target = np.concatenate([values.real, values.imag])
    weights = np.ones(hertz.size)
    left, spread = weights, 1.0
    for _ in range(_TURNS):
        both = np.concatenate([weights, weights])
        solution, *_ = np.linalg.lstsq(design * both[:, np.newaxis], target * both, rcond=None)
        left = np.hypot(*np.split(target - design @ solution, 2))
        spread = max(float(np.median(left)), _LEAST_SPREAD)
        weights = 1.0 / (1.0 + (left / (2.0 * spread)) ** 2)
    return _Description(left, spread, float(_DELAYS_S[best]))
