"""Settings of the predictor."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PredictionSettings:
    """How finely the predictor computes.

    Attributes:
        harmonics: highest order of the harmonic balance; raised to that of a test's observables where they need more.
        mesh_refinement: least number of beam elements between two points, where finer than the rig file says.
            The rig file's own mesh is the model: a gap that a finer one would close is a gap of the model.
        samples: samples per period of smooth elements and of clipping; None = enough for polynomials without aliasing.
        kept_modes: modes of the structure that are kept besides the static shapes of all places where a force or a
            sensor sits; None = all, where the structure has no more than ``full_size`` degrees of freedom.
        full_size: see ``kept_modes``.
        iterations: limit of Newton's method per level.
        tolerance: of the last Newton step, relative to the solution.
    """

    harmonics: int = 9
    mesh_refinement: int = 1
    samples: int | None = None
    kept_modes: int = 16
    full_size: int = 40
    iterations: int = 30
    tolerance: float = 1e-9
