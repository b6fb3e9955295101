"""A slow and unreliable link in front of the server, for demos and tests.

One token bucket is shared by all connections: each piece of a body waits for the moment at which
the trace has carried it, so that connections share the link equally. `stream/virtual.py` is the
same link on a virtual clock.
"""

import asyncio
import time
from collections import OrderedDict
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gsynopsis.stream.virtual import QUANTUM, Link

CONNECTIONS_KEPT = 4096
"""Connections whose set-up is remembered as paid."""


class LinkCut(Exception):
    """A connection that is broken on purpose."""


class Throttle:
    """ASGI middleware; the trace starts with the first request."""

    def __init__(
        self, app: ASGIApp, link: Link, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Slow all answers of an app down to one link."""
        self._app, self._link, self._clock = app, link, clock
        self._began: float | None = None
        self._free = 0.0
        self._carried = 0
        self._cuts = list(link.cuts)
        self._warm: OrderedDict[object, None] = OrderedDict()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer over the link."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        now = self._clock()
        if self._began is None:
            self._began = now
        # The server makes its answer while the request is on its way: a link does not wait for it.
        due = now + self._link.round_trip * (1 if self._is_warm(scope) else 2)

        async def slowly(message: Message) -> None:
            await asyncio.sleep(max(0.0, due - self._clock()))
            body = message.get("body", b"")
            if message["type"] != "http.response.body" or not body:
                await send(message)
                return
            for at in range(0, len(body), QUANTUM):
                piece = body[at : at + QUANTUM]
                last = at + QUANTUM >= len(body) and not message.get("more_body", False)
                await self._carry(piece, not last, send)

        await self._app(scope, receive, slowly)

    async def _carry(self, piece: bytes, more: bool, send: Send) -> None:
        """Send a piece when the link has carried it; or its first part, if a cut falls in it."""
        cut = bool(self._cuts) and self._carried + len(piece) >= self._cuts[0]
        if cut:
            piece, more = piece[: max(0, self._cuts.pop(0) - self._carried)], True
        self._carried += len(piece)
        now = self._clock() - (self._began or 0.0)
        trace = self._link.trace
        self._free = trace.time_of(trace.bytes_by(max(now, self._free)) + len(piece))
        await asyncio.sleep(max(0.0, self._free - now))
        await send({"type": "http.response.body", "body": piece, "more_body": more})
        if cut:
            raise LinkCut

    def _is_warm(self, scope: Scope) -> bool:
        """The connection has been used before; remembers it."""
        client = tuple(scope.get("client") or ())
        warm = client in self._warm
        self._warm[client] = None
        self._warm.move_to_end(client)
        if len(self._warm) > CONNECTIONS_KEPT:
            self._warm.popitem(last=False)
        return warm
