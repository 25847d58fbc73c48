"""Keys, sessions, rates and frames of the page."""

from __future__ import annotations

import json

import numpy as np
import pytest
from bench.frame_reader import read_frame

from nmt_bench.page.frames import write_frame
from nmt_bench.page.guard import Bucket, Guard, Role
from nmt_bench.page.server import steering_request
from nmt_core.errors import BenchError
from nmt_core.vocabulary import SteeringAct
from nmt_sequencer.steering import PRESENT_LEVEL


def test_the_key_to_steer_works_once_and_the_one_to_watch_always() -> None:
    guard = Guard(4711)
    session = guard.exchange(guard.steer_key)
    assert guard.role(session) is Role.STEER
    assert guard.exchange(guard.steer_key) == ""
    watchers = {guard.exchange(guard.watch_key) for _ in range(5)}
    assert len(watchers) == 5
    assert {guard.role(name) for name in watchers} == {Role.WATCH}
    assert guard.role(session) is Role.STEER


@pytest.mark.parametrize("given", ["", "x", "é" * 40, "a" * 100_000])
def test_wrong_keys_and_sessions_are_nobody(given: str) -> None:
    guard = Guard(4711)
    assert guard.exchange(given) == ""
    assert guard.role(given) is Role.NOBODY


def test_keys_differ_from_start_to_start() -> None:
    keys = {key for _ in range(20) for key in (Guard(1).steer_key, Guard(1).watch_key)}
    assert len(keys) == 40


def test_many_watchers_do_not_drive_out_the_one_who_steers() -> None:
    guard = Guard(4711)
    session = guard.exchange(guard.steer_key)
    for _ in range(500):
        guard.exchange(guard.watch_key)
    assert guard.role(session) is Role.STEER


@pytest.mark.parametrize(
    "host",
    [None, "", "localhost:4711", "127.0.0.1", "127.0.0.1:4712", "127.0.0.1:4711.", "evil.example:4711", "[::1]:4711"],
)
def test_only_the_very_address_is_its_host(host: str | None) -> None:
    guard = Guard(4711)
    assert guard.right_host("127.0.0.1:4711")
    assert not guard.right_host(host)


@pytest.mark.parametrize(
    "origin",
    [None, "", "null", "https://127.0.0.1:4711", "http://127.0.0.1:4712", "http://127.0.0.1:4711/", "http://a.example"],
)
def test_only_the_very_page_is_its_origin(origin: str | None) -> None:
    guard = Guard(4711)
    assert guard.own_page("http://127.0.0.1:4711")
    assert not guard.own_page(origin)


def test_a_bucket_lets_a_burst_pass_and_then_its_rate() -> None:
    now = [0.0]
    bucket = Bucket(2.0, 3, lambda: now[0])
    assert [bucket.take() for _ in range(5)] == [True, True, True, False, False]
    now[0] = 0.5
    assert [bucket.take() for _ in range(2)] == [True, False]
    now[0] = 100.0
    assert sum(bucket.take() for _ in range(10)) == 3


# -- frames ----------------------------------------------------------------------------------------------------------


def test_frames_are_read_as_they_were_written() -> None:
    head = {"kind": "live", "text": "ω̃ ± </script>", "nan": float("nan"), "inner": [float("inf"), {"a": 1.5}]}
    arrays = {"a": np.array([1.0, np.nan, 1e300]), "b": np.zeros(0), "c": np.arange(5)}
    raw = write_frame(head, arrays)
    assert len(raw) % 4 == 0
    found, values = read_frame(raw)
    assert found == {"kind": "live", "text": "ω̃ ± </script>", "nan": None, "inner": [None, {"a": 1.5}]}
    assert values["a"] == pytest.approx([1.0, np.nan, np.inf], nan_ok=True)
    assert values["b"].size == 0
    assert values["c"].tolist() == [0, 1, 2, 3, 4]
    for broken in (b"", raw[:7], b"XXXX" + raw[4:], raw[:-4]):
        with pytest.raises((ValueError, json.JSONDecodeError)):
            read_frame(broken)


# -- orders ----------------------------------------------------------------------------------------------------------


def test_orders_become_requests() -> None:
    asked = steering_request({"act": "change_levels", "levels": [1, 2.5]})
    assert (asked.act, asked.levels, asked.level_index) == (SteeringAct.CHANGE_LEVELS, (1.0, 2.5), PRESENT_LEVEL)
    assert asked.source == "the live page"
    assert steering_request({"act": "skip_level", "level_index": 3}).level_index == 3


@pytest.mark.parametrize(
    "order",
    [
        {},
        {"act": "drive"},
        {"act": 3},
        {"act": "pause", "source": "somebody else"},
        {"act": "pause", "at_sample": 5},
        {"act": "skip_level", "level_index": -1},
        {"act": "skip_level", "level_index": True},
        {"act": "skip_level", "level_index": "1"},
        {"act": "skip_level", "level_index": 2**40},
        {"act": "change_levels", "levels": "1"},
        {"act": "change_levels", "levels": [None]},
        {"act": "change_levels", "levels": [float("nan")]},
        {"act": "change_levels", "levels": [-1.0]},
        {"act": "change_levels", "levels": [1e999]},
        {"act": "change_levels", "levels": [1e308]},
        {"act": "change_levels", "levels": [10**400]},
        {"act": "change_levels", "levels": [True]},
        {"act": "change_levels", "levels": ["1"]},
        {"act": "change_levels", "levels": [[1.0]]},
    ],
)
def test_orders_that_mean_nothing_are_refused(order: dict[str, object]) -> None:
    with pytest.raises((BenchError, ValueError, TypeError)):
        steering_request(order)
