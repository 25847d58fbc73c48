"""The output guard of every device that extends GuardedDevice, simulated rig and loopback as examples."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity, SampleBlock
from nmt_core.messages.records import DriveCommand, DriveTerm
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.guarded_device import GuardedDevice
from nmt_plant.devices.loopback_device import LoopbackDevice
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.oscillator import OscillatorBlock
from nmt_plant.safety.output_guard import default_slew
from nmt_rig.rig import load_rig


class Recorded:
    """A device whose final samples, as handed to the converter, are kept."""

    def __init__(self, device: GuardedDevice) -> None:
        self.device = device
        self.outputs: list[FloatArray] = []
        measure = device._measure

        def spy(drive: OscillatorBlock) -> FloatArray:
            self.outputs.append(drive.voltage[: device.block_samples].copy())
            return measure(drive)

        device._measure = spy  # type: ignore[method-assign]
        device.configure()
        device.start()

    @property
    def output(self) -> FloatArray:
        """Everything put out so far, V."""
        return np.concatenate(self.outputs)


def beam(*overrides: str) -> Recorded:
    return Recorded(SimulatedRig(load_rig("beam", overrides)))


def loopback(**options: float) -> Recorded:
    return Recorded(LoopbackDevice(**options))


def of(blocks: list[SampleBlock], quantity: Quantity) -> SampleBlock:
    return next(block for block in blocks if block.quantity == quantity)


def sine(frequency: float, amplitude: float, ramp: float = 0.0, **more: object) -> DriveCommand:
    return DriveCommand(Waveform.SINE, frequency, amplitude, ramp, **more)  # type: ignore[arg-type]


# -- what is known before is refused ---------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [beam, loopback])
@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (
            sine(22.0, 0.3, terms=(DriveTerm(1, 3, 1e6 + 0j, False),)),
            "with its harmonics 1e\\+06 V is beyond the voltage limit",
        ),
        (sine(22.0, 51.0), "drive amplitude 51 V is beyond the voltage limit"),
        (
            sine(22.0, 9.9, terms=(DriveTerm(1, 2, 20j, False), DriveTerm(1, 3, 21.0 + 0j, False))),
            "with its harmonics 50.9 V",
        ),
        (
            DriveCommand(Waveform.RANDOM, amplitude=12.6, band_low_hz=10.0, band_high_hz=500.0),
            "reach 4 times as much, beyond the voltage limit",
        ),
        (sine(4900.0, 10.0, ramp=0.5), None),
        (sine(22.0, 0.1, apply_at_sample=2**60), "s ahead of sample 0; 60 s are allowed"),
        (sine(22.0, 0.1, ramp=1e300), "longer than a day"),
        (
            sine(0.001, 0.0, terms=tuple(DriveTerm(1, n, 0j, False) for n in range(2, 500))),
            "498 harmonics and other terms; use 400",
        ),
        (DriveCommand(Waveform.RANDOM, amplitude=0.1, band_low_hz=1e-9, band_high_hz=10.0), "must begin at 0.2 Hz"),
    ],
)
def test_a_command_beyond_the_limits_is_refused_with_a_sentence(make, command, sentence) -> None:
    recorded = make()
    if sentence is None:  # the beam's limit of 50 V would let it pass, the loopback's of 10 V does not
        sentence = "beyond the slew limit" if make is loopback else "half the sample rate"
        command = command if make is loopback else sine(5000.0, 1.0)
    with pytest.raises(BenchError, match=sentence):
        recorded.device.write(command)
    recorded.device.read()
    assert not recorded.output.any()
    assert recorded.device.tripped == ""


# -- final samples ---------------------------------------------------------------------------------------------------


def test_a_sample_beyond_the_limit_trips_at_that_sample() -> None:
    """Gaussian peaks pass four times the rms now and then; a limit at three rms is passed soon."""
    recorded = beam("limits.voltage_v=0.4", "limits.ramp_s=0.05", "watchdog.blocks=0")
    recorded.device.write(DriveCommand(Waveform.RANDOM, amplitude=0.1, band_low_hz=10.0, band_high_hz=4000.0))
    free = Recorded(SimulatedRig(load_rig("beam", ["watchdog.blocks=0"])))
    free.device.write(DriveCommand(Waveform.RANDOM, amplitude=0.1, band_low_hz=10.0, band_high_hz=4000.0))
    while not recorded.device.tripped:
        blocks = recorded.device.read()
        free.device.read()
    wanted = free.output
    index = int(np.argmax(np.abs(wanted) > 0.4))
    assert recorded.device.tripped == (
        f"output limit: the drive would have reached {wanted[index]:.4g} V at sample {index}, limit 0.4 V"
    )
    assert all(block.flags & BlockFlag.LIMIT for block in blocks)
    for _ in range(4):
        recorded.device.read()
    out = recorded.output
    slew = default_slew(0.4, 10_000.0) / 10_000.0
    untouched = np.abs(np.diff(wanted[:index], prepend=0.0)).max() <= slew
    if untouched:
        np.testing.assert_array_equal(out[:index], wanted[:index])
    assert np.abs(out).max() <= 0.4
    last = out[index - 1]
    length = max(500, math.ceil(0.5 * math.pi * abs(last) / slew))
    ramp = 0.5 * last * (1.0 + np.cos(np.pi * np.arange(1, length + 1) / length))
    np.testing.assert_allclose(out[index : index + length], ramp, atol=1e-12)
    assert not out[index + length :].any()
    assert recorded.device.is_quiet


def test_a_step_with_ramp_zero_is_spread_by_the_slew_limit() -> None:
    recorded = loopback(voltage_limit=10.0)
    recorded.device.write(sine(50.0, 0.4))
    recorded.device.read()
    recorded.device.write(sine(50.0, 9.0, terms=(DriveTerm(1, 3, 0.9 + 0j, False),)))
    for _ in range(5):
        recorded.device.read()
    step = default_slew(10.0, 10_000.0) / 10_000.0
    assert np.abs(np.diff(recorded.output)).max() <= step * (1 + 1e-12)
    assert np.abs(recorded.output).max() == pytest.approx(9.9, abs=0.01)


def test_the_slew_limit_of_the_rig_file_holds() -> None:
    recorded = beam("limits.slew_v_s=500")
    recorded.device.write(sine(22.0, 2.0))
    for _ in range(3):
        blocks = recorded.device.read()
    change = np.abs(np.diff(recorded.output, prepend=0.0))
    assert change.max() == pytest.approx(0.05)
    assert recorded.device.spread_samples > 30
    # A sine of 2 V at 22 Hz needs 276 V/s: once caught up it is followed exactly.
    theta = of(blocks, Quantity.FORCE).oscillator.phase(200, 10_000.0)
    np.testing.assert_allclose(recorded.outputs[-1], 2.0 * np.cos(theta), atol=1e-9)


def test_a_step_to_full_voltage_rises_no_faster_than_its_response_is_seen() -> None:
    """A step of 50 V needs some 200 N at the coil; the limit is 50 N and must not be passed by more than a quarter."""
    recorded = beam("watchdog.blocks=0")
    recorded.device.write(sine(22.0, 50.0))
    forces = [of(recorded.device.read(), Quantity.FORCE).data[0] for _ in range(20)]
    assert "force limit: f2 would reach about" in recorded.device.tripped
    assert np.abs(np.concatenate(forces)).max() < 1.25 * 50.0
    assert recorded.device.is_quiet


def test_the_rise_of_a_step_quadruples_from_block_to_block() -> None:
    recorded = beam("limits.force_n=1e4", "limits.acceleration_m_s2=1e6")
    recorded.device.write(sine(500.0, 50.0))
    for _ in range(5):
        recorded.device.read()
    # 5 % of the voltage limit before anything has been seen, then half-cosines between 2.5, 10, 40 and 50 V.
    cosine = 50.0 * np.cos(2 * np.pi * 500.0 * np.arange(200) / 10_000.0)
    rise = 0.5 * (1.0 - np.cos(np.pi * np.arange(200) / 200.0))
    for out, start, end in zip(recorded.outputs, (0.05, 0.05, 0.2, 0.8, 1.0), (0.05, 0.2, 0.8, 1.0, 1.0), strict=True):
        np.testing.assert_allclose(out, (start + (end - start) * rise) * cosine, atol=1e-6)


def test_without_a_measured_limit_the_rise_is_free() -> None:
    recorded = loopback(voltage_limit=10.0)
    recorded.device.write(sine(50.0, 9.0))
    recorded.device.read()
    assert np.abs(recorded.output).max() == pytest.approx(9.0, abs=0.01)


def test_a_rise_that_is_held_back_does_not_grow_on_its_way_to_zero() -> None:
    recorded = beam("watchdog.blocks=0", "limits.force_n=1000", "limits.acceleration_m_s2=1e5")
    recorded.device.write(sine(22.0, 50.0))
    recorded.device.read()
    recorded.device.read()
    recorded.device.write(DriveCommand(Waveform.OFF, ramp=0.1))
    for _ in range(8):
        recorded.device.read()
    assert np.abs(recorded.output).max() <= 10.0 + 1e-6, "the amplitude after two blocks"
    assert recorded.device.is_quiet


def test_a_half_cosine_from_zero_is_never_held_back() -> None:
    recorded = beam(
        "watchdog.blocks=0", "limits.force_n=1000", "limits.acceleration_m_s2=1e5", "limits.rise_from_v=0.5"
    )
    recorded.device.write(sine(60.0, 20.0, 0.2))
    for _ in range(12):
        recorded.device.read()
    free = beam("watchdog.blocks=0", "limits.force_n=1000", "limits.acceleration_m_s2=1e5", "limits.rise_from_v=1000")
    free.device.write(sine(60.0, 20.0, 0.2))
    for _ in range(12):
        free.device.read()
    np.testing.assert_array_equal(recorded.output, free.output)


@pytest.mark.parametrize(
    ("overrides", "word"),
    [
        (('limits.channels=[{"channel": "a2", "abort_peak": 0.5}]',), "acceleration limit: a2"),
        (('limits.channels=[{"channel": "x6", "abort_rms": 1e-5}]',), "displacement limit: x6 reached"),
        (("limits.drive_maximum_v=1.5",), "drive maximum"),
        (('limits.open_loop=[{"channel": "x6", "least": 1.0, "drive_v": 1.0, "time_s": 0.1}]',), "open loop: x6"),
        (("limits.displacement_m=1e-4",), "displacement limit"),
    ],
)
def test_levels_of_the_rig_file_trip_latch_and_reset(overrides: tuple[str, ...], word: str) -> None:
    recorded = beam("watchdog.blocks=0", "limits.ramp_s=0.05", *overrides)
    recorded.device.write(sine(22.0, 2.0, 0.1))
    for _ in range(60):
        blocks = recorded.device.read()
    assert recorded.device.tripped.startswith(word)
    assert all(block.flags & BlockFlag.LIMIT for block in blocks)
    assert not recorded.outputs[-1].any()
    recorded.device.reset()
    assert recorded.device.tripped == ""
    assert recorded.device.read()[0].flags == 0


def test_a_velocity_sensor_is_limited_too() -> None:
    rig = load_rig("beam")
    values = rig.model_dump()
    values["sensors"].append({**values["sensors"][0], "quantity": "velocity", "point": 6, "channel": None})
    values["limits"]["velocity_m_s"] = 1e-3
    recorded = Recorded(SimulatedRig(type(rig).model_validate(values)))
    recorded.device.write(sine(22.0, 2.0, 0.1))
    for _ in range(20):
        recorded.device.read()
    assert recorded.device.tripped.startswith("velocity limit: v6")


def test_warnings_and_margins_are_reported_without_a_trip() -> None:
    recorded = beam("watchdog.blocks=0", 'limits.channels=[{"channel": "f2", "warning_peak": 0.1, "abort_peak": 40}]')
    recorded.device.write(sine(22.0, 2.0, 0.1))
    peak = 0.0
    for _ in range(10):
        peak = max(peak, np.abs(of(recorded.device.read(), Quantity.FORCE).data).max())
    assert recorded.device.tripped == ""
    assert len(recorded.device.warnings) == 1
    assert recorded.device.warnings[0].startswith("f2 passed its warning level of 0.1 N peak")
    assert recorded.device.margins["f2"] == pytest.approx(peak / 40.0)


# -- watchdog --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [lambda: beam("watchdog.blocks=5", "watchdog.ramp_s=0.04"), lambda: loopback(watchdog_blocks=5, quiet_ramp=0.04)],
)
def test_the_watchdog_acts_at_its_sample(make) -> None:
    """Five blocks without a command: the fifth is flagged, the first sample of the sixth begins the ramp."""
    recorded = make()
    command = sine(22.0, 0.5)
    recorded.device.write(command)
    flags = [recorded.device.read()[0].flags for _ in range(3)]
    recorded.device.write(command)
    flags += [recorded.device.read()[0].flags for _ in range(9)]
    watchdog = int(BlockFlag.WATCHDOG)
    assert flags == [0] * 7 + [watchdog] * 5
    assert recorded.device.tripped == "watchdog: no drive command for 5 blocks"
    n = np.arange(12 * 200)
    weight = 0.5 * (1.0 + np.cos(np.pi * np.clip((n - 8 * 200) / 400.0, 0.0, 1.0)))
    weight[8 * 200 + 400 :] = 0.0
    np.testing.assert_allclose(recorded.output, weight * 0.5 * np.cos(2 * np.pi * 22.0 * n / 10_000.0), atol=1e-9)


# -- by construction -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["tick", "_read", "_write", "_drive", "_safety", "_trip", "_quiet", "_reset"])
def test_a_driver_cannot_replace_a_part_of_the_guard(name: str) -> None:
    with pytest.raises(TypeError, match=f"{name} would replace a part of the output guard"):
        type("Driver", (LoopbackDevice,), {name: lambda self, *arguments: None})


# -- hostile commands ------------------------------------------------------------------------------------------------

_EDGES = (0.0, 1e-300, 1e-9, 0.3, 1.0, 9.9, 10.0, 49.9, 50.0, 51.0, 1e6, 1e300, -1.0, math.nan, math.inf)


def _hostile(rng: np.random.Generator, now: int) -> DriveCommand | None:
    """Any command; None where its own check refuses it."""

    def number(scale: float) -> float:
        return float(rng.choice(_EDGES)) if rng.random() < 0.3 else float(scale * 10 ** rng.uniform(-3, 0.3))

    waveform = Waveform(int(rng.choice([1, 2, 2, 2, 3, 3, 4, 4])))
    periodic = waveform in (Waveform.SINE, Waveform.SWEEP)
    harmonics = tuple(
        DriveTerm(1, int(rng.choice([2, 3, 5, 7, 50, 2**31])), complex(number(5.0), number(5.0)), False)
        for _ in range(int(rng.choice([0, 0, 1, 3])) if periodic else 0)
    )
    start, end = number(3000.0), number(3000.0)
    sweep = waveform == Waveform.SWEEP
    try:
        return DriveCommand(
            waveform,
            frequency_hz=start if periodic else 0.0,
            amplitude=number(float(rng.choice([1.0, 10.0, 50.0]))),
            ramp=0.0 if rng.random() < 0.6 else number(0.1),
            apply_at_sample=int(rng.choice([0, now, now + 100, now + 5000, 2**60, 2**63])),
            based_on_sample=int(rng.choice([0, now, 2**60, 2**64 - 1])),
            terms=harmonics,
            band_low_hz=number(100.0) if waveform == Waveform.RANDOM else 0.0,
            band_high_hz=number(4000.0) if waveform == Waveform.RANDOM else 0.0,
            rate_hz_s=math.copysign(number(1e4), end - start) if sweep else 0.0,
            frequency_end_hz=end if sweep else 0.0,
        )
    except BenchError:
        return None


@pytest.mark.parametrize(
    ("make", "limit"), [(lambda: beam("watchdog.blocks=20"), 50.0), (lambda: loopback(watchdog_blocks=20), 10.0)]
)
def test_no_sequence_of_commands_passes_the_guard(make, limit: float) -> None:
    recorded = make()
    device = recorded.device
    rng = np.random.default_rng(20260)
    refused = accepted = trips = 0
    for _ in range(1000):
        command = _hostile(rng, device.next_sample)
        try:
            if command is None:
                raise BenchError("")
            device.write(command)
            accepted += 1
        except BenchError:
            refused += 1
        if rng.random() < 0.02:
            device.quiet("operator", float(rng.choice([0.0, 0.001, 0.1])))
        for _ in range(int(rng.choice([0, 1, 25], p=[0.6, 0.39, 0.01]))):
            assert all(np.isfinite(block.data).all() for block in device.read())
        if device.tripped and rng.random() < 0.3:
            trips += 1
            device.reset()
    assert min(refused, accepted) > 100
    assert trips > 2
    device.quiet("the end", 0.1)
    for _ in range(12):
        blocks = device.read()
    assert device.is_quiet
    assert not recorded.outputs[-1].any()
    assert not of(blocks, Quantity.VOLTAGE).data.any()
    out = recorded.output
    assert out.any()
    assert np.abs(out).max() <= limit
    assert np.abs(np.diff(out, prepend=0.0)).max() * 10_000.0 <= default_slew(limit, 10_000.0) * (1 + 1e-9)
