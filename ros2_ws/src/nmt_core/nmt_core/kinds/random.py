"""Band-limited noise, one window of a given length at each level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds.kind_of_test import KindOfTest
from nmt_core.vocabulary import ControlKind, TestKind

PEAK_FACTOR = 4.0
"""Peak by rms that a random drive is taken to reach; Gaussian noise passes it once in some 16,000 values."""


@dataclass(frozen=True, kw_only=True)
class RandomTest(KindOfTest):
    """Random excitation.

    Attributes:
        band_low_hz, band_high_hz: band of the noise, Hz.
        duration: length of the window, s.
    """

    NUMBER: ClassVar[TestKind] = TestKind.RANDOM
    levels_are_rms: ClassVar[bool] = True
    has_phase: ClassVar[bool] = False
    is_broad_band: ClassVar[bool] = True

    band_low_hz: float = 0.0
    band_high_hz: float = 0.0
    duration: float = 0.0

    @classmethod
    def spelled(cls, **settings: Any) -> KindOfTest:
        """``band_hz`` has both edges of the band."""
        band = settings.pop("band_hz", None)
        if band is not None:
            if len(band) != 2:
                raise BenchError(f"band_hz needs a lower and an upper edge, got {len(band)} values.")
            settings |= {"band_low_hz": float(band[0]), "band_high_hz": float(band[1])}
        return super().spelled(**settings)

    @property
    def window_s(self) -> float:
        """Length of the window, s."""
        return self.duration

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) a band that the sample rate does not hold, and levels other than of voltage."""
        super().check(frequencies_hz, levels, control, sample_rate)
        nyquist = 0.5 * sample_rate
        if not 0.0 < self.band_low_hz < self.band_high_hz < nyquist:
            raise BenchError(
                f"The random band of {self.band_low_hz:g} to {self.band_high_hz:g} Hz must lie between 0 and half "
                f"the sample rate, {nyquist:g} Hz, the lower edge first."
            )
        if control != ControlKind.VOLTAGE:
            raise BenchError("A random test has levels of voltage (V rms) only; leave the control at voltage.")
        self.check_duration(self.duration)

    def check_frequencies(self, frequencies_hz: Sequence[float], levels: int, nyquist: float) -> None:
        """Refuse (BenchError) frequencies."""
        if frequencies_hz:
            raise BenchError("A random test has a band and no frequencies; leave them out.")
