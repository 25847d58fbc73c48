"""How strong an effect is: standard deviations that are left after the model's own parameters took what they can.

Two tests without noise are compared, with the effect and without: harmonics of the locked windows and lines of the
random test. What the difference d amounts to is σ² = dᵀ (N + C Cᵀ)⁻¹ d, with N the noise of the sensors and the
repeatability of a test, and C the changes that shifts of the model's parameters by one prior standard deviation make,
together with the scatter of the phase at lock, of each level and of all levels alike. Where a laboratory's tolerances
are asked for, C also has what they change: a gain, a phase and a delay of every channel, a delay of all sensors of
a kind, the clock, and what an ordinary loop's phase leans by.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_blind.cases.blind_rigs import BlindRig
from nmt_blind.cases.injected_effects import InjectedEffect, Spot
from nmt_blind.cases.laboratory import BenchSettings, TrialError
from nmt_blind.cases.operating import Operating, noise_deviation, operating_point
from nmt_blind.cases.priors import parameters, shifted
from nmt_blind.cases.quiet_tests import QuietRecord, QuietWindow, play_backbone, play_random
from nmt_blind.cases.rig_edits import Edit, with_edits
from nmt_blind.cases.tolerances import (
    CLOCK,
    DELAY_S,
    GAIN,
    LEAST_LEAD,
    MAINS,
    PHASE_DEG,
    SHARED_DELAY_S,
    check_tolerances,
    has_lead,
)
from nmt_core.blocks import FloatArray
from nmt_core.errors import BenchError
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import Rig

# Repeatability of a test besides noise: relative scatter of the locked frequency, of fundamentals, and of other
# harmonics over the fundamental; phase at lock of each level, rad.
FREQUENCY = 3e-5
FUNDAMENTAL = 1e-4
HARMONIC = 2e-5
PHASE_AT_LOCK = 1e-3
# What all levels of a run lean to one side by when they lock, rad: measured on null cases of both blind rigs.
PHASE_LEAN = 6e-4
ORDERS = range(6)
LINES = 100
"""Lines of the random test spread over its band; as many again near the modes."""
_NEIGHBOURS = 4
# Small and central: parameters that move a narrow resonance to either side must cancel.
_STEP = 0.1
# Size over σ from which a difference counts as imitated by parameters; how often and how far they are shifted then,
# and what is not worth another turn, prior standard deviations.
_IMITATED = 5.0
_TURNS = 12
_LARGEST_STEP = 1.5
_LARGEST_TOGETHER = 3.0
_SMALL_STEP = 0.2
# Of the steps, where one made it worse.
_LEAST_DAMPING, _MORE_DAMPING = 1e-3, 10.0
# Turns end where one takes less of what is left.
_WORTH = 0.05
# Share of a linear estimate that is left after such turns, from which the estimate may stand for the strongest.
_MOSTLY = 0.5
_PHASE_STEP = 1e-2

# The loop of a laboratory: the same two.
LABORATORY_PHASE_AT_LOCK = math.radians(0.25)
LABORATORY_PHASE_LEAN = math.radians(0.5)
_CHAIN_STEPS = {"gain": 1e-3, "delay_s": 1e-5, "clock_error": 1e-5}

MIDDLE, STRONGEST, WEAK = 64.0, 4096.0, 8.0
"""Strengths that are searched for: what parameters or tolerances imitate nearly does not grow in proportion."""
COMPARED = 16.0
"""Strength at which signatures are compared, standard deviations."""
# ln of how far from it a signature may have been taken that does not grow in proportion.
_ALIKE = math.log(3.0)
# Between these multiples of a target a strength is near enough: the others follow by interpolation.
_CLOSE = {MIDDLE: (0.15, 6.0), STRONGEST: (0.7, 4.0), WEAK: (0.4, 2.5)}
_TRIALS = 4
_FEWEST_LEVELS = 8


BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Observed:
    """Observables of a pair of tests: values, noise (standard deviations), both (m,), and the level of each row."""

    values: FloatArray
    noise: FloatArray
    level: FloatArray


@dataclass(frozen=True, eq=False)
class _Shifted:
    """The model with shifts made, in standard deviations (k,): its observables (m,), their changes, and σ left."""

    made: FloatArray
    values: FloatArray
    changes: FloatArray
    left: float


class Sensitivity:
    """Strength of changes of one rig.

    Args:
        rig: the blind rig.
        tolerances: of the measuring chain, ``none`` or ``laboratory``.
    """

    def __init__(self, rig: BlindRig, tolerances: str = "none") -> None:
        self.rig = rig
        self.tolerances = check_tolerances(tolerances)
        self.model = rig.model()
        self.bench: BenchSettings = rig.bench
        self.operating: Operating = operating_point(self.model, self.bench)
        self._lines = _line_bins(self.model, self.bench)
        self._hum = MAINS if tolerances == "laboratory" else 0.0
        self.base = self.observe(self.model)
        # The edit that makes a number of standard deviations of a change; None = it stays linear.
        self._made: list[Callable[[float], Edit] | None] = []
        # What a standard deviation of a change adds to the delay of sensors: number of the change, sensor, s.
        self._late: list[tuple[int, int, float]] = []
        self._nuisance = self._nuisances()

    def observe(self, truth: Rig) -> Observed:
        """Play both tests.

        Raises:
            TrialError: a test cannot be made on this truth.
        """
        windows = play_backbone(truth, self.model, self.bench)
        record = play_random(truth, self.model, self.bench)
        noise = {self.model.sensor_channel(s): noise_deviation(self.model, s) for s in self.model.sensors}
        values, deviations, levels = [], [], []
        for level in range(len(self.bench.levels)):
            window = windows.get(level)
            rows = self._window_rows(window, noise)
            values.append(rows[0])
            deviations.append(rows[1])
            levels.append(np.full(rows[0].size, float(level)))
        random = self._record_rows(record, noise)
        values.append(random[0])
        deviations.append(random[1])
        levels.append(np.full(random[0].size, -1.0))
        return Observed(np.concatenate(values), np.concatenate(deviations), np.concatenate(levels))

    def _window_rows(self, window: QuietWindow | None, noise: dict[str, float]) -> tuple[FloatArray, FloatArray]:
        channels = sum(sensor.quantity != "voltage" for sensor in self.model.sensors)
        if window is None:
            size = 1 + channels * (2 * len(ORDERS) + 2)
            return np.full(size, math.nan), np.full(size, math.nan)
        values, deviations = [math.log(window.frequency_hz)], [FREQUENCY]
        for row, name in enumerate(window.channels):
            deviation = noise[name] * math.sqrt(2.0 / window.samples)
            fundamental = abs(window.amplitudes[row, 1])
            for order in ORDERS:
                value = complex(window.amplitudes[row, order])
                scatter = (FUNDAMENTAL if order == 1 else HARMONIC) * fundamental
                if order == 0 and not name.startswith("x"):
                    scatter = math.inf  # a constant means nothing in forces and accelerations
                values += [value.real, value.imag]
                deviations += [math.hypot(deviation, scatter)] * 2
            values += [float(window.mains[row].real), float(window.mains[row].imag)]
            hum = self._hum * self.operating.channels[name]
            deviations += [math.hypot(deviation, HARMONIC * fundamental, hum)] * 2
        return np.array(values), np.array(deviations)

    def _record_rows(self, record: QuietRecord, noise: dict[str, float]) -> tuple[FloatArray, FloatArray]:
        """Least-squares responses to the voltage over a few neighbouring lines each, with their noise."""
        size = record.voltage.size
        u = np.fft.rfft(record.voltage)
        y = np.fft.rfft(record.data, axis=1)
        near = self._lines[:, np.newaxis] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
        power = (np.abs(u[near]) ** 2).sum(axis=1)
        response = (np.conj(u[near]) * y[:, near]).sum(axis=2) / power
        deviation = np.array([noise[name] for name in record.channels])[:, np.newaxis] * np.sqrt(0.5 * size / power)
        deviation = np.hypot(deviation, FUNDAMENTAL * np.abs(response))
        values = np.concatenate([response.real.ravel(), response.imag.ravel()])
        return values, np.concatenate([deviation.ravel(), deviation.ravel()])

    def _nuisances(self) -> FloatArray:
        """Changes by one standard deviation: of each parameter, and of the phase at lock, (m, k)."""
        columns = []
        for path, (value, std) in parameters(self.model).items():
            up, down = (
                self.observe(with_edits(self.model, (shifted(path, value, std, step),))).values
                for step in (_STEP, -_STEP)
            )
            columns.append((up - down) / (2.0 * _STEP))
            self._made.append(partial(shifted, path, value, std))
        laboratory = self.tolerances == "laboratory"
        lean = LABORATORY_PHASE_LEAN if laboratory else PHASE_LEAN
        change = self._change(_leaning(_PHASE_STEP)) / _PHASE_STEP
        columns.append(change * lean)
        self._made.append(lambda deviation: _leaning(lean * deviation))
        for level in range(len(self.bench.levels)):
            scatter = LABORATORY_PHASE_AT_LOCK if laboratory else PHASE_AT_LOCK
            columns.append(np.where(self.base.level == level, change * scatter, 0.0))
            self._made.append(None)
        if laboratory:
            columns += self._chain()
        return np.nan_to_num(np.stack(columns, axis=1))

    def _change(self, edit: Edit) -> FloatArray:
        """Change of the observables by an edit of the model."""
        result: FloatArray = self.observe(with_edits(self.model, (edit,))).values - self.base.values
        return result

    def _chain(self) -> list[FloatArray]:
        """Changes by one standard deviation of everything that a laboratory's measuring chain is off by."""
        columns: list[FloatArray] = []
        # Delays of the sensors of each kind: their numbers, and the change of all together.
        kinds: dict[str, tuple[list[int], FloatArray]] = {}
        for index, sensor in enumerate(self.model.sensors):
            path = ("sensors", index)
            if sensor.quantity == "voltage":
                # The random responses are referred to it.
                columns.append(GAIN * np.where(self.base.level < 0, self.base.values, 0.0))
                self._made.append(None)
                continue
            step = _CHAIN_STEPS["gain"]
            columns.append(GAIN * self._change(Edit((*path, "gain"), sensor.gain * (1.0 + step))) / step)
            self._made.append(partial(_louder, (*path, "gain"), sensor.gain))
            step = _CHAIN_STEPS["delay_s"]
            delay = self._change(Edit((*path, "delay_s"), sensor.delay_s + step)) / step
            columns.append(DELAY_S * delay)
            self._late.append((len(self._made), index, DELAY_S))
            self._made.append(None)
            members, late = kinds.get(sensor.quantity, ([], np.zeros(self.base.values.size)))
            kinds[sensor.quantity] = ([*members, index], late + delay)
            if has_lead(sensor.quantity) and sensor.high_pass_hz is None:
                lead = math.radians(PHASE_DEG)
                corner = self.operating.omega / (2.0 * math.pi) * math.tan(lead)
                columns.append(self._change(Edit((*path, "high_pass_hz"), corner)))
                self._made.append(partial(_leading, (*path, "high_pass_hz"), corner))
        shared = SHARED_DELAY_S / math.sqrt(3.0)
        for members, late in kinds.values():
            columns.append(shared * late)
            self._late += [(len(self._made), sensor, shared) for sensor in members]
            self._made.append(None)
        step = _CHAIN_STEPS["clock_error"]
        columns.append(CLOCK * self._change(Edit(("clock_error",), self.model.clock_error + step)) / step)
        clock = self.model.clock_error
        self._made.append(lambda deviation: Edit(("clock_error",), clock + CLOCK * deviation))
        return columns

    def sigma_of(self, observed: Observed) -> float:
        """Standard deviations by which observables differ from what the model can be made to say.

        Where parameters and the measuring chain imitate nearly all of a difference, or would have to be shifted far, a
        linear estimate leaves its own error: the model is observed again with the shifts made, step by step.

        Raises:
            TrialError: too few levels locked, or the shifted model cannot be tested.
        """
        none = np.zeros(self._nuisance.shape[1])
        locked = self.base.level >= 0
        size, found, shifts = self._fitted(observed, self.base.values, none)
        own = np.array([edit is not None for edit in self._made])
        own[[number for number, _, _ in self._late]] = True
        largest = float(np.max(np.abs(shifts[own])))
        imitated = size > _IMITATED * found
        if not imitated:
            windows, rest, _ = self._fitted(observed, self.base.values, none, rows=locked)
            imitated = windows > _IMITATED * rest
        if largest < _SMALL_STEP or not (imitated or largest > _LARGEST_STEP):
            return found
        start = _Shifted(none, self.base.values, self._nuisance, self._left(observed, self.base.values, none, own))
        # Locked windows tell by how much a resonance has moved where lines of the random test, further off than its
        # width, no longer do.
        by_windows = self._walked(observed, start, own, locked)
        # Shifts that only cancel together go at one pace; one that asks for too much must not hold up the others.
        paces = [self._walked(observed, start, own, None, together) for together in (True, False)]
        return self._settled(observed, min(by_windows, *paces, key=lambda found: found.left), own).left

    def _walked(
        self, observed: Observed, start: _Shifted, own: BoolArray, rows: BoolArray | None, together: bool = False
    ) -> _Shifted:
        """Where σ is least on the way that ``rows`` of the observables ask for, step by step; None = all rows."""
        best = here = start
        for _ in range(_TURNS):
            try:
                step, moved = self._step(observed, here, own, 0.0, rows, together)
            except TrialError:
                if here is start:
                    raise
                break  # as far as the shifted model can be tested
            settled = float(np.max(np.abs(step))) < _SMALL_STEP
            here = moved
            if here.left < best.left:
                best = here
            if settled:
                break
        return best

    def _settled(self, observed: Observed, start: _Shifted, own: BoolArray) -> _Shifted:
        """The best shifts from others on, every step of which leaves less (Levenberg and Marquardt)."""
        best, damping = start, 0.0
        for _ in range(_TURNS):
            try:
                step, moved = self._step(observed, best, own, damping)
            except TrialError:
                break
            if not moved.left < best.left:
                if float(np.max(np.abs(step))) < _SMALL_STEP:
                    break
                # What was learned of the changes serves the next step all the same.
                best, damping = replace(best, changes=moved.changes), max(_MORE_DAMPING * damping, _LEAST_DAMPING)
                continue
            enough = moved.left > (1.0 - _WORTH) * best.left
            best, damping = moved, damping / _MORE_DAMPING
            if enough:
                break
        return best

    def _step(
        self,
        observed: Observed,
        here: _Shifted,
        own: BoolArray,
        damping: float,
        rows: BoolArray | None = None,
        together: bool = False,
    ) -> tuple[FloatArray, _Shifted]:
        """The next step, standard deviations (k,), and the model after it.

        What is too long is shortened: each shift on its own, or all ``together``.

        Raises:
            TrialError: the shifted model cannot be tested.
        """
        wanted = self._fitted(observed, here.values, here.made, here.changes, damping, rows)[2]
        step = np.where(own, wanted - here.made, 0.0)
        if together:
            step *= min(1.0, _LARGEST_TOGETHER / max(float(np.max(np.abs(step))), 1e-300))
        else:
            step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        made = here.made + step
        try:
            values = self.observe(with_edits(self.model, self._edits(made))).values
        except BenchError as error:
            raise TrialError(str(error)) from error
        # Along the step the changes are known now (Broyden's update).
        missed = np.nan_to_num(values - here.values - here.changes @ step)
        changes = here.changes + np.outer(missed, step) / max(float(step @ step), 1e-12)
        return step, _Shifted(made, values, changes, self._left(observed, values, made, own))

    def _left(self, observed: Observed, values: FloatArray, made: FloatArray, own: BoolArray) -> float:
        """σ with some shifts made; only changes that cannot be made are fitted."""
        good, scale = self._good(observed, values)
        d = (observed.values - values)[good] * scale
        c = self._nuisance[good][:, ~own] * scale[:, np.newaxis]
        shifts = np.linalg.solve(np.eye(c.shape[1]) + c.T @ c, c.T @ d)
        rest = d - c @ shifts
        return math.sqrt(float(rest @ rest + shifts @ shifts + made @ made))

    def _good(
        self, observed: Observed, values: FloatArray, rows: BoolArray | None = None
    ) -> tuple[BoolArray, FloatArray]:
        """Rows that compare, shape (m,), and one over the noise of each of them.

        Raises:
            TrialError: too few levels locked.
        """
        good = np.isfinite(observed.values) & np.isfinite(values) & np.isfinite(self.base.noise)
        levels = np.unique(self.base.level[good & (self.base.level >= 0)]).size
        if levels < min(_FEWEST_LEVELS, len(self.bench.levels)):
            raise TrialError(f"only {levels} levels locked")
        if rows is not None:
            good &= rows
        return good, 1.0 / self.base.noise[good]

    def _edits(self, shifts: FloatArray) -> list[Edit]:
        """Edits of the model that make so many standard deviations of every change that does not stay linear."""
        edits = [edit(float(shift)) for edit, shift in zip(self._made, shifts, strict=True) if edit and shift]
        delays: dict[int, float] = {}
        for number, sensor, size in self._late:
            delays[sensor] = delays.get(sensor, 0.0) + size * float(shifts[number])
        for sensor, delay in delays.items():
            late = max(self.model.sensors[sensor].delay_s + delay, -LEAST_LEAD / self.model.sample_rate_hz)
            edits.append(Edit(("sensors", sensor, "delay_s"), late))
        return edits

    def _fitted(
        self,
        observed: Observed,
        values: FloatArray,
        shifts: FloatArray,
        changes: FloatArray | None = None,
        damping: float = 0.0,
        rows: BoolArray | None = None,
    ) -> tuple[float, float, FloatArray]:
        """Size of the difference from the plain model, σ after the best shifts about given ones, and these.

        ``damping`` shortens the step to them, most where the observables say most (Marquardt).
        """
        good, scale = self._good(observed, values, rows)
        d = (observed.values - values)[good] * scale
        c = (self._nuisance if changes is None else changes)[good] * scale[:, np.newaxis]
        normal = c.T @ c
        normal = np.eye(c.shape[1]) + normal + damping * np.diag(np.diag(normal))
        step = np.linalg.solve(normal, c.T @ d - shifts)
        rest, total = d - c @ step, shifts + step
        whole = np.nan_to_num((observed.values - self.base.values)[good] * scale)
        return float(np.linalg.norm(whole)), math.sqrt(float(rest @ rest + total @ total)), total

    def signature(self, effect: InjectedEffect, spot: Spot, value: float) -> FloatArray:
        """What an effect changes over the noise, shape (m,); zero where a level did not lock."""
        try:
            observed = self.observe(with_edits(self.model, effect.edits(self.model, self.operating, spot, value)))
        except (BenchError, TrialError):
            return np.zeros(self.base.values.size)
        return self._reduced(observed)

    def _reduced(self, observed: Observed) -> FloatArray:
        """Change of observables over the noise, shape (m,)."""
        result: FloatArray = np.nan_to_num((observed.values - self.base.values) / self.base.noise)
        return result

    def products(self, signatures: FloatArray) -> FloatArray:
        """Products of signatures, shape (m, k), after the model's parameters took their part, shape (k, k)."""
        c = np.nan_to_num(self._nuisance / self.base.noise[:, np.newaxis])
        along = c.T @ signatures
        result: FloatArray = signatures.T @ signatures - along.T @ np.linalg.solve(np.eye(c.shape[1]) + c.T @ c, along)
        return result

    def sigma(self, edits: Sequence[Edit]) -> float:
        """Standard deviations that changes of the rig file amount to.

        Raises:
            TrialError: a test cannot be made with them.
        """
        return self.sigmas(edits, True)[0]

    def sigmas(self, edits: Sequence[Edit], refine: bool) -> tuple[float, float, FloatArray]:
        """Standard deviations of changes, as `sigma_of` finds them, by the linear estimate alone, and their signature.

        Args:
            edits: changes of the rig file.
            refine: False = the linear estimate for both: one pair of tests.

        Raises:
            TrialError: a test cannot be made with them.
        """
        try:
            truth = with_edits(self.model, edits)
        except BenchError as error:
            raise TrialError(str(error)) from error
        observed = self.observe(truth)
        linear = self._fitted(observed, self.base.values, np.zeros(self._nuisance.shape[1]))[1]
        return (self.sigma_of(observed) if refine else linear), linear, self._reduced(observed)

    def curve(
        self, effect: InjectedEffect, spot: Spot, former: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], FloatArray | None]:
        """Strengths of an effect at a spot with their standard deviations, ascending; up to 4,096 where it gets there.

        Args:
            effect: the injected effect.
            spot: where.
            former: an older curve; the search starts from its strength of 64 standard deviations.

        Returns:
            ``points``: strength and standard deviations; ``trouble``: why it does not get stronger, empty if it does.
            And its signature, for what it has in common with others; None where none was near `COMPARED`.
        """
        signatures: dict[float, FloatArray] = {}
        tried: list[tuple[float, float]] = []
        shares: dict[float, float] = {}
        trouble = ""

        def trial(value: float, refine: bool) -> None:
            nonlocal trouble
            try:
                found, linear, signature = self.sigmas(effect.edits(self.model, self.operating, spot, value), refine)
                if refine:
                    shares[found] = found / linear
                    signatures[found] = signature
                else:
                    # The model's parameters take the same share of the strongest as of what was measured in full.
                    found = linear * min(shares.items(), default=(0.0, 1.0), key=lambda item: abs(item[0] - MIDDLE))[1]
            except TrialError as error:
                trouble = str(error)
                found = math.nan
            tried.append((value, found))

        guess = value_at(former, MIDDLE) if former else None
        if guess is None:
            guess = self.rig.caution * effect.guess(self.model, self.operating, spot)
        largest = effect.limit(self.model, self.operating, spot)
        for target in (MIDDLE, STRONGEST, WEAK):
            # What is imitated at the middle strength is so at the strongest: there in full, too.
            refine = target < STRONGEST or min(shares.values(), default=1.0) < _MOSTLY
            _approach(partial(trial, refine=refine), tried, target, min(guess, largest), largest)
        points = sorted((value, found) for value, found in tried if math.isfinite(found) and found > 0.0)
        rounded = [[float(f"{v:.6g}"), float(f"{s:.5g}")] for v, s in points]
        reached = max((s for _, s in points), default=0.0)
        limit = "" if reached >= _CLOSE[STRONGEST][0] * STRONGEST else trouble or "as strong as it can be"
        # What grows in proportion keeps the direction of its signature.
        farthest = math.inf if effect.proportional else _ALIKE
        near = min((abs(math.log(max(s, 1e-300) / COMPARED)), s) for s in signatures) if signatures else (math.inf, 0.0)
        signature = signatures[near[1]] if near[0] < farthest else None
        return {"points": rounded, "proportional": effect.proportional, "trouble": limit}, signature


