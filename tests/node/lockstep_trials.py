"""Runs in lockstep on a computer that is too busy, and runs whose launcher or recorder is hurt: what is in their bags?

./nmt shell <<< "python tests/node/lockstep_trials.py busy --count 50"        # beside six busy loops
./nmt shell <<< "python tests/node/lockstep_trials.py launcher --count 30"    # SIGKILL of the launcher
./nmt shell <<< "python tests/node/lockstep_trials.py recorder --count 3"     # SIGSTOP of the recorder for 20 s
./nmt shell <<< "python tests/node/lockstep_trials.py start --count 5"        # a node that is stopped as it starts
./nmt shell <<< "python tests/node/lockstep_trials.py account --levels 40 --periods 200 --processors 1 --loops 3"
                                               # every level has its point; --hurt extract:stop, extract:slow, … as well

./nmt shell <<< "python tests/node/lockstep_trials.py lost --hurt kill"       # or raise, stop: extraction at level 20

``account`` and ``lost`` resume with --log FILE where they stopped. --queue 512 needs root: it sets the length of the
kernel's queues in a network of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from node.kill_trials import MARK, marked
from node.signal_trials import hear_signals

from nmt_core.errors import BenchError
from nmt_core.messages.wire import MODAL_POINT
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_session.node_plan import NODES

_LONGEST = 600.0  # s of wall time, after which a run is given up
_STOPPED = 20.0  # s that the recorder is stopped for
_NAMED = 10.0  # s after which a node that does not come up is to be named
_LEFT = 60.0  # s for what is left to end


@contextlib.contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Programs beside that want a core each."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def start(
    out: Path, mark: str, levels: str, periods: int, processors: int = 0, queue: int = 0
) -> subprocess.Popen[str]:
    """Start a run of the beam, every node a process.

    Args:
        out, mark, levels, periods: of the run.
        processors: how many it may use; 0 = all.
        queue: datagrams that the kernel keeps for a socket; 0 = as it is.
    """
    words = ["run", "beam", "--levels", levels, "--periods", str(periods), "--reference", "none", "--no-report"]
    before = ["taskset", "-c", f"0-{processors - 1}"] if processors else []
    if queue:
        network = f'ip link set lo up && sysctl -q -w net.unix.max_dgram_qlen={queue} && exec "$@"'
        before = [*before, "unshare", "-n", "sh", "-c", network, "sh"]
    return subprocess.Popen(
        [*before, sys.executable, "-m", "nmt_bench", *words, "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, MARK: mark},
        start_new_session=True,
        preexec_fn=hear_signals,
    )


def faults_of_bag(out: Path, whole: bool) -> list[str]:
    """What is wrong with a bag: not at zero at its end, gaps, and where it is to be whole anything that it lacks."""
    try:
        bag = Bag.open(out / "bag")
        blocks = list(bag.blocks("voltage"))
    except BenchError as error:
        return [str(error)]
    faults = [] if blocks and not np.any(blocks[-1].data) else ["the last block is not at 0 V"]
    faults += [str(bag.loss)] if whole and bag.loss else []
    ends = [block.end_sample for block in blocks[:-1]]
    return faults + (["it has gaps"] if ends != [block.first_sample for block in blocks[1:]] else [])


def leftovers(mark: str) -> list[str]:
    """Processes that stay; they are ended."""
    end = time.monotonic() + _LEFT
    while (left := marked(mark)) and time.monotonic() < end:
        time.sleep(0.05)
    for process in left:
        os.kill(process, signal.SIGKILL)
    return [f"left: {name} {process}" for process, name in left.items()]


def busy(out: Path, mark: str, rng: np.random.Generator) -> list[str]:
    """A run to its end."""
    del rng
    said, _ = (command := start(out, mark, "0.3:1:3", 60)).communicate(timeout=_LONGEST)
    faults = [] if "3 of 3 levels locked" in said and "bag closed" in said else [said.strip()[-600:]]
    return faults + ([f"exit code {command.returncode}"] if command.returncode else []) + faults_of_bag(out, whole=True)


def launcher(out: Path, mark: str, rng: np.random.Generator) -> list[str]:
    """The launcher is killed at a random moment of the run."""
    command = start(out, mark, "0.3,0.5", 200_000)
    log = out / "log" / "sequencer.log"
    wait_for(lambda: log.exists() and "Level 1:" in log.read_text())
    time.sleep(rng.uniform(0.0, 4.0))
    command.kill()
    command.communicate(timeout=_LEFT)
    return leftovers(mark) + faults_of_bag(out, whole=False)


def recorder(out: Path, mark: str, rng: np.random.Generator) -> list[str]:
    """The recorder is stopped for 20 s while it records."""
    command = start(out, mark, "0.3:1:4", 200)
    log = out / "log" / "sequencer.log"
    wait_for(lambda: log.exists() and "Level 1 locked" in log.read_text())
    time.sleep(rng.uniform(0.0, 0.5))
    (process,) = (process for process, name in marked(mark).items() if name == "recorder")
    os.kill(process, signal.SIGSTOP)
    time.sleep(_STOPPED)
    os.kill(process, signal.SIGCONT)
    said, _ = command.communicate(timeout=_LONGEST)
    held = [] if "The run waits for node recorder, which is stopped" in said else ["it was not said who holds it up"]
    faults = [] if "4 of 4 levels locked" in said and "bag closed" in said else [said.strip()[-600:]]
    return held + faults + faults_of_bag(out, whole=True)


def account(out: Path, mark: str, rng: np.random.Generator) -> list[str]:
    """Every level gives its point, as the bag does, whatever the machine and whoever is slow."""
    count, periods = OPTIONS.levels, OPTIONS.periods
    command = start(out, mark, f"0.05:1.5:{count}", periods, OPTIONS.processors, OPTIONS.queue)
    ended = threading.Event()
    helper = threading.Thread(target=hurt, args=(OPTIONS.hurt, out, mark, ended, rng), daemon=True)
    helper.start()
    said, _ = command.communicate(timeout=_LONGEST)
    ended.set()
    helper.join()
    faults = [] if command.returncode == 0 else [f"exit code {command.returncode}: {said.strip()[-400:]}"]
    try:
        live = {point.level_index: point for point in Bag.open(out / "bag").records("modal_point", MODAL_POINT)}
        again = extract_bag(out / "bag").points
    except BenchError as error:
        return [*(faults or [said.strip()[-400:]]), str(error)]
    rows = len((out / "modal.csv").read_text().splitlines()) - 1
    faults += [] if rows == len(live) == len(again) == count else [f"{rows} rows, {len(live)} live, {len(again)} again"]
    same = all(point.level_index in live and point.identical(live[point.level_index]) for point in again)
    return faults + ([] if same else ["the digits differ from those of the bag"]) + faults_of_bag(out, whole=True)


def hurt(what: str, out: Path, mark: str, ended: threading.Event, rng: np.random.Generator) -> None:
    """Stop a node for 5 s, or let it work a tenth of the time only: ``extract:stop``, ``recorder:slow``."""
    if not what:
        return
    node, _, how = what.partition(":")
    log = out / "log" / "sequencer.log"
    wait_for(lambda: ended.is_set() or (log.exists() and "Level 1 locked" in log.read_text()))
    ended.wait(float(rng.uniform(0.0, 0.5)))
    for process in [process for process, name in marked(mark).items() if name == node]:
        with contextlib.suppress(ProcessLookupError):
            while not ended.is_set():
                os.kill(process, signal.SIGSTOP)
                ended.wait(5.0 if how == "stop" else 0.09)
                os.kill(process, signal.SIGCONT)
                if how == "stop":
                    return
                ended.wait(0.01)


RAISING = """
import nmt_extract.extractor as extractor
known = extractor.modal_point
def raising(window, *rest):
    with open("/proc/self/cmdline") as words:
        of_the_node = "/extract" in words.read()
    if window.lock.level_index == 19 and (of_the_node or ALWAYS):
        raise RuntimeError("made to fail at level 20")
    return known(window, *rest)
