"""Generic sources at every place of a rig: what an unnamed effect there could do to the observables."""

from __future__ import annotations

from nmt_diagnose.evidence.observables import Evidence
from nmt_diagnose.inference.contest import Contender
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.twin.forward import Forward
from nmt_plant.rig import Rig


def generic_sources(forward: Forward, rig: Rig, base: Contender, evidence: Evidence) -> list[SourceScore]:
    """Evidence for a source at each place, on top of a fitted model."""
    return []
