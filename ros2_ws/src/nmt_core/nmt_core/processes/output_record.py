"""What the process that owns an output writes down, for everybody who wants to know what the output does.

The plant node cannot say anything when it hangs or has died, but the process that owns its output can. It appends one
line of JSON to a file whenever its state changes, and touches the file as long as it lives.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from nmt_core.vocabulary import OutputState

BEAT = 0.25  # s between two touches of the file
_SILENT = 1.0  # s without one after which nothing is known any more
_UNKNOWN = "what the drive does is UNKNOWN"


@dataclass(frozen=True)
class OutputLine:
    """One line of the record.

    Attributes:
        pid: process that owns the output.
        time: s on the steady clock of this host.
        sample: index of the sample that follows.
        state: name of an `OutputState`.
        fed_at: sample that was put out next when the last block was fed.
        reason: why the output was taken to zero; empty while it follows.
    """

    pid: int
    time: float
    sample: int
    state: str
    fed_at: int
    reason: str = ""


class OutputRecord:
    """The writing side: one file, opened once.

    Args:
        path: the file; what it held is lost.
    """

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC, 0o644)
        self._pid = os.getpid()

    def write(self, sample: int, state: OutputState, fed_at: int, reason: str) -> None:
        """Append a line."""
        line = OutputLine(self._pid, time.monotonic(), sample, state.name, fed_at, reason)
        os.write(self._file, (json.dumps(asdict(line)) + "\n").encode())

    def touch(self) -> None:
        """Say that the writer lives."""
        os.utime(self._file)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def read_output(path: str | Path) -> list[OutputLine]:
    """Lines of a record, oldest first; empty where there is none. A line that is cut is left out."""
    lines = []
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError:
        return []
    for line in text.splitlines():
        try:
            lines.append(OutputLine(**json.loads(line)))
        except (ValueError, TypeError):
            continue
    return lines


def output_sentence(path: str | Path, now: float | None = None) -> str:
    """What is known of an output from its record, for people; without a full stop.

    Args:
        path: the record; empty = there is none.
        now: wall time, s since the epoch; None = the present.
    """
    if not str(path):
        return f"{_UNKNOWN}: no process owns the output, or its record is not known here"
    lines = read_output(path)
    if not lines:
        return f"{_UNKNOWN}: the record of the process that owns the output ({path}) cannot be read"
    last = lines[-1]
    stopped = next((line for line in lines if line.reason == last.reason and line.reason), last)
    why = f": {stopped.reason}" if stopped.reason else ""
    if last.state == OutputState.ENDED.name:
        return f"the process that owns the output put it to zero at sample {last.sample} and released it{why}"
    try:
        age = (time.time() if now is None else now) - os.stat(path).st_mtime
    except OSError:
        age = float("inf")
    if age > _SILENT:
        return f"{_UNKNOWN}: the process that owns the output has died or hangs; its last state was {last.state}"
    if last.state == OutputState.HELD.name:
        return f"the process that owns the output put it to zero at sample {last.sample} and holds it there{why}"
    if last.state == OutputState.RAMPING.name:
        return f"the process that owns the output takes it to zero{why}"
    if last.state == OutputState.AT_ZERO.name:
        return "the output is at zero"
    return "the output follows its commands"


def drive_sentence(said: Mapping[str, str] | None, alive: bool, lockstep: bool = False) -> str:
    """What is known of the drive where the loop does not answer any more, for people; without a full stop.

    Args:
        said: counters of the plant's last heartbeat, see docs/reference/messages.md; None = it was never heard.
        alive: whether that heartbeat is still going on.
        lockstep: whether the plant waits for commands, so that its time stands still without them.
    """
    if said is None:
        return f"{_UNKNOWN}: the plant was not heard of"
    if alive:
        return (
            "the plant reports the drive at zero"
            if said.get("drive_at_zero") == "1"
            else (
                f"the plant lives and reports: {said.get('output', '').rstrip('.') or 'the drive is not at zero yet'}"
            )
        )
    if "output_pid" in said:
        return output_sentence(said.get("output_record", ""))
    if lockstep:
        return "the rig is simulated and its time stands still without the plant"
    return f"{_UNKNOWN}: the plant is silent"
