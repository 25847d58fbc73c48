"""What thresholds of the loops decide, on either side of each: small cases whose outcome is known by hand."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, patch

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.kinds import ResponseCurveTest
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import ControlKind, CurveParameter, LoopState, TestKind
from nmt_pll.amplitude.response_control import ResponseController
from nmt_pll.force_control.force_controller import ForceController, ForceSetup, integral_rate, most_harmonics
from nmt_pll.force_control.force_per_volt import fundamental_gain
from nmt_pll.force_control.gain_estimate import GainEstimate
from nmt_pll.force_control.modal_power_ratio import ModalPowerRatio, check_modes
from nmt_pll.force_control.mode_shape_targets import ModeShapeTargets
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.open_loop.sweep_loop import SteppedSineLoop, _Stage
from nmt_pll.phase_loop.loop import PhaseLockedLoop
from nmt_pll.secondary import secondary_loop
from nmt_pll.secondary.secondary_loop import SecondaryResonanceLoop
from nmt_pll.self_excited.self_excited_control import AmplitudeLaw, SelfExcitedPlant
from nmt_pll.self_excited.self_excited_loop import SelfExcitedLoop, _Act
from nmt_pll.thresholds import SECONDARY
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig
from nmt_session.curve_loop import curve_values


def waits(error: float) -> bool:
    """Whether the target waits where the amplitude is off by so much, in ln."""
    controller = ResponseController()
    controller.start(1.0)
    controller.target = 1.0
    controller.aim(10.0)
    controller.update(2.0, math.exp(-error), 1.0, 1.0, 1.0)
    return controller.target == 1.0


def learnt(gain: float) -> float:
    """What is learnt of a gain over what was known at first, from a clear move."""
    estimate = GainEstimate(1, 1)
    one = np.ones((1, 1), dtype=complex)
    estimate.learn(one[:, :, None], gain * one, np.zeros((1, 1)), np.full((1, 1), 1e-12))
    return round(float(abs(estimate.correction[0, 0])), 4)


def forgotten() -> float:
    """Variance of a gain of which nothing has been learnt for long."""
    estimate = GainEstimate(1, 1)
    estimate.grow(1e9)
    return float(estimate.covariance[0, 0, 0].real)


def linear(modes: int) -> Any:
    return SimpleNamespace(
        frequencies_rad_s=(1.0,) * modes, points=tuple(range(1, modes + 1)), drive_point=1, shape_matrix=np.eye(modes)
    )


def refused(modes: int) -> bool:
    try:
        check_modes(linear(modes), "Here")
    except BenchError:
        return True
    return False


def largest_target() -> float:
    """Target of a harmonic over the fundamental where the drive point hardly moves in it."""
    response = np.array([[1.0, 1e-3], [0.0, 1.0], [0.0, 0.0]], dtype=complex)
    force = np.array([[1.0j, 0.0]], dtype=complex)
    found = ModalPowerRatio(linear(3)).targets(force, response, Quantity.DISPLACEMENT, 1.0)
    return float(abs(found[0, 1]))


def fed() -> float:
    """Rate that feeds a motion which is far too small, times the dead time."""
    control = AmplitudeLaw(SelfExcitedPlant(10.0, 1.0, 1.0, 0.0, 0.5))
    return 0.5 * max(control.update(1.0, 1e30, 0.01) for _ in range(100))


def settled(mean: float = 0.0, newest: float = 0.0, noise: float = 0.0) -> bool:
    """Whether a force is at its target, by its mean and newest deviation over the tolerance and by its noise."""
    controller: Any = SimpleNamespace(
        _record=SimpleNamespace(mean_std=lambda noise: noise), _noise=np.full((1, 1), noise), _fundamental=1.0,
        _mean=np.full((1, 1), mean), _deviation=np.full((1, 1), newest), setup=SimpleNamespace(tolerance=1.0),
    )  # fmt: skip
    return bool(ForceController.settled.fget(controller)[0, 0])  # type: ignore[attr-defined]


def furthest_asked() -> float:
    """Highest frequency at which the force per volt of the fundamental is looked at, over that of the mode."""
    asked: list[float] = []

    def force_per_volt(frequency_hz: Any) -> Any:
        asked.extend(frequency_hz)
        return np.broadcast_to(np.eye(2, dtype=complex), (len(frequency_hz), 2, 2))

    fundamental_gain(force_per_volt, 100.0, 1.0, np.ones(2))
    return max(asked) / 100.0


def following() -> float:
    """Rate by which targets follow the shape, for a mode that lies 50 rad/s from another without damping."""
    several: Any = SimpleNamespace(
        frequencies_rad_s=(100.0, 150.0), damping_ratios=(0.0, 0.0), target_mode=0, points=(1, 2),
        exciter_points=(1, 2), shape_matrix=np.eye(2), exciter_force_rows=((1.0,),),
    )  # fmt: skip
    return ModeShapeTargets(several, False, 1e9, 5).following


def controller(mean: float = 0.0, **more: Any) -> Any:
    """What a controller knows of the second harmonic of one force: its mean deviation over the fundamental."""
    known = {
        "setup": SimpleNamespace(tolerance=0.0, cutoff=1.0, block_duration=1.0), "rate": 1.0, "given_up": {},
        "_record": SimpleNamespace(is_full=True), "_motion": 0.0, "_fundamental": 1.0, "_quiet": np.ones((1, 1)),
        "_since_look": np.full((1, 1), 9.0), "_looked_at": np.ones((1, 1)), "_strikes": np.zeros((1, 1)),
        "_limited": np.zeros((1, 1)), "_mean": np.array([[0.0, mean]]), "settled": np.zeros((1, 2), dtype=bool),
        "_estimate": SimpleNamespace(doubt=lambda which: None, forget=lambda which: None),
    }  # fmt: skip
    found = SimpleNamespace(**{**known, **more})
    found._share = lambda exciter, order: 0.0
    return found


def is_due(waited: float) -> bool:
    """Whether a harmonic is looked at after so many time constants."""
    found = controller(_since_look=np.full((1, 1), waited - 1.0))
    ForceController.review(found)
    return bool(found._since_look[0, 0] == 0.0)


def strikes(mean: float, before: int = 0) -> tuple[int, int]:
    """Looks without progress where so much is left of the deviation before, and harmonics that are given up."""
    found = controller(mean, _strikes=np.full((1, 1), before))
    ForceController.review(found)
    return int(found._strikes[0, 0]), len(found.given_up)


def largest_term() -> float:
    """Voltage of a harmonic over that of the fundamental that is left of five times as much."""
    found = controller(terms=np.array([[1.0, 5.0]]))
    found._room = lambda *_: None
    found._unit = found._taken_at = lambda *_: 1.0
    ForceController.limit_terms(found, 1.0, 1.0, 10.0, np.ones((1, 1, 1), dtype=complex))
    return float(found.terms[0, 1])


def gain_in_noise() -> float:
    found = controller(_noise=np.full((1, 2), 1e9), setup=SimpleNamespace(tolerance=1.0, cutoff=1.0))
    return float(ForceController.quiet_share(found)[0, 0])


def doubling_dwells() -> float:
    """Dwells of ten blocks in which an estimate of noise doubles where far more is seen."""
    record = SimpleNamespace(
        add=lambda values: None, length=10, blocks=10, mean_and_noise=lambda: (np.zeros(1), np.full(1, 1e9))
    )
    found = controller(_record=record, _noise=np.ones((1, 2)), _deviation=np.zeros((1, 2), dtype=complex))
    ForceController.judge_block(found)
    return 0.1 / math.log2(float(found._noise[0, 1]))


def doubling_time_constants() -> float:
    """Time constants of the loop in which the variance of a gain doubles."""
    grown: list[float] = []
    found = controller(_past=deque(maxlen=9), _estimate=SimpleNamespace(grow=grown.append))
    none = np.zeros((1, 2), dtype=complex)
    ForceController.learn_gains(found, none, none, [1.0 + 0j], none, 10.0)
    return 1.0 / math.log2(grown[0])


def free_window(growth: float) -> float:
    """Length of a window of a free motion of 1 Hz, s."""
    loop = SimpleNamespace(plant=SimpleNamespace(omega=2.0 * math.pi), _growth=growth)
    return float(SelfExcitedLoop.window_time.fget(loop))  # type: ignore[attr-defined]


def still() -> float:
    loop = SimpleNamespace(plant=SimpleNamespace(omega=1.0))
    return float(SelfExcitedLoop.still_growth.fget(loop))  # type: ignore[attr-defined]


def detuned(share: float) -> bool:
    """Whether a force at right angles to the velocity that shifts the frequency by a share keeps a loop from lock."""
    names = ("mean", "frequency_drift", "amplitude_drift")
    dwell: Any = SimpleNamespace(**dict.fromkeys([*names, *(f"{name}_std" for name in names)], 0.0))
    dwell.mean = share
    settings = SimpleNamespace(frequency_tolerance=1.0, amplitude_tolerance=1.0)
    loop: Any = SimpleNamespace(settings=settings, _amplitude_now=1.0)
    return bool(SelfExcitedLoop.obstacle(loop, dwell, 1.0))


def settled_without_noise(share: float) -> bool:
    """Whether a harmonic is settled at a deviation of a share of the fundamental, in a controller as it is set up."""
    setup = ForceSetup(2, 1.0, 0.01, 0, 0.0, 10)
    values = np.array([[0.0, share]])
    found = controller(
        setup=setup, _mean=values, _deviation=values.astype(complex),
        _noise=np.zeros((1, 2)), _record=SimpleNamespace(mean_std=lambda noise: noise),
    )  # fmt: skip
    return bool(ForceController.settled.fget(found)[0, 1])  # type: ignore[attr-defined]


def largest_step() -> float:
    """Change of a harmonic's voltage in a block over the amplitude, where half of the amplitude would be needed."""
    zero = np.zeros((1, 2), dtype=complex)
    found = controller(
        terms=zero, off=False, orders=np.arange(1), _rest=0, _past=deque(), _relative=False,
        _in_drive=lambda: np.zeros((1, 3)), _held=SimpleNamespace(advance=lambda values: values),
        _unit=lambda amplitude: amplitude, _known=lambda frequency_hz: (None, True), judge_block=lambda: None,
        quiet_share=lambda: np.ones((1, 1)), _step=lambda gain: np.array([[0.0, 1.0 + 0j]]),
        _given_up_and_works=lambda: (None, np.ones((1, 2), dtype=bool)),
    )  # fmt: skip
    found._estimate.gain = lambda known: None
    ForceController.update(found, zero, (), 10.0, 2.0, zero)
    return abs(complex(found.terms[0, 1])) / 2.0


