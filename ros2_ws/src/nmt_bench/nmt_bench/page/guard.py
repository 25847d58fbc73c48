"""Who may see the page and who may steer: the guard of notebook servers.

The server listens on 127.0.0.1 only. A web site in the same browser can send requests there too, so each request must
name this very host (against DNS rebinding) and, where it changes anything or opens a socket, come from this very page
(``Origin``). The address that the terminal shows has a key that works once; the browser gets a session for it. A second
key only lets watch, as often as wanted.

Stopping needs no session: whoever is on this page of this host may stop, because a refused stop is worse than a false
one. Foreign pages are refused all the same.
"""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable
from enum import Enum


class Role(Enum):
    """What a session may do."""

    NOBODY = "nobody"
    WATCH = "watch"
    STEER = "steer"


_MOST_SESSIONS = 64


class Bucket:
    """Limits how often something may happen.

    Args:
        rate: times a second in the long run.
        burst: times at once.
        clock: s, monotonic.
    """

    def __init__(self, rate: float, burst: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._clock = rate, float(burst), clock
        self._left, self._seen = float(burst), clock()

    def take(self) -> bool:
        """Whether it may happen now."""
        now = self._clock()
        self._left = min(self._burst, self._left + self._rate * (now - self._seen))
        self._seen = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class _Session:
    """A role with limits of its own: what others send does not use them up."""

    def __init__(self, role: Role) -> None:
        self.role = role
        self.requests = Bucket(100.0, 400)
        self.orders = Bucket(5.0, 10)


class Guard:
    """Keys and sessions of one start of the server.

    Args:
        port: that the server listens on.
        host: address that it listens on.

    Attributes:
        steer_key: lets steer; works once.
        watch_key: lets watch.
    """

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self.steer_key = secrets.token_urlsafe(24)
        self.watch_key = secrets.token_urlsafe(24)
        self.cookie = f"nmt_page_{port}"
        """Name of the cookie: browsers share cookies between the ports of a host."""
        self.host = f"{host}:{port}"
        self.origin = f"http://{self.host}"
        self._unused = True
        self._sessions: dict[str, _Session] = {}
        self._stranger = _Session(Role.NOBODY)

    def exchange(self, key: str) -> str:
        """A session for a key; empty if the key is wrong or used up."""
        role = Role.NOBODY
        if _equal(key, self.steer_key) and self._unused:
            self._unused, role = False, Role.STEER
        elif _equal(key, self.watch_key):
            role = Role.WATCH
        if role is Role.NOBODY:
            return ""
        session = secrets.token_urlsafe(24)
        watchers = [name for name, known in self._sessions.items() if known.role is Role.WATCH]
        if len(self._sessions) >= _MOST_SESSIONS and watchers:
            del self._sessions[watchers[0]]
        self._sessions[session] = _Session(role)
        return session

    def _known(self, session: str) -> _Session:
        return next((known for name, known in self._sessions.items() if _equal(session, name)), self._stranger)

    def role(self, session: str) -> Role:
        """What a session may do."""
        return self._known(session).role

    def requests(self, session: str) -> Bucket:
        """Limit of the requests of a session; all without one share theirs."""
        return self._known(session).requests

    def orders(self, session: str) -> Bucket:
        """Limit of the orders of a session."""
        return self._known(session).orders

    def right_host(self, host: str | None) -> bool:
        """Whether a request names this server and no other."""
        return host == self.host

    def own_page(self, origin: str | None) -> bool:
        """Whether a request comes from a page of this server."""
        return origin == self.origin


def _equal(given: str, known: str) -> bool:
    return hmac.compare_digest(given.encode(), known.encode())
