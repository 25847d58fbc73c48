"""What a rig file may say by its schema and no rig can be: checked on the model before anything is started."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.linalg import LinAlgError

from nmt_core.errors import BenchError
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.propagator import StateSpace, state_space
from nmt_rig.rig_file import KeyPath, RigDocument
from nmt_rig.rig_model import build_elements, build_structure, build_system
from nmt_rig.rig_sections import Rig
from nmt_rig.structure_sections import BeamSection

MOST_BEAM_ELEMENTS = 200
MOST_SENSORS = 200
LONGEST_DELAY = 10.0  # s
HIGHEST_RATE = 1e7  # Hz
_HIGHEST_CORNER = 1000.0  # sampling rates; a filter beyond it changes no sample
_FASTEST = 1e16  # rad/s; entries of the state matrix are larger than its eigenvalues, by far on a fine mesh
_HEAVIEST_RATIO = 1e12  # of the masses along the diagonal: more leaves nothing of the small ones in double precision


def check_physics(rig: Rig, document: RigDocument, vibrating: bool = True) -> None:
    """Refuse a rig whose model cannot be integrated, or not in reasonable time.

    Args:
        rig: validated against the schema.
        document: the file, for places.
        vibrating: whether the mode under test has to swing.

    Raises:
        BenchError: with the place, where one key is to blame.
    """
    _check_sizes(rig, document)
    blame = f"{document.name}: the model of rig {rig.name}"
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            structure = build_structure(rig)
            modes = sticking_modes(structure, build_elements(rig, structure))
            system = build_system(rig)
            masses = np.diag(system.mass)
            masses = masses[masses != 0.0]
            fastest = _fastest_rate(state_space(system))
        except (LinAlgError, ValueError, OverflowError, FloatingPointError, ZeroDivisionError) as error:
            raise BenchError(
                f"{blame} cannot be computed ({str(error).splitlines()[0].rstrip('.')}); a mass, stiffness or "
                "electrical value is out of all proportion to the others: check the units."
            ) from error
    if not np.isfinite(masses).all() or masses.max() > _HEAVIEST_RATIO * np.abs(masses).min():
        raise BenchError(
            f"{blame} has masses from {np.abs(masses).min():.3g} to {masses.max():.3g} kg (or kg m²), which no "
            "computation distinguishes: check the units of the masses."
        )
    if not fastest <= _FASTEST:
        raise BenchError(
            f"{blame} has a time constant of {1.0 / fastest:.3g} s, far below all others: check stiffnesses, masses, "
            "and inductance against resistance of the exciter."
        )
    if not vibrating:
        return
    frequency = float(modes.frequencies[rig.test.mode - 1]) / (2.0 * np.pi)
    if frequency == 0.0:
        rigid = int(np.sum(modes.frequencies == 0.0))
        words = f"modes 1 to {rigid} are rigid-body modes" if rigid > 1 else "mode 1 is a rigid-body mode"
        raise BenchError(
            f"{document.place(('test', 'mode'))}: {words} of rig {rig.name} at 0 Hz; choose an elastic "
            "mode (test.mode), or hold the structure by a spring."
        )
    if not 0.0 < frequency < 0.5 * rig.sample_rate_hz:
        place = document.place(("sample_rate_hz",))
        raise BenchError(
            f"{place}: mode {rig.test.mode} of rig {rig.name} is at {frequency:.4g} Hz, which {rig.sample_rate_hz:g} "
            "samples a second do not show; choose another test.mode or sample_rate_hz."
        )


def _check_sizes(rig: Rig, document: RigDocument) -> None:
    structure = rig.structure
    if isinstance(structure, BeamSection):
        count = structure.elements * structure.mesh_refinement
        if count > MOST_BEAM_ELEMENTS:
            raise BenchError(
                f"{document.place(('structure', 'elements'))}: elements times mesh_refinement is {count}; with more "
                f"than {MOST_BEAM_ELEMENTS} the simulated rig takes many times the time that it simulates."
            )
    if rig.sample_rate_hz > HIGHEST_RATE:
        raise BenchError(
            f"{document.place(('sample_rate_hz',))}: sample_rate_hz is {rig.sample_rate_hz:g}; no bench samples faster "
            f"than {HIGHEST_RATE:g} Hz."
        )
    if len(rig.sensors) > MOST_SENSORS:
        raise BenchError(
            f"{document.place(('sensors',))}: {len(rig.sensors)} sensors are more than the {MOST_SENSORS} that a block "
            "can carry; leave some out."
        )
    for index, sensor in enumerate(rig.sensors):
        path: KeyPath = ("sensors", index)
        if abs(sensor.delay_s) > LONGEST_DELAY:
            raise BenchError(
                f"{document.place((*path, 'delay_s'))}: sensors.{index}.delay_s is {sensor.delay_s:g} s; a channel "
                f"lags by {LONGEST_DELAY:g} s at most."
            )
        for key in ("low_pass_hz", "high_pass_hz"):
            value = getattr(sensor, key)
            if value is not None and value > _HIGHEST_CORNER * rig.sample_rate_hz:
                raise BenchError(
                    f"{document.place((*path, key))}: sensors.{index}.{key} is {value:g} Hz, far beyond what "
                    f"{rig.sample_rate_hz:g} samples a second show; leave it out."
                )


def _fastest_rate(space: StateSpace) -> float:
    """Order of the largest rate of the system at rest, rad/s: √(K/M), C/M and R/L, entry by entry."""
    m, a = space.mechanical_size, np.abs(space.a)
    rates = [np.sqrt(a[m : 2 * m, :m]).max(), a[m : 2 * m, m : 2 * m].max(), a[2 * m :, 2 * m :].max(initial=0.0)]
    return float(np.max(rates))
