"""Streams with known harmonics for the tests of the extraction."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import LockEvent
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.extractor import Extractor

RATE = 10_000.0
POINTS = (2, 4, 5, 6)
FREQUENCY = 22.19
OMEGA = 2.0 * math.pi * FREQUENCY
SHAPES = np.array([[0.3, 0.5], [1.0, -0.7], [2.0, 0.9], [3.1, -2.0]])
SETTINGS = ExtractionSettings(topics=("force", "displacement"))


def linear_description(shapes: np.ndarray = SHAPES, **changes: object) -> LinearDescription:
    values = {
        "source": "model",
        "drive_point": 2,
        "target_mode": 0,
        "points": POINTS,
        "frequencies_rad_s": (OMEGA, 5.5 * OMEGA),
        "damping_ratios": (0.01, 0.02),
        "shapes": tuple(tuple(float(x) for x in row) for row in shapes),
        "drive_point_shape": float(shapes[0, 0]),
        "plant_frequency_rad_s": OMEGA,
        "plant_damping_ratio": 0.02,
        "moving_mass_kg": 0.04,
    }
    return LinearDescription(**{**values, **changes})


def signal(cycles: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
    """Re Σ ψ_n exp(i n θ), term by term: the witness of what the harmonics mean."""
    angle = 2.0 * np.pi * cycles
    return sum((a * np.exp(1j * n * angle)).real for n, a in enumerate(amplitudes))


class Stream:
    """Force and displacements with given harmonics on an oscillator, cut into blocks.

    Args:
        force: F_n.
        shape: ψ_n, one row for each point.
        frequencies: Hz of consecutive blocks (the last one goes on), or one for all.
        noise: standard deviation relative to the largest value of each channel.
    """

    def __init__(
        self,
        force,
        shape,
        *,
        samples=8000,
        frequencies=(FREQUENCY,),
        block=200,
        noise=0.0,
        seed=0,
        start_cycles=0.0,
        known_phase=True,
        quantity=Quantity.DISPLACEMENT,
    ) -> None:
        self.samples = samples
        self.block = block
        self.known_phase = known_phase
        self.quantity = quantity
        per_block = [*frequencies, *[frequencies[-1]] * (-(-samples // block))][: -(-samples // block)]
        self.frequencies = per_block
        self.starts = [start_cycles]
        for frequency in per_block:
            self.starts.append(self.starts[-1] + frequency * block / RATE)
        cycles = np.concatenate(
            [start + f * np.arange(block) / RATE for start, f in zip(self.starts[:-1], per_block, strict=True)]
        )[:samples]
        self.cycles = cycles
        self.force = signal(cycles, np.atleast_1d(force))[np.newaxis]
        self.response = np.array([signal(cycles, row) for row in np.atleast_2d(shape)])
        random = np.random.default_rng(seed)
        for data in (self.force, self.response):
            data += noise * np.abs(data).max(axis=1, keepdims=True) * random.standard_normal(data.shape)

    def blocks(self, topic: str, size: int | None = None) -> list[SampleBlock]:
        """Blocks of a topic; another size than the oscillator's block needs a constant frequency."""
        size = size or self.block
        data, quantity, points = (
            (self.force, Quantity.FORCE, (2,)) if topic == "force" else (self.response, self.quantity, POINTS)
        )
        result = []
        for start in range(0, self.samples, size):
            index = start // self.block
            frequency = self.frequencies[index]
            cycles = self.starts[index] + frequency * (start - index * self.block) / RATE
            oscillator = (
                OscillatorPhase(cycles % 1.0, frequency) if self.known_phase else OscillatorPhase(math.nan, math.nan)
            )
            result.append(
                SampleBlock(
                    start,
                    RATE,
                    quantity,
                    quantity.unit,
                    tuple(f"{topic[0]}{point}" for point in points),
                    points,
                    np.ascontiguousarray(data[:, start : start + size]),
                    oscillator,
                )
            )
        return result

    def feed(self, extractor: Extractor, size: int | None = None) -> None:
        for pair in interleaved(self.blocks("force", size), self.blocks(self.quantity.topic, size)):
            for block in pair:
                extractor.add_block(block.quantity.topic, block)


def interleaved(*streams: list[SampleBlock]) -> Iterator[tuple[SampleBlock, ...]]:
    return zip(*streams, strict=True)


def lock_event(first: int, samples: int, periods: int, **changes: object) -> LockEvent:
    values = {
        "level_index": 0,
        "level": 0.1,
        "level_unit": "V",
        "sample": max(0, first - 1),
        "frequency_hz": FREQUENCY,
        "phase_error": 0.0,
        "window_first_sample": first,
        "window_samples": samples,
        "window_periods": periods,
    }
    return LockEvent(**{**values, **changes})


def extract(
    stream: Stream,
    lock: LockEvent,
    linear: LinearDescription | None = None,
    settings: ExtractionSettings = SETTINGS,
    size: int | None = None,
) -> ModalPoint:
    """The only point of a stream with one lock event and no loop states."""
    extractor = Extractor(linear or linear_description(), settings, require_loop_state=False)
    extractor.add_lock(lock)
    stream.feed(extractor, size)
    (point,) = [*extractor.take(), *extractor.finish()]
    return point


def in_phase_case(damping: float = 0.012, amplitude: float = 1e-3, shapes: np.ndarray = SHAPES):
    """Force and shape of a pure first mode in phase resonance with a damping ratio.

    From ½ |F| ω |ψ_k| = ½ ξ ω² q² with ξ = 2 δ ω: |F| = 2 δ ω² q² / |ψ_k|.
    """
    shape = shapes[:, 0] * amplitude
    force = 1j * 2.0 * damping * OMEGA**2 * amplitude**2 / shape[0]
    return force, shape
