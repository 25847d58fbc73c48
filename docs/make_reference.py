"""Fills the generated tables of docs/reference from the sources, so that they cannot fall behind.

    ./nmt shell
    python docs/make_reference.py           # write
    python docs/make_reference.py --check   # exit code 1 if a page is not up to date

A page holds its tables between ``<!-- generated: KIND NAME -->`` and ``<!-- end -->``; everything else is
written by hand. KIND is ``message`` (a .msg, .srv or .action file), ``parameters`` (the table of a node), ``rig``
(a section of the rig file), ``elements`` (a file of local elements), ``devices`` (the sections of the
converters), ``keys`` (attributes of a class by its
docstring), ``options`` (a command), ``python`` (the public names of a package), ``effects`` (a place of the
diagnosis), ``matrix`` (tests and consumers), ``statements``, ``priors`` or ``quantities`` (of a modal point).
The tables of parameters stand in the node modules, so
they need ROS 2.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import re
import sys
import types
import typing
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
MESSAGES = DOCS.parent / "ros2_ws" / "src" / "nmt_msgs"
REGION = re.compile(r"(<!-- generated: (\w+) ([\w./-]+) -->\n).*?(<!-- end -->)", re.S)

NODE_SETTINGS = {
    "plant": "nmt_plant.plant_settings:PlantSettings",
    "pll": "nmt_pll.pll_settings:PllSettings",
    "sequencer": "nmt_sequencer.sequencer_settings:SequencerSettings",
    "extract": "nmt_extract.extraction_settings:ExtractSettings",
    "recorder": "nmt_record.bag.recorder_settings:RecorderSettings",
    "topic_bridge": "nmt_plant.topic_bridge:TopicBridgeSettings",
}

# What the keys of a rig file mean; units and ranges come from the models.
RIG_MEANINGS: dict[str, dict[str, str]] = {
    "StopInputSection": {
        "port": "physical channel that no sensor uses",
        "range_v": "full scale of the port",
        "threshold_v": "level at which the line asks for zero",
        "stops": "below or above the threshold; `low` also detects a cut cable, with a resistor to ground",
    },
    "OutputPortSection": {
        "channel": "name",
        "port": "number from 1 (PortAudio) or physical channel (NI)",
        "range_v": "full scale of the port",
        "amplifier_gain": "volts at the exciter for a volt at the port",
    },
    "InputPortSection": {
        "channel": "name of the sensor",
        "port": "number from 1 (PortAudio) or physical channel (NI)",
        "range_v": "full scale of the port",
        "sensitivity_v": "volts at the port per unit of the sensor: V/N, V per m/s²",
        "uncertainty": "standard, relative, of the sensitivity, from the calibration sheet",
        "calibrated": "date of that sheet",
        "serial": "of the sensor",
        "coupling": "of the input (NI)",
        "icp_ma": "current of the sensor's supply (NI); 0 = none",
    },
    "Rig": {
        "device": "converter and channel map; left out = the rig is simulated",
        "name": "name: a letter, then letters, digits and underscores",
        "description": "one line for people",
        "assumptions": "sentences on what is not known for certain; kept in the bag",
        "seed": "seed of all noise of the simulation",
        "sample_rate_hz": "sampling rate of every channel",
        "block_samples": "samples a message; left out = [chosen](../explanation/phase-locked-loop.md#block-length), "
        "else 200",
        "substeps": "steps of the time integration per sample",
        "structure": "the linear structure, by `kind`",
        "local_elements": "nonlinear or additional elements, each by `kind`",
        "exciter": "what drives the structure, by `kind`; of several exciters the first",
        "exciters": "several exciters instead of `exciter`, the reference first",
        "sensors": "channels; at least the force and one response",
        "limits": "amplitudes that end a test",
        "watchdog": "what happens when drive commands stop",
        "test": "defaults of `./nmt run`",
        "extraction": "what the modal properties are computed from",
        "pll": "[settings of the loop](parameters.md#pll) and `loop: adaptive` or `paper`; empty = derived from the "
        "linear modes",
        "coordinate": "`angle`: every key has rad for m, N·m for N, kg·m² for kg; the diagnosis takes it from its "
        "recordings",
        "clock_error": "relative error e of the clock: real rates are (1 + e) times the nominal",
        "drift": "slow changes with bench time",
        "recording": "a smaller bag: samples rounded, chunks compressed; without the section neither",
    },
    "StructureSection": {
        "added_masses": "masses fixed to points",
        "oscillators": "masses on springs at points, each one more degree of freedom",
        "damping_factors": "factors on the damping ratios of the undamped modes, lowest first; the last one holds "
        "for all above; what couples two modes takes the geometric mean of their factors",
        "loss_factor": "η of hysteretic damping K (1 + iη), as ζ = η / 2 of every undamped mode",
    },
    "OscillatorSection": {
        "point": "that carries it",
        "mass_kg": "m",
        "frequency_hz": "√(k/m) / 2π, the point held",
        "damping_ratio": "c / (2 √(k m))",
    },
    "AddedMassSection": {
        "point": "where it is",
        "mass_kg": "mass; negative where the model has too much",
    },
    "RecordingSection": {
        "sample_bits": "significant bits of the samples; 24 = single precision, 53 = all",
        "compression": "of the bag's chunks",
    },
    "DriftSection": {
        "slip_force_per_s": "relative change of all slip forces (`jenkins`, `iwan`, `tanh_friction`) per second",
        "slip_force_per_cycle": "the same per period of the drive",
        "stiffness_per_s": "relative change of the structure's stiffness per second, in steps of 4e-6",
    },
    "ShakingTableSection": {
        "kind": "table that moves all supports together; a volt commands an acceleration",
        "point": "point of the loop's response and of the force channel",
        "acceleration_per_volt_m_s2": "acceleration per drive voltage, m/s² per V",
        "effective_mass_kg": "m of the force channel, −m times the table's acceleration; left out = φᵀMr / φ(point)",
        "bandwidth_hz": "corner of the low-pass between command and acceleration; left out = none",
        "suspension_hz": "natural frequency of the table's suspension; left out = none, 0.5 Hz with absolute "
        "displacements",
        "suspension_damping_ratio": "ζ of the suspension",
        "responses": "motion that the sensors see: relative to the table, or absolute",
    },
    "TransverseSection": {
        "point": "point whose motion is recorded as well",
        "fraction": "share of it",
    },
    "BeamSection": {
        "kind": "uniform Euler–Bernoulli beam",
        "boundary": "left and right end",
        "length_m": "length",
        "width_m": "width of the cross-section, across the motion",
        "height_m": "height of the cross-section, along the motion",
        "youngs_modulus_pa": "Young's modulus",
        "density_kg_m3": "density",
        "elements": "finite elements of equal length; point i is the right end of element i, in a free-free beam "
        "its left end",
        "stiffness_damping_s": "β of the damping matrix β K of the beam alone",
        "mesh_refinement": "finite elements between two points; the points stay as they are",
        "clamp_rotational_stiffness_nm_rad": "rotational spring that each clamp is; left out = rigid",
        "clamp_lateral_stiffness_n_m": "lateral spring that each clamp is; left out = rigid",
        "suspension_stiffness_n_m": "spring at each end of a free-free beam; 0 = two rigid-body modes at 0 Hz",
        "suspension_damping_ns_m": "damper parallel to each of these springs",
    },
    "ModalSection": {
        "kind": "modes: frequencies, damping ratios, shapes at points",
        "points": "point numbers, in the order of the shapes",
        "modes": "the modes; a rigid-body mode has 0 Hz",
        "residual": "what modes above the given ones contribute",
        "shape_std": "standard uncertainty of the shapes over the largest value of each mode, for the diagnosis",
        "base_motion": "displacement of each point over that of a shaking table",
        "file": "modes from a `.csv` table or data sets 55 of a universal file (`.uff`, `.unv`)",
        "direction": "direction of the nodes of a universal file",
        "source": "where the modes were read from; written by the bench",
    },
    "ModeSection": {
        "frequency_hz": "natural frequency",
        "damping_ratio": "ζ",
        "modal_mass_kg": "φᵀMφ in the scale of the shape; 1 = mass-normalised",
        "shape": "displacement at the points; 1 for a single point",
        "participation": "Γ = φᵀMr / φᵀMφ, r = rigid motion with the base; needed by a shaking table",
    },
    "ResidualSection": {
        "flexibility_m_n": "symmetric matrix of static displacements by forces at the points, beyond the modes",
        "frequency_hz": "where it is kept as modes; well above the band",
        "damping_ratio": "ζ of these modes",
    },
    "MatricesSection": {
        "kind": "mass, stiffness and damping matrix, for example of a finite-element code",
        "points_at": "points and the nodes or rows of the matrices that move there",
        "mass_kg": "mass matrix, by rows",
        "stiffness_n_m": "stiffness matrix, by rows",
        "damping_ns_m": "damping matrix, by rows; left out = none, or by `damping_ratios`",
        "damping_ratios": "ζ of the modes, the last one of all higher ones",
        "base_vector": "displacement of each row by that of a shaking table",
        "base_load_kg": "load of each row by the table's acceleration; left out = mass matrix times `base_vector`",
        "file": "`.npz` or `.mat` (up to -v7) with M, K and optional C, r (`base_vector`), p (`base_load_kg`), or a "
        "file of a finite-element program",
        "mass_file": "mass matrix alone: Matrix Market (`.mtx`), `.npy`, or scipy's sparse `.npz`",
        "stiffness_file": "stiffness matrix alone",
        "damping_file": "damping matrix alone",
        "rows_file": "node.direction of each row (`17.3` = node 17 in z), or EXTRN cards of Nastran",
        "nodes_file": "node coordinates: `*NODE` of Abaqus or CalculiX, GRID cards, or node,x,y,z a line",
        "units": "length, mass and force of the files, as `mm-t-N`",
        "modes": "Craig–Bampton reduction to the points and this number of modes; needed beyond 60 rows",
        "mass_factor": "factor on the mass matrix",
        "stiffness_factor": "factor on the stiffness matrix",
        "damping_factor": "factor on the damping matrix",
        "frequency_factors": "factors on the frequencies of the undamped modes, lowest first; 1 for all above",
        "regions": "parts of the model that may be off, by name",
        "source": "where the matrices were read from; written by the bench",
    },
    "RegionSection": {
        "nodes": "nodes of the region",
        "within": "opposite corners of a box of nodes, in the file's units",
        "file": "K and M of its elements alone; left out = no stiffness, mass by the rows of its nodes",
        "held": "a support: its nodes are free in the model, and the bench holds them",
        "stiffness_factor": "factor on its stiffness",
        "mass_factor": "factor on its mass",
        "compliance_m_n": "of a support: all springs together in each direction, evenly spread; 0 = rigid",
        "rotational_compliance_rad_nm": "the same of its rotations, where the nodes have them",
        "stiffness_std": "relative standard uncertainty of its stiffness, within which a diagnosis refits the "
        "factor; 0 = an error is an effect",
        "mass_std": "the same of its mass",
        "stiffness_n_m": "its stiffness in the reduced coordinates; written by the bench",
        "mass_kg": "its mass; written by the bench",
        "moved_kg": "mass of the region in rigid motion; written by the bench",
        "translation_rows": "coordinates that it holds as a support; written by the bench",
        "rotation_rows": "the same of rotations; written by the bench",
    },
    "MatrixPointSection": {
        "point": "point number",
        "row": "matrix row of its lateral motion, from 0",
        "rotation_row": "row of its rotation; left out = it does not rotate",
        "node": "its node, instead of `row`",
        "at": "coordinates in the file's units instead of `row`: the nearest node, reported with its distance",
        "direction": "direction of its motion, with `node` or `at`",
        "rotation": "direction of its rotation, with `node` or `at`",
    },
    "ChainSection": {
        "kind": "masses in a row",
        "masses_kg": "masses; point i is mass i",
        "springs_n_m": "springs between neighbours, one fewer than masses",
        "dampers_ns_m": "dampers between neighbours; left out = none",
        "ground_springs_n_m": "spring from each mass to the ground; left out = none",
        "ground_dampers_ns_m": "damper from each mass to the ground; left out = none",
    },
    "ShakerSection": {
        "kind": "electrodynamic shaker with a rigid stinger at `point`",
        "point": "drive point",
        "table_mass_kg": "mass of the table",
        "table_stiffness_n_m": "suspension of the table",
        "table_damping_ns_m": "damping of the table",
        "coil_mass_kg": "mass of the coil",
        "coil_stiffness_n_m": "between coil and table",
        "coil_damping_ns_m": "between coil and table",
        "force_factor_n_a": "force per current, equal to voltage per velocity",
        "inductance_h": "inductance of the coil",
        "resistance_ohm": "resistance of the coil",
        "source_resistance_ohm": "output resistance of the amplifier, in series with the coil's",
        "amplifier_saturation_v": "V of u = V tanh(command / V); a voltage sensor measures the command",
        "force_factor_linear_per_m": "b₁ of the force factor G (1 + b₁ x + b₂ x²), x = coil displacement",
        "force_factor_quadratic_per_m2": "b₂ of the same",
    },
    "ForceSection": {
        "kind": "ideal force without mass or stiffness",
        "point": "drive point",
        "newton_per_volt": "force per drive voltage",
    },
    "SensorSection": {
        "quantity": "what it measures",
        "point": "point number or `drive`; none for voltage and current",
        "exciter": "of voltage and current: exciter number from 1",
        "channel": "channel name; default f, x, v, a with point number, u, i",
        "gain": "recorded value per true value",
        "noise_psd": "two-sided density S of the noise in units²/Hz; its variance is S / correlation time",
        "noise_correlation_time_s": "time over which a noise value is held; 0 = one sample",
        "range": "full scale of the converter, in recorded units; left out = unlimited",
        "bits": "resolution of the converter, step 2 range / 2^bits; needs `range`",
        "mass_kg": "sensor mass, added to its point; a force cell then measures F + m a",
        "transverse": "recorded share of the motion of another point (`point`, `fraction`)",
        "dead_zone": "a loose sensor: sign(y) max(|y| − d, 0); SI units",
        "low_pass_hz": "corner of 1 / (1 + iω/ω_c)",
        "high_pass_hz": "corner of iω / (iω + ω_h)",
        "delay_s": "delay; negative = lead, one sampling interval at most",
        "hum_amplitude": "mains hum, recorded units, of one phase in all channels",
        "hum_hz": "its frequency",
        "crosstalk_per_volt": "recorded units per volt of the drive command",
        "clip": "clipping level of recorded values, without `FLAG_OVERLOAD`",
        "dropped_fraction": "share of samples that are lost; the one before is recorded again",
    },
    "LimitSection": {
        "voltage_v": "largest drive voltage of every sample; commands beyond it are refused, with harmonics and "
        "random peaks (four times the rms)",
        "slew_v_s": "largest rate of change of the drive; faster changes are spread; left out = a sine of "
        "`voltage_v` at a tenth of the sample rate",
        "rise_from_v": "amplitude from which a rise above fourfold a block is spread, if a measured quantity has a "
        "limit; left out = 5 % of `voltage_v`",
        "drive_maximum_v": "drive amplitude that ends a test, below `voltage_v`",
        "force_n": "largest measured force",
        "acceleration_m_s2": "largest measured acceleration, any point",
        "velocity_m_s": "largest measured velocity, any point",
        "displacement_m": "largest measured displacement, any point",
        "channels": "levels of single channels, see below",
        "open_loop": "channels that must respond to the drive, see below",
        "warning_share": "share of an abort level that warns, without a warning level",
        "rms_time_s": "time constant of the rms",
        "ramp_s": "half-cosine to zero after a violation",
    },
    "ChannelLimitSection": {
        "channel": "name of the channel",
        "abort_peak": "largest magnitude, in the channel's SI unit",
        "abort_rms": "largest rms, as an exponential mean of squares over `rms_time_s`",
        "warning_peak": "magnitude that is reported",
        "warning_rms": "rms that is reported",
    },
    "OpenLoopSection": {
        "channel": "name of the channel",
        "least": "smallest peak in a block that counts as a response",
        "drive_v": "drive amplitude from which a response is due",
        "time_s": "how long there may be none",
    },
    "WatchdogSection": {
        "blocks": "blocks without a drive command before the drive goes to zero; 0 = off",
        "ramp_s": "half-cosine to zero",
    },
    "TestSection": {
        "mode": "target mode, from 1",
        "levels": "plan of drive amplitudes in V: `a:b:n` or `a,b,c`",
        "response_levels": "amplitudes of the drive-point response for a self-excited test",
        "ramp_s": "half-cosine between levels",
        "window_periods": "whole periods a window; fewer than 3 are rejected by the extraction",
        "lock_timeout_s": "bench time a level may take to lock, after its ramp",
        "harmonics_control": "controls force harmonics 2 to this one; 0 = none, `auto` = as many as the sample rate "
        "allows, at most 15",
        "harmonics_target": "`force` = zero, `modal` = the ratio that modal power needs",
    },
    "ExtractionSection": {
        "harmonics": "highest harmonic",
        "linear_modes": "columns of Φ: at least the target mode, at most the response sensors",
        "quantity": "the responses that Φ is taken at",
        "hysteresis": "points and masses of a chain whose joint loops are evaluated",
    },
    "HysteresisSection": {
        "excited_point": "point of m₁, the driven mass",
        "middle_point": "point of m₂, between leaf spring and joint",
        "free_point": "point of m₃, beyond the joint",
        "excited_mass_kg": "m₁",
        "free_mass_kg": "m₃",
    },
}


def message_table(name: str) -> str:
    """What a message, service or action is, its fields by name, and its file, which says their units and meanings.

    Args:
        name: path below nmt_msgs, for example ``msg/Drive.msg``.
    """
    text = (MESSAGES / name).read_text(encoding="utf-8")
    heading = []
    for line in text.strip().splitlines():
        if not line.startswith("#"):
            break
        heading.append(line.removeprefix("#").strip())
    titles = {".action": ("Goal", "Result", "Feedback"), ".srv": ("Request", "Response")}.get(Path(name).suffix, ("",))
    fields = []
    for title, part in zip(titles, text.split("\n---\n"), strict=True):
        codes = [line.partition("#")[0].strip() for line in part.splitlines()]
        names = [f"`{code.split()[1]}`" for code in codes if code and "=" not in code]
        fields.append(f"{title or 'Fields'}: {', '.join(names) or 'nothing'}.")
    where = f"Types, units and constants: [{Path(name).name}](../../ros2_ws/src/nmt_msgs/{name})."
    return "\n\n".join(filter(None, (" ".join(heading), " ".join(fields), where)))


def parameters_table(name: str) -> str:
    """Parameters of a node, or ``common`` for those that all nodes have. Needs ROS 2."""
    from nmt_core.nodes.node_settings import NodeSettings
    from nmt_core.nodes.parameters import markdown_list
    from nmt_core.settings import parameters_of

    common = parameters_of(NodeSettings)
    if name == "common":
        return markdown_list(common)
    module, _, kind = NODE_SETTINGS[name].partition(":")
    return markdown_list(
        item for item in parameters_of(getattr(importlib.import_module(module), kind)) if item not in common
    )


def rig_table(name: str) -> str:
    """Keys of one section of the rig file, by the name of its model."""
    from nmt_rig import rig

    return _section_table(getattr(rig, name), rig.StructureSection, RIG_MEANINGS[name])


def devices_table(name: str) -> str:
    """Keys of the section ``device``: those of all kinds of converter, then of each, by their docstrings.

    Args:
        name: ``all``.
    """
    from nmt_rig.device_sections import DEVICES, DeviceSection

    tables = [_section_table(DeviceSection, DeviceSection, _attributes(DeviceSection))]
    for kind, model in DEVICES.items():
        title = (model.__doc__ or "").partition("\n")[0].replace("``", "`")
        keys = {"kind": "converter", **_attributes(DeviceSection), **_attributes(model)}
        tables.append(f"**`kind: {kind}`**: {title}\n\n{_section_table(model, DeviceSection, keys)}")
    return "\n\n".join(tables)


def elements_table(name: str) -> str:
    """Keys of the local elements of one file, by its name; their docstrings say what they mean."""
    from nmt_rig.model.local_elements.element import ElementSection

    name_of_module = f"nmt_rig.model.local_elements.{name}"
    tables = []
    for model in vars(importlib.import_module(name_of_module)).values():
        own = isinstance(model, type) and model.__module__ == name_of_module and issubclass(model, ElementSection)
        if own and "Attributes:" in (model.__doc__ or ""):
            title = model.__doc__.partition("\n")[0].removesuffix(".")
            title = title if title[1] == " " else title[0].lower() + title[1:]
            tables.append(_section_table(model, ElementSection, {"kind": title, **_attributes(model)}))
    return "\n\n".join(tables)


def _section_table(model: Any, base: Any, meanings: dict[str, str]) -> str:
    inherited = base.model_fields if issubclass(model, base) and model is not base else ()
    lines = []
    for key, field in model.model_fields.items():
        if key in inherited:
            continue
        kind, bounds = _type_and_range(key, field)
        value = field.get_default(call_default_factory=True)
        facts = _facts(kind, _unit(key), bounds, "required" if field.is_required() else _default(value))
        lines.append(f"* `{key}`{facts}: {meanings[key].replace('``', '`')}")
    return "\n".join(lines)


def _facts(kind: str, unit: str, bounds: str, default: str) -> str:
    """In parentheses; what most keys are, an optional number without a default, is not said."""
    facts = [
        kind if kind != "number" else "",
        unit,
        bounds,
        default if default not in ("none", "empty", "as in the section") else "",
    ]
    words = ", ".join(filter(None, facts))
    return f" ({words})" if words else ""


def _attributes(model: Any) -> dict[str, str]:
    """Meanings of the attributes of a class by its docstring."""
    text = (model.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    return {key: " ".join(words.split()) for key, words in _ATTRIBUTE.findall(text)}


def keys_table(name: str) -> str:
    """Attributes of a class as its docstring describes them, with types and defaults where it is a pydantic model.

    Args:
        name: of the class with its module.
    """
    module, _, kind = name.rpartition(".")
    model = getattr(importlib.import_module(module), kind)
    meanings = _attributes(model)
    fields = getattr(model, "model_fields", {})
    lines = []
    for key, meaning in meanings.items():
        facts = ""
        if fields:
            kinds, bounds = _type_and_range(key, fields[key])
            value = fields[key].get_default(call_default_factory=True)
            default = "required" if fields[key].is_required() else _default(value)
            facts = _facts(kinds, "", bounds, default)
        lines.append(f"* `{key}`{facts}: {meaning.replace('``', '`')}")
    return "\n".join(lines)


_ATTRIBUTE = re.compile(r"^ {8}(\w+): (.*?)(?=^ {8}\w+: |\Z)", re.S | re.M)


def options_table(name: str) -> str:
    """Arguments and options of a command, part by part where it has parts; ``shared``: those of three and more."""
    if name == "shared":
        return "\n".join(_shared_options())
    command = _command_parser(name)
    parts = _parts(command)
    if parts is None:
        return "\n".join(_option_lines(command))
    lines: list[str] = []
    for choice in parts._choices_actions:
        lines += ["", f"**`{name} {choice.dest}`**: {choice.help}", "", *_option_lines(parts.choices[choice.dest])]
    return "\n".join(lines[1:])


def _command_parser(name: str) -> argparse.ArgumentParser:
    from nmt_bench.cli import build_parser

    group = next(action for action in build_parser(name)._actions if action.dest == "command")
    return typing.cast(argparse.ArgumentParser, typing.cast(Any, group.choices)[name])


def _parts(command: argparse.ArgumentParser) -> Any:
    return next((action for action in command._actions if isinstance(action, argparse._SubParsersAction)), None)


@cache
def _shared_options() -> tuple[str, ...]:
    """Lines of the options that three commands and more have in the same words."""
    from nmt_bench.cli import all_commands

    count: Counter[str] = Counter()
    for name in all_commands():
        parts = _parts(_command_parser(name))
        for command in parts.choices.values() if parts is not None else (_command_parser(name),):
            count.update(_all_option_lines(command))
    return tuple(line for line, times in count.items() if times > 2 and "--out" not in line)


def _option_lines(command: argparse.ArgumentParser) -> list[str]:
    """Lines of a command's options, those that it shares with others by their names."""
    lines = _all_option_lines(command)
    shared = [line.partition(": ")[0].removeprefix("* ") for line in lines if line in _shared_options()]
    lines = [line for line in lines if line not in _shared_options()]
    return lines + ([f"* [as everywhere](#options-of-several-commands): {', '.join(shared)}"] if shared else [])


