"""Rig files: what a rig consists of, validated; every number carries its unit in the name of its key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from nmt_core.errors import BenchError
from nmt_core.files.validation_sentence import validation_sentence
from nmt_core.messages.blocks import Quantity
from nmt_rig.device_sections import InputPortSection as InputPortSection
from nmt_rig.device_sections import NiDaqmxSection as NiDaqmxSection
from nmt_rig.device_sections import OutputPortSection as OutputPortSection
from nmt_rig.device_sections import PortAudioSection as PortAudioSection
from nmt_rig.device_sections import StopInputSection as StopInputSection
from nmt_rig.device_sections import with_driver_folder
from nmt_rig.model.local_elements import AnyElement
from nmt_rig.model.local_elements.attachments import AttachmentSection
from nmt_rig.one_of_several import with_one_exciter
from nmt_rig.rig_file import KeyPath, RigDocument, apply_overrides, read_document
from nmt_rig.rig_places import RIG_PATH_VARIABLE as RIG_PATH_VARIABLE
from nmt_rig.rig_places import find_rig as find_rig
from nmt_rig.rig_places import rig_names as rig_names
from nmt_rig.rig_section import Section as Section
from nmt_rig.rig_sections import AnyExciter as AnyExciter
from nmt_rig.rig_sections import ChannelLimitSection as ChannelLimitSection
from nmt_rig.rig_sections import DriftSection as DriftSection
from nmt_rig.rig_sections import ExtractionSection as ExtractionSection
from nmt_rig.rig_sections import ForceSection as ForceSection
from nmt_rig.rig_sections import HysteresisSection as HysteresisSection
from nmt_rig.rig_sections import LimitSection as LimitSection
from nmt_rig.rig_sections import OpenLoopSection as OpenLoopSection
from nmt_rig.rig_sections import RecordingSection as RecordingSection
from nmt_rig.rig_sections import Rig as Rig
from nmt_rig.rig_sections import SensorSection as SensorSection
from nmt_rig.rig_sections import ShakerSection as ShakerSection
from nmt_rig.rig_sections import ShakingTableSection as ShakingTableSection
from nmt_rig.rig_sections import TestSection as TestSection
from nmt_rig.rig_sections import TransverseSection as TransverseSection
from nmt_rig.rig_sections import WatchdogSection as WatchdogSection
from nmt_rig.structure_files import completed, names_files, with_channels, with_file_contents
from nmt_rig.structure_sections import AddedMassSection as AddedMassSection
from nmt_rig.structure_sections import BeamSection as BeamSection
from nmt_rig.structure_sections import ChainSection as ChainSection
from nmt_rig.structure_sections import MatricesSection as MatricesSection
from nmt_rig.structure_sections import MatrixPointSection as MatrixPointSection
from nmt_rig.structure_sections import ModalSection as ModalSection
from nmt_rig.structure_sections import ModeSection as ModeSection
from nmt_rig.structure_sections import OscillatorSection as OscillatorSection
from nmt_rig.structure_sections import RegionSection as RegionSection
from nmt_rig.structure_sections import ResidualSection as ResidualSection
from nmt_rig.structure_sections import StructureSection as StructureSection
from nmt_rig.structure_sections import point_words

ROBOT_ENDINGS = (".xml", ".mjcf", ".urdf")
"""Of files that are robots; rigs end otherwise."""
_HYSTERESIS_POINTS = ("excited_point", "middle_point", "free_point")


def _points_used(rig: Rig) -> Iterator[tuple[KeyPath, int]]:
    if rig.exciters is None:
        yield ("exciter", "point"), rig.exciter.point
    for index, exciter in enumerate(rig.exciters or ()):
        yield ("exciters", index, "point"), exciter.point
    for index, element in enumerate(rig.local_elements):
        yield ("local_elements", index, "point"), element.point
        if element.other_point is not None:
            yield ("local_elements", index, "other_point"), element.other_point
    for index, mass in enumerate(rig.structure.added_masses):
        yield ("structure", "added_masses", index, "point"), mass.point
    for index, oscillator in enumerate(rig.structure.oscillators):
        yield ("structure", "oscillators", index, "point"), oscillator.point
    for index, sensor in enumerate(rig.sensors):
        if isinstance(sensor.point, int):
            yield ("sensors", index, "point"), sensor.point
        if sensor.transverse is not None:
            yield ("sensors", index, "transverse", "point"), sensor.transverse.point
    if rig.extraction.hysteresis is not None:
        for name in _HYSTERESIS_POINTS:
            yield ("extraction", "hysteresis", name), getattr(rig.extraction.hysteresis, name)


def _check_references(rig: Rig, document: RigDocument) -> None:
    """What one section says about another: points exist, channels are unique, a current needs a shaker."""
    points = rig.structure.points
    for path, point in _points_used(rig):
        if point not in points:
            raise BenchError(
                f"{document.place(path)}: {_dotted(path)} is {point}, but the structure has {point_words(points)}."
            )
    for index, element in enumerate(rig.local_elements):
        if element.other_point == element.point:
            path = ("local_elements", index, "other_point")
            raise BenchError(f"{document.place(path)}: {_dotted(path)} must differ from point.")
        _check_element(rig, index, element, document)
    _check_exciters(rig, document)
    seen: dict[str, int] = {}
    for index, sensor in enumerate(rig.sensors):
        channel = rig.sensor_channel(sensor)
        path = ("sensors", index)
        if channel in seen:
            raise BenchError(
                f"{document.place(path)}: channel {channel} exists already (sensors.{seen[channel]}); "
                "remove one or give it another channel name."
            )
        seen[channel] = index
        if sensor.delay_s < -1.0 / rig.sample_rate_hz:
            place = document.place((*path, "delay_s"))
            raise BenchError(
                f"{place}: sensors.{index}.delay_s is {sensor.delay_s:g}; a channel can lead by one sampling interval "
                f"({1.0 / rig.sample_rate_hz:g} s) at most; delay the other channels instead."
            )
        _check_exciter_of(rig, index, sensor, document)
    limited = {
        "channels": [entry.channel for entry in rig.limits.channels],
        "open_loop": [entry.channel for entry in rig.limits.open_loop],
    }
    for key, names in limited.items():
        for index, name in enumerate(names):
            if name not in seen:
                limit_path = ("limits", key, index, "channel")
                raise BenchError(
                    f"{document.place(limit_path)}: {_dotted(limit_path)} is {name}, but there is no such channel; the "
                    f"channels are {', '.join(seen)}."
                )
    if not any(sensor.quantity == "force" for sensor in rig.sensors):
        raise BenchError(f"{document.place(('sensors',))}: sensors needs a force sensor at the drive point.")
    responses = len(rig.response_points(Quantity[rig.extraction.quantity.upper()]))
    if responses == 0:
        raise BenchError(
            f"{document.place(('extraction', 'quantity'))}: extraction.quantity is "
            f"{rig.extraction.quantity}, but there is no such sensor."
        )
    if rig.extraction.linear_modes > responses or rig.test.mode > rig.extraction.linear_modes:
        place = document.place(("extraction", "linear_modes"))
        raise BenchError(
            f"{place}: extraction.linear_modes must be between test.mode ({rig.test.mode}) and the number of "
            f"{rig.extraction.quantity} sensors ({responses}), got {rig.extraction.linear_modes}."
        )
    if isinstance(rig.structure, ModalSection) and rig.extraction.linear_modes > len(rig.structure.modes):
        place = document.place(("extraction", "linear_modes"))
        raise BenchError(
            f"{place}: extraction.linear_modes is {rig.extraction.linear_modes}, but the structure has "
            f"{len(rig.structure.modes)} modes; lower it."
        )
    if isinstance(rig.exciter, ShakingTableSection) and rig.exciters is None:
        _check_table(rig, rig.exciter, document)
    _check_hysteresis(rig, document)
    _check_device(rig, document, seen)


def _check_exciter_of(rig: Rig, index: int, sensor: SensorSection, document: RigDocument) -> None:
    """A force is measured at an exciter; voltage and current belong to one that is there."""
    place = document.place(("sensors", index))
    if sensor.quantity == "force" and rig.sensor_point(sensor) not in rig.exciter_points:
        raise BenchError(
            f"{place}: sensors.{index}: force is measured at the drive point; write point: drive"
            + (f", or one of {', '.join(map(str, rig.exciter_points))}." if rig.exciters else ".")
        )
    if sensor.quantity not in ("voltage", "current"):
        return
    number = sensor.exciter or 1
    if number > len(rig.all_exciters):
        raise BenchError(
            f"{place}: sensors.{index}.exciter is {number}, but the rig has {len(rig.all_exciters)}; give a number "
            "from 1 on, or leave it out for the first."
        )
    if sensor.quantity == "current" and not isinstance(rig.all_exciters[number - 1], ShakerSection):
        raise BenchError(f"{place}: a current sensor needs an electrodynamic_shaker.")


def _check_exciters(rig: Rig, document: RigDocument) -> None:
    """Several exciters stand at different points, each with its force and its response measured."""
    if rig.exciters is None:
        return
    measured = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    forces = rig.response_points(Quantity.FORCE)
    for index, exciter in enumerate(rig.exciters):
        place = document.place(("exciters", index))
        if isinstance(exciter, ShakingTableSection):
            raise BenchError(
                f"{place}: exciters.{index}: a shaking_table moves everything; it can only be the exciter."
            )
        if rig.exciter_points.index(exciter.point) != index:
            raise BenchError(f"{place}: exciters.{index}: another exciter is at point {exciter.point} already.")
        if exciter.point not in forces or exciter.point not in measured:
            lacking = "force" if exciter.point not in forces else rig.extraction.quantity
            raise BenchError(
                f"{place}: exciters.{index}: no {lacking} is measured at point {exciter.point}; add "
                f"{{quantity: {lacking}, point: {exciter.point}}} to the sensors."
            )
    if len(rig.exciters) > rig.extraction.linear_modes:
        raise BenchError(
            f"{document.place(('extraction', 'linear_modes'))}: extraction.linear_modes must be at least the number of "
            f"exciters ({len(rig.exciters)}), got {rig.extraction.linear_modes}."
        )


def _check_table(rig: Rig, table: ShakingTableSection, document: RigDocument) -> None:
    """A shaking table needs a structure that says how its base moves it, and takes no part of another exciter."""
    if isinstance(rig.structure, ModalSection):
        for index, mode in enumerate(rig.structure.modes):
            if mode.participation is None:
                place = document.place(("structure", "modes", index))
                raise BenchError(
                    f"{place}: structure.modes.{index} lacks participation; a shaking_table needs it of every mode."
                )
    if isinstance(rig.structure, MatricesSection) and rig.structure.base_load_kg is rig.structure.base_vector is None:
        raise BenchError(
            f"{document.place(('structure',))}: a shaking_table needs structure.base_vector, the displacement of every "
            "row for a unit displacement of the base (or r in the file)."
        )
    for index, element in enumerate(rig.local_elements):
        if element.side == "exciter" or (isinstance(element, AttachmentSection) and element.element.inertial):
            raise BenchError(
                f"{document.place(('local_elements', index))}: local_elements.{index} ({element.kind}) does not go "
                "with a shaking_table: no element on the side of the exciter, and none with a mass of its own."
            )


def _check_device(rig: Rig, document: RigDocument, channels: dict[str, int]) -> None:
    """Every sensor but a drive voltage has a port, every port a sensor, and the drive's limit is within its range."""
    device = rig.device
    if device is None:
        return
    for index, entry in enumerate(device.inputs):
        if entry.channel not in channels:
            path: KeyPath = ("device", "inputs", index, "channel")
            raise BenchError(
                f"{document.place(path)}: {_dotted(path)} is {entry.channel}, but there is no such sensor; the sensors "
                f"are {', '.join(channels)}."
            )
    mapped = {entry.channel for entry in device.inputs}
    for name, row in channels.items():
        if name not in mapped and rig.sensors[row].quantity != "voltage":
            raise BenchError(
                f"{document.place(('device', 'inputs'))}: device.inputs has no port for sensor {name}; add one, or "
                "remove the sensor."
            )
    exciters = len(rig.all_exciters)
    if len(device.outputs) != exciters:
        raise BenchError(
            f"{document.place(('device', 'outputs'))}: device.outputs has {len(device.outputs)} drive channels for "
            f"{exciters} exciter{'s' if exciters > 1 else ''}; give one for each, in their order."
        )
    limit = rig.limits.voltage_v
    output = min(device.outputs, key=lambda entry: abs(entry.amplifier_gain) * entry.range_v)
    if limit is None or limit > abs(output.amplifier_gain) * output.range_v * (1.0 + 1e-9):
        raise BenchError(
            f"{document.place(('limits',))}: limits.voltage_v must be there for hardware and at most "
            f"{abs(output.amplifier_gain) * output.range_v:g} V, what the output reaches (range_v, amplifier_gain)."
        )


