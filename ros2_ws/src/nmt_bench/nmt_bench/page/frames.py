"""Binary frames for the browser: a JSON head and arrays of numbers of four bytes.

A frame is the text ``NMT1``, the length of the head (uint32), the head, and the arrays one after the other, all little
endian and each part padded to four bytes. The head is a JSON object; its key ``arrays`` gives name and length of each.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from nmt_bench.page.decimation import as_float32
from nmt_core.files.plain_json import plain_json

MAGIC = b"NMT1"
FRAME_LENGTH = struct.Struct("<I")


def write_frame(head: Mapping[str, Any], arrays: Mapping[str, Any]) -> bytes:
    """A frame.

    Args:
        head: what goes into the JSON head, without ``arrays``.
        arrays: one-dimensional arrays of numbers by name.
    """
    parts = {name: as_float32(np.asarray(array, dtype=np.float64).ravel()) for name, array in arrays.items()}
    listed = [[name, part.size] for name, part in parts.items()]
    text = json.dumps(plain_json({**head, "arrays": listed}), ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join((MAGIC, FRAME_LENGTH.pack(len(text)), text, *(part.tobytes() for part in parts.values())))
