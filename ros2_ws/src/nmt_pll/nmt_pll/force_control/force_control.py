"""Control of all forces next to the phase loop, from blocks to terms of the drive: filter, targets and law."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import DriveTerm, LevelCommand
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import HarmonicsTarget
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter
from nmt_pll.force_control.force_controller import ForceController, ForceSetup, integral_rate, most_harmonics
from nmt_pll.force_control.force_per_volt import ForcePerVolt, fundamental_gain, start_ratios, table_of
from nmt_pll.force_control.force_targets import ForceTargets
from nmt_pll.force_control.modal_power_ratio import ModalPowerRatio, check_modes
from nmt_pll.force_control.mode_shape_targets import ModeShapeTargets, check_exciters
from nmt_pll.loop_settings import LoopSettings


class ForceControl:
    """Harmonics of one exciter where a level asks for them; of several exciters the fundamentals at every level.

    Args:
        linear: linear description; it names the points of several exciters.
        settings: loop settings.
        sample_rate: Hz.
        block_samples: samples a block.
        cutoff: ω_LP of the phase loop's filter, rad/s.
        dead_time: mean delay between measurement and its effect, s.
        dwell_blocks: blocks over which what is settled is judged.
        highest_hz: highest frequency of the fundamental.
        force_per_volt: G(f) as far as it is known; None = as the linear description says.

    Attributes:
        law: the controller; None where there is nothing to control.

    Raises:
        BenchError: the linear description does not say enough for its exciters.
    """

    def __init__(
        self,
        linear: LinearDescription,
        settings: LoopSettings,
        sample_rate: float,
        block_samples: int,
        cutoff: float,
        dead_time: float,
        dwell_blocks: int,
        highest_hz: float,
        force_per_volt: ForcePerVolt | None = None,
    ) -> None:
        self.linear = linear
        self.exciters = max(1, len(linear.exciter_points))
        self.law: ForceController | None = None
        self.targets = ForceTargets()
        self._settings = settings
        self._sample_rate = sample_rate
        self._block_samples = block_samples
        self._cutoff, self._dead_time, self._dwell_blocks = cutoff, dead_time, dwell_blocks
        self._highest_hz = highest_hz
        self._force_per_volt = force_per_volt or table_of(linear.exciter_force_rows, self.exciters)
        self._target = HarmonicsTarget.ZERO
        self._filter: AdaptiveFourierFilter | None = None
        self._valid_from: float = math.inf  # sample from which on the filter has forgotten its start
        self._rows: tuple[tuple[int, ...], tuple[int, ...], list[int], list[int]] = ((), (), [], [])
        self._quantity = Quantity.DISPLACEMENT
        if self.exciters > 1:
            check_exciters(linear, "Several exciters")
            self._make_law(1, HarmonicsTarget.ZERO)

    def highest(self, wanted: int) -> int:
        """Highest harmonic that can be controlled where so many are asked for."""
        return most_harmonics(self._highest_hz, self._sample_rate, self._cutoff, wanted)

    def check(self, level: LevelCommand) -> None:
        """Refuse (BenchError) the modal target where the linear description has too few modes."""
        if level.harmonics_control and level.harmonics_target == HarmonicsTarget.MODAL and self.exciters == 1:
            check_modes(self.linear, f"Level {level.index}")

    # -- levels --------------------------------------------------------------------------------------------------

    @property
    def _warm_up(self) -> int:
        """Samples after which the filter has forgotten its start."""
        return round(5.0 / self._cutoff * self._sample_rate)

    def _make_law(self, highest: int, target: HarmonicsTarget) -> None:
        """A law for so many harmonics; the fundamentals of the one before stay."""
        rate = integral_rate(self._cutoff, self._dead_time)
        s, start, gain = self._settings, None, None
        setup = ForceSetup(
            highest, self._cutoff, self._block_samples / self._sample_rate, s.latency_blocks, self._dead_time,
            self._dwell_blocks, s.voltage_limit, s.slew_limit, self._sample_rate,
        )  # fmt: skip
        modal = target is HarmonicsTarget.MODAL
        if self.exciters > 1:
            shape = ModeShapeTargets(self.linear, modal, rate, self._dwell_blocks, s.mac_limit, s.pbmif_limit)
            frequency = self.linear.frequency_hz
            start = start_ratios(self._force_per_volt, frequency, shape.linear_forces)
            gain = fundamental_gain(self._force_per_volt, frequency, rate, shape.linear_ratios)
            self.targets = shape
        else:
            self.targets = ModalPowerRatio(self.linear, rate) if modal else ForceTargets()
        before, self.law = self.law, ForceController(setup, self._force_per_volt, start, gain)
        if before is not None and self.exciters > 1:
            self.law.take_over(before)
        self._target = target
        self._filter = None
        self._rows = (), (), [], []

    def start_level(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        """Have a law for the harmonics that a level asks for; what was learnt stays while they are as many."""
        wanted = level.harmonics_control
        if wanted:
            highest, target = self.highest(wanted), HarmonicsTarget(level.harmonics_target)
            if self.law is None or self.law.setup.highest != highest or target != self._target:
                self._make_law(highest, target)
        if self.law is None:
            return
        self.law.off = not wanted
        if self._filter is None:
            # One harmonic more is tracked, so that it does not leak into the others.
            tracked = max(self.law.setup.highest + 1, self._settings.harmonics if self.exciters > 1 else 0)
            channels = self.exciters + len(self.targets.points)
            self._filter = AdaptiveFourierFilter(channels, tracked, self._cutoff, self._sample_rate)
            self._valid_from = end + self._warm_up
        if was_quiet:
            self.targets.clear()
            self.law.clear()
            self._filter.reset()
            self._valid_from = end + self._warm_up
        self.law.start_level()
        self.targets.restart_dwell()

    # -- one block -----------------------------------------------------------------------------------------------

    def measure(self, force: SampleBlock, response: SampleBlock, drive_point_row: int) -> ComplexArray | None:
        """Harmonics 1 … H after the block of the forces, then of the responses that the targets follow, (rows, H).

        None without a law, or with a drive that is not periodic.

        Args:
            force, response: blocks of the same samples.
            drive_point_row: row of the force of a single exciter.

        Raises:
            ValueError: a channel at an exciter or at a point that the targets follow is missing.
        """
        phase = force.oscillator
        if self._filter is None or self.law is None or math.isnan(phase.cycles) or not phase.frequency_hz > 0:
            return None
        self._quantity = response.quantity
        values = self._filter.process(
            self._samples(force, response, drive_point_row), phase.cycles, phase.frequency_hz, phase.rate_hz_s
        )
        if not np.isfinite(values).all():
            self._filter.reset()
            self._valid_from = math.inf
            return None
        result: ComplexArray = values[:, 1 : 1 + self.law.setup.highest].copy()
        return result

    def _samples(self, force: SampleBlock, response: SampleBlock, drive_point_row: int) -> FloatArray:
        if self._rows[:2] != (force.points, response.points):
            forces = _rows_of(force, self.linear.exciter_points) if self.exciters > 1 else [drive_point_row]
            self._rows = force.points, response.points, forces, _rows_of(response, self.targets.points)
        return np.concatenate([force.data[self._rows[2]], response.data[self._rows[3]]])

    def control(
        self,
        measured: ComplexArray | None,
        motion: complex,
        frequency_hz: float,
        amplitude: float,
        end: int,
        begins: bool,
        ramp_from: float,
    ) -> None:
        """One block of control.

        Args:
            measured: of `measure`; None where nothing is to be controlled.
            motion: fundamental of the drive-point response, any unit.
            frequency_hz: of the fundamental.
            amplitude: of the first exciter's fundamental, V; 0 = the drive goes to zero.
            end: sample after the block.
            begins: whether the loop is judged from this block on.
            ramp_from: V that the amplitude comes from where it is still on its way; else 0.
        """
        law = self.law
        if law is None:
            return
        if math.isinf(self._valid_from):
            self._valid_from = end + self._warm_up
        if amplitude == 0.0:
            law.rest()
        elif measured is None or not law.controls or end <= self._valid_from:
            law.idle(amplitude)
        else:
            if begins:
                law.restart_dwell()
                self.targets.restart_dwell()
            force, response = measured[: self.exciters], measured[self.exciters :]
            target = self.targets.targets(force, response, self._quantity, law.setup.block_duration)
            points = [motion] if self.exciters == 1 else response[:, 0].tolist()
            law.update(force, points, frequency_hz, amplitude, target, ramp_from)

    def drive_terms(self, amplitude: float) -> tuple[DriveTerm, ...]:
        """Terms of the drive for the next block, within the limits next to an amplitude, V, of this size."""
        if self.law is None:
            return ()
        self.law.fit(amplitude, self._highest_hz)
        return self.law.drive_terms()

    @property
    def obstacle(self) -> str:
        """What keeps forces and motion from being settled, empty if nothing does."""
        return "" if self.law is None else self.law.obstacle or self.targets.obstacle

    @property
    def summary(self) -> str:
        """How forces and motion are; empty if nothing is controlled."""
        if self.law is None:
            return ""
        kept, *given_up = self.law.summary.split("; ", 1)
        return "; ".join([", ".join(filter(None, [kept, self.targets.summary])), *given_up])


def _rows_of(block: SampleBlock, points: tuple[int, ...]) -> list[int]:
    missing = [point for point in points if point not in block.points]
    if missing:
        raise ValueError(f"no {block.quantity.topic} at point {missing[0]}, which control of the forces needs")
    return [block.points.index(point) for point in points]
