"""Tables of one measurement that someone else has reduced, for the kinds of measurement to read."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_record.exchange.reduced.observables import ObservableTable


@dataclass(frozen=True, eq=False)
class TablesTogether:
    """One table, or several that are points of one passage, see `measured_together`.

    Attributes:
        name: of the test.
        tables: in SI units.
        view: the model, driven at the tables' drive point.
        channels: response channel of each table.
        settings: of the reading.
    """

    name: str
    tables: tuple[ObservableTable, ...]
    view: ModelView
    channels: tuple[MeasuredChannel, ...]
    settings: ObservationSettings