def _leaning(phase: float) -> Edit:
    """A loop that holds another phase, rad."""
    return Edit(("pll",), {"phase_offset_rad": phase}, "merge")


def _louder(path: tuple[str | int, ...], gain: float, deviation: float) -> Edit:
    """A gain that is off by so many standard deviations."""
    return Edit(path, gain * (1.0 + GAIN * deviation))


def _leading(path: tuple[str | int, ...], corner: float, deviation: float) -> Edit:
    """A high-pass that leads by so many standard deviations; none leads by less than nothing."""
    return Edit(path, max(corner * deviation, 1e-6 * corner))


def _approach(
    trial: Callable[[float], None], tried: list[tuple[float, float]], target: float, guess: float, largest: float
) -> None:
    """Try values until one lies near the target, by interpolation on logarithmic scales."""
    least, most = (share * target for share in _CLOSE[target])
    for _ in range(_TRIALS):
        good = sorted((v, s) for v, s in tried if math.isfinite(s) and s > 0.0)
        bad = [v for v, s in tried if not math.isfinite(s)]
        if any(least <= s <= most for _, s in good):
            return
        if not good:
            value = guess if not bad else 0.1 * min(bad)
        else:
            below = [pair for pair in good if pair[1] < target]
            above = [pair for pair in good if pair[1] >= target]
            if below and above:
                (v0, s0), (v1, s1) = below[-1], above[0]
                share = math.log(target / s0) / math.log(s1 / s0)
                value = v0 * (v1 / v0) ** min(max(share, 0.05), 0.95)
            else:
                v, s = (below or above)[-1] if below else above[0]
                # Beyond what was tried: in proportion, and not too far at once.
                value = v * min(max(target / s, 0.01), 100.0)
        value = min(value, largest)
        if bad:
            value = min(value, math.sqrt(min(bad) * max((v for v, _ in good), default=0.04 * min(bad))))
        if any(math.isclose(value, v, rel_tol=0.02) for v, _ in tried):
            return
        if bad and good and min(bad) < 1.5 * max(v for v, _ in good):
            return  # as strong as the tests allow
        trial(value)


