"""Laws of local forces that are read from held levels."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class LawThresholds:
    """Laws of local forces that are read from held levels."""

    force_share: float = threshold(
        0.002, "1",
        "Force residual over the modal force that acts: what ordinary cells and loops repeat within, 0.15 to 0.3 %.",
        "",
    )  # fmt: skip
    shape_share: float = threshold(
        1e-4, "1",
        "Shape of a level over the response: how well ordinary accelerometers repeat from level to level.",
        "",
    )  # fmt: skip
    harmonic_share: float = threshold(
        1e-5, "1",
        "Harmonics over the fundamental that sensors make of their own: a twentieth of the harmonic that matters.",
        "",
    )  # fmt: skip
    mode_frequency_std: float = threshold(
        0.01, "1", "Natural frequencies of a model that was not fitted: two moduli of 1 % each, half of their sum.", "",
    )  # fmt: skip
    mode_damping_std: float = threshold(
        0.3, "1", "Damping ratios of a model, as in the table of model priors.", "",
    )  # fmt: skip
    least_damping_std: float = threshold(
        2e-4, "1", "Damping ratio that a model without damping may lack: that of a welded structure.", "",
    )  # fmt: skip
    transfer_std: float = threshold(
        0.02, "1", "Response far from its modes to a local force: gain of the sensor, form and mass of the modes.", "",
    )  # fmt: skip
    form_std: float = threshold(
        0.01, "1", "Form of the mode under test at a sensor: as a gain, 1 %.", "",
    )  # fmt: skip
    motion_rounds: int = threshold(
        4, "1", "Rounds of motion and force: an even force at its limit of equilibrium takes so many to 1 %.", "",
    )  # fmt: skip
    fewest_levels: int = threshold(
        4, "1", "Levels from which one can be left out between the lowest and the highest.", "",
    )  # fmt: skip
    least_motion_share: float = threshold(
        0.03, "1", "Motion of a place over the largest: forces where nothing moves are not seen.", "",
    )  # fmt: skip
    largest_slip_share: float = threshold(
        0.7, "1", "Largest slip displacement over the largest motion: what hardly slips is a spring.", "",
    )  # fmt: skip
    finalists: int = threshold(
        10, "1", "Laws that are read again along the motion that they make.", "",
    )  # fmt: skip
    alike_score_ratio: float = threshold(
        1.12, "1", "Score over the best up to which the law of fewest elements is taken.", "",
    )  # fmt: skip
    place_score_ratio: float = threshold(
        1.3, "1", "Score over the best up to which places are not told apart.", "",
    )  # fmt: skip
    told_score_ratio: float = threshold(
        0.5, "1", "Score with the law over that without it from which on it is told.", "",
    )  # fmt: skip
    second_score_ratio: float = threshold(
        0.75, "1", "Score with a second law over that of the first alone from which on it is told.", "",
    )  # fmt: skip
    least_null_score: float = threshold(
        1.0, "1", "Score of the model without a law below which nothing is read: that is noise and tolerances.", "",
    )  # fmt: skip
    pull_sigmas: float = threshold(
        3.0, "1", "Errors of chain and model beyond so many of their standard deviations: the law is not told.", "",
    )  # fmt: skip
    second_from_score: float = threshold(
        1.0, "1", "Score from which on a second law is looked for: below it what is left is noise and tolerances.", "",
    )  # fmt: skip
    drawn_levels: int = threshold(
        5, "1", "Levels whose force loop is reported: more curves hide each other.", "",
    )  # fmt: skip
    start_score_ratio: float = threshold(
        0.8, "1", "Score with the law over that without it from which on the search begins at it, too.", "",
    )  # fmt: skip
    dry_slip_share: float = threshold(
        0.02, "1", "Slip displacement over the largest motion with which a slider stands for dry friction.", "",
    )  # fmt: skip
