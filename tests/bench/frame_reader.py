"""Frames of the page as the browser reads them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from nmt_bench.page.frames import FRAME_LENGTH, MAGIC


def read_frame(raw: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Head and arrays of a frame, as the browser reads them.

    Raises:
        ValueError: not a whole frame.
    """
    if raw[:4] != MAGIC or len(raw) < 8:
        raise ValueError("not a frame of the page")
    (length,) = FRAME_LENGTH.unpack_from(raw, 4)
    head = json.loads(raw[8 : 8 + length])
    position, arrays = 8 + length, {}
    for name, size in head.pop("arrays"):
        if position + 4 * size > len(raw):
            raise ValueError("the frame ends early")
        arrays[name] = np.frombuffer(raw, "<f4", size, position)
        position += 4 * size
    return head, arrays
