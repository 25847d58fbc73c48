"""One mode of a free decay, read from the samples of one channel: its slow amplitude and what its segments say.

The strongest ridges of short spectra are candidates; whoever knows the structure chooses one. Lines of the mains next
to it are taken out, and the band of the demodulation is as wide as tells most.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import Quantity
from nmt_signals.decays.decay_hum import Hum, without_hum
from nmt_signals.decays.decay_nodes import Node, nodes
from nmt_signals.decays.decay_signal import Ridge, SlowAmplitude, ridges, slow_amplitude
from nmt_signals.thresholds import DECAYS

DEMODULATION_WIDTHS = (1, 2, 4)
"""Widths of the demodulation that are tried, in periods."""
# Amplitudes at which two widths are compared.
_COMPARED_AMPLITUDES = 60
# Of two frequencies at one amplitude, beyond which one excludes the other.
_EXCLUDED_SIGMAS = 5.0


@dataclass(frozen=True)
class DecayReading:
    """What was found in one channel.

    Attributes:
        slow: amplitude of the mode on its phase.
        nodes: what each segment of it says, from large to small amplitude.
        good: those whose frequency is known.
        ridge: of the mode in short spectra.
        hum: lines of the mains that were taken out.
        others: motion in other modes over that in this one at each good node, squared, shape (good,).
    """

    slow: SlowAmplitude
    nodes: list[Node]
    good: list[Node]
    ridge: Ridge
    hum: tuple[Hum, ...]
    others: FloatArray


def read_decay(
    samples: FloatArray,
    sample_rate: float,
    quantity: Quantity,
    choose: Callable[[Sequence[Ridge]], Ridge],
    wanted: int,
    floor: float,
) -> DecayReading:
    """Amplitudes, frequencies and decay rates of one mode.

    Args:
        samples: from the switch-off or from some time before an impact on, shape (n,).
        sample_rate: Hz.
        quantity: displacement, velocity or acceleration.
        choose: the ridge of the mode, of those that were found, strongest first; raises BenchError where none will do.
        wanted: amplitudes.
        floor: uncertainty of ln ω below which nothing more is reported.

    Raises:
        BenchError: nothing of it can be used.
    """
    samples = samples - samples.mean()
    found_ridges = ridges(samples, sample_rate, quantity)
    ridge = choose(found_ridges)
    samples, hum = without_hum(samples, sample_rate, ridge, DECAYS.switch_off_periods)
    best: DecayReading | None = None
    reason = ""
    for width in DEMODULATION_WIDTHS:
        try:
            slow = slow_amplitude(samples, sample_rate, ridge, width)
        except BenchError as error:
            reason = reason or str(error)
            continue
        found = nodes(slow, wanted, DECAYS.switch_off_periods)
        good = [node for node in found if node.omega > 0.0 and node.omega_std < DECAYS.largest_log_std * node.omega]
        if not good:
            reason = reason or "the decay does not stand out of the noise, or something else rings on"
            continue
        decay = DecayReading(slow, found, good, ridge, hum, _in_others(good, ridge, found_ridges, hum))
        # A narrower band lets less of other modes through, but makes less of a fast decay.
        if best is None or _pays(decay, best, floor):
            best = decay
    if best is None:
        raise BenchError(reason)
    return best


def _in_others(good: list[Node], followed: Ridge, found: list[Ridge], hum: tuple[Hum, ...]) -> FloatArray:
    """Square of the motion in other modes over that in the own one at each node, shape (nodes,).

    Harmonics are no other mode, nor is the mains. Of slower modes velocities are compared, not displacements: a body
    that swings on its suspension does not strain.
    """
    total = np.zeros(followed.time_s.size)
    for ridge in found:
        ratio = ridge.late_hz / followed.late_hz
        foreign = any(abs(ridge.late_hz / line.frequency_hz - 1.0) < DECAYS.same_line for line in hum)
        if ridge is followed or foreign or abs(ratio - max(1.0, round(ratio))) < DECAYS.same_line * ratio:
            continue
        energy = np.interp(followed.time_s, ridge.time_s, np.where(ridge.clear, ridge.energy, 0.0))
        total += energy / np.maximum(followed.energy, 1e-300) / max(1.0, ratio) ** 2
    return np.asarray(np.interp([node.time_s for node in good], followed.time_s, total))


def _pays(narrower: DecayReading, wider: DecayReading, floor: float) -> bool:
    """Whether a narrower band tells far more of the frequency over most of the amplitudes that either covers.

    Fewer and longer segments are each more certain and say no more. What is known better than to the floor that
    observables have, relative, tells nothing more either: else quiet small amplitudes outvote the large ones. A band
    that is too narrow for how fast the frequency falls at first has another frequency there than the wide one.
    """
    if _misses(narrower, wider, floor):
        return False
    ends = [end for decay in (narrower, wider) for node in decay.good for end in _reach(decay, node)]
    grid = np.linspace(min(ends), max(ends), _COMPARED_AMPLITUDES)
    gain = _covered(narrower, grid, floor) > _covered(wider, grid, floor) / DECAYS.narrower_gain**2
    return float(np.mean(gain)) > 0.5


def _misses(narrower: DecayReading, wider: DecayReading, floor: float) -> bool:
    """Whether the largest amplitude of the wider band has a frequency that the course of the narrower one excludes."""
    top = max(wider.good, key=lambda node: node.amplitude)
    two = sorted(narrower.good, key=lambda node: -node.amplitude)[:2]
    squares = np.array([node.amplitude**2 for node in two])
    # A spring that hardens or softens moves the frequency with the square of the amplitude.
    slopes = np.gradient([node.omega for node in two], squares)[0] if len(two) > 1 else 0.0
    expected = two[0].omega + slopes * max(top.amplitude**2 - squares[0], 0.0)
    std = math.hypot(top.omega_std, two[0].omega_std, floor * top.omega)
    return bool(abs(top.omega - expected) > _EXCLUDED_SIGMAS * std)


def _reach(decay: DecayReading, node: Node) -> tuple[float, float]:
    """Smallest and largest ln of the amplitude in a node's segment."""
    log = decay.slow.log[node.first : node.stop]
    return float(log.min()), float(log.max())


def _covered(decay: DecayReading, log: FloatArray, floor: float) -> FloatArray:
    """What a decay tells of ln ω per unit of ln A, shape of ``log``; 0 where it has no segment."""
    covered = np.zeros(log.shape)
    for node in decay.good:
        low, high = _reach(decay, node)
        inside = (log >= low) & (log <= high)
        covered[inside] = 1.0 / (math.hypot(node.omega_std / node.omega, floor) ** 2 * max(high - low, 1e-9))
    return covered
