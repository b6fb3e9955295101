"""Records that pass between rooms: a trained scene as NumPy arrays with checked shapes.

Model and container meet here and nowhere else. Letters of shapes: N anchors of all levels, K slots
per anchor, L level, F features, R residual values per anchor, D input width. With splats: H values
of spherical harmonics beyond the first of each colour, S stages of codes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

HEAD_NAMES = ("opacity", "cov", "color")
HEAD_OUTPUTS = {"opacity": 1, "cov": 7, "color": 3}
"""Values per slot: one opacity, three scale factors and a quaternion, one RGB."""
NETWORK_NAMES = tuple(
    f"{net}_{part}" for net in ("fuse", *HEAD_NAMES) for part in ("w1", "b1", "w2", "b2")
)
"""All names of weights in their canonical order."""
VIEW_INPUTS = 4
"""Unit viewing direction (3) and normalised distance (1), the last columns of each head."""

SPLAT_VALUES = 7
"""Residual values of a splat: three of rotation, the opacity's logit, colour as Y, Co, Cg."""
SH_0 = 0.28209479177387814
"""The spherical harmonic of degree 0: a colour is half, plus this times its first coefficient."""
SH_1 = 0.4886025119029199
SH_2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)
"""Factors of the spherical harmonics of degree 1 to 3."""
HARMONICS = (0, 9, 24, 45)
"""H for spherical harmonics of degree 0 to 3."""

COUPLED = 16
"""Neighbouring residual values whose coupling is known, at most."""

ORBIT_NOTE = "orbit"
"""Note of the manifest: the circle on which the training cameras stand."""
FIRST_NOTE = "first"
"""Note: pose and lens of the first view."""
FOCALS_NOTE = "focals"
"""Note: focal lengths of the training photos of each level."""
SEEN_NOTE = "seen"
"""Note: where the training cameras stood and how far they saw."""
POSTER_NOTE = "poster"
"""Note: a tiny image of the first view."""
UTILITY_NOTE = "gains"
"""Note: improvement of images by each block."""
SHIFT_NOTE = "shift"
"""Note: what has to be added to positions for those of the input, `x y z` in its axes."""
ANNOTATIONS_NOTE = "annotations"
"""Note: titles and texts at places of the scene."""
TRAINED_NOTE = "trained_bytes"
"""Note: what each level takes in float32, before anything was rounded."""

