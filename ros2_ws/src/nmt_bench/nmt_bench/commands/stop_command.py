"""``./nmt stop``: emergency stop of the benches of this host."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nmt_core.errors import BenchError
from nmt_core.options import option

if TYPE_CHECKING:
    from nmt_core.messages.records import DriveStop

EXIT_STOPPED, EXIT_UNKNOWN = 0, 1
_LAST_DOMAIN = 232


@dataclass(frozen=True, kw_only=True)
class StopOptions:
    """Takes the drive of every bench on this host to zero, or that of one domain, and holds it there until the service
    'reset' of its plant is called. Says what each plant answers. It is not a substitute for the switch of the
    amplifier."""

    domain: int | None = option(
        None,
        "ROS domain of the bench (default: those of all benches that './nmt' runs here, and ROS_DOMAIN_ID)",
        metavar="N",
    )
    namespace: str = option("", "namespace of the bench (default: none)", metavar="NAME")
    timeout: float = option(5.0, "s to wait for each bench (default: 5)", metavar="S")


def run(options: StopOptions) -> int:
    """Stop and say what became of it.

    Returns:
        0 if every bench that was found says that its drive is at zero, 1 otherwise.

    Raises:
        BenchError: an option is out of range.
    """
    if options.domain is not None and not 0 <= options.domain <= _LAST_DOMAIN:
        raise BenchError(f"A ROS domain must be from 0 to {_LAST_DOMAIN}, got {options.domain}.")
    if not 0.0 < options.timeout < 1e6:
        raise BenchError(f"--timeout must be positive, got {options.timeout:g}.")
    from nmt_bench.orchestration.bench_domain import domains_in_use
    from nmt_bench.orchestration.stop_node import send_stop

    if options.domain is not None:
        domains = [options.domain]
    else:
        own = os.environ.get("ROS_DOMAIN_ID", "0")
        domains = sorted({*domains_in_use(), int(own) if own.isdigit() else 0})
    answers = {domain: send_stop(domain, options.namespace, options.timeout) for domain in domains}
    for domain, answer in answers.items():
        if answer is not None or len(answers) == 1:
            sys.stdout.write(f"Domain {domain}: {_sentence(answer)}\n")
    found = [answer for answer in answers.values() if answer is not None]
    if not found and len(answers) > 1:
        sys.stdout.write(f"No plant answered on the domains {', '.join(map(str, domains))}.\n")
    return EXIT_STOPPED if found and all(_at_rest(answer) for answer in found) else EXIT_UNKNOWN


def _at_rest(stop: DriveStop) -> bool:
    from nmt_core.vocabulary import OutputState

    return stop.output in (OutputState.HELD, OutputState.ENDED)


def _sentence(answer: DriveStop | None) -> str:
    from nmt_core.vocabulary import OutputState

    if answer is None:
        return "no plant answered; what the drive does is UNKNOWN. Switch the amplifier off."
    words = {
        OutputState.HELD: "the drive is held at zero",
        OutputState.ENDED: "the drive is at zero and its output released",
        OutputState.NOT_KNOWN: "what the drive does is UNKNOWN; switch the amplifier off",
    }.get(answer.output, "the drive is not at zero yet")
    return f"{words}; sample {answer.sample}: {answer.reason.rstrip('.')}."
