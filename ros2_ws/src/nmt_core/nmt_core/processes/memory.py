"""Memory of a process that lives long and handles blocks."""

from __future__ import annotations

import contextlib
import ctypes
import gc

# Options of mallopt of glibc, and the size from which a piece of memory is one of its own.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _LARGE_BYTES = -1, -3, 256 * 1024


def calm_collector(collect: bool = True) -> None:
    """Keep the cyclic collector off what lives as long as the node, and from looking often.

    Blocks and messages are freed by reference counting; a collection over everything that was imported would stop the
    sample path for tens of milliseconds.

    Args:
        collect: free what is garbage first; that looks at all that the program holds.
    """
    if collect:
        gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 50, 100)


def return_large_memory() -> None:
    """Large messages go back to the system as they are freed.

    The C library keeps freed memory of up to 32 MB a piece once a piece of that size has been freed. Between messages
    of many channels it stays in pieces that hardly anything fits: 30 MB in each node with 64 channels. Other libraries
    than glibc are left as they are.
    """
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, _LARGE_BYTES)
        library.mallopt(_TRIM_THRESHOLD, _LARGE_BYTES)
