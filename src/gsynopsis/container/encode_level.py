"""The blocks of one level as bytes: their directory's records, their chunks and an account."""

import zlib
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.blocks import (
    Block,
    BlockShape,
    column_sections,
    decode_block,
    encode_block,
    encode_lattice,
)
from gsynopsis.container.codecs import Array, NotFiniteError, deflate
from gsynopsis.container.coding import CodingPlan
from gsynopsis.container.directory import ranges, record_type
from gsynopsis.container.layout import Column
from gsynopsis.container.spatial import LevelBlocks
from gsynopsis.errors import ValueRangeError
from gsynopsis.records import Float32, LevelSet, stages_of

BLOCK_STRATEGY = (zlib.Z_FILTERED,)
"""Matches of a few bytes cost blocks of rounded values 1 to 4 %; the default wins none."""
SIGMAS = 3.0
"""A Gaussian reaches this many standard deviations."""


@dataclass(frozen=True)
class PartSize:
    """One kind of content at one level in the account.

    Attributes:
        level: The level that pays for it.
        kind: Name of its kind, as in docs/format.md.
        coding: Name of its coding, empty where there is but one.
        stored: Bytes in the file.
        raw: Bytes before deflating.
        values: Numbers in it.
        error: Largest absolute difference between a value given and the value a reader gets.
    """

    level: int
    kind: str
    coding: str
    stored: int
    raw: int
    values: int
    error: float


@dataclass(frozen=True)
class LevelPieces:
    """The blocks of a level: directory records [B], stored bytes of each, account by column."""

    records: Array
    bodies: tuple[bytes, ...]
    parts: tuple[PartSize, ...]


def cut_pieces(
    levels: LevelSet, number: int, blocks: LevelBlocks, plan: CodingPlan, where: str
) -> LevelPieces:
    """Encode the blocks of one level.

    Raises:
        ValueRangeError: a value is not finite.
    """
    source = _LevelSource(levels, number, plan)
    records = np.zeros(len(blocks.parent), record_type(number))
    records["parent"], records["rows"] = blocks.parent, blocks.rows
    firsts = [levels.levels[k - 1].anchors if k else 0 for k in range(number + 1)]
    starts = firsts + np.cumsum(blocks.rows, axis=0) - blocks.rows
    tally = np.zeros((len(Column), 3), np.int64)
    errors = np.zeros(len(Column))
    bodies: list[bytes] = []
    for block, (start, count) in enumerate(zip(starts, blocks.rows, strict=True)):
        rows = ranges(start, count)
        try:
            stored, sizes, error = source.encode(rows, int(count[-1]), records[block : block + 1])
        except NotFiniteError as problem:
            field = f"level {number} block {block}"
            raise ValueRangeError(
                where, field, found=problem, expected="finite values"
            ) from problem
        tally += sizes
        errors = np.maximum(errors, error)
        bodies.append(stored)
    codings = {
        Column.LOG_SCALES: plan.log_scales.coding.label,
        Column.RESIDUAL: plan.residual.coding.label,
        Column.OFFSETS: plan.offsets.coding.label,
    }
    parts = tuple(
        PartSize(
            level=number,
            kind=column.label,
            coding=codings.get(column, ""),
            stored=int(tally[i, 0]),
            raw=int(tally[i, 1]),
            values=int(tally[i, 2]),
            error=float(errors[i]),
        )
        for i, column in enumerate(Column)
        if tally[i, 1]
    )
    return LevelPieces(records, tuple(bodies), parts)


