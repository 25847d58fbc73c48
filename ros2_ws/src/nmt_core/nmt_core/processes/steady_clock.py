"""The computer's steady clock and the ways to wait on it, as one object: a test gives a clock that it turns itself."""

from __future__ import annotations

import select
import socket
import threading
import time


class SteadyClock:
    """Time that only goes forward, s from an arbitrary origin that all processes of a computer share."""

    def now(self) -> float:
        """The present, s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Return after so many seconds, at once where they are not positive."""
        time.sleep(max(seconds, 0.0))

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Wait for an event for at most so many seconds; whether it is set."""
        return event.wait(max(seconds, 0.0))

    def wait_to_read(self, channel: socket.socket, seconds: float) -> bool:
        """Wait for a message, or for the end of the channel, for at most so many seconds; whether it is there."""
        return bool(select.select([channel], [], [], max(seconds, 0.0))[0])


STEADY_CLOCK = SteadyClock()
"""That of this computer."""
