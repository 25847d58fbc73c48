"""A decay of two masses whose shape changes with the amplitude, integrated here, against the twin of the diagnosis."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.twin_tests import rows_of
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

from nmt_core.blocks import Quantity
from nmt_diagnose.observations.conditions import MeasuredChannel, RingDownTest
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.twin.forward import Forward
from nmt_rig.rig import Rig, load_rig

MASS, STIFFNESS = np.diag([1.0, 0.6]), np.array([[90_000.0, -30_000.0], [-30_000.0, 45_000.0]])
CUBIC = 4e9  # N/m³, from mass 2 to the ground
# The second mode dies at once, so that what is left is the nonlinear mode.
DAMPING = (0.006, 0.08)
SQUARES, SHAPES = eigh(STIFFNESS, MASS)
OMEGA = np.sqrt(SQUARES)
PERIODS = np.array([10, 16, 24, 34, 50])


@pytest.fixture(scope="module")
def motion() -> dict[str, np.ndarray]:
    """Time, and displacements, velocities and accelerations of both masses."""
    inverse = np.linalg.inv(MASS)
    viscous = MASS @ SHAPES @ np.diag(2.0 * np.array(DAMPING) * OMEGA) @ SHAPES.T @ MASS

    def change(_: float, state: np.ndarray) -> np.ndarray:
        x, v = state[:2], state[2:]
        return np.concatenate([v, -inverse @ (viscous @ v + STIFFNESS @ x + [0.0, CUBIC * x[1] ** 3])])

    hit = np.concatenate([[0.0, 0.0], 0.35 * SHAPES[:, 0] / SHAPES[0, 0]])
    found = solve_ivp(change, (0.0, 1.7), hit, method="DOP853", rtol=1e-10, atol=1e-13, dense_output=True)
    time = np.arange(0.0, 1.7, 5e-5)
    states = found.sol(time)
    rates = np.array([change(0.0, state) for state in states.T]).T
    rows = {"x1": states[0], "x2": states[1], "v1": states[2], "a1": rates[2], "a2": rates[3]}
    return {"time": time, **rows}


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    modes = "".join(
        f"    - {{frequency_hz: {omega / (2 * np.pi):.12g}, damping_ratio: {ratio}, modal_mass_kg: 1.0, "
        f"shape: [{shape[0]:.12g}, {shape[1]:.12g}]}}\n"
        for omega, ratio, shape in zip(OMEGA, DAMPING, SHAPES.T, strict=True)
    )
    sensors = "".join(
        f"  - {{quantity: {quantity}, point: {point}}}\n"
        for quantity, point in (("force", "drive"), *((q, p) for q in ("displacement", "acceleration") for p in (1, 2)))
    )
    path = tmp_path_factory.mktemp("rig") / "two_masses.yaml"
    path.write_text(
        f"name: two_masses\nstructure:\n  kind: modal\n  points: [1, 2]\n  modes:\n{modes}"
        f"local_elements: [{{kind: cubic_spring, point: 2, stiffness_n_m3: {CUBIC}}}]\n"
        f"exciter: {{kind: force, point: 1}}\nsensors:\n{sensors}  - {{quantity: velocity, point: 1}}\n"
        "extraction: {quantity: displacement, linear_modes: 2}\n"
    )
    return load_rig(path)


@pytest.mark.parametrize("name", ["x1", "v1", "a1", "x2", "a2"])
def test_each_channel_decays_at_its_own_rate(name: str, motion: dict[str, np.ndarray], rig: Rig) -> None:
    """Their rates differ by up to half, since frequency and shape change; fundamentals period by period."""
    displacement = CubicSpline(motion["time"], motion["x1"])
    crossings = displacement.roots(extrapolate=False)
    ups = crossings[displacement.derivative()(crossings) > 0.0]
    middle, period = 0.5 * (ups[1:] + ups[:-1]), np.diff(ups)
    share = (np.arange(400) + 0.5) / 400
    own = CubicSpline(motion["time"], motion[name])
    turned = own(ups[:-1, None] + period[:, None] * share) * np.exp(-2j * np.pi * share)
    log, log_omega = np.log(2.0 * np.abs(turned.mean(axis=1))), np.log(2.0 * np.pi / period)
    about = [slice(k - 3, k + 4) for k in PERIODS]
    fits = [np.polyfit(middle[at] - middle[k], log[at], 2) for at, k in zip(about, PERIODS, strict=True)]
    omega = np.exp(
        [np.polyfit(middle[at] - middle[k], log_omega[at], 2)[2] for at, k in zip(about, PERIODS, strict=True)]
    )
    ratio = np.array([-fit[1] for fit in fits]) / omega
    quantity = {"x": Quantity.DISPLACEMENT, "v": Quantity.VELOCITY, "a": Quantity.ACCELERATION}[name[0]]
    channel = MeasuredChannel(name, quantity, int(name[1]))
    test = RingDownTest("decay", 1, channel, np.exp([fit[2] for fit in fits]), float(omega[0]) / (2.0 * np.pi))
    table = [(0, k, 0, 1, part) for k in range(PERIODS.size) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
    values = Forward([test], rows_of(table)).predict(rig).values
    np.testing.assert_allclose(np.exp(values[::2]), omega, rtol=1e-4)
    np.testing.assert_allclose(values[1::2], ratio, rtol=4e-3)
