"""All thresholds of the diagnosis: value, unit, reason, and the test that fails when it moves."""

from __future__ import annotations

from dataclasses import dataclass, field

from nmt_diagnose.thresholds.candidates import CandidateThresholds
from nmt_diagnose.thresholds.comparison import ComparisonThresholds
from nmt_diagnose.thresholds.fits import FitThresholds
from nmt_diagnose.thresholds.misfit import MisfitThresholds
from nmt_diagnose.thresholds.modes import ModeThresholds
from nmt_diagnose.thresholds.next_test import NextTestThresholds
from nmt_diagnose.thresholds.prediction import PredictionThresholds
from nmt_diagnose.thresholds.search import SearchThresholds
from nmt_diagnose.thresholds.verdict import VerdictThresholds


@dataclass(frozen=True)
class DiagnosisThresholds:
    """Thresholds by theme; what a field means stands with it (:mod:`nmt_core.threshold`).

    Attributes:
        fits: fits of one explanation: steps, convergence, priors of dimensionless parameters.
        search: the search for explanations: which candidates are fitted, and from where.
        comparison: probabilities of explanations, of none and of something unnamed.
        verdict: verdict, held-out data, warnings and what is reported.
        modes: modes of frequency responses against those of the model.
        misfit: what a model that lacks nothing may still be off by, and what it leaves out.
        next_test: which further test would tell explanations apart.
        candidates: where effects of the library may sit and how large they may be.
        prediction: predictions of the model: operating range, search for resonances, converters.
    """

    fits: FitThresholds = field(default_factory=FitThresholds)
    search: SearchThresholds = field(default_factory=SearchThresholds)
    comparison: ComparisonThresholds = field(default_factory=ComparisonThresholds)
    verdict: VerdictThresholds = field(default_factory=VerdictThresholds)
    modes: ModeThresholds = field(default_factory=ModeThresholds)
    misfit: MisfitThresholds = field(default_factory=MisfitThresholds)
    next_test: NextTestThresholds = field(default_factory=NextTestThresholds)
    candidates: CandidateThresholds = field(default_factory=CandidateThresholds)
    prediction: PredictionThresholds = field(default_factory=PredictionThresholds)


THRESHOLDS = DiagnosisThresholds()
"""The values that are in force."""
