"""``./nmt check``: every channel and the loop at low level, before a test on hardware."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, hardware_option, replace_option
from nmt_core.errors import BenchError
from nmt_core.options import argument, option

if TYPE_CHECKING:
    from nmt_plant.check.check_result import CheckResult
    from nmt_plant.check.converter_contract import ContractResult
    from nmt_plant.devices.hardware_rig import HardwareRig
    from nmt_rig.device_sections import AnyDevice
    from nmt_rig.rig import Rig

EXIT_PASSED, EXIT_FOUND = 0, 1


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """Listens to the converter, then drives it with noise of at most one hundredth of the drive's limit, and compares
    every channel with the rig's model (several exciters drive in turn): noise, mains, offset, overload, open or shorted
    channels, dead ICP supply, sign, exchanged channels, sensitivity and delay of each, response to the drive, headroom
    for the planned levels, clock, and frequency of each mode. A test on hardware begins only after a check that passed.
    A driver of your own is tried with zeros first; with --set device.check=converter that is all."""

    rig: str = argument("name of a rig (for example beam) or path of a rig file", metavar="RIG")
    out: Path = dated_folder_option("check.json, report.html", "check")
    force: bool = replace_option()
    device: str = hardware_option()
    levels: str | None = option(None, "planned levels, V, as for './nmt run' (default: the rig's)", metavar="PLAN")
    linear: Path | None = option(None, "linear.json whose resonance is expected", metavar="FILE")
    exciter: int | None = option(None, "drive point (default: the rig's)", metavar="N")
    set: tuple[str, ...] = option((), "change a value of the rig file", metavar="KEY=VALUE")
    quiet: bool = option(False, "no progress display")


def run(options: CheckOptions) -> int:
    """Check, write and keep the result, print the table.

    Returns:
        0 if nothing was found, 1 otherwise.

    Raises:
        BenchError: rig, option or device are refused, or the device failed.
    """
    check_output(options.out, options.force)
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.hardware_options import chosen_rig
    from nmt_bench.commands.linear_input import read_linear
    from nmt_bench.hardware.chosen_device import look_for_device, parsed_device
    from nmt_bench.hardware.hardware_checks import fingerprint, keep_check
    from nmt_plant.check.check_record import record_check
    from nmt_plant.check.converter_contract import check_monitor, contract_mapping
    from nmt_plant.check.exciter_in_turn import check_in_turn
    from nmt_plant.check.hardware_check import evaluate_check
    from nmt_plant.devices.device import DeviceFault
    from nmt_plant.devices.hardware_rig import HardwareRig, device_of
    from nmt_plant.real_time import real_time_priority
    from nmt_report.check_report import check_page
    from nmt_rig.device_sections import DEVICE_KINDS
    from nmt_sequencer.level_plan import parse_levels

    rig = chosen_rig(options)
    kind, address = parsed_device(options.device, rig)
    if kind in ("", "simulated"):
        raise BenchError(
            f"Rig {rig.name} is simulated and has no converter to check; give --device {' or '.join(DEVICE_KINDS)}, or "
            "write a section 'device' into the rig file."
        )
    linear = read_linear(options.linear) if options.linear is not None else None
    levels = parse_levels(options.levels or rig.test.levels)
    section = device_of(rig, kind, address)
    look_for_device(section, rig)
    console = make_console()
    document: dict[str, Any] = {
        "rig": rig.name,
        "device": section.kind,
        "fingerprint": fingerprint(rig, section),
        "time": time.time(),
        "date": time.strftime("%Y-%m-%d %H:%M:%S"),
        "scope": section.check,
    }
    if section.by_contract or section.check == "converter":
        contract = _contract(rig, section)
        if contract.passed and section.check == "converter":
            contract = replace(contract, findings=check_monitor(rig, section))
        if not contract.passed or section.check == "converter":
            document |= {"passed": contract.passed, **contract_mapping(contract)}
            with OutputFolder(options.out, options.force) as folder:
                (folder / "check.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
            keep_check(rig, section, document)
            _show_contract(contract, console, section.check_valid_hours)
            console.print(f"Results in {options.out}: check.json", soft_wrap=True)
            return EXIT_PASSED if contract.passed else EXIT_FOUND
    priorities: list[str] = []

    def check(turned: Rig, its_section: AnyDevice) -> CheckResult:
        lead = _lead(turned.block_samples, turned.sample_rate_hz)
        device = HardwareRig(turned, its_section, lead_blocks=lead, probe_needed=False)
        try:
            device.configure()
            device.start()
            with real_time_priority():
                record = record_check(device, None if options.quiet else _progress(console))
            priorities.append(_priority(device))
            return evaluate_check(device, record, levels, 0.0 if linear is None else linear.frequency_hz)
        except DeviceFault as error:
            raise BenchError(f"The converter failed: {error}") from error
        finally:
            device.close()

    result = check_in_turn(rig, section, check)
    document = {
        "rig": rig.name,
        "device": section.kind,
        "fingerprint": fingerprint(rig, section),
        "time": time.time(),
        "date": time.strftime("%Y-%m-%d %H:%M:%S"),
        "priority": priorities[0],
        **result.to_mapping(),
    }
    with OutputFolder(options.out, options.force) as folder:
        (folder / "check.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        (folder / "report.html").write_text(check_page(document), encoding="utf-8")
    keep_check(rig, section, document)
    _show(result, console, section.check_valid_hours)
    console.print(f"Results in {options.out}: check.json, report.html", soft_wrap=True)
    return EXIT_PASSED if result.passed else EXIT_FOUND


def _contract(rig: Rig, section: AnyDevice) -> ContractResult:
    """Try the converter alone, with zeros, in a process of its own."""
    from nmt_plant.check.converter_contract import check_in_process

    monitors = {rig.sensor_channel(sensor) for sensor in rig.sensors if sensor.quantity == "voltage"}
    return check_in_process(
        section.driver,
        section.driver_arguments(float(rig.sample_rate_hz), int(rig.block_samples)),
        float(rig.sample_rate_hz),
        len(section.outputs),
        len(section.inputs),
        any(entry.channel in monitors for entry in section.inputs),
    )


def _show_contract(result: ContractResult, console: Any, valid: float) -> None:
    for finding in result.findings:
        words = finding.name.replace("_", " ")
        console.print(f"{words}: {finding.sentence}; {finding.remedy}.", style="red", soft_wrap=True)
    if result.passed:
        delay = f"{result.delay_samples} samples" if result.delay_samples >= 0 else "measured at each start"
        console.print(
            f"The converter keeps the contract: {result.rate_hz:.6g} samples a second, turns of {result.turn_samples}, "
            f"delay {delay}. Channels were not compared with the rig's model. Passed; tests may begin for {valid:g} h.",
            style="green",
            soft_wrap=True,
        )


def _lead(block: int, rate: float) -> int:
    """Blocks that wait at the output: half a second, since nothing has to be controlled."""
    return max(8, min(100, round(0.5 * rate / block)))


def _priority(device: HardwareRig) -> str:
    from nmt_plant.real_time import priority_of

    return priority_of(device.output_pid)


def _progress(console: Any) -> Any:
    told = -1

    def tell(share: float) -> None:
        nonlocal told
        tenth = int(10.0 * share)
        if tenth > told:
            told = tenth
            console.print(f"checking: {10 * tenth} %", highlight=False)

    return tell


def _show(result: CheckResult, console: Any, valid: float) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from nmt_report.quantity_format import uncertain

    table = Table(title="Channels", title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    heads = (
        "channel",
        "port",
        "noise\nrms",
        "mains\nmV",
        "mean\nmV",
        "coherence",
        "gain",
        "delay\nµs",
        "range\n%",
        "verdict",
    )
    for head in heads:
        table.add_column(head, no_wrap=head != "verdict")
    for channel in result.channels:
        found = [each.name.replace("_", " ") for each in result.findings if channel.channel in each.channels]
        table.add_row(
            channel.channel,
            channel.port,
            f"{channel.noise:.2g} {channel.unit}",
            f"{1e3 * channel.mains_v:.3f}",
            f"{1e3 * channel.offset_v:.2f}",
            f"{channel.coherence:.3f}",
            "" if channel.gain != channel.gain else f"{channel.gain:.3f}",
            "" if channel.delay != channel.delay else f"{1e6 * channel.delay:.1f}",
            "" if channel.headroom != channel.headroom else f"{100 * channel.headroom:.1f}",
            ", ".join(found) or "good",
        )
    console.print(table)
    stated = f", the driver says {result.stated_samples}" if result.stated_samples >= 0 else ""
    clock = "" if result.clock_ppm != result.clock_ppm else f"; clock {result.clock_ppm:+.0f} ppm"
    console.print(
        f"Round trip {result.round_trip_samples} samples{stated}{clock}; largest drive {result.drive_peak_v:.3g} V of "
        f"{result.drive_limit_v:.3g} V allowed; resonance at {result.frequency_hz:.4g} Hz.",
        soft_wrap=True,
    )
    for mode in result.modes:
        hz = uncertain(mode.frequency_hz, mode.frequency_std)
        damping = uncertain(100.0 * mode.damping_ratio, 100.0 * mode.damping_std)
        model = f"model {mode.model_hz:.5g} Hz, {100.0 * mode.model_damping:.3g} %"
        console.print(f"Mode {mode.number}: {hz} Hz, {damping} % ({model}).", soft_wrap=True)
    for finding in result.findings:
        where = f"{', '.join(finding.channels)}: " if finding.channels else ""
        console.print(f"{where}{finding.sentence}; {finding.remedy}.", style="red", soft_wrap=True)
    if result.passed:
        console.print(f"Passed; tests may begin for {valid:g} h.", style="green")
