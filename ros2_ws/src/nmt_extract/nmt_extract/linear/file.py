"""Files of the linear modal test: ``linear.json`` (also a linear description) and ``frf.csv``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any

import numpy as np

from nmt_core.files.plain_json import plain_json
from nmt_core.files.whole_file import csv_text
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.text.number_words import significant
from nmt_extract.linear.residuals import Residuals
from nmt_extract.linear.results import LinearTest
from nmt_extract.linear.stabilisation import DAMPING_TOLERANCE, FREQUENCY_TOLERANCE, MINIMUM_RUN
from nmt_extract.modal.quantities import estimated_mass

LINEAR_FREQUENCY_CHANGE = 2e-4
"""Relative change of the target's frequency to half the level beyond which the structure is not called linear."""
LINEAR_DAMPING_CHANGE = 0.02
"""The same for its damping ratio."""

_COHERENT = 0.9  # of voltage and force, from which on their ratio is kept
_MOST_ROWS = 500
_NEAR_TARGET = 0.1  # of its frequency


@dataclass(frozen=True)
class Linearity:
    """The target mode at the test's level and at a lower one.

    Attributes:
        level, lower_level: V rms.
        frequency_change: relative, from the lower level to the test's.
        damping_change: relative.
        frequency_std, damping_std: their standard uncertainties.
    """

    level: float
    lower_level: float
    frequency_change: float
    damping_change: float
    frequency_std: float
    damping_std: float

    @property
    def is_linear(self) -> bool:
        """Whether neither change exceeds both its limit and three standard uncertainties."""
        frequency = abs(self.frequency_change) <= max(LINEAR_FREQUENCY_CHANGE, 3.0 * self.frequency_std)
        return frequency and abs(self.damping_change) <= max(LINEAR_DAMPING_CHANGE, 3.0 * self.damping_std)

    @property
    def sentence(self) -> str:
        """The finding in words."""
        verdict = "linear" if self.is_linear else "NOT linear, lower the level"
        frequency, damping = (
            f"{significant(100 * change, 2)} % (± {significant(100 * std, 1)})"
            for change, std in (
                (self.frequency_change, self.frequency_std),
                (self.damping_change, self.damping_std),
            )
        )
        return (
            f"From {self.lower_level:g} to {self.level:g} V rms the target's frequency changes by {frequency}, "
            f"its damping ratio by {damping}: {verdict}."
        )


def linearity(test: LinearTest, lower: LinearTest, level: float, lower_level: float) -> Linearity:
    """Compare the target mode of two records of different level (V rms)."""
    here = test.target_mode
    there = min((*lower.modes, *lower.further_modes), key=lambda mode: abs(mode.frequency_hz - here.frequency_hz))
    return Linearity(
        level,
        lower_level,
        here.frequency_hz / there.frequency_hz - 1.0,
        here.damping_ratio / there.damping_ratio - 1.0,
        math.hypot(here.frequency_std, there.frequency_std) / there.frequency_hz,
        math.hypot(here.damping_std, there.damping_std) / there.damping_ratio,
    )


def description(test: LinearTest) -> LinearDescription:
    """What loop and extraction need, from measured figures only.

    Without voltage channels the exciters' share is not known: the plant is then the structure itself.
    """
    target, plant = test.target_mode, test.plant
    known = {
        "plant_frequency_rad_s": target.omega if plant is None else 2.0 * math.pi * plant.frequency_hz,
        "plant_damping_ratio": target.damping_ratio if plant is None else plant.damping_ratio,
        "moving_mass_kg": 0.0 if plant is None else plant.moving_mass_kg,
        "force_per_volt": math.nan if plant is None else plant.force_per_volt,
        "displacement_per_volt": math.nan if plant is None else plant.displacement_per_volt,
    }
    points = test.settings.exciter_points
    rows = _force_rows(test)
    return LinearDescription(
        source="test",
        drive_point=test.settings.drive_point,
        target_mode=test.target,
        points=test.points,
        frequencies_rad_s=tuple(mode.omega for mode in test.modes),
        damping_ratios=tuple(mode.damping_ratio for mode in test.modes),
        shapes=tuple(tuple(float(value) for value in row) for row in test.shapes),
        drive_point_shape=target.drive_shape,
        shape_stds=tuple(
            tuple(float(value) for value in row) for row in np.column_stack([mode.shape_std for mode in test.modes])
        ),
        force_per_volt_rows=tuple((f, re, im) for f, re, im in rows) if len(points) == 1 else (),
        exciter_points=points if len(points) > 1 and rows else (),
        exciter_force_rows=rows if len(points) > 1 else (),
        **known,
    )


