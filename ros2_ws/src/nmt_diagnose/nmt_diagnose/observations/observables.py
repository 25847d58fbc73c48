"""One schema of observables for the real side and for the model, with covariance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray, IntArray


class Natural(Enum):
    """What a change of an observable is compared with."""

    UNIT = "1"  # a neper, a radian, a harmonic as large as the fundamental
    VALUE = "value"  # its value
    RMS = "rms"  # the rms of all of its kind
    NONE = ""  # it has no natural size


@dataclass(frozen=True)
class PartFacts:
    """Facts of a part of rows, which tables, words, floors, noise, misfit and figures read.

    Attributes:
        column: what ``observables.csv`` calls it.
        words: what its rows are called before the name of their channel; parts with the same words are one observable.
        unit: in which differences are printed; empty = that of the channel.
        factor: from a difference of rows to that unit.
        noise: name of the group of rows of a test with one unknown scale of the noise.
        matters: kind of the size that matters (``DiagnosisSettings.matters``); empty = it stands out or not.
        smooth: a model that lacks nothing may be off by a misfit that neighbours share.
        natural: what a change of it is compared with.
        angle: whole turns do not count.
        excited: it follows the excitation; else it belongs to its channel alone.
        half: half of a complex number that it is, or of the logarithm of one; empty = of none.
        stated: key of a sidecar's ``repeatability``; empty = it has none.
        typical_std: uncertainty where the tests at hand hold none; NaN where it is never predicted ahead.
        title: of its curves; empty = the channel.
        axis: unit of its curves; empty = that of the channel.
        drawn: values of its curves.
        logarithmic: its curves stand on a logarithmic axis.
        scaled: its curves take a power of ten.
    """

    column: str
    words: str
    unit: str
    factor: float
    noise: str
    matters: str
    smooth: bool
    natural: Natural
    angle: bool
    excited: bool
    half: Literal["re", "im", ""]
    stated: str
    typical_std: float
    title: str
    axis: str
    drawn: Callable[[FloatArray], FloatArray]
    logarithmic: bool
    scaled: bool


def _as_it_is(values: FloatArray) -> FloatArray:
    return values


def _in_hertz(values: FloatArray) -> FloatArray:
    return np.asarray(np.exp(values) / (2.0 * math.pi))


def _in_percent(values: FloatArray) -> FloatArray:
    return 100.0 * values


def _unwrapped(values: FloatArray) -> FloatArray:
    return np.asarray(np.degrees(np.unwrap(values)))


def _size(values: FloatArray) -> FloatArray:
    return np.asarray(np.exp(values))


_DEG = 180.0 / math.pi
_HARMONIC = PartFacts(
    "real", "harmonics of", "% of the fundamental", 100.0, "harmonics", "harmonics", True, Natural.UNIT, False, True,
    "re", "", 1e-3, "", "", _as_it_is, False, False,
)  # fmt: skip
_RECORDER = PartFacts(
    "line_amplitude", "line of the mains in", "", 1.0, "converter", "", False, Natural.NONE, False, False,
    "", "", math.nan, "", "", _as_it_is, False, False,
)  # fmt: skip


class Part(IntEnum):
    """What a row is a part of, with its number in files and its facts."""

    facts: PartFacts

    def __new__(cls, number: int, *facts: PartFacts) -> Part:
        """A member with its one row of facts."""
        member = int.__new__(cls, number)
        member._value_ = number
        (member.facts,) = facts
        return member

    # ln of the locked (or ring-down, or backbone) angular frequency in rad/s
    LOG_FREQUENCY = 0, PartFacts(
        "ln_angular_frequency", "frequency", "%", 100.0, "frequency", "frequency", True, Natural.UNIT, False, True,
        "", "frequency", 3e-5, "frequency", "Hz", _in_hertz, False, False,
    )  # fmt: skip
    # arg F₁ − arg(iωψ₁) at lock, rad; predicted by what the controller aims at (0 for an ideal one)
    PHASE_ERROR = 1, PartFacts(
        "phase_error_rad", "phase error", "deg", _DEG, "phase of the loop", "response", False, Natural.UNIT, True, True,
        "", "", 3e-3, "phase error of the loop", "°", _unwrapped, False, False,
    )  # fmt: skip
    # ln |Y₁| (or ln |H| of a frequency response)
    LOG_MAGNITUDE = 2, PartFacts(
        "ln_magnitude", "amplitude of", "%", 100.0, "fundamental", "response", True, Natural.UNIT, False, True,
        "re", "amplitude", 1e-3, "", "", _size, True, True,
    )  # fmt: skip
    # arg Y₁ in the frame of the drive voltage, rad (of a frequency response: arg H)
    PHASE = 3, PartFacts(
        "phase_rad", "phase of", "deg", _DEG, "phase", "response", True, Natural.UNIT, True, True,
        "im", "phase_deg", 1e-3, "", "°", _unwrapped, False, False,
    )  # fmt: skip
    # Re Y_n / |Y₁ measured|, n ≠ 1, in the frame of the drive voltage (n = 0: the mean over |Y₁|)
    REAL = 4, _HARMONIC
    # Im of the same
    IMAG = 5, replace(_HARMONIC, column="imaginary", half="im")
    # damping ratio δ
    DAMPING = 6, PartFacts(
        "damping_ratio", "damping", "% of critical", 100.0, "damping", "damping", True, Natural.VALUE, False, True,
        "", "damping", 1e-4, "damping ratio", "%", _in_percent, False, False,
    )  # fmt: skip
    # amplitude of a spectral line at the row's frequency that follows no excitation, in units of the channel
    LINE = 8, replace(_RECORDER, scaled=True)
    # step of the converter that recorded the channel, in its units; 0 where the samples show none
    STEP = 9, replace(_RECORDER, column="converter_step", words="converter step of")
    # one over the level at which the samples of the channel are clipped, in one over its units; 0 = nowhere
    LIMIT = 10, replace(_RECORDER, column="inverse_clipping_level", words="inverse clipping level of")
    # share of the samples of the channel that repeat the one before: others were lost
    REPEATS = 11, replace(
        _RECORDER, column="share_of_repeated_samples", words="repeated samples of", unit="% of the samples",
        factor=100.0,
    )  # fmt: skip
    # a sample of a record, in units of the channel
    SAMPLE = 7, PartFacts(
        "sample", "record of", "", 1.0, "samples", "response", False, Natural.RMS, False, True,
        "", "", math.nan, "", "", _as_it_is, False, True,
    )  # fmt: skip


ANGLES = tuple(part for part in Part if part.facts.angle)
"""Parts of which whole turns do not count."""
OF_THE_CHANNEL = tuple(part for part in Part if not part.facts.excited)
"""Parts that follow no excitation and belong to their channel alone."""
HARMONICS = (Part.REAL, Part.IMAG)
"""Both halves of a harmonic."""
FUNDAMENTAL = (Part.LOG_MAGNITUDE, Part.PHASE)
"""Both halves of the logarithm of a fundamental or a response."""


def with_natural(natural: Natural) -> tuple[Part, ...]:
    """Parts whose changes are compared with the same."""
    return parts_where(lambda facts: facts.natural is natural)


def parts_where(condition: Callable[[PartFacts], bool]) -> tuple[Part, ...]:
    """Parts of whose facts a condition is true."""
    return tuple(part for part in Part if condition(part.facts))


@dataclass(frozen=True)
class Rows:
    """Identity of every observable, column by column, all of shape (m,).

    Attributes:
        test: index into the tests of the observations.
        level: level index in its test (line of a frequency response, amplitude of a decay, segment of a record).
        channel: index into the channels of its test; −1 where it belongs to none (frequency, phase error).
        harmonic: order n; −1 where it has none.
        part: see :class:`Part`.
        time_s: middle of its window on the clock of its bag, s.
        frequency_hz: excitation frequency or line, Hz.
        amplitude: drive voltage (V) or other level of excitation.
    """

    test: IntArray
    level: IntArray
    channel: IntArray
    harmonic: IntArray
    part: IntArray
    time_s: FloatArray
    frequency_hz: FloatArray
    amplitude: FloatArray

    def __len__(self) -> int:
        return int(self.test.shape[0])

    def take(self, which: NDArray[np.bool_] | IntArray) -> Rows:
        """The rows of a mask or of indices."""
        return Rows(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


class Place(NamedTuple):
    """What the rows of one level have in common; see :class:`nmt_diagnose.observations.observables.Rows`."""

    level: int
    time_s: float
    frequency_hz: float
    amplitude: float


def no_rows() -> Rows:
    """No rows."""
    integers, real = np.zeros(0, dtype=np.int64), np.zeros(0)
    return Rows(integers, integers, integers, integers, integers, real, real, real)
