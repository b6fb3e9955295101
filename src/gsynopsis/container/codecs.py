"""Bytes, byte planes and DEFLATE: the layer below arrays of values.

A [rows, columns] array becomes byte planes: column by column, and within a column first byte 0 of
every row, then byte 1 and so on. DEFLATE is the last step of every chunk and block.
"""

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Bytes = bytes | bytearray | memoryview

RAW_DEFLATE = -15
"""zlib's name for a DEFLATE stream without header and trailer."""
DEFLATE_LEVEL = 9
STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_FILTERED)
"""Matches of a few bytes cost noise-like columns, grids above all, more than they save."""


class CodecError(ValueError):
    """Bytes that no encoder of this coding writes; readers say where they stood."""


class NotFiniteError(CodecError):
    """A value or a parameter that is not finite."""


def to_planes(array: Array) -> bytes:
    """Byte planes of a [rows, columns] array, column by column, lowest byte first."""
    little = np.ascontiguousarray(array.T, array.dtype.newbyteorder("<"))
    width = array.dtype.itemsize
    if width == 1:
        return little.tobytes()
    planes = little.view(np.uint8).reshape(array.shape[1], len(array), width)
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).tobytes()


def from_planes(raw: Bytes, rows: int, columns: int, dtype: str) -> Array:
    """The inverse of `to_planes`; a view where a value is one byte."""
    width = np.dtype(dtype).itemsize
    planes = np.frombuffer(raw, np.uint8).reshape(columns, width, rows)
    if width == 1:
        return planes[:, 0].T.view(dtype)
    return np.ascontiguousarray(planes.transpose(2, 0, 1)).view(dtype).reshape(rows, columns)


def deflate(
    raw: bytes, sections: Sequence[int] = (), strategies: Sequence[int] = STRATEGIES
) -> tuple[bytes, list[int]]:
    """A DEFLATE stream of the bytes, or the bytes themselves where that is not shorter.

    Args:
        raw: What to deflate.
        sections: Lengths of the pieces whose statistics differ: each gets its own Huffman tables.
        strategies: Those of zlib to try; the shortest stream is taken.

    Returns:
        What to store, and how many bytes of it each section takes, to the nearest byte.
    """
    sections = sections or (len(raw),)
    streams = [_deflated(raw, sections, strategy) for strategy in strategies]
    pieces = min(streams, key=lambda stream: sum(map(len, stream)))
    stored = b"".join(pieces)
    if len(stored) < len(raw):
        return stored, [len(piece) for piece in pieces]
    return raw, list(sections)


def _deflated(raw: bytes, sections: Sequence[int], strategy: int) -> list[bytes]:
    """One stream, in pieces by section."""
    coder = zlib.compressobj(DEFLATE_LEVEL, zlib.DEFLATED, RAW_DEFLATE, 9, strategy)
    pieces: list[bytes] = []
    view, at = memoryview(raw), 0
    for length in sections:
        piece = coder.compress(view[at : at + length])
        at += length
        if length and at < len(raw):
            piece += coder.flush(zlib.Z_BLOCK)
        pieces.append(piece)
    # Sections of nothing take nothing, the last ones too.
    last = max((number for number, length in enumerate(sections) if length), default=0)
    pieces[last] += coder.flush()
    return pieces


def inflate(stored: Bytes, length: int) -> Bytes:
    """The bytes behind `deflate`, exactly `length` of them, never holding more than one beyond.

    Raises:
        CodecError: the stream is damaged, shorter, longer, or followed by other bytes.
    """
    if len(stored) == length:
        return stored
    stream = zlib.decompressobj(RAW_DEFLATE)
    try:
        raw = stream.decompress(stored, length + 1)
    except zlib.error as error:
        raise CodecError(f"no DEFLATE stream ({error})") from error
    if len(raw) != length or not stream.eof:
        count = f"more than {length}" if len(raw) > length else f"{len(raw)}"
        raise CodecError(f"{count} inflated bytes instead of {length}")
    if stream.unused_data:
        raise CodecError(f"{len(stream.unused_data)} bytes after the end of the DEFLATE stream")
    return raw


def section_sizes(stored: bytes, sections: Sequence[int]) -> list[int]:
    """Stored bytes that hold each section of the raw bytes, to a few bytes.

    Raises:
        CodecError: not a DEFLATE stream of that length.
    """
    if len(stored) == sum(sections):
        return list(sections)
    stream, rest, sizes = zlib.decompressobj(RAW_DEFLATE), stored, list[int]()
    try:
        for length in sections:
            done = stream.decompress(rest, length) if length else b""
            if len(done) != length:
                raise CodecError(f"{len(done)} inflated bytes instead of {length}")
            left = stream.unconsumed_tail if length else rest
            sizes.append(len(rest) - len(left))
            rest = left
    except zlib.error as error:
        raise CodecError(f"no DEFLATE stream ({error})") from error
    sizes[-1] += len(rest)
    return sizes
