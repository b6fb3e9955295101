"""Files with one thing wrong and all checksums right, as an attacker would make them."""

import itertools
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gsynopsis.container import layout
from gsynopsis.container.codecs import deflate, inflate
from gsynopsis.container.directory import pack_directory, record_type
from gsynopsis.container.index import Index, pack_index
from gsynopsis.container.layout import ChunkEntry, Header, Kind, LevelEntry


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
    """Index in the table of the first chunk of a kind and level."""
    chunks = index_of(data).chunks
    return next(i for i, c in enumerate(chunks) if c.kind == kind and c.level == level)


@dataclass
class Taken:
    """A file in pieces; `data` puts it together again with positions, sums and checksums right."""

    header: Header
    levels: list[LevelEntry]
    chunks: list[ChunkEntry]
    bodies: list[bytes]
    records: dict[int, np.ndarray] = field(default_factory=dict)
    blocks: dict[int, list[bytes]] = field(default_factory=dict)

    def raw_of(self, level: int, block: int) -> bytes:
        """Bytes of a block, inflated."""
        raw = int(self.records[level]["raw"][block])
        return bytes(inflate(self.blocks[level][block], raw))

    def set_raw(self, level: int, block: int, raw: bytes) -> None:
        """Another block; its size and checksum follow."""
        self.set_stored(level, block, deflate(raw)[0])

    def set_stored(self, level: int, block: int, stored: bytes) -> None:
        """Another block, as it is stored; its checksum follows."""
        self.blocks[level][block] = stored
        self.records[level]["stored"][block] = len(stored)
        self.records[level]["crc"][block] = zlib.crc32(stored)

    def set_body(self, number: int, stored: bytes, **fields: int) -> None:
        """Another chunk, as it is stored, and other fields of its entry."""
        self.bodies[number] = stored
        self.chunks[number] = self.chunks[number]._replace(**fields)

    def data(self) -> bytes:
        """The file."""
        offset = layout.index_bytes(len(self.levels), len(self.chunks))
        bodies, head = list(self.bodies), 0
        for i, chunk in enumerate(self.chunks):
            if chunk.kind == Kind.DIRECTORY:
                raw = pack_directory(self.records[chunk.level])
                bodies[i] = deflate(raw)[0]
                self.chunks[i] = chunk._replace(raw=len(raw), rows=len(self.records[chunk.level]))
            elif chunk.kind == Kind.BLOCKS:
                bodies[i] = b"".join(self.blocks[chunk.level])
                total = int(self.records[chunk.level]["raw"].astype(np.int64).sum())
                self.chunks[i] = chunk._replace(raw=total)
        for i, body in enumerate(bodies):
            kind, level = self.chunks[i].kind, self.chunks[i].level
            crc = 0 if kind == Kind.BLOCKS else zlib.crc32(body)
            self.chunks[i] = self.chunks[i]._replace(offset=offset, stored=len(body), crc=crc)
            if not head and kind not in (Kind.MANIFEST, Kind.DIRECTORY):
                head = offset
            offset += len(body)
            if kind == Kind.BLOCKS:
                self.levels[level] = self.levels[level]._replace(end=offset)
        self.header = self.header._replace(head=head)
        index = Index(self.header, tuple(self.levels), tuple(self.chunks))
        return pack_index(index) + b"".join(bodies)


def taken(data: bytes) -> Taken:
    """A whole file in pieces."""
    index = index_of(data)
    bodies = [data[c.offset : c.offset + c.stored] for c in index.chunks]
    pieces = Taken(index.header, list(index.levels), list(index.chunks), bodies)
    for chunk, body in zip(index.chunks, bodies, strict=True):
        if chunk.kind == Kind.DIRECTORY:
            kind = record_type(chunk.level)
            raw = np.frombuffer(inflate(body, chunk.raw), np.uint8)
            planes = raw.reshape(kind.itemsize, chunk.rows)
            pieces.records[chunk.level] = np.ascontiguousarray(planes.T).view(kind)[:, 0].copy()
    for chunk, body in zip(index.chunks, bodies, strict=True):
        if chunk.kind == Kind.BLOCKS:
            ends = np.cumsum(pieces.records[chunk.level]["stored"].astype(np.int64))
            pieces.blocks[chunk.level] = [
                body[int(e - n) : int(e)]
                for e, n in zip(ends, pieces.records[chunk.level]["stored"], strict=True)
            ]
    return pieces


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


