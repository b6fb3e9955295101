"""Files appear whole or not at all: write under a temporary name, then rename."""

import os
from pathlib import Path


def publish(path: Path, content: bytes | str) -> Path:
    """Write a file so that a reader, or a crash, never sees half of it.

    Args:
        path: Where it goes; the folder is made if it is missing, an older file is replaced.
        content: Text is written as UTF-8.

    Returns:
        The path.
    """
    data = content.encode() if isinstance(content, str) else content
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = draft_of(path)
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)
    return path


def draft_of(path: Path) -> Path:
    """A name beside `path`, with the same suffix, that no other process uses."""
    return path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