def _force_rows(test: LinearTest) -> tuple[tuple[float, ...], ...]:
    """Forces over voltages in the band, as far as the coherence is high: Hz, then N/V as real and imaginary parts.

    Of several exciters all lines around the target: there each force depends on what the others do.
    """
    if not test.voltage_frfs:
        return ()
    frequency = test.frequency_hz
    values, coherence = test.force_per_volt()
    low, high = test.settings.band_hz
    use = (frequency >= low) & (frequency <= high)
    use &= np.diagonal(coherence, axis1=1, axis2=2).min(axis=1) >= _COHERENT
    lines = np.flatnonzero(use)
    step = max(1, -(-lines.size // _MOST_ROWS))
    chosen = lines[::step]
    if len(test.voltage_frfs) > 1:
        near = np.abs(frequency / test.target_mode.frequency_hz - 1.0) < _NEAR_TARGET
        chosen = np.union1d(chosen, np.flatnonzero(near))
    return tuple(
        (
            float(f"{frequency[k]:.8g}"),
            *(float(f"{part:.6g}") for value in values[k].ravel() for part in (value.real, value.imag)),
        )
        for k in chosen
    )


def synthesis_correlation(test: LinearTest) -> FloatArray:
    """|Σ conj(H_s) H|² / (Σ|H_s|² Σ|H|²) of synthesised and measured receptance of every response to every force.

    Lines of the band of the residuals count; the responses to the first force come first.
    """
    low, high = test.residuals.band_hz
    use = (test.frequency_hz >= low) & (test.frequency_hz <= high)
    rows = len(test.points) * len(test.force_frfs)
    measured, synthesised = (values.reshape(rows, -1)[:, use] for values in (test.receptance(), test.synthesis()))
    cross = np.abs(np.sum(synthesised.conj() * measured, axis=1)) ** 2
    power = np.sum(np.abs(synthesised) ** 2, axis=1) * np.sum(np.abs(measured) ** 2, axis=1)
    return np.asarray(cross / power)


def linear_mapping(test: LinearTest, check: Linearity | None = None, level: float | None = None) -> dict[str, Any]:
    """Content of ``linear.json``.

    Args:
        test: result.
        check: comparison with a lower level.
        level: of the record, V rms.
    """
    values: dict[str, Any] = dict(asdict(description(test)))
    del values["shape_stds"]  # they stand among the uncertainties
    modes, plant = test.modes, test.plant
    values["uncertainties"] = {
        "frequencies_rad_s": [2.0 * math.pi * mode.frequency_std for mode in modes],
        "damping_ratios": [mode.damping_std for mode in modes],
        "shapes": np.column_stack([mode.shape_std for mode in modes]),
        "drive_point_shape": test.target_mode.drive_shape_std,
        "plant_frequency_rad_s": None if plant is None else 2.0 * math.pi * plant.frequency_std,
        "plant_damping_ratio": None if plant is None else plant.damping_std,
    }
    values["residuals"] = _residuals(test.residuals)
    values["target_residuals"] = _residuals(test.target_residuals)
    values["band_hz"] = list(test.settings.band_hz)
    values["estimator"] = {
        "record_s": test.duration_s,
        "level_v_rms": level,
        "segment_s": 1.0 / float(np.diff(test.frequency_hz[:2])[0]),
        "window": "hann",
        "independent_averages": test.force_frfs[0].independent_averages,
        "input_of_the_fit": test.reference,
    }
    values["fit"] = {
        "stabilisation": f"LSCF of sdypy-EMA {metadata.version('sdypy-EMA')}",
        "stable_within": {"frequency": FREQUENCY_TOLERANCE, "damping": DAMPING_TOLERANCE, "orders": MINIMUM_RUN},
        "stable_poles": [asdict(pole) for pole in test.stable],
        "modes": [_mode(test, index) for index in range(len(modes))],
        "further_modes": [
            {"frequency_hz": mode.frequency_hz, "damping_ratio": mode.damping_ratio} for mode in test.further_modes
        ],
        "suspension_below_band": test.suspension_below_band,
    }
    values["mass_estimate"] = estimated_mass(test.shapes)
    values["quality"] = {
        "coherence": [mode.coherence for mode in modes],
        "averaged_coherence": [mode.averaged_coherence for mode in modes],
        "synthesis_correlation": synthesis_correlation(test),
        "linearity": None if check is None else {**asdict(check), "is_linear": check.is_linear},
        "remarks": list(test.remarks),
    }
    return plain_json(values)  # type: ignore[no-any-return]


def _mode(test: LinearTest, index: int) -> dict[str, Any]:
    mode = test.modes[index]
    return {
        "frequency_hz": mode.frequency_hz,
        "damping_ratio": mode.damping_ratio,
        "complexity": mode.complexity,
        "complex_shape": mode.complex_shape,
        "drive_point_shape": mode.drive_shape,
        "drive_point_shape_std": mode.drive_shape_std,
        "averaged_frequency_hz": mode.averaged.frequency_hz,
        "averaged_damping_ratio": mode.averaged.damping_ratio,
        "fit_band_hz": [
            mode.fit.centre_hz - mode.fit.half_width_hz,
            mode.fit.centre_hz + mode.fit.half_width_hz,
        ],
        "lines": mode.fit.lines,
    }


def _residuals(residuals: Residuals) -> dict[str, Any]:
    return {"lower": residuals.lower, "upper": residuals.upper, "band_hz": list(residuals.band_hz)}


def frf_table(test: LinearTest) -> str:
    """``frf.csv``: frequency, then for every response over every force, and for every channel over every voltage, the
    estimates (real and imaginary part, SI units of the channels) and the coherence.

    With several exciters each input stands for itself, the other inputs at zero, and the coherence is the partial one.

    Columns are named ``<output>_<input>_<estimate>_real``, ``…_imag`` and ``<output>_<input>_coherence``.

    Examples:
        >>> test = nmt.linear(nmt.Bag.open("out/random"), modes=1, near_hz=370.0).test
        >>> head, *rows = frf_table(test).splitlines()
        >>> head.split(",")[:3]
        ['frequency_hz', 'a1_f1_h1_real', 'a1_f1_h1_imag']
        >>> len(rows) > 100
        True
    """
    head: list[str] = ["frequency_hz"]
    columns: list[FloatArray] = [test.frequency_hz]
    for frf in (*test.force_frfs, *test.voltage_frfs):
        for row, output in enumerate(frf.outputs):
            name = f"{output}_{frf.input}"
            # The voltage carries no noise: its H1 says all.
            estimates: Sequence[tuple[str, ComplexArray | None]] = [("h1", frf.h1)]
            if frf in test.force_frfs:
                estimates = [("h1", frf.h1), ("h2", frf.h2), ("hv", frf.hv), ("hc", frf.hc)]
            for label, values in estimates:
                if values is not None:
                    head += [f"{name}_{label}_real", f"{name}_{label}_imag"]
                    columns += [values[row].real, values[row].imag]
            head.append(f"{name}_coherence")
            columns.append(frf.coherence[row])
    return csv_text([head, *([f"{value:.9g}" for value in row] for row in np.column_stack(columns).tolist())])
