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


def warm_up_predictions(rig: Rig, records: bool) -> None:
    """Predict one test of each kind for a rig, and its sensitivities; a level without a solution does not matter.

    Args:
        rig: any rig with a local element.
        records: decays and records of samples; else levels and frequency responses.
    """
    point = rig.drive_point
    force = MeasuredChannel("f", Quantity.FORCE, point)
    response = MeasuredChannel("x", Quantity.DISPLACEMENT, point)
    both = (force, response)
    level = LockedLevel(0, 0.1, 0.0, 0.0, 22.0, 0.0, 1.0, 0.0, 1)
    drive, window = MeasuredChannel("u", Quantity.VOLTAGE, 0), np.array([0.0, 8.0])
    band = np.array([20.0, 21.0])
    of_responses: tuple[tuple[Measurement, tuple[Part, ...]], ...] = (
        (LockedWindows("locked", (point,), "x", both, 3, "voltage", (level,)), (Part.LOG_FREQUENCY,)),
        (
            RandomResponses("noise", point, both, "voltage", band, 1.0, "none", 0.1, 0.0, 1.0, 1000.0),
            (Part.LOG_MAGNITUDE,),
        ),
        (RandomResponses("lines", point, both, "force", band, 1.0, "none", 0.1, 0.0, 1.0), (Part.LOG_MAGNITUDE,)),
        (
            SteppedResponses(
                "stepped", point, (response,), "force", "force", np.array([20.0]), np.array([0.1]),
                np.array([[1e-4 + 0j]]), np.array([0.01]),
            ),
            (Part.LOG_MAGNITUDE,),
        ),
    )  # fmt: skip
    of_records: tuple[tuple[Measurement, tuple[Part, ...]], ...] = (
        (RecordedDecay("decay", point, response, np.array([1e-6]), 22.0), (Part.DAMPING, Part.PHASE)),
        (DrivenRecord("record", point, 1000.0, drive, np.ones(8), (response,), window), (Part.SAMPLE,)),
        (
            ImposedMotion("imposed", point, 1000.0, response, np.ones(8), (force,), window, motion=np.ones((3, 8))),
            (Part.SAMPLE,),
        ),
    )
    tests = of_records if records else of_responses
    parts = [(number, int(part)) for number, (_, asked) in enumerate(tests) for part in asked]
    of_test, of_part = np.array(parts, dtype=np.int64).T
    zero, none = np.zeros(len(parts), dtype=np.int64), np.zeros(len(parts))
    rows = Rows(of_test, zero, zero, zero + 1, of_part, none, none, none)
    forward = Forward(tuple(test for test, _ in tests), rows)
    parametrisation = Parametrisation(rig, calibration_parameters(rig)[:1])
    solved = forward.predict(rig)
    forward.jacobian(parametrisation, parametrisation.zero, solved)
    # An element at a coordinate that the rig has no force at.
    taken = {element.point for element in rig.local_elements}
    free = next((p for p in rig.structure.points if p not in taken), point)
    more = with_element(rig, CubicSpringSection(kind="cubic_spring", point=free, stiffness_n_m3=1.0))
    forward.jacobian(Parametrisation(more, calibration_parameters(more)[:1]), parametrisation.zero, solved)
