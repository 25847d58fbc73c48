"""Compiles the predictor's kernels into their cache."""

from __future__ import annotations

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.effects.rig_edit import with_element
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record import DrivenRecord
from nmt_diagnose.measurements.imposed_motion import ImposedMotion
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import LockedLevel, Measurement
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.model.local_elements.springs import CubicSpringSection
from nmt_rig.rig import Rig


def warm_up_predictions(rig: Rig) -> None:
    """Predict one test of each kind for a rig, and its sensitivities; a level without a solution does not matter."""
    point = rig.drive_point
    force = MeasuredChannel("f", Quantity.FORCE, point)
    response = MeasuredChannel("x", Quantity.DISPLACEMENT, point)
    both = (force, response)
    level = LockedLevel(0, 0.1, 0.0, 0.0, 22.0, 0.0, 1.0, 0.0, 1)
    tests: tuple[Measurement, ...] = (
        LockedWindows("locked", (point,), "x", both, 3, "voltage", (level,)),
        RandomResponses("noise", point, both, "voltage", np.array([20.0, 21.0]), 1.0, "none", 0.1, 0.0, 1.0, 1000.0),
        RecordedDecay("decay", point, response, np.array([1e-6]), 22.0),
        DrivenRecord(
            "record", point, 1000.0, MeasuredChannel("u", Quantity.VOLTAGE, 0), np.ones(8), (response,),
            np.array([0.0, 8.0]),
        ),
        ImposedMotion(
            "imposed", point, 1000.0, response, np.ones(8), (force,), np.array([0.0, 8.0]), motion=np.ones((3, 8)),
        ),
        SteppedResponses(
            "stepped", point, (response,), "force", "force", np.array([20.0]), np.array([0.1]),
            np.array([[1e-4 + 0j]]), np.array([0.01]),
        ),
        RandomResponses("lines", point, both, "force", np.array([20.0, 21.0]), 1.0, "none", 0.1, 0.0, 1.0),
    )  # fmt: skip
    parts = (Part.LOG_FREQUENCY, Part.LOG_MAGNITUDE, Part.DAMPING, Part.PHASE, Part.SAMPLE, Part.SAMPLE,
             Part.LOG_MAGNITUDE, Part.LOG_MAGNITUDE)  # fmt: skip
    of_test = np.array([0, 1, 2, 2, 3, 4, 5, 6])
    zero, none = np.zeros(len(parts), dtype=np.int64), np.zeros(len(parts))
    rows = Rows(of_test, zero, zero, zero + 1, np.array([int(part) for part in parts]), none, none, none)
    forward = Forward(tests, rows)
    parametrisation = Parametrisation(rig, calibration_parameters(rig)[:1])
    solved = forward.predict(rig)
    forward.jacobian(parametrisation, parametrisation.zero, solved)
    # An element at a coordinate that the rig has no force at.
    taken = {element.point for element in rig.local_elements}
    free = next((p for p in rig.structure.points if p not in taken), point)
    more = with_element(rig, CubicSpringSection(kind="cubic_spring", point=free, stiffness_n_m3=1.0))
    forward.jacobian(Parametrisation(more, calibration_parameters(more)[:1]), parametrisation.zero, solved)
