"""Where a session's time goes is counted only if it is asked for; the messages are the same."""

from __future__ import annotations

from nmt_session import Session, plan_test


def test_time_is_counted_where_it_is_asked_for() -> None:
    messages: dict[bool, list[str]] = {}
    for timed in (False, True):
        seen: list[str] = []
        plan = plan_test("beam", [0.2], window_periods=5)
        with Session(plan, listener=lambda topic, _, seen=seen: seen.append(topic), timed=timed) as session:
            session.run()
            assert all((seconds > 0.0) == timed for seconds in session.spent.values()), session.spent
        messages[timed] = seen
    assert messages[False] == messages[True]
