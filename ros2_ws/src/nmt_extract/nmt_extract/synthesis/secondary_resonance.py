"""Secondary resonances from the backbone of the primary mode alone.

A mode whose stiffness grows with its amplitude as that of a spring w³ does, ω̃² = ω₁² + κ q², obeys

    q̈ + 2 δ̃ ω̃ q̇ + ω₁² q + (4/3) κ q³ = φ F cos Ωt.

κ comes from the measured backbone where it has hardened little. Besides the order in resonance the mode has the one
that the force drives directly, p = |φ F / (ω₁² + κ (p² + 2 a²) − Ω²)|. With one harmonic each (harmonic balance of two
orders, Nayfeh and Mook, Nonlinear Oscillations, 1979, section 4.1) the cubic couples the two:

* 1:3, subharmonic, order 1 with the amplitude a at the frequency ω = Ω/3:
  power balance   2 δ̃ ω̃ ω = κ a p sin 3φ,
  frequency       ω² = ω̃²(a) + 2 κ p² − κ a p cos 3φ.
  At an amplitude both signs of cos 3φ give a point: the isola. Where sin 3φ = 1 they meet: tip and lower end, θ = 90°.
* 3:1, superharmonic, order 3 with the amplitude a at the frequency 3Ω:
  at θ = 270°   2 δ̃ ω̃ · 3Ω · a = (κ/3) p³,   (3Ω)² = ω̃²(a) + 2 κ p².

δ̃ and ω̃ are interpolated along the backbone; nothing is extrapolated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from nmt_core.errors import BenchError
from nmt_core.messages.secondary_resonance import SecondaryResonance
from nmt_core.numerics.arrays import FloatArray
from nmt_extract.synthesis.single_mode import SynthesisedBackbone
from nmt_extract.synthesis.synthesised_responses import backbone_of_run

_GRID = 400
_SMALL = 0.5  # of the linear stiffness, up to which the hardening is taken for that of a cubic spring alone
_STEPS = 40  # of the fixed-point iterations


@dataclass(frozen=True, eq=False)
class SecondaryBackbone:
    """The resonant order where its lag is that of resonance, at one force.

    Attributes:
        modal_amplitude: a of each solution, m√kg, the largest first; 1:3: tip and lower end of the isola.
        excitation_hz: Ω/2π of each.
        curve_amplitude, curve_hz: 1:3: the isola, amplitude and excitation frequency; empty otherwise.
    """

    modal_amplitude: FloatArray
    excitation_hz: FloatArray
    curve_amplitude: FloatArray
    curve_hz: FloatArray


class SecondarySynthesis:
    """Synthesis from a backbone.

    Args:
        backbone: of the primary mode.
        drive_shape: φ at the drive point, 1/√kg.
        linear_frequency: ω₁, rad/s.

    Attributes:
        hardening: κ, rad²/s² per kg m².

    Raises:
        BenchError: the frequency of the backbone does not grow with the amplitude.
    """

    def __init__(self, backbone: SynthesisedBackbone, drive_shape: float, linear_frequency: float) -> None:
        self.backbone = backbone
        self.drive_shape = abs(drive_shape)
        self.linear = linear_frequency
        q = backbone.modal_amplitude
        change = backbone.omega_rad_s**2 - linear_frequency**2
        small = change < _SMALL * linear_frequency**2
        chosen = small if small.sum() > 1 else np.ones(q.size, bool)
        self.hardening = float((change * q**2)[chosen].sum() / (q**4)[chosen].sum())
        if not self.hardening > 0.0 or backbone.omega_rad_s[-1] <= backbone.omega_rad_s[0]:
            raise BenchError(
                "The frequency of this backbone does not grow with the amplitude; the synthesis of a secondary "
                "resonance is one of a hardening mode."
            )

    def forced_order(self, force: float, excitation: FloatArray, amplitude: FloatArray) -> FloatArray:
        """p, m√kg, of the order that the force (N) drives, at Ω (rad/s) next to a resonant order of amplitude a."""
        p = np.zeros_like(excitation)
        for _ in range(_STEPS):
            stiffness = self.linear**2 + self.hardening * (p**2 + 2.0 * amplitude**2)
            p = 0.5 * (p + np.abs(self.drive_shape * force / (stiffness - excitation**2)))
        return p

    def _at(self, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        omega, damping, _ = self.backbone.at(amplitude)
        return omega, damping

    def _subharmonic(self, force: float, amplitude: FloatArray, sign: float) -> tuple[FloatArray, FloatArray]:
        """ω and sin 3φ at amplitudes with a sign of cos 3φ (0: sin 3φ = 1 is supposed)."""
        omega, damping = self._at(amplitude)
        w = omega.copy()
        for _ in range(_STEPS):
            p = self.forced_order(force, 3.0 * w, amplitude)
            sine = 2.0 * damping * omega * w / (self.hardening * amplitude * p)
            cosine = sign * np.sqrt(np.maximum(1.0 - sine**2, 0.0))
            w = np.sqrt(omega**2 + 2.0 * self.hardening * p**2 - self.hardening * amplitude * p * cosine)
        return w, sine

    def _superharmonic(self, force: float, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        """3Ω, and the excitation of order 3 less what damping takes, at amplitudes."""
        omega, damping = self._at(amplitude)
        w = omega.copy()
        for _ in range(_STEPS):
            p = self.forced_order(force, w / 3.0, amplitude)
            w = np.sqrt(omega**2 + 2.0 * self.hardening * p**2)
        return w, self.hardening / 3.0 * p**3 - 2.0 * damping * omega * w * amplitude

    def solve(self, resonance: SecondaryResonance, force: float) -> SecondaryBackbone:
        """Where the lag is that of resonance, at a force in N; none where the resonance does not exist.

        Raises:
            BenchError: the force is not positive.
        """
        if not 0.0 < force < math.inf:
            raise BenchError(f"A synthesis needs a force above 0 N, got {force:g}.")
        q = self.backbone.modal_amplitude
        grid = np.geomspace(q[0], q[-1], _GRID)

        def balance(amplitude: FloatArray) -> FloatArray:
            if resonance.needs_release:
                return np.asarray(1.0 - self._subharmonic(force, amplitude, 0.0)[1])
            return self._superharmonic(force, amplitude)[1]

        values = balance(grid)
        places = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0.0)[::-1]
        found = np.array([brentq(lambda a: float(balance(np.array([a]))[0]), grid[k], grid[k + 1]) for k in places])
        if not resonance.needs_release:
            hertz = self._superharmonic(force, found)[0] / 3.0 / (2.0 * math.pi) if found.size else found
            return SecondaryBackbone(found, hertz, np.empty(0), np.empty(0))
        hertz = 3.0 * self._subharmonic(force, found, 0.0)[0] / (2.0 * math.pi) if found.size else found
        inside = grid[values > 0.0]
        branches = [3.0 * self._subharmonic(force, inside, sign)[0] / (2.0 * math.pi) for sign in (1.0, -1.0)]
        curve = np.concatenate([inside, found[:1], inside[::-1], found[1:]])
        curve_hz = np.concatenate([branches[0], hertz[:1], branches[1][::-1], hertz[1:]])
        return SecondaryBackbone(found, hertz, curve, curve_hz)


_COLUMNS = "force_n,place,modal_amplitude,drive_point_m,excitation_hz"


def secondary_csv(synthesis: SecondarySynthesis, resonance: SecondaryResonance, forces: Sequence[float]) -> str:
    """``secondary.csv``: where the lag is that of resonance (``tip``, ``end``), and the isola, row by row."""
    rows = [_COLUMNS]
    for force in forces:
        found = synthesis.solve(resonance, force)
        places = ("tip", "end", *("end",) * len(found.modal_amplitude))
        marked = list(zip(places, found.modal_amplitude, found.excitation_hz, strict=False))
        marked += [("isola", a, f) for a, f in zip(found.curve_amplitude, found.curve_hz, strict=True)]
        for place, amplitude, hertz in marked:
            values = (amplitude, amplitude * synthesis.drive_shape, hertz)
            rows.append(",".join([repr(float(force)), place, *(repr(float(value)) for value in values)]))
    return "\n".join(rows) + "\n"


def synthesise_secondary(backbone: Path | str, linear: Path | str | None = None) -> SecondarySynthesis:
    """From the results folder of a run of the primary mode.

    Args:
        backbone: results folder of ``./nmt run``, or a ``modal.json``.
        linear: ``linear.json``; None = the linear modes that the run used.

    Raises:
        BenchError: no such results, fewer than two levels that locked, or a mode that does not harden.
    """
    measured, description = backbone_of_run(Path(backbone), None if linear is None else Path(linear))
    return SecondarySynthesis(
        measured, description.drive_point_shape, description.frequencies_rad_s[description.target_mode]
    )
