"""The server in a process: its socket, uvicorn's own limits, its log."""

import logging
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from ipaddress import ip_address

import anyio
import anyio.to_thread
import uvicorn
from starlette.types import ASGIApp

from gsynopsis.errors import InputError
from gsynopsis.serve.throttle import LinkCut

CONNECTIONS = 500
"""Beyond so many requests are told 503: each is an open file, and systems often allow 1,024."""
IDLE_SECONDS = 20
"""A connection may rest so long between two requests."""
LINE_MAX = 500
"""Characters of a line of the log."""


def listen(host: str, port: int) -> socket.socket:
    """A bound socket; port 0 takes any free one.

    Raises:
        InputError: the address is not to be had.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"{host}:{port}", "port", found=port, expected="0 to 65535")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        bound = socket.create_server((host, port), family=family)
    except UnicodeError as error:  # before anybody is asked: no name has an empty or a long part
        found, expected = f"{host!r:.80}", "the name or number of this machine"
        raise InputError("--host", found=found, expected=expected) from error
    except OSError as error:
        found = error.strerror or error
        advice = "take another --port, or 0 for any free one"
        raise InputError(f"{host}:{port}", found=found, advice=advice) from error
    # asyncio sets TCP_NODELAY for sockets that were made as TCP by name only; without it a body
    # waits 40 ms for the receipt of its head.
    return socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP, bound.detach())


def url_of(host: str, bound: socket.socket) -> str:
    """The address at which a bound socket is reached, without a path."""
    return f"http://{f'[{host}]' if ':' in host else host}:{bound.getsockname()[1]}"


def is_local(bound: socket.socket) -> bool:
    """Only this machine can reach it."""
    return ip_address(bound.getsockname()[0].partition("%")[0]).is_loopback


def server_of(app: ASGIApp) -> uvicorn.Server:
    """A server that is not yet running; what its first answer needs is loaded here.

    Not for use inside a running event loop.
    """
    anyio.run(anyio.to_thread.run_sync, int)
    for name in ("uvicorn.error", "asyncio"):
        logging.getLogger(name).addFilter(one_plain_line)  # the same one is added once
    config = uvicorn.Config(
        app,
        http="h11",
        loop="asyncio",
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        limit_concurrency=CONNECTIONS,
        timeout_keep_alive=IDLE_SECONDS,
        timeout_graceful_shutdown=2,
    )
    return uvicorn.Server(config)


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
        yield url_of(host, bound)
    finally:
        server.should_exit = True
        thread.join(timeout=10)
        bound.close()


def one_plain_line(record: logging.LogRecord) -> bool:
    """A filter of the log: each record becomes one escaped line; meant ends of links are none."""
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, LinkCut):
        return False
    text = record.getMessage().strip()
    if error is not None:
        text += f": {type(error).__name__}: {error}"
    record.msg, record.args = plain(text), None
    record.exc_info = record.exc_text = record.stack_info = None
    return True


def plain(text: str) -> str:
    """The text as it can be printed: control and other odd characters as escapes."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode()
        for c in text[:LINE_MAX]
    )
