"""Where effects of the library may sit and how large they may be."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class CandidateThresholds:
    """Where effects of the library may sit and how large they may be."""

    mode_band_ratio: float = threshold(
        1.3, "1",
        "Frequency over a band's ends up to which a mode's own damping shows there.",
        "tests/diagnose/test_threshold_numbers.py::test_modes_near_the_band_of_the_tests_have_dampings_of_their_own",
    )  # fmt: skip
    large_delay_phase_rad: float = threshold(
        0.3, "rad",
        "Turn of the motion by a delay from which the first order fails and a fit begins there, too.",
        "tests/diagnose/test_threshold_edges_of_records.py::test_a_threshold_decides[candidates.large_delay_phase_rad]",
    )  # fmt: skip
    clip_depth: float = threshold(
        0.1, "ln",
        "Depth of clipping that is looked at where no samples stand at a level.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[candidates.clip_depth]",
    )  # fmt: skip
    clip_depth_at_level: float = threshold(
        0.5, "ln",
        "Depth that counts from a level at which samples stand.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[candidates.clip_depth_at_level]",
    )  # fmt: skip
    largest_gain_factor: float = threshold(
        2.0, "1",
        "Gain of a sensor over that of its stated unit: a peak taken for an rms or half a bridge is less, a unit more.",
        "tests/diagnose/test_refuted_sensor_effects.py::test_a_gain_stays_within_a_factor_of_two",
    )  # fmt: skip
    air_density_kg_m3: float = threshold(
        1.2, "kg/m³",
        "Air at 20 °C.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.air_density_kg_m3]",
    )  # fmt: skip
    largest_drag_coefficient: float = threshold(
        10.0, "1",
        "Of a plate that swings by about its width, where it is largest (Keulegan and Carpenter 1958).",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.largest_drag_coefficient]",
    )  # fmt: skip
    least_sheet_kg_m2: float = threshold(
        2.7, "kg/m²",
        "Mass of a sheet of aluminium of 1 mm over its area: the largest area that a mass is taken to have.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.least_sheet_kg_m2]",
    )  # fmt: skip
    largest_power_excess: float = threshold(
        9.0, "1",
        "Exponents of a power law beyond 1 that a rig file takes.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[candidates.largest_power_excess]",
    )  # fmt: skip
    oscillator_mass_shares: tuple[float, ...] = threshold(
        (0.01, 0.03, 0.1, 0.3, 1.0), "1",
        "Masses of an oscillator over what moves at its point from which fits of a missing mode begin.",
        "tests/diagnose/test_missing_mode.py::test_a_start_has_the_pole_of_the_responses",
    )  # fmt: skip
    least_oscillator_damping: float = threshold(
        1e-4, "1",
        "Damping ratio of an oscillator from which fits begin where noise says less.",
        "tests/diagnose/test_missing_mode.py::test_a_start_has_the_pole_of_the_responses",
    )  # fmt: skip
    region_change: float = threshold(
        0.05, "ln",
        "Change of a region's stiffness or mass that its strength is counted in: of models before updating.",
        "tests/diagnose/test_regions.py::test_a_region_is_a_candidate_where_it_has_a_matrix",
    )  # fmt: skip
    largest_region_factor: float = threshold(
        20.0, "1",
        "Factor on a region's stiffness or mass beyond which it is another part, not one that is off.",
        "tests/diagnose/test_regions.py::test_a_region_is_a_candidate_where_it_has_a_matrix",
    )  # fmt: skip
    least_motion_share: float = threshold(
        1e-3, "1",
        "Motion of a point over the largest below which an effect of the structure does nothing there.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[candidates.least_motion_share]",
    )  # fmt: skip
