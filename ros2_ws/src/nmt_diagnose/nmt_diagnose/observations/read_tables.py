"""From tables that someone else has reduced to observations: each kind of measurement is asked which are its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations, empty
from nmt_diagnose.measurements.registry import MEASUREMENTS
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.tables_together import TablesTogether
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_rig.rig import Rig


def table_observations(
    name: str, tables: Sequence[ObservableTable], model: Rig, settings: ObservationSettings
) -> Observations:
    """Observables of one table, or of several that were measured together; a sentence where it cannot be used."""
    drive_point = tables[0].drive_point or model.drive_point
    points = model.structure.points
    notes = []
    for point, what in ((drive_point, "drive point"), *((each.point or drive_point, "point") for each in tables)):
        if point not in points:
            notes.append(f"{name}: left out: its {what} {point} is not among the model's points 1 to {points[-1]}.")
    tables = [each for each in tables if (each.point or drive_point) in points]
    if drive_point not in points or not tables:
        return empty(notes)
    if any(each.quantity not in MOTIONS for each in tables):
        return empty(
            (
                f"{name}: left out: its amplitude is modal ({tables[0].units.get('amplitude', 'no unit')}); the model "
                "predicts amplitudes of a point in m, m/s or m/s^2.",
            )
        )
    view = ModelView.of(model, (drive_point,))
    channels = tuple(_channel(each, view, each.point or drive_point) for each in tables)
    together = TablesTogether(name, tuple(tables), view, channels, settings)
    found = next(
        found
        for kind in MEASUREMENTS
        if kind.read_tables is not None and (found := kind.read_tables(together)) is not None
    )
    return replace(found, notes=(*notes, *found.notes))


def _channel(table: ObservableTable, view: ModelView, point: int) -> MeasuredChannel:
    return next(
        (c for c in view.channels if (c.quantity, c.point) == (table.quantity, point)),
        MeasuredChannel(f"{table.quantity.letter}{point}", table.quantity, point, turns=table.turns),
    )
