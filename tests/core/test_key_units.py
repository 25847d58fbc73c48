"""Units by the names of keys of rig files."""

from __future__ import annotations

import pytest

from nmt_core.key_units import unit_of_key


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("stiffness_n_m", "N/m"),
        ("stiffness_n_m3", "N/m³"),
        ("stiffness_n_m7", "N/m⁷"),  # of an element that somebody adds
        ("damping_ns_m3", "N s/m³"),
        ("drag_ns2_m2", "N s²/m²"),
        ("clamp_rotational_stiffness_nm_rad", "N m/rad"),
        ("density_kg_m3", "kg/m³"),
        ("youngs_modulus_pa", "Pa"),
        ("acceleration_per_volt_m_s2", "m/s²"),
        ("newton_per_volt", "N/V"),
        ("crosstalk_per_volt", "1"),  # of the channel's unit
        ("coefficient_n_sp_mp", "N sᵖ/mᵖ"),
        ("stiffness_per_s", "1/s"),
        ("force_factor_quadratic_per_m2", "1/m²"),
        ("resistance_ohm", "Ω"),
        ("slip_force_n", "N"),
        ("exponent", "1"),
        ("gain", "1"),
    ],
)
def test_the_end_of_a_key_tells_its_unit(key: str, unit: str) -> None:
    assert unit_of_key(key) == unit
