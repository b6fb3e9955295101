"""The server in a process: its socket, uvicorn, and connections whose time is limited."""

import asyncio
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from enum import Enum
from functools import partial
from typing import Any

import anyio
import anyio.to_thread
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from gsynopsis.errors import InputError
from gsynopsis.serve.gate import ACCEPTS, BACKLOG, Gate, Limits, Listener, network_of
from gsynopsis.serve.log import tame
from gsynopsis.serve.refusal import invalid, refused_at_once

UNSENT = 1 << 17
"""Bytes that the system holds for a client and has not sent: it could be megabytes each."""


class Stage(Enum):
    """Whose turn it is on a connection."""

    HEAD = "a request has to come, or the rest of it"
    ANSWER = "an answer is under way"
    IDLE = "answered; another request may come"
    REFUSED = "the last answer is given; the client may take it and leave"


class PatientProtocol(H11Protocol):
    """HTTP/1.1 whose patience has an end: with each request, and with each answer."""

    def __init__(self, gate: Gate, **settings: Any) -> None:
        """Settings are uvicorn's."""
        super().__init__(**settings)
        self.gate = gate
        self.host = ""
        self._stage = Stage.HEAD
        self._since = self.loop.time()
        self._paused: float | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client has connected."""
        super().connection_made(transport)
        self.host = network_of(transport.get_extra_info("peername")[0])
        self.gate.enter(self, self.loop)
        sock = transport.get_extra_info("socket")
        with suppress(OSError):  # it may be broken by now
            # asyncio does this for sockets made as TCP by name only; without it the body waits for
            # the receipt of the head, 40 ms later.
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if hasattr(socket, "TCP_NOTSENT_LOWAT"):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)

    def data_received(self, data: bytes) -> None:
        """Some bytes of a request."""
        if self._stage is Stage.IDLE:
            self._stage, self._since = Stage.HEAD, self.loop.time()
        if self._stage is Stage.HEAD and b"\n" in data:
            answer = refused_at_once(self.conn.trailing_data[0] + data)
            if answer is not None:
                self._refuse(answer)
                return
        super().data_received(data)
        self._turn()

    def send_400_response(self, msg: str) -> None:
        """What came is no HTTP."""
        self._refuse(invalid())

    def on_response_complete(self) -> None:
        """The last byte of an answer is written; uvicorn begins the next one if it was asked."""
        super().on_response_complete()
        self._turn()

    def pause_writing(self) -> None:
        """The client does not keep up."""
        super().pause_writing()
        self._paused = self.loop.time()

    def resume_writing(self) -> None:
        """It has taken some."""
        self._paused = None
        if self._stage is Stage.ANSWER:
            self.gate.serve(self)
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """It is gone."""
        self.gate.leave(self)
        # uvicorn leaves it where the connection broke; it would keep all that belongs to it.
        self._unset_keepalive_if_required()
        super().connection_lost(exc)

    def drop(self) -> None:
        """Break the connection: others need the room."""
        self.transport.abort()

    def check(self, now: float) -> None:
        """End the connection if its time is over."""
        limits, waited = self.gate.limits, now - self._since
        if self._stage is Stage.ANSWER and not self.transport.is_closing():
            stalled = 0.0 if self._paused is None else now - self._paused
            if stalled > limits.send_seconds:
                self.transport.abort()
            elif stalled > limits.stalled_seconds:
                self.gate.yields(self)
        elif self._stage is Stage.REFUSED:
            if waited > limits.linger_seconds:
                self.transport.abort()
        elif self.transport.is_closing() or self.transport.get_write_buffer_size():
            # Not close(): that waits for the client to take what is still buffered.
            if waited > limits.send_seconds:
                self.transport.abort()
        elif waited > (limits.head_seconds if self._stage is Stage.HEAD else limits.idle_seconds):
            self.transport.abort()

    def _refuse(self, answer: bytes) -> None:
        """Give the last answer, read nothing more, and leave it to the client to go.

        Closing at once would destroy the answer where more has come meanwhile (RFC 9112 §9.6), and
        would invite the next one: who sends such requests comes back as soon as it is let go.
        """
        self._unset_keepalive_if_required()
        self.transport.write(answer)
        self.transport.pause_reading()
        self._stage, self._since = Stage.REFUSED, self.loop.time()
        self.gate.yields(self)

    def _turn(self) -> None:
        """Note whose turn it is now."""
        answering = self.cycle is not None and not self.cycle.response_complete  # pyright: ignore
        if answering and self._stage is not Stage.ANSWER:
            self._stage, self._since = Stage.ANSWER, self.loop.time()
            self.gate.serve(self)
        elif not answering and self._stage is Stage.ANSWER:
            self._stage, self._since = Stage.IDLE, self.loop.time()
            if not self.transport.is_closing():
                self.gate.wait(self)


def listen(host: str, port: int, limits: Limits | None = None) -> Listener:
    """A bound socket; port 0 takes any free one.

    Raises:
        InputError: the address is not to be had.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"{host}:{port}", "port", found=port, expected="0 to 65535")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        bound = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except UnicodeError as error:  # before anybody is asked: no name has an empty or a long part
        found, expected = f"{host!r:.80}", "the name or number of this machine"
        raise InputError("--host", found=found, expected=expected) from error
    except OSError as error:
        found = error.strerror or error
        advice = "take another --port, or 0 for any free one"
        raise InputError(f"{host}:{port}", found=found, advice=advice) from error
    return Listener(bound, Gate((limits or Limits()).fitted()))


def url_of(host: str, bound: socket.socket) -> str:
    """The address at which a bound socket is reached, without a path."""
    return f"http://{f'[{host}]' if ':' in host else host}:{bound.getsockname()[1]}"


def server_of(app: ASGIApp, listener: Listener) -> uvicorn.Server:
    """A server that is not yet running; what its first answer needs is loaded here.

    Not for use inside a running event loop.
    """
    anyio.run(anyio.to_thread.run_sync, int)
    tame("uvicorn.error", "asyncio")
    settings: dict[str, Any] = {
        "http": partial(PatientProtocol, listener.gate),
        "loop": "asyncio",
        "ws": "none",
        "lifespan": "off",
        "log_config": None,
        "access_log": False,
        "server_header": False,
        "proxy_headers": False,
        "timeout_keep_alive": listener.gate.limits.idle_seconds,
        "timeout_graceful_shutdown": 2,
        "backlog": ACCEPTS,
    }
    return uvicorn.Server(uvicorn.Config(app, **settings))


@contextmanager
def serving(
    app: ASGIApp, host: str = "127.0.0.1", port: int = 0, limits: Limits | None = None
) -> Generator[str]:
    """The app on a socket of this machine while the `with` lasts; gives its address."""
    bound = listen(host, port, limits)
    server = server_of(app, bound)
    thread = threading.Thread(target=server.run, args=([bound],), daemon=True, name="server")
    thread.start()
    try:
        while not server.started and thread.is_alive():
            time.sleep(0.005)
        yield url_of(host, bound)
    finally:
        server.should_exit = True
        thread.join(timeout=10)
        bound.close()