def _check_hysteresis(rig: Rig, document: RigDocument) -> None:
    """The loops need the motion of all three masses."""
    section = rig.extraction.hysteresis
    if section is None:
        return
    measured = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    for name in _HYSTERESIS_POINTS:
        path = ("extraction", "hysteresis", name)
        point = getattr(section, name)
        if point not in measured:
            raise BenchError(
                f"{document.place(path)}: {_dotted(path)} is {point}, where there is no "
                f"{rig.extraction.quantity} sensor."
            )


def _check_element(rig: Rig, index: int, element: AnyElement, document: RigDocument) -> None:
    """Side and rotation fit exciter and structure."""
    if element.side == "exciter" and isinstance(element, AttachmentSection):
        place = document.place(("local_elements", index, "side"))
        raise BenchError(f"{place}: local_elements.{index} ({element.kind}) can only be on the side of the structure.")
    if element.side == "exciter" and (element.point != rig.drive_point or element.other_point is not None):
        place = document.place(("local_elements", index, "side"))
        raise BenchError(
            f"{place}: local_elements.{index} is on the side of the exciter, so its point must be the drive point "
            f"({rig.drive_point}) and it must not have an other_point."
        )
    if element.rotation and not isinstance(rig.structure, BeamSection):
        turning = {
            entry.point
            for entry in (rig.structure.points_at if isinstance(rig.structure, MatricesSection) else ())
            if entry.rotation_row is not None
        }
        if not {element.point, element.other_point} - {None} <= turning:
            place = document.place(("local_elements", index, "rotation"))
            raise BenchError(
                f"{place}: local_elements.{index}.rotation needs a beam, or matrices whose points have a rotation_row; "
                f"the points of this {rig.structure.kind} do not rotate."
            )


