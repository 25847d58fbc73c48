"""Predictions of the model: operating range, search for resonances, converters."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class PredictionThresholds:
    """Predictions of the model: operating range, search for resonances, converters."""

    resonance_search_share: float = threshold(
        0.25, "1",
        "Search range about the measured frequency.",
        "tests/diagnose/test_predictions.py::test_a_duffing_oscillator_in_closed_form",
    )  # fmt: skip
    far_off_ratio: float = threshold(
        2.0, "1",
        "Beyond this ratio of motion the model is unusable.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[prediction.far_off_ratio]",
    )  # fmt: skip
    most_joined_points: int = threshold(
        4, "1",
        "Pairs of more points are more than recordings distinguish.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[prediction.most_joined_points]",
    )  # fmt: skip
    line_width: float = threshold(
        0.01, "1",
        "Lines this near to the mains count as mains.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[prediction.line_width]",
    )  # fmt: skip
    coarse_steps: float = threshold(
        64.0, "1",
        "With more steps harmonics change below 1 % of a step.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[prediction.coarse_steps]",
    )  # fmt: skip
    noise_reach_sigmas: float = threshold(
        4.0, "σ",
        "Noise within it often reaches a clipping level.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[prediction.noise_reach_sigmas]",
    )  # fmt: skip
    continued_log_step: float = threshold(
        0.5, "ln",
        "Larger steps between lines change the branch.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[prediction.continued_log_step]",
    )  # fmt: skip
    delay_step_turns: float = threshold(
        1.0 / 16.0, "turns",
        "Turns of the highest line between delays that are tried.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[prediction.delay_step_turns]",
    )  # fmt: skip
    latest_delay_s: float = threshold(
        0.01, "s",
        "No converter or filter is later than ten milliseconds.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[prediction.latest_delay_s]",
    )  # fmt: skip
    largest_magnitude_sigmas: float = threshold(
        4.0, "σ",
        "Magnitude errors up to this correct the phase.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[prediction.largest_magnitude_sigmas]",
    )  # fmt: skip
    largest_shape_mix: float = threshold(
        1e-3, "1",
        "First-order bound for mixing two shapes.",
        "tests/diagnose/test_predictions.py::test_poles_are_followed_as_far_as_the_first_order_is_right_to_a_millionth",
    )  # fmt: skip
    far_pole_ratio: float = threshold(
        3.0, "1",
        "Poles beyond it hardly move those in the band.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[prediction.far_pole_ratio]",
    )  # fmt: skip
    unit_source_share: float = threshold(
        0.01, "1",
        "A unit source within the first order.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[prediction.unit_source_share]",
    )  # fmt: skip
