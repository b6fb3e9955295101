"""The server in a process: its socket, uvicorn, and connections that never ask."""

import asyncio
import logging
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import anyio
import uvicorn
from starlette.responses import FileResponse
from starlette.types import ASGIApp, Message, Scope
from uvicorn.protocols.http.h11_impl import H11Protocol

from gsynopsis.errors import InputError
from gsynopsis.serve.shaper import LinkCut

HEAD_SECONDS = 15.0
"""A connection on which no whole request has come by then is closed."""
SEND_SECONDS = 30.0
"""A client that takes no byte for so long is let go."""
BACKLOG = 2048


class PatientProtocol(H11Protocol):
    """HTTP/1.1 whose patience has an end: with who never asks, and with who never reads."""

    _alarm: asyncio.TimerHandle | None = None
    _first: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client has connected."""
        super().connection_made(transport)
        # asyncio does this for sockets made as TCP by name only; without it the body waits for the
        # receipt of the head, 40 ms later.
        sock = transport.get_extra_info("socket")
        if sock is not None:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._first = self.loop.call_later(HEAD_SECONDS, self._expect_request)

    def pause_writing(self) -> None:
        """The client does not keep up."""
        super().pause_writing()
        # Not close(): that would wait for the client to take what is still buffered.
        self._alarm = self.loop.call_later(SEND_SECONDS, self.transport.abort)

    def resume_writing(self) -> None:
        """It has taken some."""
        self._calm()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """It is gone."""
        self._calm()
        # The timer would keep all that belongs to the connection.
        if self._first is not None:
            self._first.cancel()
            self._first = None
        super().connection_lost(exc)

    def _calm(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None

    def _expect_request(self) -> None:
        if self.cycle is None and not self.transport.is_closing():  # pyright: ignore
            self.transport.close()


class _Quiet(logging.Filter):
    """Leaves out the connections that the shaper breaks on purpose."""

    def filter(self, record: logging.LogRecord) -> bool:
        return not (record.exc_info and isinstance(record.exc_info[1], LinkCut))


def listen(host: str, port: int) -> socket.socket:
    """A bound socket; port 0 takes any free one.

    Raises:
        InputError: the address is not to be had.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"{host}:{port}", "port", found=port, expected="0 to 65535")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        bound = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        found = error.strerror or error
        advice = "take another --port, or 0 for any free one"
        raise InputError(f"{host}:{port}", found=found, advice=advice) from error
    return bound


def server_of(app: ASGIApp) -> uvicorn.Server:
    """A server that is not yet running; what its first answer needs is loaded here.

    Not for use inside a running event loop.
    """
    anyio.run(_answer_once)
    log = logging.getLogger("uvicorn.error")
    if not any(isinstance(known, _Quiet) for known in log.filters):
        log.addFilter(_Quiet())
    settings: dict[str, Any] = {
        "http": PatientProtocol,
        "ws": "none",
        "lifespan": "off",
        "log_config": None,
        "access_log": False,
        "server_header": False,
        "timeout_keep_alive": 20,
        "timeout_graceful_shutdown": 2,
        "backlog": BACKLOG,
    }
    return uvicorn.Server(uvicorn.Config(app, **settings))


async def _answer_once() -> None:
    """Send a file to nobody: the first real answer would take some milliseconds longer."""

    async def receive() -> Message:
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        pass

    scope: Scope = {"type": "http", "method": "GET", "headers": []}
    await FileResponse(__file__)(scope, receive, send)


@contextmanager
def serving(app: ASGIApp, host: str = "127.0.0.1", port: int = 0) -> Generator[str]:
    """The app on a socket of this machine while the `with` lasts; gives its address."""
    bound = listen(host, port)
    server = server_of(app)
    thread = threading.Thread(target=server.run, args=([bound],), daemon=True, name="server")
    thread.start()
    try:
        while not server.started and thread.is_alive():
            time.sleep(0.005)
        yield f"http://{host}:{bound.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(timeout=10)
        bound.close()
