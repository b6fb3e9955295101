"""Damaged and forged files, from a seed: for tests and for fuzz.py."""

import json
import re
import struct
from collections.abc import Callable, Iterator
from itertools import cycle
from typing import NamedTuple

import numpy as np

from benchmarks.bench import ROOT
from benchmarks.robust.forge import flat, index_of, mended, taken
from gsynopsis.container import decode
from gsynopsis.container.codecs import deflate

VECTORS = ROOT / "tests" / "container" / "vectors"
FILES = (
    "small-compact",
    "both-raw",
    "free-compact",
    "common-compact",
    "splats-compact",
    "splats-raw",
)
NOTES = {
    "focals": "[[100,120],[100,120],[100,120],[100,120]]",
    "orbit": '{"target":[0,0,0],"up":[0,0,1],"ahead":[1,0,0],"radius":[2],'
    '"height":[1],"arc":[-1,1]}',
    "seen": '{"center":[0,0,0],"radius":3,"distance":[0.1,2]}',
    "scene": "a café",
}
"""Notes of a manifest that renderers read, so that mutations reach them."""
EXTREMES = (0, 1, 127, 128, 255)
TEXTS = (
    b"\\ud800",
    b"\xff",
    b"\x1b[2J",
    b"1e999",
    b"1" * 400,
    b"NaN",
    b'"',
    b"{",
    b"[",
    b"\xef\xbb\xbf",
)
NUMBER = re.compile(rb"-?\d+(\.\d+)?")
NUMBERS = (b"0", b"-1", b"1e-320", b"1e38", b"-1e308", b"1e999", b"-" + b"9" * 400, b"null", b"[]")


def seeds() -> list[bytes]:
    """Files of every part and coding, their directories stored as they are, with notes."""
    return [_noted(flat((VECTORS / f"{name}.gsyn").read_bytes())) for name in FILES]


class Mutant(NamedTuple):
    """A file that was changed.

    Attributes:
        data: Its bytes.
        silent: Only a reader that ignores checksums could accept it.
    """

    data: bytes
    silent: bool


def mutants(seed: int, share: int = 0) -> Iterator[Mutant]:
    """Endless mutants: damage, with wrong checksums, and forgeries, with right ones.

    Args:
        seed: Of a run.
        share: Of the run; each has mutants of its own.
    """
    rng, files = np.random.default_rng([seed, share]), seeds()
    kinds: tuple[Callable[[np.random.Generator, bytes], bytes], ...]
    kinds = (damaged, forged, forged, extreme, renoted, renumbered, with_tail, cut)
    for file in cycle(files):
        kind = kinds[int(rng.integers(len(kinds)))]
        data = kind(rng, file)
        yield Mutant(data, kind is damaged and data != file)


def damaged(rng: np.random.Generator, data: bytes) -> bytes:
    """Bits, runs, cuts, repeats and swaps."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at, kind = int(rng.integers(len(changed))), int(rng.integers(6))
        run = int(rng.integers(1, 17))
        if kind == 0:
            changed[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            changed[at : at + run] = rng.bytes(len(changed[at : at + run]))
        elif kind == 2:
            byte = bytes([(0, 255)[int(rng.integers(2))]])
            changed[at : at + run] = byte * len(changed[at : at + run])
        elif kind == 3 and len(changed) > 200:
            del changed[at : at + run]
        elif kind == 4:
            changed[at:at] = changed[at : at + run]
        else:
            other = int(rng.integers(len(changed)))
            changed[at], changed[other] = changed[other], changed[at]
    return bytes(changed)


def forged(rng: np.random.Generator, data: bytes) -> bytes:
    """Tables or body changed without moving anything, and every checksum made right."""
    length = index_of(data).length
    start, stop = (20, length) if rng.integers(2) else (length, len(data))
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        changed[int(rng.integers(start, stop))] = int(rng.integers(256))
    return _mended(bytes(changed))


def extreme(rng: np.random.Generator, data: bytes) -> bytes:
    """A byte of the tables, or of the values, at an end of its range; checksums made right."""
    length = index_of(data).length
    changed = bytearray(data)
    at = int(rng.integers(8, length if rng.integers(2) else len(data)))
    changed[at] = int(rng.choice([*EXTREMES, (changed[at] + 1) % 256, (changed[at] - 1) % 256]))
    return _mended(bytes(changed))


def renoted(rng: np.random.Generator, data: bytes) -> bytes:
    """Another manifest, as long as its text is: what no writer writes, put anywhere into it."""
    pieces = taken(data)
    old = index_of(data).chunks[0]
    text = bytearray(data[old.offset : old.offset + old.raw])
    at = int(rng.integers(len(text) + 1))
    more = TEXTS[int(rng.integers(len(TEXTS)))]
    over = int(rng.integers(2)) * len(more)
    text[at : at + over] = more
    pieces.set_body(0, bytes(text), raw=len(text), rows=len(text))
    return pieces.data()


def renumbered(rng: np.random.Generator, data: bytes) -> bytes:
    """Another number somewhere in the manifest, its notes included."""
    pieces = taken(data)
    old = index_of(data).chunks[0]
    text = data[old.offset : old.offset + old.raw]
    place = list(NUMBER.finditer(text))[int(rng.integers(len(NUMBER.findall(text))))]
    raw = text[: place.start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + text[place.end() :]
    pieces.set_body(0, raw, raw=len(raw), rows=len(raw))
    return pieces.data()


def with_tail(rng: np.random.Generator, data: bytes) -> bytes:
    """Bytes after the end of a DEFLATE stream, or one that is a byte too short."""
    pieces = taken(data)
    level = int(rng.integers(len(pieces.blocks)))
    block = int(rng.integers(len(pieces.blocks[level])))
    stored = deflate(pieces.raw_of(level, block))[0]
    tail = rng.bytes(int(rng.integers(1, 4)))
    changed = stored + tail if rng.integers(3) else stored[:-1]
    if len(changed) <= int(pieces.records[level]["raw"][block]):
        pieces.set_stored(level, block, changed)
    return pieces.data()


def cut(rng: np.random.Generator, data: bytes) -> bytes:
    """A beginning: that of a level, which is a file, or any other."""
    ends = [level.end for level in index_of(data).levels]
    return data[: int(rng.choice(ends)) if rng.integers(2) else int(rng.integers(len(data)))]


def _mended(data: bytes) -> bytes:
    """With checksums made right; as it is where tables reach out of the file too far for that."""
    try:
        return mended(data)
    except (ValueError, MemoryError, OverflowError, struct.error):
        return data


def _noted(data: bytes) -> bytes:
    pieces = taken(data)
    levels = decode(data, "seed")
    quality = [{"psnr_full": 20.0 + k} for k in range(len(levels.levels))]
    raw = json.dumps({"meta": NOTES, "quality": quality}, ensure_ascii=False).encode()
    pieces.set_body(0, raw, raw=len(raw), rows=len(raw))
    return flat(pieces.data())
