"""Clipping, steps of the converter, repeated samples and lines of the mains."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class ChannelFaultThresholds:
    """Clipping, steps of the converter, repeated samples and lines of the mains."""

    clipped_fewest_samples: int = threshold(
        6, "samples",
        "Fewer samples at one value happen without clipping.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.clipped_fewest_samples]",
    )  # fmt: skip
    clipped_fewest_visits: int = threshold(
        3, "1",
        "Visits to the level: one stop is a rest.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.clipped_fewest_visits]",
    )  # fmt: skip
    clipped_crowding: float = threshold(
        5.0, "1",
        "Samples at the level over the next: a sine has 2.4.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.clipped_crowding]",
    )  # fmt: skip
    clipped_neighbours: int = threshold(
        8, "values",
        "Values below the level whose samples are counted.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.clipped_neighbours]",
    )  # fmt: skip
    flat_depth: float = threshold(
        3e-3, "half swings",
        "Depth of a flat top.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.flat_depth]",
    )  # fmt: skip
    flat_edge_depth: float = threshold(
        3e-2, "half swings",
        "Depth of its edge.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.flat_edge_depth]",
    )  # fmt: skip
    flat_share: float = threshold(
        0.04, "periods",
        "Flat part of a period; a sine has 0.025.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.flat_share]",
    )  # fmt: skip
    step_samples: int = threshold(
        8192, "samples",
        "Samples searched for a converter step.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.step_samples]",
    )  # fmt: skip
    step_fewest_values: int = threshold(
        8, "values",
        "Fewer different values show no common step.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.step_fewest_values]",
    )  # fmt: skip
    step_rounding: float = threshold(
        0.02, "steps",
        "Rounding of numbers over a step.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.step_rounding]",
    )  # fmt: skip
    finest_step: float = threshold(
        1e-7, "ranges",
        "Finer than 24 bits is rounding.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.finest_step]",
    )  # fmt: skip
    mains_longest_s: float = threshold(
        4.0, "s",
        "Mains wanders by 0.05 Hz over longer pieces.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.mains_longest_s]",
    )  # fmt: skip
    mains_clearance_lines: float = threshold(
        3.0, "lines",
        "Side lobes of a harmonic cover nearer mains.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.mains_clearance_lines]",
    )  # fmt: skip
    mains_fewest_neighbours: int = threshold(
        8, "lines",
        "Fewer neighbouring lines do not show the noise.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.mains_fewest_neighbours]",
    )  # fmt: skip
    repeats_fewest: int = threshold(
        5, "samples",
        "Fewer repeated samples happen by chance.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.repeats_fewest]",
    )  # fmt: skip
    repeats_least_share: float = threshold(
        1e-4, "1",
        "A smaller share changes nothing that is measured.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.repeats_least_share]",
    )  # fmt: skip
    repeats_steepness: float = threshold(
        0.5, "rms step",
        "Typical steps from which a repeat is a fault.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.repeats_steepness]",
    )  # fmt: skip
    repeats_crowding: float = threshold(
        3.0, "1",
        "Repeats over such steps in one direction only.",
        "tests/signals/test_signal_threshold_edges.py::test_a_threshold_decides[signals.channel_faults.repeats_crowding]",
    )  # fmt: skip