def with_record(data: bytes, level: int, block: int, **fields: int | float) -> bytes:
    """Other fields in a directory's record; checksums and positions of chunks follow."""
    pieces = taken(data)
    for name, value in fields.items():
        pieces.records[level][name][block] = value
    return pieces.data()


def counted_for_sisters(data: bytes, level: int) -> Iterator[bytes]:
    """Files in which a block counts a live slot of the level before in place of its sister."""
    parents = taken(data).records[level]["parent"]
    for more, less in itertools.permutations(range(len(parents)), 2):
        if parents[more] == parents[less]:
            pieces = taken(data)
            for name in ("before", "live"):
                pieces.records[level][name][more] += np.uint32(1)
                pieces.records[level][name][less] -= np.uint32(1)
            yield pieces.data()


def mended(data: bytes) -> bytes:
    """The same bytes with every checksum made right, where the tables allow it."""
    index = index_of(data)
    chunks: list[ChunkEntry] = []
    changed = bytearray(data)
    for chunk in index.chunks:
        body = bytes(changed[chunk.offset : chunk.offset + chunk.stored])
        if chunk.kind == Kind.DIRECTORY:
            body = _mended_directory(index, chunk, bytes(changed), body)
            if len(body) == chunk.stored:
                changed[chunk.offset : chunk.offset + chunk.stored] = body
        crc = 0 if chunk.kind == Kind.BLOCKS else zlib.crc32(body)
        chunks.append(chunk._replace(crc=crc))
    return pack_index(Index(index.header, index.levels, tuple(chunks))) + bytes(
        changed[index.length :]
    )


def _mended_directory(index: Index, chunk: ChunkEntry, data: bytes, body: bytes) -> bytes:
    """A directory stored as it is, checksums of its blocks made right; others stay."""
    kind = record_type(chunk.level)
    if len(body) != chunk.raw or len(body) != kind.itemsize * chunk.rows:
        return body
    records = np.ascontiguousarray(
        np.frombuffer(body, np.uint8).reshape(kind.itemsize, chunk.rows).T
    )
    records = records.copy().view(kind)[:, 0]
    blocks = [c for c in index.chunks if c.kind == Kind.BLOCKS and c.level == chunk.level]
    at = blocks[0].offset if blocks else 0
    for record in records:
        stored = int(record["stored"])
        record["crc"] = zlib.crc32(data[at : at + stored])
        at += stored
    return pack_directory(records)


def flat(data: bytes) -> bytes:
    """The same file with every directory stored as it is, so that `mended` can mend it."""
    pieces = taken(data)
    forged = pieces.data()
    for i, chunk in enumerate(pieces.chunks):
        if chunk.kind == Kind.DIRECTORY:
            raw = pack_directory(pieces.records[chunk.level])
            forged = _with_body(forged, i, raw)
    return forged


def _with_body(data: bytes, number: int, body: bytes) -> bytes:
    index = index_of(data)
    old = index.chunks[number]
    by = len(body) - old.stored
    chunks = [
        c._replace(offset=c.offset + (by if i > number else 0)) for i, c in enumerate(index.chunks)
    ]
    chunks[number] = old._replace(stored=len(body), crc=zlib.crc32(body))
    levels = tuple(v._replace(end=v.end + by * (v.end > old.offset)) for v in index.levels)
    head = index.header.head + by * (index.header.head > old.offset)
    forged = Index(index.header._replace(head=head), levels, tuple(chunks))
    tail = data[index.length : old.offset] + body + data[old.offset + old.stored :]
    return pack_index(forged) + tail
