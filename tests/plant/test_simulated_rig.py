"""Simulated rig: tick order, limits, determinism, overload."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from nmt_benchmark.plant_speed import owned_output_cost, run_benchmark
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.simulated_rig import TICK_ORDER, SimulatedRig
from nmt_rig.rig import load_rig

NOISY = ["sensors.0.noise_psd=2e-9", "sensors.0.noise_correlation_time_s=1e-5"]


def started(*overrides: str, block_samples: int | None = None) -> SimulatedRig:
    rig = SimulatedRig(load_rig("beam", overrides), block_samples)
    rig.configure()
    rig.start()
    return rig


def test_tick_works_in_the_written_order(monkeypatch):
    rig = started()
    seen: list[str] = []
    methods = dict(
        zip(
            TICK_ORDER,
            ["_take_commands", "_drive", "_measure", "_compute", "_safety", "_actuate", "_publish"],
            strict=True,
        )
    )
    for stage, method in methods.items():
        original = getattr(rig, method)

        def spy(*arguments, stage=stage, original=original):
            seen.append(stage)
            return original(*arguments)

        monkeypatch.setattr(rig, method, spy)
    rig.read()
    assert tuple(seen) == TICK_ORDER


@pytest.mark.parametrize(
    ("override", "word"),
    [
        ("limits.force_n=0.05", "force limit"),
        ("limits.acceleration_m_s2=0.5", "acceleration limit"),
        ("limits.displacement_m=1e-4", "displacement limit"),
    ],
)
def test_limits_trip_latch_and_reset(override, word):
    rig = started(override, "limits.ramp_s=0.05")
    rig.write(DriveCommand(Waveform.SINE, 22.0, 2.0))
    for _ in range(60):
        rig.write(DriveCommand(Waveform.SINE, 22.0, 2.0))
        blocks = rig.read()
    assert rig.tripped.startswith(word)
    assert "sample" in rig.tripped
    assert all(block.flags & BlockFlag.LIMIT for block in blocks)
    assert not next(b for b in blocks if b.quantity == Quantity.VOLTAGE).data.any()
    rig.reset()
    assert rig.tripped == ""
    assert rig.read()[0].flags == 0


def test_a_level_beyond_the_voltage_limit_is_refused():
    rig = started("limits.voltage_v=1")
    with pytest.raises(BenchError, match="voltage limit"):
        rig.write(DriveCommand(Waveform.SINE, 22.0, 2.0))


def test_one_seed_gives_one_result_whatever_the_block_length():
    def record(block_samples: int) -> dict[str, np.ndarray]:
        rig = started(*NOISY, block_samples=block_samples)
        rig.write(DriveCommand(Waveform.SINE, 22.0, 1.0))
        parts: dict[str, list[np.ndarray]] = {}
        for _ in range(2000 // block_samples):
            for block in rig.read():
                for name, row in zip(block.channels, block.data, strict=True):
                    parts.setdefault(name, []).append(row)
        return {name: np.concatenate(rows) for name, rows in parts.items()}

    first, again, other = record(200), record(200), record(500)
    for name in first:
        assert np.array_equal(first[name], again[name])
        # The phase is carried over block by block: rounding only.
        np.testing.assert_allclose(other[name], first[name], atol=1e-8 * np.abs(first[name]).max())


def test_seeds_change_the_noise_only():
    one, two = started(*NOISY), started(*NOISY, "seed=2")
    a, b = one.read(), two.read()
    assert not np.array_equal(a[0].data, b[0].data)
    assert np.array_equal(a[1].data, b[1].data)


def test_overload_is_flagged_for_its_block_only():
    rig = started("sensors.0.range=0.01", "sensors.0.bits=12")
    rig.write(DriveCommand(Waveform.SINE, 22.0, 1.0))
    assert any(rig.read()[0].flags & BlockFlag.OVERLOAD for _ in range(5))
    for _ in range(120):
        rig.write(DriveCommand(Waveform.OFF, ramp=0.1))
        last = rig.read()
    assert last[0].flags == 0


def test_cost_of_an_owned_output_is_a_share_of_real_time():
    cost = owned_output_cost(load_rig("beam"), seconds=0.6)
    assert 0.0 < cost.device < 5.0
    assert 0.0 <= cost.owner < 5.0
    assert cost.late > 0.0


def test_benchmark_reports_positive_figures():
    result = run_benchmark(load_rig("beam"), seconds=0.2, peer_seconds=0.002)
    assert all(value > 0 for value in dataclasses.asdict(result).values())
