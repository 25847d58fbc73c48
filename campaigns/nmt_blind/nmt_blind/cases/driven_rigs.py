"""Rigs that are driven blindly: a folder for each, with the model, the rig file of what is driven, and the truth.

``model.yaml`` is what its owner believes, ``real.yaml`` what is driven: a simulated rig with what it really has, or a
rig with a section ``device`` behind which a simulator of others answers. ``truth.yaml`` is that of a laboratory's case,
see :mod:`nmt_blind.campaign.foreign_case`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_blind.cases.blind_rigs import blind_rig
from nmt_blind.cases.draw import Case, TrueEffect, draw_cases
from nmt_blind.cases.injected_effects import INJECTED_EFFECTS, NEAR_TWINS
from nmt_blind.cases.operating import operating_point
from nmt_blind.cases.rig_edits import Edit, rig_yaml, with_edits
from nmt_blind.cases.tolerances import check_tolerances, draw_chain
from nmt_core.errors import BenchError
from nmt_core.files.whole_file import write_whole
from nmt_core.files.yaml_text import yaml_text
from nmt_core.tolerances import TOLERANCES
from nmt_rig.rig import Rig
from nmt_sequencer.level_plan import parse_levels

PAIR_FILE, CALIBRATION_FILE = "pair.txt", "calibration.yaml"
MODEL_FILE, REAL_FILE, TRUTH_FILE = "model.yaml", "real.yaml", "truth.yaml"
KINDS = ("null", "effect")
LEAST_SIZE = 3.0
"""Of an effect, see `InjectedEffect.natural`: what is smaller hides in noise and tolerances, whatever is measured."""

PAIR_SIZE = 10.0
"""Of the effects of pairs: a gain of size 3 is less than what matters."""

PAIRS: tuple[tuple[str, str], ...] = (
    *NEAR_TWINS,
    ("suspension_cubic", "cubic_stiffness"),
    ("cubic_stiffness", "two_sided_gap"),
    ("quintic_stiffness", "two_sided_gap"),
    ("one_sided_stop", "quadratic_stiffness"),
    ("force_factor_asymmetric", "quadratic_stiffness"),
    ("amplifier_saturation", "force_factor_symmetric"),
    ("source_impedance", "viscous_damping"),
    ("viscous_damping", "air_drag"),
    ("second_friction_contact", "microslip"),
    ("clamp_friction", "second_friction_contact"),
    ("clamp_compliance", "added_mass"),
    ("temperature_drift", "preload_loss"),
    ("force_cell_mass", "sensor_mass"),
    ("charge_high_pass", "channel_skew"),
    ("clipping", "amplifier_saturation"),
)
"""Effects that do nearly the same in the first two tests of an investigation, the true one of each rig among them."""

_BEYOND_TOLERANCE = 5.0
_TOLERATED = {
    "force_gain": TOLERANCES.gain,
    "response_gain": TOLERANCES.gain,
    "channel_skew": TOLERANCES.delay_s,
    "shared_delay": TOLERANCES.shared_delay_s,
    "clock_error": TOLERANCES.clock,
    "phase_offset": math.radians(TOLERANCES.loop_phase_deg),
}
"""What an ordinary chain has of an effect, in the effect's unit: what is not much larger is not a fault of a rig."""


@dataclass(frozen=True)
class DrivenRig:
    """A rig's folder.

    Attributes:
        folder: where it lies.
    """

    folder: Path

    @property
    def name(self) -> str:
        """That of the folder."""
        return self.folder.name

    @property
    def model(self) -> Path:
        """What is believed."""
        return self.folder / MODEL_FILE

    @property
    def real(self) -> Path:
        """What is driven."""
        return self.folder / REAL_FILE

    @property
    def pair(self) -> tuple[str, ...]:
        """Two effects that are hard to distinguish, one of which it has; empty where it is of no pair."""
        path = self.folder / PAIR_FILE
        return tuple(path.read_text(encoding="utf-8").split()) if path.is_file() else ()

    @property
    def calibration(self) -> Path | None:
        """What is known of its measuring chain; None where that measures as its rig file says."""
        path = self.folder / CALIBRATION_FILE
        return path if path.is_file() else None

    @property
    def truth(self) -> Path:
        """What is true of it."""
        return self.folder / TRUTH_FILE


