"""Robots' files that use much of their format, and random changes of their trees."""

from __future__ import annotations

from collections.abc import Callable
from xml.etree import ElementTree

import numpy as np

MJCF = """<mujoco model="rich"><compiler angle="degree" eulerseq="xyz" autolimits="true"/>
<option gravity="0.3 -0.2 -9.7" timestep="0.001"><flag energy="enable"/></option><size memory="10M"/>
<default><joint damping="0.2" armature="0.01"/><geom density="700" rgba="1 0 0 1"/>
<default class="heavy"><geom density="2700" type="capsule" size="0.03"/>
<joint axis="0 1 0" stiffness="2" springref="10"/>
</default></default>
<asset><texture name="t" type="2d" builtin="flat" width="8" height="8"/><material name="m" texture="t"/>
<mesh name="absent" file="absent.stl"/></asset>
<worldbody><light pos="0 0 3"/><geom type="plane" size="1 1 1"/>
<body name="turret" pos="0 0 0.2" euler="5 0 10" childclass="heavy">
<joint name="pan" axis="0 0 1" range="-150 150" ref="5"/>
<inertial pos="0.01 0 0.03" mass="2.4" fullinertia="0.012 0.013 0.009 0.001 0 -0.002"/>
<geom type="mesh" mesh="absent"/>
<frame pos="0.02 0 0.1" axisangle="0 1 0 20"><body name="upper"><joint name="lift" type="hinge" range="-100 100"/>
<geom fromto="0 0 0 0.3 0 0.02" mass="1.7"/><site name="end" pos="0.3 0 0"/><camera name="c"/>
<body name="fore" pos="0.32 0 0" quat="0.9 0.1 0.3 0.2"><joint name="elbow" pos="0.01 0 0" range="-140 140"/>
<joint name="shift" type="slide" axis="1 0 0" range="-0.2 0.2"/><geom type="box" class="heavy" size="0.12 0.03 0.02"/>
<geom type="sphere" size="0.04" pos="0.1 0 0"/><body name="hand" pos="0.2 0 0" xyaxes="0 1 0 -1 0 0">
<inertial pos="0 0 0.05" euler="10 20 30" mass="0.4" diaginertia="0.001 0.002 0.0025"/></body></body></body>
</frame></body>
</worldbody><tendon><fixed name="band" stiffness="3" springlength="0.1"><joint joint="lift" coef="1"/>
<joint joint="elbow" coef="-0.5"/></fixed></tendon>
<actuator><motor joint="pan" gear="20" ctrlrange="-1 1"/><position joint="lift" kp="50" forcerange="-40 40"/>
</actuator>
<sensor><jointpos joint="pan"/></sensor><keyframe><key name="k" qpos="0 0 0 0"/></keyframe></mujoco>"""

URDF = """<?xml version="1.0"?><robot name="rich"><material name="red"><color rgba="1 0 0 1"/></material>
<ros2_control name="x" type="system"><joint name="pan"><command_interface name="position"/></joint></ros2_control>
<link name="world"/><link name="base"><inertial><mass value="3"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial></link><link name="turret"><inertial><origin xyz="0.01 0 0.03" rpy="0.1 0.2 0.3"/><mass value="2.4"/>
<inertia ixx="0.012" iyy="0.013" izz="0.009" ixy="0.001" ixz="0" iyz="-0.002"/></inertial><collision><geometry>
<cylinder radius="0.05" length="0.1"/></geometry></collision><visual><geometry><mesh filename="package://a/b.dae"/>
</geometry>
</visual></link><link name="upper"><inertial><origin xyz="0.16 0 0"/><mass value="1.7"/>
<inertia ixx="0.003" iyy="0.016" izz="0.016" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="frame"/>
<link name="fore"><inertial><mass value="0.9"/><inertia ixx="0.001" iyy="0.006" izz="0.0002" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.05 0.05"/></geometry></collision></link>
<link name="finger"><inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0"
iyz="0"/></inertial>
</link><joint name="foot" type="fixed"><origin rpy="0 0.1 0"/><parent link="world"/><child link="base"/></joint>
<joint name="pan" type="continuous"><origin xyz="0 0 0.2"/><parent link="base"/><child link="turret"/>
<axis xyz="0 0 1"/>
<limit effort="60" velocity="6"/><dynamics damping="0.4" friction="0.25"/></joint><joint name="lift" type="revolute">
<origin xyz="0 0 0.1" rpy="0.2 0 0"/><parent link="turret"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="60" velocity="6"/></joint><joint name="bolted" type="fixed">
<origin xyz="0.32 0 0"/>
<parent link="upper"/><child link="frame"/></joint><joint name="elbow" type="revolute"><parent link="frame"/>
<child link="fore"/><axis xyz="0 1 1"/><limit lower="-2" upper="2" effort="30" velocity="6"/></joint>
<joint name="grip" type="prismatic"><origin xyz="0.2 0 0"/><parent link="fore"/><child link="finger"/>
<axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" effort="10" velocity="1"/><mimic joint="elbow" multiplier="0.01"/></joint>
<gazebo reference="base"/></robot>"""

