"""Files with one thing wrong and all checksums right, as an attacker would make them."""

import zlib

import numpy as np

from gsynopsis.pack import layout
from gsynopsis.pack.codecs import encode_array
from gsynopsis.pack.index import Index, pack_index
from gsynopsis.pack.layout import ChunkEntry, CodingId, Header, Kind, LevelEntry


def index_of(data: bytes) -> Index:
    """The tables of a file, unchecked."""
    header = Header._make(layout.HEADER.unpack_from(data))
    first = layout.HEADER.size
    second = first + header.levels * layout.LEVEL.size
    end = second + header.chunks * layout.CHUNK.size
    levels = tuple(map(LevelEntry._make, layout.LEVEL.iter_unpack(data[first:second])))
    chunks = tuple(map(ChunkEntry._make, layout.CHUNK.iter_unpack(data[second:end])))
    return Index(header, levels, chunks)


def number_of(data: bytes, kind: Kind, level: int = 0) -> int:
    """Where the first chunk of a kind and level stands in the table."""
    chunks = index_of(data).chunks
    return next(i for i, c in enumerate(chunks) if c.kind == kind and c.level == level)


def with_header(data: bytes, **fields: object) -> bytes:
    index = index_of(data)
    forged = Index(index.header._replace(**fields), index.levels, index.chunks)
    return pack_index(forged) + data[index.length :]


def with_level(data: bytes, number: int, **fields: object) -> bytes:
    index = index_of(data)
    levels = list(index.levels)
    levels[number] = levels[number]._replace(**fields)
    return pack_index(Index(index.header, tuple(levels), index.chunks)) + data[index.length :]


def with_chunk(data: bytes, number: int, **fields: object) -> bytes:
    index = index_of(data)
    chunks = list(index.chunks)
    chunks[number] = chunks[number]._replace(**fields)
    return pack_index(Index(index.header, index.levels, tuple(chunks))) + data[index.length :]


def with_stored(data: bytes, number: int, stored: bytes, **fields: object) -> bytes:
    """Other bytes in a chunk; lengths, positions and checksums follow."""
    index = index_of(data)
    bodies = [data[c.offset : c.offset + c.stored] for c in index.chunks]
    bodies[number] = stored
    changed = index.chunks[number]._replace(**fields)
    chunks, offset = list(index.chunks), index.length
    chunks[number] = changed
    ends = [0] * len(index.levels)
    for i, body in enumerate(bodies):
        size = len(body)
        chunks[i] = chunks[i]._replace(offset=offset, stored=size, crc=zlib.crc32(body))
        offset += size
        ends[chunks[i].level] = offset
    levels = tuple(e._replace(end=end) for e, end in zip(index.levels, ends, strict=True))
    return pack_index(Index(index.header, levels, tuple(chunks))) + b"".join(bodies)


def with_array(data: bytes, number: int, array: np.ndarray, coding: CodingId) -> bytes:
    """Other values in a chunk, in any coding."""
    encoded = encode_array(coding, array)
    return with_stored(data, number, encoded.stored, raw=encoded.raw, coding=int(coding))


def mended(data: bytes) -> bytes:
    """The same bytes with every checksum made right, where the tables allow it."""
    index = index_of(data)
    chunks = tuple(
        c._replace(crc=zlib.crc32(data[c.offset : c.offset + c.stored])) for c in index.chunks
    )
    return pack_index(Index(index.header, index.levels, chunks)) + data[index.length :]
