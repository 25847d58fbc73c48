"""Run by :mod:`nmt_robots.model.compilation` in a process of its own: a robot compiled by MuJoCo.

Reads a JSON object from its standard input and writes ``robot.mjb`` and ``facts.json`` into its folder. Its keys: text
(MJCF), folder (of meshes), keep (joints that move; null = all), followers (joint, driver, ratio, offset of each).
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import open_regular
from nmt_core.files.limited_child import limit

os.environ["MUJOCO_GL"] = "disable"  # nothing is drawn; the window library takes a third of the import
try:
    import mujoco
except ImportError:  # optional; the parent looks for it before this runs
    mujoco = None

_LARGEST_MESH = 2**26
_IMPOSSIBLE = 1e-3
"""Share by which moments of inertia break A + B ≥ C before it is reported; below it they were rounded."""

Array = np.ndarray[Any, Any]


def compiled(request: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The model and what was noticed.

    Raises:
        ValueError: MuJoCo refuses it.
        BenchError: a mesh that gives mass is not there.
    """
    spec = mujoco.MjSpec.from_string(request["text"])
    spec.compiler.usethread = False
    facts: dict[str, Any] = {"free": _without_free_objects(spec), "gravcomp": [], "impossible": {}}
    for body in spec.bodies:
        if body.gravcomp:
            facts["gravcomp"].append(_name(body))
            body.gravcomp = 0.0
    facts["meshes"] = _load_meshes(spec, Path(request["folder"]))
    stated = _stated_inertias(spec, facts["impossible"])
    if request["keep"] is not None:
        _keep_only(spec, request["keep"], request["followers"])
    model = spec.compile()
    _put_back(model, stated)
    return model, facts


def _name(body: Any) -> str:
    """Of a body, or of its drive."""
    return str(body.name or next((joint.name for joint in body.joints if joint.name), "") or "a body without a name")


def _below(body: Any) -> list[Any]:
    return [body, *(item for child in body.bodies for item in _below(child))]


def _without_free_objects(spec: Any) -> list[str]:
    """Take bodies that float alone out of a scene with a robot; their names."""
    free = mujoco.mjtJoint.mjJNT_FREE
    alone: list[Any] = []
    kept: list[Any] = []
    for top in spec.worldbody.bodies:
        kinds = {joint.type for body in _below(top) for joint in body.joints}
        (alone if kinds == {free} else kept).append(top)
    if not any(body.joints for top in kept for body in _below(top)):
        return []
    names = [_name(body) for body in alone]
    for body in alone:
        spec.delete(body)
    return names


def _carries(spec: Any, geom: Any) -> bool:
    """Whether a shape gives mass to its body."""
    body = geom.parent
    mode = spec.compiler.inertiafromgeom
    if body.name == "world" or mode == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE:
        return False
    if mode == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO and body.explicitinertial:
        return False
    low, high = spec.compiler.inertiagrouprange
    dense = geom.density if math.isnan(geom.mass) else geom.mass
    return bool(low <= geom.group <= high and dense != 0.0)


def _moves(body: Any) -> bool:
    """Whether a body or one that it hangs on has a joint."""
    while body is not None and body.name != "world":
        if body.joints:
            return True
        body = body.parent
    return False


def _load_meshes(spec: Any, folder: Path) -> bool:
    """Load meshes that give mass and take all others out; whether there are any that do.

    Raises:
        BenchError: one of them is not there.
    """
    loaded: dict[str, bytes] = {}
    needed: set[str] = set()
    by_name = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes}
    solid = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF)
    for geom in list(spec.geoms):
        if (geom.meshname or geom.type in solid) and _carries(spec, geom) and _moves(geom.parent):
            needed.add(geom.meshname)
            loaded |= _content(spec, by_name.get(geom.meshname), folder, geom)
        elif geom.meshname or geom.type in (*solid, mujoco.mjtGeom.mjGEOM_HFIELD):
            spec.delete(geom)
    for name, mesh in by_name.items():
        if name not in needed:
            spec.delete(mesh)
    spec.compiler.meshdir = ""
    spec.assets = loaded
    return bool(needed)


def _content(spec: Any, mesh: Any, folder: Path, geom: Any) -> dict[str, bytes]:
    """A mesh's file by its name; nothing where its points stand in the robot's file."""
    try:
        if mesh is None:
            raise BenchError(f"the file has no mesh '{geom.meshname}'.")
        if not mesh.file:
            return {}
        with open_regular(folder / spec.compiler.meshdir / mesh.file, "mesh", _LARGEST_MESH) as file:
            return {mesh.file: file.read()}
    except BenchError as error:
        raise BenchError(
            f"link {_name(geom.parent)} has its mass in a mesh: {error} Put it there, or give the link an <inertial>"
        ) from None


