"""Imports of dropped files in the process of the tests, which has loaded what they need."""

import io
import sys
from collections.abc import Generator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingTCPServer
from threading import Thread

from gsynopsis.cli import run_safely
from gsynopsis.cli.dropped import Dropped

ASK = """
import socket, sys
port, *names = sys.argv[1:]
with socket.create_connection(("127.0.0.1", int(port))) as asked:
    asked.sendall("\\0".join(names).encode())
    asked.shutdown(socket.SHUT_WR)
    with asked.makefile() as answer:
        code = int(answer.readline())
        sys.stderr.write(answer.read())
sys.exit(code)
"""


class _Importing(StreamRequestHandler):
    def handle(self) -> None:
        source, out = map(Path, self.rfile.read().decode().split("\0"))
        said = io.StringIO()
        with redirect_stderr(said):
            code = run_safely(lambda: Dropped(source, out))
        self.wfile.write(f"{code}\n{said.getvalue()}".encode())


@contextmanager
def importing() -> Generator[tuple[str, ...]]:
    """The words of a command that does what `gsynopsis.cli.dropped` does, in this process."""
    with ThreadingTCPServer(("127.0.0.1", 0), _Importing) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield sys.executable, "-S", "-E", "-c", ASK, str(server.server_address[1])
        finally:
            server.shutdown()
