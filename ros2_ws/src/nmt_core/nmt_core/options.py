"""Options of a command as a frozen dataclass: argparse takes them from it and gives them back as one object with types.

>>> @dataclass(frozen=True, kw_only=True)
... class Options:
...     rig: str = argument("name of a rig")
...     points: int = option(400, "frequencies", metavar="N")
...     quiet: bool = option(False, "no progress display")
>>> parser = argparse.ArgumentParser()
>>> add_options(parser, Options)
>>> options_of(Options, parser.parse_args(["beam", "--points", "7"]))
Options(rig='beam', points=7, quiet=False)

The annotation of a field is the type of its option: ``bool`` a switch, a tuple an option that may be repeated,
``X | None`` one that may be missing. A field is called as its option is, with ``_`` for ``-``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from nmt_core.settings import ordered_fields

T = TypeVar("T")
_OPTION = "nmt option"


@dataclass(frozen=True, slots=True)
class OptionMeaning:
    """What a field says of its option besides type and default.

    Attributes:
        help: its words in the help.
        name: its name where that is not the field's, such as ``--from``; empty for an argument without a name.
        metavar: stands for the value in the help; empty = as argparse has it.
        choices: allowed values; empty = any.
        parse: makes the value of a text where the annotation does not say how.
        counted: ``?`` or ``*``: an argument that may be missing, or any number of them.
        exclusive: one of several of which exactly one must be given.
        hidden: not in the help.
        factory: makes the default as the parser is made.
    """

    help: str
    name: str | None = None
    metavar: str = ""
    choices: tuple[str, ...] = ()
    parse: Callable[[str], Any] | None = None
    counted: str = ""
    exclusive: bool = False
    hidden: bool = False
    factory: Callable[[], Any] | None = None


def option(
    default: T,
    words: str,
    *,
    name: str | None = None,
    metavar: str = "",
    choices: Sequence[str] = (),
    parse: Callable[[str], T] | None = None,
    exclusive: bool = False,
    hidden: bool = False,
) -> T:
    """An option with a default; ``words`` are its help, for the rest see :class:`OptionMeaning`."""
    meaning = OptionMeaning(words, name, metavar, tuple(choices), parse, exclusive=exclusive, hidden=hidden)
    made: T = field(default=default, metadata={_OPTION: meaning})
    return made


def option_made(factory: Callable[[], T], words: str, *, name: str | None = None, metavar: str = "") -> T:
    """An option whose default is made as the command is called, such as a folder named after the time."""
    meaning = OptionMeaning(words, name, metavar, factory=factory)
    made: T = field(default_factory=factory, metadata={_OPTION: meaning})
    return made


def needed_option(words: str, *, name: str | None = None, metavar: str = "") -> Any:
    """An option that cannot be left out."""
    return field(metadata={_OPTION: OptionMeaning(words, name, metavar)})


def argument(words: str, *, metavar: str = "", choices: Sequence[str] = ()) -> Any:
    """An argument without a name that must be given."""
    return field(metadata={_OPTION: OptionMeaning(words, "", metavar, tuple(choices))})


def optional_argument(default: T, words: str, *, metavar: str = "", counted: str = "?", exclusive: bool = False) -> T:
    """An argument without a name that may be missing; ``counted="*"``: there may be several."""
    meaning = OptionMeaning(words, "", metavar, counted=counted, exclusive=exclusive)
    made: T = field(default=default, metadata={_OPTION: meaning})
    return made


def add_options(parser: argparse.ArgumentParser, kind: type) -> None:
    """Give a parser the options of a class, in the order of its fields, those of its bases last."""
    exclusive: Any = None
    types = get_type_hints(kind)
    for item in ordered_fields(kind):
        meaning: OptionMeaning | None = item.metadata.get(_OPTION)
        if meaning is None:
            continue
        if meaning.exclusive and exclusive is None:
            exclusive = parser.add_mutually_exclusive_group(required=True)
        settings = _settings(types[item.name], meaning)
        if meaning.factory is not None:
            settings["default"] = meaning.factory()
        elif item.default is not MISSING:
            settings["default"] = list(item.default) if isinstance(item.default, tuple) else item.default
        place = exclusive if meaning.exclusive else parser
        if meaning.name == "":
            place.add_argument(item.name, **settings)
            continue
        if item.default is MISSING and meaning.factory is None:
            settings["required"] = True
            if settings.get("action") == "append":
                settings["default"] = []
        place.add_argument(meaning.name or f"--{item.name.replace('_', '-')}", dest=item.name, **settings)


def _settings(annotation: Any, meaning: OptionMeaning) -> dict[str, Any]:
    """Arguments of ``add_argument`` but the default."""
    settings: dict[str, Any] = {"help": argparse.SUPPRESS if meaning.hidden else meaning.help}
    kinds = [kind for kind in get_args(annotation) or (annotation,) if kind not in (NoneType, Ellipsis)]
    if get_origin(annotation) is tuple and not meaning.counted:
        settings["action"] = "append"
    if annotation is bool:
        settings["action"] = "store_true"
        return settings
    if meaning.counted:
        settings["nargs"] = meaning.counted
    if meaning.metavar:
        settings["metavar"] = meaning.metavar
    if meaning.choices:
        settings["choices"] = meaning.choices
    kind = meaning.parse or kinds[0]
    if kind is not str:
        settings["type"] = kind
    return settings


def options_of(kind: type[T], arguments: argparse.Namespace) -> T:
    """The options of a class from what argparse has parsed: lists as tuples."""
    given: Mapping[str, Any] = vars(arguments)
    names = [item.name for item in fields(kind) if _OPTION in item.metadata]  # type: ignore[arg-type]
    return kind(**{name: tuple(given[name]) if isinstance(given[name], list) else given[name] for name in names})
