"""What every documented command has to answer: the page's claim beside each command, as a check that can fail.

A page is followed from top to bottom in one empty folder. ``prints`` are regular expressions of the output, ``holds``
looks into the files that the command left, ``table`` compares the table of the page with the printed one. A command
that is not run here says why, or which test runs it.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import nmt

TESTS = Path(__file__).resolve().parents[1]
PAGES = TESTS.parent


@dataclass(frozen=True)
class Answer:
    """What a command has to answer.

    Attributes:
        prints: regular expressions that the output has.
        holds: of the folder in which the page is followed; raises AssertionError where the page's claim is not so.
        table: the next table of the page is the printed one, numbers within two of their uncertainties.
        instead: options that are added, or the command that stands for one that waits for a person.
        code: exit code.
        tested_by: test that runs this command with its answer, as ``file.py::test``, below ``tests``.
        not_run: what a reader has and the suite has not.
        before: what the page tells the reader to do first.
    """

    prints: tuple[str, ...] = ()
    holds: Callable[[Path], None] | None = None
    table: bool = False
    instead: str = ""
    code: int = 0
    tested_by: str = ""
    not_run: str = ""
    before: Callable[[Path], None] | None = None

    @property
    def is_run(self) -> bool:
        """Whether the campaign of the pages runs the command."""
        return not (self.tested_by or self.not_run)

    @property
    def is_checked(self) -> bool:
        """Whether anything but the exit code is looked at."""
        return bool(self.prints or self.holds or self.table or self.code)


def page_text(page: str) -> str:
    """Text of a page of the repository."""
    return (PAGES / page).read_text(encoding="utf-8")


def yaml_of(page: str, start: str) -> str:
    """The page's first block of YAML that begins with a text."""
    found = re.search(rf"```yaml\n({re.escape(start)}.*?)```", page_text(page), re.S)
    assert found is not None, f"{page} has no YAML that begins with {start}"
    return found[1]


def the_complete_rig(folder: Path) -> None:
    """``duffing.yaml`` as the guide to rig files has it."""
    (folder / "duffing.yaml").write_text(yaml_of("docs/how-to/write-a-rig-file.md", "name:"), encoding="utf-8")


def the_rig_is_named(folder: Path) -> None:
    """The line of the sidecar that the tutorial tells to replace."""
    (asked,) = re.findall(
        r"in the place of the line `(# rig: my_rig\.yaml) …` write", page_text("docs/tutorial.md"), re.I
    )
    (answer,) = re.findall(r"^rig: .*", page_text("docs/tutorial.md"), re.M)
    sidecar = folder / "measured.yaml"
    text, count = re.subn(rf"{asked}.*", answer, sidecar.read_text(encoding="utf-8"))
    assert count == 1
    sidecar.write_text(text, encoding="utf-8")


def points(folder: Path, name: str) -> Any:
    """Table of a run, one row a level with values."""
    result = nmt.open(folder / name)
    table = result.to_dataframe()
    return table[table.status == "OK"] if "status" in table else table


def document(folder: Path, name: str) -> Any:
    """A JSON file of a results folder."""
    return json.loads((folder / name).read_text(encoding="utf-8"))


def falls(name: str, by_hz: float) -> Callable[[Path], None]:
    """Frequency falls from the first level to the last by at least some hertz; negative = it rises."""

    def holds(folder: Path) -> None:
        frequency = points(folder, name).frequency_hz.to_numpy()
        change = frequency[0] - frequency[-1]
        assert change >= by_hz if by_hz > 0.0 else change <= by_hz, f"{name}: {change}"

    return holds


def every_level(number: int) -> str:
    """Sentence at the end of a run of which every level locked."""
    return rf"\b{number} of {number} levels locked and extracted"


def tip_of_the_tutorial(folder: Path) -> None:
    table = points(folder, "out/tip")
    assert 0.85 < table.pbmif.min() < 0.865
    assert table.gamma_force.min() < 0.9  # strong harmonics of the force


def point_of(folder: Path) -> None:
    """The verdict of the tutorial's section 11."""
    found = document(folder, "out/mass/diagnosis.json")
    first = found["ranking"][0]
    assert found["verdict"] == "effect"
    assert {first["effect"], *first["equivalents"]} == {"sensor_mass", "added_mass"}
    assert {place["detail"] for place in found["where"]} == {"x5", "5"}
    mass = first["parameters"]["m"]
    assert abs(mass["value"] - 0.004) < max(3.0 * mass["std"], 2e-5)
    assert found["gap"]["closed"] > 0.99
    model = (folder / "out/mass/model.yaml").read_text(encoding="utf-8")
    assert re.search(r"mass_kg: *0\.00(?:39|40)\d", model), "model.yaml has no mass of 4 g"


