"""The figures of ``./nmt benchmark``: what is measured, and the limit or peer for comparison."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_session import Session, plan_test

LIMIT_KERNEL = 200.0
LIMIT_EXTRACTION = 0.7
_LEVELS = (0.2, 0.5, 1.0)
_SHORT = "block_samples=200"  # 20 ms
_BEST_OF = 3
_REAL_TIME = 5.0  # s
_MANY = 1000
_READ_LEVELS = (50, 200)
_ELEMENTS = 196
LIMIT_BACKBONE = 0.5
LIMIT_RESPONSE = 2.0
LIMIT_DIAGNOSIS = 12.0
LIMIT_AMPLITUDES = 2.0
LIMIT_REPORT = 5.0
LIMIT_PAGE = 3.0
LIMIT_MANY_LEVELS = 0.7
LIMIT_GROWTH = 4.5
LIMIT_OPENING = 50.0
LIMIT_CONTACTS = 1.0
LIMIT_CHANNELS = 10.0
_CONTACTS = 12
# A beam whose joint slips earlier than its model says, with a sensor that shows too much and noise as in the paper.
_MEASURED = (
    "local_elements.0.slip_force_n=0.9",
    "sensors.3.gain=1.05",
    "sensors.0.noise_psd=2e-9",
    "sensors.0.noise_correlation_time_s=1e-5",
    *(f"sensors.{k}.{key}" for k in range(1, 5) for key in ("noise_psd=4.5e-16", "noise_correlation_time_s=1e-5")),
)
_SHORT_BLOCKS = 80.0  # × real time that blocks of 20 ms are to allow
_RAMP_LEVELS = 16
_RAMP_PERIODS = 28
RAMP_ERRORS = (1e-3, 0.03)
"""Largest errors of frequency and damping ratio of a level that counts."""
AT_LEAST = "limit, at least"
AT_MOST = "limit, at most"


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    Attributes:
        name: what was measured.
        value: in ``unit``; None = could not be measured, ``note`` says why.
        unit: of ``value`` and ``compared``.
        compared: the limit or what the peer reached; None = neither.
        note: what ``compared`` is.
        met: whether a limit is met; None where ``compared`` is not a limit.
    """

    name: str
    value: float | None
    unit: str
    compared: float | None
    note: str
    met: bool | None = None

    @classmethod
    def limited(cls, name: str, value: float, unit: str, limit: float, note: str = AT_LEAST) -> Figure:
        """A figure against its limit; ``note`` is `AT_LEAST` or `AT_MOST`."""
        return cls(name, value, unit, limit, note, value >= limit if note == AT_LEAST else value <= limit)


def plant_figures(seconds: float) -> list[Figure]:
    """Time integration of the beam against its limit and scipy's solve_ivp; friction at many places; many channels."""
    from nmt_benchmark.plant_speed import channel_speed, contact_speed, owned_output_cost, run_benchmark
    from nmt_rig.rig import load_rig

    rig = load_rig("beam")
    run_benchmark(rig, 0.2, 0.01)  # compiles or loads the kernel
    result = run_benchmark(rig, seconds)
    kernel = result.kernel
    owned = owned_output_cost(rig, min(seconds, _REAL_TIME))
    channels, more_channels = channel_speed(32), channel_speed(12) / channel_speed(48)
    several = [
        Figure.limited(
            f"plant: {_CONTACTS} joints along a beam, all slip", contact_speed(_CONTACTS), "× real time", LIMIT_CONTACTS
        ),
        Figure.limited(
            "plant: whole device, 49 elements, 32 channels, 51.2 kHz", channels, "× real time", LIMIT_CHANNELS
        ),
        Figure.limited("plant: growth over four times the channels", more_channels, "×", LIMIT_GROWTH, AT_MOST),
    ]
    return [
        Figure.limited("plant: time integration", kernel, "× real time", LIMIT_KERNEL),
        Figure("plant: time integration", kernel, "× real time", result.peer, "scipy solve_ivp, same equations"),
        Figure("plant: whole device", result.device, "× real time", None, "with oscillator, sensors and safety"),
        Figure("plant: real time, output of its own process", 100.0 * owned.device, "% of a core", None, "the device"),
        Figure(
            "plant: the process that owns the output", 100.0 * owned.owner, "% of a core", None, "250 looks a second"
        ),
        Figure("plant: block later than put out", 1e3 * owned.late, "ms, worst", None, "of 20 ms a block"),
        *several,
    ]