MORTON_BITS = 21
"""Bits per axis of a Morton code, so that three axes fit 63 bits."""
MORTON_STEPS = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""Shifts and masks that move bit i of a 21-bit number to bit 3i."""


@dataclass(frozen=True)
class Frame:
    """Frame of lattice coordinates: gives positions and grid coordinates; fixed at step 0.

    Attributes:
        voxel: Edge of a lattice cell, world units, > 0.
        center: Centre of the contraction (or of the box), world units, float64 [3].
        radius: Positions within this of the centre keep their resolution, world units, > 0.
        contract: True: everything outside is contracted into the grid's outer half
            (methods.md §1.3). False: the grid covers the box centre ± radius and clamps.
        extent: Unit of the distance that the heads see, world units, > 0 (1.1 × the largest
            distance of a training camera from their mean, methods.md §1.2).
    """

    voxel: float
    center: NDArray[np.float64]
    radius: float
    contract: bool
    extent: float


@dataclass(frozen=True)
class Shared:
    """Values that all levels share: written once, never modified after training.

    Rows are ordered by the level at which the anchor first appears, then by Morton code, so that
    the anchors of level L are the first `levels[L].anchors` rows.

    Rows are anchors, or, where `degree` is given, splats: Gaussians with values of their own
    (docs/format.md §5). A splat is an anchor with one slot, always live, without offset: K is 1,
    `log_scales` [N, 3], `residual` [N, 7], `offsets` [N, 1, 0], `codes` [N, S], and there are no
    grids. A splat uses as many of its codes as the codebook of its first level has stages.
    """

    lattice: NDArray[np.int32]  # [N, 3] position = float32(float64(lattice) * voxel)
    log_scales: Float32  # [N, 6] natural log, world units; 3 for offsets, 3 for Gaussians
    offsets: Float32  # [N, K, 3] in units of exp(log_scales[:, :3])
    codes: NDArray[np.uint8]  # [N] codebook row, or [0] if there is no codebook
    residual: Float32  # [N, R] continuous features, R may be 0
    grids: Sequence[Float32]  # per grid level [T, F]; may be empty
    grid_resolutions: Sequence[int]  # vertices per axis of each grid level, ascending
    degree: int | None = None  # of splats' spherical harmonics, 0 to 3; None: rows are anchors
    stand_ins: int = 0  # levels whose splats finer levels do not show; 0: all show all

    @property
    def slots(self) -> int:
        """K, the slots per anchor."""
        return int(self.offsets.shape[1])

    @property
    def harmonics(self) -> int:
        """H, of splats; 0 for anchors."""
        return HARMONICS[self.degree or 0]

    def of_rows(self, rows: slice | NDArray[np.int64]) -> "Shared":
        """The values of some rows, in their order."""
        return replace(
            self,
            lattice=self.lattice[rows],
            log_scales=self.log_scales[rows],
            offsets=self.offsets[rows],
            codes=self.codes[rows] if len(self.codes) else self.codes,
            residual=self.residual[rows],
        )


@dataclass(frozen=True)
class Level:
    """One level of detail: which anchors and slots, and the parts it replaces.

    Attributes:
        mask: bool [n, K] live slots of the first n anchors; every row has at least one.
        grids: How many of the coarsest shared grids this level reads.
        codebook: [C, D] or [0, 0]; of splats [C, S · H]: S stages, whose rows add up.
        networks: Empty with splats. Weights by name: `fuse_w1 [hidden, in]`, `fuse_b1`,
            `fuse_w2`, `fuse_b2` where there is a fusion MLP, and for each head
            `{head}_w1 [hidden, in]`, `{head}_b1`,
            `{head}_w2 [outputs * K, hidden]`, `{head}_b2`. Columns are grids (coarse to fine),
            codebook, residual, then (in heads) direction and distance; a fusion MLP takes the
            place of the first three.
        gain: Factor on the scales of Gaussians, float32 [3] > 0 (methods.md §1.11.11).
        quality: Measured figures such as `psnr_full`, dB; empty if unknown.
    """

    mask: NDArray[np.bool_]
    grids: int
    codebook: Float32
    networks: Mapping[str, Float32]
    gain: Float32
    quality: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def anchors(self) -> int:
        """Anchors of this level."""
        return int(self.mask.shape[0])

    @property
    def live(self) -> int:
        """Live slots of this level."""
        return int(self.mask.sum())


@dataclass(frozen=True)
class LevelSet:
    """A whole scene: frame, shared tensors and nested levels, coarsest first.

    Raises:
        ValueError: a shape does not fit or the levels are not nested. This is a programming
            mistake or a hostile file; readers translate it into a `FormatError`.
    """

    frame: Frame
    shared: Shared
    levels: tuple[Level, ...]
    meta: Mapping[str, str] = field(default_factory=dict[str, str])

    def __post_init__(self) -> None:
        _check_frame(self.frame)
        _check_shared(self.shared)
        if not self.levels:
            raise ValueError("a level set needs at least one level")
        for number, level in enumerate(self.levels):
            _check_level(self.shared, level, number)
        for number in range(len(self.levels) - 1):
            _check_nested(self.levels[number], self.levels[number + 1], number)
        if not 0 <= self.shared.stand_ins < max(1, len(self.levels)):
            raise ValueError(f"stand-ins at {self.shared.stand_ins} of {len(self.levels)} levels")
        if self.shared.degree is not None:
            _check_codes(self.shared, self.levels)
        elif self.shared.stand_ins:
            raise ValueError("anchors as stand-ins")
        if self.levels[-1].anchors != len(self.shared.lattice):
            raise ValueError("the finest level does not hold all anchors")

    def first_shown(self, level: int) -> int:
        """The first row that a level shows: stand-ins of coarser levels are not its."""
        own = level % len(self.levels)
        stand_ins = self.shared.stand_ins
        return self.levels[stand_ins - 1].anchors if 0 < stand_ins <= own else 0

    def before(self, level: int) -> NDArray[np.bool_]:
        """Slots of a level's anchors that coarser levels have already, bool [n, K]."""
        found = np.zeros_like(self.levels[level].mask)
        if level:
            parent = self.levels[level - 1]
            found[: parent.anchors] = parent.mask
        return found

    def inherits(self, level: int) -> bool:
        """True if a level has the matrices of the level before, or its splats that codebook."""
        if not level:
            return False
        if self.shared.degree is not None:
            book = self.levels[level].codebook
            return bool(book.size) and np.array_equal(book, self.levels[level - 1].codebook)
        own, before = self.levels[level].networks, self.levels[level - 1].networks
        if list(own) != list(before):
            return False
        matrices = [name for name, weight in own.items() if weight.ndim == 2]
        return all(np.array_equal(own[name], before[name]) for name in matrices)

    def own_networks(self, level: int) -> dict[str, Float32]:
        """A level's networks without those it inherits: biases alone with tied weights."""
        inherits = self.inherits(level)
        weights = self.levels[level].networks.items()
        return {name: w for name, w in weights if w.ndim == 1 or not inherits}

    def upto(self, level: int) -> "LevelSet":
        """The level set that ends with `level`, as a client has it after that many deltas."""
        last = self.levels[level]
        s = self.shared.of_rows(slice(last.anchors))
        codes = s.codes
        if s.degree is not None:
            codes = codes[:, : max(stages_of(s, v) for v in self.levels[: level + 1])]
        shared = replace(
            s,
            offsets=np.where(last.mask[:, :, None], s.offsets, np.float32(0)),
            codes=codes,
            grids=tuple(s.grids[: last.grids]),
            grid_resolutions=tuple(s.grid_resolutions[: last.grids]),
            stand_ins=s.stand_ins if level % len(self.levels) >= s.stand_ins else 0,
        )
        return LevelSet(self.frame, shared, self.levels[: level + 1], self.meta)


