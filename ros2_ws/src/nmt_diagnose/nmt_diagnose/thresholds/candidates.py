"""Where effects of the library may sit and how large they may be."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class CandidateThresholds:
    """Where effects of the library may sit and how large they may be."""

    mode_band_ratio: float = threshold(
        1.3, "1",
        "Reach of a mode's damping beyond the band's ends.",
        "tests/diagnose/test_threshold_numbers.py::test_modes_near_the_band_of_the_tests_have_dampings_of_their_own",
    )  # fmt: skip
    large_delay_phase_rad: float = threshold(
        0.3, "rad",
        "Delay phase beyond the first order.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[candidates.large_delay_phase_rad]",
    )  # fmt: skip
    clip_depth: float = threshold(
        0.1, "ln",
        "Clipping depth tried without samples at a level.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[candidates.clip_depth]",
    )  # fmt: skip
    clip_depth_at_level: float = threshold(
        0.5, "ln",
        "Depth that counts from a level at which samples stand.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[candidates.clip_depth_at_level]",
    )  # fmt: skip
    largest_gain_factor: float = threshold(
        2.0, "1",
        "Larger factors are wrong units.",
        "tests/diagnose/test_refuted_sensor_effects.py::test_a_gain_stays_within_a_factor_of_two",
    )  # fmt: skip
    air_density_kg_m3: float = threshold(
        1.2, "kg/m³",
        "Air at 20 °C.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.air_density_kg_m3]",
    )  # fmt: skip
    largest_drag_coefficient: float = threshold(
        10.0, "1",
        "Largest, of an oscillating plate (Keulegan and Carpenter 1958).",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.largest_drag_coefficient]",
    )  # fmt: skip
    least_sheet_kg_m2: float = threshold(
        2.7, "kg/m²",
        "Aluminium of 1 mm: bounds the area of a mass.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.least_sheet_kg_m2]",
    )  # fmt: skip
    largest_power_excess: float = threshold(
        9.0, "1",
        "Largest exponent minus 1 in a rig file.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.largest_power_excess]",
    )  # fmt: skip
    oscillator_mass_shares: tuple[float, ...] = threshold(
        (0.01, 0.03, 0.1, 0.3, 1.0), "1",
        "Starting masses of a missing mode over the moving mass.",
        "tests/diagnose/test_missing_mode.py::test_a_start_has_the_pole_of_the_responses",
    )  # fmt: skip
    least_oscillator_damping: float = threshold(
        1e-4, "1",
        "Smallest starting damping ratio of an oscillator.",
        "tests/diagnose/test_missing_mode.py::test_a_start_has_the_pole_of_the_responses",
    )  # fmt: skip
    region_change: float = threshold(
        0.05, "ln",
        "Unit of a region's change: an unverified model.",
        "tests/diagnose/test_regions.py::test_a_region_is_a_candidate_where_it_has_a_matrix",
    )  # fmt: skip
    largest_region_factor: float = threshold(
        20.0, "1",
        "A larger factor means another part.",
        "tests/diagnose/test_regions.py::test_a_region_is_a_candidate_where_it_has_a_matrix",
    )  # fmt: skip
    least_motion_share: float = threshold(
        1e-3, "1",
        "Effects at points with less motion are skipped.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[candidates.least_motion_share]",
    )  # fmt: skip
