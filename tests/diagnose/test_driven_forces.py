"""Local forces under a random drive: how they follow a small change of the rig, beside forces that are found anew."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.predicted_tests import chain, noise_test, rows_of

from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.prediction import gaussian_motion
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_rig.rig import load_rig

FRICTION = {"kind": "tanh_friction", "point": 2, "slip_force_n": 0.05, "reference_velocity_m_s": 1e-3}
SPRING = {"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 3e9}


@pytest.mark.parametrize("name", ["joint", "friction and spring"])
def test_responses_follow_their_parameters_as_those_found_anew_do(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of fourth order in steps ten thousand times those of a fit, forces and motion found at each of them."""
    rig = load_rig("beam") if name == "joint" else chain(local_elements=[FRICTION, SPRING])
    test, table = noise_test(rig, 10.0, 60.0, 40)
    forward = Forward([test], rows_of(table), PredictionSettings())
    parametrisation = Parametrisation(rig, calibration_parameters(rig))
    theta, step = np.full(parametrisation.size, 0.1), 0.02
    prediction = forward.predict(parametrisation.rig(theta))
    searches: list[None] = []
    settled = gaussian_motion._settled
    with monkeypatch.context() as patch:
        patch.setattr(gaussian_motion, "_settled", lambda *tables: (searches.append(None), settled(*tables))[1])
        slopes = forward.jacobian(parametrisation, theta, prediction)
    assert len(searches) == 1
    still = forward.predict(chain(local_elements=[]) if name != "joint" else rig).values
    assert name == "joint" or np.max(np.abs(forward.difference(still, prediction.values))) > 0.1
    for column, label in enumerate(parametrisation.names):
        total = np.zeros(slopes.shape[0])
        for steps, weight in ((-2.0, 1.0), (-1.0, -8.0), (1.0, 8.0), (2.0, -1.0)):
            moved = theta.copy()
            moved[column] += steps * step
            values = forward.predict(parametrisation.rig(moved)).values
            total += weight * forward.difference(values, prediction.values)
        expected = total / (12.0 * step)
        size = np.max(np.abs(expected))
        np.testing.assert_allclose(slopes[:, column], expected, atol=1e-3 * size + 1e-7, err_msg=label)
