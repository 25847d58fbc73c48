"""What a drive that is held over each sample does to the observables, and what is uncertain about it.

The steps of such a drive have images about the multiples of its rate; they reach the responses, are folded by the
sampling, and move what is taken for the response at each frequency.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from nmt_core.arrays import ComplexArray, FloatArray
from nmt_core.blocks import Quantity
from nmt_diagnose.inference.chain_tests import ChainTests, edited, later
from nmt_diagnose.observations.conditions import PhaseResonanceTest, RandomTest, Test
from nmt_diagnose.observations.drive_hold import zero_order_images
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.twin.forward import Forward, Prediction
from nmt_diagnose.twin.held_steps import LEAST_RISE

_IMAGE_ORDERS = tuple((order,) for order in (-1, 1, -2, 2, -3, 3, -4, 4))
# What the model's response far above its modes is off by, some 0.1, goes smoothly over some hundred lines; taken as
# noise of each line it must be larger by the root of their number not to count for more than it is. The share of it
# that differs from level to level.
IMAGE_FLOOR, SAME_FOR_LEVELS = 1.0, 0.2
# Samples about the step of a held drive in which it is on the way, what is left of the step, relative, and of a
# response at most.
_JUMP, _JUMP_SHARE, _JUMP_FLOOR = 0.15, 0.05, 1e-3
# Time that such a drive takes to move on, samples; what images that are part of the model may be off by, relative.
_RISE, _KNOWN_IMAGES = 0.05, 0.01
# What a loop may hold other than it was told, for all levels, rad.
_AIM_STD = math.radians(1.0)


class HeldDrive:
    """Errors of the held drive of some tests.

    Args:
        chain: the tests.
    """

    def __init__(self, chain: ChainTests) -> None:
        self.chain = chain
        self.rows = chain.rows
        self.tests = chain.tests
        self.rig = chain.rig
        self.own = chain.own
        self.channels = chain.channels

    def size(self, values: FloatArray) -> FloatArray:
        """What images add to ln of each fundamental at most, (rows,); ``values`` as for `_images`."""
        return np.asarray(np.sum(np.abs(self._images(values)), axis=0))

    def _images(self, values: FloatArray) -> tuple[ComplexArray, ...]:
        """What images of a held drive add to ln of each fundamental, (rows,) for each of the orders.

        The images themselves are those of a linear structure, far above its modes; what they are added to in locked
        windows is what a solution says, ``values`` (rows,): a joint that slips turns it and makes it another share.
        """
        windows = self._windows(values)
        result = np.zeros((len(_IMAGE_ORDERS), len(self.rows)), dtype=np.complex128)
        for number in self.chain.referred():
            test, chain = self.tests[number], self.own[number]
            channels = getattr(test, "channels", ())
            mine = np.flatnonzero(self.chain.linear_rows(number))
            if not mine.size or not np.isfinite(chain.hold_hz) or not chain.images:
                continue
            view = ModelView.of(self.rig, test.drive_point)
            frequency = self.rows.frequency_hz[mine]
            place = (self.rows.channel[mine], np.arange(mine.size))
            plain = view.responses(channels, frequency)[place]
            plain = np.where(np.isfinite(windows[mine]), windows[mine], plain)
            for k, orders in enumerate(_IMAGE_ORDERS):
                images = zero_order_images(view, channels, frequency, chain.hold_hz, orders)
                result[k, mine] = np.where(frequency < 0.5 * chain.hold_hz, images[place] / plain, 0.0)
        return tuple(np.nan_to_num(result))

    def _windows(self, values: FloatArray) -> ComplexArray:
        """Fundamentals of locked windows per volt, at their magnitude and at their phase, (rows,); NaN elsewhere."""
        other, turned = values[self.chain.other_part()], self.rows.part == Part.PHASE
        size, angle = np.where(turned, other, values), np.where(turned, values, other)
        result = np.full(len(self.rows), np.nan, dtype=np.complex128)
        for number in self.chain.referred():
            if isinstance(self.tests[number], PhaseResonanceTest):
                mine = self.chain.linear_rows(number)
                result[mine] = np.exp(size[mine] + 1j * angle[mine]) / self.rows.amplitude[mine]
        return result

    def columns(self, slopes: FloatArray, base: Prediction) -> list[FloatArray]:
        """A drive that is held over each sample: smaller, half a sample late, and with images.

        A sampler with a delay τ of its own turns the image of order m by 2π m f_h τ, any angle; so each has an
        amplitude and a phase of its own in every channel.
        """
        found = []
        commanded = [n for n in self.chain.referred() if getattr(self.tests[n], "commanded", False)]
        recorded = [n for n in self.chain.referred() if n not in commanded]
        # A voltage that filters smooth before it is recorded shows the hold as the responses do; what was commanded
        # does not.
        for tests in (commanded, recorded):
            direct = np.zeros(len(self.rows), dtype=np.complex128)
            for number in tests:
                rate = self.own[number].hold_hz
                mine = self.chain.linear_rows(number)
                if np.isfinite(rate):
                    share = self.rows.frequency_hz[mine] / rate
                    direct[mine] = np.log(np.maximum(np.sinc(share), 1e-3)) - 1j * np.pi * share
            found.append(self.chain.parts(direct) + self._late(base.values, tests))
        found.append(self._other_steps(base, rise=_RISE))
        found += self._known_images(base)
        harmonics, all_images = self.chain.over_fundamental(), self._images(base.values)
        for channel in self.channels:
            own = self.chain.rows_of(channel)
            for images in all_images:
                for turned in (images, 1j * images):
                    changed = self.chain.parts(turned) * own
                    for fundamental, above in harmonics:
                        changed[above] = -base.values[above] * changed[fundamental]
                    found.append(changed + slopes * self._turned(channel, turned))
        return found

    def _late(self, base: FloatArray, tests: Sequence[int]) -> FloatArray:
        """Change of harmonics above the first by half a sample of delay, in the frame of the drive."""
        result = np.zeros(len(self.rows))
        for (number, _, _, order), mine in self.chain.harmonics().items():
            rate = self.own[number].hold_hz
            if number in tests and np.isfinite(rate) and len(mine) == 2:
                values = {int(self.rows.part[row]): row for row in mine}
                angle = -np.pi * order * self.rows.frequency_hz[mine[0]] / rate
                real, imag = values[int(Part.REAL)], values[int(Part.IMAG)]
                result[real], result[imag] = -angle * base[imag], angle * base[real]
        return np.nan_to_num(result)

    def _other_steps(self, base: Prediction, **changes: Any) -> FloatArray:
        """Change of the rows if the steps of a held drive were others, where their images are part of the model."""
        moved = tuple(
            replace(test, **changes) if isinstance(test, RandomTest) and test.sampled_at is not None else test
            for test in self.tests
        )
        return np.nan_to_num(self.chain.moved(moved, base))

    def _known_images(self, base: Prediction) -> list[FloatArray]:
        """What images that are part of the model may be off by, in each channel of each test the same share of them."""
        change = self._without_images(base)
        if not change.any():
            return []
        other = change[self.chain.other_part()]
        turned = self.rows.part == Part.PHASE
        images = np.where(turned, other, change) + 1j * np.where(turned, change, other)
        return [
            _KNOWN_IMAGES * self.chain.parts(part) * self.chain.rows_of(channel) * (self.rows.test == number)
            for channel in self.channels
            for number, test in enumerate(self.tests)
            if isinstance(test, RandomTest) and test.sampled_at is not None
            for part in (images, 1j * images)
        ]

    def bends(self) -> list[FloatArray]:
        """What delays of channels add to images that are part of the model, beyond what is in proportion to them.

        An image of order m turns by m times the delay's share of a sample: a bend that counts. For a Gaussian delay it
        goes with the square, of which the rms is √3.
        """
        found = []
        for number, test in enumerate(self.tests):
            if not isinstance(test, RandomTest) or test.sampled_at is None:
                continue
            mine = self.rows.test == number
            own = self.rows.take(mine)
            forward = Forward((test,), replace(own, test=np.zeros_like(own.test)))
            base = forward.predict(self.rig)
            for channel in test.channels:
                delay = self.own[number].of(channel.name).delay_s
                both = np.zeros(len(own))
                for turn in (-delay, delay):
                    moved = forward.predict(edited(self.rig, channel, partial(later, seconds=turn)), base)
                    both += forward.difference(moved.values, base.values)
                column = np.zeros(len(self.rows))
                column[mine] = 0.5 * math.sqrt(3.0) * np.nan_to_num(both)
                found.append(column)
        return found

    def _without_images(self, base: Prediction) -> FloatArray:
        """Change of the rows if images that are part of the model were not there, and the drive held all the same."""
        change = self._other_steps(base, sampled_at=None, drive_hold_hz=math.inf)
        for number, test in enumerate(self.tests):
            if not isinstance(test, RandomTest) or test.sampled_at is None:
                continue
            mine = self.chain.linear_rows(number)
            share = self.rows.frequency_hz / test.drive_hold_hz
            held = np.log(np.abs(np.sinc(share) * np.sinc(share * test.rise)) + 1e-300)
            late = np.pi * share * (2.0 * test.sampled_at - 1.0)
            turned = self.rows.part == Part.PHASE
            change = change + mine * np.where(turned, late, held)
            change[mine & turned] = (change[mine & turned] + np.pi) % (2.0 * np.pi) - np.pi
        return change

    def _jumps(self, base: Prediction) -> FloatArray:
        """Change of the rows of channels that are sampled near the step of a held drive from before it to after it."""
        result = np.zeros(len(self.rows))
        for number, test in enumerate(self.tests):
            if not isinstance(test, RandomTest) or test.sampled_at is None:
                continue
            for k, channel in enumerate(test.channels):
                if not near_step(test, channel.name):
                    continue
                moment = test.sampled_at + (test.late_s[k] * test.drive_hold_hz if test.late_s else 0.0)
                sides = []
                for side in (-0.5 * LEAST_RISE, 0.5 * LEAST_RISE):
                    there = test.sampled_at + round(moment) + side - moment
                    moved = tuple(
                        replace(test, sampled_at=there, rise=LEAST_RISE) if own is test else own for own in self.tests
                    )
                    sides.append(np.nan_to_num(self.chain.moved(moved, base)))
                change = sides[1] - sides[0]
                turned = self.rows.part == Part.PHASE
                change -= turned * 2.0 * np.pi * self.rows.frequency_hz / test.drive_hold_hz * LEAST_RISE
                size = np.hypot(change, change[self.chain.other_part()])
                mine = (self.rows.channel == k) & self.chain.linear_rows(number)
                result[mine] = size[mine]
        return result

    def _turned(self, channel: str, images: ComplexArray) -> FloatArray:
        """By how much the phase between force and response truly was off at each locked row, if images were in it."""
        result = np.zeros(len(self.rows))
        for number, test in enumerate(self.tests):
            if not isinstance(test, PhaseResonanceTest):
                continue
            force = next((c.name for c in test.channels if c.quantity is Quantity.FORCE), "")
            sign = (channel == test.response_channel) - (channel == force)
            mine = (self.rows.test == number) & self.chain.rows_of(channel) & (self.rows.part == Part.PHASE)
            for level in np.unique(self.rows.level[mine]) if sign else ():
                angle = float(images[mine & (self.rows.level == level)][0].imag)
                result[(self.rows.test == number) & (self.rows.level == level)] = sign * angle
        return result

    def aims(self, base: Prediction) -> list[FloatArray]:
        """What the loop of each test held: it measured with a chain of its own."""
        found = []
        size = self.size(base.values)
        for number, test in enumerate(self.tests):
            if isinstance(test, PhaseResonanceTest):
                mine = self.rows.test == number
                # One of the two chains may have filters that keep images out, and the other none.
                around = float(np.max(size[mine & (self.rows.part == Part.PHASE)], initial=0.0)) / math.sqrt(2.0)
                found.append(np.hypot(_AIM_STD, around) * (mine & (self.rows.part == Part.PHASE_ERROR)))
        return found

    def jumps(self, base: Prediction) -> FloatArray:
        """What samples about the step of the drive may be off by, (rows,)."""
        return np.minimum(_JUMP_SHARE * self._jumps(base), _JUMP_FLOOR)

    def known_images(self, base: Prediction) -> FloatArray:
        """What images that are part of the model may be off by, (rows,)."""
        return np.asarray(_KNOWN_IMAGES * np.abs(self._without_images(base)))


def near_step(test: Test, channel: str) -> bool:
    """Whether images are part of the model, and a channel is sampled about when the held drive moves on.

    No drive jumps at once: what is sampled at that moment sees something between.
    """
    if not isinstance(test, RandomTest) or test.sampled_at is None:
        return False
    names = [own.name for own in test.channels]
    if channel not in names:
        return False
    moment = test.sampled_at
    if test.late_s:
        moment += test.late_s[names.index(channel)] * test.drive_hold_hz
    return abs(moment - round(moment)) < _JUMP