def release_wait() -> int:
    """Milliseconds from the lock at the release's amplitude to the switch, at the lag that is the last to be taken."""
    switched: list[int] = []
    output = SimpleNamespace(amplitude=1.0, ramp=0.0, state=LoopState.LOCKED, frequency_hz=1.0)
    loop: Any = SimpleNamespace(
        _level=object(), _primary=SimpleNamespace(process=lambda force, response: output), _switch_until=math.inf,
        sample_rate=1000.0, _lag_after_switch=lambda *_: math.pi + SECONDARY.release_phase_rad - 1e-9,
        _switch=lambda level, primary, end: switched.append(end),
    )  # fmt: skip
    for end in range(0, 20000, 10):
        SecondaryResonanceLoop._release(loop, None, None, end)  # type: ignore[arg-type]
        if switched:
            break
    return switched[0]


def release_floor() -> float:
    """Floor of the response over the amplitude of the release."""
    loop: Any = SimpleNamespace(
        settings=LoopSettings(), linear=None, sample_rate=1.0, _block_samples=1, _releases=0, _stage=None
    )
    level = LevelCommand(1, 0, 1.0, 0, 1.0, ControlKind.RESPONSE, release=1.0)
    with patch.object(secondary_loop, "PhaseLockedLoop") as primary:
        SecondaryResonanceLoop._begin_release(loop, level, 0)
    return float(primary.call_args.args[1].response_floor / primary.return_value.set_level.call_args.args[0].amplitude)


