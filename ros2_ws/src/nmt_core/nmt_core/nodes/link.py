"""The sample path of a run in lockstep past the middleware: a Unix socket a node, a datagram a message.

Plant, loop and sequencer wait for each other block by block, and a delivery by the middleware costs more than a block.
Messages of `TAKEN_BY` go to the sockets of the nodes that take them, in this order.
Everybody else takes the topic. Why a drive stops goes the same way, so that it is there before the blocks of its ramp.
The kernel keeps order and loses nothing, and a socket's name lives no longer than its process. Only the user of the
process is heard. A queue of the kernel is short (``net.unix.max_dgram_qlen``, often 10 datagrams); what has no room in
it waits at its sender, which is woken as soon as there is some.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence

from nmt_core.messages.bundle import LOOP_INPUT, PLANT_BUNDLE, PLL_BUNDLE

TAKEN_BY: dict[str, tuple[str, ...]] = {
    LOOP_INPUT: ("pll",),
    "drive": ("plant",),
    "frequency": ("sequencer",),
    "lock": ("sequencer",),
    "level": ("extract", "pll"),  # extraction first: it has the level before what the loop makes of it
    "run_state": ("plant",),
    "drive_stop": ("sequencer",),
    "diagnostics": ("sequencer",),
    PLANT_BUNDLE: ("recorder", "extract"),
    PLL_BUNDLE: ("recorder", "extract"),
}
"""Topics that are handed over, each with the nodes that take them."""
_TOPICS = tuple(TAKEN_BY)
_PREFIX = {topic: bytes((number,)) for number, topic in enumerate(_TOPICS)}
_LONGEST = 262_144  # bytes; the kernel takes 212,992
_SENDER = struct.Struct("iII")  # process, user, group
_ROOM = socket.CMSG_SPACE(_SENDER.size)
_GONE = (errno.ECONNREFUSED, errno.ENOTCONN, errno.ECONNRESET)  # the name is unused, or its owner has ended
_SHORT_QUEUE = 8  # datagrams read in a row after which more may wait at their senders
_MORE = 1  # ms that they get to send them


class _Outbox:
    """What goes to one node, from a socket of its own: a reader that is slow or stopped holds up no other.

    The socket is connected, so that a poll tells when its reader has room.

    Attributes:
        bytes: that wait now.
        longest: most messages that have waited.
    """

    def __init__(self, address: bytes) -> None:
        self._address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        self._connected = False
        self._waiting: deque[bytes] = deque()
        self.bytes = self.longest = 0

    def fileno(self) -> int:
        return self._socket.fileno()

    def send(self, message: bytes) -> None:
        self._waiting.append(message)
        self.bytes += len(message)
        if not self.flush():
            self.longest = max(self.longest, len(self._waiting))

    def flush(self) -> bool:
        while self._waiting:
            try:
                if not self._sent(self._waiting[0]):
                    self._sent(self._waiting[0])  # to a node that was started anew; without any it is lost
            except BlockingIOError:
                return False
            self.bytes -= len(self._waiting.popleft())
        return True

    def _sent(self, message: bytes) -> bool:
        """Whether the reader has taken a message; False if there is none under its name."""
        try:
            if not self._connected:
                self._socket.connect(self._address)
                self._connected = True
            self._socket.send(message)
        except BlockingIOError:
            raise
        except OSError as error:
            if error.errno not in _GONE:
                raise
            self._connected = False
            return False
        return True

    def close(self) -> None:
        self._socket.close()


class Link:
    """The socket of one node.

    Args:
        bench: name of the bench on this host.
        node: name of the node in it.

    Raises:
        OSError: another node of this name is there.
    """

    def __init__(self, bench: str, node: str) -> None:
        self._bench = bench
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
            self._socket.bind(self._address(node))
        except BaseException:
            self._socket.close()
            raise
        self._user = os.getuid()
        self._buffer = memoryview(bytearray(_LONGEST))
        self._room = [self._buffer]
        self._takers: dict[int, Callable[[bytes], None]] = {}
        self._outboxes: dict[str, _Outbox] = {}

    def _address(self, node: str) -> bytes:
        return f"\0nmt {os.getuid()} {self._bench} {node}".encode()

    def fileno(self) -> int:
        """Its descriptor, for `select`."""
        return self._socket.fileno()

    def take(self, topic: str, callback: Callable[[bytes], None]) -> None:
        """Have the serialised messages of a topic handed to ``callback``."""
        self._takers[_PREFIX[topic][0]] = callback

    def sender(self, topic: str) -> Callable[[bytes], None]:
        """What hands a serialised message over; without its taker it is lost, as on a topic."""
        prefix = _PREFIX[topic]
        boxes = [self._outbox(node) for node in TAKEN_BY[topic]]

        def send(raw: bytes) -> None:
            message = prefix + raw
            for box in boxes:
                box.send(message)

        return send

    def _outbox(self, node: str) -> _Outbox:
        if node not in self._outboxes:
            self._outboxes[node] = _Outbox(self._address(node))
        return self._outboxes[node]

    def flush(self) -> bool:
        """Send what waits; whether everything has been."""
        sent = [box.flush() for box in self._outboxes.values()]
        return all(sent)

    def waiting(self) -> list[int]:
        """Descriptors of links with messages left for a reader; a poll says when that has room."""
        return [box.fileno() for box in self._outboxes.values() if box.bytes]

    @property
    def counters(self) -> dict[str, int]:
        """Of each reader: messages that have waited for it at most, and bytes that wait now."""
        counters: dict[str, int] = {}
        for node, box in self._outboxes.items():
            counters[f"outbox_{node}_longest"], counters[f"outbox_{node}_bytes"] = box.longest, box.bytes
        return counters

    def read(self) -> bool:
        """Hand one message on; False if none is there."""
        try:
            size, notes, _, _ = self._socket.recvmsg_into(self._room, _ROOM)
        except BlockingIOError:
            return False
        user = next((_SENDER.unpack_from(data)[1] for _, kind, data in notes if kind == socket.SCM_CREDENTIALS), None)
        if size and user == self._user:
            taker = self._takers.get(self._buffer[0])
            if taker is not None:
                taker(bytes(self._buffer[1:size]))
        return True

    def close(self) -> None:
        """Release the name."""
        self._socket.close()
        for box in self._outboxes.values():
            box.close()


def serve(links: Sequence[Link], seconds: float) -> None:
    """Hand on what comes over some links for a while of wall time (s), and send what waits as readers have room."""
    poll = select.poll()
    by_descriptor = {link.fileno(): link for link in links}
    for descriptor in by_descriptor:
        poll.register(descriptor, select.POLLIN)
    asked: set[int] = set()
    end = time.monotonic() + seconds
    while True:
        left = end - time.monotonic()
        if left <= 0.0:
            return
        full = {descriptor for link in links if not link.flush() for descriptor in link.waiting()}
        for descriptor in asked - full:
            poll.unregister(descriptor)
        for descriptor in full - asked:
            poll.register(descriptor, select.POLLOUT)
        asked = full
        for descriptor, _ in _polled(poll, 1e3 * left):
            if descriptor in by_descriptor:
                by_descriptor[descriptor].read()


def serve_late(link: Link, seconds: float) -> None:
    """Sleep for a while (s), then hand on what has come over a link: a wake-up serves several messages.

    The queue of a link is short. Where it was full its senders get a moment for each further message; otherwise no more
    than one queue would be taken at a time, however much waits.
    """
    link.flush()
    time.sleep(seconds)
    poll = select.poll()
    poll.register(link.fileno(), select.POLLIN)
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        if link.read():
            count += 1
        elif count < _SHORT_QUEUE or not _polled(poll, _MORE):
            break
    link.flush()


def _polled(poll: select.poll, milliseconds: float) -> list[tuple[int, int]]:
    try:
        return poll.poll(milliseconds)
    except InterruptedError:
        return []
