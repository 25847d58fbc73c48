"""Chain of lumped masses: the joint resonator (paper section 4) and tests on few degrees of freedom."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_rig.model.structure import Structure


def lumped_chain(
    masses: Sequence[float],
    springs: Sequence[float],
    dampers: Sequence[float] | None = None,
    ground_springs: Sequence[float] | None = None,
    ground_dampers: Sequence[float] | None = None,
) -> Structure:
    """Masses 1..n in a row; spring and damper i join masses i and i+1; ground springs hold each mass.

    Args:
        masses: n masses, kg.
        springs: n - 1 stiffnesses between neighbours, N/m.
        dampers: n - 1 viscous dampers between neighbours, N s/m; none when omitted.
        ground_springs: n stiffnesses to the ground, N/m; none when omitted.
        ground_dampers: n dampers to the ground, N s/m; none when omitted.

    Returns:
        Structure with point i = mass i, i from 1; its base load is that of the ground moving.

    Raises:
        ValueError: lengths that do not fit, a mass that is not positive, or a negative spring or damper.
    """
    n = len(masses)
    if n == 0:
        raise ValueError("a chain needs at least one mass")

    def checked(name: str, values: Sequence[float] | None, count: int) -> list[float]:
        if values is None:
            return [0.0] * count
        if len(values) != count:
            raise ValueError(f"{name} needs {count} values for {n} masses, got {len(values)}")
        if not all(value >= 0 for value in values):
            raise ValueError(f"{name} must not be negative")
        return [float(value) for value in values]

    if not all(value > 0 for value in masses):
        raise ValueError("masses must be positive")

    def matrix(between: list[float], ground: list[float]) -> np.ndarray:
        result = np.diag(np.asarray(ground, dtype=float))
        for i, value in enumerate(between):
            result[i, i] += value
            result[i + 1, i + 1] += value
            result[i, i + 1] -= value
            result[i + 1, i] -= value
        return result

    return Structure(
        mass=np.diag(np.asarray(masses, dtype=float)),
        damping=matrix(checked("dampers", dampers, n - 1), checked("ground_dampers", ground_dampers, n)),
        stiffness=matrix(checked("springs", springs, n - 1), checked("ground_springs", ground_springs, n)),
        points={i + 1: i for i in range(n)},
        base_load=np.asarray(masses, dtype=float),
    )
