"""The contract of a converter, tried with the device itself and an output of nothing but zeros.

For an untried driver: `./nmt check` begins with it where ``device.kind`` is ``custom`` or
``loopback``, and a laboratory's tests may call :func:`check_driver`. What it holds a driver to is what the process that
owns the output relies on (`nmt_plant.output_process.output_owner`); whether channels carry what they should is the
matter of `hardware_check`.

    python -m nmt_plant.check.converter_contract DRIVER ARGUMENTS SETTINGS

tries one in a process of its own and prints the result as JSON.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.plain_json import plain_json
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.steady_clock import STEADY_CLOCK, SteadyClock
from nmt_plant.converters.converter import Converter, Taken, load_converter
from nmt_plant.devices.device import DeviceFault
from nmt_rig.device_sections import AnyDevice
from nmt_rig.rig import Rig

TRIED = 2.0
"""s of samples that a driver is tried with."""
_LONGEST_TURN = 0.05  # s: the guard looks at everything once a turn
_MOST_RATE_ERROR = 0.03  # relative
_FIRST = 0.3  # s, whose turns say nothing of the rate: buffers fill
_STRETCH = 0.5  # s of samples
_MOST_OWED = 0.5  # s of samples that may still be on their way; by then it is in the steady state
_PATIENCE = 15.0  # s beyond the samples' time, after which a driver hangs
_SECOND = 0.1  # s of samples of the second start


@dataclass(frozen=True)
class ContractFinding:
    """Something that a driver does not keep.

    Attributes:
        name: of the rule, one word or several with underscores.
        sentence: what was seen.
        remedy: what to do.
    """

    name: str
    sentence: str
    remedy: str


@dataclass(frozen=True)
class ContractResult:
    """What was found.

    Attributes:
        findings: of every rule that is broken.
        delay_samples: of the driver; negative = it does not know, and the delay is measured at each start.
        turn_samples: of its last turn.
        rate_hz: of its samples by the computer's clock; NaN = too few turns.
    """

    findings: tuple[ContractFinding, ...] = ()
    delay_samples: int = -1
    turn_samples: int = 0
    rate_hz: float = float("nan")

    @property
    def passed(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    def __str__(self) -> str:
        return "\n".join(f"{each.name}: {each.sentence}; {each.remedy}." for each in self.findings) or "nothing found"


@dataclass
class _Trial:
    """The side that feeds: zeros for so many samples, then the end; keeps what it is asked and given."""

    rate: float
    outputs: int
    inputs: int
    samples: int
    clock: SteadyClock
    counts: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    taken: list[tuple[Taken, FloatArray]] = field(default_factory=list)
    empty_turns: int = 0
    owed: list[int] = field(default_factory=list)
    after_end: int = 0
    ended: bool = False
    given: list[FloatArray] = field(default_factory=list)
    wrong_count: str = ""

    def turn(self, count: Any, taken: Taken | None = None) -> FloatArray | None:
        """As the owner answers a converter, with zeros."""
        if self.ended:
            self.after_end += 1
            return None
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or not count >= 1:
            self.wrong_count = repr(count)
            self.ended = True
            return None
        self.times.append(self.clock.now())
        if taken is not None:
            self.taken.append((taken, np.array(taken.values)))
        elif self.counts:
            self.empty_turns += 1
        self.owed.append(sum(self.counts) - sum(copy.shape[1] for _, copy in self.taken))
        if sum(self.counts) >= self.samples:
            self.ended = True
            return None
        self.counts.append(int(count))
        self.given.append(np.zeros((self.outputs, int(count))))
        return self.given[-1]

    def findings(self) -> list[ContractFinding]:
        """What the turns show."""
        if self.wrong_count:
            remedy = "ask for a whole number of samples, 1 at least, in each turn"
            return [ContractFinding("turn", f"it asked for {self.wrong_count} samples", remedy)]
        found = []
        longest = max(self.counts, default=0)
        if longest > max(1.0, _LONGEST_TURN * self.rate):
            found.append(
                ContractFinding(
                    "turn",
                    f"a turn has {longest} samples ({1e3 * longest / self.rate:.0f} ms)",
                    f"take turns of {1e3 * _LONGEST_TURN:.0f} ms at most (chunk_samples)",
                )
            )
        if self.inputs:
            found += self._findings_of_inputs()
        if any(values.any() for values in self.given):
            found.append(ContractFinding("output", "it wrote into the samples to put out", "work on a copy of them"))
        if self.after_end:
            found.append(
                ContractFinding("end", "it went on after the answer None", "return from run when turn gives None")
            )
        # A busy computer delays turns: slow is what is slow all the time.
        if (
            self.rate_hz > (1.0 + _MOST_RATE_ERROR) * self.rate
            or self._fastest_hz < (1.0 - _MOST_RATE_ERROR) * self.rate
        ):
            found.append(
                ContractFinding(
                    "rate",
                    f"it takes {self.rate_hz:.6g} samples a second, the rig has {self.rate:.6g}",
                    "return from exchange when the device has taken the samples, and set its rate to sample_rate",
                )
            )
        return found

    def _findings_of_inputs(self) -> list[ContractFinding]:
        found = []
        if self.empty_turns and not self.taken:
            found.append(ContractFinding("input", "it measures nothing", "give what was measured in each turn"))
        else:
            put_out, measured = sum(self.counts), sum(copy.shape[1] for _, copy in self.taken)
            if not -_MOST_OWED * self.rate <= measured - put_out <= max(self.counts, default=0):
                found.append(
                    ContractFinding(
                        "input",
                        f"it measured {measured} samples while it put out {put_out}",
                        "measure as many samples as are put out; both count from the same turn on",
                    )
                )
            elif shift := self._drifts:
                way = "fewer" if shift > 0 else "more"
                found.append(
                    ContractFinding(
                        "input",
                        f"turn after turn it measures {way} samples than it puts out: {measured} for {put_out}, and "
                        "the difference grows",
                        "give as many samples in each turn as were put out, inputs and outputs by one clock",
                    )
                )
        if any(not np.array_equal(taken.values, copy) for taken, copy in self.taken):
            found.append(
                ContractFinding("input", "it changed what it had given before", "give a new array in each turn")
            )
        losses = sum(taken.lost for taken, _ in self.taken)
        if losses:
            found.append(
                ContractFinding(
                    "loss", f"it lost samples in {losses} of {len(self.taken)} turns", "look at buffers and priority"
                )
            )
        return found

    @property
    def _drifts(self) -> int:
        """Samples by which what is owed has left, in the last quarter, all that it was in the second; 0 = it has not.

        What is on its way is the same in the steady state, within the turns of a device that takes blocks of its own;
        a sample that is lost in every turn is not.
        """
        quarter = len(self.owed) // 4
        if quarter < 2:
            return 0
        before, after = self.owed[quarter : 2 * quarter], self.owed[-quarter:]
        return max(min(after) - max(before), 0) + min(max(after) - min(before), 0)

    @property
    def _fastest_hz(self) -> float:
        """Samples a second in the stretch of half a second in which they are most; infinity = too few turns."""
        sums = np.cumsum([0, *self.counts])[: len(self.times)]
        times, most = np.array(self.times), 0.0
        for first in np.flatnonzero(sums >= _FIRST * self.rate):
            last = int(np.searchsorted(sums, sums[first] + _STRETCH * self.rate))
            if last < len(times) and times[last] > times[first]:
                most = max(most, float((sums[last] - sums[first]) / (times[last] - times[first])))
        return most or math.inf

    @property
    def rate_hz(self) -> float:
        """Samples a second, without the first turns; NaN = too few."""
        sums = np.cumsum([0, *self.counts])
        first = next((k for k, total in enumerate(sums) if total >= _FIRST * self.rate), len(sums))
        last = len(self.times) - 1
        if last - first < 3 or self.times[last] <= self.times[first]:
            return float("inf") if last - first >= 3 else float("nan")
        return float((sums[last] - sums[first]) / (self.times[last] - self.times[first]))


def check_converter(
    make: Callable[[], Converter],
    sample_rate: float,
    outputs: int,
    inputs: int,
    monitored: bool = True,
    seconds: float = TRIED,
    clock: SteadyClock = STEADY_CLOCK,
) -> ContractResult:
    """Try a converter with zeros.

    Args:
        make: makes it; called twice.
        sample_rate: Hz.
        outputs, inputs: channels that the rig file names.
        monitored: whether an input measures the output, so that the delay can be measured.
        seconds: of samples.
        clock: by which the rate is judged.

    Returns:
        What was found. A converter that hangs is left behind in a thread.
    """
    found: list[ContractFinding] = []
    trial = _Trial(sample_rate, outputs, inputs, round(seconds * sample_rate), clock)
    try:
        converter = make()
    except Exception as error:  # whatever a driver raises
        return ContractResult((ContractFinding("start", _words(error), "correct the driver or its section"),))
    if (converter.outputs, converter.inputs) != (outputs, inputs):
        sentence = f"it has {converter.outputs} outputs and {converter.inputs} inputs, the rig {outputs} and {inputs}"
        found.append(ContractFinding("channels", sentence, "open the ports that it is given"))
    failed = _ended(converter, trial, seconds)
    if failed:  # what follows from it says no more
        return ContractResult((*found, *failed), converter.delay)
    found += trial.findings()
    if converter.delay < 0 and not monitored:
        found.append(
            ContractFinding(
                "delay",
                "it does not know its delay, and no input measures the output",
                "give it the attribute delay, or add a sensor {quantity: voltage} with a port",
            )
        )
    if not trial.wrong_count:
        found += _closed_and_opened(
            converter, make, _Trial(sample_rate, outputs, inputs, round(_SECOND * sample_rate), clock)
        )
    turn = trial.counts[-1] if trial.counts else 0
    return ContractResult(tuple(found), converter.delay, turn, trial.rate_hz)


def _ended(converter: Converter, trial: _Trial, seconds: float) -> list[ContractFinding]:
    """Run it to its end in a thread."""
    failures: list[Exception] = []

    def run() -> None:
        try:
            converter.run(trial.turn)
        except Exception as error:  # whatever a driver raises
            failures.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds + _PATIENCE)
    if thread.is_alive():
        remedy = "return from run when turn gives None" if trial.ended else "return from exchange in time"
        return [ContractFinding("end", f"it did not end within {seconds + _PATIENCE:.0f} s", remedy)]
    if failures:
        return [ContractFinding("failure", _words(failures[0]), "correct the driver")]
    if not trial.ended:
        return [ContractFinding("end", "it ended before it was told to", "go on until turn gives None")]
    return []


def _closed_and_opened(converter: Converter, make: Callable[[], Converter], trial: _Trial) -> list[ContractFinding]:
    """Close it twice, and start it once more."""
    try:
        if not isinstance(converter.stop_requested(), bool):
            return [ContractFinding("stop", "stop_requested gave no truth value", "return True or False")]
        converter.close()
        converter.close()
    except Exception as error:  # whatever a driver raises
        return [ContractFinding("close", _words(error), "let close be called twice")]
    try:
        again = make()
    except Exception as error:  # whatever a driver raises
        return [ContractFinding("second_start", _words(error), "release the device in close")]
    found = _ended(again, trial, _SECOND)
    again.close()
    return [ContractFinding("second_start", each.sentence, "release the device in close") for each in found]


def check_driver(
    converter: str,
    folder: Path | str,
    sample_rate: float,
    outputs: Sequence[tuple[int | str, float]] = ((1, 10.0),),
    inputs: Sequence[tuple[int | str, float]] = ((1, 10.0), (2, 10.0)),
    arguments: Mapping[str, Any] | None = None,
    **trial: Any,
) -> ContractResult:
    """Try a driver of your own, as ``device.kind: custom`` has it, in this process.

    Args:
        converter: ``module:Class``.
        folder: where the module is.
        sample_rate: Hz.
        outputs, inputs: port and range (V) of each.
        arguments: of the class.
        **trial: monitored, seconds and clock of :func:`check_converter`.
    """
    from nmt_plant.converters.custom_converter import CustomConverter

    def make() -> Converter:
        ends = [(port, reach, 1.0) for port, reach in outputs]
        return CustomConverter(converter, str(folder), sample_rate, ends, inputs, arguments or {})

    return check_converter(make, sample_rate, len(outputs), len(inputs), **trial)


def check_in_process(
    driver: str, arguments: Mapping[str, Any], sample_rate: float, outputs: int, inputs: int, monitored: bool
) -> ContractResult:
    """Try a converter in a process of its own, which a driver may hang or end.

    Args:
        driver, arguments: of :func:`nmt_plant.converters.converter.load_converter`.
        sample_rate, outputs, inputs, monitored: of :func:`check_converter`.
    """
    settings = {"sample_rate": sample_rate, "outputs": outputs, "inputs": inputs, "monitored": monitored}
    words = [sys.executable, "-m", "nmt_plant.check.converter_contract"]
    words += [driver, json.dumps(dict(arguments)), json.dumps(settings)]
    limit = 2.0 * (TRIED + _PATIENCE) + 30.0
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=limit, stdin=subprocess.DEVNULL)
        answer = json.loads(done.stdout.strip().splitlines()[-1])
        found = tuple(ContractFinding(**each) for each in answer.pop("findings"))
    except subprocess.TimeoutExpired:
        return ContractResult((ContractFinding("end", f"it did not end within {limit:.0f} s", "look where it waits"),))
    except (ValueError, IndexError, TypeError, AttributeError):
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        return ContractResult((ContractFinding("start", f"its process ended: {last}", "correct the driver"),))
    return ContractResult(found, **answer)


def check_monitor(rig: Rig, section: AnyDevice) -> tuple[ContractFinding, ...]:
    """Whether the output is seen at the drive's monitor, as every test asks at its start; nothing without a monitor.

    Args:
        rig: the rig.
        section: its converter.
    """
    from nmt_plant.devices.hardware_rig import HardwareRig

    device = HardwareRig(rig, section)
    if not device.has_monitor:
        return ()
    try:
        device.configure()
        device.start()
        device.read()
    except (BenchError, DeviceFault) as error:
        remedy = "connect the monitor to the output, or take its port out of device.inputs where it measures no output"
        return (ContractFinding("monitor", _words(error), remedy),)
    finally:
        device.close()
    return ()


def contract_mapping(result: ContractResult) -> dict[str, Any]:
    """What ``check.json`` says of it, with the keys of the check of a whole rig."""
    return plain_json(  # type: ignore[no-any-return]
        {
            "findings": [{**asdict(each), "channels": []} for each in result.findings],
            "delay_samples": max(result.delay_samples, 0),
            "round_trip_samples": max(result.delay_samples, 0) + result.turn_samples,
            "rate_hz": result.rate_hz,
        }
    )


def _words(error: Exception) -> str:
    """What an error says, without the stop at its end."""
    text = str(error) if isinstance(error, BenchError | DeviceFault) else f"{type(error).__name__}: {error}"
    return text.rstrip(": .")


def main() -> int:
    """Try a converter and print the result."""
    driver, arguments, settings = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
    result = check_converter(lambda: load_converter(driver, arguments), **settings)
    sys.stdout.write("\n" + json.dumps(asdict(result)) + "\n")
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
