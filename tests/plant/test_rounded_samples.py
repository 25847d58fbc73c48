"""Samples with fewer significant bits: what rounding does, and that a small bag gives the run's result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import rounded
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test


@pytest.mark.parametrize("bits", [1, 16, 24, 52])
def test_rounding_keeps_so_many_bits_and_goes_to_the_nearest(bits: int) -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal((3, 400)) * 10.0 ** rng.uniform(-30, 30, (3, 400))
    result = rounded(values, bits)
    assert np.all(np.abs(result - values) <= 2.0**-bits * np.abs(values))
    mantissa, _ = np.frexp(result)
    assert np.array_equal(np.round(mantissa * 2.0**bits), mantissa * 2.0**bits)
    assert np.array_equal(rounded(result, bits), result)


def test_rounding_to_24_bits_is_single_precision() -> None:
    values = np.random.default_rng(4).standard_normal(1000)
    assert np.array_equal(rounded(values, 24), values.astype(np.float32).astype(np.float64))


def test_rounding_leaves_what_is_no_number_and_all_bits() -> None:
    odd = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1.0 - 2.0**-53])
    result = rounded(odd, 24)
    assert np.array_equal(result[:5], odd[:5], equal_nan=True)
    assert result[5] == 1.0
    assert np.array_equal(rounded(odd, 53), odd, equal_nan=True)
    with pytest.raises(ValueError, match="1 to 53"):
        rounded(odd, 54)


def test_a_small_bag_gives_the_result_of_the_run(tmp_path: Path) -> None:
    sizes, points = {}, {}
    for name, overrides in (("plain", []), ("small", ["recording.sample_bits=24"])):
        with Session(plan_test(load_rig("beam", overrides), [0.3], window_periods=20), tmp_path / name) as session:
            points[name] = session.run().points
        bag = tmp_path / name / "bag"
        sizes[name] = sum(path.stat().st_size for path in bag.glob("*.mcap"))
        (offline,) = extract_bag(bag).points
        assert offline.omega_rad_s == points[name][0].omega_rad_s
        assert offline.damping_ratio == points[name][0].damping_ratio
        assert np.array_equal(offline.normalised_shape, points[name][0].normalised_shape)
    for block in Bag.open(tmp_path / "small" / "bag").blocks("force"):
        assert np.array_equal(block.data, block.data.astype(np.float32))
    assert sizes["small"] < 0.6 * sizes["plain"]
    (plain,), (small,) = points["plain"], points["small"]
    for quantity in ("omega_rad_s", "damping_ratio", "modal_amplitude"):
        change = abs(getattr(small, quantity) - getattr(plain, quantity))
        assert change < 0.05 * getattr(plain, f"{quantity}_std")


@pytest.mark.parametrize(
    "override",
    ["recording.sample_bits=8", "recording.sample_bits=54", "recording.compression=gzip", "recording.bits=24"],
)
def test_a_wrong_recording_is_a_sentence(override: str) -> None:
    with pytest.raises(BenchError, match="recording"):
        load_rig("beam", [override])
