"""Every kind of converter describes itself: what the schema, the commands and the pages need is in its section."""

from __future__ import annotations

import importlib
import inspect
from typing import Any

import pytest

from nmt_bench.commands import shared_options
from nmt_core.errors import BenchError
from nmt_plant.converters.converter import Converter
from nmt_plant.devices.hardware_rig import device_of
from nmt_rig.device_sections import DEVICES, DeviceSection
from nmt_rig.rig import Rig, load_rig


def named(text: str) -> Any:
    module, _, name = text.partition(":")
    return getattr(importlib.import_module(module), name)


def section_of(kind: str) -> DeviceSection:
    """A section of a kind, with the ports of the beam; texts for what it needs besides."""
    ports = device_of(load_rig("beam"), "loopback")
    needed = [name for name, field in DEVICES[kind].model_fields.items() if field.is_required()]
    own = dict.fromkeys(needed, "module:Class") | {"kind": kind, "outputs": ports.outputs, "inputs": ports.inputs}
    try:
        return device_of(load_rig("beam"), kind)
    except BenchError:
        return DEVICES[kind](**own)


@pytest.mark.parametrize("kind", DEVICES)
def test_a_driver_takes_the_arguments_of_its_section(kind: str) -> None:
    section = section_of(kind)
    driver = named(section.driver)
    assert issubclass(driver, Converter)
    inspect.signature(driver).bind(**section.driver_arguments(10_000.0, 200))


@pytest.mark.parametrize("kind", DEVICES)
def test_a_finder_is_called_with_section_and_rig(kind: str) -> None:
    section = DEVICES[kind]
    if section.finder:
        inspect.signature(named(section.finder)).bind(section_of(kind), load_rig("beam"))


@pytest.mark.parametrize("kind", DEVICES)
def test_the_help_of_the_commands_names_it(kind: str) -> None:
    assert kind in shared_options._DEVICE


def test_the_schema_has_every_kind() -> None:
    content = load_rig("beam").model_dump(mode="json", exclude_none=True)
    for kind in DEVICES:
        content["device"] = section_of(kind).model_dump(mode="json", exclude_none=True)
        assert type(Rig.model_validate(content, strict=False).device) is DEVICES[kind]


def test_a_kind_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(BenchError, match="no kind of converter 'portaudoi'; use portaudio, nidaqmx, loopback, custom"):
        device_of(load_rig("beam"), "portaudoi")
    with pytest.raises(BenchError, match="kind 'custom' needs a section 'device' in the rig file"):
        device_of(load_rig("beam"), "custom")
