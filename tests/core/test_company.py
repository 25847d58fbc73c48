"""What a node concludes from the heartbeats of others, with times given by hand."""

from __future__ import annotations

from nmt_core.company import READY, Company

A, B = "lab process 1 node 1", "lab process 2 node 1"


def company(**options: str) -> Company:
    made = Company(["pll", "plant"], 2.0, **options)
    made.listened(0.0)
    return made


def test_a_node_is_silent_after_the_time_out_and_not_before() -> None:
    others = company()
    assert others.silent(0.0) == ""  # nobody was heard yet: not ready, but not lost either
    others.hear("pll", A, READY, False, 0.5)
    for now in (1.0, 1.7, 2.4):
        others.listened(now)
    assert others.silent(2.49) == ""
    assert others.silent(2.51) == "pll"


def test_time_in_which_the_node_could_not_listen_does_not_count() -> None:
    others = company()
    others.hear("pll", A, READY, False, 0.0)
    assert others.silent(30.0) == ""  # deaf for 30 s itself
    others.listened(30.0)
    assert others.silent(30.5) == ""
    for now in (30.9, 31.8, 32.6):
        others.listened(now)
    assert others.silent(32.7) == "pll"


def test_a_busy_node_is_not_lost_and_a_hung_one_is() -> None:
    others = company()
    others.hear("pll", A, "busy for 8.0 s", False, 0.5)
    others.hear("plant", A, READY, False, 0.5)
    assert others.silent(0.6) == ""
    assert others.unready(0.6) == {"pll": "busy for 8.0 s"}
    others.hear("pll", A, "hung: nothing has been done for 10.1 s", True, 0.7)
    assert others.silent(0.8) == "pll"
    assert others.failures == {"pll": "hung: nothing has been done for 10.1 s"}


def test_who_is_not_ready_and_why() -> None:
    others = company()
    assert others.unheard == ["pll", "plant"]
    assert others.unready(0.0) == {"pll": "not heard of", "plant": "not heard of"}
    others.hear("pll", A, READY, False, 0.0)
    others.hear("plant", A, "waiting for drive", False, 0.0)
    assert others.unready(0.1) == {"plant": "waiting for drive"}
    assert others.unheard == []
    assert others.unready(2.1) == {"pll": "silent", "plant": "silent"}


def test_two_processes_of_one_name_are_named_while_both_are_heard() -> None:
    others = company()
    for now, instance in ((0.1, A), (0.2, B), (0.35, A)):
        assert others.twice(now) == ""
        others.hear("pll", instance, READY, False, now)
    assert others.twice(0.4) == f"node pll is there twice: {A} and {B}"
    assert others.twice(2.4) == ""


def test_a_node_that_was_started_again_is_no_second_one() -> None:
    others = company()
    for now, instance in ((0.1, A), (0.35, A), (1.5, B), (1.75, B), (2.0, B)):
        others.hear("pll", instance, READY, False, now)
        assert others.twice(now) == ""


def test_a_heartbeat_in_the_own_name_from_another_process_is_a_second_one() -> None:
    others = company(own="sequencer", own_instance=A)
    others.hear("sequencer", A, READY, False, 0.1)
    assert others.twice(0.2) == ""
    others.hear("sequencer", B, READY, False, 0.3)
    assert others.twice(0.4) == f"node sequencer is there twice: {A} and {B}"
    others.hear("stranger", B, READY, False, 0.5)
    assert "stranger" not in others.twice(0.6)


def test_a_node_that_was_started_again_is_noted_until_the_next_run() -> None:
    others = company()
    others.hear("pll", A, READY, False, 0.0)
    others.hear("plant", A, READY, False, 0.0)
    others.hear("plant", B, READY, False, 1.0)
    assert others.restarted(1.5) == [], "the one before may be there still"
    assert others.restarted(2.1) == ["plant"]
    others.hear("plant", A, READY, False, 2.2)
    assert others.restarted(3.5) == []
    assert others.twice(3.5)
    others.hear("plant", B, READY, False, 9.0)
    assert others.restarted(11.1) == ["plant"]
    others.meet_again(11.2)
    assert others.restarted(20.0) == []


def test_who_was_not_heard_since() -> None:
    others = company()
    others.hear("pll", A, READY, False, 0.0)
    others.hear("plant", A, READY, False, 1.0)
    assert others.unheard_since(0.5) == ["pll"]
    assert others.unheard_since(0.0) == []


def test_a_run_gives_everybody_time_to_be_heard_again() -> None:
    others = company()
    others.hear("pll", A, READY, False, 0.0)
    for now in (0.9, 1.8, 2.7, 3.6):
        others.listened(now)
    assert others.silent(3.6) == "pll"
    others.meet_again(3.6)
    assert others.silent(3.7) == ""
    for now in (4.5, 5.4, 5.7):
        others.listened(now)
    assert others.silent(5.7) == "pll"
