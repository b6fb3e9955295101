"""Files by path, by run or by address: opened, checked, cut."""

from pathlib import Path

from gsynopsis.container import check_file, cut_file, describe
from gsynopsis.container.info import LevelInfo
from gsynopsis.runs.folder import Run, find_run
from gsynopsis.runs.gsyn_file import File, open_source
from gsynopsis.stream.download import is_address


def open_file(source: Path | str | Run) -> File:
    """Open a .gsyn file, the folder of a run, or an http address.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file.
        MissingExtraError: httpx is not installed, and it is an address.
        SourceError: the server does not give it.

    Examples:
        >>> with gs.open("runs/room/scene.gsyn") as file:
        ...     file.meta["scene"], file.bytes_read < file.levels[-1].bytes
        ('scene', True)
    """
    if isinstance(source, Run):
        return source.open()
    return open_source(source if is_address(source) else find_run(Path(source)).file)


def check(path: Path | str) -> tuple[LevelInfo, ...]:
    """Decode every byte of a file and check everything that docs/format.md promises.

    Returns:
        What each level holds.

    Raises:
        FormatError: it breaks a promise; the class says which.
        InputError: it cannot be read.

    Examples:
        >>> levels = gs.check("runs/room/scene.gsyn")
        >>> [level.level for level in levels]
        [0, 1, 2, 3]
    """
    file = find_run(Path(path)).file
    check_file(file)
    return describe(file).levels


def cut(path: Path | str, level: int, out: Path | str) -> Path:
    """Write the prefix of a file that ends with a level: a file of fewer levels.

    Raises:
        FormatError: the file is damaged.
        InputError: the level is not in there, or a path cannot be used.
        SpaceError: the disk has no room.

    Examples:
        >>> short = gs.cut("runs/room/scene.gsyn", 1, "short.gsyn")
        >>> len(gs.check(short))
        2
    """
    cut_file(find_run(Path(path)).file, level, Path(out))
    return Path(out)