_NUMBERS = ("nan", "inf", "-inf", "1e308", "-1e308", "1e999", "0", "-1", "1e-320", "1e9", "0x10", "1,5", "x")
_ELEMENTS = (
    '<include file="/dev/zero"/>', "<INCLUDE/>",
    '<attach model="m"/>', '<replicate count="100000000"><geom/></replicate>',
    '<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>', '<size nkey="2000000000"/>',
    '<flexcomp name="f" type="grid" count="500 500 500"/>', '<composite type="cable" count="1000000 1 1"/>',
    '<geom type="mesh" mesh="absent" mass="1"/>', '<joint name="pan"/>', "<freejoint/>", "<inertial/>", "<body/>",
    '<mesh name="absent" file="/dev/zero"/>', '<mimic joint="lift"/>', '<link name="base"/>', "<joint/>",
    '<compiler meshdir="/dev" settotalmass="1e12" balanceinertia="true" boundinertia="nan"/>', "<frame/>",
)  # fmt: skip


def changed_tree(content: bytes, random: np.random.Generator) -> bytes:
    """A file with one to four changes of its tree: numbers, attributes, elements put in, doubled or taken out."""
    root = ElementTree.fromstring(content)
    for _ in range(random.integers(1, 5)):
        elements = list(root.iter())
        element = elements[int(random.integers(len(elements)))]
        other = elements[int(random.integers(len(elements)))]
        _change(int(random.integers(8)), element, other, random)
    return ElementTree.tostring(root)


def scaled_numbers(text: str, random: np.random.Generator) -> str:
    """A file in which up to three numbers have another size."""
    root = ElementTree.fromstring(text)
    numbers = [
        (element, key) for element in root.iter() for key, value in element.attrib.items() if _are_numbers(value)
    ]
    for _ in range(random.integers(1, 4)):
        element, key = numbers[int(random.integers(len(numbers)))]
        words = element.attrib[key].split()
        place = int(random.integers(len(words)))
        words[place] = f"{float(words[place]) * random.uniform(0.7, 1.4):.9g}"
        element.set(key, " ".join(words))
    return ElementTree.tostring(root, encoding="unicode")


def _are_numbers(words: str) -> bool:
    try:
        return bool([float(word) for word in words.split()])
    except ValueError:
        return False


def _change(kind: int, element: ElementTree.Element, other: ElementTree.Element, random: np.random.Generator) -> None:
    pick: Callable[[int], int] = lambda count: int(random.integers(count))  # noqa: E731
    keys = list(element.attrib)
    key = keys[pick(len(keys))] if keys else "pos"
    if kind <= 1:
        words = element.attrib.get(key, "0").split() or [""]
        words[pick(len(words))] = _NUMBERS[pick(len(_NUMBERS))]
        element.set(key, " ".join(words))
    elif kind == 2:
        element.attrib.pop(key, None)
    elif kind == 3:
        element.set(key, next(iter(other.attrib.values()), "x"))
    elif kind == 4 and len(element):
        element.remove(element[pick(len(element))])
    elif kind == 5:
        element.append(ElementTree.fromstring(_ELEMENTS[pick(len(_ELEMENTS))]))
    elif kind == 6:
        element.append(ElementTree.fromstring(ElementTree.tostring(other)))
    else:
        element.tag = other.tag
