"""What a run's report shows, as plain arrays: independent of how it was read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nmt_extract.judgement.uncertainty_budget import BudgetInputs, PointBudget


@dataclass(frozen=True)
class LoopHistory:
    """State of the loop, one entry a block; all arrays have the shape ``(blocks,)``.

    Attributes:
        sample: last sample of the block.
        frequency_hz: commanded frequency, Hz; 0 = drive off.
        phase_error: rad; NaN = not valid.
        state: see :class:`~nmt_core.vocabulary.LoopState`.
        drive_amplitude: V peak.
    """

    sample: NDArray[np.int64]
    frequency_hz: FloatArray
    phase_error: FloatArray
    state: NDArray[np.int64]
    drive_amplitude: FloatArray


@dataclass(frozen=True)
class SignalEnvelope:
    """Smallest and largest value of a channel over consecutive stretches of the run.

    Attributes:
        channel: name of the channel.
        symbol: what it is called in axis labels.
        unit: SI unit of ``low`` and ``high``.
        sample: middle sample of each stretch, shape ``(stretches,)``.
        low, high: same shape.
    """

    channel: str
    symbol: str
    unit: str
    sample: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Excerpt:
    """A few periods of force and drive-point response from the start of a window.

    Attributes:
        level_index: number of the level, from 0.
        level: target amplitude, in ``level_unit``.
        level_unit: V, N, m or m/s^2.
        frequency_hz: excitation frequency, Hz.
        sample_rate: Hz.
        force: N, shape ``(samples,)``.
        response: in ``response_unit``, same shape.
        response_symbol, response_unit: what the response is.
    """

    level_index: int
    level: float
    level_unit: str
    frequency_hz: float
    sample_rate: float
    force: FloatArray
    response: FloatArray
    response_symbol: str
    response_unit: str


@dataclass(frozen=True)
class LevelStart:
    """A step of the plan: level ``index`` with target ``amplitude`` takes effect at ``sample``."""

    index: int
    amplitude: float
    sample: int


@dataclass(frozen=True)
class LockMark:
    """A confirmed lock and the window it opened."""

    level_index: int
    level: float
    level_unit: str
    sample: int
    frequency_hz: float
    window_first_sample: int
    window_samples: int
    window_periods: int


@dataclass(frozen=True)
class ReferenceCurve:
    """A computed backbone to compare with.

    Attributes:
        label: what it is, for legends.
        modal_amplitude: m√kg, ascending, shape ``(n,)``.
        omega_rad_s: modal frequency, rad/s, same shape.
        damping_ratio: 1, same shape.
    """

    label: str
    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    damping_ratio: FloatArray

    def at(self, modal_amplitude: float) -> tuple[float, float]:
        """Modal frequency (rad/s) and damping ratio at a modal amplitude; NaN outside the curve."""
        q = self.modal_amplitude
        if not (math.isfinite(modal_amplitude) and q[0] <= modal_amplitude <= q[-1]):
            return math.nan, math.nan
        position = math.log(modal_amplitude)
        return (
            float(np.interp(position, np.log(q), self.omega_rad_s)),
            float(np.interp(position, np.log(q), self.damping_ratio)),
        )


@dataclass(frozen=True)
class FileEntry:
    """A file of the results, with its size in bytes and the hexadecimal SHA-256 of its contents."""

    name: str
    size: int
    sha256: str


@dataclass
class RunReportData:
    """Everything in a run's report.

    Attributes:
        points: one modal point a level, in the order of the test, also of levels that gave none.
        sample_rate: Hz.
        run: the run's description of itself (``run.json``).
        rig: the rig file as used, parsed.
        stop: the stop record; empty if the run has none.
        linear: what the loop and the extraction knew of the linear system.
        history: state of the loop; None where it was not recorded.
        envelopes: voltage, force and response over the whole run, as far as recorded.
        excerpts: time signals, one a locked level, or only of those that a page shows.
        excerpts_of: locked levels that they were chosen from; 0 = not chosen.
        levels: steps of the plan.
        locks: confirmed locks.
        reference: computed backbone to compare with, if any.
        files: files of the results.
        loss: one sentence on what a damaged recording lost, else None.
        not_live: locked levels whose point did not come while the test ran.
        end_sample: sample after the last recorded one.
        budgets: uncertainty budget of each point with values.
        budget_inputs: what it was made from; None = there is none.
        lock_words: what the loop said when it locked, level index -> words.
        plant: what the plant node said of itself last, name -> value; empty where nothing was recorded.
    """

    points: Sequence[ModalPoint]
    sample_rate: float
    run: Mapping[str, Any] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    stop: Mapping[str, Any] = field(default_factory=dict)
    linear: LinearDescription | None = None
    history: LoopHistory | None = None
    envelopes: Sequence[SignalEnvelope] = ()
    excerpts: Sequence[Excerpt] = ()
    excerpts_of: int = 0
    levels: Sequence[LevelStart] = ()
    locks: Sequence[LockMark] = ()
    reference: ReferenceCurve | None = None
    files: Sequence[FileEntry] = ()
    loss: str | None = None
    not_live: Sequence[int] = ()
    end_sample: int = 0
    budgets: Sequence[PointBudget] = ()
    budget_inputs: BudgetInputs | None = None
    lock_words: Mapping[int, str] = field(default_factory=dict)
    plant: Mapping[str, str] = field(default_factory=dict)

    @property
    def good_points(self) -> list[ModalPoint]:
        """The points with measured values."""
        return [point for point in self.points if point.status == PointStatus.OK]

    @property
    def failed_points(self) -> list[ModalPoint]:
        """The points of levels that gave no measured values."""
        return [point for point in self.points if point.status != PointStatus.OK]


def read_reference(path: Path, label: str = "EPMC reference") -> ReferenceCurve:
    """Read a backbone written by ``./nmt reference`` (modal_amplitude, omega_rad_s, damping_ratio).

    Lines that start with ``#`` are skipped; without a header line the columns are taken in this order.

    Raises:
        BenchError: the file cannot be read, or a column or number in it is missing.
    """
    names = ["modal_amplitude", "omega_rad_s", "damping_ratio"]
    try:
        lines = read_text(path, "reference").splitlines()
    except BenchError as error:
        raise BenchError(
            f"The reference {path} cannot be read as text; give the reference.csv that './nmt reference' writes."
        ) from error
    rows: list[list[float]] = []
    columns = [0, 1, 2]
    for number, line in enumerate(lines, start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() or line.startswith("#"):
            continue
        if not rows and not _is_number(cells[0]):
            missing = [name for name in names if name not in cells]
            if missing:
                raise BenchError(f"The reference {path} has no column '{missing[0]}'; it needs {', '.join(names)}.")
            columns = [cells.index(name) for name in names]
            continue
        try:
            rows.append([float(cells[column]) for column in columns])
        except (ValueError, IndexError) as error:
            raise BenchError(f"The reference {path} line {number} is not three numbers: '{line.strip()}'.") from error
    table = np.array(rows, dtype=np.float64)
    if len(rows) < 2 or not np.all(np.isfinite(table)) or not np.all(table[:, 0] > 0.0):
        raise BenchError(f"The reference {path} needs at least two points with finite values and modal_amplitude > 0.")
    table = table[np.argsort(table[:, 0], kind="stable")]
    return ReferenceCurve(label, table[:, 0], table[:, 1], table[:, 2])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
