"""The phase-locked loop of a rig with several exciters: one phase, and amplitudes and phases of all forces."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.numerics.arrays import ComplexArray
from nmt_core.vocabulary import AUTOMATIC, HarmonicsTarget, LoopState
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter
from nmt_pll.exciters.exciter_appropriation import AppropriationSetup, ExciterAppropriation, ForceMatrix
from nmt_pll.level_loop import LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.loop import PhaseLockedLoop
from nmt_pll.thresholds import HARMONICS


class AppropriatedLoop(PhaseLockedLoop):
    """As :class:`~nmt_pll.phase_loop.loop.PhaseLockedLoop` for the first exciter, which the others follow.

    Args:
        linear: linear description that names the exciters' points.
        settings, sample_rate, block_samples: as for one exciter.
        force_per_volt: force at every exciter per volt of every exciter.

    Attributes:
        appropriation: control of the exciters; None before the first level.

    Raises:
        BenchError: the linear description does not say enough for so many exciters.
    """

    def __init__(
        self,
        linear: LinearDescription,
        settings: LoopSettings,
        sample_rate: float,
        block_samples: int,
        force_per_volt: ForceMatrix,
    ) -> None:
        super().__init__(linear, settings, sample_rate, block_samples)
        self._matrix = force_per_volt
        self._shape_filter: AdaptiveFourierFilter | None = None
        self._shape_from: float = math.inf  # sample from which on that filter has forgotten its start
        self._rows: tuple[tuple[int, ...], tuple[int, ...], list[int], list[int]] = ((), (), [], [])
        self.appropriation: ExciterAppropriation | None = ExciterAppropriation(
            self._setup(1, False), linear, force_per_volt
        )

    def _setup(self, highest: int, modal: bool) -> AppropriationSetup:
        s = self.settings
        return AppropriationSetup(
            highest, modal, self.cutoff, self.block_duration, self._dead_time, self.dwell.length, s.voltage_limit,
            s.mac_limit, s.pbmif_limit,
        )  # fmt: skip

    def _check_modes(self, level: LevelCommand) -> None:
        """As many modes as exciters are enough; the constructor has seen to it."""

    def _prepare_harmonics(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        """Have a control of the exciters for the harmonics that a level asks for; the ratios stay."""
        wanted = level.harmonics_control
        highest = self._most_harmonics(HARMONICS.automatic_highest if wanted == AUTOMATIC else wanted) if wanted else 1
        modal = bool(wanted) and level.harmonics_target == HarmonicsTarget.MODAL
        before = self.appropriation
        if before is None or before.setup.highest != highest or before.setup.modal != modal:
            self.appropriation = ExciterAppropriation(self._setup(highest, modal), self.linear, self._matrix)
            if before is not None:
                kept = min(highest, before.setup.highest)
                self.appropriation.ratios[:, :kept] = before.ratios[:, :kept]
            self._shape_filter = None
        assert self.appropriation is not None
        channels = self.appropriation.exciters + len(self.linear.points)
        if self._shape_filter is None:
            tracked = max(highest + 1, self.settings.harmonics)
            self._shape_filter = AdaptiveFourierFilter(channels, tracked, self.cutoff, self.sample_rate)
            self._shape_from = end + self._filter_warm_up
        if was_quiet:
            self.appropriation.clear()
            self._shape_filter.reset()
            self._shape_from = end + self._filter_warm_up
        self.appropriation.start_level()

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of all forces and responses.

        Raises:
            ValueError: the blocks do not cover the same samples, or a channel at an exciter or a point of the linear
                description is missing.
        """
        forces, responses = self._channels(force, response)
        measured = self._shapes(np.concatenate([force.data[forces], response.data[responses]]), force)
        output = super().process(force, response)
        law = self.appropriation
        assert law is not None
        if self._amplitude > 0.0 and measured is not None and self._controls_exciters(force.end_sample, output):
            if self._judged_from - self._block_samples < force.end_sample <= self._judged_from:
                law.start_level()
            count = law.exciters
            amplitude = max(output.amplitude, self._amplitude_before)
            frequency = force.oscillator.frequency_hz
            law.update(measured[:count], measured[count:], response.quantity, frequency, amplitude)
        law.fit(max(output.amplitude, self._amplitude_before))
        return output._replace(terms=law.terms)

    def _channels(self, force: SampleBlock, response: SampleBlock) -> tuple[list[int], list[int]]:
        """Rows of the forces at the exciters and of the responses at the points of the linear description."""
        if self._rows[:2] != (force.points, response.points):
            rows = []
            for block, points in ((force, self.linear.exciter_points), (response, self.linear.points)):
                missing = [point for point in points if point not in block.points]
                if missing:
                    raise ValueError(f"no {block.quantity.topic} at point {missing[0]}, which several exciters need")
                rows.append([block.points.index(point) for point in points])
            self._rows = force.points, response.points, rows[0], rows[1]
        return self._rows[2], self._rows[3]

    def _shapes(self, data: np.ndarray, block: SampleBlock) -> ComplexArray | None:
        """Harmonics 1 … H of forces and responses after the block; None where the drive is not periodic."""
        phase = block.oscillator
        if self._shape_filter is None or self.appropriation is None:
            return None
        if math.isnan(phase.cycles) or not phase.frequency_hz > 0:
            return None
        values = self._shape_filter.process(data, phase.cycles, phase.frequency_hz, phase.rate_hz_s)
        if not np.isfinite(values).all():
            self._shape_filter.reset()
            self._shape_from = block.end_sample + self._filter_warm_up
            return None
        result: ComplexArray = values[:, 1 : 1 + self.appropriation.setup.highest].copy()
        return result

    def _controls_exciters(self, end: int, output: LoopOutput) -> bool:
        running = self.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED) and not self._decaying
        valid = not math.isnan(output.phase_error)
        return running and valid and end > max(self._closed_from, self._shape_from)

    @property
    def _harmonics_obstacle(self) -> str:
        """What keeps forces and shape from being settled, empty if nothing does."""
        return "" if self.appropriation is None else self.appropriation.obstacle

    @property
    def _settled_words(self) -> str:
        return "" if self.appropriation is None else self.appropriation.summary
