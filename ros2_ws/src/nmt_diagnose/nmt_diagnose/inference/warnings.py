"""What a reader has to mind: fits that stopped early, parameters that nobody would believe, remainders."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_diagnose.inference.diagnosis import Gap, Recalibrated, Verdict
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.physical_limits import beyond_limits
from nmt_diagnose.observations.observables import Observations

# Standard deviations of its prior beyond which a parameter is not what a data sheet or a ruler leaves open.
_CREDIBLE = 3.0
# What is left over the floor from which it is more than noise, and the share of the gap from which that is a warning.
_LEFT, _SMALL_SHARE = 2.0, 0.15


def warned(
    verdict: Verdict,
    best: FittedModel,
    calibration: Sequence[Recalibrated],
    gap: Gap,
    alike: Sequence[FittedModel] = (),
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
    if not best.fit.converged:
        what = f"The fit with {best.explanation.label}" if best.candidates else "The re-fit of the model"
        found.append(f"{what} stopped before its optimum: its values and their uncertainties are not to be relied on.")
    theta = best.fit.theta[: len(calibration)]
    far = [(item, float(value)) for item, value in zip(calibration, theta, strict=True) if abs(value) > _CREDIBLE]
    for item, value in sorted(far, key=lambda pair: -abs(pair[1])) if verdict is not Verdict.NONE else ():
        found.append(
            f"The fit moves {item.name} from {item.start:.4g} to {item.to:.4g} {item.unit}, {abs(value):.1f} standard "
            "deviations of what is believed of it: check it, or something else hides behind it."
        )
    for member in alike if verdict is Verdict.EFFECT else ():
        found += _beyond_physics(member)
    large = not gap.closed >= 1.0 - _SMALL_SHARE
    if verdict is Verdict.EFFECT and large and math.isfinite(gap.after) and gap.after > _LEFT * max(gap.floor, 1.0):
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


def _beyond_physics(fitted_model: FittedModel) -> list[str]:
    """Sentences on parameters larger than physics allows."""
    if beyond_limits(fitted_model.candidates, fitted_model.fit) < _CREDIBLE:
        return []
    found = []
    for index, candidate in enumerate(fitted_model.candidates):
        values = fitted_model.fit.parametrisation.values(fitted_model.fit.theta, index)
        for parameter in candidate.effect.parameters:
            limit = candidate.site.limits.get(parameter.name, math.inf)
            if abs(values[parameter.name]) > limit:
                times = abs(values[parameter.name]) / limit
                found.append(
                    f"As {candidate.label} the gap would take {parameter.name} = {values[parameter.name]:.3g} "
                    f"{parameter.unit}, {times:.2g} times the largest that physics allows there: it is something else "
                    "that grows in the same way."
                )
    return found
