"""The end of a process: what is registered runs, what is printed arrives, threads are waited for."""

from __future__ import annotations

import subprocess
import sys

import pytest

_PROGRAM = """
import atexit, sys, threading, time
from nmt_core.processes.process_end import end_process
atexit.register(lambda: print("registered"))
{thread}
print("printed")
print("error", file=sys.stderr, end="")
end_process(3)
"""
_THREAD = "threading.Thread(target=lambda: (time.sleep(0.2), print('thread'))).start()"


@pytest.mark.parametrize(("thread", "printed"), [("", "printed registered"), (_THREAD, "printed thread registered")])
def test_nothing_is_lost_and_the_exit_code_is_the_one_given(thread: str, printed: str) -> None:
    words = [sys.executable, "-c", _PROGRAM.format(thread=thread)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split(), done.stderr) == (3, printed.split(), "error")


def test_modules_are_not_taken_apart() -> None:
    program = "class Last:\n def __del__(self): print('apart')\nlast = Last()\n"
    program += "from nmt_core.processes.process_end import end_process\nend_process(0)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


def test_a_reader_that_has_gone_makes_no_complaint() -> None:
    program = "import os, sys\nfrom nmt_core.processes.process_end import end_process\n"
    program += "print('lost')\nos.close(1)\nend_process(5)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (5, "")
