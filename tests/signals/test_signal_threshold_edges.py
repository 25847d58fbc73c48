"""What thresholds of signals decide, on either side of each: small cases whose outcome is known by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_signals.channel_faults.clipping import flat_top
from nmt_signals.channel_faults.converter_faults import repeated_share
from nmt_signals.channel_faults.mains_lines import mains_line
from nmt_signals.decays.decay_hum import without_hum
from nmt_signals.decays.decay_nodes import span
from nmt_signals.decays.decay_reading import DecayReading, read_decay
from nmt_signals.decays.decay_signal import SlowAmplitude, ridges
from nmt_signals.decays.half_cycles import half_cycle_nodes
from nmt_signals.local_responses import choose_bins, local_responses

RATE = 400.0


def clipped_sine(share: float, step: float = 0.0) -> bool:
    """Whether a sine that is cut for a share of its period has a flat top; ``step``: of the values, half swings."""
    phase = 2.0 * math.pi * np.arange(50_000) / 1000.37
    top = math.cos(math.pi * share)
    samples = np.minimum(np.cos(phase), top)
    half = 0.5 * (1.0 + top)
    if step:
        samples = top - np.ceil((top - samples) / (step * half)) * step * half
    return flat_top(samples, 1000.37) is not None


def rests(near: int, far: int) -> bool:
    """Whether 1000 of 10,000 samples at the top are cut off, with so many in the upper and lower half of the edge."""
    below = 10_000 - 1000 - near - far
    depths = [
        np.zeros(1000),
        np.linspace(0.0029, 0.014, near),
        np.linspace(0.035, 0.055, far),
        np.linspace(0.2, 2.0, below),
    ]
    return flat_top(1.0 - np.concatenate(depths), 1000.37) is not None


def line(seconds: float, away_hz: float, rate: float = 1000.0) -> bool:
    """Whether a line of 50 Hz is looked for beside the second harmonic, so far below it."""
    cycles = 0.5 * (50.0 - away_hz) * np.arange(round(seconds * rate)) / rate
    data = np.random.default_rng(1).standard_normal((1, cycles.size))
    return mains_line(cycles, data, rate, 2, 50.0) is not None


def neighbours(count: int) -> bool:
    """Whether so many lines tell the noise, two below one of 5 Hz and the others above it, where the spectrum ends."""
    rate = 2.0 * (5.0 + count - 1 + 0.5)
    data = np.random.default_rng(1).standard_normal((1, round(rate)))
    return mains_line(None, data, rate, 0, 5.0) is not None


def repeats(steepness: float, by_chance: int = 0) -> bool:
    """Whether six repeats are noticed at a steepness over the rms one, with so many smallest steps beside them."""
    phase = 0.3 * np.arange(4000) + 0.1
    samples = np.sin(phase)
    apart = np.abs(samples[3:] - samples[:-3])
    steep = apart / np.sqrt(np.mean(apart**2))
    places = np.flatnonzero(np.abs(steep - steepness) < 0.03)[::7] + 2
    for place in places[:6]:
        samples[place] = samples[place - 1]
    clear = np.flatnonzero(steep > 1.3)[3::40] + 2
    for place in clear[:by_chance]:
        samples[place] = samples[place - 1] + 1e-9
    return repeated_share(samples) > 0.0


def hums(amplitude: float) -> int:
    """Lines of the mains that are taken out of a steady oscillation of 1 at 40 Hz."""
    time = np.arange(2000) / RATE
    samples = np.cos(2.0 * math.pi * 40.0 * time) + amplitude * np.cos(2.0 * math.pi * 50.0 * time)
    return len(without_hum(samples, RATE, ridges(samples, RATE, Quantity.VELOCITY)[0], 1)[1])


def hums_beside(frequency_hz: float, sweep_hz: float = 0.0, seconds: float = 5.0) -> int:
    """Lines that are taken out of an oscillation near 50 Hz whose frequency rises by so much."""
    time = np.arange(round(seconds * RATE)) / RATE
    turns = (frequency_hz - 0.5 * sweep_hz) * time + 0.5 * sweep_hz / seconds * time**2
    samples = np.cos(2.0 * math.pi * turns) + 0.1 * np.cos(2.0 * math.pi * 50.0 * time)
    return len(without_hum(samples, RATE, ridges(samples, RATE, Quantity.VELOCITY)[0], 1)[1])


def slow(values: np.ndarray) -> SlowAmplitude:
    return SlowAmplitude(np.arange(float(values.size)), 1, np.arange(float(values.size)), values)


def followed(noise: float) -> int:
    """Period to which a decay stands out of its noise."""
    period = np.arange(800.0)
    values = np.exp(-0.01 * period) + noise * np.exp(2j * math.pi * np.random.default_rng(1).random(period.size))
    return span(slow(values.astype(np.complex128)), 0)[1]


def tones(ratio: float, amplitude: float) -> int:
    """Ridges of two tones, the other at a ratio of 20 Hz and with an amplitude of the velocity."""
    time = np.arange(4096) / RATE
    samples = np.cos(2.0 * math.pi * 20.0 * time) + amplitude * np.cos(2.0 * math.pi * 20.0 * ratio * time)
    return len(ridges(samples, RATE, Quantity.VELOCITY))


def turns(guess: float, noise: float = 0.0) -> int:
    """Nodes of a decay of 40 samples a period whose frequency is guessed wrong by a factor; 0 where there are none."""
    n = np.arange(1600)
    samples = np.exp(-0.05 * n / 40.0) * np.cos(2.0 * math.pi * n / 40.0 + 0.3)
    samples += noise * np.random.default_rng(1).standard_normal(n.size)
    try:
        return len(half_cycle_nodes(samples, 40.0, guess))
    except BenchError:
        return 0


def reading(other: float = 0.0) -> DecayReading:
    """What is read of a decay at 20 Hz with another tone at a ratio of its frequency."""
    time = np.arange(4000) / RATE
    samples = np.exp(-0.5 * time) * np.cos(2.0 * math.pi * 20.0 * time)
    if other:
        samples = samples + 0.2 * np.exp(-0.5 * time) * np.cos(2.0 * math.pi * 20.0 * other * time)
    return read_decay(samples, RATE, Quantity.VELOCITY, lambda found: found[0], 12, 1e-4)


def resonances(noise: float) -> int:
    """Lines at which a resonance narrower than their distance is told from noise."""
    size = 4096
    generator = np.random.default_rng(1)
    reference = generator.standard_normal(size)
    line = np.arange(size // 2 + 1)
    response = 1.0 + 1.0j / (line - 500.3 + 2.0j)
    answer = np.fft.irfft(np.fft.rfft(reference) * response, size) + noise * generator.standard_normal(size)
    return int(local_responses(reference, answer[np.newaxis], np.array([500])).resonant.sum())


def highest_driven(share: float) -> float:
    """Highest line over the sampling rate of a drive whose power falls to a share from a fifth of the rate on."""
    size, segment = 12 * 512, 512
    generator = np.random.default_rng(1)
    bins = np.arange(8, segment // 2, 4)
    amplitudes = np.where(bins < segment // 5, 1.0, math.sqrt(share))
    phases = 2.0 * math.pi * generator.random(bins.size)
    time = np.arange(size) / segment
    reference = (amplitudes[:, None] * np.cos(2.0 * math.pi * bins[:, None] * time + phases[:, None])).sum(axis=0)
    return float(choose_bins(reference, reference, 1.0, 400)[-1]) / size


EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    # A sine has a share of 0.025 within the depth of its extreme, and is cut for a little less than what is counted.
    "signals.channel_faults.flat_share": (lambda: (clipped_sine(0.030), clipped_sine(0.036)), (False, True)),
    "signals.channel_faults.flat_depth": (
        lambda: (clipped_sine(0.2, 0.0035), clipped_sine(0.2, 0.0025)), (False, True)
    ),
    "signals.channel_faults.flat_edge_depth": (lambda: (rests(500, 600), rests(300, 600)), (False, True)),
    "signals.channel_faults.mains_longest_s": (lambda: (line(3.9, 1.0), line(4.1, 1.0)), (True, False)),
    "signals.channel_faults.mains_clearance_lines": (lambda: (line(2.0, 1.4), line(2.0, 1.6)), (False, True)),
    "signals.channel_faults.mains_fewest_neighbours": (lambda: (neighbours(7), neighbours(8)), (False, True)),
    "signals.channel_faults.repeats_steepness": (lambda: (repeats(0.4), repeats(0.6)), (False, True)),
    "signals.channel_faults.repeats_crowding": (lambda: (repeats(1.0, 5), repeats(1.0, 3)), (False, True)),
    "signals.decays.hum_fewest_beats": (lambda: [hums_beside(50.0 - away) for away in (0.6, 0.75)], [0, 1]),
    "signals.decays.hum_passing_share": (lambda: [hums_beside(50.0, sweep, 10.0) for sweep in (2.5, 3.5)], [0, 1]),
    # The smooth course is known to a twentieth: so are cosine and sine, by √(2 / 2000) of it.
    "signals.decays.hum_roughness": (lambda: (hums(0.008), hums(0.012)), (0, 1)),
    "signals.decays.hum_sigmas": (lambda: (hums(0.008), hums(0.012)), (0, 1)),
    # ln(1 / (5 · 0.002)) / 0.01
    "signals.decays.node_sigmas": (lambda: abs(followed(0.002) - 460) < 30, True),
    "signals.decays.ridge_log_change": (lambda: (tones(1.2, 0.5), tones(1.4, 0.5)), (1, 2)),
    "signals.decays.other_ridge_share": (lambda: (tones(2.5, 0.08), tones(2.5, 0.12)), (1, 2)),
    "signals.decays.turning_interval_periods": (
        lambda: [turns(guess) > 0 for guess in (0.65, 0.75, 1.3, 1.5)], [False, True, True, False]
    ),
    "signals.decays.turning_sigmas": (lambda: abs(turns(1.0, 0.02) - 25) < 2, True),
    "signals.decays.switch_off_periods": (lambda: reading().nodes[0].first, 1),
    "signals.decays.same_line": (
        lambda: [float(reading(ratio).others.max()) > 1e-3 for ratio in (3.04, 3.1)], [False, True]
    ),
    "signals.fits.local_resonance_gain": (lambda: [resonances(noise) for noise in (0.065, 0.08)], [1, 0]),
    "signals.fits.driven_share": (lambda: [highest_driven(share) > 0.25 for share in (0.2, 0.3)], [False, True]),
    "signals.fits.highest_share": (lambda: highest_driven(1.0), pytest.approx(0.4, abs=0.02)),
}  # fmt: skip


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected
