"""Who may connect: limits of connections, whom to let go for whom, descriptors that run out."""

import asyncio
import errno
import math
import socket
from collections import Counter, OrderedDict
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from ipaddress import IPv6Address, ip_address
from time import monotonic
from typing import Protocol

from gsynopsis.serve.refusal import is_whole, refused_at_once

BACKLOG = 2048
"""Connections that the system keeps until they are accepted."""
ACCEPTS = 8
"""Connections accepted in a row; then those that are open get their turn."""
RESERVE = 64 + 2 * ACCEPTS
"""Descriptors that are not for clients: what the process has open, and two rows."""
CHECK_SECONDS = 1.0
"""Between two looks at the connections, at most."""
PAUSE_SECONDS = 1.0
"""Nothing is accepted for so long after the system had no descriptor left."""
PEEKED = 4096
"""Bytes of a request that are looked at before there is a connection for it."""
EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
REFUSAL = (
    b"HTTP/1.1 503 Service Unavailable\r\nretry-after: 1\r\n"
    b"content-length: 0\r\nconnection: close\r\n\r\n"
)


@dataclass(frozen=True)
class Limits:
    """How long and for how many clients the server waits.

    Attributes:
        head_seconds: A request's head has to be whole so long after its first byte, and a
            connection's first byte has to come in that time.
        idle_seconds: A connection may rest so long between two requests.
        send_seconds: A client has to take what is buffered for it, some 64 KiB, within that time.
        stalled_seconds: One that takes nothing for so long goes first when there is no room.
        spared_seconds: Who keeps us waiting for less is not let go for another one.
        hurried_seconds: The same for one that was never answered, where the other one has already
            sent its request. A request follows the last packet of the handshake, so that a long way
            takes nothing of this time.
        linger_seconds: A client whose request was refused has so long to take the answer and leave.
        connections: At most, in all; fewer where the process may not open that many files.
        share: Of them, at most this share from one address.
    """

    head_seconds: float = 15.0
    idle_seconds: float = 20.0
    send_seconds: float = 30.0
    stalled_seconds: float = 1.0
    spared_seconds: float = 0.25
    hurried_seconds: float = 0.05
    linger_seconds: float = 5.0
    connections: int = 4096
    share: float = 0.5

    @property
    def per_address(self) -> int:
        """Connections from one address, at most."""
        return max(1, math.floor(self.share * self.connections))

    def fitted(self) -> "Limits":
        """The same with as many connections as this process can have, each with an open file."""
        files = descriptors(2 * self.connections + RESERVE)
        return replace(self, connections=max(1, min(self.connections, (files - RESERVE) // 2)))


def descriptors(wanted: int) -> int:
    """How many files this process may open, after asking the system for what is wanted."""
    try:
        import resource
    except ImportError:  # Windows, whose sockets are no files
        return wanted
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    infinite = resource.RLIM_INFINITY
    if soft == infinite or soft >= wanted:
        return wanted
    most = wanted if hard == infinite else min(wanted, hard)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    except (OSError, ValueError):
        return soft
    return most


class Client(Protocol):
    """An open connection, as the gate knows it."""

    host: str

    def drop(self) -> None:
        """Break it now; `Gate.leave` follows."""
        ...

    def check(self, now: float) -> None:
        """End it if its time is over; `now` in seconds of the event loop."""
        ...


class Gate:
    """Counts connections; when there are too many, those that keep us waiting go first."""

    def __init__(self, limits: Limits) -> None:
        """No connection is open yet."""
        self.limits = limits
        self._clients: set[Client] = set()
        self._watched = False
        waits = limits.head_seconds, limits.idle_seconds, limits.send_seconds
        shortest = min(*waits, limits.stalled_seconds, limits.linger_seconds)
        self._interval = min(CHECK_SECONDS, shortest / 4)
        self._total = self._coming = 0
        self._from = Counter[str]()
        # When the waiting for each began; the first is let go first, after all those that yield.
        self._waiting: OrderedDict[Client, float] = OrderedDict()
        self._yielding: OrderedDict[Client, float] = OrderedDict()
        # Those that wait for their first answer are waiting, too.
        self._new: OrderedDict[Client, float] = OrderedDict()

    @property
    def busy(self) -> bool:
        """As many were admitted in a row as may be; they enter before anybody else comes."""
        return self._coming >= ACCEPTS

    @property
    def count(self) -> int:
        """Connections that are open."""
        return self._total

    def admit(self, host: str, *, ready: bool = False) -> bool:
        """Whether one more from there may come in; if so, it is counted until it leaves.

        Args:
            host: Its address.
            ready: Its request is here.
        """
        full = self._from[host] >= self.limits.per_address
        room = self.has_room(host) or self.make_room(host if full else "", ready=ready)
        if room:
            self._total += 1
            self._coming += 1
            self._from[host] += 1
        return room

    def has_room(self, host: str) -> bool:
        """Nobody has to go for one more from there."""
        within = self._from[host] < self.limits.per_address
        return within and self._total < self.limits.connections

    def make_room(self, host: str = "", *, ready: bool = False) -> bool:
        """Drop the connection, of one host or any, that is missed least, if there is such."""
        spared = self.limits.spared_seconds
        found = self._first(self._yielding, host, 0.0) or self._first(self._waiting, host, spared)
        if found is None and ready:
            found = self._first(self._new, host, self.limits.hurried_seconds)
        if found is None:
            return False
        self.serve(found)
        found.drop()
        return True

    def _first(self, among: OrderedDict[Client, float], host: str, spared: float) -> Client | None:
        """The one that waits longest, of one host or any, if it has waited for so long."""
        found = next((c for c in among if not host or c.host == host), None)
        return None if found is None or monotonic() - among[found] < spared else found

    def enter(self, client: Client, loop: asyncio.AbstractEventLoop) -> None:
        """A connection that was admitted stands; it is its turn, and the loop checks it."""
        self._coming -= 1
        self._clients.add(client)
        self._waiting[client] = self._new[client] = monotonic()
        if not self._watched:
            self._watched = True
            loop.call_later(self._interval, self._watch, loop)

    def leave(self, client: Client) -> None:
        """A connection that was admitted is closed."""
        self._clients.discard(client)
        self.serve(client)
        self._total -= 1
        self._from[client.host] -= 1
        if not self._from[client.host]:
            del self._from[client.host]

    def wait(self, client: Client) -> None:
        """It is the client's turn from now on; nothing changes if it was before."""
        self._waiting.setdefault(client, monotonic())

    def yields(self, client: Client) -> None:
        """It does not take what it has asked for, or is done: it goes first, without delay."""
        if client not in self._yielding:
            self.serve(client)
            self._yielding[client] = monotonic()

    def serve(self, client: Client) -> None:
        """It is our turn: the connection is not dropped for another one."""
        for kept in (self._waiting, self._yielding, self._new):
            kept.pop(client, None)

    def close(self) -> None:
        """Nobody is let in any more: those that yield have no reason to stay."""
        for client in list(self._yielding):
            client.drop()

    def _watch(self, loop: asyncio.AbstractEventLoop) -> None:
        """End all connections whose time is over; again and again while there are any."""
        for client in list(self._clients):
            client.check(loop.time())
        self._watched = bool(self._clients)
        if self._watched:
            loop.call_later(self._interval, self._watch, loop)


class Listener(socket.socket):
    """A listening socket whose `accept` asks a gate, and rests when descriptors run out."""

    def __init__(self, bound: socket.socket, gate: Gate) -> None:
        """Takes over a bound socket."""
        family, kind, proto = bound.family, bound.type, bound.proto
        super().__init__(family, kind, proto, fileno=bound.detach())
        self.gate = gate
        self._resume = 0.0

    def listen(self, backlog: int = 0, /) -> None:
        """Listen; asyncio's backlog also says how often it accepts in a row and is not ours."""
        super().listen(BACKLOG)

    def close(self) -> None:
        """Close it and what it holds itself."""
        self.gate.close()
        super().close()

    def accept(self) -> tuple[socket.socket, object]:
        """As `socket.accept`, for a client that the gate admits.

        Raises:
            BlockingIOError: there is none now.
            OSError: the system has no descriptor left; asyncio waits and comes back.
        """
        if monotonic() < self._resume or self.gate.busy:
            raise BlockingIOError
        for _ in range(ACCEPTS):
            try:
                connection, address = super().accept()
            except OSError as error:
                if error.errno in EXHAUSTED:
                    self._resume = monotonic() + PAUSE_SECONDS
                    self.gate.make_room()
                raise
            host, data = network_of(address[0]), first_bytes(connection)
            answer = refused_at_once(data)
            if answer is not None:
                self._refuse(connection, host, answer)
            elif self.gate.admit(host, ready=is_whole(data)):
                return connection, address
            else:
                turn_away(connection, REFUSAL)
        raise BlockingIOError

    def _refuse(self, connection: socket.socket, host: str, answer: bytes) -> None:
        """Give the only answer; nobody has to go for that."""
        if self.gate.has_room(host) and self.gate.admit(host):
            Refused(self.gate, connection, host, answer)
        else:
            turn_away(connection, answer)


class Refused:
    """A connection that has its only answer before it was one for asyncio.

    The client has some seconds to take the answer and to leave. Closing at once would destroy the
    answer where more has come meanwhile (RFC 9112 §9.6), and would invite the next one.
    """

    def __init__(self, gate: Gate, connection: socket.socket, host: str, answer: bytes) -> None:
        """Admitted already; inside the event loop."""
        self.host = host
        self._gate, self._connection = gate, connection
        loop = asyncio.get_running_loop()
        self._until = loop.time() + gate.limits.linger_seconds
        say(connection, answer)
        gate.enter(self, loop)
        gate.yields(self)

    def drop(self) -> None:
        """Close it."""
        self._connection.close()
        self._gate.leave(self)

    def check(self, now: float) -> None:
        """Close it if its time is over."""
        if now > self._until:
            self.drop()


def first_bytes(connection: socket.socket) -> bytes:
    """What has come already; it stays to be read."""
    try:
        connection.setblocking(False)
        return connection.recv(PEEKED, socket.MSG_PEEK)
    except OSError:
        return b""


def say(connection: socket.socket, answer: bytes) -> None:
    """Send it as far as that needs no waiting."""
    with suppress(OSError):
        connection.send(answer)


def turn_away(connection: socket.socket, answer: bytes) -> None:
    """Say why, as far as that needs no waiting, and close."""
    say(connection, answer)
    connection.close()


@lru_cache(4096)
def network_of(host: str) -> str:
    """What counts as one address: of IPv6, the 64 bits that a provider gives to one customer."""
    try:
        address = ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if not isinstance(address, IPv6Address):
        return host
    return str(address.ipv4_mapped or int(address) >> 64)
