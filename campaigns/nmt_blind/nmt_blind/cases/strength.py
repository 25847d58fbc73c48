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
from nmt_blind.cases.laboratory import BenchSettings, TrialError
from nmt_blind.cases.operating import Operating, noise_deviation, operating_point
from nmt_blind.cases.priors import parameters, shifted
from nmt_blind.cases.quiet_tests import QuietRecord, QuietWindow, play_backbone, play_random
from nmt_blind.cases.rig_edits import Edit, with_edits
from nmt_blind.cases.tolerances import LEAST_LEAD, check_tolerances, has_lead
from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_core.tolerances import TOLERANCES
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
# How often shifts are improved, and what is not worth another turn, prior standard deviations.
_TURNS = 12
_SMALL_STEP = 0.05
# Of the steps, where one made it worse.
_LEAST_DAMPING, _MORE_DAMPING = 1e-3, 10.0
# How often changes by shifts are measured anew, of how many shifts, from what size of theirs over the noise on, and by
# what step in prior standard deviations.
_RENEWALS = 3
_RENEWED = 6
_LEAST_RENEWED = 30.0
_RENEWAL_STEP = 0.02
# Turns end where one takes less of what is left.
_WORTH = 0.02
_PHASE_STEP = 1e-2

# The loop of a laboratory: the same two.
LABORATORY_PHASE_AT_LOCK = math.radians(0.25)
LABORATORY_PHASE_LEAN = math.radians(0.5)
_CHAIN_STEPS = {"gain": 1e-3, "delay_s": 1e-5, "clock_error": 1e-5}

_FEWEST_LEVELS = 8


@dataclass(frozen=True, eq=False)
class Observed:
    """Observables of a pair of tests: values, noise (standard deviations), both (m,), and the level of each row."""

    values: FloatArray
    noise: FloatArray
    level: FloatArray


@dataclass(frozen=True, eq=False)
class Shifted:
    """The model with shifts of its parameters and of the measuring chain.

    Attributes:
        made: shifts that were made, standard deviations, shape (k,).
        values: its observables, shape (m,).
        changes: their changes by one standard deviation of each shift, shape (m, k).
        left: standard deviations that are left of a difference.
    """

    made: FloatArray
    values: FloatArray
    changes: FloatArray
    left: float


