"""All thresholds of the diagnosis: value, unit, reason, and the test that fails when it moves."""

from __future__ import annotations

from dataclasses import dataclass, field

from nmt_core.tolerances import TOLERANCES, ChainTolerances
from nmt_diagnose.thresholds.candidates import CandidateThresholds
from nmt_diagnose.thresholds.comparison import ComparisonThresholds
from nmt_diagnose.thresholds.fits import FitThresholds
from nmt_diagnose.thresholds.law import LawThresholds
from nmt_diagnose.thresholds.misfit import MisfitThresholds
from nmt_diagnose.thresholds.modes import ModeThresholds
from nmt_diagnose.thresholds.next_test import NextTestThresholds
from nmt_diagnose.thresholds.noise import NoiseThresholds
from nmt_diagnose.thresholds.prediction import PredictionThresholds
from nmt_diagnose.thresholds.reading import ReadingThresholds
from nmt_diagnose.thresholds.search import SearchThresholds
from nmt_diagnose.thresholds.verdict import VerdictThresholds
from nmt_signals.thresholds import THRESHOLDS as SIGNAL_THRESHOLDS
from nmt_signals.thresholds import SignalThresholds


@dataclass(frozen=True)
class DiagnosisThresholds:
    """Thresholds by theme; what a field means stands with it (:mod:`nmt_core.threshold`).

    Attributes:
        candidates: where effects of the library may sit and how large they may be.
        comparison: probabilities of explanations, of none and of something unnamed.
        fits: fits of one explanation: steps, convergence, priors of dimensionless parameters.
        law: laws of local forces that are read from held levels.
        misfit: what a model that lacks nothing may still be off by, and what it leaves out.
        modes: modes of frequency responses against those of the model.
        next_test: which further test would tell explanations apart.
        noise: uncertainties of observables from the recordings.
        prediction: predictions of the model: operating range, search for resonances, converters.
        reading: what of a recording becomes an observable.
        search: the search for explanations: which candidates are fitted, and from where.
        verdict: verdict, held-out data, warnings and what is reported.
        signals: clipping, decays, lines of the mains and fits of signals.
        tolerances: what a healthy measuring chain is off by.
    """

    candidates: CandidateThresholds = field(default_factory=CandidateThresholds)
    comparison: ComparisonThresholds = field(default_factory=ComparisonThresholds)
    fits: FitThresholds = field(default_factory=FitThresholds)
    law: LawThresholds = field(default_factory=LawThresholds)
    misfit: MisfitThresholds = field(default_factory=MisfitThresholds)
    modes: ModeThresholds = field(default_factory=ModeThresholds)
    next_test: NextTestThresholds = field(default_factory=NextTestThresholds)
    noise: NoiseThresholds = field(default_factory=NoiseThresholds)
    prediction: PredictionThresholds = field(default_factory=PredictionThresholds)
    reading: ReadingThresholds = field(default_factory=ReadingThresholds)
    search: SearchThresholds = field(default_factory=SearchThresholds)
    verdict: VerdictThresholds = field(default_factory=VerdictThresholds)
    signals: SignalThresholds = field(default_factory=lambda: SIGNAL_THRESHOLDS)
    tolerances: ChainTolerances = field(default_factory=lambda: TOLERANCES)


THRESHOLDS = DiagnosisThresholds()
"""The values that are in force."""
