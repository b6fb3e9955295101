"""Other programs' splats that a page of our own sends: a process makes a scene of them."""

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import anyio
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from gsynopsis.errors import InputError
from gsynopsis.files import write_error
from gsynopsis.serve.edit import is_own

PLACE = "import/"
"""Before the name of a file: where it is sent."""
BYTES_MAX = 2 << 30
"""Bytes of a file, at most: it and what becomes of it are in the folder of temporary files."""
ODD = re.compile(r"[^\w .-]")
NAMED = 60
"""Characters of its name that are kept, the last ones: a system takes 255 bytes."""


def importer(command: Sequence[str]) -> ASGIApp:
    """An app that answers POST of a file with the scene that a command makes of it, one at a time.

    Args:
        command: Words before the names of the file and of the new one; its last line of errors is
            told to the page. It has to end when its input does, which is as long as the server.
    """
    turn = anyio.Lock()

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope, receive)
        if not is_own(request.headers):
            more = {"connection": "close"}
            refusal = PlainTextResponse("only a page of this server may import", 403, more)
            await refusal(scope, receive, send)
            return
        with TemporaryDirectory(prefix="gsynopsis-") as folder:
            async with turn:
                found = await _made(command, request, Path(folder))
            await found(scope, receive, send)

    return answer


async def _made(command: Sequence[str], request: Request, folder: Path) -> Response:
    """The scene, or a line that says why there is none."""
    name = (
        ODD.sub("_", request.scope["path"].removeprefix(f"/{PLACE}"))[-NAMED:].lstrip(". ")
        or "file"
    )
    given, made = folder / name, folder / ".gsyn"
    try:
        await _receive(request, given)
        done = await _run([*command, str(given), str(made)], request)
    except ClientDisconnect:
        return Response(status_code=400)
    except InputError as error:
        return PlainTextResponse(str(error), 413, {"connection": "close"})
    except OSError as error:
        return PlainTextResponse(str(write_error(Path(name), error)), 507, {"connection": "close"})
    if done.returncode == 0:
        return FileResponse(made, headers={"cache-control": "no-store"})
    last = ["", *done.stderr.decode("utf-8", "replace").splitlines()][-1]
    line = last.removeprefix("gsynopsis: ").replace(f"{folder}/", "")
    return PlainTextResponse(line or f"{name}: the import ended without a word", 400)


async def _receive(request: Request, path: Path) -> None:
    """Write the body to a file.

    Raises:
        InputError: it is too long.
        ClientDisconnect: nobody sends any more.
        OSError: it cannot be written.
    """
    announced, came = int(request.headers.get("content-length", "0")), 0
    async with await anyio.open_file(path, "xb") as file:
        async for piece in request.stream():
            came += len(piece)
            if max(announced, came) > BYTES_MAX:
                found = f"more than {BYTES_MAX / 2**30:g} GiB"
                advice = f"`gsynopsis import {path.name}` takes more"
                raise InputError(path.name, found=found, advice=advice)
            await file.write(piece)


async def _run(command: Sequence[str], request: Request) -> "subprocess.CompletedProcess[bytes]":
    """Run a command to its end; it is killed if that of the server comes first.

    Raises:
        ClientDisconnect: nobody waits for it any more; it is killed.
    """
    async with anyio.create_task_group() as both:

        async def watch() -> None:
            while (await request.receive())["type"] != "http.disconnect":
                pass
            both.cancel_scope.cancel()

        both.start_soon(watch)
        pipe, null = subprocess.PIPE, subprocess.DEVNULL
        done = await anyio.run_process(command, stdin=pipe, stdout=null, check=False)
        both.cancel_scope.cancel()
        return done
    raise ClientDisconnect
