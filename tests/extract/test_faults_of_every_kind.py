"""A fault put into a window of every kind of test: it is named, or the error is inside twice the stated uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from extract.synthetic import OMEGA, POINTS, RATE, SHAPES, linear_description, lock_event
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import PointStatus, TestKind
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.modal.point import modal_point
from nmt_extract.modal.window import Channel, Window

SAMPLES = 18_000
TIME = np.arange(SAMPLES) / RATE
SIZE = 1e-3
CHECKED = ("damping_ratio", "omega_rad_s", "modal_amplitude")
SETTINGS = ExtractionSettings(topics=("force", "displacement"))
CHANNELS = (Channel("f2", Quantity.FORCE, 2), *(Channel(f"x{p}", Quantity.DISPLACEMENT, p) for p in POINTS))


def motion(damping: float, growth: float = 0.0, orders: tuple[int, int] = (1, 1)) -> tuple[np.ndarray, ...]:
    """Complex force at point 2 and displacements of a mode of this damping at its frequency; growth in 1/s."""
    s = complex(growth, math.sqrt(OMEGA**2 - growth**2))
    size = SIZE * np.exp(s * (TIME - 0.5 * TIME[-1]))
    force = (s * s + 2.0 * damping * OMEGA * s + OMEGA**2) / SHAPES[0, 0] * size
    return force[None], SHAPES[:, :1] * size


def periodic(
    damping: float, kind: TestKind = TestKind.PHASE_RESONANCE, growth: float = 0.0, **changes: object
) -> Window:
    force, shape = motion(damping, growth)
    periods = round(OMEGA / (2.0 * math.pi) * TIME[-1])
    lock = lock_event(0, SAMPLES, periods, test=kind)
    omega = math.sqrt(OMEGA**2 - growth**2)
    end = omega * SAMPLES / RATE / (2.0 * math.pi)
    return Window(lock, RATE, CHANNELS, np.concatenate([force, shape]).real, omega * TIME / (2.0 * math.pi), end)


def two_exciters() -> Window:
    plain = periodic(0.012)
    force = plain.data[0]
    shape = 0.5 * SHAPES[:, 0] / SHAPES[0, 0]
    data = np.concatenate([[0.5 * force, 0.5 * force * SHAPES[0, 0] / SHAPES[1, 0]], plain.data[1:]])
    assert shape.size == len(POINTS)
    channels = (CHANNELS[0], Channel("f4", Quantity.FORCE, 4), *CHANNELS[1:])
    return Window(plain.lock, RATE, channels, data, plain.cycles, plain.end_cycles)


def secondary() -> Window:
    """3:1: the force works on the first order, the third is the mode's."""
    base = OMEGA / 3.0
    cycles = base * TIME / (2.0 * math.pi)
    wave = np.exp(2j * np.pi * cycles)
    shape = SHAPES[:, :1] * SIZE * (wave**3 + 0.4 * wave)
    force = 2.0 * wave * 1j
    lock = lock_event(
        0, SAMPLES, round(cycles[-1]), test=TestKind.SECONDARY_RESONANCE, response_order=3, force_order=1,
        frequency_hz=base / (2.0 * math.pi),
    )  # fmt: skip
    data = np.concatenate([force[None], shape]).real
    return Window(lock, RATE, CHANNELS, data, cycles, base * SAMPLES / RATE / (2.0 * math.pi))


def released() -> Window:
    damping = -0.004
    plain = periodic(damping, TestKind.SELF_EXCITED, growth=-damping * OMEGA)
    level = SIZE * SHAPES[0, 0]
    lock = lock_event(0, SAMPLES, 0, test=TestKind.SELF_EXCITED, level=level, level_unit="m", phase_error=math.nan)
    data = np.concatenate([np.zeros((1, SAMPLES)), plain.data[1:]])
    return Window(lock, RATE, CHANNELS, data, None, math.nan)


BALANCE = ExtractionSettings(topics=("force", "displacement"), power_balance=True)
KINDS: dict[str, tuple[Callable[[], Window], ExtractionSettings, dict[str, object]]] = {
    "phase resonance": (lambda: periodic(0.012), SETTINGS, {}),
    "two exciters": (two_exciters, SETTINGS, {"exciter_points": (2, 4)}),
    "ramp": (lambda: periodic(0.012, growth=0.05), BALANCE, {}),
    "secondary resonance": (secondary, SETTINGS, {}),
    "held self-excited": (lambda: periodic(-0.01, TestKind.SELF_EXCITED), SETTINGS, {}),
    "released motion": (released, SETTINGS, {}),
}


def dropped(values: np.ndarray) -> np.ndarray:
    half = round(math.pi / OMEGA * RATE)
    changed = values.copy()
    changed[SAMPLES // 2 : SAMPLES // 2 + half] = 0.0
    return changed


FAULTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "drop-out": dropped,
    "drift": lambda values: values + 0.5 * np.abs(values).max() * TIME / TIME[-1],
    "clipping": lambda values: np.clip(values, -0.8 * np.abs(values).max(), 0.8 * np.abs(values).max()),
    "coarse steps": lambda values: np.round(values / np.abs(values).max() * 8.0) * np.abs(values).max() / 8.0,
    "dead": lambda values: np.zeros_like(values),
}


def verdict(kind: str, fault: str, point: int) -> str:
    """``named``, ``covered``, or what is wrong."""
    make, settings, changes = KINDS[kind]
    window, linear = make(), linear_description(**changes)
    clean = modal_point(window, linear, settings)
    assert clean.status is PointStatus.OK, clean.reason
    name = f"x{point}"
    row = [channel.name for channel in window.channels].index(name)
    data = window.data.copy()
    data[row] = FAULTS[fault](data[row])
    faulty = Window(window.lock, RATE, window.channels, data, window.cycles, window.end_cycles)
    found = modal_point(faulty, linear, settings)
    if name in found.reason:
        return "named"
    if found.status is not PointStatus.OK:
        return f"rejected without its name: {found.reason}"
    for quantity in CHECKED:
        error = abs(getattr(found, quantity) - getattr(clean, quantity))
        std = math.hypot(getattr(found, f"{quantity}_std"), getattr(clean, f"{quantity}_std"))
        if not error <= 2.0 * std + 1e-9 * abs(getattr(clean, quantity)):
            return f"{quantity} off by {error / abs(getattr(clean, quantity)):.1e}, {error / std:.1f} std"
    return "covered"


@pytest.mark.parametrize("point", with_quick([2, 5], 5))
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_named_or_inside_twice_the_stated_uncertainty(kind: str, fault: str, point: int) -> None:
    assert verdict(kind, fault, point) in ("named", "covered")


@pytest.mark.parametrize(
    ("growth", "cause"), [(0.0, "Let the sensor warm up"), (0.05, "Level or frequency of the loop")]
)
def test_a_drift_has_the_cause_that_the_window_shows(growth: float, cause: str) -> None:
    window = periodic(0.012, growth=growth)
    row = [channel.name for channel in window.channels].index("x5")
    window.data[row] += 0.05 * np.abs(window.data[row]).max() * TIME / TIME[-1]
    reason = modal_point(window, linear_description(), SETTINGS).reason
    assert "x5 drifts by" in reason
    assert cause in reason
