"""Signal-to-noise ratio of windows: sines of known amplitude in white noise of known variance."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nmt_record.bag.bag_reader import Bag
from nmt_study.signal_noise import window_signal_to_noise

RATE, HZ, BLOCK = 5000.0, 20.0, 500


class Recording:
    """Force and displacement of 100 periods at a point, ten blocks a second."""

    def __init__(self, ratio_db: dict[str, float]) -> None:
        draw, time = np.random.default_rng(1), np.arange(25_000) / RATE
        self.data = {}
        for topic, ratio in ratio_db.items():
            signal = 2.0 * np.cos(2.0 * np.pi * HZ * time) + 0.5 * np.sin(6.0 * np.pi * HZ * time)
            power = 0.5 * (2.0**2 + 0.5**2)
            # The mean is not a signal.
            self.data[topic] = 3.0 + signal + np.sqrt(power / 10.0 ** (ratio / 10.0)) * draw.standard_normal(time.size)

    def lock_events(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(window_samples=25_000, window_periods=100, window_first_sample=0, level_index=3)]

    def blocks(self, topic: str, first: int, stop: int):
        for start in range(first, stop, BLOCK):
            turns = HZ * (start + np.arange(BLOCK)) / RATE
            phase = 2.0 * np.pi * (turns - np.floor(turns[0]))
            yield SimpleNamespace(
                points=(2,),
                samples=BLOCK,
                sample_rate=RATE,
                first_sample=start,
                data=self.data[topic][None, start : start + BLOCK],
                oscillator=SimpleNamespace(phase=lambda samples, rate, phase=phase: phase),
            )


def test_ratio_of_powers_in_decibels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bag, "open", lambda _: Recording({"force": 10.0, "displacement": 33.0}))
    found = window_signal_to_noise(Path("bag"), 2, 5)
    assert list(found) == ["3"]
    assert found["3"]["force"] == pytest.approx(10.0, abs=0.3)
    assert found["3"]["displacement"] == pytest.approx(33.0, abs=0.3)
