"""What the channels of a recording may be off by: a calibration sheet, what the bag says itself, or ordinary values.

The bench's own simulator measures as the rig file says; its bags have no tolerances. A laboratory's sensors and
converters have ordinary ones: gains by the calibration sheet, phases of conditioners, delays of filters and
multiplexers, the converter's clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_core.messages.blocks import Quantity
from nmt_core.tolerances import TOLERANCES
from nmt_core.vocabulary import QUANTITIES
from nmt_record.bag.bag_keys import SIMULATED_RIG
from nmt_record.exchange.unit_table import is_quantity, measured_quantity

if TYPE_CHECKING:
    from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet

Place = tuple[Quantity, int]


@dataclass(frozen=True)
class ChannelTolerance:
    """Standard deviations of a channel's errors.

    Attributes:
        gain: relative.
        phase: the same at all frequencies, rad.
        delay_s: its own, s.
        source: where the gain's comes from.
    """

    gain: float = TOLERANCES.gain
    phase: float = math.radians(TOLERANCES.phase_deg)
    delay_s: float = TOLERANCES.delay_s
    source: str = field(default="ordinary values", compare=False)

    def phase_at(self, omega: float) -> float:
        """Standard deviation of the phase at an angular frequency (rad/s), rad."""
        return math.hypot(self.phase, omega * self.delay_s)


NO_TOLERANCE = ChannelTolerance(0.0, 0.0, 0.0, "none: simulated")


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of all channels of a recording.

    Attributes:
        channels: by quantity and point; point −1 stands for all points of the quantity.
        default: of the others.
        clock: relative standard deviation of the sampling clock.
        same_sensors: measured linear shapes were measured with these sensors.
    """

    channels: Mapping[Place, ChannelTolerance]
    default: ChannelTolerance
    clock: float
    same_sensors: bool = True

    def of(self, quantity: Quantity, point: int) -> ChannelTolerance:
        """Tolerance of a channel; a force that is the only one counts wherever it is measured."""
        for place in ((quantity, point), (quantity, -1)):
            if place in self.channels:
                return self.channels[place]
        forces = [own for (kind, _), own in self.channels.items() if kind is Quantity.FORCE]
        if quantity is Quantity.FORCE and len(forces) == 1:
            return forces[0]
        return self.default


def tolerances(
    run: Mapping[str, Any], rig_yaml: str | None = None, sheet: CalibrationSheet | None = None
) -> Tolerances:
    """Tolerances of a recording's channels.

    A calibration sheet counts before what the bag says: the sidecar of an import, or the section ``device`` of its rig
    file. Channels that neither names have ordinary values, or none where the bench's simulator made the bag.

    Args:
        run: start record of the bag.
        rig_yaml: rig file in the bag.
        sheet: None = none.

    Raises:
        BenchError: what the bag says of a channel is not a number.
    """
    simulated = is_simulated(run)
    default = NO_TOLERANCE if simulated else ChannelTolerance()
    found: dict[Place, ChannelTolerance] = {}
    for place, stated, source in _stated(run, rig_yaml):
        found[place] = _changed(found.get(place, default), stated, source)
    for channel in sheet.channels if sheet is not None else ():
        place = measured_quantity(channel.quantity), -1 if channel.point is None else channel.point
        found[place] = _changed(found.get(place, default), channel.model_dump(), channel.source)
    clock = 0.0 if simulated else math.hypot(TOLERANCES.clock, _clock_of_import(run))
    if sheet is not None and sheet.clock_std is not None:
        clock = sheet.clock_std
    return Tolerances(found, default, clock, sheet is None or sheet.shapes_with_same_sensors)


def _clock_of_import(run: Mapping[str, Any]) -> float:
    """What the digits of an imported file leave open of its sampling rate, relative."""
    imported = run.get("imported")
    std = imported.get("clock_std") if isinstance(imported, dict) else None
    return float(std) if isinstance(std, (int, float)) and 0.0 <= std < 1.0 else 0.0


def is_simulated(run: Mapping[str, Any]) -> bool:
    """Whether the bench's own simulator made a bag, by its start record; one that says nothing is taken for it."""
    if isinstance(run.get("imported"), dict):
        return False
    device = run.get("device")
    return not (isinstance(device, str) and device not in ("", SIMULATED_RIG))


def _changed(before: ChannelTolerance, stated: Mapping[str, Any], source: str) -> ChannelTolerance:
    gain, phase, delay = (stated.get(key) for key in ("gain_std", "phase_std_deg", "delay_std_s"))
    return replace(
        before,
        gain=before.gain if gain is None else float(gain),
        phase=before.phase if phase is None else math.radians(float(phase)),
        delay_s=before.delay_s if delay is None else float(delay),
        source=before.source if gain is None else source,
    )


def _stated(run: Mapping[str, Any], rig_yaml: str | None) -> Iterator[tuple[Place, Mapping[str, Any], str]]:
    imported = run.get("imported")
    if isinstance(imported, dict):
        sidecar = imported.get("sidecar")
        for section in _mappings(sidecar.get("channels") if isinstance(sidecar, dict) else None):
            quantity = str(section.get("quantity", ""))
            if section.get("force_factor") is not None:
                yield (Quantity.FORCE, int(section.get("point", 0))), _of_current(section), "sidecar"
            elif is_quantity(quantity):
                yield (measured_quantity(quantity), int(section.get("point", 0))), section, "sidecar"
        return
    if is_simulated(run) or not rig_yaml:
        return
    try:
        rig = yaml_value(rig_yaml, "rig.yaml")
    except BenchError:
        return
    device = rig.get("device") if isinstance(rig, dict) else None
    for section in _mappings(device.get("inputs") if isinstance(device, dict) else None):
        name = str(section.get("channel", ""))
        kind, point = QUANTITIES.get(name[:1]), name[1:]
        if kind and (point.isdigit() or not point):
            date = section.get("calibrated")
            source = "rig file, section device" + (f" ({date})" if date else "")
            stated = {"gain_std": section.get("uncertainty")}
            yield (kind, int(point or 0)), stated, source


def _of_current(section: Mapping[str, Any]) -> Mapping[str, Any]:
    """Tolerances of a force that is a current times a factor: both are uncertain."""
    gain, factor = section.get("gain_std"), section.get("force_factor_std")
    gain = TOLERANCES.gain if gain is None else float(gain)
    return {**section, "gain_std": math.hypot(gain, TOLERANCES.force_factor if factor is None else float(factor))}


def _mappings(sections: Any) -> Iterator[Mapping[str, Any]]:
    for section in sections if isinstance(sections, list) else ():
        if isinstance(section, dict):
            yield section