def read_rigs(folder: Path, only: Sequence[str] = ()) -> list[DrivenRig]:
    """The rigs in a folder, by name.

    Args:
        folder: holds a folder for each rig; what has no ``truth.yaml`` is none.
        only: names of rigs; empty = all.

    Raises:
        BenchError: there is none, not the one that is named, or a file is missing.
    """
    found = [DrivenRig(path.parent.absolute()) for path in sorted(folder.glob(f"*/{TRUTH_FILE}"))]
    if not found:
        raise BenchError(
            f"The folder {folder} holds no rigs to be driven; each is a folder with {MODEL_FILE}, {REAL_FILE} and "
            f"{TRUTH_FILE}: make some with './nmt blind rigs'."
        )
    names = [rig.name for rig in found]
    for name in only:
        if name not in names:
            raise BenchError(f"There is no rig {name} in {folder}; it has {', '.join(names)}.")
    for rig in found:
        if not (rig.model.is_file() and rig.real.is_file()):
            raise BenchError(f"The rig {rig.folder} lacks {MODEL_FILE} or {REAL_FILE}; make it again.")
    return [rig for rig in found if not only or rig.name in only]


def make_rigs(out: Path, rig_name: str, seeds: Sequence[int], tolerances: str = "none") -> list[str]:
    """Draw rigs, a third of them healthy, the others with one effect, and write their folders, truth last.

    Args:
        out: gets a folder for each; one that has its truth is kept.
        rig_name: name of the blind rig.
        seeds: one a rig; the same seed gives the same rig.
        tolerances: of the measuring chain, ``none`` or ``laboratory``: gains, phases, hum and a clock are drawn for
            each rig, and a calibration file says how well they are known. Delays are none: a simulated rig that is
            driven is late along straight lines between samples, which no converter is. Hum is ordinary at the lowest
            level, too.

    Returns:
        Names of the rigs.

    Raises:
        BenchError: there is no such blind rig, or tolerances that do not exist.
    """
    check_tolerances(tolerances)
    rig, kind = blind_rig(rig_name), "_chain" if tolerances != "none" else ""
    model, names = rig.model(), []
    operating = None
    for seed in seeds:
        name = f"{rig_name}{kind}_{seed:04d}"
        names.append(name)
        folder = out / name
        if (folder / TRUTH_FILE).is_file():
            continue
        operating = operating or operating_point(model, rig.bench)
        wanted = KINDS[0 if seed % 3 == 0 else 1]
        # A healthy rig whose parameters are those of its model would be the model itself.
        case = next(
            (
                case
                for count in (24, 240)
                for case in draw_cases(model, operating, count, seed, (wanted,))
                if (case.effects or case.shifted) and all(_stands_out(effect) for effect in case.effects)
            ),
            None,
        )
        if case is None:
            raise BenchError(f"No effect that seed {seed} draws stands out of the noise; leave this seed out.")
        folder.mkdir(parents=True, exist_ok=True)
        edits = list(case.edits)
        if tolerances != "none":
            chain = draw_chain(model, operating, np.random.default_rng([seed, 6]))
            levels = parse_levels(model.test.levels)
            hums = tuple(hum * min(levels) / max(levels) for hum in chain.hums)
            exact = replace(chain, delays=(0.0,) * len(chain.delays), hums=hums)
            edits += exact.edits(with_edits(model, edits), operating.omega)
        real = with_edits(model, [*edits, Edit(("seed",), case.noise_seed)])
        write_whole(folder / MODEL_FILE, rig.file.read_text(encoding="utf-8"))
        write_whole(folder / REAL_FILE, rig_yaml(real))
        if tolerances != "none":
            write_whole(folder / CALIBRATION_FILE, yaml_text(calibration_of(model)))
        write_whole(folder / TRUTH_FILE, yaml_text(truth_of(case)))
    return names


