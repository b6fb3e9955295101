"""Level sets from a seed, for tests of whatever takes a `LevelSet`."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.records import (
    HARMONICS,
    HEAD_NAMES,
    Float32,
    Frame,
    Level,
    LevelSet,
    Shared,
    input_width,
    morton_order,
    network_shapes,
)


@dataclass(frozen=True)
class Shape:
    """What a random level set counts; the defaults are a small one with every part."""

    anchors: tuple[int, ...] = (4, 11, 23, 40)
    slots: int = 4
    grids: tuple[int, ...] = (1, 1, 2, 3)
    features: int = 2
    entries: int = 5
    code_width: int = 3
    residual: int = 0
    hidden: int = 4
    fuse: tuple[int, int] | None = None
    keep: float = 0.4
    common: bool = False
    """Networks of all levels have the matrices of level 0; of splats the last two a codebook."""
    degree: int | None = None
    """Of splats' spherical harmonics; `code_width` is then their stages."""
    stand_ins: int = 0
    """Levels of splats that are stand-ins."""


FUSED = Shape(fuse=(6, 5))
FREE = Shape(grids=(0, 0, 0, 0), features=0, entries=0, code_width=0, residual=32)
SINGLE = Shape(anchors=(9,), grids=(2,))
ONE_ANCHOR = Shape(anchors=(1, 1), grids=(1, 2))
ONE_SLOT = Shape(slots=1)
EMPTY_FIRST = Shape(anchors=(0, 5, 5, 12))
EMPTY = Shape(anchors=(0, 0), grids=(0, 1))
BOTH = Shape(residual=3, fuse=(6, 5))
COMMON = Shape(grids=(2, 2, 2, 2), residual=3, common=True)
SPLATS = Shape(
    slots=1, grids=(0, 0, 0, 0), features=0, entries=7, code_width=2, residual=7, keep=1, degree=3
)  # fmt: skip
PLAIN_SPLATS = replace(SPLATS, degree=0, entries=0, code_width=0)
FEW_SPLATS = replace(SPLATS, anchors=(0, 1, 2, 9), degree=1, common=True)
SHAPES = {
    "small": Shape(),
    "fused": FUSED,
    "free": FREE,
    "single": SINGLE,
    "one_anchor": ONE_ANCHOR,
    "one_slot": ONE_SLOT,
    "empty_first": EMPTY_FIRST,
    "empty": EMPTY,
    "both": BOTH,
    "common": COMMON,
}
STAND_INS = replace(SPLATS, stand_ins=2)
SPLAT_SHAPES = {
    "splats": SPLATS,
    "plain_splats": PLAIN_SPLATS,
    "few_splats": FEW_SPLATS,
    "stand_ins": STAND_INS,
}
ALL_SHAPES = SHAPES | SPLAT_SHAPES


def make_level_set(rng: np.random.Generator, shape: Shape | None = None) -> LevelSet:
    """A valid level set: unique lattice points in Morton order by first level, nested masks."""
    shape = shape or Shape()
    if shape.degree is not None:
        return _splat_set(rng, shape, shape.degree)
    count = shape.anchors[-1]
    shared = Shared(
        lattice=_lattice(rng, shape.anchors),
        log_scales=_normal(rng, (count, 6), 1.0) - np.float32(4),
        offsets=_normal(rng, (count, shape.slots, 3), 1.0),
        codes=rng.integers(0, max(1, shape.entries), count if shape.entries else 0, np.uint8),
        residual=_normal(rng, (count, shape.residual), 0.3),
        grids=tuple(
            _normal(rng, (8 * (g + 1), shape.features), 0.1) for g in range(shape.grids[-1])
        ),
        grid_resolutions=tuple(3 + 2 * g for g in range(shape.grids[-1])),
    )
    mask = np.zeros((0, shape.slots), np.bool_)
    levels: list[Level] = []
    for number, (anchors, grids) in enumerate(zip(shape.anchors, shape.grids, strict=True)):
        mask = _grown_mask(rng, mask, anchors, shape.keep)
        levels.append(_level(rng, shape, shared, mask, grids, number))
        if shape.common:
            first = {n: w for n, w in levels[0].networks.items() if w.ndim == 2}
            levels[-1] = replace(levels[-1], networks={**levels[-1].networks, **first})
    frame = Frame(0.013, rng.normal(size=3), 2.5, bool(rng.integers(2)), 7.25)
    return LevelSet(frame, shared, tuple(levels), {"scene": "random", "generator": "tests"})