def _dotted(path: Sequence[str | int]) -> str:
    return ".".join(str(part) for part in path)


_IN_ITS_UNIT = dict.fromkeys(("float_type", "float_parsing"), "must be a number in the unit that its name says")


def validate_rig(document: RigDocument, folder: Path | None = None) -> Rig:
    """Rig from a parsed file.

    Args:
        document: the file.
        folder: where files that its structure names are searched for; the working directory when None.

    Raises:
        BenchError: the first thing that is wrong, with file and line, and how many more there are.
    """
    document = completed(with_file_contents(document, folder or Path()))
    try:
        rig = Rig.model_validate(document.values)
    except ValidationError as failure:
        errors = failure.errors(include_url=False)
        raise BenchError(validation_sentence(errors, document, Rig, "the rig", words=_IN_ITS_UNIT)) from failure
    _check_references(rig, document)
    return rig


def load_rig(path_or_name: str | Path, overrides: Sequence[str] = (), vibrating: bool = True) -> Rig:
    """Load and validate a rig.

    Args:
        path_or_name: path of a YAML file, or the name of a shipped rig.
        overrides: `a.b.c=value`, validated like the file itself; `exciter.point` takes the elements on its side along.
        vibrating: whether the mode under test has to swing; recordings of imposed motion need none.

    Raises:
        BenchError: no such rig, anything wrong in it or in an override, with the line, or a model that cannot be
            computed.

    Examples:
        >>> rig = load_rig("beam")
        >>> rig.drive_point, rig.sample_rate_hz
        (2, 10000.0)
        >>> load_rig("beam", ["exciter.point=4", "local_elements.0.slip_force_n=2"]).local_elements[0].slip_force_n
        2.0
        >>> load_rig("wing")
        Traceback (most recent call last):
        nmt_core.errors.BenchError: there is no rig wing...
    """
    path = find_rig(path_or_name)
    if path.suffix.lower() in ROBOT_ENDINGS:
        raise BenchError(
            f"{path} is a robot's file, and this takes a rig's; a robot and a log of its joints go to "
            f"'./nmt diagnose --model {path} --real LOG --out DIR'."
        )
    document, overrides = with_one_exciter(read_document(path), overrides)
    # What the structure's files hold can be changed too: those that say which file come first.
    first = [text for text in overrides if names_files(text.partition("=")[0].strip())]
    whole = with_file_contents(apply_overrides(document, first), path.parent)
    read = with_channels(with_driver_folder(whole, path.parent))
    changed = apply_overrides(read, [text for text in overrides if text not in first])
    _move_exciter_elements(document.values, changed.values)
    rig = validate_rig(changed)
    from nmt_rig.dry_run import check_physics  # late: who only reads a rig needs no models

    check_physics(rig, changed, vibrating)
    return rig


def _move_exciter_elements(before: Any, after: Any) -> None:
    """Elements on the side of the exciter go with it where an override moves its point; `after` is changed."""
    try:
        old, new = before["exciter"]["point"], after["exciter"]["point"]
        elements = after.get("local_elements") or []
        for element in elements:
            if element.get("side") == "exciter" and element.get("point") == old:
                element["point"] = new
    except (AttributeError, KeyError, TypeError):
        return  # not a rig: validation says what is wrong
