"""All kinds of measurement."""

from __future__ import annotations

from nmt_diagnose.measurements.backbone_table import BackboneTable
from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord
from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses.stepped_responses import SteppedResponses

MEASUREMENTS: tuple[type[Measurement], ...] = (
    ImposedMotion,
    BackboneTable,
    LockedWindows,
    SteppedResponses,
    RandomResponses,
    RecordedDecay,
    DrivenRecord,
)
"""The classes, in the order in which they are asked what of a bag is theirs: those first that take windows out.

A kind that is added stands here, and the tests ask it what they ask of all.
"""
