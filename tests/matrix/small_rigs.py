"""Rigs of two points for every kind of exciter, with a hardening spring, small enough for a test of a second."""

from __future__ import annotations

import yaml

from nmt_core.vocabulary import TestKind

SHAKER = {
    "kind": "electrodynamic_shaker",
    "table_mass_kg": 0.05, "table_stiffness_n_m": 500.0, "table_damping_ns_m": 2.0,
    "coil_mass_kg": 0.02, "coil_stiffness_n_m": 8.0e6, "coil_damping_ns_m": 20.0,
    "force_factor_n_a": 5.0, "inductance_h": 1.0e-4, "resistance_ohm": 3.0,
}  # fmt: skip
FORCE = {"kind": "force", "newton_per_volt": 1.0}
TABLE = {"kind": "shaking_table", "point": 1, "acceleration_per_volt_m_s2": 1.0}
EXCITERS = {
    "electrodynamic_shaker": [SHAKER],
    "force": [FORCE],
    "shaking_table": [TABLE],
    "2 electrodynamic_shaker": [SHAKER, SHAKER],
    "2 force": [FORCE, FORCE],
}
"""Exciters of each rig by a name for it."""


def rig_text(exciters: str, kind: TestKind, resonance: str = "") -> str:
    """Text of the rig file with these exciters; a self-excited test gets damping below zero.

    A 1:3 resonance gets one mass on the spring of the shipped `strong_cubic`: below 0.47 of 16 N it has none.
    """
    strong = resonance == "1:3"
    several = len(EXCITERS[exciters]) > 1
    sections = [
        dict(section) if "point" in section else {**section, "point": number + 1}
        for number, section in enumerate(EXCITERS[exciters])
    ]
    fed = kind is TestKind.SELF_EXCITED
    chain = {
        "kind": "chain",
        "masses_kg": [1.0, 1.0],
        "ground_springs_n_m": [16000.0, 16000.0],
        "ground_dampers_ns_m": [2.5, 2.5],
        # Close modes are what several exciters are for; a decay in which both ring is told by no mode of its own.
        "springs_n_m": [1500.0 if several and kind is not TestKind.RING_DOWN else 12000.0],
        "dampers_ns_m": [0.3],
    }
    if strong:
        chain = {"kind": "chain", "masses_kg": [1.0], "ground_springs_n_m": [16000.0], "ground_dampers_ns_m": [2.5]}
    cubic = 1.6e10 if strong else 2.0e8
    elements = [{"name": "hardening", "kind": "cubic_spring", "point": 1, "stiffness_n_m3": cubic}]
    if fed:
        flow = {"kind": "polynomial_damper", "point": 1, "damping_ns_m": -6.0, "damping_ns_m3": 1.0e6}
        elements.append({"name": "flow", **flow})
    noise = {"noise_correlation_time_s": 1.0e-5}
    sensors = [
        {"quantity": "force", "point": point, "noise_psd": 1.0e-10, **noise} for point in ((1, 2) if several else (1,))
    ]
    points = (1,) if strong else (1, 2)
    sensors += [{"quantity": "displacement", "point": point, "noise_psd": 1.0e-17, **noise} for point in points]
    sensors += [{"quantity": "voltage"}, *([{"quantity": "voltage", "exciter": 2}] if several else [])]
    return yaml.safe_dump(
        {
            "name": "small",
            "seed": 1,
            "sample_rate_hz": 5000 if fed or strong else 1000 if kind is TestKind.RANDOM else 2000,
            "block_samples": 25 if fed or strong else 20 if kind is TestKind.RANDOM else 40,
            "structure": chain,
            "local_elements": elements,
            **({"exciters": sections} if several else {"exciter": sections[0]}),
            "sensors": sensors,
            "limits": {"voltage_v": 200, "displacement_m": 0.05, "ramp_s": 0.1},
            "test": {
                "mode": 1, "levels": "0.5,1", "response_levels": "0.001,0.002", "ramp_s": 0.2, "window_periods": 20,
                "lock_timeout_s": 30,
            },
            "extraction": {"quantity": "displacement", "harmonics": 5, "linear_modes": len(points)},
            **({"pll": {"guard_high": 4.0}} if strong else {}),
        },
        sort_keys=False,
    )  # fmt: skip
