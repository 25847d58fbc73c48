"""Frequency responses at held amplitudes: harmonic balance of the nonlinear model at every line.

A frequency response at a held force has folds: near them it changes without limit while the parameters of a model
hardly do, and beyond them it is another branch. A fit of such values stalls. The way round is that the measured
response itself says how large the motion was. So each line is solved with that amplitude s given (which has one
solution, on whatever branch) and the model tells what it needs for it: the reference R(s), force or acceleration of
the base, in magnitude and phase. That is smooth in every parameter of the model, and nearly linear in most.

The error e of the measured magnitude enters twice, by the response itself and by s. With u = ln s,

    ln|R(s)| − ln(level) = ρ' e + e_level,     ρ' = ∂ ln|R| / ∂u,

so the response at the held level differs from the measured one by ρ / ρ', ρ being the left side. This is what a row
predicts where |ρ'| ≥ 1: the response at the held level, to first order in the difference, on the branch that was
measured. Towards a fold ρ' vanishes, and the response there would tell the level better than any laboratory holds it;
so no ρ counts for more than the noise of the response: where |ρ'| < 1 a row predicts ρ itself. The phase is corrected
by the same error e = ρ ρ' / max(ρ'², 1), and what stays unknown of that is part of its uncertainty. ρ' is noise
propagation, so it is traced about one solution (:func:`with_growth`) and the same for all models that are compared.
Where a strong nonlinearity meets light damping, e turns the phase by more than its first order about the measured
amplitude holds for. So that is taken about the amplitude that the solution has, as far as it is within the noise.

Where a jump was measured thus says which branch a line belongs to and nothing else: real jumps come early, by any
disturbance. :mod:`nmt_diagnose.measurements.stepped_responses.frequency_sweep` finds where a model itself would jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.driven_lines import solve_lines
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.periodic_kernel import DRIVEN, Closing, Limits, advance, target_rows
from nmt_diagnose.prediction.periodic_state import has_coordinates, shared_unknowns
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.rig_parts import RigParts, sliding
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.aft import LocalTables
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig, ShakingTableSection

if TYPE_CHECKING:
    from nmt_diagnose.measurements.stepped_responses.stepped_responses import SteppedResponses

HARMONICS = 5


@dataclass(frozen=True)
class SteppedSineState:
    """Solutions of all lines of a test.

    Attributes:
        keys: identity of the coordinates.
        tables: local elements and clock that the forces belong to.
        z, forces, inverses, slopes: as the kernel gives them; NaN in ``z`` where a line has no solution.
        responses: (lines, channels) over the reference.
        growth: ∂ ln R / ∂ ln s of each line, complex, (lines,).
        moved: ln of the amplitude given over the measured one, (lines,).
    """

    keys: tuple[str, ...]
    tables: LocalTables
    clock: float
    z: FloatArray
    forces: FloatArray
    inverses: FloatArray
    slopes: ComplexArray
    responses: ComplexArray
    growth: ComplexArray
    moved: FloatArray


class SteppedSinePredictor(Predictor):
    """Predicts one test of frequency responses at a held amplitude.

    Args:
        test: the test.
        rows: its rows; ``level`` is the line.
        settings: of the predictor.

    Raises:
        BenchError: an unknown reference, or one that was held in a way the model cannot follow.
    """

    def __init__(self, test: SteppedResponses, rows: Rows, settings: PredictionSettings) -> None:
        if test.reference not in ("force", "base", "voltage"):
            raise BenchError(f"test {test.name}: reference {test.reference!r} is unknown; use force, base or voltage.")
        if test.held not in (test.reference, "response"):
            raise BenchError(
                f"test {test.name}: {test.held} was held, but the responses refer to the {test.reference}; give "
                "responses over what was held, or the measured amplitude of the reference at each line."
            )
        self.test, self.rows, self.settings = test, rows, settings
        channels = [*test.channels]
        if test.reference == "force":
            channels.append(force_channel(test))
        self.channels = tuple(channels)
        self.moved = moved_of(test)
        self.amplitudes = test.amplitudes * test.scale * np.exp(self.moved)
        self.growth = growth_of(test)
        # A motion that is imposed has no harmonics, whatever the force has.
        basis = FourierBasis.up_to(1 if test.imposed else HARMONICS)
        self.use(Setup(test.drive_points, test.reference == "force", self.channels, basis))

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        self.setup = setup
        self._own = np.array(setup.index(self.channels), dtype=np.int64)

    @property
    def levels(self) -> tuple[SteppedResponses, ...]:
        """One set of lines."""
        return (self.test,)

    def parts(self, rig: Rig, cache: PartsCache) -> RigParts:
        """The rig taken apart.

        Raises:
            BenchError: the responses refer to a base that the model does not have.
        """
        if self.test.reference == "base" and not isinstance(rig.exciter, ShakingTableSection):
            raise BenchError(
                f"test {self.test.name} is over the acceleration of the base, but the exciter of rig {rig.name} is no "
                "shaking table; write exciter: {kind: shaking_table, point: …} in the model."
            )
        return cache.parts(rig, self.setup)

    def solve(
        self, rig: Rig, cache: PartsCache, start: tuple[SteppedSineState | None, ...] | None
    ) -> list[SteppedSineState | None]:
        """One state for all lines."""
        parts = self.parts(rig, cache)
        before = start[0] if start else None
        lines = self.amplitudes.size
        size = parts.coordinates * parts.basis.size + 2
        if before is not None and before.keys == parts.keys:
            known = np.isfinite(before.z[:, 0])
            first = np.where(known[:, None], before.z, 0.0)
        else:
            known, first = np.zeros(lines, dtype=bool), np.zeros((lines, size))
        asked = self._closing, self._targets(parts)
        how = parts.first_input, parts.kernel_tables, Limits(self.settings.iterations, self.settings.tolerance)
        good, z, forces, inverses, values, slopes = solve_lines(first, known, *asked, *parts.resting, *how)
        if not good.all() and parts.tables.elements.jenkins.size:
            # Far beyond the slip of a stiff contact nothing leads there from rest.
            unknown = np.zeros_like(known)
            other, *found = solve_lines(np.zeros_like(first), unknown, *asked, *sliding(parts), *how)
            taken = other & ~good
            for kept, more in zip((z, forces, inverses, values, slopes), found, strict=True):
                kept[taken] = more[taken]
            good = good | taken
        z[~good] = np.nan
        responses, reference = self._over_reference(parts, z, values)
        # The closure's rows are its real and imaginary part: one of the real one is the change by s.
        local = size - 2
        along = inverses[:, :, local] * self.amplitudes[:, None]
        change = along[:, local] + 1j * along[:, local + 1]
        if self.test.reference == "force":
            change = np.einsum("lk,lk->l", slopes[:, self._own[-1], 0], along)
        elif self.test.reference == "voltage":
            change = change / parts.input_per_volt[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            growth = change / reference
        growth = np.asarray(growth)
        keys, tables, clock = parts.keys, parts.tables, parts.clock
        state = SteppedSineState(keys, tables, clock, z, forces, inverses, slopes, responses, growth, self.moved)
        return [state]

    def stepped(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> list[SteppedSineState | None]:
        """Solutions of a slightly different rig by one Newton step from ``states``."""
        state = states[0]
        assert state is not None
        parts = self.parts(rig, cache)
        if not has_coordinates(state.keys, parts.keys):
            # A coordinate with a force is gone: nothing of the Jacobians can be kept.
            return self.solve(rig, cache, None)
        same = parts.keys == state.keys and parts.clock == state.clock and _same_tables(parts.tables, state.tables)
        shared = shared_unknowns(state.keys, parts.keys, parts.basis.size)
        z, values = advance(
            state.z, state.forces if same else state.forces[:0], shared, state.inverses, state.slopes, self._closing,
            self._targets(parts), parts.first_input[None], parts.kernel_tables,
        )  # fmt: skip
        responses, _ = self._over_reference(parts, z, values)
        return [replace(state, keys=parts.keys, z=z, responses=responses)]

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the test's rows; see the module."""
        state = states[0]
        result = np.full(len(self.rows), np.nan)
        if state is None:
            return result
        magnitude, phase = self.predicted(state)
        rows = self.rows
        for part, values in ((Part.LOG_MAGNITUDE, magnitude), (Part.PHASE, phase)):
            which = rows.part == part
            result[which] = values[rows.level[which], rows.channel[which]]
        result[np.isinf(result)] = np.nan
        return result

    def predicted(self, state: SteppedSineState) -> tuple[FloatArray, FloatArray]:
        """ln of the magnitudes and phases (rad) that the rows predict, each (lines, channels)."""
        measured = self.test.measured
        with np.errstate(divide="ignore", invalid="ignore"):
            log_ratio = np.log(measured / state.responses)
        if self.test.held == "response":
            left = log_ratio
        else:
            left = whitened_difference(at_measured(log_ratio, self.growth, self.moved), self.growth, self.test.noise)
        return np.log(np.abs(measured)) - left.real, np.angle(measured) - left.imag

    @property
    def _closing(self) -> Closing:
        return Closing(DRIVEN, int(self._own[0]))

    def _targets(self, parts: RigParts) -> FloatArray:
        return target_rows(self.amplitudes, omega=2.0 * np.pi * self.test.lines_hz * parts.clock)

    def _over_reference(
        self, parts: RigParts, z: FloatArray, values: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Responses (lines, channels) over the reference, and the reference (lines,)."""
        if self.test.reference == "force":
            reference = values[:, self._own[-1], 0]
        else:
            reference = z[:, -2] + 1j * z[:, -1]
            if self.test.reference == "voltage":
                reference = reference / parts.input_per_volt[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            return values[:, self._own[: len(self.test.channels)], 0] / reference[:, None], reference


def force_channel(test: SteppedResponses) -> MeasuredChannel:
    """The force that the responses of a test are divided by."""
    return MeasuredChannel(f"f{test.drive_point}", Quantity.FORCE, test.drive_point)


def growth_of(test: SteppedResponses) -> ComplexArray:
    """∂ ln R / ∂ ln s that a test's noise is propagated by, (lines,): 1 of a linear rig."""
    return np.ones(test.lines_hz.size, dtype=np.complex128) if test.growth is None else test.growth


def moved_of(test: SteppedResponses) -> FloatArray:
    """ln of the amplitude that a model is given over the measured one, (lines,)."""
    return np.zeros(test.lines_hz.size) if test.moved is None else test.moved


def with_growth(test: SteppedResponses, state: SteppedSineState) -> SteppedResponses:
    """The test with its noise propagated as a solution says; lines without a solution as they were.

    An amplitude that is within its noise is moved to where the solution has it.
    """
    solved = np.isfinite(state.growth)
    growth = np.where(solved, state.growth, growth_of(test))
    if test.held == "response":
        return replace(test, growth=growth)
    # The amplitude that suits its own measurement, the level and the phase: amplitude and level alone may suit two.
    slope, turn = growth.real, -growth.imag * test.phase_known
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(test.measured[:, 0] / state.responses[:, 0])
    further = -slope * (log_ratio.real + state.moved) + turn * log_ratio.imag - state.moved
    moved = state.moved + further / (slope**2 + turn**2 + 1.0)
    # What is many times the noise is no error of the amplitude.
    moved = np.where(
        np.isfinite(moved),
        moved / (1.0 + (moved / (THRESHOLDS.prediction.largest_magnitude_sigmas * test.noise)) ** 4),
        0.0,
    )
    return replace(test, growth=growth, moved=np.where(solved, moved, moved_of(test)))


def at_measured(log_ratio: ComplexArray, growth: ComplexArray, moved: FloatArray) -> ComplexArray:
    """ln of measured over predicted responses at the measured amplitude, from there where the model was given another.

    Args:
        log_ratio: the same at the amplitude that the model was targets, (lines, channels).
        growth: ∂ ln R / ∂ ln s there, (lines,); the responses over R then go as 1 − growth.
        moved: ln of that amplitude over the measured one, (lines,).
    """
    return np.asarray(log_ratio + ((1.0 - growth) * moved)[:, None])


def gain_error(test: SteppedResponses, channel: int | None = None, error: complex = 1.0) -> ComplexArray:
    """Change of ln H that a relative error of a gain makes of the rows, (lines, channels).

    Real parts are rows for magnitudes, imaginary ones for phases. The amplitude that the model is given stays as it is:
    an error of that is one of the scale of all strengths, which no row shows.

    Args:
        test: the test.
        channel: the response whose gain is off; None = that of the reference, by which all are divided.
        error: of ln of the gain; i is an error of the phase.
    """
    log_ratio = np.full_like(test.measured, error)
    if channel is not None:
        log_ratio[:, np.arange(log_ratio.shape[1]) != channel] = 0.0
    return log_ratio if test.held == "response" else whitened_difference(log_ratio, growth_of(test))


def whitened_difference(log_ratio: ComplexArray, growth: ComplexArray, noise: FloatArray | None = None) -> ComplexArray:
    """What a response at the held level differs by from the measured one, ln of magnitude and phase in rad.

    Args:
        log_ratio: ln of the measured response over the one that the model has at the measured amplitude of the first
            channel, (lines, channels).
        growth: ∂ ln R / ∂ ln s, (lines,).
        noise: standard uncertainty of the magnitudes, (lines,): a difference many times as large is none of the
            amplitude, and corrects no other row; None = corrections are not bounded.

    Returns:
        (lines, channels); no component has a larger variance than the measured one's errors.
    """
    slope, turn = growth.real, -growth.imag
    sharpness = np.maximum(slope**2, 1.0)
    lead = log_ratio[:, 0].real / np.sqrt(sharpness)
    # The error of the first channel's magnitude, as far as the level tells it, and the part of it that stays unknown.
    error = (log_ratio[:, 0].real * slope / sharpness)[:, None]
    if noise is not None:
        most = THRESHOLDS.prediction.largest_magnitude_sigmas * noise[:, None]
        error = most * np.tanh(error / most)
    unknown = 1.0 - slope**2 / sharpness
    # Other responses follow the first in proportion: ∂ ln H ≈ 1 − ∂ ln R.
    fall = 1.0 - slope
    sizes = (log_ratio.real + fall[:, None] * error) / np.sqrt(1.0 + fall**2 * unknown)[:, None]
    phases = (log_ratio.imag + turn[:, None] * error) / np.sqrt(1.0 + turn**2 * unknown)[:, None]
    sizes[:, 0] = lead
    return np.asarray(sizes + 1j * phases)


def _same_tables(a: LocalTables, b: LocalTables) -> bool:
    """Whether two tables hold the same elements."""
    # Elements and their coordinates, and the number of samples; the rest follows from these.
    if a is b:
        return True
    pairs = zip((*a.elements, a.values), (*b.elements, b.values), strict=True)
    return all(x is y or (x.shape == y.shape and bool((x == y).all())) for x, y in pairs)
