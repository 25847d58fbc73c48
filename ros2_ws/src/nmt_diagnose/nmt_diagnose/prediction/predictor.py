"""What predicts the rows of one measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.prediction.influence import Source, SourceColumn
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.measurements.channel import MeasuredChannel
    from nmt_diagnose.observations.observables import Rows


class Predictor:
    """Predicts the rows of one measurement; those without solutions of their own leave all but ``values`` as it is.

    Attributes:
        SOLUTION: what there is one of at each level.
        rows: the rows.
        channels: of the measurement.
        setup: what it shares with other measurements; ``_places`` are those of the channels in it.
    """

    SOLUTION: ClassVar[str] = "phase-resonant solution"
    rows: Rows
    channels: tuple[MeasuredChannel, ...]
    setup: Setup

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other measurements share."""
        self.setup = setup
        self._places = np.array(setup.index(self.channels), dtype=np.int64)

    def solve(self, rig: Rig, cache: PartsCache, start: tuple[Any, ...] | None) -> list[Any] | None:
        """One solution per level, from those of a similar rig; None where the values follow at once."""
        return None

    def influence(
        self, rig: Rig, cache: PartsCache, states: Sequence[Any], source: Source
    ) -> tuple[FloatArray, list[SourceColumn]]:
        """What unit sources at a place would do to its rows, (rows, sources), and what each is; none by default."""
        return np.zeros((len(self.rows), 0)), []

    def errors(self, rig: Rig, cache: PartsCache, chain: MeasuringChain | None) -> dict[str, FloatArray]:
        """What a standard deviation of each error of a record's channels adds to the rows, (rows,) each, by name."""
        return {}

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the rows, (rows,); NaN where a level has no solution."""
        raise NotImplementedError

    def tangent(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> Any:
        """What solutions need to follow small changes of the rig; None where they have their own way."""
        return None

    def advanced(self, rig: Rig, cache: PartsCache, tangent: Any) -> list[Any] | None:
        """Solutions of a slightly different rig by a tangent; None where it does not reach there."""
        return None

    def stepped(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> list[Any]:
        """Solutions of a slightly different rig, one Newton step from those of the rig before."""
        raise NotImplementedError
