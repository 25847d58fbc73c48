"""The message files ``<package>/msg/<Name>.msg``: where they are, and the fields that they describe."""

from __future__ import annotations

import os
from pathlib import Path
from sys import intern

from nmt_core.errors import BenchError

_HERE = Path(__file__).resolve()
_OWN = (_HERE.parents[3], _HERE.parents[1] / "definitions")  # the source tree; a wheel


def find_message_file(message_type: str) -> Path:
    """File of ``package/msg/Name``: of the source tree, of the wheel, or of a workspace on ``AMENT_PREFIX_PATH``.

    Raises:
        BenchError: there is none.
    """
    package, _, name = message_type.partition("/msg/")
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    for folder in (*_OWN, *(Path(prefix) / "share" for prefix in prefixes)):
        path = folder / package / "msg" / f"{name}.msg"
        if path.is_file():
            return path
    raise BenchError(
        f"The definition of message type {message_type} is not on this machine; "
        f"source the workspace that contains {package} or leave the topic out."
    )


def message_fields(text: str) -> tuple[tuple[str, str], ...]:
    """Name and type of each field in the text of a message, in order; without those of the messages in it."""
    own = text.partition("=" * 80)[0]
    lines = [line.partition("#")[0].split() for line in own.splitlines()]
    # Interned, because they become keywords of calls, which are found faster so.
    return tuple((intern(words[1]), words[0]) for words in lines if len(words) == 2 and "=" not in words[1])
