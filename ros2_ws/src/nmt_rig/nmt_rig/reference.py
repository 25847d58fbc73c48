"""Reference solutions of a rig: EPMC backbone, its convergence over harmonics, and the single-point
reference.

Two references answer two questions. The EPMC backbone is the nonlinear mode itself: distance of a test to it
contains the error of the method (single-point drive, few sensors). The single-point reference is what a
perfect test with this
exciter and these sensors would measure: distance to it is the error of the test alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import write_whole
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_rig.linear_description import isolating_inputs
from nmt_rig.model.epmc import EpmcBackbone, epmc_backbone
from nmt_rig.model.forced_response import ForcedProblem
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.phase_resonance import ExtractedMode, extract_mode, phase_resonant_backbone
from nmt_rig.rig import Rig
from nmt_rig.rig_model import (
    build_elements,
    build_resting_elements,
    build_structure,
    build_system,
    input_per_volt,
    refuse_beyond_harmonic_balance,
    without_exciter_effects,
)
from nmt_rig.structure_sections import point_words

_RANGE_HARMONICS = 1  # of the search of the amplitude range
REFERENCE_COLUMNS = ("modal_amplitude", "omega_rad_s", "damping_ratio")


@dataclass(frozen=True)
class Reference:
    """EPMC backbone of a rig's target mode.

    Attributes:
        modal_amplitude: (k,) q, m√kg.
        omega_rad_s: (k,) ω̃, rad/s.
        damping_ratio: (k,) δ̃.
        harmonics: highest harmonic order.
        single_valued: the backbone does not fold in q; where it does, the first crossing is given.
        backbone: the full result with shapes.
    """

    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    damping_ratio: FloatArray
    harmonics: int
    single_valued: bool
    backbone: EpmcBackbone


@dataclass(frozen=True)
class PointShapes:
    """Shapes of a nonlinear mode at the structure's points.

    Attributes:
        points: (p,) point numbers, ascending.
        orders: (m,) harmonic orders.
        shape: (k, m, p) φ̃_n, 1/√kg, complex, for every modal amplitude.
    """

    points: tuple[int, ...]
    orders: tuple[int, ...]
    shape: NDArray[np.complex128]


@dataclass(frozen=True)
class ConvergenceRow:
    """Largest relative distance of one truncation to the finest one, over the backbone."""

    harmonics: int
    omega_error: float
    damping_error: float


@dataclass(frozen=True)
class SinglePointReference:
    """Modal properties that a perfect single-point phase-resonant test of the rig would extract.

    Attributes:
        exciter_point: point number of the drive.
        level: (k,) drive amplitudes, V; those beyond a fold of the phase-resonant branch are left out.
        mode: extracted properties per level.
        single_valued: phase resonance does not fold over the level; where it does, the first crossing is
            given.
    """

    exciter_point: int
    level: FloatArray
    mode: ExtractedMode
    single_valued: bool


def covers(test: DrivenTest) -> str:
    """What the backbone of a mode cannot be compared with, and what to use instead; empty = it can be."""
    kind = kind_class(test.kind)
    if kind.beyond_backbone:
        return kind.beyond_backbone.format(words=test.words)
    if not kind.gives_modal_points:
        return (
            f"The reference is the backbone of a mode, and {test.words} measures responses; use a test at phase "
            "resonance or a self-excited test."
        )
    return ""


def compute_reference(
    rig: Rig,
    harmonics: int = 7,
    modal_amplitudes: Sequence[float] | FloatArray | None = None,
    points: int = 100,
) -> Reference:
    """EPMC backbone of the rig's target mode (paper eq. 2), without its exciter.

    Args:
        rig: rig; ``rig.test.mode`` says which mode.
        harmonics: highest harmonic order.
        modal_amplitudes: q (m√kg), positive and ascending; see ``default_amplitudes`` when None.
        points: number of amplitudes when ``modal_amplitudes`` is None.

    Raises:
        BenchError: wrong amplitudes or harmonics, or no solution.

    Examples:
        >>> from nmt_rig.rig import load_rig
        >>> reference = compute_reference(load_rig("beam"), harmonics=3, points=5)
        >>> (reference.omega_rad_s[[0, -1]] / 6.283185307).round(2)
        array([22.19, 18.55])
        >>> compute_reference(load_rig("beam"), modal_amplitudes=[1e-5], harmonics=1).damping_ratio.round(5)
        array([0.00506])
    """
    refuse_beyond_harmonic_balance(rig, with_exciter=False)
    structure = build_structure(rig)
    elements = build_elements(rig, structure)
    amplitudes = (
        default_amplitudes(rig, points) if modal_amplitudes is None else np.asarray(modal_amplitudes, dtype=np.float64)
    )
    basis = FourierBasis.up_to(harmonics)
    backbone = epmc_backbone(structure, elements, amplitudes, basis, rig.test.mode - 1)
    return Reference(
        backbone.modal_amplitude,
        backbone.omega_rad_s,
        backbone.damping_ratio,
        harmonics,
        backbone.single_valued,
        backbone,
    )


def point_shapes(rig: Rig, reference: Reference) -> PointShapes:
    """Lateral displacement of every point in the shapes of a computed backbone.

    Args:
        rig: the rig of :func:`compute_reference`.
        reference: what it returned.
    """
    structure = build_structure(rig)
    backbone = reference.backbone
    selectors = np.array([structure.selector(point) for point in structure.point_numbers])
    orders = tuple(int(order) for order in backbone.orders)
    return PointShapes(structure.point_numbers, orders, backbone.normalised_shape @ selectors.T)


def default_amplitudes(rig: Rig, points: int = 100) -> FloatArray:
    """Modal amplitudes (points,) that cover the rig's default levels generously, in geometric steps, m√kg.

    From a third of the value at the lowest level to ten times that at the highest on the sticking structure
    or with the phase-resonant single-point drive; of several exciters from a third of the lowest to twice the
    highest at rest. With levels of the response, as of a self-excited rig, from a third of the lowest to the highest.

    Raises:
        BenchError: fewer than two points, or levels that are no numbers.
    """
    if points < 2:
        raise BenchError(f"a reference needs at least 2 points, got {points}; give a larger number.")
    if rig.test.response_levels:
        structure = build_structure(rig)
        modes = sticking_modes(structure, build_resting_elements(rig, structure), rig.test.mode)
        drive = abs(float(modes.shapes[modes.points.index(rig.drive_point), rig.test.mode - 1]))
        order = MOTIONS[Quantity[rig.extraction.quantity.upper()]]
        low, high = _level_range(rig.test.response_levels)
        scale = drive * float(modes.frequencies[rig.test.mode - 1]) ** order
        return np.geomspace(low / scale / 3.0, high / scale, points)
    levels = _level_range(rig.test.levels)
    if len(rig.all_exciters) > 1:
        low, high = np.array([levels[0] / 3.0, 2.0 * levels[-1]]) * _resting_amplitude_per_volt(rig)
        return np.geomspace(low, high, points)
    # A range in whole decades: the fundamental alone tells it, at a quarter of the work.
    found = single_point_reference(without_exciter_effects(rig), None, levels, _RANGE_HARMONICS)
    reached = found.mode.full_modal_amplitude
    low = 10.0 ** np.floor(np.log10(reached.min() / 3.0))
    high = 10.0 ** np.ceil(np.log10(reached.max() * 10.0))
    return np.geomspace(low, high, points)


def _resting_amplitude_per_volt(rig: Rig) -> float:
    """Modal amplitude (m√kg) per volt of exciter 1, at rest and at resonance, all driving the target mode alone."""
    structure, mode = build_structure(rig), rig.test.mode - 1
    count = max(rig.extraction.linear_modes, rig.test.mode)
    modes = sticking_modes(structure, build_resting_elements(rig, structure), count)
    shapes = modes.shapes[[modes.points.index(point) for point in rig.exciter_points]]
    frequency, system = float(modes.frequencies[mode]), build_system(rig, structure)
    inputs, _ = isolating_inputs(system, frequency, shapes, mode)
    motion = (system.responses(frequency)[0] @ inputs)[: structure.size]
    return float(abs(modes.full_shapes[:, mode] @ structure.mass @ motion) * input_per_volt(rig) / abs(inputs[0]))


def _level_range(levels: str) -> list[float]:
    try:
        if ":" in levels:
            numbers = [float(part) for part in levels.split(":")[:2]]
        else:
            numbers = [float(part) for part in levels.split(",")]
    except ValueError as failure:
        raise BenchError(f"test.levels {levels!r} must be start:stop:number or a list a,b,c.") from failure
    return sorted({min(numbers), max(numbers)})


def with_exciter_at(rig: Rig, point: int | None) -> Rig:
    """The rig with its exciter, and what is on its side, at another point; unchanged when ``point`` is None.

    Raises:
        BenchError: the structure has no such point.
    """
    if point is None or point == rig.drive_point:
        return rig
    if point not in rig.structure.points:
        raise BenchError(
            f"exciter point {point} does not exist: rig {rig.name} has {point_words(rig.structure.points)}; "
            "choose one of them."
        )
    moved = [
        section.model_copy(update={"point": point}) if section.side == "exciter" else section
        for section in rig.local_elements
    ]
    return rig.model_copy(update={"exciter": rig.exciter.model_copy(update={"point": point}), "local_elements": moved})


def single_point_reference(
    rig: Rig,
    exciter_point: int | None = None,
    levels: Sequence[float] | FloatArray = (),
    harmonics: int = 7,
) -> SinglePointReference:
    """Phase-resonant responses of the rig's real single-point drive and the method's extraction from them.

    The estimated mass matrix comes from the sticking structure's linear modes at the rig's response sensors
    (``rig.extraction``), as many modes as the rig's extraction uses.

    Args:
        rig: rig with its exciter and sensors.
        exciter_point: point of the drive instead of the rig's.
        levels: (k,) drive amplitudes, V, positive and ascending.
        harmonics: highest harmonic order.

    Raises:
        BenchError: wrong levels or point, or no phase resonance.
    """
    rig = with_exciter_at(rig, exciter_point)
    refuse_beyond_harmonic_balance(rig, with_exciter=True)
    structure = build_structure(rig)
    elements = build_resting_elements(rig, structure)
    modes = sticking_modes(structure, elements, max(rig.extraction.linear_modes, rig.test.mode))
    problem = ForcedProblem(
        build_system(rig, structure), FourierBasis.up_to(harmonics), float(modes.frequencies[rig.test.mode - 1])
    )
    volts = np.asarray(levels, dtype=np.float64)
    # Start the branch in the linear range, even if the lowest level lies beyond it.
    drives = volts * input_per_volt(rig)
    if drives.size and np.all(np.isfinite(drives)) and drives[0] > 0.0:
        lead_in = drives[0] * np.array([1e-3])
        backbone = phase_resonant_backbone(problem, np.concatenate((lead_in, drives)), skip_unreached=True)
        responses = backbone.responses[1:]
    else:
        raise BenchError("levels must be positive and ascending voltages; give at least one.")
    sensor_points = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    rows = [modes.points.index(point) for point in sensor_points]
    shapes = modes.shapes[rows, : rig.extraction.linear_modes]
    mode = extract_mode(problem, responses, sensor_points, shapes, structure.mass)
    return SinglePointReference(rig.drive_point, volts[: len(responses)], mode, backbone.single_valued)


def convergence_table(
    rig: Rig,
    orders: Sequence[int] = (1, 3, 5, 7, 20),
    modal_amplitudes: Sequence[float] | FloatArray | None = None,
    points: int = 100,
) -> list[ConvergenceRow]:
    """Distance of the backbone's truncations to the finest of ``orders``, at the same modal amplitudes.

    Raises:
        BenchError: no orders, or no solution for one of them.
    """
    if not orders:
        raise BenchError("a convergence table needs at least one number of harmonics.")
    amplitudes = default_amplitudes(rig, points) if modal_amplitudes is None else modal_amplitudes
    results = [compute_reference(rig, order, amplitudes) for order in sorted(set(orders))]
    finest = results[-1]
    return [
        ConvergenceRow(
            result.harmonics,
            float(np.max(np.abs(result.omega_rad_s / finest.omega_rad_s - 1.0))),
            float(np.max(np.abs(result.damping_ratio / finest.damping_ratio - 1.0))),
        )
        for result in results
    ]


class Backbone(Protocol):
    """A backbone as a table: q (m√kg), ω̃ (rad/s) and δ̃, each of shape (k,)."""

    @property
    def modal_amplitude(self) -> FloatArray:
        """q, m√kg."""
        ...

    @property
    def omega_rad_s(self) -> FloatArray:
        """ω̃, rad/s."""
        ...

    @property
    def damping_ratio(self) -> FloatArray:
        """δ̃."""
        ...


def write_reference_csv(reference: Backbone, path: str | Path) -> Path:
    """Write ``reference.csv`` (columns modal_amplitude, omega_rad_s, damping_ratio), complete or not at all.

    Raises:
        BenchError: the file cannot be written.

    Examples:
        >>> from nmt_rig.rig import load_rig
        >>> reference = compute_reference(load_rig("beam"), harmonics=1, modal_amplitudes=[1e-5, 1e-4])
        >>> write_reference_csv(reference, "out/backbone/reference.csv").read_text().splitlines()[0]
        'modal_amplitude,omega_rad_s,damping_ratio'
        >>> len(nmt.open("out/backbone").rows())
        2
    """
    rows = np.column_stack([getattr(reference, column) for column in REFERENCE_COLUMNS])
    lines = [",".join(REFERENCE_COLUMNS), *(",".join(f"{value:.12g}" for value in row) for row in rows)]
    return _write_lines(lines, path)


def write_shapes_csv(reference: Backbone, shapes: PointShapes, path: str | Path) -> Path:
    """Write ``shapes.csv``: a row for every amplitude, harmonic order and point, with real and imaginary part (1/√kg).

    Raises:
        BenchError: the file cannot be written.
    """
    lines = ["modal_amplitude,order,point,real,imaginary"]
    for q, amplitude in zip(reference.modal_amplitude, shapes.shape, strict=True):
        for order, harmonic in zip(shapes.orders, amplitude, strict=True):
            for point, value in zip(shapes.points, harmonic, strict=True):
                lines.append(f"{q:.12g},{order},{point},{value.real:.9g},{value.imag:.9g}")
    return _write_lines(lines, path)


def _write_lines(lines: Sequence[str], path: str | Path) -> Path:
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, "\n".join(lines) + "\n")
    except OSError as failure:
        raise BenchError(f"cannot write {target}: {failure.strerror}; choose another output folder.") from failure
    return target
