"""``report.html`` of a robot: bodies, joints and motion first, then the evidence, last the log and the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from nmt_core.text.number_words import percent, value_text
from nmt_report.quantity_format import significant
from nmt_report.response_page import ResponsePage, html_figures, html_table
from nmt_report.svg import BLUE, MUTED, ORANGE, RED, ReportFigure, figure_style, svg_text
from nmt_robots.log_faults.finding import is_known
from nmt_robots.model.robot_model import effort_units, rms_text
from nmt_robots.report.written_back import changes
from nmt_robots.verdict.joint_verdict import JointVerdict
from nmt_robots.verdict.replay import Replay, missed_text
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

_FAULTS = 2
"""On the first screen; the table has all."""
_LISTED = 3
"""Joints whose sizes are on the first screen."""
_REPLAYED_JOINTS = 4
_REPLAYED_POINTS = 600
"""In a figure."""


def robot_page(diagnosis: RobotDiagnosis) -> str:
    """The whole page."""
    with figure_style():
        figures = [_drawing(diagnosis), _bars(diagnosis)]
    faults = [finding for finding in diagnosis.findings if finding.fault]
    differing = [joint for joint in diagnosis.joints if joint.differs]
    page = ResponsePage(
        kicker="Diagnosis of a robot",
        heading=diagnosis.model.name,
        subtitle=f"{len(diagnosis.joints)} joints, {diagnosis.log.rows} rows at "
        f"{1.0 / diagnosis.log.step_s:.4g} Hz of {Path(diagnosis.log.source).name}",
        verdict=(diagnosis.verdict, "partly" if faults or differing else "good"),
        answers=_answers(diagnosis),
        cards=_cards(diagnosis),
        sections=[
            *([("replay", "In motion", _replay(diagnosis.replay))] if diagnosis.replay else []),
            ("joints", "Joints", html_figures(figures[:1]) + _joints(diagnosis)),
            *([("bodies", "Bodies", _bodies(diagnosis))] if diagnosis.bodies else []),
            ("held-out", "Held-out motion", html_figures(figures[1:]) + _held_out(diagnosis)),
            *([("others", "Other logs", _others(diagnosis))] if diagnosis.others else []),
            ("terms", "Terms of each joint", _terms(diagnosis)),
            ("next", "What to move next", _next(diagnosis)),
            ("limits", "What this log cannot tell", _limits(diagnosis)),
            ("log", "The log", _log(diagnosis)),
            *([("file", "The robot's file", _file(diagnosis))] if diagnosis.of_file else []),
        ],
        footer="Torque left: rms on held-out seconds. ± is a standard uncertainty; it covers all timings of the log "
        "that fit equally well. No cause is named that takes less than 3 % of a joint's torque. SI units.",
    )
    return page.html()


def _answers(diagnosis: RobotDiagnosis) -> list[tuple[str, str]]:
    """How far the simulation is from the motion, what differs in bodies and joints, and how the log was read."""
    faults = [finding.sentence for finding in diagnosis.findings if finding.fault]
    rows = [] if diagnosis.replay is None else [("In motion", diagnosis.replay.sentence)]
    rows += [] if diagnosis.bodies is None else [("Bodies", diagnosis.bodies.sentence)]
    rows.append(("Joints", _named(diagnosis)))
    read = (
        f"Timing: {diagnosis.reading.text()}{'; other timings fit equally well' if len(diagnosis.as_well) > 1 else ''}."
    )
    read += " The torque is computed by the drives' control law." if diagnosis.log.is_arithmetic else ""
    more = [f"{len(faults) - _FAULTS} more faults are below."] if len(faults) > _FAULTS else []
    rows.append(("The log", " ".join([*(faults[:_FAULTS] or ["No fault was found."]), *more, read])))
    name, listed = diagnosis.model.path.with_stem("robot").name, "trajectory.csv is the next motion."
    if changes(diagnosis):
        listed = f"{name} holds the changed values, changes.csv lists them; {listed}"
    rows.append(("Files", listed))
    return rows


def _named(diagnosis: RobotDiagnosis) -> str:
    """What differs joint by joint with sizes, or by cause where many joints differ."""
    differing = [joint for joint in diagnosis.joints if joint.differs]
    if not differing:
        return "No cause is named at any joint."
    if len(differing) <= _LISTED:
        return "; ".join(f"{joint.joint.name}: {joint.difference}" for joint in differing) + "."
    causes: dict[str, list[str]] = {}
    for joint in differing:
        for name in dict.fromkeys(term.brief for term in joint.terms if term.differs):
            causes.setdefault(name, []).append(joint.joint.name)
    words = "; ".join(f"{name} at {', '.join(joints)}" for name, joints in causes.items())
    return f"{words[:1].upper()}{words[1:]}. The table has sizes."


def _unit(diagnosis: RobotDiagnosis) -> str:
    return effort_units([joint.joint for joint in diagnosis.joints])


def _cards(diagnosis: RobotDiagnosis) -> list[tuple[str, str, str]]:
    values = {name: rms_text(diagnosis.left_over(name)) for name in ("torque", "unchanged", "left")}
    return [
        (
            "Torque computed from the commands" if diagnosis.log.is_arithmetic else "Torque of the log",
            values["torque"],
            "rms over the joints",
        ),
        ("Residual of the model as given", values["unchanged"], "on held-out seconds"),
        ("Residual of the changed model", values["left"], "on held-out seconds"),
    ]


def _file(diagnosis: RobotDiagnosis) -> Markup:
    rows = [(finding.sentence, ", ".join(finding.joints)) for finding in diagnosis.of_file]
    return html_table([("what the file says", ""), ("joints", "")], rows)


def _log(diagnosis: RobotDiagnosis) -> Markup:
    rows = []
    for finding in diagnosis.findings:
        size = value_text(finding.size, finding.std, finding.unit if finding.unit != "1" else "")
        share = percent(finding.share) if is_known(finding.share) else ""
        whose = ", ".join(finding.joints) or "all"
        rows.append(("fault" if finding.fault else "note", finding.sentence, size if is_known(finding.size) else "",
                     share, whose))  # fmt: skip
    head = [("", ""), ("finding", ""), ("size", ""), ("share of the residual", ""), ("joints", "")]
    others = "; ".join(f"({number}) {reading.text()}" for number, reading in enumerate(diagnosis.as_well[1:], 1))
    note = f"Other timings that fit equally well: {others}." if others else "No other timing fits as well."
    return html_table(head, rows, note)


def _bodies(diagnosis: RobotDiagnosis) -> Markup:
    """What all joints together say of the bodies, its sizes, and the torque of the last part."""
    found = diagnosis.bodies
    assert found is not None
    parts = Markup("<p>{}</p>").format(found.sentence)
    if found.values:
        rows = [
            (item.body, item.quantity, value_text(item.value, item.std, item.unit), significant(item.in_model, 3))
            for item in found.values
        ]
        parts += html_table([("body", ""), ("number", ""), ("robot", ""), ("file", "")], rows)
    if found.claimed:
        lefts = [
            (name, percent(share), significant(before, 3), significant(after, 3))
            for name, share, before, after in zip(
                diagnosis.log.joints, found.effect, found.before, found.after, strict=True
            )
        ]
        unit = _unit(diagnosis)
        head = [("joint", ""), ("change, of its torque", ""), ("left as given", unit), ("left as changed", unit)]
        note = "The last part of the log, below 8 Hz, with bodies and friction of the rows before."
        parts += html_table(head, lefts, note)
    if found.unseen:
        note = (
            "This motion does not determine them: 30 % of a mass or 3 cm of a centre change every torque by less "
            "than 3 %. They keep the file's values."
        )
        parts += html_table([("this log cannot tell", "")], [(item,) for item in found.unseen], note)
    return parts


def _joints(diagnosis: RobotDiagnosis) -> Markup:
    rows = [_joint_row(joint) for joint in diagnosis.joints]
    head = [
        ("joint", ""),
        ("what differs", ""),
        ("closed", ""),
        ("torque left", _unit(diagnosis)),
        ("what remains", ""),
    ]
    return html_table(
        head, rows, "Closed: share of the residual of the model as given that the changes remove, on held-out seconds."
    )


def _joint_row(joint: JointVerdict) -> tuple[str, ...]:
    if joint.mechanics is None:
        return (joint.joint.name, "not judged", "", "", joint.remains)
    impossible = "; ".join(term.text() for term in joint.terms if term.impossible < 0.0)
    words = f"{joint.difference}. {impossible}" if impossible else joint.difference
    closed = percent(joint.closed) if joint.differs and is_known(joint.closed) else ""
    return (joint.joint.name, words, closed, significant(joint.left, 3), joint.remains)


def _held_out(diagnosis: RobotDiagnosis) -> Markup:
    judged = [joint for joint in diagnosis.joints if joint.mechanics is not None]
    names = ("torque", "model as given", "basic fit, log as recorded", "basic fit", "all terms", "basic fit, last part",
             "all terms, last part")  # fmt: skip
    texts = [[significant(value, 3) for value in _figures(joint)] for joint in judged]
    # A fit with the values of an earlier one needs no column.
    columns: dict[tuple[str, ...], str] = {}
    for name, cells in zip(names, zip(*texts, strict=True), strict=False):
        columns.setdefault(cells, name)
    head = [("joint", ""), *((name, _unit(diagnosis)) for name in columns.values())]
    rows = list(zip([joint.joint.name for joint in judged], *columns, strict=True))
    note = (
        "Basic fit: Coulomb and viscous friction, armature and an offset; of the log as recorded: with its timing as "
    )
    note += "it is. Last part: fitted to the first 70 % of the rows, judged by the others."
    repeated = [name for name in names if name not in columns.values()]
    note += f" With the same values: {', '.join(repeated)}." if repeated else ""
    return html_table(head, rows, note)


def _others(diagnosis: RobotDiagnosis) -> Markup:
    """Values by further logs, and torque that the first log's values leave of theirs."""
    parts = Markup()
    for item in diagnosis.others:
        rows = [
            (term.joint, term.words, value_text(*term.first, term.unit),
             value_text(*term.other, term.unit) if is_known(term.other[0]) else "not found",
             "agrees" if term.agrees else "differs")
            for term in item.terms
        ]  # fmt: skip
        head = [("joint", ""), ("term", ""), ("first log", ""), ("this log", ""), ("within 2 ±", "")]
        left = [(name, *(significant(value, 3) for value in values)) for name, values in item.left.items()]
        names = ("torque", "model as given", "first log's values")
        figures = [("joint", ""), *((name, _unit(diagnosis)) for name in names)]
        parts += html_table(figures, left, item.sentence)
        if rows:
            parts += html_table(head, rows)
    return parts