def the_spring_is_found(folder: Path) -> None:
    (shown,) = re.findall(r"comes out as \((\S+) ± (\S+)\)·10⁹ N/m³", page_text("docs/tutorial.md"))
    found = document(folder, "out/why/diagnosis.json")
    (moved,) = [it for it in found["calibration"] if it["name"].endswith("stiffness_n_m3")]
    assert moved["to"] / 1e9 == float(shown[0]) or abs(moved["to"] / 1e9 - float(shown[0])) < float(shown[1])
    assert abs(moved["to"] - 1.2e9) < 3.0 * moved["std"]


def the_mended_model_is_the_specimen(folder: Path) -> None:
    mended, specimen = points(folder, "out/mended"), points(folder, "out/specimen")
    np.testing.assert_allclose(mended.frequency_hz, specimen.frequency_hz, rtol=1e-3)


def equal_again(levels: int) -> tuple[str, ...]:
    return (rf"Equal to the live results bit for bit \({levels} of {levels} levels compared\)\.",)


def limit_cycles(folder: Path) -> None:
    """Of the tutorial's section 13: damping changes its sign near 1.8 and 5.4 mm."""
    table = points(folder, "out/subcritical")
    level, damping = table.level.to_numpy(), table.damping_ratio.to_numpy()
    signs = np.sign(damping)
    (first,), (second,) = np.nonzero((signs[:-1] > 0) & (signs[1:] < 0)), np.nonzero((signs[:-1] < 0) & (signs[1:] > 0))
    crossings = [
        float(np.interp(0.0, sorted(damping[k : k + 2]), level[k : k + 2][np.argsort(damping[k : k + 2])]))
        for k in (first[0], second[0])
    ]
    assert abs(crossings[0] - 1.8e-3) < 1e-4
    assert abs(crossings[1] - 5.4e-3) < 1e-4


def third_harmonic_resonates(folder: Path) -> None:
    """The third harmonic of the response is held at its lag, outgrows the fundamental, and hardens with the force."""
    good = nmt.open(folder / "out/superharmonic").good_points  # type: ignore[attr-defined]
    share = [float(np.abs(it.shape_harmonics[3]).max() / np.abs(it.shape_harmonics[1]).max()) for it in good]
    assert max(abs(it.phase_error) for it in good) < 1e-3
    assert share == sorted(share)
    assert share[-1] > 2.0
    assert good[-1].frequency_hz > 1.2 * good[0].frequency_hz


def no_force_harmonics(folder: Path) -> None:
    assert points(folder, "out/controlled").gamma_force.min() > 0.9999


def isola_row(folder: Path, place: str) -> Any:
    table = nmt.open(folder / "out/isola").to_dataframe()
    return table[table.place == place].iloc[0]


def the_isola(folder: Path) -> None:
    """It has a tip above its lower end, at a higher frequency."""
    tip, end = isola_row(folder, "tip"), isola_row(folder, "end")
    assert tip.drive_point_m > 2.0 * end.drive_point_m
    assert tip.excitation_hz > end.excitation_hz


def modes_near_each_other(folder: Path) -> None:
    """Bending and torsion, 2 % apart."""
    frequency = sorted(nmt.open(folder / "out/linear").to_dataframe().frequency_hz)
    assert 0.015 < frequency[1] / frequency[0] - 1.0 < 0.025


def curve_with_an_unstable_branch(folder: Path) -> None:
    curves = nmt.open(folder / "out/curves").response_curves  # type: ignore[attr-defined]
    assert len(curves) == 2
    assert (folder / "out/curves/response_folds.csv").read_text(encoding="utf-8").count("\n") > 2


def cubic_at_five(folder: Path) -> None:
    """The spring of the guide: 2.0e7 N/m³ at point 5."""
    found = document(folder, "diagnosis/diagnosis.json")
    first = found["ranking"][0]
    assert (found["verdict"], first["effect"], first["detail"]) == ("effect", "cubic_stiffness", "5")
    assert first["probability"] > 0.97
    assert abs(first["parameters"]["k"]["value"] - 2.0e7) < 3.0 * first["parameters"]["k"]["std"]


def the_rig_of_the_guide(folder: Path) -> None:
    """The beam with the hardening spring and the noise that the page shows."""
    import yaml

    from nmt_rig.rig import find_rig

    changes = yaml.safe_load(yaml_of("docs/how-to/diagnose.md", "local_elements:"))
    content = yaml.safe_load(find_rig("beam").read_text(encoding="utf-8"))
    content["local_elements"] += changes["local_elements"]
    noise = {it["quantity"]: it for it in changes["sensors"]}
    for sensor in content["sensors"]:
        found = noise.get(sensor["quantity"], {})
        sensor.update({name: value for name, value in found.items() if name.startswith("noise_")})
    (folder / "real.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")


