"""Signals to the command line while a test runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from nmt_bench.orchestration.interrupts import deferred_interrupts, terminate_as_interrupt, unbroken


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_wish_to_end_is_as_ctrl_c(number: int) -> None:
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), terminate_as_interrupt():
        os.kill(os.getpid(), number)
    assert signal.getsignal(number) == before


def test_what_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with terminate_as_interrupt(), deferred_interrupts() as deferred:
            os.kill(os.getpid(), signal.SIGHUP)
        assert not deferred.came
    finally:
        signal.signal(signal.SIGHUP, before)


def test_ctrl_c_while_a_kernel_hands_over_its_result_is_ctrl_c() -> None:
    """As numba answers where it comes while an array is made of a result."""
    with pytest.raises(KeyboardInterrupt), terminate_as_interrupt():
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()
    with pytest.raises(SystemError), terminate_as_interrupt():
        raise SystemError("of another cause") from ValueError()


KERNELS = """
import os, signal, threading, time
from typing import NamedTuple
import numba, numpy as np
from nmt_bench.orchestration.interrupts import raise_interrupt
class Pair(NamedTuple):
    value: float
    array: np.ndarray
@numba.njit
def pair(given):
    return Pair(given.value + 1.0, given.array), given.array
given = Pair(1.0, np.zeros(3))
pair(given)
working, came = False, 0
def handle(number, frame):
    if working:
        raise_interrupt(number, frame)
signal.signal(signal.SIGINT, handle)
def interrupt():
    for _ in range(150):
        time.sleep(0.004)
        os.kill(os.getpid(), signal.SIGINT)
thread = threading.Thread(target=interrupt)
thread.start()
while thread.is_alive():
    try:
        working = True
        while thread.is_alive():
            for _ in range(50):
                pair(given)
        working = False
    except KeyboardInterrupt:
        working = False
        came += 1
print(came)
"""


def test_an_interrupt_never_breaks_into_what_numba_makes_of_a_result() -> None:
    """With Python's handler such a program ends by a SystemError or by SIGSEGV."""
    found = subprocess.run([sys.executable, "-c", KERNELS], capture_output=True, text=True, timeout=100, check=False)
    assert found.returncode == 0, found.stderr[-500:]
    assert int(found.stdout) > 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_one_signal_waits_and_a_second_one_breaks_in(number: int) -> None:
    with terminate_as_interrupt(), deferred_interrupts() as deferred:
        os.kill(os.getpid(), number)
        assert deferred.came  # and the work goes on
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)


def test_a_signal_acts_after_what_it_must_not_break() -> None:
    done = []

    def work(fails: bool) -> None:
        with unbroken():
            os.kill(os.getpid(), signal.SIGINT)
            done.append("the work")
            if fails:
                raise ValueError("does not swallow the signal")

    for fails in (False, True):
        with pytest.raises(KeyboardInterrupt):
            work(fails)
    with deferred_interrupts() as deferred:
        work(False)
    assert deferred.came  # whoever defers around it still does
    assert len(done) == 3


def test_patient_work_is_never_broken() -> None:
    with deferred_interrupts(patient=True) as deferred:
        for _ in range(3):
            os.kill(os.getpid(), signal.SIGINT)
    assert deferred.came
