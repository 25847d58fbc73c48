"""Free motions that grow or decay through an amplitude, against motions that are known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import LockEvent
from nmt_core.vocabulary import PointStatus, TestKind
from nmt_extract.curves.limit_cycles import limit_cycles, write_limit_cycles
from nmt_extract.modal.growing_oscillation import fit_phasors
from nmt_extract.modal.point import modal_point
from nmt_extract.modal.window import Channel, Window

RATE = 5_000.0
OMEGA = 2.0 * math.pi * 20.0


def linear(mass: float) -> LinearDescription:
    return LinearDescription("test", 1, 0, (1,), (OMEGA,), (-0.06,), ((mass**-0.5,),), mass**-0.5, OMEGA, -0.06, 0.0)


def window(displacement: np.ndarray, level: float, force: np.ndarray | None = None) -> Window:
    lock = LockEvent(0, level, "m", 0, 20.1, math.nan, 0, displacement.size, 0, TestKind.SELF_EXCITED, 0)
    channels = (Channel("f1", Quantity.FORCE, 1), Channel("x1", Quantity.DISPLACEMENT, 1))
    zero = np.zeros(displacement.size)
    return Window(lock, RATE, channels, np.stack([zero if force is None else force, displacement]), None, math.nan)


@pytest.mark.parametrize("damping", [-0.06, -0.01, 0.03])
@pytest.mark.parametrize("mass", [1.0, 2.5])
def test_linear_growth_and_decay_are_exact(damping: float, mass: float) -> None:
    s = OMEGA * complex(-damping, math.sqrt(1.0 - damping**2))
    time = np.arange(2000) / RATE
    x = 1e-3 * (np.exp(s * time)).real
    level = 1e-3 * math.exp(s.real * 0.2)
    point = modal_point(window(x, level), linear(mass))
    assert point.status == PointStatus.OK, point.reason
    assert point.omega_rad_s == pytest.approx(OMEGA, rel=1e-6)
    assert point.damping_ratio == pytest.approx(damping, abs=1e-6)
    assert point.modal_amplitude == pytest.approx(level * math.sqrt(mass), rel=1e-9)
    assert point.frequency_hz == pytest.approx(OMEGA / (2.0 * math.pi), rel=1e-6)
    assert point.window_periods == 0


def test_a_force_that_was_measured_is_taken_out() -> None:
    """A circuit that brakes with c ẋ: what it takes is not a damping of the structure."""
    damping, brake = -0.03, 2.0
    decay = damping * OMEGA + 0.5 * brake
    s = complex(-decay, math.sqrt(OMEGA**2 - decay**2))
    wave = 1e-3 * np.exp(s * np.arange(2000) / RATE)
    level = 1e-3 * math.exp(s.real * 0.2)
    point = modal_point(window(wave.real, level, (-brake * s * wave).real), linear(1.0))
    assert point.damping_ratio == pytest.approx(damping, abs=1e-5)
    assert point.omega_rad_s == pytest.approx(OMEGA, rel=1e-5)


def test_growth_that_levels_off_and_noise() -> None:
    """a(t) of ȧ = g a (1 - a²/c²); the uncertainty covers the error."""
    growth, cycle = 6.0, 5e-3
    time = np.arange(1500) / RATE
    a = cycle / np.sqrt(1.0 + (cycle / 1.5e-3) ** 2 * np.exp(-2.0 * growth * time))
    noise = np.random.default_rng(4).normal(size=time.size) * 5e-6
    point = modal_point(window(a * np.cos(OMEGA * time) + noise, 3e-3), linear(1.0))
    expected = -growth * (1.0 - (3e-3 / cycle) ** 2) / OMEGA
    assert point.damping_ratio == pytest.approx(expected, abs=3e-4)
    assert 0.0 < point.damping_ratio_std < 1e-3
    assert point.omega_rad_s == pytest.approx(OMEGA, rel=2e-3)
    assert abs(point.omega_rad_s - OMEGA) < 3.0 * point.omega_rad_s_std


def test_what_does_not_pass_the_level_is_rejected() -> None:
    x = 1e-3 * np.exp(-1.0 * np.arange(2000) / RATE) * np.cos(OMEGA * np.arange(2000) / RATE)
    point = modal_point(window(x, 2e-3), linear(1.0))
    assert point.status == PointStatus.REJECTED
    assert "not the level's 0.002" in point.reason
    x[700] = math.nan
    assert "Samples are missing" in modal_point(window(x, 8e-4), linear(1.0)).reason


@pytest.mark.court(said="limit cycle")
@pytest.mark.parametrize("lost", [(), (1.8,), (2.6,), (5.0,), (1.8, 2.6), (1.8, 2.6, 5.0)])
def test_a_limit_cycle_between_lost_levels_is_uncertain(lost: tuple[float, ...]) -> None:
    """Damping 1 - 6 r² + 5 r⁴ % over r = q/q₀ is zero at q₀/√5 and at q₀; whatever is lost, they are within 3 std."""
    q0 = 5.0
    points = [
        ModalPoint(
            0, PointStatus.OK, "", q, "m", modal_amplitude=q, omega_rad_s=100.0, damping_ratio_std=1e-7,
            damping_ratio=0.01 * (1.0 - 6.0 * (q / q0) ** 2 + 5.0 * (q / q0) ** 4),
        )
        for q in (1.0, 1.8, 2.6, 3.4, 4.2, 5.001, 5.8) if round(q, 1) not in lost
    ]  # fmt: skip
    unstable, stable = limit_cycles(points)
    for cycle, true in ((unstable, q0 / math.sqrt(5.0)), (stable, q0)):
        assert abs(cycle.modal_amplitude - true) < 3.0 * cycle.modal_amplitude_std


@pytest.mark.court(not_said="limit cycle")
@pytest.mark.parametrize("damping", [(0.01, 0.002, 0.001, 0.002, 0.01), (-0.01, -0.012, -0.02, -0.015, -0.01)])
def test_a_damping_that_keeps_its_sign_has_no_limit_cycle(damping: tuple[float, ...]) -> None:
    """One falls to a tenth and rises again, the other moves on with growth everywhere."""
    points = [
        ModalPoint(
            0, PointStatus.OK, "", q, "m", modal_amplitude=q, damping_ratio=ratio, damping_ratio_std=1e-4,
            omega_rad_s=100.0,
        )
        for q, ratio in enumerate(damping, 1)
    ]  # fmt: skip
    assert limit_cycles(points) == []


def test_limit_cycles_and_their_stability(tmp_path) -> None:
    def point(q: float, damping: float) -> ModalPoint:
        return ModalPoint(
            0, PointStatus.OK, "", q, "m", modal_amplitude=q, damping_ratio=damping, damping_ratio_std=1e-4,
            omega_rad_s=100.0 + q,
        )  # fmt: skip

    points = [point(4.0, 0.02), point(1.0, 0.01), point(2.0, -0.01), point(3.0, -0.02)]
    unstable, stable = limit_cycles(points)
    assert (unstable.modal_amplitude, unstable.stable) == (pytest.approx(1.5, abs=0.2), False)
    assert (stable.modal_amplitude, stable.stable) == (pytest.approx(3.5, abs=0.2), True)
    share = stable.modal_amplitude - 3.0
    measured = math.hypot((1.0 - share) * 1e-4, share * 1e-4) / 0.04
    assert stable.modal_amplitude_std == pytest.approx(math.hypot(measured, stable.modal_amplitude - 3.5))
    assert stable.omega_rad_s == pytest.approx(100.0 + stable.modal_amplitude)
    assert limit_cycles(points[:2]) == []
    two = limit_cycles(points[1:3])
    assert [cycle.modal_amplitude for cycle in two] == [pytest.approx(1.5)]
    write_limit_cycles([unstable, stable], tmp_path / "limit_cycles.csv")
    lines = (tmp_path / "limit_cycles.csv").read_text().splitlines()
    assert lines[0].startswith("modal_amplitude,modal_amplitude_std")
    assert len(lines) == 3
    assert ",no," in lines[1]
    assert ",yes," in lines[2]


def test_orders_and_offset_do_not_disturb() -> None:
    time = (np.arange(800) - 399.5) / RATE
    s = complex(-5.0, OMEGA)
    wave = (2.0 * np.exp(s * time)).real + 0.3 + 20.0 * time
    wave += (0.4 * np.exp((3.0 * s.real + 3j * s.imag) * time)).real
    fit = fit_phasors(wave[None], RATE, s, 3)
    assert fit.coefficients[0, 0] == pytest.approx(2.0, abs=1e-9)
    assert abs(fit.coefficients[0, 1]) < 1e-6
