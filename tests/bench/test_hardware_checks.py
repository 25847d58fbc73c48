"""A test on hardware begins only on a check that passed, is young enough, and is of the same bench."""

from __future__ import annotations

import pytest

from nmt_bench.hardware.chosen_device import parsed_device
from nmt_bench.hardware.hardware_checks import check_file, fingerprint, keep_check, require_check
from nmt_core.errors import BenchError
from nmt_plant.devices.hardware_rig import device_of
from nmt_rig.rig import load_rig

HOUR = 3600.0


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    rig = load_rig("beam")
    return rig, device_of(rig, "portaudio")


def test_without_a_check_no_test_begins(bench):
    with pytest.raises(BenchError, match=r"has not been checked since it was last changed; type: \./nmt check beam"):
        require_check(*bench, "./nmt check beam")


def test_a_passing_check_holds_for_its_time(bench):
    keep_check(*bench, {"time": 1e9, "passed": True, "findings": [], "delay_samples": 7})
    assert require_check(*bench, "c", now=1e9 + 23 * HOUR)["delay_samples"] == 7
    with pytest.raises(BenchError, match=r"is 25\.0 h old and holds for 24 h"):
        require_check(*bench, "c", now=1e9 + 25 * HOUR)


def test_a_check_that_found_something_is_named(bench):
    keep_check(*bench, {"time": 1e9, "passed": False, "findings": [{"name": "sign"}, {"name": "mains"}]})
    with pytest.raises(BenchError, match="found sign, mains; fix it and type: c"):
        require_check(*bench, "c", now=1e9)


def test_a_changed_bench_asks_for_a_new_check(bench):
    rig, section = bench
    other = load_rig("beam", ["limits.force_n=40"])
    assert fingerprint(rig, section) != fingerprint(other, section)
    assert check_file(rig, section) != check_file(other, device_of(other, "portaudio"))


def test_a_damaged_file_is_no_check(bench):
    keep_check(*bench, {})
    check_file(*bench).write_text("{")
    with pytest.raises(BenchError, match="has not been checked"):
        require_check(*bench, "c")


def test_the_device_is_named_with_its_address_or_refused(bench):
    rig, _ = bench
    assert parsed_device("", rig) == ("", "")
    assert parsed_device("nidaqmx@lab:31763", rig) == ("nidaqmx", "lab:31763")
    with pytest.raises(BenchError, match="'asio' is not known"):
        parsed_device("asio", rig)
    with pytest.raises(BenchError, match="an address for nidaqmx only"):
        parsed_device("portaudio@lab", rig)


def test_a_check_of_the_converter_alone_lets_begin_only_what_asks_for_no_more(bench):
    rig, section = bench
    document = {"time": 1e9, "passed": True, "findings": [], "delay_samples": 7, "scope": "converter"}
    keep_check(rig, section, document)
    with pytest.raises(BenchError, match="looked at the converter alone; type: c"):
        require_check(rig, section, "c", now=1e9)
    less = section.model_copy(update={"check": "converter"})
    keep_check(rig, less, document)
    assert require_check(rig, less, "c", now=1e9)["delay_samples"] == 7
