"""What mesh, reduction and the law of damping of a finite-element model do to the shapes of its modes.

They change K by some δK. In modal coordinates its diagonal terms move each frequency, and a diagnosis fits that. Its
off-diagonal terms mix two shapes. Neither can be without the other: of two modes at one frequency any combination is a
mode, and the uncertainty must not depend on which is taken. Off-diagonal terms of a symmetric random matrix of that
kind have half of the variance of the diagonal ones (Mehta, Random Matrices, 2004, section 2.3). They move the zeros
between near resonances, which a lightly damped structure shows as sharply as the resonances.

The same holds for damping, which a law only approximates: a diagnosis fits that of each mode, and the coupling of two
is at most the root of their product, as the whole is to be passive.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from scipy.linalg import eigh

from nmt_core.numerics.arrays import FloatArray
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.chain.chain_tests import ChainTests
from nmt_diagnose.chain.modes_left_out import ModesLeftOut
from nmt_diagnose.observations.observables import FUNDAMENTAL, Part
from nmt_diagnose.prediction.forward import Prediction
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import MatricesSection, Rig
from nmt_rig.rig_model import build_plain_structure, completed_structure

# Of a standard deviation.
_STEP = 0.05
# Standard deviation of a uniform distribution between minus and plus one.
_UNIFORM = 3.0**-0.5


class CoupledModes:
    """Couplings between modes of the finite-element model of some tests that its mesh leaves open.

    Args:
        chain: the tests.
    """

    def __init__(self, chain: ChainTests) -> None:
        self.chain = chain

    def columns(self, base: Prediction) -> list[FloatArray]:
        """What one standard deviation of the coupling of each two near modes adds to the rows, (rows,) each.

        The change of a line is taken over its measured response, because near a zero its logarithm is not linear.

        Args:
            base: prediction of the chain's tests.
        """
        rig, section = self.chain.rig, self.chain.rig.structure
        # Matrices that stand in the rig file itself are a lumped model: no mesh and no reduction made them.
        if not isinstance(section, MatricesSection) or not section.source:
            return []
        bare = rig.model_copy(update={"structure": section.model_copy(update={"oscillators": []})})
        structure = build_plain_structure(rig)
        squares, shapes = eigh(structure.stiffness, structure.mass)
        omega, weighted = np.sqrt(np.maximum(squares, 0.0)), structure.mass @ shapes
        damping = np.einsum("ik,ij,jk->k", shapes, completed_structure(structure, bare).damping, shapes)
        found = []
        for first, second in self.pairs(omega / (2.0 * np.pi)):
            both = np.outer(weighted[:, first], weighted[:, second])
            stiffness = MODEL_PRIORS["frequency_factors"].std * np.sqrt(2.0) * omega[first] * omega[second]
            lossy = _UNIFORM * np.sqrt(max(damping[first] * damping[second], 0.0))
            for changed in (
                _with_added(rig, "stiffness", stiffness * (both + both.T)),
                _with_added(rig, "damping", lossy * (both + both.T)),
            ):
                found.append(self._change(base, changed))
        return [column for column in found if column.any()]

    def pairs(self, frequencies_hz: FloatArray) -> list[tuple[int, int]]:
        """Modes about the frequencies of the rows, two and two, that are near each other."""
        known, reach = self.chain.frequencies_hz, THRESHOLDS.misfit.shape_reach
        if not known.size:
            return []
        near = np.flatnonzero(
            (frequencies_hz >= float(known.min()) / reach) & (frequencies_hz <= float(known.max()) * reach)
        )
        return [
            (int(a), int(b)) for k, a in enumerate(near) for b in near[k + 1 :]
            if frequencies_hz[b] < reach * frequencies_hz[a]
        ]  # fmt: skip

    def _change(self, base: Prediction, rig: Rig) -> FloatArray:
        forward, rows = self.chain.forward, self.chain.rows
        change = forward.difference(forward.predict(rig, base).values, base.values) / _STEP
        change = np.nan_to_num(change, posinf=0.0, neginf=0.0)
        over, measured = ModesLeftOut(self.chain), self.chain.observations.values[self.chain.selected]
        for number, test in enumerate(self.chain.tests):
            if test.lines is None or not test.lines.broad_band:
                continue
            selected = np.flatnonzero((rows.test == number) & np.isin(rows.part, FUNDAMENTAL))
            apart = base.values - measured
            turned = over.logarithms(number, selected, change) * np.exp(over.logarithms(number, selected, apart))
            change[selected] = np.where(rows.part[selected] == Part.PHASE, turned.imag, turned.real)
        return change


def _with_added(rig: Rig, kind: Literal["stiffness", "damping"], added: FloatArray) -> Rig:
    """The rig with `_STEP` of a stiffness (N/m) or damping (N s/m) of the rows that move added to its structure."""
    section = rig.structure
    assert isinstance(section, MatricesSection)
    rows = section.moving_rows
    part = _STEP * added
    if kind == "stiffness":
        stiffness = np.array(section.stiffness_n_m)
        stiffness[np.ix_(rows, rows)] += part / section.stiffness_factor
        change: dict[str, Any] = {"stiffness_n_m": stiffness.tolist()}
    else:
        damping = np.zeros((len(section.mass_kg),) * 2)
        damping[np.ix_(rows, rows)] = build_plain_structure(rig).damping + part
        change = {"damping_ns_m": damping.tolist(), "damping_ratios": None, "damping_factor": 1.0}
    return rig.model_copy(update={"structure": section.model_copy(update=change)})