def self_excited(amplitude: float = 1.0, **more: Any) -> Any:
    """A loop that holds a motion of 1 Hz at an amplitude of 1, and notes what it does."""
    plant = SimpleNamespace(omega=2.0 * math.pi, quadrature_rate=0.0, rate_per_force=1.0)
    law = SimpleNamespace(rate=1.0, update=lambda *_: 0.0)
    known = {
        "plant": plant, "_target": 1.0, "_from": 1.0, "_amplitude_now": amplitude, "_engaged": True, "_order": 0,
        "_approached": 0, "sample_rate": 1000.0, "_chosen": "amplitude", "_laws": {"amplitude": law, "envelope": law},
        "block_duration": 0.01, "_free": True, "_quadrature": 0.0, "_deadline": math.inf, "_drive": 0j,
        "_largest": math.inf, "_from_above": True, "_ramp_end": 0, "_judged_from": math.inf, "_displacement": 1.0,
        "_level": SimpleNamespace(amplitude=1.0, duration=math.inf), "_act": _Act.HOLD, "_tried": set(),
        "machine": SimpleNamespace(state=LoopState.ACQUIRING), "settings": SimpleNamespace(latency_blocks=0),
        "_window_until": 0, "_release_from": 0, "cutoff": 100.0, "_growth": 0.0, "still_growth": 1e-3,
        "_logarithms": [math.log(amplitude)], "method": "envelope", "_settled_at": 0.5,
    }  # fmt: skip
    loop = SimpleNamespace(**{**known, **more}, done=[])
    loop._begin_ramp = lambda end: None
    loop._wanted = lambda end: 1.0
    loop._apply = lambda rate, direction, amplitude: loop.done.append(rate)
    for name in ("_lose", "_again", "_approach", "_open"):
        setattr(loop, name, lambda *arguments, name=name: loop.done.append((name, arguments[0])))
    return loop


