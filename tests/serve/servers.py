"""Our development server and Debian's nginx, for tests that hold for both."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from benchmarks.robust.nginx import NGINX, nginx
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving

WITH_NGINX = pytest.mark.skipif(
    NGINX is None, reason="no nginx (apt-get install nginx-light): packaging/nginx.conf NOT tested"
)
SERVERS = ["serve", pytest.param("nginx", marks=WITH_NGINX)]


@contextmanager
def client_of(kind: str, folder: Path, viewer: Path | None = None) -> Generator[httpx.Client]:
    """A client of a server for a folder; ours takes its page from `viewer`, nginx from `folder`."""
    if kind == "nginx":
        with nginx(folder) as server, httpx.Client(base_url=server.address) as client:
            yield client
        return
    app = make_app(root_of(folder), viewer=viewer)
    with serving(app) as address, httpx.Client(base_url=address) as client:
        yield client