def _stated_inertias(spec: Any, impossible: dict[str, str]) -> dict[int, tuple[float, list[float]]]:
    """Put placeholders where MuJoCo would refuse an inertia; mass and moments that they stand for, by body.

    Torque is linear in mass and moments, so any symmetric matrix serves; only its axes are put in here.
    """
    stated = {}
    bounded = spec.compiler.balanceinertia or spec.compiler.boundinertia > 0.0 or spec.compiler.boundmass > 0.0
    if bounded or spec.compiler.settotalmass > 0.0:
        return {}
    for number, body in enumerate(spec.bodies):
        if body.name == "world" and number == 0:
            continue
        if not body.explicitinertial:
            if any(_carries(spec, geom) for geom in body.geoms):
                continue
            body.explicitinertial = True
            body.mass, body.inertia, body.ipos, body.iquat = 0.0, [0.0] * 3, [0.0] * 3, [1.0, 0.0, 0.0, 0.0]
        moments = np.array(body.inertia)
        if not math.isnan(body.fullinertia[0]):
            moments, body.iquat = _principal(np.array(body.fullinertia))
            body.fullinertia = [math.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
        low, middle, high = np.sort(moments)
        why = ""
        if low < -1e-9 * max(abs(low), abs(high)):
            why = f"a negative principal moment of inertia ({low:.3g} kg·m²)"
        elif low + middle < (1.0 - _IMPOSSIBLE) * high:
            why = f"principal moments {low:.3g}, {middle:.3g} and {high:.3g} kg·m², the largest above the others' sum"
        if body.mass < 0.0:
            why = f"a negative mass ({body.mass:.3g} kg)"
        if why:
            impossible[_name(body)] = why
        stated[number] = float(body.mass), moments.tolist()
        body.mass, body.inertia = 1.0, [1.0] * 3
    return stated


def _principal(full: Array) -> tuple[Array, Array]:
    """Principal moments of a symmetric matrix xx, yy, zz, xy, xz, yz, and the quaternion of its axes."""
    xx, yy, zz, xy, xz, yz = full
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] *= -1.0
    turn = np.empty(4)
    mujoco.mju_mat2Quat(turn, axes.ravel())
    return moments, turn


def _put_back(model: Any, stated: dict[int, tuple[float, list[float]]]) -> None:
    """Mass and moments as the file states them, and what MuJoCo derives of them."""
    for number, (mass, moments) in stated.items():
        model.body_mass[number] = mass
        model.body_inertia[number] = moments
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for values in (model.dof_invweight0, model.body_invweight0, model.dof_M0):
        values[:] = np.maximum(np.nan_to_num(values, nan=1e-9, posinf=1e9), 1e-9)


def _keep_only(spec: Any, names: list[str], followers: list[list[Any]]) -> None:
    """Leave bodies, the named joints, and those that follow them."""
    kept = {*names, *(item[0] for item in followers)}
    for kind in ("actuators", "tendons"):
        for item in list(getattr(spec, kind)):
            spec.delete(item)
    for joint in list(spec.joints):
        if joint.name not in kept:
            spec.delete(joint)
    references = {joint.name: float(joint.ref) for joint in spec.joints}
    for joint, driver, ratio, offset in followers:
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        equality.name1, equality.name2 = joint, driver
        equality.data[:5] = [offset - references[joint] + ratio * references[driver], ratio, 0.0, 0.0, 0.0]


if __name__ == "__main__":
    mujoco.set_mju_user_warning(lambda _: None)
    limit(int(sys.argv[1]), int(sys.argv[2]))
    try:
        model, facts = compiled(json.load(sys.stdin))
    except BenchError:
        raise
    except (ValueError, RuntimeError) as error:
        # Its lines are those of its own input, not of the user's file.
        words = re.sub(r"\b(XML )?Error: |,? \(?line \d+\)?", "", str(error))
        raise ValueError("; ".join(line.strip() for line in words.splitlines() if line.strip())) from None
    size = mujoco.mj_sizeModel(model)
    if size + model.narena > int(sys.argv[1]):
        raise MemoryError
    mujoco.mj_saveModel(model, "robot.mjb", None)
    Path("facts.json").write_text(json.dumps(facts), encoding="utf-8")
