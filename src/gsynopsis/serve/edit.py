"""Annotations that a page of our own, on the same machine, saves into a scene's file."""

import anyio
import anyio.to_thread
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import Receive, Scope, Send

from gsynopsis.container.annotate import annotate
from gsynopsis.container.layout import MANIFEST_BYTES_MAX
from gsynopsis.errors import GsynopsisError
from gsynopsis.serve.files import Root

SUFFIX = "/annotations"
"""After a scene's name: where its annotations are put."""
LOCAL = {"localhost", "127.0.0.1", "[::1]"}
"""Names of this machine: another name may have been made to lead here by another site."""


class Edits:
    """Answers PUT of a scene's annotations."""

    def __init__(self, root: Root) -> None:
        """Scenes of a root."""
        self._root = root
        # One after the other: each reads and writes the whole file.
        self._writer = anyio.CapacityLimiter(1)

    async def put(self, name: str, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 204 once they are in the file, else say in a line why not."""
        answer = await self._answer(name, Request(scope, receive))
        await answer(scope, receive, send)

    async def _answer(self, name: str, request: Request) -> Response:
        path = self._root.find(name.removesuffix(SUFFIX))
        if path is None:
            return PlainTextResponse("not found", 404)
        if not is_own(request.headers):
            return PlainTextResponse("only a page of this server may save", 403)
        try:
            body = bytearray()
            async for piece in request.stream():
                body += piece
                if len(body) > MANIFEST_BYTES_MAX:
                    return PlainTextResponse("too many annotations", 413)
            text = body.decode()
            await anyio.to_thread.run_sync(
                annotate, path, text, "annotations", limiter=self._writer
            )
        except UnicodeDecodeError:
            return PlainTextResponse("no text", 400)
        except ClientDisconnect:
            return Response(status_code=400)
        except GsynopsisError as error:
            return PlainTextResponse(str(error), 400)
        return Response(status_code=204)


def is_own(headers: Headers) -> bool:
    """A page of this very server asks, by a name of this machine that nobody else can take."""
    host = headers.get("host", "")
    return host.rpartition(":")[0] in LOCAL and headers.get("origin") == f"http://{host}"
