"""What a reader has to mind: fits that stopped early, implausible parameters, residuals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_core.key_units import of_rotation
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.ledger.diagnosis import Gap, Recalibrated, Verdict
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.thresholds import THRESHOLDS

_LISTED_PARAMETERS = 3


def warned(
    verdict: Verdict,
    best: FittedExplanation,
    calibration: Sequence[Recalibrated],
    gap: Gap,
    alike: Sequence[FittedExplanation] = (),
) -> tuple[str, ...]:
    """Sentences of warning; empty where there is nothing to mind.

    Args:
        verdict: of the diagnosis.
        best: the model as it came out, with the accepted explanation or without.
        calibration: its own parameters.
        gap: on held-out data.
        alike: explanations that the tests cannot distinguish, the accepted one among them.
    """
    found = []
    away = math.sqrt(max(0.0, best.fit.promised))
    if away >= 1.0:
        what = f"The fit with {best.explanation.label}" if best.candidates else "The re-fit of the model"
        found.append(
            f"{what} stopped before its optimum, some {away:.1f} standard uncertainties away: its values are not to be "
            "relied on."
        )
    theta = best.fit.theta[: len(calibration)]
    far = [
        (item, float(value))
        for item, value in zip(calibration, theta, strict=True)
        if abs(value) > THRESHOLDS.comparison.credible_sigmas
    ]
    if far and verdict is not Verdict.NONE:
        far.sort(key=lambda pair: -abs(pair[1]))
        moves = [
            f"{item.name} from {item.start:.4g} to {item.to:.4g} {item.unit} ({abs(value):.1f} standard deviations)"
            for item, value in far[:_LISTED_PARAMETERS]
        ]
        others = f" and {len(far) - len(moves)} more parameters as far" if len(far) > len(moves) else ""
        found.append(
            f"The fit moves parameters further than their tolerances: {'; '.join(moves)}{others}. "
            "Check them, or something else hides behind them."
        )
    for member in alike if verdict is Verdict.EFFECT else ():
        found += _beyond_physics(member)
    large = not gap.closed >= 1.0 - THRESHOLDS.verdict.small_left_share
    if (
        verdict is Verdict.EFFECT
        and large
        and math.isfinite(gap.after)
        and gap.after > THRESHOLDS.verdict.left_over_scale * max(gap.floor, 1.0)
    ):
        worst = max(gap.per_observable.items(), key=lambda item: item[1]["after"], default=None)
        where = f", most of it in {worst[0]}" if worst else ""
        found.append(
            f"{gap.after:.1f} standard deviations (rms) are left on held-out data{where}: the explanation is not the "
            "whole of the gap."
        )
    return tuple(found)


def without_observables(observations: Observations) -> tuple[str, ...]:
    """Sentences on recordings of which nothing could be compared: the verdict is about the others only."""
    compared = {test.name: bool(np.any(observations.rows.test == n)) for n, test in enumerate(observations.tests)}
    silent = []
    for (path, _), origin in zip(observations.inputs, observations.origins, strict=True):
        # The tests of a floor bag are not among those that are compared.
        if not any(compared.get(test, True) for test in origin.tests):
            silent.append(str(path))
    if not silent:
        return ()
    return (
        f"Nothing of {' and '.join(silent)} could be compared, so the verdict says nothing of it; the notes say why. "
        "Where the model locks and the rig does not, that is a gap by itself.",
    )


def frequencies_alone(observations: Observations) -> tuple[str, ...]:
    """A sentence where nothing but frequencies was compared: that no gap is in them says nothing of losses."""
    parts = observations.rows.part
    if parts.size == 0 or np.any(parts != Part.LOG_FREQUENCY):
        return ()
    return ("Only frequencies were compared: these tests tell nothing about damping, drive or friction.",)


def beyond_physical_limits(found: FittedExplanation) -> dict[tuple[int, str], float]:
    """Parameters of effects that are larger than physics allows: by how many standard deviations of the limit."""
    parametrisation, result = found.fit.parametrisation, {}
    for index, candidate in enumerate(found.candidates):
        values = parametrisation.values(found.fit.theta, index)
        for name, limit in candidate.site.limits.items():
            if abs(values[name]) > limit:
                result[index, name] = (abs(values[name]) / limit - 1.0) / THRESHOLDS.comparison.limit_std
    return result


def _beyond_physics(found: FittedExplanation) -> list[str]:
    """Sentences on parameters larger than physics allows."""
    result = []
    for (index, name), far in beyond_physical_limits(found).items():
        if far > THRESHOLDS.comparison.credible_sigmas:
            candidate = found.candidates[index]
            value = found.fit.parametrisation.values(found.fit.theta, index)[name]
            unit = next(p.unit for p in candidate.effect.parameters if p.name == name)
            unit = of_rotation(unit) if found.fit.parametrisation.base.coordinate == "angle" else unit
            result.append(
                f"As {candidate.label} the gap would take {name} = {value:.3g} {unit}, "
                f"{abs(value) / candidate.site.limits[name]:.2g} times the largest that physics allows there: it is "
                "something else that grows in the same way."
            )
    return result
