"""`gsynopsis view`: a scene as a web page in one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gsynopsis.cli.defaults import said
from gsynopsis.cli.shown_file import refuse_splats, shown_file
from gsynopsis.errors import InputError, printable


@dataclass(frozen=True)
class ViewCommand:
    """Write a web page that shows a scene, to be opened without a server.

    Attributes:
        path: A .gsyn file, the folder of a run, or splats of another program, which are imported.
        html: The page; beside the file under its name if not given.
        beside: Leave the file where it is and load it from there: a smaller page, but it needs a
            web server, since browsers do not let a page read files of the disk.
    """

    path: Positional[Path]
    html: Annotated[Path | None, said("beside the file")] = None
    beside: bool = False

    def run(self) -> int:
        """Check the file, write the page."""
        from gsynopsis.container.reader import read_bytes
        from gsynopsis.files import publish

        if self.beside:
            refuse_splats(self.path, "--beside")
        with shown_file(self.path) as (file, source):
            data = read_bytes(file)
            out = self.html or source.with_suffix(".html")
            if out.resolve() == source.resolve():
                expected = "another name for the page"
                raise InputError(out, found="the scene itself", expected=expected)
            page = self._page(file, out, data)
        publish(out, page)
        print(f"wrote {printable(str(out))} ({out.stat().st_size / 2**20:.2f} MiB)")
        return 0

    def _page(self, file: Path, out: Path, data: bytes) -> str:
        from gsynopsis.serve.files import address_of, shown_name
        from gsynopsis.serve.page import single_page

        if not self.beside:
            return single_page(shown_name(file.name), data)
        source, folder = file.resolve(), out.resolve().parent
        if not source.is_relative_to(folder):
            expected = "the page in a folder that holds the scene"
            raise InputError(out, found="another folder", expected=expected)
        address = address_of(source.relative_to(folder).as_posix())
        return single_page(shown_name(file.name), None, address)
