"""Settings as dataclasses: parameters made from them, and settings made from values by name."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from nmt_core.errors import BenchError
from nmt_core.nodes.parameters import Parameter
from nmt_core.settings import group, parameters_of, setting, settings_of, values_of, with_values


@dataclass(frozen=True)
class Common:
    pacing: str = setting("realtime", "What paces.", choices=("lockstep", "realtime"))
    linked: bool = setting(False, "Whether.")


@dataclass(frozen=True)
class Gains:
    gain: float = setting(2.0, "Gain.", unit="1/s", low=0.0)
    derived: float = 0.0  # no parameter


@dataclass(frozen=True)
class Node(Common):
    rate: float = setting(10.0, "A rate.", unit="Hz", low=1.0, high=100.0)
    pacing: str = setting("lockstep", "What paces this one.", choices=("lockstep", "realtime"))
    gains: Gains = group(Gains)
    others: Gains = group(Gains, prefix="other_")
    topics: tuple[str, ...] = setting(("force",), "Topics.")


def test_parameters_are_the_fields_with_a_meaning_groups_in_place_and_those_of_the_base_last() -> None:
    assert parameters_of(Node) == (
        Parameter("rate", 10.0, "Hz", "A rate.", low=1.0, high=100.0),
        Parameter("pacing", "lockstep", "", "What paces this one.", choices=("lockstep", "realtime")),
        Parameter("gain", 2.0, "1/s", "Gain.", low=0.0),
        Parameter("other_gain", 2.0, "1/s", "Gain.", low=0.0),
        Parameter("topics", ["force"], "", "Topics."),
        Parameter("linked", False, "", "Whether."),
    )


def test_settings_and_values_by_name_are_the_same_thing() -> None:
    node = Node(rate=20.0, gains=Gains(3.0), others=Gains(4.0), topics=("a", "b"), linked=True)
    values = values_of(node)
    assert values["topics"] == ["a", "b"]
    assert (values["gain"], values["other_gain"]) == (3.0, 4.0)
    assert settings_of(Node, values, "node") == node
    assert settings_of(Node, {}, "node") == Node()
    assert values_of(Node()) == {item.name: item.default for item in parameters_of(Node)}


def test_a_whole_number_serves_as_a_real_one() -> None:
    rate = settings_of(Node, {"rate": 20}, "node").rate
    assert (rate, type(rate)) == (20.0, float)


def test_some_settings_are_changed_by_name() -> None:
    changed = with_values(Node(rate=20.0), {"other_gain": 5.0}, "node")
    assert changed == Node(rate=20.0, others=Gains(5.0))


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"rat": 1.0}, r"^Parameter 'rat' is not known to node; it knows gain, .*, topics\.$"),
        ({"derived": 1.0}, r"^Parameter 'derived' is not known to node"),
        ({"rate": 0.5}, r"^Parameter 'rate' of node must be at least 1 Hz, got 0\.5\.$"),
        ({"other_gain": -1.0}, r"^Parameter 'other_gain' of node must be at least 0 1/s, got -1\.$"),
        ({"topics": "force"}, r"^Parameter 'topics' of node must be a list, got 'force'\.$"),
    ],
)
def test_each_refusal_is_a_sentence(given: dict[str, object], sentence: str) -> None:
    with pytest.raises(BenchError, match=sentence):
        settings_of(Node, given, "node")