class _LevelSource:
    """Arrays of one level from which its blocks are cut."""

    def __init__(self, levels: LevelSet, number: int, plan: CodingPlan) -> None:
        self.levels, self.number, self.plan = levels, number, plan
        self.before = levels.before(number)
        shared = levels.shared
        self.base = shared.lattice.astype(np.int64).min(axis=0, initial=1 << 31)
        self.splats = shared.degree is not None
        level = levels.levels[number]
        self.codes = stages_of(shared, level) if self.splats else int(bool(len(shared.codes)))

    def encode(
        self, rows: NDArray[np.int64], fresh: int, record: Array
    ) -> tuple[bytes, NDArray[np.int64], NDArray[np.float64]]:
        """One block: fills its record, returns bytes, sizes by column and errors by column."""
        shared, mask = self.levels.shared, self.levels.levels[self.number].mask[rows]
        before = self.before[rows]
        new = rows[len(rows) - fresh :]
        block = Block(
            lattice=shared.lattice[new],
            log_scales=shared.log_scales[new],
            codes=self._codes(new),
            residual=shared.residual[new],
            mask=mask[~before],
            offsets=self._offsets(rows, mask & ~before),
        )
        width, lattice = encode_lattice(block.lattice, self.base)
        shape = self._shape(block, width)
        columns = encode_block(block, lattice, shape, self.plan)
        raw = b"".join(columns.values())
        lengths = [len(column) for column in columns.values()]
        sections = list(column_sections(shape).values())
        stored, pieces = deflate(raw, list(chain(*sections)), BLOCK_STRATEGY)
        taken = iter(pieces)
        sizes_stored = [sum(islice(taken, len(section))) for section in sections]
        record["stored"], record["raw"], record["crc"] = len(stored), len(raw), zlib.crc32(stored)
        record["live"], record["before"], record["width"] = mask.sum(), before.sum(), width
        self._place(rows, mask, record)
        values = [b.size for b in (block.lattice, block.log_scales, block.codes)]
        values += [block.residual.size, block.mask.size, block.offsets.size]
        sizes = np.stack([sizes_stored, lengths, values], axis=1).astype(np.int64)
        return stored, sizes, self._errors(block, decode_block(raw, shape))

    def _codes(self, new: NDArray[np.int64]) -> NDArray[np.uint8]:
        codes = self.levels.shared.codes
        if self.splats:
            return codes[new, : self.codes]
        return codes[new] if self.codes else np.zeros(0, np.uint8)

    def _offsets(self, rows: NDArray[np.int64], fresh: NDArray[np.bool_]) -> Float32:
        if self.splats:
            return np.zeros((0, 3), np.float32)
        return self.levels.shared.offsets[rows][fresh]

    def _shape(self, block: Block, width: int) -> BlockShape:
        codings = (
            self.plan.log_scales.coding,
            self.plan.residual.coding,
            self.plan.offsets.coding,
        )
        return BlockShape(
            fresh=len(block.lattice),
            hidden=0 if self.splats else len(block.mask),
            added=len(block.offsets),
            width=width,
            residual=int(block.residual.shape[1]),
            codes=self.codes,
            splats=self.splats,
            codings=codings,
        )

    def _place(self, rows: NDArray[np.int64], mask: NDArray[np.bool_], record: Array) -> None:
        """The box of the block's anchors and how far their Gaussians reach beyond it."""
        if not len(rows):
            return
        shared, gain = self.levels.shared, self.levels.levels[self.number].gain
        lattice = shared.lattice[rows]
        for axis, low, high in zip("xyz", lattice.min(axis=0), lattice.max(axis=0), strict=True):
            record[f"low_{axis}"], record[f"high_{axis}"] = low, high
        with np.errstate(over="ignore"):
            scales = np.exp(shared.log_scales[rows].astype(np.float64))
            alive = np.where(mask[:, :, None], np.abs(shared.offsets[rows]), 0)
            away = (alive.max(axis=1) * scales[:, : alive.shape[2]]).max(axis=1, initial=0)
            reach = away + SIGMAS * float(gain.max()) * scales[:, -3:].max(axis=1)
        record["reach"] = min(float(reach.max()), float(np.finfo(np.float32).max))

    @staticmethod
    def _errors(given: Block, found: Block) -> NDArray[np.float64]:
        pairs = (
            (given.lattice, found.lattice),
            (given.log_scales, found.log_scales),
            (given.codes, found.codes),
            (given.residual, found.residual),
            (given.mask, found.mask),
            (given.offsets, found.offsets),
        )
        return np.array(
            [np.abs(a.astype(np.float64) - b).max(initial=0) for a, b in pairs], np.float64
        )
