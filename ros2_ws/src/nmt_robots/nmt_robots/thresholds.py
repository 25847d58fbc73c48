"""Numbers that decisions about robots hang on, with unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """Limits of a diagnosis of joints.

    Attributes:
        sticking_rad_s: speed below which a joint may stick; such rows are no equations, rad/s (m/s of a slide).
        smallest_share: of a joint's torque (rms); nothing smaller is claimed, a user's own tolerances are as large.
        smallest_new: the same of friction, damping and armature that a model does not state, so that it has no
            tolerance for them.
        certain: an effect is claimed beyond so many of its standard uncertainties.
        certain_over_readings: the same with the spread between readings of the log in the uncertainty, a bound.
        alike: cosine between what two effects add beyond the usual terms; above it they are one class.
        equal: the same cosine, above which two effects are one in any such log and bear one name.
        fits_as_well: a reading of the log whose pooled relative residual, squared, is larger by no more than this fits
            as well.
        smallest_floor: of a joint's torque; no set of causes is expected to leave less over, for the bodies have
            errors of that size.
        needed_gain: share by which an effect that is needed has to shrink what held-out rows leave over.
        unexplained: torque left over, as a share of the torque, from which a joint is not as in the model, and a gain
            of its drive is not told.
        may_give_way: torque left over, as a share of the torque, from which a link is simulated by itself.
        gives_way: torque left over by a transmission against that of the rigid bodies, below which it is one.
        moving_rows: share of rows; a joint that moves in fewer is not judged.
        lag_s: a delay below this is within what rows of a log can tell, s.
        clock_factor: a factor of all speeds that is off by more leaves nothing to be claimed of a joint: torques of the
            bodies have its square, which is as large as their tolerances.
        velocity_gain: a logged velocity whose factor to the derivative of the position is off by less is right.
        coulomb_tolerance, armature_tolerance, damping_tolerance: relative standard uncertainties of a model's own
            values; three of them are no finding.
        inertia_tolerance, mass_tolerance, torque_tolerance: relative standard uncertainties of a model's inertias and
            masses and of a torque constant or gain; every ± has them in it.
        held_rows: mean number of rows between changes of a command above which it is held over rows.
        exact: relative residual below which a torque is computed from the other columns and not measured.
    """

    sticking_rad_s: float = 0.06
    smallest_share: float = 0.03
    smallest_new: float = 0.01
    certain: float = 3.0
    certain_over_readings: float = 2.5
    alike: float = 0.95
    equal: float = 0.99
    fits_as_well: float = 0.06
    smallest_floor: float = 0.02
    needed_gain: float = 0.05
    unexplained: float = 0.15
    may_give_way: float = 0.05
    gives_way: float = 0.5
    moving_rows: float = 0.1
    lag_s: float = 0.001
    clock_factor: float = 0.04
    velocity_gain: float = 0.02
    coulomb_tolerance: float = 0.10
    armature_tolerance: float = 0.05
    damping_tolerance: float = 0.15
    inertia_tolerance: float = 0.05
    mass_tolerance: float = 0.02
    torque_tolerance: float = 0.02
    held_rows: float = 1.5
    exact: float = 3e-3


THRESHOLDS = Thresholds()
