"""Modes of frequency responses against those of the model."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class ModeThresholds:
    """Modes of frequency responses against those of the model."""

    mode_share: float = threshold(
        0.5, "1",
        "Share of a response at its frequency that a mode carries in half of the channels.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.mode_share]",
    )  # fmt: skip
    missing_share: float = threshold(
        0.1, "1",
        "The same in two channels of a resonance that the model lacks: a small mass on a spring turns it by less.",
        "tests/diagnose/test_missing_mode.py::test_a_small_mass_on_a_spring_is_a_resonance",
    )  # fmt: skip
    least_images_share: float = threshold(
        0.25, "1",
        "Highest line over the rate of a held drive below which images are smooth and small: at most 11 %.",
        "tests/diagnose/test_held_drive.py::test_modes_are_looked_for_below_the_images_of_a_held_drive",
    )  # fmt: skip
    unlike_mac: float = threshold(
        0.3, "1",
        "Modal assurance criterion below which two modes are different.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.unlike_mac]",
    )  # fmt: skip
    alike_mac: float = threshold(
        0.5, "1",
        "Modal assurance criterion below which the order of two modes is beyond doubt.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[modes.alike_mac]",
    )  # fmt: skip
    apart_log_frequency: float = threshold(
        0.5, "ln frequency",
        "Ratio of frequencies from which two modes are not the same.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.apart_log_frequency]",
    )  # fmt: skip
    near_log_frequency: float = threshold(
        0.1, "ln frequency",
        "Ratio of frequencies below which two modes are the same whatever sensors make of the shape.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.near_log_frequency]",
    )  # fmt: skip
    same_log_frequency: float = threshold(
        0.02, "ln frequency",
        "Ratio of frequencies below which a mode of two tests is one.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.same_log_frequency]",
    )  # fmt: skip
    edge_ratio: float = threshold(
        1.3, "1",
        "Frequency over an end of the band up to which a pole that the model lacks may be noise: responses are "
        "small there.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[modes.edge_ratio]",
    )  # fmt: skip
    around_log_frequency: float = threshold(
        0.1, "ln frequency",
        "Frequencies around a mode that the model seems to lack in which it has to show.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.around_log_frequency]",
    )  # fmt: skip
    missed_sigmas: float = threshold(
        3.0, "σ",
        "Misfit of the lines around from which a channel shows that a mode is missing.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.missed_sigmas]",
    )  # fmt: skip
    certain_sigmas: float = threshold(
        10.0, "σ",
        "The same from which no effect is tried in its place.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.certain_sigmas]",
    )  # fmt: skip
    certain_channel_share: float = threshold(
        0.8, "1",
        "Share of the channels that have to show it for that.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.certain_channel_share]",
    )  # fmt: skip
    highest_measured_damping: float = threshold(
        0.05, "1",
        "Damping ratio beyond which a pole of a response is no mode.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.highest_measured_damping]",
    )  # fmt: skip
    highest_model_damping: float = threshold(
        0.3, "1",
        "Damping ratio beyond which a mode of the model is not paired.",
        "tests/diagnose/test_threshold_edges_of_predictions.py::test_a_threshold_decides[modes.highest_model_damping]",
    )  # fmt: skip
    fewest_lines: int = threshold(
        20, "1",
        "Fewer lines do not determine poles.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[modes.fewest_lines]",
    )  # fmt: skip
    least_width_lines: float = threshold(
        0.3, "lines",
        "Width of a resonance over the spacing of the lines below which a pole is noise.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[modes.least_width_lines]",
    )  # fmt: skip
