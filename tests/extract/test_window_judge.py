"""Windows that are not what they seem: none gives a result that is wrong beyond its stated uncertainty."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from extract.synthetic import linear_description, lock_event

from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.judgement.signal_faults import drifting, without_drift
from nmt_extract.judgement.window_judge import silent_stretch
from nmt_extract.modal.point import modal_point
from nmt_extract.modal.window import Channel, Window
from nmt_signals.channel_faults.converter_faults import resolution

RATE, SECONDS, F0, DAMPING = 2000.0, 2.0, 50.0, 0.005
OMEGA0 = 2.0 * math.pi * F0
SETTINGS = ExtractionSettings(topics=("force", "displacement"))
LINEAR = linear_description(
    np.array([[1.0]]), points=(1,), drive_point=1, frequencies_rad_s=(OMEGA0,), damping_ratios=(DAMPING,),
    drive_point_shape=1.0,
)  # fmt: skip
TIME = np.arange(round(RATE * SECONDS)) / RATE
SMALL = 1e-3  # relative; ordinary tolerances of channels are ten times as large


def vibration(frequency: float = F0, amplitude: float = 1e-4, shift_s: float = 0.0, clock: float = 0.0):
    """Force and displacement of one mode of 1 kg in steady vibration; the response late and on a clock of its own."""
    omega = 2.0 * math.pi * frequency
    response = amplitude
    force = response * (OMEGA0**2 - omega**2 + 2j * DAMPING * OMEGA0 * omega)
    other = TIME * (1.0 + clock) + 8.0 * clock - shift_s
    return (force * np.exp(1j * omega * TIME)).real, (response * np.exp(1j * omega * other)).real


def evaluated(force: np.ndarray, response: np.ndarray):
    channels = (Channel("f1", Quantity.FORCE, 1), Channel("x1", Quantity.DISPLACEMENT, 1))
    lock = lock_event(0, TIME.size, 0, frequency_hz=math.nan)
    window = Window(lock, RATE, channels, np.array([force, response]), None, math.nan)
    return modal_point(window, LINEAR, SETTINGS)


def noisy(signal: np.ndarray, seed: int, share: float = 1e-4) -> np.ndarray:
    return signal + share * np.abs(signal).max() * np.random.default_rng(seed).standard_normal(signal.size)


def frequency_at(phase_deg: float) -> float:
    """Excitation frequency at which force leads velocity by −phase."""
    t = math.tan(math.radians(phase_deg))
    return F0 * (DAMPING * t + math.sqrt((DAMPING * t) ** 2 + 1.0))


def drive(kind: str, size: float, seed: int):
    force, response = vibration()
    top = 1e-4
    if kind == "delay":
        force, response = vibration(shift_s=size / 360.0 / F0)
    elif kind == "detuned":
        force, response = vibration(frequency_at(size))
    elif kind == "ramp":
        response = response + size * top * TIME / SECONDS
    elif kind == "warming":
        response = response + size * top * np.exp(-TIME / 1.3)
    elif kind == "wandering":
        response = response + size * top * np.sin(2.0 * math.pi * 0.3 * TIME + 0.7)
    elif kind == "step":
        response = response + size * top * (TIME > 0.83)
    elif kind == "silent":
        off = (TIME > 1.0) & (1.0 + size > TIME)
        force, response = np.where(off, 0.0, force), response
    elif kind == "drop":
        off = (TIME > 1.0) & (1.0 + size > TIME)
        response = np.where(off, 0.0, response)
    elif kind == "clock":
        force, response = vibration(clock=size * 1e-6)
    elif kind == "mean":
        force, response = force + size * force.max(), response + size * top
    elif kind == "saturated":
        response = np.clip(response, -size * top, size * top)
    elif kind == "velocity":
        response = 1j * OMEGA0 * response[0] * np.exp(1j * OMEGA0 * TIME)
        response = response.real
    elif kind == "acceleration":
        response = -(OMEGA0**2) * response
    elif kind == "sign":
        response = -response
    elif kind == "growing":
        grown = np.exp(size * TIME)
        # Force of the mode whose amplitude grows: what it stores comes on top of what it dissipates.
        x = top * np.exp((size + 1j * OMEGA0) * TIME)
        force = ((size + 1j * OMEGA0) ** 2 + 2.0 * DAMPING * OMEGA0 * (size + 1j * OMEGA0) + OMEGA0**2) * x
        force, response = force.real, top * grown * np.cos(OMEGA0 * TIME)
    elif kind == "rounded":
        response = np.round(response / (size * top)) * size * top
    return noisy(force, seed), noisy(response, seed + 1) if kind != "rounded" else response


STRANGE = [
    *(("delay", size) for size in (-90, -60, -30, -10, -4, 4, 10, 30, 60, 90)),
    *(("detuned", size) for size in (-80, -30, 30, 80)),
    *(("ramp", size) for size in (0.1, 1.0, 10.0)),
    *(("warming", size) for size in (0.3, 3.0)),
    *(("wandering", size) for size in (0.3, 3.0)),
    *(("step", size) for size in (0.1, 1.0)),
    *(("silent", size) for size in (0.05, 0.2, 0.6)),
    *(("drop", size) for size in (0.01, 0.2)),
    *(("clock", size) for size in (10, 50, 100, 200, 500)),
    ("mean", 5.0),
    *(("saturated", size) for size in (0.6, 0.9)),
    ("velocity", 0), ("acceleration", 0), ("sign", 0),
    *(("growing", size) for size in (0.05, -0.0027, -0.3)),
    *(("rounded", size) for size in (0.0057, 0.02, 0.3)),
]  # fmt: skip


def test_there_are_forty_strange_windows():
    assert len(STRANGE) >= 40


@pytest.mark.parametrize(("kind", "size"), STRANGE)
def test_no_strange_window_is_confidently_wrong(kind, size):
    point = evaluated(*drive(kind, size, 11))
    assert point.reason or point.status is PointStatus.OK
    if point.status is PointStatus.OK:
        error = abs(point.damping_ratio - DAMPING)
        assert error < max(3.0 * point.damping_ratio_std, SMALL * DAMPING)
        assert abs(point.omega_rad_s / OMEGA0 - 1.0) < max(3.0 * point.omega_rad_s_std / OMEGA0, 1e-5)
        mean = 1e-4 if kind != "growing" else 1e-4 * math.expm1(size * SECONDS) / (size * SECONDS)
        assert abs(point.modal_amplitude / mean - 1.0) < max(3.0 * point.modal_amplitude_std / 1e-4, SMALL)


def test_a_good_window_has_no_remark_and_no_impossible_uncertainty():
    point = evaluated(*vibration())
    assert (point.status, point.reason) == (PointStatus.OK, "")
    assert point.damping_ratio == pytest.approx(DAMPING, rel=1e-7)
    for name in ("damping_ratio", "modal_amplitude", "force_n", "pbmif", "mac"):
        assert getattr(point, f"{name}_std") > 1e-10 * getattr(point, name)


@pytest.mark.parametrize(
    ("kind", "size", "status", "words"),
    [
        ("delay", 10, PointStatus.OK, "10.0° apart.*response is late by 0.556 ms"),
        ("delay", -72, PointStatus.REJECTED, "force is late by 4 ms"),
        ("velocity", 0, PointStatus.REJECTED, "velocity called a displacement"),
        ("sign", 0, PointStatus.REJECTED, "scale: -1"),
        ("ramp", 1.0, PointStatus.OK, "x1 drifts"),
        ("silent", 0.2, PointStatus.REJECTED, r"off from 0\.999\d* to 1\.20\d* s"),
        ("drop", 0.01, PointStatus.OK, "departs from its periodic course between 1"),
        ("clock", 500, PointStatus.OK, "ppm apart"),
        ("growing", 0.05, PointStatus.OK, "not steady"),
    ],
)
def test_what_is_wrong_is_said(kind, size, status, words):
    force, response = drive(kind, size, 5)
    if kind == "clock":  # the clocks were set at the middle of the window
        omega = OMEGA0 * (1.0 + size * 1e-6)
        response = 1e-4 * np.cos(omega * (TIME - 1.0) + OMEGA0 * 1.0)
        force = (vibration()[0]) * 1.0
    point = evaluated(force, response)
    assert point.status is status
    assert re.search(words, point.reason), point.reason


def test_a_phase_of_the_limit_costs_what_the_documentation_says():
    """A delay of 5° lowers damping by 1 − cos 5°, 0.4 %."""
    point = evaluated(*vibration(shift_s=4.999 / 360.0 / F0))
    assert point.reason == ""
    assert point.damping_ratio / DAMPING == pytest.approx(math.cos(math.radians(5.0)), abs=1e-5)
    assert point.damping_ratio_std > 0.9 * (DAMPING - point.damping_ratio)


def test_a_polynomial_goes_and_the_harmonics_stay():
    cycles = 7.3 + F0 * TIME
    wave = np.cos(2.0 * np.pi * cycles) + 0.2 * np.sin(6.0 * np.pi * cycles)
    place = np.linspace(-1.0, 1.0, TIME.size)
    found = without_drift(cycles, (wave + 4.0 * place - 3.0 * place**3)[np.newaxis], 5, 3)[0]
    assert np.abs(found - wave).max() < 1e-9


def test_a_still_mean_is_no_drift():
    means = np.full((10, 2), [3.0, 1.0])
    means[:, 1] += np.linspace(0.0, 0.5, 10)
    assert drifting(means, np.ones(2), np.zeros(2), 4000, 100) == [1]
    assert drifting(means, np.ones(2), np.ones(2) * 10.0, 4000, 100) == []


def test_the_grid_of_values_is_seen():
    values = np.random.default_rng(1).standard_normal(5000)
    assert resolution(values) == 0.0
    assert resolution(np.round(values, 2)) == pytest.approx(0.01)
    assert resolution(np.round(values, 2) * 9.81) == pytest.approx(0.0981)
    # The same few values in every period: none is one step beside another.
    few = np.tile([0.0, 0.03, 0.05, 0.08, 0.12, -0.07], 300)
    assert resolution(few) == pytest.approx(0.01)
    assert resolution(np.tile([0.0, 0.0312, 0.0507, 0.0893, 0.1211, -0.0749], 300) * math.pi) < 1e-3


def test_a_beat_is_not_silence():
    assert silent_stretch(vibration()[0] * (1.2 + np.cos(2.0 * np.pi * TIME)), RATE / F0) is None
    assert silent_stretch(np.where(TIME < 0.5, 0.0, vibration()[0]), RATE / F0) == pytest.approx((0, 1000), abs=45)
