"""`gsynopsis serve`: a file or a folder over HTTP, with ranges."""

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from gsynopsis.errors import InputError, MissingExtraError, SettingError

if TYPE_CHECKING:
    from gsynopsis.stream.virtual import Link


@dataclass(frozen=True)
class Serve:
    """Serve a .gsyn file, or a folder of them, with Range requests; Ctrl-C ends it.

    Any static host does the same; this one can also pretend to be a slow line.

    Attributes:
        path: A .gsyn file or a folder.
        host: Address to listen on; 0.0.0.0 lets other machines in.
        port: Port to listen on; 0 takes a free one.
        viewer: Folder of another viewer to show at the root; ours if not given.
        trace: Be as slow as this recorded line (CSV `time_s,mbit_per_s`) from the first request.
        round_trip: Seconds from a request to its answer; with --trace only.
        cuts: Break so many connections at random within the first `--cut-mib`; with --trace only.
        cut_mib: Traffic within which connections break, MiB.
        seed: Of the broken connections.
        quiet: Say nothing.
    """

    path: Positional[Path]
    host: str = "127.0.0.1"
    port: int = 8000
    viewer: Path | None = None
    trace: Path | None = None
    round_trip: float = 0.05
    cuts: int = 0
    cut_mib: float = 10.0
    seed: int = 0
    quiet: bool = False

    def run(self) -> int:
        """Serve until interrupted."""
        try:
            from gsynopsis.serve.app import make_app
            from gsynopsis.serve.files import root_of
            from gsynopsis.serve.page import FOLDER
            from gsynopsis.serve.run import listen, server_of
        except ImportError as error:
            raise MissingExtraError("starlette and uvicorn", "serve,stream") from error
        viewer = self.viewer or FOLDER
        if not (viewer / "index.html").is_file():
            raise InputError(viewer, found="no index.html", expected="a built viewer")
        link = None
        if self.trace is not None:
            link = self._link(self.trace)
        elif self.cuts:
            raise SettingError("--cuts", found=self.cuts, advice="needs --trace")
        root = root_of(self.path)
        app = make_app(root, viewer=viewer, link=link)
        with listen(self.host, self.port) as bound:
            address = f"http://{self.host}:{bound.getsockname()[1]}"
            if not self.quiet:
                print(f"{address}/ shows it", flush=True)
                for name in root.names():
                    print(f"{address}/{name}", flush=True)
                print(f"listing: {address}/listing.json (Ctrl-C ends)", flush=True)
            asyncio.run(server_of(app).serve(sockets=[bound]))
        return 0

    def _link(self, path: Path) -> "Link":
        from gsynopsis.stream.trace import read_trace
        from gsynopsis.stream.virtual import Link, random_cuts

        if not 0 <= self.round_trip < 60:
            raise SettingError("--round-trip", found=self.round_trip, expected="0 to 60 seconds")
        if self.cuts < 0 or not 0 < self.cut_mib < 1 << 20:
            raise SettingError("--cuts", found=self.cuts, expected="a count, and --cut-mib above 0")
        cuts = random_cuts(round(self.cut_mib * (1 << 20)), self.cuts, self.seed)
        return Link(read_trace(path), self.round_trip, cuts)