def _replay(replay: Replay) -> Markup:
    """Distance after each horizon, and the windows of the joints that are off most."""
    if not replay.horizons_s:
        return html_table([("in motion", "")], [(replay.how,)])
    found = [
        (replay.after(item, span), replay.is_beyond(item, span))
        for _, item in replay.models
        for span in replay.horizons_s
    ]
    rows = [(f"{replay.tool} (mm)", "", *(missed_text(tool, beyond) for (_, tool), beyond in found))]
    for number, (name, turns) in enumerate(zip(replay.joints, replay.turns, strict=True)):
        missed = (missed_text(float(joints[number]), beyond) for (joints, _), beyond in found)
        rows.append((f"{name} ({'mrad' if turns else 'mm'})", replay.changed.get(name, "nothing"), *missed))
    spans = [f"{words}, after {span:g} s" for words, _ in replay.models for span in replay.horizons_s]
    with figure_style():
        figure = _motions(replay)
    head = [("off by, rms", ""), ("changed", ""), *((words, "") for words in spans)]
    return html_figures([figure]) + html_table(head, rows, replay.how)


def _motions(replay: Replay) -> ReportFigure:
    """Error over the horizon, and measured and simulated windows, of the tool and the joints that are off most."""
    last = replay.after(replay.by_model, replay.horizons_s[-1])[0]
    chosen = np.argsort(-last)[:_REPLAYED_JOINTS]
    every = slice(None, None, max(1, len(replay.time) // _REPLAYED_POINTS))
    apart = _without_overlap(replay)
    height = 1.9 * (len(chosen) + 1) + 0.5
    figure = Figure(figsize=(9.2, height))
    grid: Any = figure.subplots(len(chosen) + 1, 2, squeeze=False)
    figure.subplots_adjust(left=0.08, right=0.99, top=1.0 - 0.4 / height, hspace=0.3, wspace=0.2, bottom=0.45 / height)
    for (words, predicted), colour in zip(replay.models, (ORANGE, BLUE), strict=False):
        time = replay.time[every]
        grid[0][0].plot(time, 1e3 * predicted.ends()[every], color=colour, label=words)
        for window in replay.starts[apart]:
            of_window = int(np.flatnonzero(replay.starts == window)[0])
            since = (window - replay.starts[0]) * replay.step_s + time
            grid[0][1].plot(since, 1e3 * np.mean(predicted.tool[of_window, every], axis=1), color=colour, linewidth=0.9)
            for axes, joint in zip(grid[1:, 1], chosen, strict=True):
                axes.plot(since, replay.measured[of_window, every, joint], color=MUTED, linewidth=2.5, zorder=1)
                axes.plot(since, predicted.position[of_window, every, joint], color=colour, linewidth=0.9)
        for axes, joint in zip(grid[1:, 0], chosen, strict=True):
            axes.plot(time, 1e3 * predicted.joints()[every, joint], color=colour)
    grid[0][0].set_ylabel("tool off (mm, rms)")
    grid[0][1].set_ylabel("tool off (mm)")
    for row, joint in zip(grid[1:], chosen, strict=True):
        small, unit = ("mrad", "rad") if replay.turns[joint] else ("mm", "m")
        row[0].set_ylabel(f"{replay.joints[joint]} off ({small}, rms)")
        row[1].set_ylabel(f"{replay.joints[joint]} ({unit})")
    grid[-1][0].set_xlabel("time since the measured state (s)")
    grid[-1][1].set_xlabel("time (s)")
    grid[0][0].legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    more = len(replay.joints) - len(chosen)
    words = "The joints with the largest errors. Left: error over the time since the measured state. Right: windows, "
    words += "measured in grey."
    words += f" {more} more are in the table." if more else ""
    return ReportFigure("replay", "Measured and simulated motion", words,
                        svg_text(figure, "replay", "Error over the horizon; positions"), wide=True)  # fmt: skip


def _without_overlap(replay: Replay) -> list[int]:
    """Numbers of windows one after the other."""
    found: list[int] = []
    for number, start in enumerate(replay.starts):
        if not found or start - replay.starts[found[-1]] >= len(replay.time):
            found.append(number)
    return found


def _figures(joint: JointVerdict) -> tuple[float, ...]:
    return (joint.torque, joint.unchanged, joint.as_logged, joint.plain, joint.left, joint.last_plain, joint.last)


def _terms(diagnosis: RobotDiagnosis) -> Markup:
    rows = [
        (
            joint.joint.name,
            term.name,
            value_text(term.value, term.std, term.unit) if term.impossible == 0.0 else term.text(),
            significant(term.in_model, 3) if term.in_model else "",
            percent(term.share),
            ", ".join(words for words in term.alike if words not in term.equal),
        )
        for joint in diagnosis.joints
        for term in joint.terms
    ]
    head = [("joint", ""), ("term", ""), ("value", ""), ("in the model", ""), ("difference, of the torque", ""),
            ("fits almost as well", "")]  # fmt: skip
    return html_table(head, rows)


def _next(diagnosis: RobotDiagnosis) -> Markup:
    rows = [(str(number + 1), request.sentence) for number, request in enumerate(diagnosis.next.requests)]
    note = (
        "trajectory.csv and trajectory.yaml (trajectory_msgs/JointTrajectory) hold it, inside the ranges of the joints "
        "and no faster than this log. They are not checked for collisions with the "
        "surroundings: check the clearance first."
    )
    return html_table([("part", ""), ("motion and what it separates", "")], rows, note)


def _limits(diagnosis: RobotDiagnosis) -> Markup:
    rows = [
        ("armature or inertia of a link that turns alone", "not separable in any log", "weigh the link"),
        ("friction that builds up over a short way", "named only with many slow reversals",
         "slow reversals, two amplitudes"),
        ("torque constant, or mass, friction and armature scaled alike", "reported only beyond the stated tolerances",
         "a known payload"),
        ("effects of temperature, friction that depends on position", "no term of the library describes them",
         "the same motion when warm"),
    ]  # fmt: skip
    if diagnosis.log.is_arithmetic:
        rows.insert(1, ("velocity gain or viscous friction", "not separable where the torque is computed",
                        "measured current, or a velocity command that is not zero"))  # fmt: skip
    return html_table([("what", ""), ("why", ""), ("what would tell", "")], rows)


def _drawing(diagnosis: RobotDiagnosis) -> ReportFigure:
    """Joints where the robot's kinematics has them, coloured by the residual."""
    pose = np.median(diagnosis.motion.q, axis=0)
    anchors, before = diagnosis.model.positions(diagnosis.log.joints, pose)
    share = np.array(
        [joint.left / joint.torque if joint.mechanics is not None else np.nan for joint in diagnosis.joints]
    )
    figure = Figure(figsize=(4.6, 3.4))
    axes: Any = figure.add_axes((0.02, 0.02, 0.78, 0.96), projection="3d")
    for anchor, parent in zip(anchors, before, strict=True):
        axes.plot(*np.column_stack([parent, anchor]), color=MUTED, linewidth=2.5)
    colours = matplotlib.colormaps["plasma"](np.clip(np.nan_to_num(share) / 0.25, 0.0, 0.9))
    axes.scatter(*anchors.T, c=colours, s=45, depthshade=False)
    for number, anchor in enumerate(anchors):
        axes.text(*anchor, f" {number + 1}", fontsize=8)
    spans = np.ptp(np.vstack([anchors, before]), axis=0)
    axes.set_box_aspect(np.maximum(spans, 0.1 * max(float(np.max(spans)), 1e-3)))
    axes.set_axis_off()
    bar = figure.add_axes((0.86, 0.2, 0.03, 0.6))
    bar.imshow(np.linspace(0.0, 0.9, 32)[:, None], cmap="plasma", vmin=0, vmax=1, aspect="auto", origin="lower",
               extent=(0, 1, 0, 25))  # fmt: skip
    bar.set_xticks([])
    bar.set_title("left, %", fontsize=8)
    bar.grid(False)
    names = ", ".join(f"{number + 1} {name}" for number, name in enumerate(diagnosis.log.joints))
    label = "The robot's joints, coloured by the share of torque that is left over"
    return ReportFigure("robot", "The robot", f"Joints by their remaining torque: {names}.",
                        svg_text(figure, "robot", label))  # fmt: skip


def _bars(diagnosis: RobotDiagnosis) -> ReportFigure:
    """Torque left in each joint."""
    judged = [joint for joint in diagnosis.joints if joint.mechanics is not None]
    figure = Figure(figsize=(9.2, 3.0))
    axes = figure.add_axes((0.07, 0.32, 0.91, 0.6))
    places = np.arange(len(judged))
    kinds = (
        (-0.3, "unchanged", "model as given", RED),
        (-0.1, "as_logged", "plain fit, log as it is", MUTED),
        (0.1, "plain", "plain fit, log read anew", ORANGE),
        (0.3, "left", "all terms", BLUE),
    )
    for shift, name, label, colour in kinds:
        axes.bar(places + shift, [getattr(joint, name) for joint in judged], 0.19, color=colour, label=label)
    axes.set_xticks(places, [joint.joint.name for joint in judged], rotation=30, ha="right")
    axes.set_ylabel(f"torque left ({_unit(diagnosis)})")
    axes.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return ReportFigure("left", "Torque left on held-out seconds", "The lower, the more is explained.",
                        svg_text(figure, "left", "Torque left in each joint"), wide=True)  # fmt: skip
