"""How evidence becomes probability: priors, temperature and thresholds, fixed on simulated development cases.

The file ``confidence.json`` beside this module is frozen before a sealed campaign; its SHA-256 goes into every
diagnosis.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

from nmt_core.errors import BenchError

_FILE = Path(__file__).with_name("confidence.json")


@dataclass(frozen=True)
class Confidence:
    """Calibration of probabilities.

    Attributes:
        prior_none: prior probability that nothing is missing.
        prior_effect: that one named effect is, all effects together.
        prior_pair: that two are.
        prior_unknown: that something unnamed is.
        temperature: divides log-evidences; above one where they are over-confident.
        alarm: log-odds against ``none`` from which a gap is claimed.
        unknown: probability of something unnamed, given a gap, from which the verdict is ``unknown``.
        recalibration: fall of χ² by re-fitting the model's own parameters from which that is called a calibration.
        inexactness: share of an effect's own gain in evidence that anything on top of it, or unnamed in its place, must
            beat: the model of an effect is right to some percent of the effect only.
        explained: share of the held-out gap from which a named explanation stands although something unnamed fits
            better.
        equivalence: distance in standard deviations below which two explanations count as one.
    """

    prior_none: float
    prior_effect: float
    prior_pair: float
    prior_unknown: float
    temperature: float
    alarm: float
    unknown: float
    recalibration: float
    inexactness: float
    explained: float
    equivalence: float


@cache
def confidence(path: Path = _FILE) -> Confidence:
    """The frozen calibration.

    Raises:
        BenchError: the file is damaged.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return Confidence(**{item.name: float(values[item.name]) for item in fields(Confidence)})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BenchError(
            f"The calibration of confidence {path} cannot be read ({error}); install nmt again."
        ) from error


@cache
def confidence_digest(path: Path = _FILE) -> str:
    """SHA-256 of the frozen calibration."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