@dataclass(frozen=True)
class Sensitivity:
    """Loss of an image by an error of 1 in one value, for small errors: decibels, ≥ 0.

    Squares of errors, weighted by it, add up to about the loss of the level that loses most.

    Attributes:
        log_scales: [N, 6].
        offsets: [N, K, 3].
        residual: [N, R].
        grids: Per grid level [T, F].
        coupling: Of errors in two residual values of an anchor, any sign, all levels' sum: [N, P],
            a column for each of the P pairs of `coupled_pairs`. Pairs of one value with itself are
            included.
    """

    log_scales: Float32
    offsets: Float32
    residual: Float32
    grids: Sequence[Float32]
    coupling: Float32


@dataclass(frozen=True)
class PlainGaussians:
    """Gaussians with nothing to decode, as other programs train and keep them (3DGS, §4).

    Values are before activation, colours are spherical harmonics in 3DGS's convention:
    colour = 0.5 + Σ basis(direction) · sh, so that `sh[:, 0]` is 3DGS's `f_dc`.

    Attributes:
        means: World units, float32 [G, 3].
        log_scales: Natural logarithms of standard deviations in world units, float32 [G, 3].
        quaternions: w x y z, of any length above 0, float32 [G, 4].
        logits: Opacities before the logistic function, float32 [G].
        sh: Coefficients, C = 1, 4, 9 or 16 for degree 0 to 3, red green blue, float32 [G, C, 3].
    """

    means: Float32  # [G, 3]
    log_scales: Float32  # [G, 3]
    quaternions: Float32  # [G, 4]
    logits: Float32  # [G]
    sh: Float32  # [G, C, 3]

    def __post_init__(self) -> None:
        count, coefficients = len(self.means), self.sh.shape[1] if self.sh.ndim == 3 else 0
        if coefficients not in (1, 4, 9, 16):
            raise ValueError(f"sh: found {list(self.sh.shape)}, expected [G, 1, 4, 9 or 16, 3]")
        _expect("means", self.means, np.float32, (count, 3))
        _expect("log_scales", self.log_scales, np.float32, (count, 3))
        _expect("quaternions", self.quaternions, np.float32, (count, 4))
        _expect("logits", self.logits, np.float32, (count,))
        _expect("sh", self.sh, np.float32, (count, coefficients, 3))

    def __len__(self) -> int:
        return len(self.means)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1