extractor.modal_point = raising
"""


def lost(out: Path, mark: str, rng: np.random.Generator) -> list[str]:
    """Extraction is killed, stopped for good or made to raise at level 20: named, exit 1, all that is in the bag."""
    how = OPTIONS.hurt or "kill"
    with tempfile.TemporaryDirectory(prefix="nmt-raising-") as folder, contextlib.ExitStack() as stack:
        if how.startswith("raise"):
            text = f"ALWAYS = {how == 'raise-always'}{RAISING}"
            (Path(folder) / "sitecustomize.py").write_text(text, encoding="utf-8")
            before = os.environ.get("PYTHONPATH", "")
            stack.callback(os.environ.__setitem__, "PYTHONPATH", before)
            os.environ["PYTHONPATH"] = f"{folder}{os.pathsep}{before}"
        command = start(out, mark, f"0.05:1.5:{OPTIONS.levels}", OPTIONS.periods, OPTIONS.processors, OPTIONS.queue)
        log = out / "log" / "sequencer.log"
        if not how.startswith("raise"):
            wait_for(lambda: log.exists() and "Level 20 locked" in log.read_text())
            (process,) = (process for process, name in marked(mark).items() if name == "extract")
            os.kill(process, signal.SIGKILL if how == "kill" else signal.SIGSTOP)
        said = ""
        if how == "stop":  # the run waits and says for whom, until somebody ends it
            assert command.stdout is not None
            while "The run waits for node extract, which is stopped" not in said and (
                line := command.stdout.readline()
            ):
                said += line
            domain = re.findall(r"in ROS domain (\d+)", said)  # others on this host have benches of their own
            if len(domain) != 1:
                command.kill()
                return [f"no domain is named: {said[-400:]}"]
            words = [sys.executable, "-m", "nmt_bench", "stop", "--domain", domain[0]]
            ending = subprocess.run(words, capture_output=True, text=True, check=False, timeout=_LEFT)
            said += ending.stdout + ending.stderr
        rest, _ = command.communicate(timeout=_LONGEST)
        said += rest
    print(said.strip()[-600:], flush=True)
    faults = [] if command.returncode == 1 else [f"exit code {command.returncode}: {said.strip()[-400:]}"]
    faults += [] if "node extract" in said.lower() else ["extraction is not named"]
    result = json.loads((out / "run.json").read_text())["result"]
    again = extract_bag(out / "bag").points
    rows = len((out / "modal.csv").read_text().splitlines()) - 1
    live = len(list(Bag.open(out / "bag").records("modal_point", MODAL_POINT)))
    not_live = result["points"]["not_live"]
    print(f"     {live} live, {rows} rows, {len(again)} in the bag; not live: {not_live}; {result['code']}", flush=True)
    if how == "raise-always":  # the bag cannot be extracted either: what came is kept, and the levels are named
        faults += [] if rows == live == 19 and "failed, too" in said else [f"{rows} rows, {live} live"]
    else:
        faults += [] if rows == len(again) >= 19 else [f"{rows} rows, {len(again)} windows in the bag"]
    faults += [] if not_live else ["no level is named"]
    return faults + faults_of_bag(out, whole=False)


def start_of_a_node(out: Path, mark: str, rng: np.random.Generator) -> list[str]:
    """A node is stopped as soon as its process is there."""
    victim = str(rng.choice(list(NODES)))
    command = start(out, mark, "0.3", 60)
    wait_for(lambda: victim in marked(mark).values())
    for process, name in marked(mark).items():
        if name == victim:
            os.kill(process, signal.SIGSTOP)
    began = time.monotonic()
    said, _ = command.communicate(timeout=_LONGEST)
    took = time.monotonic() - began
    print(f"     {victim}: {took:.1f} s: {said.strip()[-150:]}", flush=True)
    faults = [] if f"Node {victim} does not come up" in said else [said.strip()[-600:]]
    return faults + ([f"it took {took:.1f} s"] if took > _NAMED + 5.0 else [])


def wait_for(condition: object) -> None:
    end = time.monotonic() + _LONGEST
    while not condition():  # type: ignore[operator]
        if time.monotonic() > end:
            raise RuntimeError("waited in vain")
        time.sleep(0.02)


TRIALS = {
    "account": account,
    "busy": busy,
    "launcher": launcher,
    "lost": lost,
    "recorder": recorder,
    "start": start_of_a_node,
}
OPTIONS = argparse.Namespace()


def main() -> int:
    """One line a trial, one for all; 1 if something is not as it should."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("trial", choices=TRIALS)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loops", type=int, help="busy loops beside (default: 6 for busy, else none)")
    parser.add_argument("--levels", type=int, default=40, help="account: levels of the plan")
    parser.add_argument("--periods", type=int, default=200, help="account: whole periods a window")
    parser.add_argument("--processors", type=int, default=0, help="account: processors to use (default: all)")
    parser.add_argument("--queue", type=int, default=0, help="account: datagrams of a queue (default: the kernel's)")
    parser.add_argument(
        "--hurt", default="", help="account: NODE:stop, NODE:slow; lost: kill, stop, raise, raise-always"
    )
    parser.add_argument("--log", type=Path, help="account: file of the trials that are done, to go on from")
    options = parser.parse_args(namespace=OPTIONS)
    loops = options.loops if options.loops is not None else 6 * (options.trial == "busy")
    rng, faulty = np.random.default_rng(options.seed), 0
    before = options.log.read_text().splitlines() if options.log and options.log.exists() else []
    done, faulty = len(before), sum("as it should" not in line for line in before)
    with busy_loops(loops):
        for number in range(done, options.count):
            mark = f"lockstep-{os.getpid()}-{number}"
            began = time.monotonic()
            with tempfile.TemporaryDirectory(prefix="nmt-lockstep-") as folder:
                out = Path(folder) / "out"
                faults = TRIALS[options.trial](out, mark, rng) + leftovers(mark)
                lacks = ""
                with contextlib.suppress(OSError, ValueError, KeyError):
                    lacks = f", bag lacks {json.loads((out / 'run.json').read_text())['result']['bag']['lacks_s']} s"
            faulty += bool(faults)
            line = (
                f"{number + 1:3d}  {time.monotonic() - began:5.1f} s, load {os.getloadavg()[0]:.0f}{lacks}  "
                f"{faults or 'as it should'}"
            )
            print(line, flush=True)
            if options.log:
                with options.log.open("a") as log:
                    log.write(line + "\n")
    print(f"{options.trial}: {options.count} trials, {faulty} not as they should be")
    return int(faulty > 0)


if __name__ == "__main__":
    sys.exit(main())