def _splat_set(rng: np.random.Generator, shape: Shape, degree: int) -> LevelSet:
    """Splats whose base has a codebook of its own, of one stage; `common`: the last two share."""
    count, width = shape.anchors[-1], HARMONICS[degree]
    stages = [min(shape.code_width, number + 1) for number in range(len(shape.anchors))]
    books = [_normal(rng, (shape.entries, s * width), 0.1) for s in stages]
    books[-1] = books[-2] if shape.common else books[-1]
    shared = Shared(
        lattice=_lattice(rng, shape.anchors),
        log_scales=_normal(rng, (count, 3), 1.0) - np.float32(4),
        offsets=np.zeros((count, 1, 0), np.float32),
        codes=rng.integers(0, max(1, shape.entries), (count, max(stages)), np.uint8),
        residual=_normal(rng, (count, 7), 0.5),
        grids=(),
        grid_resolutions=(),
        degree=degree,
        stand_ins=shape.stand_ins,
    )
    first = 0
    for anchors, used in zip(shape.anchors, stages, strict=True):
        shared.codes[first:anchors, used:] = 0
        first = anchors
    levels = tuple(
        Level(
            mask=np.ones((anchors, 1), np.bool_),
            grids=0,
            codebook=book,
            networks={},
            gain=(1 + rng.random(3)).astype(np.float32),
            quality={"psnr_full": 20.0 + number},
        )
        for number, (anchors, book) in enumerate(zip(shape.anchors, books, strict=True))
    )
    frame = Frame(0.013, rng.normal(size=3), 2.5, False, 7.25)
    return LevelSet(frame, shared, levels, {"scene": "random", "generator": "tests"})


def _normal(rng: np.random.Generator, shape: tuple[int, ...], scale: float) -> Float32:
    return (rng.standard_normal(shape) * scale).astype(np.float32)


def _lattice(rng: np.random.Generator, anchors: tuple[int, ...]) -> NDArray[np.int32]:
    """Points near a bent sheet, as anchors lie on surfaces; coordinates of both signs."""
    count = anchors[-1]
    side = int(4 + 2 * count**0.5)
    points = np.unique(rng.integers(-side, side, (4 * count + 8, 2)), axis=0)
    points = rng.permutation(points)[:count]
    height = (points**2).sum(axis=1) // (2 * side) + rng.integers(-1, 2, count)
    lattice = np.column_stack([points, height]).astype(np.int32)
    starts = (0, *anchors[:-1])
    rank = np.argsort(morton_order(lattice))
    for start, end in zip(starts, anchors, strict=True):
        lattice[start:end] = lattice[start:end][np.argsort(rank[start:end])]
    return lattice


def _grown_mask(
    rng: np.random.Generator, before: NDArray[np.bool_], anchors: int, keep: float
) -> NDArray[np.bool_]:
    slots = before.shape[1]
    mask = rng.random((anchors, slots)) < keep
    mask[np.arange(anchors), rng.integers(0, slots, anchors)] = True
    mask[: len(before)] = before | (rng.random(before.shape) < keep / 4)
    return mask


def _level(
    rng: np.random.Generator,
    shape: Shape,
    shared: Shared,
    mask: NDArray[np.bool_],
    grids: int,
    number: int,
) -> Level:
    codebook = _normal(rng, (shape.entries, shape.code_width), 0.1)
    blank = {f"{head}_b1": np.zeros(shape.hidden, np.float32) for head in HEAD_NAMES}
    width = input_width(shared, _sized(grids, codebook, blank, mask))
    shapes = network_shapes(width, shape.slots, shape.hidden, shape.fuse)
    return Level(
        mask=mask,
        grids=grids,
        codebook=codebook,
        networks={name: _normal(rng, size, 0.2) for name, size in shapes.items()},
        gain=(1 + rng.random(3)).astype(np.float32),
        quality={"psnr_full": 20.0 + number, "ssim_full": 0.5 + number / 10},
    )


def _sized(
    grids: int, codebook: Float32, networks: dict[str, Float32], mask: NDArray[np.bool_]
) -> Level:
    return Level(mask, grids, codebook, networks, np.ones(3, np.float32))


def assert_same(first: LevelSet, second: LevelSet) -> None:
    """Every value of two level sets is equal, bit for bit."""
    assert _values(first) == _values(second)


def _values(levels: LevelSet) -> list[object]:
    frame, shared = levels.frame, levels.shared
    values: list[object] = [frame.voxel, frame.radius, frame.contract, frame.extent]
    values += [dict(levels.meta), list(shared.grid_resolutions)]
    arrays = [frame.center, shared.lattice, shared.log_scales, shared.offsets, shared.codes]
    arrays += [shared.residual, *shared.grids]
    for level in levels.levels:
        values += [level.grids, dict(level.quality), list(level.networks)]
        arrays += [level.mask, level.codebook, level.gain, *level.networks.values()]
    return values + [(a.dtype.str, a.shape, np.ascontiguousarray(a).tobytes()) for a in arrays]
