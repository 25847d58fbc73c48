"""Modes of frequency responses against those of the model."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class ModeThresholds:
    """Modes of frequency responses against those of the model."""

    mode_share: float = threshold(
        0.5, "1",
        "Share of the response of a mode, in half of the channels.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.mode_share]",
    )  # fmt: skip
    missing_share: float = threshold(
        0.1, "1",
        "The same of a missing mode, in two channels.",
        "tests/diagnose/test_missing_mode.py::test_a_small_mass_on_a_spring_is_a_resonance",
    )  # fmt: skip
    least_images_share: float = threshold(
        0.25, "1",
        "At lower lines images are smooth, at most 11 %.",
        "tests/diagnose/test_held_drive.py::test_modes_are_looked_for_below_the_images_of_a_held_drive",
    )  # fmt: skip
    unlike_mac: float = threshold(
        0.3, "1",
        "Modal assurance criterion below which two modes are different.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.unlike_mac]",
    )  # fmt: skip
    alike_mac: float = threshold(
        0.5, "1",
        "Below it the order of two modes is certain.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[modes.alike_mac]",
    )  # fmt: skip
    apart_log_frequency: float = threshold(
        0.5, "ln frequency",
        "Modes further apart are different.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.apart_log_frequency]",
    )  # fmt: skip
    near_log_frequency: float = threshold(
        0.1, "ln frequency",
        "Modes nearer are equal whatever the sensors.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.near_log_frequency]",
    )  # fmt: skip
    same_log_frequency: float = threshold(
        0.02, "ln frequency",
        "A mode of two tests within it is one.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.same_log_frequency]",
    )  # fmt: skip
    edge_ratio: float = threshold(
        1.3, "1",
        "Poles this near to an edge may be noise.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[modes.edge_ratio]",
    )  # fmt: skip
    around_log_frequency: float = threshold(
        0.1, "ln frequency",
        "Range about a missing mode in which it must show.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.around_log_frequency]",
    )  # fmt: skip
    missed_sigmas: float = threshold(
        3.0, "σ",
        "Misfit at which a channel shows a missing mode.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.missed_sigmas]",
    )  # fmt: skip
    certain_sigmas: float = threshold(
        10.0, "σ",
        "Misfit from which only a missing mode explains it.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.certain_sigmas]",
    )  # fmt: skip
    certain_channel_share: float = threshold(
        0.8, "1",
        "Share of channels that must show it.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.certain_channel_share]",
    )  # fmt: skip
    highest_measured_damping: float = threshold(
        0.05, "1",
        "Poles with more damping are not modes.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.highest_measured_damping]",
    )  # fmt: skip
    highest_model_damping: float = threshold(
        0.3, "1",
        "Model modes with more damping are not paired.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[modes.highest_model_damping]",
    )  # fmt: skip
    fewest_lines: int = threshold(
        20, "1",
        "Fewer lines do not determine poles.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.fewest_lines]",
    )  # fmt: skip
    least_width_lines: float = threshold(
        0.3, "lines",
        "Narrower resonances, in lines, are noise.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.least_width_lines]",
    )  # fmt: skip
