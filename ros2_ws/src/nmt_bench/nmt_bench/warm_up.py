"""Compiles the numerical kernels into their cache, so that no first run has to wait (``-m nmt_bench.warm_up PART``).

Part ``test`` is what a first test needs, and the packages' byte code: every node is a process of its own. Part
``reference`` is what its report compares with. Parts ``responses`` and ``records`` are everything else, the kernels of
a diagnosis first; without a part all are compiled.
"""

from __future__ import annotations

import compileall
import os
import sys
from collections.abc import Callable
from pathlib import Path

from nmt_extract.offline import extract_bag
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.linear_description import linear_description
from nmt_rig.reference import compute_reference, single_point_reference
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test

SOURCES = Path(__file__).resolve().parents[2]


def write_byte_code(sources: Path = SOURCES) -> None:
    """Compile the modules of all packages to byte code, also where Python is set to write none.

    Without it each process of a bench would compile what it imports, at every start. A module that is edited later is
    compiled as it is imported.

    Args:
        sources: the folder of the packages; a module that does not compile is left out.
    """
    for package in sorted(sources.glob("*/*/__init__.py")):
        compileall.compile_dir(package.parent, quiet=2)


def _measure() -> None:
    """Plant, loop and extraction."""
    with Session(plan_test(load_rig("beam"), [0.6], window_periods=6)) as session:
        session.run()
        extract_bag(session.out / "bag")


def _reference() -> None:
    """Nonlinear modes by harmonic balance."""
    compute_reference(load_rig("beam"), harmonics=3, points=5)


def _single_point_reference() -> None:
    single_point_reference(load_rig("beam"), levels=[0.1, 0.6], harmonics=3)


def _paper_loop() -> None:
    from nmt_pll.phase_loop.paper_loop import PaperLoop
    from nmt_pll.phase_loop.paper_settings import PaperSettings

    rig = load_rig("beam")
    PaperLoop(linear_description(rig), PaperSettings(), rig.sample_rate_hz, rig.block_samples)


def _other_plants() -> None:
    """Slow channels have a filter, and the loop of a plant is compiled for each number of exciters."""
    slow = load_rig("beam", ["exciter.force_factor_linear_per_m=1.0", "sensors.0.delay_s=1e-5"])
    for rig in (slow, load_rig("frame")):
        device = SimulatedRig(rig)
        device.configure()
        device.start()
        device.read()
        device.close()


def _predicted_responses() -> None:
    from nmt_diagnose.prediction.warm_up import warm_up_predictions

    warm_up_predictions(load_rig("beam"), records=False)


def _predicted_records() -> None:
    from nmt_diagnose.prediction.warm_up import warm_up_predictions

    warm_up_predictions(load_rig("beam"), records=True)


PARTS: dict[str, tuple[Callable[[], None], ...]] = {
    "test": (write_byte_code, _measure),
    "reference": (_reference,),
    "responses": (_predicted_responses, _single_point_reference, _paper_loop),
    "records": (_predicted_records, _other_plants),
}
BACKGROUND = ("responses", "records")
NICENESS = 10
"""Of the background: a run next to it has nine tenths of the processor."""


def warm_up(*parts: str) -> None:
    """Use every kernel of some parts once, and print how many steps are done.

    Args:
        parts: of ``PARTS``; all where none is named.
    """
    steps = [step for part in parts or PARTS for step in PARTS[part]]
    for number, step in enumerate(steps, 1):
        print(f"{number} of {len(steps)}", flush=True)
        step()


if __name__ == "__main__":
    if set(sys.argv[1:]) & set(BACKGROUND):
        os.nice(NICENESS)
    warm_up(*sys.argv[1:])