def _stands_out(effect: TrueEffect) -> bool:
    """Whether an effect is more than noise hides and than an ordinary chain has."""
    return effect.size >= LEAST_SIZE and abs(effect.value) >= _BEYOND_TOLERANCE * _TOLERATED.get(effect.name, 0.0)


def calibration_of(rig: Rig) -> dict[str, Any]:
    """Content of a calibration file that states the ordinary tolerances of a rig's chain, from which it was drawn."""
    stated = {"gain_std": TOLERANCES.gain, "phase_std_deg": TOLERANCES.phase_deg, "delay_std_s": TOLERANCES.delay_s}
    kinds = dict.fromkeys(sensor.quantity for sensor in rig.sensors)
    channels = [{"quantity": kind, **stated} for kind in kinds if kind != "voltage"]
    # The delay of the drive against all sensors.
    voltage = {"quantity": "voltage", "gain_std": TOLERANCES.gain, "delay_std_s": TOLERANCES.shared_delay_s}
    return {"channels": [*channels, voltage], "clock_std": TOLERANCES.clock}


def make_pairs(out: Path, rig_name: str) -> list[str]:
    """Two rigs for each pair of effects that are hard to distinguish: one with the first, one with the other.

    Args:
        out: gets a folder for each; one that has its truth is kept.
        rig_name: name of the blind rig.

    Returns:
        Names of the rigs; effects that have no place on this rig have none.

    Raises:
        BenchError: there is no such blind rig.
    """
    rig = blind_rig(rig_name)
    model, names = rig.model(), []
    operating = operating_point(model, rig.bench)
    for number, pair in enumerate(PAIRS):
        for side, name in enumerate(pair):
            effect = INJECTED_EFFECTS[name]
            spots = effect.spots(model)
            if not spots:
                continue
            names.append(f"{rig_name}_pair_{number:02d}_{side}")
            folder = out / names[-1]
            if (folder / TRUTH_FILE).is_file():
                continue
            spot = spots[number % len(spots)]
            value = effect.value(model, operating, spot, PAIR_SIZE)
            true = TrueEffect(
                name, effect.place_at(model, spot), spot.label, PAIR_SIZE, value, effect.unit, effect.known,
                effect.figures(model, operating, spot, value),
            )  # fmt: skip
            edits = effect.edits(model, operating, spot, value)
            real = with_edits(model, [*edits, Edit(("seed",), 100 + 2 * number + side)])
            folder.mkdir(parents=True, exist_ok=True)
            write_whole(folder / MODEL_FILE, rig.file.read_text(encoding="utf-8"))
            write_whole(folder / REAL_FILE, rig_yaml(real))
            write_whole(folder / PAIR_FILE, " ".join((name, pair[1 - side])) + "\n")
            write_whole(folder / TRUTH_FILE, yaml_text(truth_of_effect(true)))
    return names


def truth_of(case: Case) -> dict[str, Any]:
    """Content of the ``truth.yaml`` of a drawn case without or with one effect of the library."""
    if not case.effects:
        # Parameters that are off by less than what matters are none.
        return {"kind": "healthy", "verdicts": ["none", "calibration"]}
    (effect,) = case.effects
    return truth_of_effect(effect)


def truth_of_effect(effect: TrueEffect) -> dict[str, Any]:
    """Content of the ``truth.yaml`` of a rig with one effect of the library."""
    return {
        "kind": "effect",
        "verdicts": ["effect"],
        "effects": [effect.name],
        "place": _place(effect),
        "parameters": dict(effect.figures),
        "remark": f"{effect.value:.4g} {effect.unit} at {effect.place} {effect.detail}, size {effect.size:g}",
    }


def _place(effect: TrueEffect) -> list[str]:
    """Words of which the stated place has to hold one; that of a force sensor may lack its channel."""
    words = [word for word in re.split(r"[^\w]+", effect.detail) if word]
    only = [effect.place] if effect.place == "force_sensor" or not words else []
    return [*words[:1], *only]
