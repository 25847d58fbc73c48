"""Texts and hashes of message definitions, which make a bag readable where the message packages are absent.

The texts of the bench's own messages are those of :mod:`nmt_core.messages.message_files`. The common ones come with
``rosbags``, which is imported where it is used: the bench's own bags are read without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.message_files import find_message_file

_SECTION = "=" * 80


@dataclass(frozen=True, slots=True)
class MessageDefinition:
    """What a bag says about a message type.

    Attributes:
        text: ros2msg text, followed by that of every message it contains; or ros2idl text.
        type_hash: ``RIHS01_…`` hash of the type; empty if not known.
        encoding: ``ros2msg`` or ``ros2idl``; empty if not known.
    """

    text: str
    type_hash: str = ""
    encoding: str = "ros2msg"


class DefinitionStore:
    """Definitions of message types on this machine, looked up when first asked for.

    Attributes:
        typestore: the ``rosbags`` type store that holds every type asked for so far.
    """

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.typestore = get_typestore(Stores.ROS2_JAZZY)
        self._texts: dict[str, str] = {}

    def definition(self, message_type: str) -> MessageDefinition:
        """Definition of ``package/msg/Name`` with everything it contains.

        Raises:
            BenchError: the type is not to be found or its text is malformed.
        """
        self._register(message_type)
        generated, _ = self.typestore.generate_msgdef(message_type, ros_version=2)
        own, *contained = generated.split(f"{_SECTION}\n")
        # The text of the source carries the comments: units and the meaning of NaN travel with the bag.
        text = self._texts.get(message_type, own).rstrip("\n") + "\n"
        for section in contained:
            head, _, body = section.partition("\n")
            package, _, name = head.removeprefix("MSG: ").rpartition("/")
            body = self._texts.get(f"{package}/msg/{name}", body)
            text += f"{_SECTION}\n{head}\n{body.rstrip()}\n"
        return MessageDefinition(text, self.typestore.hash_rihs01(message_type))

    def fields(self, message_type: str) -> tuple[str, ...]:
        """Names of the fields of a type, in the order of the wire."""
        self._register(message_type)
        return tuple(name for name, _ in self.typestore.fielddefs[message_type][1])

    def _register(self, message_type: str) -> None:
        if message_type in self.typestore.fielddefs:
            return
        path = find_message_file(message_type)
        text = path.read_text(encoding="utf-8")
        from rosbags.typesys import get_types_from_msg

        try:
            self.typestore.register(get_types_from_msg(text, message_type))
        except Exception as error:  # the parser raises whatever its grammar meets
            raise BenchError(f"The message definition {path} cannot be read: {_first_line(error)}") from error
        self._texts[message_type] = text
        for _, description in self.typestore.fielddefs[message_type][1]:
            contained = _contained_type(description)
            if contained:
                self._register(contained)


def typestore_of(definitions: dict[str, MessageDefinition], path: str) -> Any:
    """A ``rosbags`` type store made of the definitions in a bag; the same one for the same definitions.

    Making one compiles code for every type, which takes most of the time of opening a short bag.

    Args:
        definitions: by message type; a type without text is looked up on this machine.
        path: of the bag, for the message.

    Raises:
        BenchError: a definition is malformed, contradicts another, or is missing here and in the bag.
    """
    known = [
        (message_type, definition if definition.text else local_definitions().definition(message_type))
        for message_type, definition in definitions.items()
    ]
    try:
        return _compiled_store(tuple(known))
    except _UnreadableError as error:
        raise BenchError(
            f"The bag {path} holds an unreadable definition of {error.message_type} ({_first_line(error.cause)}); "
            "record it again or take the topic out of the bag."
        ) from error.cause


class _UnreadableError(Exception):
    """What the parser said of the definition of a type."""

    def __init__(self, message_type: str, cause: Exception) -> None:
        super().__init__(message_type)
        self.message_type, self.cause = message_type, cause


@lru_cache(maxsize=32)
def _compiled_store(definitions: tuple[tuple[str, MessageDefinition], ...]) -> Any:
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    for message_type, definition in definitions:
        parse = get_types_from_idl if definition.encoding == "ros2idl" else get_types_from_msg
        try:
            if parse is get_types_from_idl:
                store.register(parse(_idl_of(definition.text)))
            else:
                store.register(parse(definition.text, message_type))
            store.get_msgdef(message_type)
        except Exception as error:  # the parser raises whatever its grammar meets
            raise _UnreadableError(message_type, error) from error
    return store


@lru_cache(maxsize=1)
def local_definitions() -> DefinitionStore:
    """The definitions of this machine, loaded once."""
    return DefinitionStore()


def _contained_type(description: Any) -> str | None:
    from rosbags.interfaces import Nodetype

    kind, detail = description
    if kind == Nodetype.NAME:
        return str(detail)
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and detail[0][0] == Nodetype.NAME:
        return str(detail[0][1])
    return None


def _idl_of(text: str) -> str:
    """The definitions in a text as a recorder writes it: each behind a line of signs and one with its name."""
    lines = text.splitlines()
    return "\n".join(line for line in lines if line != _SECTION and not line.startswith("IDL: "))


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
