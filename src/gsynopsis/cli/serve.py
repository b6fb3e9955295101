"""`gsynopsis serve`: a file or a folder over HTTP, with ranges."""

import asyncio
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from gsynopsis.cli.bounds import bounded
from gsynopsis.cli.defaults import said
from gsynopsis.cli.dropped import COMMAND
from gsynopsis.cli.shown_file import refuse_splats, shown_file
from gsynopsis.errors import MissingExtraError, SettingError
from gsynopsis.runs.folder import RUN_FILE

if TYPE_CHECKING:
    from gsynopsis.stream.virtual import Link

CUTS_MAX = 10_000
"""Connections to break, at most: their places are drawn before the first request."""


@dataclass(frozen=True)
class Serve:
    """Serve a .gsyn file, or a folder of them, with Range requests; Ctrl-C ends it.

    Nothing but .gsyn files and the viewer's page is served; of a run's folder, its scene alone.
    It is for this machine and its network; for the internet take nginx (packaging/nginx.conf) or
    any static host. This one can also pretend to be a slow line, and imports other programs' splats
    that are dropped on its page, where this machine alone reaches it.

    Attributes:
        path: A .gsyn file, the folder of a run, a folder of scenes, or splats of another program,
            which are imported first.
        host: Address to listen on; 0.0.0.0 lets other machines in.
        port: Port to listen on; 0 takes a free one.
        viewer: Folder of another viewer to show at the root; ours if not given.
        embed: Origins whose pages may show ours in a frame, as https://example.org; * for all.
        edit: Save annotations that are made in the viewer (`M`) into the scene's file; for this
            machine alone.
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
    viewer: Annotated[Path | None, said("ours")] = None
    embed: tuple[str, ...] = ()
    edit: bool = False
    trace: Annotated[Path | None, said("none, as fast as it goes")] = None
    round_trip: float = 0.05
    cuts: int = 0
    cut_mib: float = 10.0
    seed: int = 0
    quiet: bool = False

    def run(self) -> int:
        """Serve until interrupted."""
        try:
            from gsynopsis.formats.readers.any import is_splats
            from gsynopsis.serve.app import make_app
            from gsynopsis.serve.files import address_of, root_of
            from gsynopsis.serve.page import FOLDER
            from gsynopsis.serve.run import is_local, listen, server_of, url_of
        except ImportError as error:
            raise MissingExtraError("starlette and uvicorn", "serve,stream") from error
        link = None
        if self.trace is not None:
            link = self._link(self.trace)
        elif self.cuts:
            raise SettingError("--cuts", found=self.cuts, advice="needs --trace")
        with ExitStack() as stack:
            path = self.path
            if (path / RUN_FILE).is_file() or is_splats(path):
                path = stack.enter_context(shown_file(path, quiet=self.quiet)).file
            root = root_of(path)
            bound = stack.enter_context(listen(self.host, self.port))
            edit = self.edit and self._may_edit(local=is_local(bound))
            viewer = self.viewer or FOLDER
            imports = COMMAND if is_local(bound) else ()
            app = make_app(
                root, viewer=viewer, link=link, embed=self.embed, edit=edit, imports=imports
            )
            address = url_of(self.host, bound)
            if not self.quiet:
                print(f"{address}/ shows it", flush=True)
                for name in root.names():
                    print(f"{address}/{address_of(name)}", flush=True)
                if not is_local(bound):
                    print("other machines can reach it: plain HTTP, no password", flush=True)
                print(f"listing: {address}/listing.json (Ctrl-C ends)", flush=True)
            asyncio.run(server_of(app).serve(sockets=[bound]))
        return 0

    def _may_edit(self, *, local: bool) -> bool:
        """Refuse `--edit` of what does not stay, and on a network; else true."""
        refuse_splats(self.path, "--edit")
        if not local:
            expected = "this machine alone"
            raise SettingError("--edit", found=f"--host {self.host}", expected=expected)
        return True

    def _link(self, path: Path) -> "Link":
        from gsynopsis.stream.trace import read_trace
        from gsynopsis.stream.virtual import Link, random_cuts

        if not 0 <= self.round_trip < 60:
            raise SettingError("--round-trip", found=self.round_trip, expected="0 to 60 seconds")
        bounded("--cuts", self.cuts, 0, CUTS_MAX)
        if not 0 < self.cut_mib < 1 << 20:
            raise SettingError("--cut-mib", found=self.cut_mib, expected="a number above 0")
        cuts = random_cuts(round(self.cut_mib * (1 << 20)), self.cuts, self.seed)
        return Link(read_trace(path), self.round_trip, cuts)
