"""What modes that a modal model leaves out add to measured responses."""

from __future__ import annotations

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.chain.chain_tests import ChainTests
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import ResponseLines
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import FUNDAMENTAL, parts_where
from nmt_diagnose.prediction.forward import Prediction
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import ModalSection


class ModesLeftOut:
    """Modes that the model of some tests leaves out.

    Args:
        chain: the tests.
    """

    def __init__(self, chain: ChainTests) -> None:
        self.chain = chain
        self.rows = chain.rows
        self.tests = chain.tests
        self.rig = chain.rig
        self.channels = chain.channels
        self.forward = chain.forward
        self.observations = chain.observations
        self.selected = chain.selected

    def columns(self, base: Prediction) -> list[FloatArray]:
        """What modes that a modal model leaves out add to responses over a force or at held amplitudes.

        Those above the band add a flexibility that rises towards the first of them, those below it minus one over a
        mass (Ewins, Modal Testing, 2000, section 4.3): unknown constants of either sign.
        """
        structure = self.rig.structure
        if not isinstance(structure, ModalSection) or structure.residual is not None:
            return []
        found = []
        resonance = self.chain.resonance()
        for channel, measured_channel in self.channels.items():
            if measured_channel.quantity not in MOTIONS:
                continue  # only motions
            columns = np.zeros((4, len(self.rows)))
            for number, test in enumerate(self.tests):
                if test.lines is None or not test.lines.over_force:
                    continue
                selected = np.flatnonzero((self.rows.test == number) & self.chain.rows_of(channel))
                frequency = self.rows.frequency_hz[selected]
                static = self._flexibility(test.lines, measured_channel)
                added = static * (2j * np.pi * frequency) ** MOTIONS[measured_channel.quantity]
                part = self.rows.part[selected]
                relative = np.isin(part, FUNDAMENTAL)
                added[relative] /= self._between(test.lines, number, selected, base)[relative]
                changed = np.where(np.isin(part, parts_where(lambda facts: facts.half == "im")), added.imag, added.real)
                share = frequency / np.max(frequency, initial=1.0)
                columns[:3, selected] = (
                    THRESHOLDS.misfit.static_share_above * changed * share ** np.array([[0.0], [2.0], [4.0]])
                )
                columns[3, selected] = THRESHOLDS.misfit.static_share_below * changed * (resonance / frequency) ** 2
            found += list(columns)
        return found

    def _flexibility(self, test: ResponseLines, channel: MeasuredChannel) -> float:
        """Displacement at a channel far below the first mode, m over the N of the force.

        Over the V of the drive where the test refers to the voltage, or the model has no force at the drive point.
        """
        view = ModelView.of(self.rig, test.drive_points)
        frequency = THRESHOLDS.misfit.static_frequency_ratio * self.chain.resonance()
        force = MeasuredChannel(f"f{test.drive_point}", Quantity.FORCE, test.drive_point, ideal=True)
        response, reference = view.responses((channel, force), np.array([frequency]))[:, 0]
        over = 1.0 if test.reference == "voltage" or not np.isfinite(reference) else abs(reference)
        return float(abs(response) / over / (2.0 * np.pi * frequency) ** MOTIONS[channel.quantity])

    def _between(self, test: ResponseLines, number: int, selected: IntArray, base: Prediction) -> ComplexArray:
        """Responses of rows that a small addition is compared with: measured ones, or between those and the model's.

        ln (1 + z) is z / √(1 + z) to the second order: of a linear test the geometric mean of both responses is taken,
        without the delay between them.
        """
        measured = test.measured_responses(self.rows.level[selected], self.rows.channel[selected])
        if measured is not None:
            return measured
        difference = self.forward.difference(self.observations.values[self.selected], base.values)
        apart = self.logarithms(number, selected, difference)
        frequency = self.rows.frequency_hz[selected]
        apart -= 1j * frequency * float(frequency @ apart.imag) / max(float(frequency @ frequency), 1.0)
        apart[np.abs(apart.real) > THRESHOLDS.misfit.large_log_ratio] *= 2.0
        return np.exp(self.logarithms(number, selected, base.values) + 0.5 * apart)

    def logarithms(self, number: int, selected: IntArray, values: FloatArray) -> ComplexArray:
        """Complex logarithms of the responses of rows, from those of magnitude and phase."""
        found = np.zeros(selected.size, dtype=np.complex128)
        place = self.rows.level * (int(np.max(self.rows.channel)) + 1) + self.rows.channel
        for part, factor in zip(FUNDAMENTAL, (1.0, 1j), strict=True):
            of_part = np.flatnonzero((self.rows.test == number) & (self.rows.part == part))
            by_place = dict(zip(place[of_part], values[of_part], strict=True))
            found += factor * np.array([by_place.get(location, 0.0) for location in place[selected]])
        return np.nan_to_num(found)