def coupled_pairs(values: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and second of all pairs of an anchor's residual values whose coupling is known.

    Pairs lie within `COUPLED` neighbours, the first not after the second, both int64 [P].
    """
    pairs = np.array(
        [
            (first, second)
            for first in range(values)
            for second in range(first, min(values, (first // COUPLED + 1) * COUPLED))
        ],
        dtype=np.int64,
    ).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def positions(frame: Frame, lattice: NDArray[np.int32]) -> Float32:
    """Anchor positions, float32 [N, 3] world units; the one canonical formula (§1.2.3)."""
    return (lattice.astype(np.float64) * frame.voxel).astype(np.float32)


def morton_order(lattice: NDArray[np.int32]) -> NDArray[np.int64]:
    """The order of lattice points along a Morton (Z) curve, int64 [N].

    Coordinates count from the smallest of each axis; all of their bits, up to 32 per axis, are
    interleaved. Equal points keep their order. To order by first level and then Morton code, sort
    stably by level afterwards: `order[np.argsort(first[order], kind="stable")]`.

    Args:
        lattice: int32 [N, 3]; any values, N may be 0.
    """
    if not len(lattice):
        return np.zeros(0, np.int64)
    points = lattice.astype(np.int64)
    points -= points.min(axis=0)
    low = morton_codes(points.astype(np.uint64))
    if not int(points.max()) >> MORTON_BITS:
        return np.argsort(low, kind="stable").astype(np.int64)
    high = morton_codes((points >> MORTON_BITS).astype(np.uint64))
    return np.lexsort((low, high)).astype(np.int64)


def morton_codes(points: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Lowest 21 bits of x, y, z interleaved, x lowest: uint64 [N] below 2^63.

    Args:
        points: uint64 [N, 3].
    """
    codes = points & np.uint64((1 << MORTON_BITS) - 1)
    for shift, mask in MORTON_STEPS:
        codes = (codes | (codes << np.uint64(shift))) & np.uint64(mask)
    return codes[:, 0] | (codes[:, 1] << np.uint64(1)) | (codes[:, 2] << np.uint64(2))


def morton_axes(codes: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The inverse of `morton_codes`: uint64 [N, 3], each below 2^21."""
    axes = codes[:, None] >> np.arange(3, dtype=np.uint64)
    shifts, masks = zip(*reversed(MORTON_STEPS), strict=True)
    axes &= np.uint64(masks[0])
    for shift, mask in zip(shifts, [*masks[1:], (1 << MORTON_BITS) - 1], strict=True):
        axes = (axes | (axes >> np.uint64(shift))) & np.uint64(mask)
    return axes


def stages_of(shared: Shared, level: Level) -> int:
    """S, the codes of a splat that a level brings."""
    return int(level.codebook.shape[1]) // (shared.harmonics or 1)


def harmonics_of(shared: Shared, levels: tuple[Level, ...]) -> Float32:
    """Coefficients beyond the first of each colour, float32 [N, H]: sums of rows of codebooks."""
    found = np.zeros((len(shared.lattice), shared.harmonics), np.float32)
    first = 0
    for level in levels:
        rows = slice(first, level.anchors)
        for stage in range(stages_of(shared, level)):
            columns = slice(stage * shared.harmonics, (stage + 1) * shared.harmonics)
            found[rows] += level.codebook[:, columns][shared.codes[rows, stage]]
        first = level.anchors
    return found


def input_width(shared: Shared, level: Level) -> int:
    """Width of the view-independent features of a level: grids, codebook, residual."""
    grid = sum(int(g.shape[1]) for g in shared.grids[: level.grids])
    return grid + int(level.codebook.shape[1]) + int(shared.residual.shape[1])


def network_shapes(
    width: int, slots: int, hidden: int, fuse: tuple[int, int] | None
) -> dict[str, tuple[int, ...]]:
    """The exact names and shapes of a level's networks.

    Args:
        width: View-independent feature width, see `input_width`.
        slots: K.
        hidden: Hidden width of the heads.
        fuse: Hidden and output width of the fusion MLP, or None.
    """
    shapes: dict[str, tuple[int, ...]] = {}
    if fuse is not None:
        inner, outer = fuse
        shapes |= {"fuse_w1": (inner, width), "fuse_b1": (inner,)}
        shapes |= {"fuse_w2": (outer, inner), "fuse_b2": (outer,)}
        width = outer
    for head in HEAD_NAMES:
        out = HEAD_OUTPUTS[head] * slots
        shapes |= {f"{head}_w1": (hidden, width + VIEW_INPUTS), f"{head}_b1": (hidden,)}
        shapes |= {f"{head}_w2": (out, hidden), f"{head}_b2": (out,)}
    return shapes


def _expect(name: str, array: NDArray[np.generic], dtype: type, shape: tuple[int, ...]) -> None:
    if array.dtype != np.dtype(dtype) or array.shape != shape:
        raise ValueError(
            f"{name}: found {array.dtype}{list(array.shape)}, "
            f"expected {np.dtype(dtype)}{list(shape)}"
        )


def _check_frame(frame: Frame) -> None:
    numbers = [frame.voxel, frame.radius, frame.extent, *frame.center]
    if not np.isfinite(numbers).all() or min(frame.voxel, frame.radius, frame.extent) <= 0:
        raise ValueError(f"frame: found {numbers}, expected finite values and positive sizes")


def _check_shared(shared: Shared) -> None:
    n, k = len(shared.lattice), shared.slots
    _expect("lattice", shared.lattice, np.int32, (n, 3))
    if shared.degree is not None:
        _check_splats(shared, n)
        return
    _expect("log_scales", shared.log_scales, np.float32, (n, 6))
    _expect("offsets", shared.offsets, np.float32, (n, k, 3))
    _expect("codes", shared.codes, np.uint8, (n if len(shared.codes) else 0,))
    _expect("residual", shared.residual, np.float32, (n, shared.residual.shape[1]))
    if len(shared.grids) != len(shared.grid_resolutions):
        raise ValueError("grids: one resolution for each grid is expected")
    for number, grid in enumerate(shared.grids):
        _expect(f"grid {number}", grid, np.float32, (len(grid), shared.grids[0].shape[1]))


def _check_splats(shared: Shared, n: int) -> None:
    _expect("log_scales", shared.log_scales, np.float32, (n, 3))
    _expect("offsets", shared.offsets, np.float32, (n, 1, 0))
    _expect("codes", shared.codes, np.uint8, (n, *shared.codes.shape[1:2]))
    _expect("residual", shared.residual, np.float32, (n, SPLAT_VALUES))
    if len(shared.grids) or shared.degree not in range(len(HARMONICS)):
        raise ValueError(f"splats of degree {shared.degree} with {len(shared.grids)} grids")


def _check_codes(shared: Shared, levels: Sequence[Level]) -> None:
    """Codes of splats have a stage and a row in the codebook of the level that brings them."""
    first = 0
    for number, level in enumerate(levels):
        (entries, width), stages = level.codebook.shape, stages_of(shared, level)
        if stages * shared.harmonics != width or stages > shared.codes.shape[1]:
            raise ValueError(f"level {number}: codebook of {width} columns")
        codes = shared.codes[first : level.anchors, :stages]
        if codes.size and int(codes.max()) >= entries:
            raise ValueError(f"level {number}: a code is out of the codebook's {entries} entries")
        first = level.anchors


def _check_level(shared: Shared, level: Level, number: int) -> None:
    where = f"level {number}"
    n = level.anchors
    _expect(f"{where} mask", level.mask, np.bool_, (n, shared.slots))
    if n > len(shared.lattice):
        raise ValueError(f"{where}: {n} anchors, more than the {len(shared.lattice)} there are")
    if n and not level.mask.any(axis=1).all():
        raise ValueError(f"{where}: an anchor without a live slot")
    if not 0 <= level.grids <= len(shared.grids):
        raise ValueError(f"{where}: reads {level.grids} of {len(shared.grids)} grids")
    _expect(f"{where} codebook", level.codebook, np.float32, level.codebook.shape[:2])
    _expect(f"{where} gain", level.gain, np.float32, (3,))
    if shared.degree is None:
        _check_learnt(shared, level, where)
    elif level.networks:
        raise ValueError(f"{where}: networks {list(level.networks)}, expected none with splats")


def _check_learnt(shared: Shared, level: Level, where: str) -> None:
    """Codes, codebook and networks of a level of anchors."""
    n = level.anchors
    entries = len(level.codebook)
    if bool(entries) != bool(len(shared.codes)) and n:
        raise ValueError(f"{where}: codes and codebook must be there together")
    if n and entries and int(shared.codes[:n].max()) >= entries:
        raise ValueError(f"{where}: a code is out of the codebook's {entries} entries")
    hidden = len(level.networks["opacity_b1"])
    fuse = None
    if "fuse_b1" in level.networks:
        fuse = (len(level.networks["fuse_b1"]), len(level.networks["fuse_b2"]))
    shapes = network_shapes(input_width(shared, level), shared.slots, hidden, fuse)
    if list(level.networks) != list(shapes):
        raise ValueError(f"{where}: networks {list(level.networks)}, expected {list(shapes)}")
    for name, shape in shapes.items():
        _expect(f"{where} {name}", level.networks[name], np.float32, shape)


def _check_nested(coarse: Level, fine: Level, number: int) -> None:
    n = coarse.anchors
    if n > fine.anchors or (coarse.mask & ~fine.mask[:n]).any():
        raise ValueError(f"level {number} is not contained in level {number + 1}")
    if coarse.grids > fine.grids:
        raise ValueError(f"level {number} reads more grids than level {number + 1}")
