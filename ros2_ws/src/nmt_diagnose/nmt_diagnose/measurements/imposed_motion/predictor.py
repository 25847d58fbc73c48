"""Imposed motion: the drive point moves as measured, and force and further responses follow.

With p = c / cᵀc and columns N that span what c does not see, the unknowns are q = p w + N z: w is the measured motion
of the drive point, c its row, and z what stays free. Nᵀ times the equation of motion tells z, pᵀ times it the force:

    NᵀMN z̈ + NᵀCN ż + NᵀKN z = −Nᵀ (M p ẅ + C p ẇ + K p w + Σ d g),
    u = pᵀ (M q̈ + C q̇ + K q + Σ d g) / pᵀb.

(Craig, Structural Dynamics (1981), ch. 14, with base motion.) Where the structure has one unknown nothing is left to
integrate: mass, damper, spring and local laws are evaluated along the motion. So no spring to the ground and no mode is
needed. Between two steps the motion of z is that of :mod:`nmt_diagnose.prediction.record_kernel`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import CubicSpline

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.driven_record.predictor import recorded, stepped_model, substeps_of
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.imposed_kernel import MOTIONS_GIVEN, follow
from nmt_diagnose.prediction.linear_model import LinearModel, OutputRows, linear_model
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion

_ERROR_STEP = 0.05  # of a standard deviation, for differences


class ImposedMotionPredictor(Predictor):
    """Predicts force and responses of one record of an imposed motion.

    Args:
        test: the record.
        rows: its rows.
        settings: of the predictor.
    """

    def __init__(self, test: ImposedMotion, rows: Rows, settings: PredictionSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        self.channels = tuple(test.channels)
        self.use(Setup(test.drive_points, True, self.channels, FourierBasis.up_to(1)))
        self._sample = np.clip(
            np.round((rows.time_s - test.start_s) * test.sample_rate).astype(np.int64), 0, test.input.size - 1
        )

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        self.setup = setup
        self._own = np.array(setup.index(self.channels), dtype=np.int64)

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any] = ()) -> FloatArray:
        """Observables of the test's rows."""
        return self._of_rows(self._responses(rig, cache, self.test.motion), np.nan)

    def errors(self, rig: Rig, cache: PartsCache, chain: MeasuringChain | None) -> dict[str, FloatArray]:
        """What a standard deviation of each error of the record adds to its rows, (rows,) each.

        Args:
            rig: about whose motion they act.
            cache: of the prediction.
            chain: of the record; None = that of the bench's simulator, whose sensors have no zeros and no gains.
        """
        if chain is None or not self.test.zeros.size:
            return {}
        test = self.test
        base = self._responses(rig, cache, test.motion)
        found: dict[str, FloatArray] = {}
        for what, moved in (("zero", test.with_zero(_ERROR_STEP)), ("gain", test.with_gain(_ERROR_STEP))):
            change = (self._responses(rig, cache, moved) - base) / _ERROR_STEP
            found[f"{what} of {test.input_channel.name} in {test.name}"] = self._of_rows(change)
        for number, channel in enumerate(self.channels):
            selected = (self.rows.part == Part.SAMPLE) & (self.rows.channel == number)
            found[f"zero of {channel.name} in {test.name}"] = test.zeros[1 + number] * selected
            found[f"gain of {channel.name} in {test.name}"] = (
                chain.of(channel.name).gain * self._of_rows(base) * selected
            )
        return found

    def _of_rows(self, responses: FloatArray, other: float = 0.0) -> FloatArray:
        selected = self.rows.part == Part.SAMPLE
        return np.where(selected, responses[np.maximum(self.rows.channel, 0), self._sample], other)

    def _responses(self, rig: Rig, cache: PartsCache, motion: FloatArray) -> FloatArray:
        """Recorded channels, (channels, samples)."""
        test = self.test
        parts = cache.parts(rig, self.setup, test.start_s + 0.5 * test.input.size / test.sample_rate)
        rate = test.sample_rate * parts.clock
        rows = np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._own))
        free = free_model(parts, self.settings)
        substeps = substeps_of(free, rate) if free.poles.size else 1
        model = stepped_model(free, parts.coordinates, rows, 1.0 / (rate * substeps))
        steps = _between(motion * np.array([1.0, parts.clock, parts.clock**2])[:, None], substeps)
        timed = parts.timed.tables(test.signals, substeps)
        raw = follow(steps, substeps, parts.coordinates, model, parts.force_factor, parts.tables, timed)
        return recorded(raw, parts, self._own, rate)