def moved_by_the_harmonics(folder: Path) -> None:
    """Every second level is measured without control first; ``modal.csv`` says how far control moves it."""
    with (folder / "out/compared/modal.csv").open(encoding="utf-8") as file:
        assert {"frequency_moved", "damping_moved"} <= set(next(csv.reader(file)))


def cubic_is_investigated(folder: Path) -> None:
    found = document(folder, "out/investigation/diagnosis/diagnosis.json")
    first = found["ranking"][0]
    assert (found["verdict"], first["effect"], first["detail"]) == ("effect", "cubic_stiffness", "5")
    assert first["probability"] >= 0.95
    assert abs(first["parameters"]["k"]["value"] - 2.0e7) < 3.0 * first["parameters"]["k"]["std"]


def recordings_at_hand(folder: Path) -> None:
    """A linear test and levels of the guide's rig, which the page takes for granted."""
    the_rig_of_the_guide(folder)
    for words in ("linear real.yaml --out out/linear", "run real.yaml --levels 0.05:1.5:5 --out out/levels"):
        subprocess.run([str(PAGES / "nmt"), *words.split(), "--quiet"], cwd=folder, capture_output=True, check=True)


def next_tests_are_named(folder: Path) -> None:
    assert document(folder, "out/next/diagnosis/diagnosis.json")["ranking"]


def the_one_mode_rig(folder: Path) -> None:
    text = yaml_of("docs/how-to/one-mode-model.md", "name: one_mode\n")
    (folder / "one_mode.yaml").write_text(text, encoding="utf-8")


