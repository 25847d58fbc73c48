"""Parameters: every refusal, documentation."""

from __future__ import annotations

import math

import pytest

from nmt_core.errors import BenchError
from nmt_core.nodes.parameters import Parameter, markdown_list

TABLE = (
    Parameter("rate", 10.0, "Hz", "A rate.", low=1.0, high=100.0),
    Parameter("count", 3, "blocks", "A count.", low=1),
    Parameter("name", "beam", "", "A name."),
    Parameter("pacing", "lockstep", "", "A choice.", choices=("lockstep", "realtime")),
    Parameter("on", True, "", "A switch."),
    Parameter("gains", [1.0, 2.0], "1/s", "Numbers.", low=0.0),
    Parameter("points", [1, 2], "", "Points.", low=0),
    Parameter("topics", [""], "", "Names."),
)


def checked(given: dict[str, object]) -> dict[str, object]:
    by_name = {item.name: item for item in TABLE}
    return {name: by_name[name].check(value, "node") for name, value in given.items()}


def test_a_whole_number_serves_as_a_real_one():
    value = checked({"rate": 20})["rate"]
    assert (value, type(value)) == (20.0, float)
    gains = checked({"gains": [1, 2.5]})["gains"]
    assert [type(gain) for gain in gains] == [float, float]


def test_bounds_are_inclusive():
    assert checked({"rate": 1.0, "count": 1})["rate"] == 1.0
    assert checked({"rate": 100.0})["rate"] == 100.0


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"rate": "10"}, r"^Parameter 'rate' of node must be of type float, got '10'\.$"),
        ({"rate": True}, r"^Parameter 'rate' of node must be of type float, got True\.$"),
        ({"rate": None}, r"^Parameter 'rate' of node must be of type float, got None\.$"),
        ({"rate": math.nan}, r"^Parameter 'rate' of node must be finite, got nan\.$"),
        ({"rate": math.inf}, r"^Parameter 'rate' of node must be finite, got inf\.$"),
        ({"rate": 0.5}, r"^Parameter 'rate' of node must be at least 1 Hz, got 0\.5\.$"),
        ({"rate": 101.0}, r"^Parameter 'rate' of node must be at most 100 Hz, got 101\.$"),
        ({"count": 1.0}, r"^Parameter 'count' of node must be of type int, got 1\.0\.$"),
        ({"count": True}, r"^Parameter 'count' of node must be of type int, got True\.$"),
        ({"count": 0}, r"^Parameter 'count' of node must be at least 1 blocks, got 0\.$"),
        ({"name": 3}, r"^Parameter 'name' of node must be of type str, got 3\.$"),
        ({"pacing": "fast"}, r"^Parameter 'pacing' of node must be one of lockstep, realtime, got 'fast'\.$"),
        ({"on": 1}, r"^Parameter 'on' of node must be of type bool, got 1\.$"),
        ({"gains": [1.0, -2.0]}, r"^Parameter 'gains' of node must be at least 0 1/s, got -2\.$"),
        ({"gains": [1.0, math.nan]}, r"^Parameter 'gains' of node must be finite, got nan\.$"),
        ({"points": [1, -1]}, r"^Parameter 'points' of node must be at least 0, got -1\.$"),
    ],
)
def test_each_refusal_is_a_sentence(given, sentence):
    with pytest.raises(BenchError, match=sentence):
        checked(given)


@pytest.mark.parametrize(
    "given", [{"gains": 3.0}, {"gains": ["much"]}, {"points": [1.5]}, {"points": ["a"]}, {"topics": "force"}]
)
def test_lists_of_the_wrong_kind_are_refused(given):
    with pytest.raises(BenchError, match=r"^Parameter '\w+' of node must"):
        checked(given)


def test_markdown_has_a_line_for_each_parameter():
    lines = markdown_list(TABLE).splitlines()
    assert len(lines) == len(TABLE)
    assert lines[0] == "* `rate` (`10.0`, Hz, ≥ 1 ≤ 100): A rate."
    assert lines[3] == "* `pacing` (`'lockstep'`, lockstep or realtime): A choice."
