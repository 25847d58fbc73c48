"""The model alone, fitted to the observations: the first of all explanations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray
from nmt_diagnose.chain.chain_columns import shared_delays
from nmt_diagnose.effects.calibration import CalibrationParameter, calibration_parameters, mode_factors
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.best_fit import StartName, best_fit, from_believed, likelihood
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import Data, FitError, FitResult, Start, data_about, fit
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.prediction.forward import Forward, Prediction, traced
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

# Times that the measuring chain is taken anew about the model's fit: it is linear, and the second round starts near.
_CHAIN_ROUNDS = 2
# Order of the solution that shows what the harmonic balance leaves out: three times as many leave 2 % of it.
_FINE_HARMONICS = 27


def free_parameters(rig: Rig, observations: Observations) -> tuple[CalibrationParameter, ...]:
    """Parameters that are free in every explanation: of the model, damping of its modes, delays of its sensors."""
    return (*own_and_modes(rig, observations), *shared_delays(observations, rig))


def own_and_modes(rig: Rig, observations: Observations) -> tuple[CalibrationParameter, ...]:
    """Parameters of the model and of its modes in the band of the observations."""
    of_modes = mode_factors(rig, *_band(observations))
    # A factor on the damping matrix is redundant with a factor for each of its modes.
    each = any(parameter.path == ("structure", "damping_factors") for parameter in of_modes)
    of_model = (p for p in calibration_parameters(rig) if not (each and p.path == ("structure", "damping_factor")))
    return (*of_model, *of_modes)


def model_alone(
    rig: Rig,
    observations: Observations,
    parameters: Sequence[CalibrationParameter],
    fitted: BoolArray,
    modes: LowLevelModes,
) -> tuple[Observations, Prediction, FittedExplanation, Data]:
    """The model alone: first by logarithms, then with its chain about where it stands.

    Args:
        rig: the model.
        observations: the real side.
        parameters: those of the model and its chain that are free.
        fitted: rows that are compared, (m,).
        modes: of the observations.

    Returns:
        Observations with the error of the solver, prediction of the model as given, its fit, and what that worked on.

    Raises:
        BenchError: the model has no solution for most of the observations.
    """
    try:
        as_given = Forward(observations.tests, observations.rows).predict(rig)
        observations = replace(observations, tests=traced(observations.tests, as_given))
        as_given = Forward(observations.tests, observations.rows).predict(rig, as_given)
        used = np.isfinite(as_given.values) & fitted
        if used.sum() < THRESHOLDS.fits.least_solved_share * fitted.sum():
            raise FitError("it has no solution for most of the observables")
        observations = _with_solver_error(observations, rig, as_given)
        parametrisation = Parametrisation(rig, tuple(parameters))
        data = data_about(observations, rig, as_given, used, logarithms=True)
        starts = [Start(StartName.GIVEN, parametrisation.zero, as_given)]
        if modes.far_from(rig):
            starts.append(Start(StartName.MODES, modes.start(parametrisation, parametrisation.zero)[0]))
        found = best_fit(data, parametrisation, starts, value=likelihood)
        for _ in range(_CHAIN_ROUNDS):
            data = about(rig, observations, found, used)
            found = from_believed(data, fit(data, parametrisation, Start(found.start, found.theta, found)))
    except (FitError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise BenchError(f"The model cannot be compared with the observations: {error}.") from error
    return data.observations, as_given, FittedExplanation((), found), data


def about(rig: Rig, observations: Observations, near: FitResult, used: BoolArray) -> Data:
    """What fits work on, noise of measured amplitudes and errors of the chain about a fit."""
    observations = replace(observations, tests=traced(observations.tests, near.prediction))
    fitted_rig = near.parametrisation.rig(near.theta)
    prediction = Forward(observations.tests, observations.rows).predict(fitted_rig, near.prediction)
    return data_about(observations, fitted_rig, prediction, used & np.isfinite(prediction.values))


def _with_solver_error(observations: Observations, rig: Rig, as_given: Prediction) -> Observations:
    """The observations with what harmonics that the harmonic balance leaves out change, as part of their floor."""
    fine = Forward(observations.tests, observations.rows, PredictionSettings(harmonics=_FINE_HARMONICS))
    change = np.abs(np.nan_to_num(fine.difference(fine.predict(rig).values, as_given.values)))
    return replace(observations, floor=np.hypot(observations.floor, change))


def _band(observations: Observations) -> tuple[float, float]:
    """Lowest and highest frequency of all rows, Hz; empty where none has one."""
    known = observations.rows.frequency_hz
    known = known[np.isfinite(known) & (known > 0.0)]
    return (float(known.min()), float(known.max())) if known.size else (1.0, 0.0)
