"""Messages whose definition in a bag is not the one of today: what they say, in the form of today.

A bag carries the definitions that its messages were written by. Where those of one of the bench's own types have the
fields of today in today's order, the bytes are taken as they are. Otherwise each message is read by the stored
definition and written again by today's: fields go by their names, wherever they stand; one that the bag lacks has the
default of the bench's record, and one that is unknown today is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.cdr import ENCAPSULATION
from nmt_core.messages.message_files import find_message_file, message_fields
from nmt_core.messages.wire import record_defaults
from nmt_record.bag.message_definitions import MessageDefinition, local_definitions, typestore_of

_OWN = "nmt_msgs/msg/"
_UNREADABLE = ENCAPSULATION
"""What a message that does not fit its own definition becomes: no codec takes it for a whole message."""

Translation = Callable[[bytes], bytes]


def is_translated(message_type: str, definition: MessageDefinition) -> bool:
    """Whether messages of a type are stored in another form than today's.

    Args:
        message_type: ``package/msg/Name``; only the bench's own types are ever translated.
        definition: that of the bag; without text it counts as today's.
    """
    if not message_type.startswith(_OWN) or not definition.text:
        return False
    try:
        today = _fields_of_today(message_type)
    except BenchError:
        return False  # a type of a later release: its readers, if any, say so
    return definition.encoding == "ros2idl" or message_fields(definition.text) != today


@lru_cache(maxsize=64)
def translation(message_type: str, definition: MessageDefinition, path: str) -> Translation | None:
    """What makes messages of today of the bytes in a bag; None where they are that already.

    A message that does not fit its own definition becomes one without fields, which every codec refuses.

    Args:
        message_type: ``package/msg/Name``.
        definition: that of the bag.
        path: of the bag, for errors.

    Raises:
        BenchError: the stored definition is malformed.
    """
    if not is_translated(message_type, definition):
        return None
    stored = typestore_of({message_type: definition}, path)
    local = local_definitions()
    names = local.fields(message_type)
    present = {name for name, _ in stored.fielddefs[message_type][1]}
    missing = _missing_values(local.typestore, message_type, present)
    make = local.typestore.types[message_type]

    def translate(raw: bytes) -> bytes:
        try:
            message = stored.deserialize_cdr(raw, message_type)
            values = {name: missing[name] if name in missing else getattr(message, name) for name in names}
            return bytes(local.typestore.serialize_cdr(make(**values), message_type))
        except Exception:  # generated code raises whatever the bytes lead it to
            return _UNREADABLE

    return translate


def _missing_values(store: Any, message_type: str, present: set[str]) -> dict[str, Any]:
    """Values of the fields of today that a stored definition lacks, as rosbags has them."""
    from rosbags.interfaces import Nodetype

    known: Mapping[str, Any] = record_defaults(message_type.removeprefix(_OWN))
    values: dict[str, Any] = {}
    for name, (node, detail) in store.fielddefs[message_type][1]:
        if name in present:
            continue
        empty = _empty(store, node, detail, Nodetype)
        values[name] = known[name] if name in known and isinstance(empty, (int, float, str)) else empty
    return values


def _empty(store: Any, node: Any, detail: Any, kinds: Any) -> Any:
    """The value that says nothing: NaN, 0, no text, no items."""
    import numpy as np

    if node == kinds.BASE:
        kind = detail[0]
        if kind == "string":
            return ""
        return float("nan") if kind.startswith("float") else False if kind == "bool" else 0
    if node == kinds.NAME:
        parts = {
            name: _empty(store, node_in, detail_in, kinds) for name, (node_in, detail_in) in store.fielddefs[detail][1]
        }
        return store.types[detail](**parts)
    (item_node, item_detail), count = detail
    items = [_empty(store, item_node, item_detail, kinds)] * (count if node == kinds.ARRAY else 0)
    numbers = item_node == kinds.BASE and item_detail[0] != "string"
    return np.array(items, item_detail[0]) if numbers else items


@lru_cache(maxsize=64)
def _fields_of_today(message_type: str) -> tuple[tuple[str, str], ...]:
    return message_fields(find_message_file(message_type).read_text(encoding="utf-8"))
