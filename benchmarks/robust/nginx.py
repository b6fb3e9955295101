"""Debian's nginx with `packaging/nginx.conf`, on this machine's loopback and without its files."""

import os
import re
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.bench import ROOT

CONFIGURATION = ROOT / "packaging" / "nginx.conf"
NGINX = shutil.which("nginx", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
"""Its program; None where it is not installed."""
PATIENCE = 10.0
AROUND = """
{user}
worker_processes auto;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{ worker_connections 768; }}
http {{
  access_log {folder}/access.log;
  client_body_temp_path {folder}/body;
  proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/fastcgi;
  scgi_temp_path {folder}/scgi;
  uwsgi_temp_path {folder}/uwsgi;
  include {folder}/gsynopsis.conf;
}}
"""
"""Debian's `/etc/nginx/nginx.conf` as far as it matters, with files of its own."""


@dataclass(frozen=True)
class Nginx:
    """A running nginx.

    Attributes:
        port: Of 127.0.0.1.
        process: Its master's id.
        log: What it says of errors.
        requests: A line for each request.
    """

    port: int
    process: int
    log: Path
    requests: Path

    @property
    def address(self) -> str:
        """Address of its root, without the last slash."""
        return f"http://127.0.0.1:{self.port}"


def configured(text: str, root: Path, port: int) -> str:
    """The configuration for another folder and port; all else stays.

    Raises:
        ValueError: the lines of folder and port are not there.
    """
    for old, new in (
        (r"listen 80;", f"listen 127.0.0.1:{port};"),
        (r"root [^;]+;", f'root "{root}";'),
    ):
        text, count = re.subn(old, lambda _, new=new: new, text)
        if count != 1:
            raise ValueError(f"{CONFIGURATION}: {count} lines `{old}`, expected one")
    return text


@contextmanager
def nginx(root: Path) -> Generator[Nginx]:
    """Serve a folder while the `with` lasts.

    Raises:
        RuntimeError: it does not start; with what it says.
    """
    assert NGINX is not None, "nginx is not installed"
    with tempfile.TemporaryDirectory(prefix="gsynopsis-nginx-") as name:
        folder = Path(name)
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        # The tests' folders are closed to the user of Debian's service.
        user = "user root;" if os.geteuid() == 0 else ""
        (folder / "nginx.conf").write_text(AROUND.format(folder=folder, user=user))
        text = configured(CONFIGURATION.read_text(), root.resolve(), port)
        (folder / "gsynopsis.conf").write_text(text)
        log = folder / "error.log"
        line = [NGINX, "-p", name, "-e", str(log), "-c", str(folder / "nginx.conf")]
        with subprocess.Popen([*line, "-g", "daemon off;"], stderr=subprocess.DEVNULL) as child:
            try:
                _wait(port, child, log)
                yield Nginx(port, child.pid, log, folder / "access.log")
            finally:
                child.terminate()


def _wait(port: int, child: "subprocess.Popen[bytes]", log: Path) -> None:
    """Until it answers."""
    ended = time.monotonic() + PATIENCE
    while child.poll() is None and time.monotonic() < ended:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        time.sleep(0.02)
    raise RuntimeError(f"nginx does not start: {log.read_text() if log.exists() else ''}")
