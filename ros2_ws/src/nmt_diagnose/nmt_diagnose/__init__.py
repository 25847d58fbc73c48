"""The gap between a rig and its model: where it lies, which unmodelled effect causes it, how far it shrinks.

Public names, each loaded when it is asked for: :func:`diagnose_bags` does it; :func:`nmt_report.write_diagnosis` writes
its files.

>>> from nmt_diagnose import DiagnosisSettings, diagnose_bags
>>> few = DiagnosisSettings(withheld=OTHERS, jobs=1, allow_own_model=True)
>>> outcome = diagnose_bags("out/demo/rig.yaml", ["out/demo"], settings=few)
>>> outcome.diagnosis.verdict.value
'none'
>>> outcome.initial_model.local_elements[0].slip_force_n
1.0
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_diagnose.diagnose import DiagnosisOutcome, diagnose_bags
    from nmt_diagnose.diagnosis_settings import DiagnosisSettings
    from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict

__all__ = [
    "Diagnosis",
    "DiagnosisOutcome",
    "DiagnosisSettings",
    "Verdict",
    "diagnose_bags",
]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
