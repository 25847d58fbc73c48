"""What a run reports while it goes on and when it has ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import ResultCode


@dataclass(frozen=True)
class Progress:
    """Where a run stands; fields as in the feedback of ``nmt_msgs/RunLevels``."""

    level_index: int
    level_count: int
    level: float
    state: int
    frequency_hz: float
    phase_error: float
    fraction_done: float
    sample: int


def with_cause(message: str, tripped: str) -> str:
    """The sentence of a run that a limit ended, with what the plant says of it.

    Args:
        message: such as ``Level 2: a safety limit has tripped.``
        tripped: channel, value and limit, without a full stop; empty where the plant says nothing.
    """
    return message.replace("a safety limit has tripped", tripped) if tripped else message


@dataclass(frozen=True)
class RunResult:
    """How a run ended.

    Attributes:
        code: result code.
        message: one sentence.
        points: modal points in the order of the levels.
        bag: folder of the bag, None if nothing was recorded.
        bag_state: ``closed``, ``failed`` (the recorder could not write on), or ``open`` (it has died or hangs).
        lacks_s: bench time that the bag lacks, s.
        missing: indices of levels whose point did not come while the bench ran; those of them that stand in ``points``
            were extracted from the bag.
        wall_time: s from the start of the first level to the end of the run.
        bench_time: s of bench time.
        lost_node: name of the node that died, empty if none did.
        interrupted: True after Ctrl-C.
        remarks: sentences on gaps, late blocks and real-time margin.
    """

    code: ResultCode
    message: str
    points: tuple[ModalPoint, ...]
    bag: Path | None
    bag_state: str
    wall_time: float
    bench_time: float
    lost_node: str = ""
    interrupted: bool = False
    remarks: tuple[str, ...] = ()
    lacks_s: float = 0.0
    missing: tuple[int, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether the plan was worked through and all of it is in the bag."""
        return self.code == ResultCode.SUCCEEDED and self.bag_state == "closed"

    @property
    def real_time_factor(self) -> float:
        """Bench time over wall time."""
        return self.bench_time / self.wall_time if self.wall_time > 0 else 0.0
