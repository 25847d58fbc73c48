"""Order analysis along sweeps: exact amplitudes, stated bias and noise, the physics of a finite rate, stepped sines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, ss2tf

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_extract.curves.response_table import read_response_csv, write_response_csv
from nmt_extract.curves.swept_response import (
    OrderKernel,
    response_per_force,
    stepped_point,
    stepped_table,
    sweep_table,
    swept_response,
)
from nmt_record.windows.segments import Signals

RATE = 5000.0


def phase(start: float, stop: float, sweep: float) -> np.ndarray:
    """Unwrapped cycles of a linear sweep."""
    time = np.arange(round(abs(stop - start) / sweep * RATE)) / RATE
    return 0.3 + start * time + 0.5 * math.copysign(sweep, stop - start) * time**2


def signals(cycles: np.ndarray, **channels: np.ndarray) -> Signals:
    kinds = {"f": Quantity.FORCE, "a": Quantity.ACCELERATION, "u": Quantity.VOLTAGE}
    return Signals(
        RATE,
        1000,
        channels,
        {name: kinds[name[0]].unit for name in channels},
        {name: int(name[1:] or 0) for name in channels},
        {name: kinds[name[0]] for name in channels},
        cycles,
        (),
    )


def test_constant_orders_come_out_whatever_the_sweep() -> None:
    cycles = phase(60.0, 50.0, 2.0)
    amplitudes = np.array([1.0 - 2.0j, 0.3j, 0.1])
    data = sum((c * np.exp(2j * np.pi * (n + 1) * cycles)).real for n, c in enumerate(amplitudes)) + 4.0
    swept = swept_response(cycles, data[None], ("a1",), RATE, points=50, harmonics=3)
    assert swept.amplitudes[0] == pytest.approx(np.repeat(amplitudes[:, None], swept.frequency_hz.size, 1), abs=2e-4)
    assert swept.frequency_hz[0] < 60.0
    assert np.all(np.diff(swept.frequency_hz) < 0)
    assert swept.rate_hz_s == pytest.approx(-2.0)
    assert swept.kernel.duration * 50.0 > 10.0


def fourth_moment(kernel: OrderKernel) -> float:
    """μ₄ = Σ k τ⁴, s⁴; the bias of a smoothly varying amplitude is μ₄/24 times its fourth derivative."""
    time = np.arange(-kernel.half, kernel.half + 1) / kernel.sample_rate
    return float((kernel.weights * time**4).sum())


def test_kernel_is_what_it_says() -> None:
    kernel = OrderKernel.of_length(0.25, RATE)
    time = np.arange(-kernel.half, kernel.half + 1) / RATE
    assert kernel.weights.sum() == pytest.approx(1.0)
    assert (kernel.weights * time**2).sum() == pytest.approx(0.0, abs=1e-15)
    assert fourth_moment(kernel) < 0
    beat = kernel.bandwidth_hz
    assert abs((kernel.weights * np.exp(2j * np.pi * beat * time)).sum()) == pytest.approx(math.sqrt(0.5), abs=0.02)
    far = np.abs([(kernel.weights * np.exp(2j * np.pi * f * time)).sum() for f in np.linspace(40.0, 400.0, 300)])
    assert far.max() < 1e-4


def test_bias_of_the_window_is_its_fourth_moment() -> None:
    """An amplitude that beats at ν is scaled by 1 + μ₄ (2πν)⁴/24 to leading order."""
    cycles, beat = phase(100.0, 101.0, 0.25), 1.0
    time = np.arange(cycles.size) / RATE
    data = ((1.0 + 0.5 * np.cos(2 * np.pi * beat * time)) * np.exp(2j * np.pi * cycles)).real
    swept = swept_response(cycles, data[None], ("a1",), RATE, points=200, duration=0.25)
    at = swept.sample / RATE
    found = np.linalg.lstsq(np.cos(2 * np.pi * beat * at)[:, None], swept.fundamental("a1").real - 1.0, rcond=None)[0]
    expected = 1.0 + fourth_moment(swept.kernel) * (2 * np.pi * beat) ** 4 / 24.0
    assert 0.5 * expected == pytest.approx(float(found[0]), abs=2e-5)
    assert abs(expected - 1.0) > 1e-5


def test_stated_noise_is_the_scatter() -> None:
    generator = np.random.default_rng(2)
    cycles = phase(100.0, 130.0, 1.0)
    clean = (2.0 * np.exp(2j * np.pi * cycles)).real
    swept = swept_response(cycles, (clean + generator.standard_normal(cycles.size))[None], ("a1",), RATE, points=300)
    scatter = np.std(np.concatenate([(swept.fundamental("a1") - 2.0).real, swept.fundamental("a1").imag]))
    assert np.mean(swept.fundamental_noise("a1")) == pytest.approx(scatter, rel=0.15)
    assert scatter == pytest.approx(math.sqrt(2.0 * float((swept.kernel.weights**2).sum())), rel=0.15)


def one_dof(cycles: np.ndarray, omega: float, damping: float) -> np.ndarray:
    """Displacement of ẍ + 2δω ẋ + ω² x = cos θ by exact integration of a force that is linear between fine samples."""
    fine = 8
    time = np.arange(cycles.size * fine) / fine
    exact = np.polynomial.Polynomial.fit(np.arange(cycles.size), cycles, 2)
    force = np.cos(2 * np.pi * exact(time))
    a = np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]])
    continuous = a, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))
    system = cont2discrete(continuous, 1 / RATE / fine, "foh")
    numerator, denominator = ss2tf(*system[:4])
    return lfilter(numerator[0], denominator, force)[::fine]


@pytest.mark.parametrize("direction", [1, -1])
def test_sweep_of_a_resonance_is_the_steady_response_and_the_lag_of_a_finite_rate(direction: int) -> None:
    omega, damping, sweep = 2 * np.pi * 100.0, 0.008, 0.2
    ends = (94.0, 106.0)[::direction]
    cycles = phase(*ends, sweep)
    motion = one_dof(cycles, omega, damping)
    force = np.cos(2 * np.pi * cycles)
    table = sweep_table(signals(cycles, f1=force, a1=motion), 1.0, "N", points=400)
    assert np.max(np.abs(table.held_error())) < 2e-5
    w = 2 * np.pi * table.frequency_hz

    def steady(w: np.ndarray) -> np.ndarray:
        return 1.0 / (omega**2 - w**2 + 2j * damping * omega * w)

    h = 1e-2
    second = (steady(w + h) - 2 * steady(w) + steady(w - h)) / h**2
    lagged = steady(w) - 0.5j * direction * 2 * np.pi * sweep * second
    top = np.abs(steady(w)).max()
    inside = slice(60, -10)  # the start of the sweep from rest has decayed
    to_steady = np.abs(table.frf[0] - steady(w))[inside].max() / top
    to_lagged = np.abs(table.frf[0] - lagged)[inside].max() / top
    expected = 2 * np.pi * sweep / (damping * omega) ** 2
    assert to_steady == pytest.approx(expected, rel=0.4)  # α/δ² at the peak
    assert to_lagged < 0.3 * to_steady
    late = table.frequency_hz[np.argmax(np.abs(table.frf[0]))] - 100.0
    # α/δ late, in Hz
    assert late == pytest.approx(direction * sweep / (damping * omega), abs=0.04)


def test_response_per_force_carries_both_uncertainties() -> None:
    generator = np.random.default_rng(3)
    force, response = 2.0 + 1.0j, 3.0 - 4.0j
    noise = generator.standard_normal((4, 20_000)) * 0.01
    values = (response + noise[0] + 1j * noise[1]) / (force + 2 * noise[2] + 2j * noise[3])
    _, std = response_per_force(np.array([force]), np.array([0.02]), np.array([[response]]), np.array([[0.01]]))
    assert std[0, 0] == pytest.approx(np.std(values.real), rel=0.03)
    assert std[0, 0] == pytest.approx(np.std(values.imag), rel=0.03)


def test_stepped_points_with_uncertainties_and_the_file(tmp_path) -> None:
    generator = np.random.default_rng(4)
    points, spread = [], []
    for k in range(30):
        frequency = 50.0 + k
        cycles = 0.1 + frequency * np.arange(round(100 * RATE / frequency)) / RATE
        tone = np.exp(2j * np.pi * cycles)
        a = ((1.0 + 2.0j) * tone + 0.2 * tone**3).real + 0.1 * generator.standard_normal(cycles.size)
        point = stepped_point(signals(cycles, f1=(2.0 * tone).real, a1=a, u=(3.0 * tone).real), 100, frequency)
        points.append(point)
        spread.append(point.frf[0] - (0.5 + 1.0j))
    table = stepped_table(points, 2.0, "N")
    scatter = np.sqrt(np.mean(np.abs(spread) ** 2) / 2)
    assert np.sqrt(np.mean(table.frf_std**2)) == pytest.approx(scatter, rel=0.35)
    assert table.force_n == pytest.approx(2.0)
    assert table.voltage_v == pytest.approx(3.0)
    assert table.held_error() == pytest.approx(0.0, abs=1e-9)
    write_response_csv([table, table], tmp_path / "frf.csv")
    read = read_response_csv(tmp_path / "frf.csv")
    assert len(read) == 2
    assert read[1].frf.tobytes() == table.frf.tobytes()
    assert read[1].frf_std.tobytes() == table.frf_std.tobytes()
    assert read[1].level_unit == "N"
    (tmp_path / "frf.csv").write_text("frequency_hz\n1\n")
    with pytest.raises(BenchError, match=r"not the frf\.csv of a sweep"):
        read_response_csv(tmp_path / "frf.csv")


def test_refusals() -> None:
    cycles = phase(100.0, 101.0, 1.0)
    tone = np.cos(2 * np.pi * cycles)
    with pytest.raises(BenchError, match="no longer than"):
        swept_response(cycles[:600], tone[None, :600], ("a1",), RATE)
    with pytest.raises(BenchError, match="periods"):
        swept_response(cycles, tone[None], ("a1",), RATE, duration=0.05)
    with pytest.raises(BenchError, match="force channel"):
        sweep_table(signals(cycles, a1=tone), 1.0, "N")
    gap = tone.copy()
    gap[100] = math.nan
    with pytest.raises(BenchError, match="missing"):
        sweep_table(signals(cycles, f1=tone, a1=gap), 1.0, "N")
    with pytest.raises(BenchError, match="no channel"):
        swept_response(cycles, tone[None], ("a1",), RATE).fundamental("a2")
