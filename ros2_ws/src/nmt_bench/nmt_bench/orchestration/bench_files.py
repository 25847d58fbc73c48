"""The files from which nodes are started one by one: parameters, rig and the run's description of itself."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from nmt_bench.hardware.chosen_device import check_command, checked_device
from nmt_core.errors import BenchError
from nmt_rig.rig import load_rig
from nmt_rig.rig_snapshot import rig_text
from nmt_sequencer.level_plan import parse_levels
from nmt_session.node_plan import NodePlan, plan_nodes
from nmt_session.plan_of_test import PlanSettings, TestPlan
from nmt_session.planning import kind_of_rig

GOAL_FILE = "goal.json"
"""Fields of the goal of the run for which the nodes have their parameters."""


def write_bench_files(
    rig_name: str,
    folder: Path,
    out: Path,
    *,
    levels: str | None = None,
    pacing: str = "realtime",
    changes: Sequence[str] = (),
    device: str = "",
) -> NodePlan:
    """Write ``nodes.yaml`` (for ``--params-file``), ``rig.yaml``, ``run.json`` and ``goal.json``.

    Args:
        rig_name: name of a rig that comes with the bench, or path of a rig file.
        folder: where the files are written; made if it does not exist.
        out: where they will lie when the nodes start; the bags go there, too.
        levels: drive amplitudes, the notation of ``--levels``; None = the rig's own.
        pacing: ``lockstep`` or ``realtime``.
        changes: ``key=value`` texts applied to the rig file.
        device: as ``--device`` of ``./nmt run``; empty = the converter of the rig file. Where it describes none, the
            plant simulates, and the bag names no device, since a plant of one's own may take the place of the bench's.

    Returns:
        The parameters of the nodes and the goal of a run.

    Raises:
        BenchError: the rig or a setting is refused, a converter has not been checked, or the folder cannot be written.
    """
    rig = load_rig(rig_name, list(changes))
    text = rig_text(rig, rig_name, list(changes))
    settings: PlanSettings = {"pacing": pacing, "linked": False}  # whoever starts the nodes chooses their hosts
    settings.update(checked_device(rig, device, check_command(rig_name, device, changes)))
    test = TestPlan.of(
        rig=rig,
        rig_yaml=text,
        levels=tuple(parse_levels(levels or rig.test.levels)),
        kind=kind_of_rig("phase_resonance", rig, {}),
        **settings,
    )
    plan = plan_nodes(test, out / "bag", out / "rig.yaml", test.device_name if test.device else "")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "rig.yaml").write_text(text, encoding="utf-8")
        (folder / "run.json").write_text(json.dumps(plan.run, indent=2) + "\n", encoding="utf-8")
        (folder / GOAL_FILE).write_text(json.dumps(plan.goal) + "\n", encoding="utf-8")
        plan.write_parameters(folder / "nodes.yaml")
    except OSError as error:
        raise BenchError(f"The folder {folder} cannot be written ({error.strerror}); choose another.") from error
    return plan
