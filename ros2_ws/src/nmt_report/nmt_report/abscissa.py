"""What modal properties are drawn over: modal amplitude, or modal acceleration where accelerations are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from nmt_core.numerics.arrays import FloatArray

if TYPE_CHECKING:
    from nmt_core.messages.modal_point import ModalPoint
    from nmt_report.run_data import ReferenceCurve, RunReportData


@dataclass(frozen=True)
class Abscissa:
    """One of the two.

    Attributes:
        label: of the axis.
        html: for captions.
        accelerations: ω̃²q, as in the paper's section 4, instead of q.
    """

    label: str
    html: Markup
    accelerations: bool

    def of_points(self, points: Sequence[ModalPoint]) -> tuple[FloatArray, FloatArray]:
        """Values and standard uncertainties, shape ``(points,)`` each."""
        q = np.array([point.modal_amplitude for point in points])
        q_std = np.array([point.modal_amplitude_std for point in points])
        if not self.accelerations:
            return q, q_std
        omega = np.array([point.omega_rad_s for point in points])
        omega_std = np.array([point.omega_rad_s_std for point in points])
        value = omega**2 * q
        return value, value * np.hypot(q_std / q, 2.0 * omega_std / omega)

    def of_curve(self, curve: ReferenceCurve) -> FloatArray:
        """Values of a computed backbone."""
        if self.accelerations:
            return np.asarray(curve.omega_rad_s**2 * curve.modal_amplitude, dtype=np.float64)
        return curve.modal_amplitude


_AMPLITUDE = Abscissa(r"modal amplitude $q$ / (m$\sqrt{\mathrm{kg}}$)", Markup("modal amplitude <i>q</i>"), False)
_ACCELERATION = Abscissa(
    r"modal acceleration $\tilde\omega^2 q$ / ((m/s²)$\sqrt{\mathrm{kg}}$)",
    Markup("modal acceleration ω̃²<i>q</i>"),
    True,
)


def abscissa_of(data: RunReportData) -> Abscissa:
    """Modal acceleration for rigs whose extraction is based on accelerations, else modal amplitude."""
    extraction = data.rig.get("extraction") or {}
    return _ACCELERATION if extraction.get("quantity") == "acceleration" else _AMPLITUDE
