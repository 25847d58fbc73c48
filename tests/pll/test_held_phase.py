"""Phase offset and latency: both loops rest where force leads velocity by φ₀ + ω τ."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from pll.closed_loop import ClosedLoop
from pll.plant_in_the_loop import LoopOnRig

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.paper_settings import PaperSettings
from nmt_rig.rig_model import build_system

CASES = [(0.1, 0.0), (-0.08, 0.0), (0.0, 6e-4), (0.05, -4e-4)]


def measured_lead(loop: ClosedLoop, blocks: int = 100) -> tuple[float, float]:
    """arg F - arg v from the samples of the next blocks (least squares), and the mean ω."""
    force, response, cycles, omegas = [], [], [], []
    for _ in range(blocks):
        loop.step()
        f, x = loop.blocks[Quantity.FORCE], loop.blocks[Quantity.DISPLACEMENT]
        force.append(f.data[0])
        response.append(x.data[0])
        cycles.append(f.oscillator.cycles + f.oscillator.frequency_hz * np.arange(f.samples) / f.sample_rate)
        omegas.append(2 * math.pi * f.oscillator.frequency_hz)
    theta = 2 * math.pi * np.concatenate(cycles)
    basis = np.column_stack([fn(n * theta) for n in range(1, 6) for fn in (np.cos, np.sin)])
    c = np.linalg.lstsq(basis, np.column_stack([np.concatenate(force), np.concatenate(response)]), rcond=None)[0]
    f1, x1 = c[0] - 1j * c[1]
    return cmath.phase(f1 / (1j * x1)), float(np.mean(omegas))


@pytest.mark.parametrize(("offset", "latency"), CASES)
def test_adaptive_loop_holds_the_phase_it_is_told(offset, latency):
    loop = ClosedLoop(settings=LoopSettings(phase_offset_rad=offset, loop_latency_s=latency))
    outcome = loop.run_level(0.05)
    assert outcome.lock is not None, outcome.reason
    lead, omega = measured_lead(loop)
    assert lead == pytest.approx(offset + omega * latency, abs=2e-4)
    # The loop takes what it holds for phase resonance.
    assert abs(outcome.lock.phase_error) < 4e-3


def test_where_the_linear_rig_has_that_phase():
    """All friction sticks at 0.02 V: the locked frequency solves arg F(ω) - arg iωx(ω) = φ₀ of the assembled system."""
    loop = ClosedLoop(settings=LoopSettings(phase_offset_rad=0.1))
    assert loop.run_level(0.02).lock is not None
    _, omega = measured_lead(loop)
    system = build_system(loop.device.rig)
    q, force = system.response(omega)
    assert cmath.phase(force / (1j * q[system.points[2]])) == pytest.approx(0.1, abs=5e-4)
    aligned = ClosedLoop()
    assert aligned.run_level(0.02).lock is not None
    assert abs(measured_lead(aligned)[1] / omega - 1) > 1e-4


@pytest.mark.parametrize(("offset", "latency"), [(0.1, 0.0), (0.0, -6e-4)])
def test_paper_loop_holds_the_phase_it_is_told(offset, latency):
    loop = LoopOnRig(phase_offset_rad=offset, loop_latency_s=latency)
    history = loop.hold(0.05, 12.0)
    omega = history.omega[-40:].mean()
    # measured_phase is that of force against displacement, a quarter turn more.
    lead = math.radians(loop.measured_phase()) - 0.5 * math.pi
    assert lead == pytest.approx(offset + omega * latency, abs=3e-3)
    assert abs(history.phase_error[-40:].mean()) < 3e-3


def test_the_paper_loop_takes_both_settings_from_the_shared_parameters():
    settings = PaperSettings().combined_with(LoopSettings(phase_offset_rad=-0.2, loop_latency_s=1e-3))
    assert settings.held_lead(100.0) == pytest.approx(-0.1)
    with pytest.raises(BenchError, match="'loop_latency_s' of the paper's loop must be finite"):
        PaperSettings(loop_latency_s=math.inf)
