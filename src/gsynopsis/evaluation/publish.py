"""Files appear whole or not at all: write under a temporary name, then rename."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from gsynopsis.errors import InputError


@contextmanager
def published(path: Path) -> Generator[Path]:
    """A name to write to; when the block ends well the file takes the name `path`.

    A failure, also Ctrl-C, leaves the older file as it was and nothing beside it.

    Args:
        path: Where the file goes; its folder is made if it is missing.

    Yields:
        A name in the same folder with the same suffix, that no other process uses.

    Raises:
        InputError: it is the name of a folder.
    """
    if path.is_dir():
        raise InputError(path, found="a folder", expected="the name of a file")
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield draft
        with draft.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def publish(path: Path, content: bytes | str) -> Path:
    """Write a file so that a reader, or a crash, never sees half of it; text as UTF-8."""
    with published(path) as draft:
        draft.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
