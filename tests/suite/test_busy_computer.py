"""A test that loses samples is done again or skipped on a computer that stands still, and fails on any other."""

from __future__ import annotations

import time

import busy_computer
import pytest
from busy_computer import MANY, Standstills, on_a_quiet_computer


class Seen(Standstills):
    """As many standstills as a test wants."""

    number = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.late = [0.02] * self.number


def outcome(monkeypatch, tmp_path, number, words):
    """What a test that always fails with some words ends as, and how often it was done."""
    monkeypatch.setattr(busy_computer, "Standstills", type("These", (Seen,), {"number": number}))
    done = []

    @on_a_quiet_computer(lambda _: {})
    def test(tmp_path):
        done.append(tmp_path)
        raise RuntimeError(words)

    with pytest.raises((RuntimeError, pytest.skip.Exception)) as caught:
        test(tmp_path=tmp_path)
    return caught.type is RuntimeError, len(done)


def test_lost_samples_fail_on_a_quiet_computer(monkeypatch, tmp_path):
    assert outcome(monkeypatch, tmp_path, MANY - 1, "28 blocks had lost samples") == (True, 1)


def test_lost_samples_show_nothing_on_a_computer_that_stands_still(monkeypatch, tmp_path):
    assert outcome(monkeypatch, tmp_path, MANY, "28 blocks had lost samples") == (False, 3)


def test_another_failure_is_one_on_every_computer(monkeypatch, tmp_path):
    assert outcome(monkeypatch, tmp_path, MANY, "the damping is wrong") == (True, 1)


def test_the_witness_ends_with_what_it_saw():
    with Standstills() as standstills:
        time.sleep(0.5)
    assert all(each > busy_computer.LONG for each in standstills.late)
    assert "stood still" in str(standstills)
