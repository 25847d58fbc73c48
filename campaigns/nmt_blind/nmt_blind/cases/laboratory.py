"""Tests of a simulated rig in a session of this process: the bench's own run, loop and bag, at a finer mesh and step.

What is recorded says nothing of the truth: the bag's rig file, plan and linear description are those of the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmt_blind.cases.laboratory_rig import Converters, LaboratoryRig
from nmt_blind.cases.rig_edits import rig_yaml
from nmt_core.bench_version import bench_version
from nmt_core.errors import BenchError
from nmt_core.kinds import RandomTest
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import ResultCode
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.model.time_integration import IntegrationError
from nmt_rig.rig import BeamSection, Rig
from nmt_session import RunResult, Session, TestPlan
from nmt_session.planning import kind_of_rig
from nmt_session.session import Listener

# The oscillator runs through the random numbers of a seed: each test has one of its own.
_RANDOM_SEED = 0x5245
# Chunks by number of messages alone: the same truth gives the same file.
_CHUNKS = {"chunk_messages": 2000, "flush_interval": 1e9}


@dataclass(frozen=True)
class BenchSettings:
    """How the tests of a blind rig are made.

    Attributes:
        levels: drive amplitudes of the backbone test, V.
        window_periods: whole periods of each window.
        ramp: between levels, s.
        random_level: rms of the random drive, V.
        band_hz: band of the random drive.
        duration: window of the random test, s.
        settling_time: before that window, s.
        mesh_refinement: elements per point spacing of a beam, in the truth.
        substeps: steps of the time integration per sample, in the truth.
    """

    levels: tuple[float, ...]
    window_periods: int
    ramp: float
    random_level: float
    band_hz: tuple[float, float]
    duration: float
    settling_time: float
    mesh_refinement: int = 3
    substeps: int = 4


@dataclass(frozen=True)
class RecordingOutcome:
    """How a test went.

    Attributes:
        locked: levels whose window was recorded.
        levels: levels of the plan.
        bench_seconds: bench time, s.
        trouble: why it ended early; empty if it did not.
    """

    locked: int
    levels: int
    bench_seconds: float
    trouble: str = ""


def as_built(truth: Rig, bench: BenchSettings, seed: int) -> Rig:
    """The rig as the laboratory has it: finer mesh and step, noise of its own seed."""
    changes: dict[str, Any] = {"substeps": bench.substeps, "seed": seed}
    if isinstance(truth.structure, BeamSection):
        changes["structure"] = truth.structure.model_copy(update={"mesh_refinement": bench.mesh_refinement})
    return truth.model_copy(update=changes)


@dataclass(frozen=True)
class PlannedTest:
    """A test ready to be made.

    Attributes:
        plan: the test as the model has it.
        loop_values: parameters of the loop as the truth has them; the bag does not name them.
    """

    plan: TestPlan
    loop_values: Mapping[str, Any]


def backbone_test(truth: Rig, model: Rig, bench: BenchSettings, bag: Path | None = None) -> PlannedTest:
    """Phase resonance at every level, with real lock transients.

    Args:
        truth: the rig with what it really has; the loop's own settings are among that.
        model: the rig as it is believed to be: plan and description come from it.
        bench: settings of the test.
        bag: folder of the bag to create.

    Raises:
        BenchError: a setting is refused.
    """
    plan = TestPlan.of(
        rig=model,
        rig_yaml=rig_yaml(model),
        levels=bench.levels,
        kind=kind_of_rig("phase_resonance", model, {}),
        run_id="run",
        window_periods=bench.window_periods,
        ramp=bench.ramp,
        node_values=_recorder(bag),
    )
    return PlannedTest(plan, truth.pll)


def random_test(model: Rig, bench: BenchSettings, bag: Path | None = None) -> PlannedTest:
    """One window of random excitation at low level; arguments as for `backbone_test`."""
    plan = TestPlan.of(
        rig=model,
        rig_yaml=rig_yaml(model),
        levels=(bench.random_level,),
        run_id="run",
        ramp=bench.ramp,
        node_values={**_recorder(bag), "pll": {"settling_time": bench.settling_time}},
        kind=RandomTest.spelled(band_hz=bench.band_hz, duration=bench.duration),
    )
    return PlannedTest(plan, {})


def record_backbone(
    bag: Path, truth: Rig, model: Rig, bench: BenchSettings, seed: int, converters: Converters | None = None
) -> RecordingOutcome:
    """Make the backbone test and write it into a bag.

    Args:
        bag: folder to create.
        truth: the rig with what it really has.
        model: the rig as it is believed to be.
        bench: settings of the test.
        seed: of noise and random numbers.
        converters: of a laboratory; the bag says then that its data come from elsewhere.
            None = the bench's own simulator.

    Raises:
        BenchError: a setting is refused or the bag cannot be written.
    """
    return _record(as_built(truth, bench, seed), backbone_test(truth, model, bench, bag), converters)


def record_random(
    bag: Path, truth: Rig, model: Rig, bench: BenchSettings, seed: int, converters: Converters | None = None
) -> RecordingOutcome:
    """Make the random test and write it into a bag; arguments as for `record_backbone`."""
    return _record(as_built(truth, bench, seed ^ _RANDOM_SEED), random_test(model, bench, bag), converters)


def play(built: Rig, test: PlannedTest, listener: Listener) -> RunResult:
    """Make a test without a bag.

    Args:
        built: the rig as it stands in the laboratory.
        test: the test.
        listener: told of every message.

    Raises:
        TrialError: the motion is not finite any more.
    """
    session = Session(
        test.plan,
        device=SimulatedRig(built),
        loop_values=test.loop_values,
        record=False,
        extract=False,
        listener=listener,
    )
    try:
        with session:
            result = session.run()
    except IntegrationError as error:
        # A rig that leaves its rest by itself is found out before the first block.
        raise TrialError(str(error)) from error
    if result.code == ResultCode.NODE_LOST:
        raise TrialError(result.message)
    return result


class TrialError(ArithmeticError):
    """A test that cannot be made on this truth."""


def sidecar_of(model: Rig) -> dict[str, Any]:
    """The sidecar of a recording that a laboratory made of a rig: its channels, without calibration sheets."""
    return {
        "rig": model.name,
        "file": "recording",
        "sample_rate": model.sample_rate_hz,
        "channels": [
            {
                "column": model.sensor_channel(sensor),
                "name": model.sensor_channel(sensor),
                "quantity": sensor.quantity,
                "unit": Quantity[sensor.quantity.upper()].unit,
                "point": model.sensor_point(sensor),
            }
            for sensor in model.sensors
        ],
    }


def _recorder(bag: Path | None) -> dict[str, dict[str, Any]]:
    return {} if bag is None else {"recorder": {"output": str(bag), **_CHUNKS}}


def _record(built: Rig, test: PlannedTest, converters: Converters | None) -> RecordingOutcome:
    plan = test.plan
    device = SimulatedRig(built) if converters is None else LaboratoryRig(built, converters)
    try:
        session = Session(plan, device=device, loop_values=test.loop_values)
        # Nothing in the run's description depends on the truth, on the clock or on where the files are.
        described = {key: session.plan.run[key] for key in _DESCRIBED} | {"versions": {"nmt": bench_version()}}
        if converters is not None:
            described["imported"] = {"sidecar": sidecar_of(plan.rig), "files": [], "notes": []}
        session.describe(described)
        with session:
            result = session.run()
    except BenchError as error:
        return RecordingOutcome(0, len(plan.asked.levels), 0.0, str(error))
    trouble = "" if result.code == ResultCode.SUCCEEDED else result.message
    return RecordingOutcome(session.levels_locked, len(plan.asked.levels), result.bench_time, trouble)


_DESCRIBED = ("run_id", "rig", "seed", "plan", "exciter_point", "linear", "extraction")