class Sensitivity:
    """Strength of changes of one rig.

    Args:
        rig: the blind rig.
        tolerances: of the measuring chain, ``none`` or ``laboratory``.

    Attributes:
        relative: numbers of the shifts that turn or stretch what a channel says, in proportion to it.
    """

    def __init__(self, rig: BlindRig, tolerances: str = "none") -> None:
        self.rig = rig
        self.tolerances = check_tolerances(tolerances)
        self.model = rig.model()
        self.bench: BenchSettings = rig.bench
        self.operating: Operating = operating_point(self.model, self.bench)
        self._lines = _line_bins(self.model, self.bench)
        self._hum = TOLERANCES.mains if tolerances == "laboratory" else 0.0
        self.base = self.observe(self.model)
        # The edit that makes a number of standard deviations of a change; None = it stays linear.
        self._made: list[Callable[[float], Edit] | None] = []
        # What a standard deviation of a change adds to the delay of sensors: number of the change, sensor, s.
        self._late: list[tuple[int, int, float]] = []
        # Changes that turn or stretch what a channel says, in proportion to it; those of them that are leads.
        self.relative: list[int] = []
        self._leads: list[int] = []
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
                columns.append(TOLERANCES.gain * np.where(self.base.level < 0, self.base.values, 0.0))
                self.relative.append(len(self._made))
                self._made.append(None)
                continue
            step = _CHAIN_STEPS["gain"]
            columns.append(TOLERANCES.gain * self._change(Edit((*path, "gain"), sensor.gain * (1.0 + step))) / step)
            self._made.append(partial(_louder, (*path, "gain"), sensor.gain))
            step = _CHAIN_STEPS["delay_s"]
            delay = self._change(Edit((*path, "delay_s"), sensor.delay_s + step)) / step
            columns.append(TOLERANCES.delay_s * delay)
            self._late.append((len(self._made), index, TOLERANCES.delay_s))
            self._made.append(None)
            members, late = kinds.get(sensor.quantity, ([], np.zeros(self.base.values.size)))
            kinds[sensor.quantity] = ([*members, index], late + delay)
            if has_lead(sensor.quantity) and sensor.high_pass_hz is None:
                lead = math.radians(TOLERANCES.phase_deg)
                corner = self.operating.omega / (2.0 * math.pi) * math.tan(lead)
                columns.append(self._change(Edit((*path, "high_pass_hz"), corner)))
                self.relative.append(len(self._made))
                self._leads.append(len(self._made))
                self._made.append(partial(_leading, (*path, "high_pass_hz"), corner))
        shared = TOLERANCES.shared_delay_s / math.sqrt(3.0)
        for members, late in kinds.values():
            columns.append(shared * late)
            self._late += [(len(self._made), sensor, shared) for sensor in members]
            self._made.append(None)
        step = _CHAIN_STEPS["clock_error"]
        columns.append(TOLERANCES.clock * self._change(Edit(("clock_error",), self.model.clock_error + step)) / step)
        clock = self.model.clock_error
        self._made.append(lambda deviation: Edit(("clock_error",), clock + TOLERANCES.clock * deviation))
        return columns

    def shifted(self, observed: Observed, made: FloatArray | None = None, changes: FloatArray | None = None) -> Shifted:
        """The model with shifts made, and what is left of observables then.

        Args:
            observed: of a test.
            made: shifts, standard deviations (k,); None = none.
            changes: what they change; None = as measured about the model.

        Raises:
            TrialError: too few levels locked, or the shifted model cannot be tested.
        """
        made = np.zeros(self._nuisance.shape[1]) if made is None else made
        changes = self._nuisance if changes is None else changes
        values = self._values(made) if made.any() else self.base.values
        return Shifted(made, values, changes, self._left(observed, values, made))

    def settled(self, observed: Observed, start: Shifted) -> Shifted:
        """The best shifts from others on, every step of which leaves less (Levenberg and Marquardt).

        It finds the least nearby. About a narrow resonance that has to move by more than its width there are others;
        `strength_curve` climbs to strong effects from weak ones, where there is one only.
        """
        best = self._descended(observed, start)
        for _ in range(_RENEWALS):
            try:
                found = self._descended(observed, replace(best, changes=self._renewed(best)))
            except TrialError:
                break
            enough = found.left > (1.0 - _WORTH) * best.left
            best = found if found.left < best.left else best
            if enough:
                break
        return best

    def _renewed(self, here: Shifted) -> FloatArray:
        """Changes of the observables by one standard deviation of each shift, (m, k).

        Those of the shifts that do most are measured anew: what steps taught of them is true along the steps only, and
        about the model a narrow resonance moved otherwise.

        Raises:
            TrialError: the shifted model cannot be tested.
        """
        changes = self._nuisance.copy()
        scale = np.where(np.isfinite(self.base.noise), 1.0 / self.base.noise, 0.0)[:, np.newaxis]
        size = np.abs(here.made) * np.linalg.norm(changes * scale, axis=0) * self._own()
        for column in np.argsort(-size)[:_RENEWED]:
            if size[column] < _LEAST_RENEWED:
                break
            moved = here.made.copy()
            moved[column] += _RENEWAL_STEP
            changes[:, column] = np.nan_to_num(self._values(moved) - here.values) / _RENEWAL_STEP
        return changes

    def _descended(self, observed: Observed, start: Shifted) -> Shifted:
        """The best shifts that steps with changes corrected on the way lead to."""
        best, damping = start, 0.0
        for _ in range(_TURNS):
            try:
                step, moved = self._step(observed, best, damping)
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

    def sigma_of(self, observed: Observed) -> float:
        """Standard deviations by which observables differ from what the model can be made to say nearby.

        Raises:
            TrialError: too few levels locked.
        """
        return self.settled(observed, self.shifted(observed)).left

    def _own(self) -> BoolArray:
        """Shifts that can be made; others stay linear."""
        model_columns = np.array([edit is not None for edit in self._made])
        model_columns[[number for number, _, _ in self._late]] = True
        return model_columns

    def _values(self, made: FloatArray) -> FloatArray:
        """Observables of the shifted model, shape (m,).

        Raises:
            TrialError: it cannot be tested.
        """
        try:
            values = self.observe(with_edits(self.model, self._edits(made))).values
        except (BenchError, OverflowError) as error:
            raise TrialError(str(error)) from error
        # A healthy channel leads by something already, so it may lead by less as well as by more.
        less = [lead for lead in self._leads if made[lead] < 0.0]
        return values + self.changes_about(values)[:, less] @ made[less] if less else values

    def _step(self, observed: Observed, here: Shifted, damping: float) -> tuple[FloatArray, Shifted]:
        """The next step, standard deviations (k,), and the model after it.

        Raises:
            TrialError: the shifted model cannot be tested.
        """
        changes = here.changes.copy()
        changes[:, self.relative] = self.changes_about(here.values)[:, self.relative]
        wanted = self.linear(observed, here.values, here.made, changes, damping)[2]
        step = np.where(self._own(), wanted - here.made, 0.0)
        made = here.made + step
        values = self._values(made)
        # Along the step the changes are known now (Broyden's update).
        missed = np.nan_to_num(values - here.values - here.changes @ step)
        changes = here.changes + np.outer(missed, step) / max(float(step @ step), 1e-12)
        return step, Shifted(made, values, changes, self._left(observed, values, made))

    def _left(self, observed: Observed, values: FloatArray, made: FloatArray) -> float:
        """σ with some shifts made; only changes that cannot be made are fitted."""
        residual, shifts = self._rest(observed, values, made)
        return math.sqrt(float(residual @ residual + shifts @ shifts))

    def _rest(self, observed: Observed, values: FloatArray, made: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is left over the noise, shape (m,), zero where nothing compares, and all shifts, shape (k,)."""
        good, scale = self._good(observed, values)
        model_columns = self._own()
        d = (observed.values - values)[good] * scale
        c = self.changes_about(values)[good][:, ~model_columns] * scale[:, np.newaxis]
        found = np.linalg.solve(np.eye(c.shape[1]) + c.T @ c, c.T @ d)
        shifts = made.copy()
        shifts[~model_columns] += found
        residual = np.zeros(observed.values.size)
        residual[good] = d - c @ found
        return residual, shifts

    def changes_about(self, values: FloatArray) -> FloatArray:
        """Changes of observables by one standard deviation of each shift, (m, k).

        Args:
            values: observables of the model with some shifts, (m,); what is relative goes with them.
        """
        changes = self._nuisance.copy()
        if not self.relative:
            return changes
        real, imaginary = self._pairs()
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = (values[real] + 1j * values[imaginary]) / (
                self.base.values[real] + 1j * self.base.values[imaginary]
            )
        ratio[~np.isfinite(ratio)] = 1.0
        for column in self.relative:
            turned = (changes[real, column] + 1j * changes[imaginary, column]) * ratio
            changes[real, column], changes[imaginary, column] = turned.real, turned.imag
        return changes

    def _pairs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows of the real and imaginary parts of all fundamentals and of the random test's responses."""
        channels = sum(sensor.quantity != "voltage" for sensor in self.model.sensors)
        window = 1 + channels * (2 * len(ORDERS) + 2)
        levels = len(self.bench.levels)
        first = 1 + np.arange(channels) * (2 * len(ORDERS) + 2) + 2 * list(ORDERS).index(1)
        fundamentals = (np.arange(levels)[:, np.newaxis] * window + first).ravel()
        start = levels * window
        random = np.arange((self.base.values.size - start) // 2)
        return (
            np.concatenate([fundamentals, start + random]),
            np.concatenate([fundamentals + 1, start + random.size + random]),
        )

    def _good(self, observed: Observed, values: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Rows that compare, shape (m,), and one over the noise of each of them.

        Raises:
            TrialError: too few levels locked.
        """
        good = np.isfinite(observed.values) & np.isfinite(values) & np.isfinite(self.base.noise)
        levels = np.unique(self.base.level[good & (self.base.level >= 0)]).size
        if levels < min(_FEWEST_LEVELS, len(self.bench.levels)):
            raise TrialError(f"only {levels} levels locked")
        return good, 1.0 / self.base.noise[good]

    def _edits(self, shifts: FloatArray) -> list[Edit]:
        """Edits of the model that make so many standard deviations of every change that does not stay linear."""
        edits = [edit(float(shift)) for edit, shift in zip(self._made, shifts, strict=True) if edit and shift]
        delays: dict[int, float] = {}
        for number, sensor, size in self._late:
            delays[sensor] = delays.get(sensor, 0.0) + size * float(shifts[number])
        if not delays:
            return edits
        clock = next((edit.value for edit in edits if edit.path == ("clock_error",)), self.model.clock_error)
        most = LEAST_LEAD / (self.model.sample_rate_hz * (1.0 + clock))
        for sensor, delay in delays.items():
            late = max(self.model.sensors[sensor].delay_s + delay, -most)
            edits.append(Edit(("sensors", sensor, "delay_s"), late))
        return edits

    def linear(
        self,
        observed: Observed,
        values: FloatArray | None = None,
        shifts: FloatArray | None = None,
        changes: FloatArray | None = None,
        damping: float = 0.0,
    ) -> tuple[float, float, FloatArray]:
        """Size of the difference from the plain model, σ after the best shifts about given ones, and these.

        Args:
            observed: of a test.
            values: of the shifted model, shape (m,); None = of the plain one.
            shifts: that were made, standard deviations (k,); None = none.
            changes: of the observables by one standard deviation of each, shape (m, k); None = about the plain model.
            damping: shortens the step to the best shifts, most where the observables say most (Marquardt).

        Raises:
            TrialError: too few levels locked.
        """
        values = self.base.values if values is None else values
        changes = self._nuisance if changes is None else changes
        shifts = np.zeros(changes.shape[1]) if shifts is None else shifts
        good, scale = self._good(observed, values)
        d = (observed.values - values)[good] * scale
        c = changes[good] * scale[:, np.newaxis]
        normal = c.T @ c
        normal = np.eye(c.shape[1]) + normal + damping * np.diag(np.diag(normal))
        step = np.linalg.solve(normal, c.T @ d - shifts)
        residual, total = d - c @ step, shifts + step
        difference = np.nan_to_num((observed.values - self.base.values)[good] * scale)
        return float(np.linalg.norm(difference)), math.sqrt(float(residual @ residual + total @ total)), total

    def signature(self, observed: Observed, made: FloatArray) -> FloatArray:
        """What observables say that the model with shifts made does not, and the shifts, shape (m + k,).

        The product of two signatures is dᵀ (N + C Cᵀ)⁻¹ d' where everything is linear; σ² is that with itself.

        Raises:
            TrialError: too few levels locked, or the shifted model cannot be tested.
        """
        values = self._values(made) if made.any() else self.base.values
        return np.concatenate(self._rest(observed, values, made))

    def sigma(self, edits: Sequence[Edit]) -> float:
        """Standard deviations that small changes of the rig file amount to.

        Raises:
            TrialError: a test cannot be made with them.
        """
        return self.sigma_of(self.played(edits))

    def played(self, edits: Sequence[Edit]) -> Observed:
        """Both tests on the rig with changes of its file.

        Raises:
            TrialError: a test cannot be made with them.
        """
        try:
            return self.observe(with_edits(self.model, edits))
        except BenchError as error:
            raise TrialError(str(error)) from error


def _leaning(phase: float) -> Edit:
    """A loop that holds another phase, rad."""
    return Edit(("pll",), {"phase_offset_rad": phase}, "merge")


def _louder(path: tuple[str | int, ...], gain: float, deviation: float) -> Edit:
    """A gain that is off by so many standard deviations."""
    return Edit(path, gain * (1.0 + TOLERANCES.gain * deviation))


def _leading(path: tuple[str | int, ...], corner: float, deviation: float) -> Edit:
    """A high-pass that leads by so many standard deviations; none leads by less than nothing."""
    return Edit(path, max(corner * deviation, 1e-6 * corner))


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
