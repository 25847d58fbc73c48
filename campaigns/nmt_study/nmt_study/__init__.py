"""The paper's studies of its virtual experiment, each a list of cases, figures and findings."""

from __future__ import annotations

STUDIES: dict[str, tuple[str, str]] = {
    "exciter_location": (
        "nmt_study.exciter_location",
        "drive at points 2, 4, 5, 6: frequency, damping, participation, PBMIF, fundamental contents",
    ),
    "noise": ("nmt_study.noise", "sensor noise of the paper's table, and one and two decades more"),
    "linear_modes": ("nmt_study.linear_modes", "wrong scale and random errors of the linear shapes"),
    "joint_stiffness": (
        "nmt_study.joint_stiffness",
        "tangential stiffness of the joint from 8 to 500 kN/m; locks on the second mode",
    ),
    "harmonic_control": (
        "nmt_study.harmonic_control",
        "harmonics of the force left alone, brought to zero, or to modal power: error against EPMC, PBMIF, γ_F",
    ),
    "levels": ("nmt_study.levels", "levels upwards, downwards and up and down again"),
    "bench_time": (
        "nmt_study.bench_time",
        "accuracy against periods per level for four ways to test",
    ),
    "method_comparison": (
        "nmt_study.method_comparison",
        "joint resonator: phase resonance, ring-downs, sweeps, stepped sines; bench time, accuracy, noise",
    ),
    "identification": (
        "nmt_study.identification",
        "nonlinear subspace identification and the diagnosis' model on the same recordings: backbone, held-out sweep",
    ),
}
"""Module and one line of help of each study."""