def held(amplitude: float, **more: Any) -> Any:
    """A loop after one block in which it held a motion."""
    loop = self_excited(amplitude, **more)
    SelfExcitedLoop._hold(loop, 1j, 1.0 + 0j, 1.0 + 0j, 1.0, 1)
    return loop


def is_lost(change: float) -> bool:
    return bool(held(math.exp(change), machine=SimpleNamespace(state=LoopState.LOCKED)).done[1:])


def is_released(target: float, level: float, drive: float) -> bool:
    """Whether a motion of amplitude 1 is left alone, by ln of target and level and by the share of the drive."""
    known = SimpleNamespace(amplitude=math.exp(level), duration=math.inf)
    found = held(1.0, _target=math.exp(target), _level=known, _chosen="envelope", _drive=drive, _largest=1.0)
    return bool(found._act is _Act.FREE)


def release_leads() -> list[float]:
    """ln of the amplitude from which a level of 1 is released, from below and from above."""
    found = []
    for above in (False, True):
        loop = self_excited(_chosen="envelope", _tried={not above})
        SelfExcitedLoop._begin(loop, loop._level, 0)
        found.append(math.log(loop.done[0][1]))
    return found


def watched(seconds: float, distance: float = -0.5) -> str:
    """What is done with a free motion that neither grows nor falls, so far above its level in ln of the amplitude."""
    loop = self_excited(math.exp(-distance))
    SelfExcitedLoop._watch(loop, round(1000.0 * seconds))
    return str(loop.done[0][0]) if loop.done else ""


