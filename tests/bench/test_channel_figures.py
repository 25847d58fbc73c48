"""The benchmark of many channels: its rig, and its rows beside their limits."""

import os

import pytest

from nmt_benchmark import channel_figures
from nmt_core.errors import BenchError


def test_the_rig_has_as_many_channels_as_asked_for_and_one_at_the_drive_point():
    rig = channel_figures.large_rig(20, 200, 25_600.0)
    assert len(rig.sensors) == 200
    assert [sensor.quantity for sensor in rig.sensors[:2]] == ["force", "voltage"]
    assert {sensor.quantity for sensor in rig.sensors[2:]} == {"acceleration"}
    assert sum(sensor.point == rig.drive_point for sensor in rig.sensors[2:]) >= 1
    assert len({sensor.channel for sensor in rig.sensors[2:]}) == 198
    assert rig.block_samples == 512
    with pytest.raises(ValueError, match="at least 3 channels"):
        channel_figures.large_rig(20, 2, 25_600.0)


def test_every_row_stands_beside_its_limit(monkeypatch):
    monkeypatch.setattr(channel_figures, "in_a_process", lambda function, *arguments: function(*arguments))
    monkeypatch.setattr(channel_figures, "run_cost", lambda *_, **__: channel_figures.RunCost(9.0, 600.0, 0.3))
    figures = channel_figures.channel_figures(20.0)
    found = {(figure.unit, figure.compared): figure.met for figure in figures}
    assert found == {
        ("× real time", 10.0): False,
        ("× real time", 8.0): True,
        (channel_figures._CPU, 0.2): False,
        ("× real time", 2.0): True,
        (channel_figures._CPU, 0.5): True,
        ("MB", 500.0): False,
        ("× real time", 0.98): True,
        (channel_figures._CPU, 0.6): True,
    }


def test_a_run_that_fails_is_no_figure(monkeypatch):
    def fail(*_, **__):
        raise BenchError("The drive was stopped.")

    monkeypatch.setattr(channel_figures, "in_a_process", lambda function, *arguments: function(*arguments))
    monkeypatch.setattr(channel_figures, "run_cost", fail)
    figures = channel_figures.channel_figures(20.0)
    assert len(figures) == 4
    assert all(figure.value is None and figure.met is None for figure in figures)
    assert {figure.note for figure in figures} == {"not measured: The drive was stopped."}


def test_a_process_of_its_own_gives_its_result() -> None:
    assert channel_figures.in_a_process(os.getpid) != os.getpid()
