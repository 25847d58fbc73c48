"""The order of the tests on several workers: what takes longest begins first, so that nobody waits for it at the end.

`seconds.txt` holds what each file took when it was last measured. A file's tests stay together, because they share
what its fixtures make; where it says *apart* they share nothing, and each goes wherever there is room. What is
*punctual* keeps to the clock, and a neighbour can make it late: all of it is done by the first worker, one after the
other. The other workers stand back for it, and those beyond the number of cores begin after it. What is *alone* loses
samples for good when it is late: the first worker begins with it, and no other begins before it is done. What is *wide*
keeps several cores busy: it begins when nothing keeps to the clock any more. A file without a line counts as short:
that costs time and nothing else.

    ./nmt test --write-seconds

measures them anew.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler.loadscope import LoadScopeScheduling

TABLE = Path(__file__).with_name("seconds.txt")
LEAST = 1.0  # s; shorter files are not in the table
FIRST = "gw0"
_NICE = 5
_TIMED = ("alone", "punctual")
_HEAD = "# Seconds of each test file, and 'apart', 'punctual', 'alone', 'wide': see worker_schedule.py.\n"


@dataclass(frozen=True)
class Cost:
    """What a file takes.

    Attributes:
        seconds: of all its tests, with what their fixtures make.
        word: ``apart``, its tests can be on different workers at no cost; ``punctual``, they are in real time;
            ``alone``, nothing may run beside them; ``wide``, they keep several cores busy; or none.
    """

    seconds: float = 0.0
    word: str = ""


def read_costs(path: Path = TABLE) -> dict[str, Cost]:
    """Costs by file, as pytest names it."""
    costs = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.partition("#")[0].split()
        if words:
            costs[words[1]] = Cost(float(words[0]), " ".join(words[2:]))
    return costs


def write_costs(seconds: Mapping[str, float], path: Path = TABLE) -> None:
    """Put measured seconds into the table.

    Args:
        seconds: by file; what is not among them keeps its line.
        path: of the table; files are sought from the folder above its own.
    """
    costs = read_costs(path)
    costs.update({name: Cost(value, costs.get(name, Cost()).word) for name, value in seconds.items()})
    lines = [
        f"{cost.seconds:6.0f} {name} {cost.word}".rstrip() + "\n"
        for name, cost in sorted(costs.items(), key=lambda item: (-round(item[1].seconds), item[0]))
        if (cost.seconds >= LEAST or cost.word) and (path.parent.parent / name).is_file()
    ]
    path.write_text(_HEAD + "".join(lines), encoding="utf-8")


def stand_back(worker: str) -> None:
    """Let the first worker go before this one on a busy computer."""
    if worker != FIRST:
        os.nice(_NICE)


class LongestFirst(LoadScopeScheduling):
    """Gives a worker that has nothing to do the longest of what is left.

    Args:
        config: of the test run.
        log: of xdist.
        costs: by file; default those of the table.
        cores: of the computer; default those that may be used.
    """

    def __init__(
        self,
        config: pytest.Config,
        log: Any = None,
        costs: Mapping[str, Cost] | None = None,
        cores: int | None = None,
    ) -> None:
        super().__init__(config, log)
        self._costs = read_costs() if costs is None else costs
        self._cores = len(os.sched_getaffinity(0)) if cores is None else cores
        self._tests: Counter[str] = Counter()
        self._all_may = False

    def _split_scope(self, nodeid: str) -> str:
        """Name of the unit that a test belongs to: itself, or its file."""
        file = nodeid.partition("::")[0]
        return nodeid if self._costs.get(file, Cost()).word == "apart" else file

    def schedule(self) -> None:
        """Distribute what was collected."""
        if not self._tests:
            collected = next(iter(self.registered_collections.values()))
            self._tests.update(nodeid.partition("::")[0] for nodeid in collected)
        super().schedule()

    def mark_test_complete(self, node: Any, item_index: int, duration: float = 0) -> None:
        """Note the end of a test; one that others waited for lets them begin."""
        before = self._workers_beside()
        super().mark_test_complete(node, item_index, duration)
        if self._workers_beside() > before:
            # A worker begins a test when it knows the next one: a unit of one test alone would wait for ever.
            for other in [*self.nodes] * 2:
                self._reschedule(other)

    def _word(self, unit: str) -> str:
        return self._costs.get(unit, Cost()).word

    def _workers_beside(self) -> int:
        """How many workers may work now."""
        if self._all_may:
            return len(self.assigned_work)
        begun = (item for units in self.assigned_work.values() for item in units.items())
        left = {self._word(unit) for unit in self.workqueue}
        left |= {self._word(unit) for unit, tests in begun if not all(tests.values())}
        if "alone" in left:
            return 1
        if "punctual" in left:
            return max(self._cores, 1)
        self._all_may = self.collection is not None
        return len(self.assigned_work)

    def _assign_work_unit(self, node: Any) -> None:
        """Let a worker have the longest unit that is left; the first one what keeps to the clock, before all else."""
        timed = [unit for unit in self.workqueue if self._word(unit) in _TIMED]
        others = [unit for unit in self.workqueue if unit not in timed]
        # A worker that died has a successor of another name.
        names = sorted((worker.gateway.id for worker in self.assigned_work), key=lambda name: (len(name), name))
        place = names.index(node.gateway.id)
        if place >= self._workers_beside():
            return
        if not self._all_may:
            others = [unit for unit in others if self._word(unit) != "wide"] or others
        alone = [unit for unit in timed if self._word(unit) == "alone"]
        mine = alone or timed or others if place == 0 else others
        if not mine:  # what is left is for the first
            node.shutdown()
            return
        self.workqueue.move_to_end(max(mine, key=self._seconds), last=False)
        super()._assign_work_unit(node)

    def _seconds(self, unit: str) -> float:
        file, _, test = unit.partition("::")
        cost = self._costs.get(file, Cost())
        return cost.seconds / self._tests[file] if test else cost.seconds
