"""How evidence becomes probability: priors, thresholds and reliabilities, fixed on simulated development cases.

Evidences of an inexact model are over-confident, and what is called the cause of a gap may be a relative of the true
one. So three questions are answered by how often the same features were right on cases whose truth was known: is there
a gap, has it a name, is the first name the right one. ``./nmt blind calibrate`` learns them from development campaigns.

The file ``confidence.json`` beside this module is frozen before a sealed campaign; its SHA-256 goes into every
diagnosis.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, cast

from nmt_core.errors import BenchError
from nmt_core.hardened import read_json

CONFIDENCE_FILE = Path(__file__).with_name("confidence.json")


@dataclass(frozen=True)
class Reliability:
    """Probability that something is so, from features: 1 / (1 + exp(-bias - Σ weight · feature)).

    Attributes:
        bias: log-odds where all features are zero.
        weights: of the features, by name.
    """

    bias: float
    weights: Mapping[str, float]

    def probability(self, features: Mapping[str, float]) -> float:
        """Of features by name; each counts within the range in which it was learned only."""
        total = self.bias + sum(weight * bounded(name, features[name]) for name, weight in self.weights.items())
        return 1.0 / (1.0 + math.exp(-min(max(total, -30.0), 30.0)))


RANGES: dict[str, tuple[float, float]] = {
    "log_odds": (-3.0, 8.0),
    "unknown_odds": (-8.0, 8.0),
    "leftover": (-1.0, 12.0),
    "second": (0.0, 1.0),
    "together": (0.0, 1.0),
    "margin": (-2.0, 8.0),
    "sigmas": (0.0, 4.0),
    "equivalents": (0.0, 4.0),
}
"""Features, and the range in which each counts.

log_odds: ln of all explanations over none; unknown_odds: ln of something unnamed over the named; leftover: ln of the
evidence for a generic source on top of the best explanation; second: 1 if that has two effects; together: 1 if these
act at one point or channel; margin: ln of the best class over the other named ones; sigmas: ln(1 + strength in
standard deviations); equivalents: members of the best class beyond the first.
"""


def bounded(name: str, value: float) -> float:
    """A feature within its range."""
    low, high = RANGES[name]
    return low if not value > low else min(value, high)


@dataclass(frozen=True)
class Confidence:
    """Calibration of probabilities.

    Attributes:
        prior_none: prior probability that nothing is missing.
        prior_effect: that one named effect is, all effects together.
        prior_pair: that two are.
        prior_unknown: that something unnamed is.
        alarm: log-odds against ``none`` from which a gap is claimed.
        unknown: probability of something unnamed, given a gap, from which the verdict is ``unknown``.
        recalibration: fall of χ² by re-fitting the model's own parameters from which that is called a calibration.
        inexactness: share of an effect's own gain in evidence that anything on top of it, or unnamed in its place, must
            beat: the model of an effect is right to some percent of the effect only.
        explained: share of the held-out gap that a named explanation must close for something unnamed behind it to
            count for the rest only.
        equivalence: distance in standard deviations below which two explanations count as one.
        gap: reliability of there being a gap.
        unnamed: of a gap having no name in the library.
        first: of the best of the named explanations being right, if one is.
    """

    prior_none: float
    prior_effect: float
    prior_pair: float
    prior_unknown: float
    alarm: float
    unknown: float
    recalibration: float
    inexactness: float
    explained: float
    equivalence: float
    gap: Reliability
    unnamed: Reliability
    first: Reliability


@cache
def confidence(path: Path = CONFIDENCE_FILE) -> Confidence:
    """The frozen calibration.

    Raises:
        BenchError: the file is damaged.
    """
    try:
        values = read_json(path, "calibration of confidence")
        return Confidence(**{item.name: _read(values[item.name]) for item in fields(Confidence)})
    except (BenchError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise BenchError(
            f"The calibration of confidence {path} cannot be read ({error}); install nmt again."
        ) from error


def _read(value: object) -> Any:
    if not isinstance(value, dict):
        return float(cast(float, value))
    return Reliability(float(value["bias"]), {name: float(value["weights"][name]) for name in value["weights"]})


@cache
def confidence_digest(path: Path = CONFIDENCE_FILE) -> str:
    """SHA-256 of the frozen calibration."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