def computed_curves_agree(folder: Path) -> None:
    """Folds that were measured at 0.16 N are those that are computed, within 0.1 % of the frequency."""
    with (folder / "out/curves/response_folds.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["place"] == "fold" and float(row["level"]) == 0.16]
    measured = sorted(float(row["frequency_hz"]) for row in rows)
    with (folder / "out/model/response_folds.csv").open(encoding="utf-8") as file:
        computed = sorted(float(row["frequency_hz"]) for row in csv.DictReader(file) if float(row["force_n"]) == 0.16)
    np.testing.assert_allclose(measured, computed, rtol=1e-3)


def held_responses(folder: Path) -> None:
    """Six amplitudes, every point of which locked, and a force surface between neighbouring ones."""
    from nmt_extract.curves.force_surface import ForceSurface

    curves = nmt.open(folder / "out/held").response_curves  # type: ignore[attr-defined]
    assert len(curves) == 6
    assert ForceSurface.of(curves).cut(0.15)


def tip_of_the_isola(folder: Path) -> None:
    """The synthesis from the backbone foretells the tip within 2 % in frequency and 3 % in amplitude."""
    (point,) = nmt.open(folder / "out/subharmonic").good_points  # type: ignore[attr-defined]
    tip = isola_row(folder, "tip")
    assert abs(3.0 * point.frequency_hz / tip.excitation_hz - 1.0) < 0.02
    assert abs(point.modal_amplitude / tip.modal_amplitude - 1.0) < 0.03


def linear_test_of_the_joint(folder: Path) -> None:
    """The linear test of the how-to before."""
    words = "linear joint_resonator --out linear --quiet"
    subprocess.run([str(PAGES / "nmt"), *words.split()], cwd=folder, capture_output=True, check=True)


def _mac(folder: Path, name: str, least: float) -> None:
    """The mode is isolated: linear at the lowest level; a joint changes its shape at higher ones."""
    mac = points(folder, name).mac.to_numpy()
    assert mac[0] > 0.999
    assert mac.min() > least


def examples_at_hand(folder: Path) -> None:
    """The data sets of the clone."""
    shutil.copytree(PAGES / "examples", folder / "examples", dirs_exist_ok=True)


def the_spring_is_cubic(folder: Path) -> None:
    """The oscillator of examples/measured_data.py: 2.4e9 N/m³."""
    first = document(folder, "out/why/diagnosis.json")["ranking"][0]
    assert first["effect"] == "cubic_stiffness"
    assert abs(first["parameters"]["k"]["value"] - 2.4e9) < 3.0 * first["parameters"]["k"]["std"] < 0.1 * 2.4e9


def the_root_is_soft(folder: Path) -> None:
    """The strip of examples/measured_data.py: 0.7 of the stiffness of its root."""
    first = document(folder, "out/root/diagnosis.json")["ranking"][0]
    assert (first["effect"], first["detail"]) == ("local_stiffness", "root")
    factor = next(iter(first["parameters"].values()))
    assert abs(factor["value"] - 0.7) < 0.005


READER = "the reader's converter, sensors or machines"
FILES = "the reader's files, which the page describes"
WAITS = "it waits for a person"
DEVELOPER = "a developer's command; the suite itself runs these tests"

DIFFERING_BENCH = {
    "./nmt import examples/bench/measured.yaml --out out/measured": Answer(
        prints=(r"3 N down +47 Hz +54 Hz +141 rows: frequency_hz, real, imag",), before=examples_at_hand
    ),
    "./nmt diagnose --model examples/bench/one_mode.yaml --real out/measured --out out/why": Answer(
        prints=(r"Verdict: the model lacks cubic stiffness \(the structure, point 1\)",), holds=the_spring_is_cubic
    ),
}
DIFFERING_ROBOT = {
    "./nmt diagnose --model examples/robot/arm.xml --real examples/robot/log.npz --out out/robot": Answer(
        prints=(r"shoulder +nothing: as in the model", r"elbow +Coulomb friction 1\.4\d* ± 0\.0\d+ N·m \(model 0\.5\)"),
        before=examples_at_hand,
    )
}

ANSWERS: dict[str, dict[str, Answer]] = {
    "README.md": {
        **DIFFERING_BENCH,
        "./nmt demo": Answer(prints=(every_level(10),)),
        "./nmt run beam --exciter 4 --levels 0.5:15:10 --out out/point4": Answer(prints=(every_level(10),)),
        "./nmt extract out/point4 --out out/again": Answer(prints=equal_again(10)),
        "./nmt figures out/point4 --format pdf --width 85mm": Answer(prints=(r"10 figures in out/point4/figures",)),
        **DIFFERING_ROBOT,
    },
    "docs/start/bench.md": DIFFERING_BENCH,
    "docs/start/robot.md": DIFFERING_ROBOT,
    "docs/start/finite-elements.md": {
        "./nmt import examples/strip/measured.yaml --out out/strip": Answer(
            prints=(r"1081 rows: frequency_hz, real, imag",), before=examples_at_hand
        ),
        "./nmt diagnose --model examples/strip/strip.yaml --real out/strip --out out/root": Answer(
            prints=(r"Verdict: the model is too stiff \(the structure, root\)",), holds=the_root_is_soft
        ),
        "./nmt rigs --check examples/strip/strip.npz --units mm-t-N": Answer(
            prints=(r"rows: 1080, 360 nodes", r"mass: 0\.19116 kg in x", r"frequencies: 56\.23\d+, 353\.77")
        ),
    },
    "docs/start/ros.md": {
        "./nmt ros nmt_plant plant --ros-args -p rig_file:=beam": Answer(tested_by="node/test_plant_node.py")
    },
    "docs/start/developer.md": {"./nmt setup": Answer(not_run=DEVELOPER), "./nmt test": Answer(not_run=DEVELOPER)},
    "docs/tutorial.md": {
        "./nmt demo": Answer(prints=(every_level(10),), table=True),
        "./nmt run beam --levels 0.2:0.5:4 --periods 60 --out out/onset": Answer(prints=(every_level(4),)),
        "./nmt run beam --exciter 6 --levels 2:10:4 --periods 60 --out out/tip": Answer(
            prints=(every_level(4),), holds=tip_of_the_tutorial
        ),
        "./nmt run beam --set local_elements.joint.slip_force_n=0.5 --levels 0.1:1:4 --periods 60 --out out/softer": (
            Answer(prints=(every_level(4),), holds=falls("out/softer", 3.0))
        ),
        "./nmt run beam --set local_elements.joint.slip_force=2 --out out/wrong": Answer(
            prints=(r"unknown key local_elements\.0\.slip_force; did you mean slip_force_n\?",), code=2
        ),
        "./nmt extract out/demo --out out/again": Answer(prints=equal_again(10)),
        "./nmt extract out/demo --harmonics 15 --out out/more": Answer(prints=(every_level(10),)),
        "./nmt run duffing.yaml --out out/duffing": Answer(
            prints=(every_level(5),), holds=falls("out/duffing", -0.3), before=the_complete_rig
        ),
        "./nmt run duffing.yaml --set local_elements.hardening.stiffness_n_m3=1.2e9 --levels 0.1,0.2,0.4 --periods 60 "
        "--out out/specimen": Answer(prints=(every_level(3),)),
        "./nmt export out/specimen --format csv --out out/columns": Answer(prints=(r"data\.csv",)),
        "cp out/columns/data.csv measured.csv": Answer(
            holds=lambda folder: _begins(folder / "measured.csv", "time [s],f1 [N],a1 [m/s^2],a2 [m/s^2]")
        ),
        "./nmt import --init measured.csv": Answer(prints=(r"# rig: my_rig\.yaml", r"kind: record")),
        "./nmt import measured.yaml --out out/theirs": Answer(
            prints=(r"f1 +f1 \[N\] +force +1 +-0\.4 N +0\.4 N",), before=the_rig_is_named
        ),
        "./nmt diagnose --model duffing.yaml --real out/theirs --out out/why": Answer(
            prints=(
                r"Verdict: the model's own parameters were off\n",
                r"Where     The gap lies in parameters that the model already has\.",
            ),
            holds=the_spring_is_found,
        ),
        "./nmt run out/why/model.yaml --levels 0.1,0.2,0.4 --periods 60 --out out/mended": Answer(
            prints=(every_level(3),), holds=the_mended_model_is_the_specimen
        ),
        "./nmt run out/why/model.yaml --pacing realtime --page --levels 0.1,0.2,0.4 --out out/watched": Answer(
            tested_by="node/test_live_page.py"
        ),
        "./nmt page out/watched": Answer(tested_by="node/test_live_page.py"),
        "./nmt shell": Answer(not_run=WAITS),
        "./nmt linear joint_resonator --out out/linear": Answer(
            prints=(r"Linear modes: value ± standard uncertainty", r"1 \(target\) +370\.00\d+")
        ),
        "./nmt run joint_resonator --linear out/linear/linear.json --out out/joint": Answer(prints=(every_level(16),)),
        "./nmt sweep joint_resonator --force 14.65,38.15 --from 350 --to 390 --out out/sweep": Answer(
            prints=(r"14\.65 N, a1: peak 420\.\d m/s²",)
        ),
        "./nmt synthesis --backbone out/joint --linear out/linear/linear.json --sweep out/sweep --out out/synthesis": (
            Answer(prints=(r"synthesis: peak [+-]0\.[0-7]\d %, frequency [+-]0\.0(?:0\d|10) %",))
        ),
        './nmt run beam --set "structure.added_masses=[{point: 5, mass_kg: 0.004}]" --levels 0.05:1.5:8 --periods 60 '
        "--out out/heavy": Answer(prints=(every_level(8),)),
        "./nmt diagnose --model beam --real out/heavy --out out/mass": Answer(
            prints=(r"Verdict: the model lacks sensor mass or added mass",), holds=point_of
        ),
        "./nmt run strong_cubic --resonance 3:1 --control force --levels 4.8,16 --out out/superharmonic": Answer(
            prints=(every_level(2), r"Ω/2π"), holds=third_harmonic_resonates
        ),
        "./nmt run subcritical --kind self_excited --out out/subcritical": Answer(
            prints=(r"Unstable limit cycle at q = 0\.0023", r"Stable limit cycle at q = 0\.0071"), holds=limit_cycles
        ),
        "./nmt run beam --pacing realtime --out out/stopped": Answer(tested_by="node/test_signals.py"),
    },
    "CONTRIBUTING.md": {"./nmt setup": Answer(not_run=DEVELOPER), "./nmt test": Answer(not_run=DEVELOPER)},
    "docs/explanation/blind-check.md": {
        "./nmt blind make  --rig beam --cases 400 --seed 1001 --sealed --out check": Answer(
            tested_by="blind/test_small_sealed_campaign.py"
        ),
        "./nmt blind run   --out check": Answer(tested_by="blind/test_small_sealed_campaign.py"),
        "./nmt blind score --out check": Answer(tested_by="blind/test_small_sealed_campaign.py"),
        "./nmt blind explain 17 --out check": Answer(tested_by="blind/test_explain.py"),
        "./nmt blind laboratory cases --out answers": Answer(tested_by="blind/test_foreign_laboratory.py"),
        "./nmt blind laboratory cases --out answers --only beam_3,plate_1 --force": Answer(
            tested_by="blind/test_foreign_laboratory.py"
        ),
        "./nmt blind laboratory two --out answers": Answer(tested_by="blind/test_foreign_laboratory.py"),
    },
    "docs/how-to/add-a-kind-of-test.md": {
        "./nmt test tests/core tests/pll tests/matrix tests/session/test_kinds_of_test.py": Answer(not_run=DEVELOPER)
    },
    "docs/how-to/add-a-local-element.md": {
        "./nmt test tests/rig tests/diagnose/test_registry_of_forces.py tests/diagnose/test_predicted_effects.py "
        "tests/docs": Answer(not_run=DEVELOPER)
    },
    "docs/how-to/add-a-measured-quantity.md": {"./nmt test tests/extract tests/core": Answer(not_run=DEVELOPER)},
    "docs/how-to/bring-your-converter.md": {
        "./nmt check laboratory.yaml": Answer(tested_by="node/test_custom_converter.py"),
        "./nmt run laboratory.yaml --out out/test": Answer(tested_by="node/test_custom_converter.py"),
    },
    "docs/how-to/bring-your-own-data.md": {
        "./nmt import --init run.csv": Answer(not_run=FILES),
        "./nmt import run.yaml --out out/theirs": Answer(not_run=FILES),
        "./nmt extract out/theirs --out out/theirs-modal": Answer(not_run=FILES),
    },
    "docs/how-to/control-force-harmonics.md": {
        "./nmt run beam --harmonics-control auto --out out/controlled": Answer(
            prints=(every_level(10),), holds=no_force_harmonics
        ),
        "./nmt run beam --harmonics-control 9 --compare 2 --out out/compared": Answer(
            prints=(every_level(15),), holds=moved_by_the_harmonics
        ),
        "./nmt run beam --harmonics-control auto --harmonics-target modal --set extraction.linear_modes=3 "
        "--out out/modal": Answer(prints=(every_level(10),)),
    },
    "docs/how-to/diagnose-a-record.md": {
        line: Answer(tested_by="diagnose/test_silverbox_diagnosis.py::test_the_silverbox_lacks_a_cubic_spring")
        for line in (
            "./nmt import multisine.yaml --out multisine",
            "./nmt import arrow.yaml --out arrow",
            "./nmt diagnose --model silverbox.yaml --real multisine --real arrow --hold-out arrow --out diagnosis",
        )
    },
    "docs/how-to/diagnose-a-robot.md": {
        "./nmt import --init log.npz --robot robot.xml": Answer(tested_by="robots/test_robot_diagnosis.py"),
        "./nmt diagnose --model robot.xml --real log.yaml --out out/robot": Answer(
            tested_by="robots/test_robot_diagnosis.py"
        ),
    },
    "docs/how-to/diagnose.md": {
        "./nmt run real.yaml --levels 0.05:1.5:12 --periods 40 --out levels": Answer(
            prints=(every_level(12),), before=the_rig_of_the_guide
        ),
        "./nmt linear real.yaml --band 5:1000 --out random": Answer(prints=(r"1 \(target\)",)),
        "./nmt diagnose --model beam --real levels --real random --out diagnosis": Answer(
            prints=(r"Verdict: the model lacks cubic stiffness \(the structure, point 5\)",), holds=cubic_at_five
        ),
    },
    "docs/how-to/finite-element-model.md": {
        "./nmt rigs --check strip.npz --units mm-t-N": Answer(
            tested_by="rig/test_finite_element_page.py::test_the_page_makes_a_rig_of_a_strip"
        )
    },
    "docs/how-to/impact-hammer.md": {
        "./nmt import tap.yaml --out tap": Answer(
            tested_by="diagnose/test_how_to_pages.py::test_the_files_of_the_page_read_a_tap"
        ),
        "./nmt diagnose --model clamped.yaml --real tap --out diagnosis": Answer(
            tested_by="diagnose/test_how_to_pages.py::test_the_files_of_the_page_read_a_tap"
        ),
        "./nmt import hits.yaml --out hits": Answer(
            tested_by="diagnose/test_how_to_pages.py::test_hits_of_a_hammer_give_the_modes_and_no_finding"
        ),
        "./nmt linear --bag hits --band 10:200 --out modes": Answer(
            tested_by="diagnose/test_how_to_pages.py::test_hits_of_a_hammer_give_the_modes_and_no_finding"
        ),
    },
    "docs/how-to/install.md": {
        "./nmt demo": Answer(prints=(every_level(10),)),
        "./nmt setup": Answer(not_run=DEVELOPER),
        "nmt extract BAG --out DIR": Answer(not_run="the wheel has a check of its own, .ci/wheel"),
    },
    "docs/how-to/investigate.md": {
        "./nmt investigate beam --rig real.yaml --until 0.95 --budget 300 --out out/investigation": Answer(
            holds=cubic_is_investigated, before=the_rig_of_the_guide
        ),
        "./nmt investigate beam --real out/linear --real out/levels --out out/next": Answer(
            holds=next_tests_are_named, before=recordings_at_hand
        ),
    },
    "docs/how-to/laser-and-current.md": {
        line: Answer(tested_by="diagnose/test_laser_and_current.py::test_the_page_finds_the_stiffness")
        for line in (
            "./nmt import scan.yaml --out scan",
            "./nmt diagnose --model plate.yaml --real scan --out diagnosis",
        )
    },
    "docs/how-to/linear-test.md": {
        "./nmt linear joint_resonator --out linear": Answer(prints=(r"1 \(target\) +370\.00\d+", r": linear\.")),
        "./nmt run joint_resonator --linear linear/linear.json --out run": Answer(prints=(every_level(16),)),
    },
    "docs/how-to/live-page.md": {
        "./nmt run beam --page --pacing realtime --out out/beam": Answer(tested_by="node/test_live_page.py")
    },
    "docs/how-to/many-machines.md": {
        "./nmt study noise --scheduler tcp://HOST:8786 --out out/noise": Answer(
            tested_by="study/test_scheduler.py::test_a_killed_worker_costs_no_case_of_a_study"
        ),
        "./nmt blind make --seed 7 --scheduler tcp://HOST:8786 --out /shared/campaign": Answer(
            tested_by="study/test_scheduler.py::test_a_killed_worker_costs_no_case_of_a_blind_check"
        ),
    },
    "docs/how-to/one-mode-model.md": {
        "./nmt linear one_mode.yaml --out out/linear": Answer(
            prints=(r"1 \(target\) +133\.1",), before=the_one_mode_rig
        ),
        "./nmt reference one_mode.yaml --out out/reference": Answer(prints=(r"modal frequency 133\.1",)),
        "./nmt run one_mode.yaml --out out/run": Answer(prints=(every_level(8),)),
        "./nmt import frf.yaml --out frf": Answer(
            tested_by="diagnose/test_how_to_pages.py::test_the_files_of_the_one_mode_model_read_a_frequency_response"
        ),
        "./nmt diagnose --model one_mode.yaml --real frf --out fitted": Answer(
            tested_by="diagnose/test_how_to_pages.py::test_the_files_of_the_one_mode_model_read_a_frequency_response"
        ),
    },
    "docs/how-to/response-curves.md": {
        "./nmt run strong_cubic --kind response_curve --levels 0.16,0.48 --lag 12:172 --periods 20 --ramp 0.3 "
        "--out out/curves": Answer(holds=curve_with_an_unstable_branch),
        "./nmt reference strong_cubic --forces 0.16,0.48 --band 12:40 --out out/model": Answer(
            holds=computed_curves_agree
        ),
        "./nmt run strong_cubic --kind response_curve --control response --levels 0.0002:0.0004:6 --lag 40:140 "
        "--periods 20 --ramp 0.3 --out out/held": Answer(holds=held_responses),
    },
    "docs/how-to/robot-joint.md": {
        line: Answer(tested_by="diagnose/test_how_to_pages.py::test_the_friction_of_the_joint_is_found")
        for line in (
            "./nmt import elbow.yaml --out elbow",
            "./nmt diagnose --model arm.yaml --real elbow --out diagnosis",
        )
    },
    "docs/how-to/run-on-hardware.md": {
        "./nmt check my_rig.yaml": Answer(not_run=READER),
        "./nmt linear my_rig.yaml --out out/linear": Answer(not_run=READER),
        "./nmt run my_rig.yaml --linear out/linear --out out/test1": Answer(not_run=READER),
        "./nmt sweep my_rig.yaml --force 1 --from 20 --to 25 --rate 0.1 --out out/sweep": Answer(not_run=READER),
        "./nmt specimen beam --set sample_rate_hz=48000 --set block_samples=960": Answer(
            tested_by="node/test_converters.py"
        ),
        "./nmt check beam --device portaudio --set sample_rate_hz=48000 --set block_samples=960 --out out/check": (
            Answer(tested_by="node/test_converters.py")
        ),
        "./nmt run beam --device portaudio --set sample_rate_hz=48000 --set block_samples=960 --out out/test": Answer(
            tested_by="node/test_converters.py"
        ),
        "./nmt params bench.yaml --out out/test1": Answer(tested_by="bench/test_params_command.py"),
    },
    "docs/how-to/run-on-two-hosts.md": {"./nmt shell": Answer(not_run=READER)},
    "docs/how-to/secondary-resonances.md": {
        "./nmt run internal_resonance --control response --levels 0.0005:0.0028:6 --refine 0.0005 --direction both "
        "--out out/internal": Answer(prints=(r"levels locked and extracted",)),
        "./nmt run strong_cubic --resonance 3:1 --control force --levels 4.8,8,11.2,16 --out out/superharmonic": Answer(
            prints=(every_level(4),), holds=third_harmonic_resonates
        ),
        "./nmt run strong_cubic --control response --levels 0.0002:0.0024:10 --out out/primary": Answer(
            prints=(every_level(10),), holds=falls("out/primary", -5.0)
        ),
        "./nmt synthesis --backbone out/primary --resonance 1:3 --levels 9.6 --out out/isola": Answer(holds=the_isola),
        "./nmt run strong_cubic --resonance 1:3 --control force --levels 9.6 --release 0.00075 --out out/subharmonic": (
            Answer(prints=(every_level(1),), holds=tip_of_the_isola)
        ),
    },
    "docs/how-to/self-excited-rigs.md": {
        "./nmt run subcritical --kind self_excited --out out/subcritical": Answer(
            prints=(r"Unstable limit cycle at q = 0\.0023", r"Stable limit cycle at q = 0\.0071"), holds=limit_cycles
        ),
        "./nmt run van_der_pol --kind self_excited --out out/van_der_pol": Answer(prints=(r"Stable limit cycle at q",)),
        "./nmt run belt --kind self_excited --levels 0.001:0.0038:8:linear --out out/belt": Answer(
            prints=(r"limit cycle at q",)
        ),
        "./nmt extract out/belt --out out/again": Answer(prints=(r"Equal to the live results bit for bit",)),
    },
    "docs/how-to/several-exciters.md": {
        "./nmt linear frame --near 100 --out out/linear": Answer(holds=modes_near_each_other),
        "./nmt run frame --linear out/linear/linear.json --out out/frame": Answer(
            prints=(r"levels locked and extracted",), holds=lambda folder: _mac(folder, "out/frame", 0.94)
        ),
        "./nmt run frame --set test.mode=2 --out out/torsion": Answer(
            prints=(r"levels locked and extracted",), holds=lambda folder: _mac(folder, "out/torsion", 0.94)
        ),
        "./nmt run frame --exciter 1 --out out/one": Answer(prints=(r"8 another mode",), code=3),
        "./nmt run beam_two_shakers --out out/beam": Answer(
            prints=(r"levels locked and extracted",), holds=lambda folder: _mac(folder, "out/beam", 0.94)
        ),
    },
    "docs/how-to/several-units.md": {
        "./nmt diagnose --model leg.yaml --group units.csv --out out/legs": Answer(
            tested_by="bench/test_group_diagnosis.py"
        ),
        "./nmt diagnose --model robot.xml --real log-a.yaml --real log-b.yaml --group legs.csv --out out/legs": Answer(
            tested_by="robots/test_alike_joints.py"
        ),
    },
    "docs/how-to/studies.md": {
        "./nmt study exciter_location --out exciter": Answer(
            prints=(r"holds: The PBMIF deviates considerably from one at point 6",)
        ),
        "./nmt study all --out studies": Answer(not_run="half an hour and more; each study has its own command"),
        "./nmt study all --quick --out look": Answer(prints=(r"results in look",)),
    },
    "docs/how-to/sweeps-and-synthesis.md": {
        "./nmt run joint_resonator --out backbone": Answer(prints=(every_level(16),), before=linear_test_of_the_joint),
        "./nmt sweep joint_resonator --force 14.65,38.15 --from 350 --to 390 --rate 0.2 --out up": Answer(
            prints=(r"14\.65 N, a1: peak 420\.\d m/s²",)
        ),
        "./nmt sweep joint_resonator --force 14.65,38.15 --from 350 --to 390 --rate 0.2 --direction down --out down": (
            Answer(prints=(r"14\.65 N, a1: peak 42\d\.?\d* m/s²",))
        ),
        "./nmt sweep joint_resonator --force 14.65,38.15 --from 364 --to 372 --stepped 33 --out steps": Answer(
            prints=(r"14\.65 N, a1: peak 4[12]\d",)
        ),
        "./nmt synthesis --backbone backbone --linear linear/linear.json --sweep up --sweep down --sweep steps "
        "--out synthesis": Answer(prints=(r"synthesis: peak [+-]0\.\d+ %",)),
    },
    "docs/how-to/write-a-rig-file.md": {
        "./nmt run duffing.yaml --out out/duffing": Answer(
            prints=(every_level(5),), holds=falls("out/duffing", -0.3), before=the_complete_rig
        ),
        "./nmt run beam --set local_elements.joint.slip_force_n=2 --set exciter.point=4 --out out/variant": Answer(
            prints=(every_level(10),)
        ),
    },
    "docs/reference/commands.md": {
        "./nmt figures out/demo --format pdf --width 85mm": Answer(not_run="README has the same on a run of its own")
    },
    "docs/reference/parameters.md": {
        "./nmt params beam --out out/params": Answer(tested_by="bench/test_params_command.py"),
        "./nmt ros nmt_pll pll --ros-args --params-file out/params/nodes.yaml": Answer(
            tested_by="bench/test_params_command.py"
        ),
    },
    "docs/verified.md": {
        "./nmt linear joint_resonator --out linear": Answer(prints=(r"1 \(target\) +370\.00\d+",)),
        "./nmt run joint_resonator --linear linear/linear.json --out backbone": Answer(prints=(every_level(16),)),
        "./nmt sweep joint_resonator --force 14.65,38.15 --from 350 --to 390 --rate 0.2 --out sweep": Answer(
            prints=(r"14\.65 N, a1: peak 420\.\d m/s²",)
        ),
        "./nmt synthesis --backbone backbone --linear linear/linear.json --sweep sweep --out synthesis": Answer(
            prints=(r"synthesis: peak [+-]0\.[0-7]\d %, frequency [+-]0\.0(?:0\d|10) %",)
        ),
    },
}
"""Page -> its commands, in the order of the page -> what they answer."""


def _begins(path: Path, text: str) -> None:
    with path.open(encoding="utf-8") as lines:
        assert lines.readline().strip() == text
