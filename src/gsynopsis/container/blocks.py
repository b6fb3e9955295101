"""The bytes of one spatial block: its new anchors, and the slots that become live in it.

After inflating, the columns stand one after the other: lattice, log-scales, codes, residual, mask,
offsets. Their lengths follow from the directory's counts and the level's codings. Splats have
neither mask nor offsets.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.codecs import Array, Bytes, CodecError, from_planes, to_planes
from gsynopsis.container.coding import CodingPlan
from gsynopsis.container.index import Index
from gsynopsis.container.layout import MORTON_BITS_MAX, SPLAT_SCALES, CodingId, Column
from gsynopsis.container.values import (
    PARAMETER_BYTES,
    STEPPED,
    TYPES,
    decode_values,
    encode_values,
    values_bytes,
)
from gsynopsis.records import MORTON_BITS, Float32, morton_axes, morton_codes

MORTON_HEAD = 20
"""Origin as 3 × i32 and first code as u64, before the steps."""
PLAIN_WIDTH = 12
"""Bytes per anchor where lattice coordinates stand as they are (width 0)."""


class BlockShape(NamedTuple):
    """Sizes and codings that determine the columns of a block."""

    fresh: int
    """New anchors."""
    hidden: int
    """Slots that were off before, those of new anchors included: bits of the mask."""
    added: int
    """Slots that become live."""
    width: int
    """Bytes of a step between Morton codes, or 0."""
    residual: int
    codes: int
    """Codes of each new anchor: 0 without a codebook."""
    splats: bool
    codings: tuple[CodingId, CodingId, CodingId]
    """Codings of log-scales, residual and offsets."""

    @property
    def scales(self) -> int:
        """Log-scales of each new anchor."""
        return scales_of(self.splats)


@dataclass(frozen=True)
class Block:
    """The decoded values of one block: rows are its new anchors or its new live slots."""

    lattice: NDArray[np.int32]  # [fresh, 3]
    log_scales: Float32  # [fresh, 6], of splats [fresh, 3]
    codes: NDArray[np.uint8]  # [fresh], or [0] without a codebook; of splats [fresh, S]
    residual: Float32  # [fresh, R]
    mask: NDArray[np.bool_]  # [hidden], of splats [fresh] and all set
    offsets: Float32  # [added, 3], of splats [0, 3]


def scales_of(splats: bool) -> int:
    """Log-scales of a row."""
    return SPLAT_SCALES if splats else 2 * SPLAT_SCALES


def shape_of(index: Index, level: int, record: np.void) -> BlockShape:
    """The shape of a block from its record in the directory."""
    entry = index.levels[level]
    rows, fresh = int(record["rows"].sum(dtype=np.int64)), int(record["rows"][-1])
    before, live = int(record["before"]), int(record["live"])
    return BlockShape(
        fresh=fresh,
        hidden=0 if index.splats else rows * index.header.slots - before,
        added=0 if index.splats else live - before,
        width=int(record["width"]),
        residual=index.header.residual,
        codes=index.codes_of(level),
        splats=index.splats,
        codings=(CodingId(entry.log_scales), CodingId(entry.residual), CodingId(entry.offsets)),
    )


def column_bytes(shape: BlockShape) -> dict[Column, int]:
    """Raw bytes of each column of a block, in order."""
    fresh = shape.fresh
    lattice = (MORTON_HEAD + fresh * shape.width) if shape.width else fresh * PLAIN_WIDTH
    return {
        Column.LATTICE: lattice if fresh else 0,
        Column.LOG_SCALES: values_bytes(shape.codings[0], fresh, shape.scales),
        Column.CODES: fresh * shape.codes,
        Column.RESIDUAL: values_bytes(shape.codings[1], fresh, shape.residual),
        Column.MASK: (shape.hidden + 7) // 8,
        Column.OFFSETS: values_bytes(shape.codings[2], shape.added, 3),
    }


def column_sections(shape: BlockShape) -> dict[Column, list[int]]:
    """Lengths of the pieces of each column whose bytes are unlike: DEFLATE codes them apart.

    First and other byte planes of Morton steps; scales of offsets and those of Gaussians; of
    splats, every byte plane.
    """
    columns = column_bytes(shape)
    sections = {column: [length] for column, length in columns.items()}
    if shape.fresh and shape.splats:
        sections[Column.LOG_SCALES] = _planes(columns[Column.LOG_SCALES], shape.fresh)
        sections[Column.CODES] = _planes(columns[Column.CODES], shape.fresh)
        sections[Column.RESIDUAL] = _planes(columns[Column.RESIDUAL], shape.fresh)
        sections[Column.LATTICE] = _planes(columns[Column.LATTICE], shape.fresh)
    elif shape.fresh:
        head = PARAMETER_BYTES * 6 if shape.codings[0] in STEPPED else 0
        half = (columns[Column.LOG_SCALES] - head) // 2
        sections[Column.LOG_SCALES] = [head + half, half]
        if shape.width > 1:
            first = MORTON_HEAD + shape.fresh
            sections[Column.LATTICE] = [first, columns[Column.LATTICE] - first]
    return sections


def _planes(length: int, rows: int) -> list[int]:
    """The planes of a column, the first with what stands before it."""
    if not length:
        return [0]
    return [length % rows + rows, *([rows] * (length // rows - 1))]


def column_values(shape: BlockShape) -> dict[Column, int]:
    """Numbers in each column of a block."""
    return {
        Column.LATTICE: shape.fresh * 3,
        Column.LOG_SCALES: shape.fresh * shape.scales,
        Column.CODES: shape.fresh * shape.codes,
        Column.RESIDUAL: shape.fresh * shape.residual,
        Column.MASK: shape.hidden,
        Column.OFFSETS: shape.added * 3,
    }


def block_bytes(index: Index, level: int, records: Array) -> NDArray[np.int64]:
    """Raw bytes of every block of a directory, int64 [B]; `column_bytes` for many at once."""
    entry = index.levels[level]
    rows = records["rows"].astype(np.int64)
    fresh, total = rows[:, -1], rows.sum(axis=1)
    before = records["before"].astype(np.int64)
    added = records["live"].astype(np.int64) - before
    width = records["width"].astype(np.int64)
    lattice = np.where(width > 0, MORTON_HEAD + fresh * width, fresh * PLAIN_WIDTH)
    size = np.where(fresh > 0, lattice, 0) + fresh * index.codes_of(level)
    arrays = [
        (entry.log_scales, fresh, scales_of(index.splats)),
        (entry.residual, fresh, index.header.residual),
    ]
    if not index.splats:
        size += (total * index.header.slots - before + 7) // 8
        arrays.append((entry.offsets, added, 3))
    for coding, count, columns in arrays:
        bytes_each = np.dtype(TYPES[CodingId(coding)]).itemsize * columns
        head = PARAMETER_BYTES * columns if CodingId(coding) in STEPPED else 0
        size += np.where(count > 0, head + count * bytes_each, 0)
    return size


def encode_block(
    block: Block, lattice: bytes, shape: BlockShape, plan: CodingPlan
) -> dict[Column, bytes]:
    """The raw bytes of each column; the lattice's come from `encode_lattice`.

    Raises:
        NotFiniteError: a value is not finite.
    """
    scales, residual, offsets = shape.codings
    return {
        Column.LATTICE: lattice,
        Column.LOG_SCALES: encode_values(scales, block.log_scales, plan.log_scales.least),
        Column.CODES: to_planes(block.codes) if shape.splats else block.codes.tobytes(),
        Column.RESIDUAL: encode_values(residual, block.residual, plan.residual.least),
        Column.MASK: b"" if shape.splats else np.packbits(block.mask, bitorder="little").tobytes(),
        Column.OFFSETS: encode_values(offsets, block.offsets, plan.offsets.least),
    }


def decode_block(raw: Bytes, shape: BlockShape) -> Block:
    """The values of a block from inflated bytes of the right length.

    Raises:
        CodecError: the bytes are not what an encoder writes.
        NotFiniteError: a value is not finite.
    """
    parts: dict[Column, Bytes] = {}
    at, view = 0, memoryview(raw)
    for column, length in column_bytes(shape).items():
        parts[column] = view[at : at + length]
        at += length
    scales, residual, offsets = shape.codings
    mask, codes = _decode_mask(parts[Column.MASK], shape), np.frombuffer(parts[Column.CODES], "u1")
    return Block(
        lattice=decode_lattice(parts[Column.LATTICE], shape.fresh, shape.width),
        log_scales=decode_values(scales, parts[Column.LOG_SCALES], shape.fresh, shape.scales),
        codes=codes.reshape(shape.codes, shape.fresh).T if shape.splats else codes,
        residual=decode_values(residual, parts[Column.RESIDUAL], shape.fresh, shape.residual),
        mask=mask,
        offsets=decode_values(offsets, parts[Column.OFFSETS], shape.added, 3),
    )


def _decode_mask(raw: Bytes, shape: BlockShape) -> NDArray[np.bool_]:
    if shape.splats:
        return np.ones(shape.fresh, np.bool_)
    bits = np.unpackbits(np.frombuffer(raw, np.uint8), bitorder="little")
    if bits[shape.hidden :].any():
        raise CodecError("padding bits set")
    mask = bits[: shape.hidden].view(np.bool_)
    if (live := int(np.count_nonzero(mask))) != shape.added:
        raise CodecError(f"{live} new live slots instead of {shape.added}")
    return mask


def encode_lattice(lattice: NDArray[np.int32], base: NDArray[np.int64]) -> tuple[int, bytes]:
    """Bytes of a step and the column, from coordinates in Morton order counted from `base`.

    Steps do not depend on where the code's origin lies, as long as the order of codes does not:
    the origin moves from `base` to a corner of the smallest aligned cube around the block. Width
    0, coordinates as they are, is for a cube of more than 2^21 cells and for any other order.
    """
    if not len(lattice):
        return 0, b""
    local = lattice.astype(np.int64) - base
    low = local.min(axis=0)
    bits = int((local.max(axis=0) ^ low).max()).bit_length()
    if bits <= MORTON_BITS:
        corner = (low >> bits) << bits
        codes = morton_codes((local - corner).astype(np.uint64))
        if (codes[1:] >= codes[:-1]).all():
            steps = np.diff(codes, prepend=codes[:1])
            width = max(1, (int(steps.max()).bit_length() + 7) // 8)
            head = (base + corner).astype("<i4").tobytes() + codes[:1].astype("<u8").tobytes()
            planes = np.frombuffer(to_planes(steps[:, None]), np.uint8)[: width * len(steps)]
            return width, head + planes.tobytes()
    return 0, to_planes(lattice)


def decode_lattice(raw: Bytes, fresh: int, width: int) -> NDArray[np.int32]:
    """Lattice coordinates, int32 [fresh, 3].

    Raises:
        CodecError: a code or a coordinate is out of range.
    """
    if not fresh:
        return np.zeros((0, 3), np.int32)
    if not width:
        return from_planes(raw, fresh, 3, "<i4").astype(np.int32, copy=False)
    origin = np.frombuffer(raw[:12], "<i4").astype(np.int64)
    planes = np.zeros((8, fresh), np.uint8)
    planes[:width] = np.frombuffer(raw[MORTON_HEAD:], np.uint8).reshape(width, fresh)
    steps = np.ascontiguousarray(planes.T).view("<u8")[:, 0]
    first = np.frombuffer(raw[12:MORTON_HEAD], "<u8")
    codes = np.cumsum(steps, dtype=np.uint64) + first
    falling = codes[0] < first[0] or (codes[1:] < codes[:-1]).any()
    if codes[-1] >> np.uint64(MORTON_BITS_MAX) or falling:
        raise CodecError(f"a Morton code above 2^{MORTON_BITS_MAX}")
    points = morton_axes(codes).astype(np.int64) + origin
    if points.max() > np.iinfo(np.int32).max:
        raise CodecError("a coordinate above 2^31 - 1")
    return points.astype(np.int32)