def spot_key(effect: InjectedEffect, spot: Spot) -> str:
    """Key of a curve in a table."""
    return f"{effect.name}@{spot.label}" if spot.label else effect.name


def value_at(curve: dict[str, Any], target: float) -> float | None:
    """Strength for a number of standard deviations, by interpolation of a curve on logarithmic scales.

    Beyond the weakest point, and a single one, in proportion; None where the curve does not get there.
    """
    points = [(float(v), float(s)) for v, s in curve["points"]]
    rising: list[tuple[float, float]] = []
    for value, found in points:
        if not rising or found > rising[-1][1]:
            rising.append((value, found))
    if not rising:
        return None
    if target > 1.1 * rising[-1][1]:
        # An effect that grows in proportion may have been left somewhat below the target.
        near = curve.get("proportional") and target < 3.0 * rising[-1][1]
        return rising[-1][0] * target / rising[-1][1] if near else None
    if target <= rising[0][1]:
        return rising[0][0] * target / rising[0][1]
    values, founds = np.log(np.array(rising)).T
    if target >= rising[-1][1]:
        return rising[-1][0]
    return float(np.exp(np.interp(math.log(target), founds, values)))


def _line_bins(model: Rig, bench: BenchSettings) -> np.ndarray[Any, np.dtype[np.int64]]:
    resolution = 1.0 / bench.duration
    low, high = bench.band_hz
    lines = [*np.geomspace(1.05 * low, 0.95 * high, LINES)]
    linear = linear_description(model)
    centres = [w / (2.0 * math.pi) for w in linear.frequencies_rad_s] + [linear.plant_frequency_rad_s / (2.0 * math.pi)]
    width = 12 * (2 * _NEIGHBOURS + 1) * resolution
    for centre in centres:
        if low < centre < high:
            lines += [*np.arange(centre - width, centre + width, (2 * _NEIGHBOURS + 1) * resolution)]
    bins = np.unique(np.round(np.array(lines) * bench.duration).astype(np.int64))
    kept: list[int] = []
    for line in bins:
        if line > _NEIGHBOURS and (not kept or line - kept[-1] > 2 * _NEIGHBOURS):
            kept.append(int(line))
    return np.array(kept, dtype=np.int64)
