"""Compiles the numerical kernels into their cache, so that no first run has to wait (``-m nmt_bench.warm_up``).

The packages' byte code is written with them: every node is a process of its own.
"""

from __future__ import annotations

import compileall
from pathlib import Path

from nmt_diagnose.twin.warm_up import warm_up_twin
from nmt_extract.offline import extract_bag
from nmt_plant.benchmark import contact_speed
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_pll.paper_loop import PaperLoop
from nmt_pll.paper_settings import PaperSettings
from nmt_rig.linear_description import linear_description
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
    contact_speed(2, 1, 0.02)
    further = SimulatedRig(load_rig("beam", ["exciter.force_factor_linear_per_m=1.0", "sensors.0.delay_s=1e-5"]))
    further.configure()
    further.start()
    further.read()
    further.close()
    warm_up_twin(rig)


if __name__ == "__main__":
    write_byte_code()
    warm_up()
