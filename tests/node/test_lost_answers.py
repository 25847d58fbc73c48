"""The goal and its result arrive although a request or an answer of the action is lost."""

from __future__ import annotations

from typing import Any

import pytest
from tiers import with_quick

from nmt_bench.harness import Bench
from nmt_core.vocabulary import ResultCode


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmt_bench.harness._RESEND", 0.4)


def test_a_goal_whose_request_was_lost_is_sent_again(impatient: None, monkeypatch: pytest.MonkeyPatch) -> None:
    with Bench("beam", [0.3], window_periods=10) as bench:
        send, asked = bench.client.action_client.send_goal_async, []

        def lose_the_first(goal: Any, **options: Any) -> Any:
            asked.append(options["goal_uuid"])
            if len(asked) == 1:
                from rclpy.task import Future

                return Future()
            return send(goal, **options)

        monkeypatch.setattr(bench.client.action_client, "send_goal_async", lose_the_first)
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED
    assert len(asked) == 2
    assert asked[0] == asked[1]


@pytest.mark.parametrize("known", with_quick(["at once", "when asked again", "after the refusal"], "when asked again"))
def test_a_goal_whose_answer_was_lost_runs_once(known: str, impatient: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server has it: it stands in the status, or the goal that is sent again is refused as known.

    The status may come later than that refusal.
    """
    with Bench("beam", [0.3], window_periods=100) as bench:
        send, asked = bench.client.action_client.send_goal_async, []

        def lose_the_first_answer(goal: Any, **options: Any) -> Any:
            asked.append(send(goal, **options))
            if len(asked) == 1:
                from rclpy.task import Future

                return Future()
            return asked[-1]

        monkeypatch.setattr(bench.client.action_client, "send_goal_async", lose_the_first_answer)
        is_known = bench.client.is_known
        looks = {
            "at once": lambda: True,
            "when asked again": lambda: len(asked) > 1,
            "after the refusal": lambda: len(asked) > 2 and asked[1].done() and not asked[1].result().accepted,
        }
        monkeypatch.setattr(bench.client, "is_known", lambda goal: looks[known]() and is_known(goal))
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED
    assert len(result.points) == 1
    assert len(asked) == {"at once": 1, "when asked again": 2, "after the refusal": 3}[known]


def test_a_result_whose_answer_was_lost_is_asked_for_again(impatient: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from rclpy.action.client import ClientGoalHandle
    from rclpy.task import Future

    ask, asked = ClientGoalHandle.get_result_async, []

    def lose_the_first(handle: Any) -> Any:
        asked.append(handle)
        return Future() if len(asked) == 1 else ask(handle)

    monkeypatch.setattr(ClientGoalHandle, "get_result_async", lose_the_first)
    with Bench("beam", [0.3], window_periods=10) as bench:
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED
    assert len(asked) == 2
