"""Compiles the numerical kernels into their cache, so that no first run has to wait (``-m nmt_bench.warm_up``).

The packages' byte code is written with them: every node is a process of its own.
"""

from __future__ import annotations

import compileall
from pathlib import Path

import numpy as np

from nmt_diagnose.prediction.warm_up import warm_up_predictions
from nmt_extract.offline import extract_bag
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_pll.phase_loop.paper_loop import PaperLoop
from nmt_pll.phase_loop.paper_settings import PaperSettings
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import assemble, displacement_output
from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.reference import compute_reference, single_point_reference
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test

SOURCES = Path(__file__).resolve().parents[2]


def write_byte_code(sources: Path = SOURCES) -> None:
    """Compile the modules of all packages to byte code, also where Python is told to write none.

    Without it each process of a bench would compile what it imports, at every start. A module that is edited later is
    compiled as it is imported.

    Args:
        sources: the folder of the packages; a module that does not compile is left out.
    """
    for package in sorted(sources.glob("*/*/__init__.py")):
        compileall.compile_dir(package.parent, quiet=2)


def warm_up() -> None:
    """Use every kernel once: plant, loop, extraction, harmonic balance, the diagnosis' model."""
    rig = load_rig("beam")
    with Session(plan_test(rig, [0.6], window_periods=6)) as session:
        session.run()
        extract_bag(session.out / "bag")
    compute_reference(rig, harmonics=3, points=5)
    single_point_reference(rig, levels=[0.1, 0.6], harmonics=3)
    PaperLoop(linear_description(rig), PaperSettings(), rig.sample_rate_hz, rig.block_samples)
    # Forces of two arguments have a time loop of their own, as have joints at several places; slow channels a filter.
    _slide_at_two_places()
    slow = load_rig("beam", ["exciter.force_factor_linear_per_m=1.0", "sensors.0.delay_s=1e-5"])
    for other in (slow, load_rig("frame")):  # the loop is compiled for each number of exciters
        device = SimulatedRig(other)
        device.configure()
        device.start()
        device.read()
        device.close()
    warm_up_predictions(rig)


def _slide_at_two_places() -> None:
    """A block of a beam's motion with two sliders to the ground."""
    beam = euler_bernoulli_beam(0.7, 0.00527668, 0.01156978, 185e9, 7830.0, 50, 1e-4)
    sliders = [Jenkins(beam.selector(point), 4000.0, limit) for point, limit in ((2, 0.25), (50, 25.0))]
    system = assemble(beam, sliders, 14)
    integrator = TimeIntegrator(system, 10_000.0, [displacement_output(system, 50)])
    integrator.advance(2.0 * np.sin(2 * np.pi * 20.0 * np.arange(201) / 10_000.0))


if __name__ == "__main__":
    write_byte_code()
    warm_up()
