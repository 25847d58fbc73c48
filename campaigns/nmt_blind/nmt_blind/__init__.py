"""The blind check of the diagnosis: sealed cases, campaigns, scores, baselines, calibration.

Public names, each loaded when it is asked for: :func:`make_campaign` draws and seals the cases of a
:class:`CampaignPlan`, :func:`run_campaign` diagnoses them, :func:`score_campaign` opens the seal and
:func:`write_sheets` writes what was reached. :func:`run_laboratory` diagnoses and classes the cases of another
laboratory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_blind.campaign.foreign_run import run_laboratory
    from nmt_blind.campaign.run import CampaignRun, run_campaign
    from nmt_blind.campaign.score import Scores, score_campaign
    from nmt_blind.campaign.score_sheet import write_sheets
    from nmt_blind.cases.make import CampaignPlan, Made, make_campaign

__all__ = [
    "CampaignPlan",
    "CampaignRun",
    "Made",
    "Scores",
    "make_campaign",
    "run_campaign",
    "run_laboratory",
    "score_campaign",
    "write_sheets",
]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
