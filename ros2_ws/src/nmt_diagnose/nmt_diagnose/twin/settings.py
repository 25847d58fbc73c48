"""Settings of the twin."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TwinSettings:
    """How finely the twin computes.

    Attributes:
        harmonics: highest order of the harmonic balance; raised to that of a test's observables where they need more.
        mesh_refinement: least number of beam elements between two points; 2 keeps the error of the third mode's
            frequency below 1e-4 with seven points, 1 leaves 1e-3.
        samples: samples per period of smooth elements and of clipping; None = enough for polynomials without aliasing.
        kept_modes: modes of the structure that are kept besides the static shapes of all places where a force or a
            sensor sits; None = all, where the structure has no more than ``full_size`` degrees of freedom.
        full_size: see ``kept_modes``.
        iterations: limit of Newton's method per level.
        tolerance: of the last Newton step, relative to the solution.
    """

    harmonics: int = 7
    mesh_refinement: int = 2
    samples: int | None = None
    kept_modes: int = 16
    full_size: int = 40
    iterations: int = 30
    tolerance: float = 1e-9
