"""All kinds of measurement, and what reads each."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from nmt_diagnose.measurements.backbone_table import BackboneTable, backbone_observations, unforced_observations
from nmt_diagnose.measurements.driven_record import DrivenRecord, records_of
from nmt_diagnose.measurements.imposed_motion import ImposedMotion, imposed_motion_observations
from nmt_diagnose.measurements.locked_reading import locked_windows_of
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import Measurement, Observations
from nmt_diagnose.measurements.random_reading import random_responses_of, response_table_observations
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay import RecordedDecay, decays_of
from nmt_diagnose.measurements.stepped_reading import stepped_table_observations, swept_responses_of
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.tables_together import TablesTogether


class MeasurementKind(NamedTuple):
    """A kind of measurement.

    Attributes:
        measurement: its class.
        read: its measurements among the windows of a bag; raises BenchError where that cannot be of the model's rig.
        read_tables: its measurement where tables that someone else has reduced are one, None of other tables; raises
            BenchError where what they say does not fit together. None where no table is of this kind.
    """

    measurement: type[Measurement]
    read: Callable[[BagWindows], list[Observations]]
    read_tables: Callable[[TablesTogether], Observations | None] | None = None


MEASUREMENTS = (
    MeasurementKind(ImposedMotion, imposed_motion_observations),
    MeasurementKind(BackboneTable, unforced_observations, backbone_observations),
    MeasurementKind(LockedWindows, locked_windows_of),
    MeasurementKind(SteppedResponses, swept_responses_of, stepped_table_observations),
    MeasurementKind(RandomResponses, random_responses_of, response_table_observations),
    MeasurementKind(RecordedDecay, decays_of),
    MeasurementKind(DrivenRecord, records_of),
)
"""The kinds, in the order in which they are asked what of a bag is theirs: those first that take windows out.

A kind that is added stands here, and the tests ask it what they ask of all.
"""
