"""A server whose answers a test watches, changes or keeps back."""

import asyncio
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER

Span = tuple[int, int]
PATIENCE = 30.0
"""Seconds for which bytes are kept back at most."""

LATE = """
const { set } = Object.getOwnPropertyDescriptor(Worker.prototype, "onmessage");
Object.defineProperty(Worker.prototype, "onmessage", { set(take) {
  let queue = Promise.resolve();
  set.call(this, (event) => {
    const late = event.data.type === "level-ready" ? 300 : 0;
    if (late) queue = queue.then(() => new Promise((go) => setTimeout(go, late)));
    queue = queue.then(() => take.call(this, event));
  });
} });
"""
"""Of a busy machine: that a level is ready is told when its order has long come."""


class Watched:
    """Serves the viewer and a folder's files.

    Attributes:
        app: Gives the answers.
        spans: Bytes of scenes that were sent, in order.
        change: What becomes of them.
        held: Bytes of scenes from here on are kept back until a page asks for `/go`.
    """

    def __init__(
        self,
        path: Path,
        change: Callable[[bytes, Span], bytes] = lambda body, _: body,
        held: int | None = None,
    ) -> None:
        self.app: ASGIApp = make_app(root_of(path), viewer=FOLDER)
        self.spans: list[Span] = []
        self.change, self.held = change, held
        self._go = asyncio.Event()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == "/go":
            self._go.set()
            await Response(status_code=204)(scope, receive, send)
            return
        if not scope["path"].endswith(".gsyn") or scope["method"] != "GET":
            await self.app(scope, receive, send)
            return
        at = int(Headers(scope=scope)["range"].removeprefix("bytes=").split("-")[0])

        async def watched(message: Message) -> None:
            nonlocal at
            body = message.get("body", b"")
            if body and self.held is not None and at + len(body) > self.held:
                early = body[: max(0, self.held - at)]
                if early:
                    await put({**message, "more_body": True}, early)
                await asyncio.wait_for(self._go.wait(), PATIENCE)
                body = body[len(early) :]
            await put(message, body)

        async def put(message: Message, body: bytes) -> None:
            nonlocal at
            if body:
                self.spans.append((at, at + len(body)))
                message = {**message, "body": self.change(body, self.spans[-1])}
                at += len(body)
            await send(message)

        await self.app(scope, receive, watched)


def read_once(spans: list[Span], size: int) -> bool:
    """Whether the spans are the whole file, no byte of it twice."""
    sides = sorted(spans)
    return (
        sides[0][0] == 0 and sides[-1][1] == size and all(a[1] == b[0] for a, b in pairwise(sides))
    )
