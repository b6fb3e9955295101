"""`gsynopsis view`: a scene as a web page in one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gsynopsis.cli.defaults import said
from gsynopsis.errors import InputError, printable
from gsynopsis.runs.folder import find_run


@dataclass(frozen=True)
class ViewCommand:
    """Write a web page that shows a .gsyn file, to be opened without a server.

    Attributes:
        path: A .gsyn file, or the folder of a run.
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
        from gsynopsis.serve.files import address_of, shown_name
        from gsynopsis.serve.page import single_page

        path = find_run(self.path).file
        data = read_bytes(path)
        out = self.html or path.with_suffix(".html")
        if out.resolve() == path.resolve():
            raise InputError(out, found="the scene itself", expected="another name for the page")
        if self.beside:
            source = path.resolve()
            folder = out.resolve().parent
            if not source.is_relative_to(folder):
                expected = "the page in a folder that holds the scene"
                raise InputError(out, found="another folder", expected=expected)
            address = address_of(source.relative_to(folder).as_posix())
            page = single_page(shown_name(path.name), None, address)
        else:
            page = single_page(shown_name(path.name), data)
        publish(out, page)
        print(f"wrote {printable(str(out))} ({out.stat().st_size / 2**20:.2f} MiB)")
        return 0
