"""Settings as frozen dataclasses: what a field means, its unit, its range and its choices stand with the field.

The parameters of a node are the fields of one class. ROS descriptors, checks and the reference pages come from it, and
a misspelt name is an error of mypy:

>>> @dataclass(frozen=True)
... class Ramp:
...     seconds: float = setting(0.5, "Half-cosine between levels.", unit="s", low=0.0)
>>> settings_of(Ramp, {"seconds": 2}, "sequencer")
Ramp(seconds=2.0)

A field may hold settings itself, see :func:`group`; as parameters they stand with the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields
from functools import cache
from inspect import get_annotations
from typing import Any, TypeVar, cast

from nmt_core.errors import BenchError
from nmt_core.nodes.parameters import Parameter, ParameterValue

T = TypeVar("T")
_MEANING, _GROUP = "nmt meaning", "nmt group"


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a field says besides its type and default.

    Attributes:
        description: one sentence.
        unit: unit of the value, empty where it has none.
        low, high: inclusive bounds of a number or of every element of a tuple; None = unbounded.
        choices: allowed texts; empty = any.
    """

    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()


def setting(
    default: T,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: Sequence[str] = (),
) -> T:
    """A field of a settings class.

    Args:
        default: bool, int, float, str, or a tuple of one of these with at least one element (ROS cannot tell the type
            of an empty list); its type is that of the setting.
        description, unit, low, high, choices: see :class:`Meaning`.
    """
    meaning = Meaning(description, unit, low, high, tuple(choices))
    made: T = field(default=default, metadata={_MEANING: meaning})
    return made


def group(kind: type[T], prefix: str = "") -> T:
    """A field that holds other settings; ``prefix`` stands before their names where they are parameters of a node."""
    made: T = field(default_factory=kind, metadata={_GROUP: (kind, prefix)})
    return made


def parameters_of(kind: type) -> tuple[Parameter, ...]:
    """A class of settings as parameters: its own in their order, groups in place, then those of its base classes.

    Fields without a meaning are none.
    """
    return tuple(parameter for _, parameter in _parameters(kind))


def _parameters(kind: Any) -> tuple[tuple[tuple[str, ...], Parameter], ...]:
    """Every parameter with the names of the fields that lead to it."""
    return _kept_parameters(kind)


@cache
def _kept_parameters(kind: Any) -> tuple[tuple[tuple[str, ...], Parameter], ...]:
    return tuple(_found_parameters(kind))


def _found_parameters(kind: type) -> Iterator[tuple[tuple[str, ...], Parameter]]:
    for item in ordered_fields(kind):
        if _GROUP in item.metadata:
            inner, prefix = item.metadata[_GROUP]
            for path, own in _parameters(inner):
                yield (item.name, *path), own.renamed(prefix + own.name)
        elif _MEANING in item.metadata:
            yield (item.name,), _parameter(item)


def _parameter(item: Field[Any]) -> Parameter:
    meaning: Meaning = item.metadata[_MEANING]
    default: Any = list(item.default) if isinstance(item.default, tuple) else item.default
    return Parameter(item.name, default, meaning.unit, meaning.description, meaning.low, meaning.high, meaning.choices)


def ordered_fields(kind: Any) -> list[Field[Any]]:
    """Fields of a class before those of its bases."""
    found = {item.name: item for item in fields(kind)}
    names: dict[str, None] = {}
    for one in kind.__mro__:
        names |= dict.fromkeys(get_annotations(one) if one is not object else ())
    return [found[name] for name in names if name in found]


def settings_of(kind: type[T], values: Mapping[str, Any], owner: str) -> T:
    """Settings from values by name, as they come from ROS, a file or a user; what is not given has its default.

    Args:
        kind: a class of settings.
        values: as :func:`values_of` names them.
        owner: whose they are, for messages.

    Raises:
        BenchError: unknown name, or a value that :meth:`nmt_core.nodes.parameters.Parameter.check` refuses.
    """
    known = {parameter.name: (path, parameter) for path, parameter in _parameters(kind)}
    for name in values:
        if name not in known:
            raise BenchError(f"Parameter '{name}' is not known to {owner}; it knows {', '.join(sorted(known))}.")
    tree: dict[str, Any] = {}
    for name, (path, parameter) in known.items():
        if name in values:
            value = parameter.check(values[name], owner)
            place = tree
            for step in path[:-1]:
                place = place.setdefault(step, {})
            place[path[-1]] = tuple(value) if isinstance(value, list) else value
    return _built(kind, tree)


def _built(kind: type[T], tree: Mapping[str, Any]) -> T:
    groups = {item.name: item.metadata[_GROUP][0] for item in fields(cast("Any", kind)) if _GROUP in item.metadata}
    return kind(**{name: _built(groups[name], item) if name in groups else item for name, item in tree.items()})


def values_of(settings: Any) -> dict[str, ParameterValue]:
    """Every setting by its name as a parameter, in the types of ROS: tuples are lists."""
    values: dict[str, ParameterValue] = {}
    for path, parameter in _parameters(type(settings)):
        value = settings
        for step in path:
            value = getattr(value, step)
        values[parameter.name] = list(value) if isinstance(value, tuple) else value
    return values


def with_values(settings: T, values: Mapping[str, Any], owner: str) -> T:
    """The settings with other values for some, by their names as parameters.

    Raises:
        BenchError: as :func:`settings_of`.
    """
    return settings_of(type(settings), {**values_of(settings), **values}, owner) if values else settings
