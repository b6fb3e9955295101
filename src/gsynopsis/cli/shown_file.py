"""The file that a command shows: a `.gsyn` one, or what is imported from another program's."""

import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from gsynopsis.cli.bounds import with_training
from gsynopsis.errors import InputError, printable
from gsynopsis.runs.folder import find_run


class Shown(NamedTuple):
    """A scene to show.

    Attributes:
        file: The `.gsyn` file.
        source: Beside what belongs that is made of it: the file, or what was imported.
    """

    file: Path
    source: Path


@contextmanager
def shown_file(path: Path, *, quiet: bool = False) -> Generator[Shown]:
    """A `.gsyn` file; that of a run's folder, or an import that lasts as long as the context.

    Args:
        path: A `.gsyn` file, a run's folder, or splats as `gsynopsis import` reads them.
        quiet: No progress of an import, and no lines on it.

    Raises:
        InputError: it is nothing of that kind.
    """
    from gsynopsis.formats.readers.any import is_splats

    if not is_splats(path):
        file = find_run(path).file
        yield Shown(file, file)
        return
    with with_training():
        from gsynopsis.jobs.import_splats import import_splats
        from gsynopsis.monitor.display import passing
    name = path.resolve().stem.lstrip(".") or "scene"
    with tempfile.TemporaryDirectory(prefix="gsynopsis-") as folder:
        with passing(quiet=quiet) as tick:
            made = import_splats(path, Path(folder) / f"{name}.gsyn", draft=True, tick=tick)
        if not quiet:
            count = f"{made.splats[-1]:,} splats in {len(made.splats)} levels"
            print(
                f"imported {printable(str(path))}: {count}; `gsynopsis import` keeps a file whose "
                "coarse levels are chosen with more care"
            )
            for note in made.notes:
                print(f"  {printable(note)}")
        yield Shown(made.path, path.resolve())


def refuse_splats(path: Path, option: str) -> None:
    """Refuse an option that needs a file which stays.

    Raises:
        InputError: the path is another program's splats.
    """
    from gsynopsis.formats.readers.any import is_splats

    if is_splats(path):
        found, expected = "another program's splats", f"a .gsyn file for {option}"
        raise InputError(
            path, found=found, expected=expected, advice=f"make one: gsynopsis import {path}"
        )