def glides(step: float) -> bool:
    """Whether a stepped sine goes to the next frequency without a stop, by the relative step."""
    done: list[str] = []
    loop: Any = SimpleNamespace(
        _stop_moving=lambda end: None, _frequency=10.0, _stage=_Stage.WINDOW, _glide=SteppedSineLoop._glide,
        _approach=lambda *_: done.append("approach"), _fade=lambda *_: done.append("fade"),
    )  # fmt: skip
    SteppedSineLoop._start(loop, SimpleNamespace(frequency_hz=10.0 * (1.0 + step)), 0, False)  # type: ignore[arg-type]
    return done == ["approach"]


def of_a_curve(name: str) -> float:
    """A setting of the loop along a response curve, of a mode that settles within a dwell."""
    linear: Any = SimpleNamespace(damping_ratios=[0.5], target_mode=0)
    return float(curve_values(ResponseCurveTest(), linear, {}, ControlKind.RESPONSE)[name])


def closed_from() -> int:
    """Sample from which the loop is closed after a start from rest, ramp 1 s, decay 2 1/s, 1000 samples/s."""
    level: Any = MagicMock(
        frequency_hz=1.0, held_phase=0.5, release=0.0, ramp=1.0, parameter=CurveParameter.LAG, timeout=0.0,
        test=TestKind.RESPONSE_CURVE,
    )  # fmt: skip
    loop = MagicMock(cutoff=100.0, sample_rate=1000.0)
    loop.plant.plant_decay, loop.settings.ramp_delay_periods = 2.0, 0
    loop._force_schedule.amplitude_bandwidth = 1.0
    PhaseLockedLoop._start(loop, level, 0, True)
    return int(loop._closed_from)


def gain_along_a_secant() -> Any:
    """Share of the loop's gains that a secant takes."""
    loop = MagicMock(cutoff=1.0, block_duration=0.01, decay=1.0, _slope=0.0, _is_gentle=False, _found_phase=0.0)
    loop._parameter, loop._mean_phase, loop.dwell.length = CurveParameter.SECANT, 0.0, 1
    loop._level = SimpleNamespace(phase_per_response=0.0, control=ControlKind.VOLTAGE)
    loop.controller.output, loop.linear.drive_point_shape, loop._per_displacement = 100.0, 1.0, lambda: 1.0
    loop.schedule.gains.return_value = SimpleNamespace(scaled=lambda share: share)
    PhaseLockedLoop._control(loop, 0.0, 0.0, 1.0, 1.0, 0)
    return loop.controller.update.call_args.args[1]


def largest_voltage() -> float:
    """Largest drive of a self-excited test whose limit is 2 V."""
    rig = load_rig("van_der_pol")
    loop = SelfExcitedLoop(
        linear_description(rig), LoopSettings(voltage_limit=2.0), rig.sample_rate_hz, rig.block_samples
    )
    return float(loop._largest)


EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    "pll.amplitude.waiting_error": (lambda: (waits(0.09), waits(0.11)), (False, True)),
    "pll.curve.phase_tolerance": (lambda: of_a_curve("phase_tolerance"), pytest.approx(math.radians(0.5))),
    "pll.curve.frequency_steadiness": (lambda: of_a_curve("frequency_tolerance"), pytest.approx(1e-3)),
    "pll.curve.free_decays": (closed_from, 2500),
    "pll.curve.slow_share": (gain_along_a_secant, 0.15),
    "pll.harmonics.phase_margin_rad": (lambda: integral_rate(4.0, 0.75), pytest.approx(0.35)),
    "pll.harmonics.automatic_highest": (lambda: most_harmonics(1.0, 1e4, 1.0), 15),
    "pll.harmonics.initial_gain_std": (lambda: GainEstimate(1, 1).covariance[0, 0, 0].real, pytest.approx(0.3**2)),
    "pll.harmonics.largest_gain_std": (forgotten, pytest.approx(0.5**2)),
    "pll.harmonics.lowest_gain_correction": (lambda: (learnt(0.009), learnt(0.011)), (1.0, 0.011)),
    "pll.harmonics.modal_target_modes": (lambda: (refused(2), refused(3)), (True, False)),
    "pll.harmonics.largest_target_ratio": (largest_target, pytest.approx(0.3)),
    "pll.harmonics.noise_sigmas": (lambda: (settled(mean=3.9, noise=1.0), settled(mean=4.1, noise=1.0)), (True, False)),
    "pll.harmonics.newest_value_ratio": (lambda: (settled(newest=1.9), settled(newest=2.1)), (True, False)),
    "pll.harmonics.resonance_band_ratio": (furthest_asked, pytest.approx(1.4)),
    "pll.harmonics.shape_following_ratio": (following, pytest.approx(0.08 * 50.0)),
    "pll.harmonics.review_time_constants": (lambda: (is_due(4.9), is_due(5.1)), (False, True)),
    "pll.harmonics.progress_share": (lambda: (strikes(0.69), strikes(0.71)), ((0, 0), (1, 0))),
    "pll.harmonics.reviews_without_progress": (lambda: (strikes(1.0, 1), strikes(1.0, 2)), ((2, 0), (3, 1))),
    "pll.harmonics.largest_voltage_share": (largest_term, 1.0),
    "pll.harmonics.lowest_gain_share": (gain_in_noise, 0.1),
    "pll.harmonics.noise_doubling_dwells": (doubling_dwells, pytest.approx(5.0)),
    "pll.harmonics.variance_doubling_time_constants": (doubling_time_constants, pytest.approx(20.0)),
    "pll.harmonics.settled_share": (
        lambda: (settled_without_noise(0.0029), settled_without_noise(0.0031)), (True, False)
    ),
    "pll.harmonics.largest_step_share": (largest_step, pytest.approx(0.1)),
    "pll.secondary.release_wait_s": (release_wait, 3000),
    "pll.secondary.response_floor_ratio": (release_floor, pytest.approx(0.02)),
    "pll.self_excited.first_target_ratio": (
        lambda: held(1e-9, _engaged=False).done, [pytest.approx(math.log(2.0), rel=1e-3)]
    ),
    "pll.self_excited.lost_lock_change": (lambda: (is_lost(-0.09), is_lost(-0.11)), (False, True)),
    "pll.self_excited.release_log_lead": (release_leads, [pytest.approx(-0.6), pytest.approx(0.6)]),
    "pll.self_excited.shortest_log_lead": (
        lambda: (is_released(1.0, -0.14, 1.0), is_released(1.0, -0.16, 1.0)), (False, True)
    ),
    "pll.self_excited.release_log_tolerance": (
        lambda: (is_released(0.051, 0.0, 0.0), is_released(0.049, 0.0, 0.0)), (False, True)
    ),
    "pll.self_excited.limit_cycle_log_distance": (
        lambda: (watched(9.0, -0.021), watched(9.0, -0.019)), ("_again", "_open")
    ),
    "pll.self_excited.growth_periods": (lambda: (watched(7.9), watched(8.1)), ("", "_again")),
    "pll.self_excited.voltage_limit_share": (largest_voltage, pytest.approx(1.8)),
    "pll.sweeps.glide_frequency_step": (lambda: (glides(0.049), glides(0.051)), (True, False)),
    "pll.self_excited.shortest_free_window_periods": (lambda: free_window(9.0), pytest.approx(6.0)),
    "pll.self_excited.free_window_log_span": (lambda: free_window(0.1), pytest.approx(8.0)),
    "pll.self_excited.settled_growth_ratio": (still, pytest.approx(5e-4)),
    "pll.self_excited.largest_detuning": (lambda: (detuned(0.9e-4), detuned(1.1e-4)), (False, True)),
    "pll.self_excited.largest_feeding_rate": (fed, pytest.approx(3.0)),
}  # fmt: skip


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected
