"""A robot's file as changed: what a joint has got stands in that joint's element, whatever else bears its name."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.model.compilation import read_robot
from nmt_robots.report.written_back import changes, robot_text

LINKS = '<link name="base"/><link name="a"/><link name="b"/>'
CONTROL = '<ros2_control name="x"><joint name="hip"><param name="p">1</param></joint></ros2_control>'
COMMENT = '<!-- <joint name="hip" type="revolute"><dynamics friction="9" damping="9"/></joint> -->'
URDF_JOINT = '<joint name="hip" type="revolute"><parent link="base"/><child link="a"/>DYNAMICS</joint>'
OTHER = '<joint name="knee" type="revolute"><parent link="a"/><child link="b"/><dynamics friction="0.5"/></joint>'
DYNAMICS = ("", "<dynamics/>", '<dynamics friction="0.3" damping="0.1"/>', '<dynamics\n friction = "0.3"></dynamics>')
MJCF = """<mujoco><default><joint name="x" damping="2"/></default>BEFORE<worldbody><body>
<joint class="" JOINT name="hip"END<geom name="a>b" size="1"/>
<body><joint frictionloss="0.5" name="knee"/><geom size="1"/></body>
</body></worldbody><actuator><motor joint="hip"/></actuator><sensor><jointpos joint="hip"/></sensor></mujoco>"""


def diagnosed(path: Path) -> Any:
    """What a diagnosis of the file would have found: friction, damping and a spring of the hip."""
    terms = [
        SimpleNamespace(key=key, value=value, std=0.01, unit="N·m", in_model=0.3, equal=("a -- b",), differs=True)
        for key, value in (("coulomb", 0.7543), ("viscous", 0.25), ("spring", 3.0))
    ]
    joint = SimpleNamespace(joint=SimpleNamespace(name="hip"), terms=terms)
    return SimpleNamespace(model=SimpleNamespace(file=read_robot(path)), joints=[joint], bodies=None)


def stripped(element: ElementTree.Element) -> str:
    """An element as text with single blanks."""
    return re.sub(r"\s+", " ", ElementTree.tostring(element, encoding="unicode")).strip()


def written(path: Path) -> tuple[ElementTree.Element, str]:
    """The tree of the file as changed, and which terms it has."""
    diagnosis = diagnosed(path)
    changed = changes(diagnosis)
    assert [bool(change.attribute) for change in changed] == [True, True, False]
    text = robot_text(diagnosis, changed)
    assert "± 0.01 N·m (was 0.3" in text
    return ElementTree.fromstring(text), text


@pytest.mark.parametrize("quotes", ['"', "'"])
def test_a_urdf_joint_gets_it(tmp_path: Path, quotes: str) -> None:
    path = tmp_path / "robot.urdf"
    for dynamics, first, second in product(DYNAMICS, ("", CONTROL, COMMENT), ("", CONTROL, COMMENT)):
        joint = URDF_JOINT.replace("DYNAMICS", dynamics)
        text = f'<robot name="ü">{first}{LINKS}{second}{OTHER}{joint}</robot>'.replace('"', quotes)
        path.write_text(text, encoding="utf-8")
        before = ElementTree.fromstring(text)
        root, _ = written(path)
        (found,) = root.findall("joint[@name='hip']")
        (place,) = found.findall("dynamics")
        assert (place.get("friction"), place.get("damping")) == ("0.7543", "0.25")
        found.remove(place)
        (old,) = before.findall("joint[@name='hip']")
        for item in old.findall("dynamics"):
            old.remove(item)
        assert stripped(root) == stripped(before)


@pytest.mark.parametrize("quotes", ['"', "'"])
def test_an_mjcf_joint_gets_it(tmp_path: Path, quotes: str) -> None:
    path = tmp_path / "robot.xml"
    equal = '<tendon><fixed><joint joint="hip" coef="1"/></fixed></tendon>'
    for joint, end, before in product(("", 'damping="1"', "frictionloss = '0.3'"), ("/>", "></joint>", " />"),
                                      ("", COMMENT, equal)):  # fmt: skip
        text = MJCF.replace("JOINT", joint).replace("END", end).replace("BEFORE", before)
        path.write_text(text.replace('"', quotes) if "'" not in joint else text)
        root, _ = written(path)
        places = [item for item in root.find("worldbody").iter("joint") if item.get("name") == "hip"]  # type: ignore[union-attr]
        expected = {"class": "", "name": "hip", "frictionloss": "0.7543", "damping": "0.25"}
        assert [item.attrib for item in places] == [expected]
        (knee,) = (item for item in root.iter("joint") if item.get("name") == "knee")
        assert knee.attrib == {"name": "knee", "frictionloss": "0.5"}


def test_a_joint_that_the_file_has_not_is_not_said_to_be_written(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="x">{LINKS}{CONTROL}{OTHER.replace("knee", "toe")}{URDF_JOINT}</robot>'
                    .replace("DYNAMICS", "").replace('"hip" type', '"haunch" type'))  # fmt: skip
    diagnosis = diagnosed(path)
    changed = changes(diagnosis)
    assert not any(change.attribute for change in changed)
    assert robot_text(diagnosis, changed) == path.read_text()