def _all_option_lines(command: argparse.ArgumentParser) -> list[str]:
    lines = []
    for action in command._actions:
        if action.help == argparse.SUPPRESS:
            continue
        if action.dest == "help" or (action.dest == "json" and action.nargs == 0):  # every command has them
            continue
        value = str(action.metavar or ("{" + ",".join(map(str, action.choices)) + "}" if action.choices else ""))
        words = ", ".join(action.option_strings)
        shown = f"{words} {value}".strip() if words and action.nargs != 0 else words or value or action.dest
        need = " **Required.**" if action.required and words else ""
        meaning = re.sub(_DEFAULT_FOLDER, "", (action.help or "").replace("%%", "%"))
        lines.append(f"* `{shown}`: {meaning}{need}")
    return lines


_DEFAULT_FOLDER = r"; made if it does not exist \(default: out/[a-z]+-DATE-TIME\)"


def python_table(package: str) -> str:
    """Public names of a package, where each is defined, and the first sentence of its docstring."""
    module = importlib.import_module(package)
    lines = []
    for name in module.__all__:
        value = getattr(module, name)
        first = (value.__doc__ or "").strip().partition("\n\n")[0]
        sentence = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", " ".join(first.replace("``", "`").split()))
        sentence = re.split(r"(?<=\w)[.;:] ", sentence)[0].removesuffix(".")
        lines.append(f"* `{package}.{name}` (`{value.__module__}.{value.__qualname__}`): {sentence}")
    return "\n".join(lines)


def effects_table(place: str) -> str:
    """Effects of the diagnosis at one place."""
    from nmt_diagnose.effects.library import library

    lines = []
    for effect in library():
        if effect.place != place:
            continue
        parameters = []
        for p in effect.parameters:
            starts = f", starts at {', '.join(f'{value:g}' for value in p.grid)} scales" if p.grid else ""
            sign = "" if p.kind == "shape" or p.signed else ", ≥ 0"
            parameters.append(f"`{p.name}` ({p.unit}; {p.kind}{sign}{starts})")
        alike = "; ".join(f"`{name}` ({test})" for name, test in effect.equivalents.items())
        keys = ", ".join(f"`{key}`" for key in effect.keys.split(", "))
        equal = f" Like {alike}." if alike else ""
        lines.append(
            f"* `{effect.name}`: {effect.equation}; {keys}; {', '.join(parameters)}.{equal} *{effect.reference}*"
        )
    return "\n".join(lines)


def priors_table(name: str) -> str:
    """Priors of the calibration parameters."""
    from nmt_core.tolerances import MODEL_PRIORS

    keys: dict[tuple[float, str], list[str]] = {}
    for key, prior in MODEL_PRIORS.items():
        keys.setdefault((prior.std, prior.reason), []).append(f"`{key}`")
    return "\n".join(f"* {', '.join(names)} ± {100 * std:g} %: {reason}" for (std, reason), names in keys.items())


def quantities_table(name: str) -> str:
    """The measured quantities of a modal point, and where each is shown."""
    from nmt_core.messages.modal_point import QUANTITIES

    lines = ["| quantity | unit | what it is | modal.csv | tables |", "|---|---|---|---|---|"]
    for quantity in QUANTITIES:
        symbol = quantity.column.symbol if quantity.column is not None else ""
        cells = (f"`{quantity.name}`", quantity.unit, quantity.meaning, "yes" if quantity.csv else "", symbol)
        lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    return "\n".join(lines)


def statements(name: str) -> str:
    """Every statement with the check that stops it.

    Args:
        name: ``all``.
    """
    from nmt_diagnose.ledger.statements import statements_table

    return statements_table()


def tolerances_table(name: str) -> str:
    """Standard uncertainties of a healthy measuring chain.

    Args:
        name: ``all``.
    """
    from nmt_core.threshold import thresholds_of
    from nmt_diagnose.thresholds import THRESHOLDS

    lines = []
    for key, holder, field in thresholds_of(THRESHOLDS.tolerances):
        unit = field.metadata["unit"]
        lines.append(
            f"* `{key}` {getattr(holder, key):g}{'' if unit == '1' else f' {unit}'}: {field.metadata['reason']}"
        )
    return "\n".join(lines)


def matrix_table(name: str) -> str:
    """Tests by kind, exciters and drive, and what each consumer says of them; its sentences below."""
    from nmt_bench.consumers import CONSUMERS, covers_of
    from nmt_core.kinds import KINDS as TESTS
    from nmt_core.kinds import SecondaryResonanceTest
    from nmt_core.messages.driven_test import DrivenTest
    from nmt_core.vocabulary import TestKind

    drives = {
        "shaker": ("electrodynamic_shaker",), "force": ("force",), "table": ("shaking_table",),
        "2 shakers": ("electrodynamic_shaker",) * 2, "2 forces": ("force",) * 2,
    }  # fmt: skip
    names = "|".join(re.escape(test.words()) for test in TESTS.values())
    any_test = re.compile(
        rf"\b([Aa])n? (?:{names}) test\b(?: with \d exciters)?(?:(?: with| and) controlled "
        f"harmonics)?"
    )
    sentences: dict[str, int] = {}
    lines = [f"| test | driven by | {' | '.join(CONSUMERS)} |", "|---|---|" + "---|" * len(CONSUMERS)]
    for kind, test in TESTS.items():
        if kind is TestKind.RECORD:
            continue
        for harmonics in (0, 1) if "harmonics_control" in test.FROM_RIG else (0,):
            rows: dict[tuple[str, ...], list[str]] = {}
            for drive, exciters in drives.items():
                resonance = "3:1" if test is SecondaryResonanceTest else ""
                asked = DrivenTest(
                    kind=kind, exciters=exciters, control=test.CONTROL, controlled_harmonics=harmonics,
                    resonance=resonance,
                )  # fmt: skip
                cells = []
                for consumer in CONSUMERS:
                    sentence = covers_of(consumer)(asked)
                    if sentence:
                        sentence = any_test.sub(_this_test, sentence).replace("is this test", "is another one")
                        cells.append(f"({sentences.setdefault(sentence, len(sentences) + 1)})")
                    else:
                        cells.append("✓")
                    if consumer == "run" and sentence:
                        cells += ["–"] * (len(CONSUMERS) - 1)
                        break
                rows.setdefault(tuple(cells), []).append(drive)
            for row, driven in rows.items():
                words = test.words() + (", harmonics controlled" if harmonics else "")
                by = "any" if len(driven) == len(drives) else ", ".join(driven)
                lines.append(f"| {words} | {by} | {' | '.join(row)} |")
    lines.append("")
    lines += [f"{number}. {sentence}" for sentence, number in sentences.items()]
    return "\n".join(lines)


def _this_test(found: re.Match[str]) -> str:
    return "This test" if found[1] == "A" else "this test"


KINDS: dict[str, Callable[[str], str]] = {
    "matrix": matrix_table,
    "statements": statements,
    "tolerances": tolerances_table,
    "effects": effects_table,
    "priors": priors_table,
    "quantities": quantities_table,
    "message": message_table,
    "parameters": parameters_table,
    "rig": rig_table,
    "devices": devices_table,
    "elements": elements_table,
    "keys": keys_table,
    "options": options_table,
    "python": python_table,
}


def render(text: str, skip: frozenset[str] = frozenset()) -> str:
    """The page with its tables made anew; kinds in ``skip`` stay as they are."""

    def fill(match: re.Match[str]) -> str:
        start, kind, name, end = match.groups()
        return match.group(0) if kind in skip else f"{start}{KINDS[kind](name)}\n{end}"

    return REGION.sub(fill, text)


def regions(text: str) -> Iterator[tuple[str, str]]:
    """Kind and name of every generated table of a page."""
    for match in REGION.finditer(text):
        yield match.group(2), match.group(3)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _unit(key: str) -> str:
    from nmt_core.key_units import unit_of_key

    unit = unit_of_key(key)
    return "" if unit == "1" else unit


def _default(value: Any) -> str:
    if value is None:
        return "none"
    if value in ("", [], {}):
        return "empty"
    return "as in the section" if hasattr(type(value), "model_fields") else f"`{value}`"


def _type_and_range(key: str, field: Any) -> tuple[str, str]:
    kinds: list[str] = []
    bounds: list[str] = []
    _describe(field.annotation, kinds, bounds)
    for item in field.metadata:
        bounds += _bound(item)
    if key in ("structure", "exciters", "local_elements") or (key == "exciter" and "section" in kinds):
        kinds, bounds = (["list of sections"] if key in ("exciters", "local_elements") else ["section"]), []
    # A kind is named once however often the annotation repeats it.
    return " or ".join(dict.fromkeys(kinds)), ", ".join(dict.fromkeys(bounds))


_PLAIN = {float: "number", int: "whole number", str: "text", bool: "true or false", dict: "mapping"}


def _describe(annotation: Any, kinds: list[str], bounds: list[str]) -> None:
    origin = typing.get_origin(annotation)
    if annotation is type(None):
        return
    if origin is typing.Annotated:
        inner, *extras = typing.get_args(annotation)
        _describe(inner, kinds, bounds)
        for item in extras:
            bounds += _bound(item)
    elif origin is typing.Literal:
        kinds.extend(f"`{value}`" for value in typing.get_args(annotation))
    elif origin in (typing.Union, types.UnionType):
        for inner in typing.get_args(annotation):
            _describe(inner, kinds, bounds)
    elif origin is list:
        inside: list[str] = []
        _describe(typing.get_args(annotation)[0], inside, bounds)
        plural = "lists" + inside[0].removeprefix("list") if inside[0].startswith("list") else f"{inside[0]}s"
        kinds.append(f"list of {plural}")
    elif origin is dict:
        kinds.append("mapping")
    else:
        kinds.append(_PLAIN.get(annotation, "section"))


def _bound(item: Any) -> list[str]:
    signs = (("gt", "> "), ("ge", "≥ "), ("lt", "< "), ("le", "≤ "))
    found = [f"{sign}{getattr(item, name):g}" for name, sign in signs if hasattr(item, name)]
    for name, words in (("min_length", "{} entries at least"), ("max_length", "{} at most")):
        if getattr(item, name, None):
            found.append(words.format(getattr(item, name)))
    for inner in getattr(item, "metadata", ()):  # pydantic keeps the bounds of Field here
        found += _bound(inner)
    return found


def main(arguments: list[str] | None = None) -> int:
    """Write or check every page; 1 if ``--check`` finds one that is not up to date."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a page is stale")
    options = parser.parse_args(arguments)
    if importlib.util.find_spec("nmt_bench") is None:
        sys.stderr.write("The packages of the bench are not known to this Python; run the command in ./nmt shell.\n")
        return 2
    without_ros = importlib.util.find_spec("rclpy") is None
    if without_ros:
        sys.stderr.write("Without ROS 2 the tables of node parameters stay as they are.\n")
    stale = []
    for page in sorted((DOCS / "reference").glob("*.md")):
        old = page.read_text(encoding="utf-8")
        new = render(old, frozenset({"parameters"} if without_ros else ()))
        if new != old:
            stale.append(page.name)
            if not options.check:
                page.write_text(new, encoding="utf-8")
    sys.stdout.write(f"{'Stale' if options.check else 'Written'}: {', '.join(stale) or 'none'}\n")
    return 1 if options.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
