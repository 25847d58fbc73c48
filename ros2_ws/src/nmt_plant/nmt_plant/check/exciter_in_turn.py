"""The check of a bench with several exciters: each drives alone in turn, as the only exciter of the check does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from nmt_plant.check.check_result import CheckResult
from nmt_rig.device_sections import AnyDevice
from nmt_rig.rig import Rig


def with_first(rig: Rig, section: AnyDevice, number: int) -> tuple[Rig, AnyDevice]:
    """Rig and converter with another exciter in the first place; points, channels and ports stay.

    Args:
        rig: with one exciter or several.
        section: its converter, an output for each.
        number: of the exciter, from 1.
    """
    if number == 1 or rig.exciters is None:
        return rig, section
    order = [number - 1, *(row for row in range(len(rig.exciters)) if row != number - 1)]
    exciters = [rig.exciters[row] for row in order]
    sensors = []
    for sensor in rig.sensors:
        changes: dict[str, object] = {"channel": rig.sensor_channel(sensor)}
        if sensor.quantity in ("voltage", "current"):
            changes["exciter"] = order.index((sensor.exciter or 1) - 1) + 1
        elif sensor.point == "drive":
            changes["point"] = rig.drive_point
        sensors.append(sensor.model_copy(update=changes))
    turned = rig.model_copy(update={"exciter": exciters[0], "exciters": exciters, "sensors": sensors})
    return turned, section.model_copy(update={"outputs": [section.outputs[row] for row in order]})


def check_in_turn(rig: Rig, section: AnyDevice, check: Callable[[Rig, AnyDevice], CheckResult]) -> CheckResult:
    """Check the bench with each exciter in turn.

    Args:
        rig, section: of the bench.
        check: of a bench, driven by its first exciter.

    Returns:
        Findings of all, those of several exciters with the number of the one that drove; figures of the channels as the
        first drove, of each monitor as its exciter drove.
    """
    count = len(rig.all_exciters)
    results = [check(*with_first(rig, section, number)) for number in range(1, count + 1)]
    return results[0] if count == 1 else _together(rig, results)


def _together(rig: Rig, results: Sequence[CheckResult]) -> CheckResult:
    findings = tuple(
        each._replace(sentence=f"exciter {number} drives: {each.sentence}")
        for number, result in enumerate(results, start=1)
        for each in result.findings
    )
    driver = {
        rig.sensor_channel(sensor): (sensor.exciter or 1) - 1 for sensor in rig.sensors if sensor.quantity == "voltage"
    }
    channels = tuple(
        results[driver.get(figures.channel, 0)].channels[row] for row, figures in enumerate(results[0].channels)
    )
    return replace(
        results[0],
        findings=findings,
        channels=channels,
        drive_peak_v=max(result.drive_peak_v for result in results),
        lost_blocks=sum(result.lost_blocks for result in results),
    )
