"""What ``./nmt diagnose`` and ``./nmt import --init`` do where the model is a robot's file."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.command_parser import EXIT_DONE
from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_core.errors import BenchError

if TYPE_CHECKING:
    from rich.console import Console

    from nmt_bench.commands.diagnose_options import DiagnoseOptions
    from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

_ONLY_RIGS = ("floor", "set", "without", "hold_out", "matters", "why", "calibration")


def is_robot(model: str) -> bool:
    """Whether a model is a robot's file."""
    from nmt_robots.model.robot_model import is_robot_file

    return is_robot_file(model)


def diagnose_robot_log(options: DiagnoseOptions) -> int:
    """Diagnose a robot by a log of its joints, test it on further ones, write the results, print the verdict.

    Raises:
        BenchError: an option, the model or the log is refused.
    """
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.diagnose_options import DiagnosisProgress
    from nmt_robots.report.robot_files import write_robot_diagnosis
    from nmt_robots.verdict.other_logs import diagnose_robot_by_logs

    unused = [name for name in _ONLY_RIGS if getattr(options, name)]
    if unused:
        raise BenchError(f"--{unused[0].replace('_', '-')} belongs to rigs and says nothing of a robot; leave it out.")
    if not options.real:
        raise BenchError("Give a log of the robot's joints: --real LOG; --group TABLE says which joints are alike.")
    check_output(options.out, options.force)
    console = make_console()
    started = time.monotonic()
    with DiagnosisProgress(console, options.quiet) as progress:
        diagnosis = diagnose_robot_by_logs(Path(options.model), options.real, progress.update, options.group)
        progress.update("writing the report")
        with OutputFolder(options.out, options.force) as folder:
            write_robot_diagnosis(diagnosis, folder)
    _show(diagnosis, console)
    console.print(f"Diagnosed in {time.monotonic() - started:.0f} s.", soft_wrap=True)
    console.print(f"Report: {(options.out / 'report.html').resolve()}", soft_wrap=True)
    return EXIT_DONE


def propose_robot_sidecar(data: Path, robot: Path, force: bool) -> int:
    """Write a sidecar for a log of joints next to it, or here where that folder takes no files.

    Raises:
        BenchError: the log or the robot cannot be read, or there is a sidecar already.
    """
    import os

    from nmt_core.files.whole_file import write_whole, writing
    from nmt_robots.log.proposal import propose_sidecar

    folder = data.parent if os.access(data.parent, os.W_OK) else Path()
    proposal = propose_sidecar(data, robot, folder)
    target = folder / f"{data.stem}.yaml"
    if target.exists() and not force:
        raise BenchError(f"{target} exists already; move it away or give --force to write it anew.")
    with writing(target):
        write_whole(target, proposal.text)
    asks = f"Answer: {'; '.join(proposal.questions)}; then" if proposal.questions else "Check it, then"
    sys.stdout.write(
        f"{proposal.text}\nWritten to {target}. {asks}: ./nmt diagnose --model {robot} --real {target} --out DIR\n"
    )
    return EXIT_DONE


def _show(diagnosis: RobotDiagnosis, console: Console) -> None:
    """Print the findings on the log and a row for each joint."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    from nmt_core.text.number_words import percent

    console.print()
    console.print(Text(f"Verdict: {diagnosis.verdict}", style="bold"), soft_wrap=True)
    if diagnosis.replay is not None:
        console.print(Text(f"In motion: {diagnosis.replay.sentence}"), soft_wrap=True)
    faults = [finding for finding in diagnosis.findings if finding.fault]
    by_key = {key: [item for item in faults if item.key == key] for key in dict.fromkeys(item.key for item in faults)}
    for first, *others in by_key.values():
        also = f" The same of {', '.join(name for item in others for name in item.joints)}." if others else ""
        console.print(Text(f"Log: {first.sentence}{also}", style="yellow"), soft_wrap=True)
    notes = len(diagnosis.of_file) + len(diagnosis.findings) - len(faults)
    if notes:
        console.print(f"Notes on the file and the log: {notes}, in the report.", soft_wrap=True)
    table = Table(box=SIMPLE_HEAD)
    for head in ("joint", "what differs", "closed", "left"):
        table.add_column(
            head, justify="right" if head in ("closed", "left") else "left", no_wrap=head != "what differs"
        )
    for joint in diagnosis.joints:
        if joint.mechanics is None:
            table.add_row(joint.joint.name, f"not judged: {joint.remains}", "", "")
            continue
        left = f"{joint.left:.3g} {joint.joint.effort_unit} ({percent(joint.left / joint.torque)})"
        table.add_row(joint.joint.name, joint.difference, percent(joint.closed) if joint.differs else "", left)
    console.print(table)
    for sentence in () if diagnosis.group is None else diagnosis.group.sentences:
        console.print(Text(f"Units: {sentence}"), soft_wrap=True)
    for other in diagnosis.others:
        console.print(Text(f"Held out: {other.sentence}"), soft_wrap=True)
    for request in diagnosis.next.requests:
        console.print(Text(f"Move next (trajectory.csv): {request.sentence}"), soft_wrap=True)
