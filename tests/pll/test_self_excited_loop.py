"""The loop of self-excited tests on the simulated rigs: methods, loss of control, and the end of the motion."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from pll.self_excited_rig import SelfExcitedBench

from nmt_bench.commands.run_command import RunOptions
from nmt_core.errors import BenchError
from nmt_core.kinds import METHODS
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import ControlKind, LoopState, TestKind
from nmt_pll.thresholds import SELF_EXCITED


def test_loss_of_control_is_damped_and_the_drive_then_goes_to_zero_by_a_ramp() -> None:
    bench = SelfExcitedBench("subcritical")
    level = bench.run_level(0.003)
    assert level.point is not None
    bench.loop.quiet("somebody stops the test")
    after = [bench.advance() for _ in range(400)]
    assert after[0].state == LoopState.LOCK_LOST
    driven = [item for item in after if item.amplitude > 0.0]
    assert len(driven) > 10, "the motion is damped, not left alone"
    assert after[-1].amplitude == 0.0
    assert after[-1].response_amplitude < 1e-4
    last = after.index(driven[-1]) + 1
    assert after[last].ramp == pytest.approx(0.2)
    assert "the response is down" in bench.loop.ending


def test_silence_would_not_have_stopped_it() -> None:
    """The same motion without a drive settles at the large limit cycle."""
    bench = SelfExcitedBench("subcritical")
    bench.run_level(0.003)
    bench.loop._give_up = lambda *_: None  # type: ignore[method-assign]
    bench.loop._act = type(bench.loop._act).REST
    for _ in range(1200):
        bench.advance()
    assert bench.outputs[-1].amplitude == 0.0
    assert bench.outputs[-1].response_amplitude > 0.005


def test_damping_that_does_not_succeed_ends_with_its_time() -> None:
    """A drive far too weak: the motion stays, the drive goes to zero, and the sentence says which."""
    bench = SelfExcitedBench("van_der_pol")
    bench.run_level(0.004)
    for _ in range(200):
        bench.advance()
    bench.loop._largest = 1e-3
    outputs = bench.end(duration=1.0)
    assert "the time is over" in bench.loop.ending
    assert outputs[-1].amplitude == 0.0
    assert outputs[-1].response_amplitude > 0.004


def test_a_motion_near_its_limit_is_damped_before_the_guard_trips() -> None:
    bench = SelfExcitedBench("van_der_pol", overrides=["limits.displacement_m=0.0057"])
    bench.run_level(0.003)
    assert SELF_EXCITED.response_limit_share * bench.limit < 0.005, "the limit cycle lies beyond what the loop allows"
    for _ in range(600):
        bench.advance()
    assert any("of its limit" in (item.transition.reason if item.transition else "") for item in bench.outputs)
    assert bench.largest < 0.0057
    assert not bench.device.tripped


@pytest.mark.parametrize("seed", [1, 2, pytest.param(range(3, 53), marks=pytest.mark.campaign)])
def test_an_unstable_rig_never_passes_its_limits_at_a_start(seed: int | range) -> None:
    for number in seed if isinstance(seed, range) else [seed]:
        bench = SelfExcitedBench("van_der_pol", noise=True, seed=number, latency=number % 4)
        for amplitude in (0.002, 0.006):
            level = bench.run_level(amplitude)
            assert level.point is not None, (number, level)
            assert level.point.status == 1, (number, level)
        bench.end()
        assert bench.largest < 0.8 * bench.limit, number
        assert not bench.device.tripped


def test_velocity_feedback_alone_settles_where_damping_grows_and_is_damped_where_it_does_not() -> None:
    bench = SelfExcitedBench("van_der_pol", "feedback")
    lost = bench.run_level(0.001)
    assert lost.point is None or lost.point.status != 1
    held = bench.run_level(0.0045)
    assert held.point is not None
    assert held.point.status == 1
    assert "velocity feedback" in held.reasons[-1]


def test_what_cannot_be_meant_is_refused() -> None:
    loop = SelfExcitedBench("subcritical").loop

    def level(**fields: object) -> LevelCommand:
        values = {"control": ControlKind.RESPONSE, "test": TestKind.SELF_EXCITED, "duration": 1.0, **fields}
        return LevelCommand(1, 0, values.pop("amplitude", 0.002), 0, 0.3, **values)

    for changed, sentence in (
        ({"control": ControlKind.VOLTAGE}, "levels of the response"),
        ({"amplitude": 0.011}, "85 % of the limit"),
        ({"duration": 0.0}, "needs a duration"),
        ({"test": TestKind.RING_DOWN}, "has no ring_down"),
    ):
        with pytest.raises(BenchError, match=sentence):
            loop.set_level(level(**changed))
    with pytest.raises(BenchError, match="method 'hope' of self-excited tests is not known"):
        SelfExcitedBench("subcritical", "hope")


def test_the_command_offers_the_methods_of_the_loop() -> None:
    (method,) = [item for item in fields(RunOptions) if item.name == "method"]
    assert next(iter(method.metadata.values())).choices == METHODS


def test_the_drive_is_a_force_in_phase_with_the_velocity_of_either_sign() -> None:
    bench = SelfExcitedBench("subcritical")
    fed = bench.run_level(0.001).point
    taken = bench.run_level(0.0035).point
    assert fed is not None
    assert taken is not None
    assert fed.active_power > 0.0 > taken.active_power
    assert max(abs(fed.phase_error), abs(taken.phase_error)) < 0.01
    assert np.isfinite(taken.pbmif)
    assert taken.pbmif > 0.99
