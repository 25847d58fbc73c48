"""Bodies that are not as in the file are named before any joint, by torques of Lagrange's equations."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tiers import with_quick

from nmt_laboratories import body_cases
from nmt_laboratories.body_cases import GRAVITY, Body, Case, Truth, chain, make_case, tally, torque_of, urdf_of

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.bodies import body_finding as module
from nmt_robots.bodies.body_choice import EVERY, BodyExplanation
from nmt_robots.bodies.body_finding import BodyFinding, body_finding
from nmt_robots.bodies.body_shape import SHAPE, BodyShapes, moved_body
from nmt_robots.log.joint_log import JointLog
from nmt_robots.model.links import LinkMotion, in_frame_of, parameters_of, split_parameters
from nmt_robots.model.robot_model import BodyChange, RobotModel
from nmt_robots.report.robot_files import write_robot_diagnosis
from nmt_robots.verdict.robot_diagnosis import diagnose_robot

pytestmark = pytest.mark.usefixtures("module_undrawn")


def finding_of(case: Case, path: Path) -> BodyFinding:
    """What the bodies of a case are found to be."""
    path.write_text(case.urdf)
    model = RobotModel(path)
    names = tuple(str(name) for name in case.columns["names"])
    torque = case.columns["torque"]
    log = JointLog("sealed", names, case.columns["time"], case.columns["position"], torque=torque)
    found = body_finding(model, log, torque, model.chosen(names))
    assert found is not None
    return found


def test_columns_of_links_make_the_torque_of_lagrange(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    bodies = chain("arm7", rng)
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_of(bodies, np.zeros(7), np.zeros(7)))
    q, v, a = rng.standard_normal((3, 20, 7))
    moment = 1e-4
    before, after = q - moment * v + 0.5 * moment**2 * a, q + moment * v + 0.5 * moment**2 * a
    expected = torque_of(bodies, q, before, after, moment, GRAVITY)
    model = RobotModel(path)
    motion = LinkMotion(model, model.names, q, v, a)
    torque = np.zeros_like(q)
    for (joint, link), columns in motion.columns(GRAVITY).items():
        torque[:, joint] += columns @ motion.links[link].parameters
    assert torque == pytest.approx(expected, abs=1e-5 * np.max(np.abs(expected)))
    assert torque == pytest.approx(model.torque(model.names, q, v, a), abs=1e-9)


@pytest.mark.parametrize(
    ("lost", "kept"),
    [
        ({(0, 1, 2): 0.0}, (0, 1, 2)),
        ({(0, 1, 2): 0.5, (0, 1): 0.2, (1,): 0.0}, (1,)),
        ({(0, 1, 2): 0.5, (0, 1): 0.5}, None),
        ({(0, 1, 2): 0.5, (0, 1): 0.2, (0,): 0.1}, None),
    ],
)
def test_links_by_which_a_joint_has_more_left_are_not_claimed(
    monkeypatch: pytest.MonkeyPatch, lost: dict[tuple[int, ...], float], kept: tuple[int, ...] | None
) -> None:
    asked = object.__new__(module._Asked)
    monkeypatch.setattr(asked, "_lost", lambda item, white, before: lost.get(item.links, 1.0), raising=False)
    every = BodyExplanation("all", tuple((link, EVERY) for link in range(3)))
    held = asked._holding(every, None, np.ones(3))  # type: ignore[arg-type]
    assert (None if held is None else held.links) == kept
    part = BodyExplanation("part", ((0, EVERY), (1, EVERY)), off=0)
    assert asked._holding(part, None, np.ones(3)) is part  # type: ignore[arg-type]


def test_a_changed_body_has_the_torque_of_its_parameters(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    path = tmp_path / "leg.urdf"
    path.write_text(urdf_of(chain("leg", rng), np.zeros(3), np.zeros(3)))
    model = RobotModel(path)
    q, v, a = rng.standard_normal((3, 8, 3))
    turned = rng.standard_normal((3, 3))
    change = BodyChange(3, 0.7, np.array([0.02, 0.03, -0.1]), 0.01 * (turned @ turned.T + np.eye(3)))
    motion = LinkMotion(model, model.names, q, v, a)
    link = next(number for number, item in enumerate(motion.links) if item.root == 3)
    other, data = model.at_rest()
    before = in_frame_of(other, data, 3, 3)
    more = parameters_of(change.mass, change.centre, change.inertia) - before
    expected = model.torque(model.names, q, v, a)
    for joint in range(3):
        expected[:, joint] += motion.columns(GRAVITY)[joint, link] @ more
    found = model.with_bodies([change])
    assert found.torque(model.names, q, v, a) == pytest.approx(expected, abs=1e-9)


def test_a_changed_link_is_always_a_possible_body() -> None:
    rng = np.random.default_rng(5)
    centre, moments = np.array([0.02, -0.01, 0.2]), np.diag([0.03, 0.025, 0.01])
    in_file = np.array([parameters_of(2.0, centre, moments)] * 20)
    shapes, every = BodyShapes(in_file, np.full(20, 0.4)), 0.3 * rng.standard_normal((20, SHAPE))
    step = 1e-6 * np.eye(SHAPE)
    slopes = np.stack([(shapes.change(every + h) - shapes.change(every - h)) / 2e-6 for h in step], axis=-1)
    assert shapes.slopes(every) == pytest.approx(slopes, abs=1e-7)
    for numbers, changed in zip(every, in_file + shapes.change(every), strict=True):
        mass, _, inertia = split_parameters(changed)
        low, middle, high = np.linalg.eigvalsh(inertia)
        assert mass > 0.0
        assert low + middle > high
        # All bodies of a link move with its points, so that together they are the changed link.
        parts = [moved_body((1.2, centre + 0.1, 0.3 * moments), centre, numbers)]
        parts.append(moved_body((0.8, centre - 0.15, moments), centre, numbers))
        together = sum(parameters_of(*part) for part in parts)
        total = parameters_of(1.2, centre + 0.1, 0.3 * moments) + parameters_of(0.8, centre - 0.15, moments)
        change = BodyShapes(total[None], np.array([0.4])).change(numbers[None])
        assert together == pytest.approx(total + change[0], abs=1e-9)


@pytest.mark.parametrize(
    ("kind", "subject"),
    with_quick(
        [
            ("none", "none"),
            ("part", "part foot"),
            ("mass", "link link3"),
            ("tilt", "tilt"),
            ("constant", "constant joint3"),
        ],
        ("part", "part foot"),
        ("mass", "link link3"),
    ),
)
def test_a_body_is_named_by_all_joints_together(tmp_path: Path, kind: str, subject: str) -> None:
    case = make_case("leg", kind, 0)
    found = finding_of(case, tmp_path / "leg.urdf")
    assert found.subjects == (subject,)
    assert found.probability > 0.85
    if kind == "tilt":
        (lean,) = found.values
        assert lean.value == pytest.approx(3.0, abs=3.0 * lean.std + 0.1)
    if kind == "constant":
        (constant,) = found.values
        assert 1.0 / constant.value - 1.0 == pytest.approx(case.truth.size, abs=0.015)
    if kind != "none":
        assert np.all(found.after[found.effect > 0.03] < found.before[found.effect > 0.03])


@pytest.fixture(scope="module")
def without_foot(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """The whole diagnosis of a leg whose foot is not mounted, and the folder of its files."""
    folder = tmp_path_factory.mktemp("without_foot")
    case = make_case("leg", "part", 1)
    (folder / "leg.urdf").write_text(case.urdf)
    np.savez(folder / "log.npz", **case.columns)
    diagnosis = diagnose_robot(folder / "leg.urdf", folder / "log.npz")
    write_robot_diagnosis(diagnosis, folder)
    return diagnosis, folder


def test_what_is_not_mounted_heads_the_answer(without_foot: tuple[Any, Path]) -> None:
    diagnosis, folder = without_foot
    assert diagnosis.verdict.startswith("The part foot of the file")
    assert all(joint.terms[0].key == "bodies" for joint in diagnosis.joints if joint.differs)
    assert sum(joint.differs for joint in diagnosis.joints) >= 2
    for joint in diagnosis.joints:
        assert joint.left < 0.5 * joint.unchanged
    assert "is not mounted" in (folder / "report.html").read_text()
    assert "foot,mass,0," in (folder / "changes.csv").read_text()


def test_the_written_robot_has_no_foot(without_foot: tuple[Any, Path]) -> None:
    diagnosis, folder = without_foot
    before, after = diagnosis.model, RobotModel(folder / "robot.urdf")
    assert before.at_rest()[0].body_mass.sum() - after.at_rest()[0].body_mass.sum() == pytest.approx(0.35)
    q, v, a = np.random.default_rng(2).standard_normal((3, 4, 3))
    expected = diagnosis.changed.torque(after.names, q, v, a)
    assert after.torque(after.names, q, v, a) == pytest.approx(expected, abs=1e-4)


@pytest.mark.campaign
def test_sealed_bodies_are_right_and_never_wrong() -> None:
    counts, lines = tally(range(3), dirty=False)
    assert counts["wrong"] == 0, lines
    assert counts["right"] >= 66, lines


@pytest.mark.campaign
def test_sealed_bodies_with_ripple_and_drift() -> None:
    counts, lines = tally(range(2), dirty=True)
    assert counts["wrong"] <= 1, lines
    assert counts["right"] >= 36, lines


@pytest.mark.campaign
def test_the_hand_of_a_real_arm_is_not_mounted(data_folder: Path) -> None:
    robots = (Path(place) / "cmeel.prefix/share/example-robot-data/robots" for place in sys.path)
    found = [place / "panda_description/urdf/panda.urdf" for place in robots]
    urdf = next((path for path in found if path.is_file()), None)
    if urdf is None:
        pytest.skip("the URDF of the arm is not installed: pip install example-robot-data")
    diagnosis = diagnose_robot(urdf, data_folder / "robots/panda/log.npz")
    assert diagnosis.verdict.startswith("The part panda_hand with 2 more of the file (0.76 kg) is not mounted")
    assert diagnosis.bodies is not None
    assert np.all(diagnosis.bodies.after[:6] < 0.5 * diagnosis.bodies.before[:6])


@pytest.mark.parametrize("waves", with_quick([3.4, 4.5, 8.6, 15.0], 4.5))
def test_ripple_of_a_gear_is_no_body(tmp_path: Path, waves: float) -> None:
    """Waves between and beyond those that are nuisances, 2 % of the torque."""
    case = make_case("leg", "none", 1)
    size = np.sqrt(np.mean(case.columns["torque"] ** 2, axis=0))
    case.columns["torque"] += 0.02 * size * np.sin(waves * case.columns["position"] + np.arange(size.size))
    found = finding_of(case, tmp_path / "leg.urdf")
    assert not found.claimed


def test_a_link_and_a_payload_on_it_are_one_claim(tmp_path: Path) -> None:
    found = finding_of(make_case("leg", "mass", 2), tmp_path / "leg.urdf")
    assert found.kind in ("link", "payload")
    assert found.claimed


def test_links_that_are_all_off_are_not_one_or_two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def all_off(bodies: list[Body], _: str, rng: np.random.Generator) -> tuple[list[Body], Any, Any, Truth]:
        moved = [
            replace(body, mass=factor * body.mass, inertia=factor * body.inertia,
                    centre=body.centre + 0.01 * rng.standard_normal(3))
            for body in bodies
            for factor in [float(np.exp(0.12 * rng.standard_normal()))]
        ]  # fmt: skip
        return moved, GRAVITY, np.ones(3), Truth("several")

    monkeypatch.setattr(body_cases, "changed", all_off)
    found = finding_of(make_case("leg", "two", 6, dirty=True), tmp_path / "leg.urdf")
    assert found.subjects == ("several link1 link2 link3",)


@pytest.mark.parametrize(("rises", "kind"), [(1.0, "pair"), (8.0, "part")])
def test_a_light_part_is_off_only_where_the_torque_says_so(rises: float, kind: str) -> None:
    """What a link lacks is uncertain by more than the part weighs, and other links explain most of the torque."""
    pair = BodyExplanation("pair", ((0, EVERY), (1, EVERY)))
    evidences = {-1: 0.0, 0: rises}
    numbers, loose = np.zeros(SHAPE), np.full(SHAPE, 0.1)
    best = SimpleNamespace(explanation=pair, evidence=0.5, of_link=lambda link: (numbers, loose, loose))

    def weigh(item: BodyExplanation) -> Any:
        return SimpleNamespace(explanation=item, evidence=evidences[item.off])

    asked: Any = object.__new__(module._Asked)
    asked._evidence = SimpleNamespace(shapes=SimpleNamespace(masses=np.ones(2)), weigh=weigh)
    asked._parts = [SimpleNamespace(link=1, mass=0.015)]
    assert asked._structured(best).explanation.kind == kind
