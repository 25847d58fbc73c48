from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_rig.reference import single_point_reference
from nmt_rig.rig import load_rig
from nmt_rig.slipping_reference import single_point_reference_from_above, softened

KEY = "local_elements.0.tangential_stiffness_n_m"


def test_from_above_and_from_rest_meet():
    rig = load_rig("beam", [f"{KEY}=20e3"])
    levels = [0.5, 1.0, 3.0]
    above = single_point_reference_from_above(rig, levels, 5)
    rest = single_point_reference(rig, None, levels, 5)
    assert above.level == pytest.approx(levels)
    assert above.mode.omega_rad_s == pytest.approx(rest.mode.omega_rad_s, rel=1e-8)
    assert above.mode.damping_ratio == pytest.approx(rest.mode.damping_ratio, rel=1e-7)


def test_it_reaches_what_cannot_be_reached_from_rest():
    rig = load_rig("beam", [f"{KEY}=100e3"])
    with pytest.raises(BenchError, match="no phase resonance"):
        single_point_reference(rig, None, [1.0, 3.0], 5)
    reference = single_point_reference_from_above(rig, [0.05, 1.0, 3.0], 9)
    # Deep in the sticking range there is no phase resonance: that level is left out.
    assert reference.level == pytest.approx([1.0, 3.0])
    assert not reference.single_valued
    # Nearly the free beam, whose first mode lies at 116.5 rad/s.
    assert np.all(np.diff(reference.mode.omega_rad_s) < 0.0)
    assert reference.mode.omega_rad_s == pytest.approx([120.7, 116.95], rel=1e-3)


def test_what_has_no_slipping_range_is_refused():
    with pytest.raises(BenchError, match="no Jenkins"):
        single_point_reference_from_above(load_rig("beam").model_copy(update={"local_elements": []}), [1.0])
    with pytest.raises(BenchError, match="positive"):
        single_point_reference_from_above(load_rig("beam"), [])
    assert softened(load_rig("beam"), 0.5).local_elements[0].tangential_stiffness_n_m == 4000.0
