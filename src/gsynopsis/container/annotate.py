"""Annotations of a `.gsyn` file: read, and put in place of those there."""

from pathlib import Path

from gsynopsis.container.assembler import Assembler
from gsynopsis.container.edit import annotated
from gsynopsis.container.notes.annotations import annotations_text
from gsynopsis.container.reader import read_bytes
from gsynopsis.container.writer import publish
from gsynopsis.errors import InputError
from gsynopsis.records import ANNOTATIONS_NOTE


def annotate(file: Path, content: str, source: Path | str, out: Path | None = None) -> None:
    """Put annotations in place of those that a file has; all else of it stays as it is.

    Args:
        file: A .gsyn file.
        content: The annotations as JSON, see docs/format.md; an empty list takes those there away.
        source: What messages call `content`.
        out: The file to write; None: the same.

    Raises:
        FormatError: the file is damaged.
        InputError: the annotations are not of their form, or the file can not be read.
        SpaceError: the disk has no room.
        ValueRangeError: the manifest would be too long.
    """
    text = annotations_text(content, source)
    publish(annotated(read_bytes(file), {ANNOTATIONS_NOTE: text}, None, str(file)), out or file)


def annotations_of(file: Path) -> str:
    """The annotations of a file as JSON, an empty list if it has none or cannot be read."""
    try:
        data = read_bytes(file)
        assembler = Assembler(data, str(file))
        manifest = assembler.index.chunks[0]
        assembler.add(manifest, data[manifest.offset : manifest.offset + manifest.stored])
        text = assembler.meta.get(ANNOTATIONS_NOTE) or "[]"
        return annotations_text(text, file) or "[]"
    except (InputError, OSError):
        return "[]"


def read_annotations(path: Path) -> str:
    """The text of a file of annotations.

    Raises:
        InputError: it can not be read as text.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        found = getattr(error, "strerror", "") or "no text"
        expected = "annotations as JSON, such as the viewer saves"
        raise InputError(path, found=found, expected=expected) from error