def reference_figures(_: float) -> list[Figure]:
    """Harmonic balance of the beam: EPMC backbone and a forced response against their limits."""
    from nmt_rig.model.forced_response import ForcedProblem, frequency_response
    from nmt_rig.model.fourier_basis import FourierBasis
    from nmt_rig.reference import compute_reference, default_amplitudes
    from nmt_rig.rig import load_rig
    from nmt_rig.rig_model import build_system

    rig = load_rig("beam")
    coarse, fine = (
        load_rig("beam", [f"structure.elements={count}", "structure.mesh_refinement=1"])
        for count in (_ELEMENTS // 4, _ELEMENTS)
    )
    amplitudes = np.geomspace(1e-5, 2e-2, 100)
    problem = ForcedProblem(build_system(rig), FourierBasis.up_to(7), 139.4)

    def sweep() -> int:
        return len(frequency_response(problem, 0.5, 110.0, 150.0, held="force").responses)

    compute_reference(rig, 7, amplitudes)  # compiles or loads the kernels
    points = sweep()
    backbone = _best(lambda: compute_reference(rig, 7, amplitudes))
    response = _best(sweep)
    default_amplitudes(rig)
    search = _best(lambda: default_amplitudes(fine), 1)
    growth = search / _best(lambda: default_amplitudes(coarse))
    return [
        Figure.limited(
            f"reference: search of the amplitudes, {_ELEMENTS} elements", search, "s", LIMIT_AMPLITUDES, AT_MOST
        ),
        Figure.limited(
            "reference: growth of that search over four times the elements", growth, "×", LIMIT_GROWTH, AT_MOST
        ),
        Figure.limited("reference: 100 backbone points, 7 harmonics", backbone, "s", LIMIT_BACKBONE, AT_MOST),
        Figure.limited(f"reference: force-held response, {points} points", response, "s", LIMIT_RESPONSE, AT_MOST),
    ]


def bag_figures(seconds: float) -> list[Figure]:
    """Work per block without ROS; reading and extracting a bag against a bare rosbags read."""
    from rosbags.highlevel import AnyReader

    from nmt_extract.offline import extract_opened_bag
    from nmt_record.bag.bag_reader import Bag
    from nmt_rig.rig import load_rig

    rig = load_rig("beam", [_SHORT])
    with tempfile.TemporaryDirectory(prefix="nmt-benchmark-") as folder:
        with Session(plan_test(rig, [0.3], window_periods=5), extract=False) as session:
            session.run()  # compiles or loads the kernels
        plan = plan_test(rig, _LEVELS, window_periods=window_periods(seconds))
        with Session(plan, Path(folder), extract=False, timed=True) as session:
            session.run()
        bag = Bag.open(Path(folder) / "bag")
        result = extract_opened_bag(bag)  # compiles or loads the kernels
        topics = [*result.settings.topics, "lock", "frequency"]
        messages = sum(bag.topics.get(topic, ("", 0))[1] for topic in topics)
        with AnyReader([Path(folder) / "bag"]) as reader:
            bare = messages / _best(lambda: _read_bare(reader, topics))
        ours = messages / _best(lambda: sum(1 for _ in bag.messages(topics)))
        extraction = messages / _best(lambda: extract_opened_bag(bag))
        writing = _copy_time(bag, Path(folder) / "copy") / sum(count for _, count in bag.topics.values())
        sizes = [_bag_size(load_rig("beam", [_SHORT, *more])) for more in ((), ("recording.sample_bits=24",))]
    block_us = 1e6 * rig.block_samples / rig.sample_rate_hz
    plant_us = 1e6 * session.spent["plant"] / session.blocks
    loop_us = 1e6 * session.spent["loop"] / session.blocks
    budget = block_us / _SHORT_BLOCKS
    share = f"a block of {block_us / 1000:.0f} ms at {_SHORT_BLOCKS:.0f} × real time"
    without_ros, ratio = block_us / (plant_us + loop_us), extraction / bare
    rosbags, real_time = "bare rosbags read, same messages", "× real time"
    return [
        Figure("plant: process time a block", plant_us, "µs", budget, share),
        Figure("loop: process time a block", loop_us, "µs", budget, share),
        Figure("plant and loop without ROS", without_ros, real_time, None, "one core allows no more"),
        Figure("recorder: process time a message", 1e6 * writing, "µs", None, "serialised message to bag"),
        Figure("extraction: process time a message", 1e6 / extraction, "µs", None, "bag to modal points"),
        Figure("bag: size, 24 bits a sample", sizes[1], "MB a minute", sizes[0], "all 53 bits, same run"),
        Figure("bag: read", ours, "messages/s", bare, rosbags),
        Figure("bag: extraction", extraction, "messages/s", bare, rosbags),
        Figure.limited("bag: extraction over bare read", ratio, "×", LIMIT_EXTRACTION),
    ]


def _bag_size(rig: Any) -> float:
    """Size of the bag of a run, MB for a minute of bench time."""
    with tempfile.TemporaryDirectory(prefix="nmt-benchmark-") as folder:
        with Session(plan_test(rig, list(_LEVELS), window_periods=100), Path(folder), extract=False) as session:
            session.run()
        seconds = float(session.blocks * rig.block_samples / rig.sample_rate_hz)
        return sum(file.stat().st_size for file in Path(folder, "bag").iterdir()) / 1e6 / seconds * 60.0


def level_figures(_: float) -> list[Figure]:
    """Very many levels: the report and its growth, and extraction against a bare rosbags read."""
    from nmt_extract.offline import extract_opened_bag
    from nmt_record.bag.bag_reader import Bag
    from nmt_report.run_report import report_data_from_bag, report_html
    from nmt_rig.rig import load_rig

    reports, pages = {}, {}
    with tempfile.TemporaryDirectory(prefix="nmt-benchmark-") as folder:
        for count in (_MANY // 4, _MANY):
            bag = _recorded(Path(folder) / str(count), load_rig("joint_resonator"), np.geomspace(0.3, 0.5, count), 50)
            points = extract_opened_bag(bag).points

            def page(bag: Bag = bag, points: Any = points, count: int = count) -> None:
                pages[count] = len(report_html(report_data_from_bag(bag, points)).encode()) / 1e6

            page()  # loads fonts and libraries
            reports[count] = _best(page, 1)
        opening = 1e3 * _best(lambda: Bag.open(bag.path))
    growth = reports[_MANY] / reports[_MANY // 4]
    figures = [
        Figure.limited(f"report of {_MANY} levels", reports[_MANY], "s", LIMIT_REPORT, AT_MOST),
        Figure.limited(f"report of {_MANY} levels: page", pages[_MANY], "MB", LIMIT_PAGE, AT_MOST),
        Figure.limited("report: growth over four times the levels", growth, "×", LIMIT_GROWTH, AT_MOST),
        Figure.limited("bag: opening", opening, "ms", LIMIT_OPENING, AT_MOST),
    ]
    for count in _READ_LEVELS:
        with tempfile.TemporaryDirectory(prefix="nmt-benchmark-") as folder:
            bag = _recorded(Path(folder), load_rig("beam", [_SHORT]), np.geomspace(0.3, 0.9, count), 20)
            ratio = _over_bare_read(bag)
        name = f"bag: extraction over bare read, {count} levels"
        figures.append(Figure.limited(name, ratio, "×", LIMIT_MANY_LEVELS))
    return figures


def _recorded(folder: Path, rig: Any, levels: Any, periods: int) -> Any:
    """A run recorded without live extraction, opened."""
    from nmt_record.bag.bag_reader import Bag

    with Session(plan_test(rig, list(levels), window_periods=periods), folder, extract=False) as session:
        session.run()
    return Bag.open(folder / "bag")


def _over_bare_read(bag: Any) -> float:
    """Time of a bare rosbags read of the same messages over that of an extraction."""
    from rosbags.highlevel import AnyReader

    from nmt_extract.offline import extract_opened_bag

    topics = [*extract_opened_bag(bag).settings.topics, "lock", "frequency"]
    with AnyReader([bag.path]) as reader:
        bare = _best(lambda: _read_bare(reader, topics))
    return bare / _best(lambda: extract_opened_bag(bag))


def ramp_figures(_: float) -> list[Figure]:
    """Levels that the strategy ``ramp`` measures as well as is asked for at their own amplitude, of all."""
    from nmt_rig.reference import single_point_reference

    test = plan_test(
        "beam", np.geomspace(0.1, 1.0, _RAMP_LEVELS).tolist(), strategy="ramp", window_periods=_RAMP_PERIODS
    )
    with Session(test, record=False) as session:
        points = session.run().points
    expected = single_point_reference(test.rig, None, np.geomspace(0.08, 1.1, 161).tolist()).mode
    q = [point.modal_amplitude for point in points]
    frequency = np.interp(q, expected.modal_amplitude, expected.omega_rad_s)
    damping = np.interp(q, expected.modal_amplitude, expected.damping_ratio)
    good = sum(
        abs(point.omega_rad_s / frequency[k] - 1.0) <= RAMP_ERRORS[0]
        and abs(point.damping_ratio / damping[k] - 1.0) <= RAMP_ERRORS[1]
        for k, point in enumerate(points)
    )
    name = f"ramp: levels within 0.1 and 3 % at their own amplitude, {_RAMP_PERIODS} periods each"
    return [Figure.limited(name, float(good), "levels", float(_RAMP_LEVELS))]


def diagnosis_figures(_: float) -> list[Figure]:
    """A whole diagnosis against its limit; its sensitivities against new solutions for each parameter."""
    from nmt_diagnose.diagnose import diagnose_bags
    from nmt_diagnose.diagnosis_settings import DiagnosisSettings
    from nmt_diagnose.effects.calibration import calibration_parameters
    from nmt_diagnose.effects.parametrisation import Parametrisation
    from nmt_diagnose.observations.read_observations import read_observations
    from nmt_diagnose.prediction.forward import Forward
    from nmt_rig.rig import load_rig

    model = load_rig("beam")
    real = load_rig("beam", _MEASURED)
    jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with tempfile.TemporaryDirectory(prefix="nmt-benchmark-") as folder:
        plans = {
            "levels": plan_test(real, "0.05:1.5:12", window_periods=40),
            "random": plan_test(real, [0.05], test="random", band_hz=(5.0, 1000.0), duration=60.0),
        }
        for name, plan in plans.items():
            with Session(plan, Path(folder) / name, extract=False) as session:
                session.run()
        bags = [Path(folder) / name for name in plans]
        begin = time.perf_counter()
        diagnose_bags(model, bags, settings=DiagnosisSettings(jobs=jobs))
        whole = time.perf_counter() - begin
        observations = read_observations(bags, model)
    forward = Forward(observations.tests, observations.rows)
    parametrisation = Parametrisation(model, calibration_parameters(model))
    theta = parametrisation.zero
    start = forward.predict(model)

    def solved() -> None:
        for column in range(theta.size):
            moved = theta.copy()
            moved[column] = 1e-3
            forward.predict(parametrisation.rig(moved), start)

    forward.jacobian(parametrisation, theta, start)  # compiles or loads the kernels
    together = _best(lambda: forward.jacobian(parametrisation, theta, start))
    return [
        Figure.limited(f"diagnosis: levels and a random test, {jobs} processes", whole, "s", LIMIT_DIAGNOSIS, AT_MOST),
        Figure(
            f"diagnosis: sensitivities to {theta.size} parameters",
            1e3 * together,
            "ms",
            1e3 * _best(solved),
            "a new solution for each parameter",
        ),
    ]


def window_periods(seconds: float) -> int:
    """Window that makes a run over all levels last about ``seconds`` (20 Hz, 1.5 s to lock)."""
    return max(5, round(20.0 * (seconds / len(_LEVELS) - 1.5)))


def _read_bare(reader: Any, topics: list[str]) -> None:
    """Deserialise messages as the rosbags documentation shows it."""
    chosen = [connection for connection in reader.connections if connection.topic.lstrip("/") in topics]
    for connection, _, raw in reader.messages(chosen):
        reader.deserialize(raw, connection.msgtype)


def _copy_time(bag: Any, destination: Path) -> float:
    """Process time of the recorder's writer for all messages of a bag, s."""
    from nmt_record.bag.bag_writer import BagWriter
    from nmt_record.bag.bench_topics import BENCH_TOPICS

    messages = list(bag.raw_messages())
    writer = BagWriter(destination, records=False)
    for topic in BENCH_TOPICS:
        writer.add_topic(topic.name, topic.message_type, topic.service)
    begin = time.process_time()
    for topic, received, published, raw in messages:
        writer.write(topic, raw, received, published)
    writer.close()
    return time.process_time() - begin


def _best(action: Any, best_of: int = _BEST_OF) -> float:
    """Shortest of a few process times of an action, s; wall times would depend on other programs."""
    times = []
    for _ in range(best_of):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return min(times)