def free_model(parts: RigParts, settings: PredictionSettings) -> LinearModel:
    """Linear model of what moves freely while the motion of the drive point is given.

    Args:
        parts: of a rig with an ideal force.
        settings: reduction.

    Returns:
        Inputs are the local forces, then displacement, velocity and acceleration of the drive point; outputs as those
        of ``parts.linear``.
    """
    system, r = parts.system, parts.coordinates
    m, c, k = system.mass, system.damping, system.stiffness
    b = parts.inputs[:, r]
    p, n = _split(system.selector(system.drive_point))
    given = np.stack((k @ p, c @ p, m @ p), axis=1)
    local = parts.inputs[:, :r]
    share = float(p @ b)
    # The force as an output of q and of the inputs.
    along = p[None] / share
    force = OutputRows(along @ k, along @ c, along @ m, -along @ local)
    rows = parts.rows
    feed = rows.feedthrough[:, r : r + 1]
    whole = OutputRows(
        rows.displacement + feed @ force.displacement,
        rows.velocity + feed @ force.velocity,
        rows.acceleration + feed @ force.acceleration,
        rows.feedthrough[:, :r] + feed @ force.feedthrough,
    )
    direct = np.stack((whole.displacement @ p, whole.velocity @ p, whole.acceleration @ p), axis=1)
    feedthrough = np.hstack((whole.feedthrough, direct))
    if not n.shape[1]:
        nothing = np.zeros((rows.displacement.shape[0], 0), dtype=np.complex128)
        none = np.zeros(0, dtype=np.complex128)
        shares = np.zeros((0, r + MOTIONS_GIVEN), dtype=np.complex128)
        return LinearModel(none, nothing, nothing, nothing, shares, feedthrough.astype(np.complex128))
    # The force itself acts along p alone.
    inputs = n.T @ np.hstack((local, -given))
    reduced = replace(
        system, mass=n.T @ m @ n, damping=n.T @ c @ n, stiffness=n.T @ k @ n, exciters=(), elements=(), points={},
        structure_size=n.shape[1],
    )  # fmt: skip
    outputs = OutputRows(whole.displacement @ n, whole.velocity @ n, whole.acceleration @ n, feedthrough)
    return linear_model(reduced, inputs, outputs, settings.kept_modes, settings.full_size)


def _between(motion: FloatArray, substeps: int) -> FloatArray:
    """The motion (3, n) with steps between its samples; sample k comes to stand at ``substeps`` k."""
    if substeps == 1:
        return motion
    samples = np.arange(motion.shape[1])
    fine = np.minimum(np.arange(substeps * samples.size) / substeps, samples[-1])
    return np.asarray(CubicSpline(samples, motion, axis=1)(fine))


def _split(row: FloatArray) -> tuple[FloatArray, FloatArray]:
    """p with row · p = 1, and an orthonormal basis (n, n − 1) of what the row does not see (Householder)."""
    size = float(np.linalg.norm(row))
    pivot = int(np.argmax(np.abs(row)))
    mirror = row / size
    mirror[pivot] += np.sign(mirror[pivot])
    basis = np.eye(row.size) - 2.0 * np.outer(mirror, mirror) / float(mirror @ mirror)
    return row / size**2, np.delete(basis, pivot, axis=1)
