"""Settings as frozen dataclasses: types, ranges and defaults. Defaults are the paper's values.

Each field gives its unit and where its value comes from: a section of docs/methods.md (which cites
the papers) or "ours" and why. Ranges are part of the types; `serialize.config_from_values` enforces
them.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

from gsynopsis.config.rates import RateTable

GRID_RESOLUTIONS = (18, 24, 33, 44, 59, 80, 108, 148, 201, 275, 376, 514)
"""Vertices per axis of the twelve grids (methods.md §1.3, from HAC)."""
STEPS_MAX = 100_000_000
Share: TypeAlias = Annotated[float, Meta(ge=0, le=1)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0, le=1e9)]
Steps: TypeAlias = Annotated[int, Meta(ge=1, le=STEPS_MAX)]
Keep: TypeAlias = Annotated[
    tuple[Annotated[float, Meta(gt=0, le=1)], ...], Meta(min_length=0, max_length=7)
]
"""Shares of anchors, one per step down."""
Split: TypeAlias = Literal["every8", "validation", "bungee", "none"]
"""As `scene.scene.Split`."""


@dataclass(frozen=True)
class ModelConfig:
    """The anchor model (methods.md §1.1–§1.5)."""

    feature: Literal["synopsis", "free"] = "synopsis"
    """`synopsis`: grids, codebook and residual; `free`: 32 plain values per anchor (control)."""
    fusion: Literal["mlp", "none"] = "mlp"
    """`mlp` as in the paper; `none` feeds features straight into the heads (ours, §1.5)."""
    slots: Annotated[int, Meta(ge=1, le=32)] = 10
    """K, Gaussians per anchor (§1.15; 16 in our presets)."""
    grids: Annotated[int, Meta(ge=0, le=12)] = 12
    """Hash grids; 0 switches them off (§1.3). Each coarser level reads a sixth fewer of them, at
    least one fewer (§1.11.2), unless levels have tied weights."""
    table_log2: Annotated[int, Meta(ge=4, le=22)] = 15
    """log2 of the entries per hashed grid; 13 in `paper` (§1.3)."""
    codebook: Annotated[int, Meta(ge=0, le=256)] = 256
    """Codebook rows, 32 values each; 0 switches the codebook off (§1.4)."""
    residual: Annotated[int, Meta(ge=0, le=1024)] = 0
    """Continuous values per anchor beside grids and codebook (ours; the paper has none)."""
    hidden: Annotated[int, Meta(ge=1, le=4096)] = 32
    """Hidden width of the three heads (§1.5)."""
    opacity_init_scale: Annotated[float, Meta(gt=0, le=100)] = 1.0
    """Factor on the first weights and biases of the opacity head's output: slots of an anchor start
    more unlike each other, and above 1 most of them show at the start (ours, §2.6)."""
    bounds: Literal["contract", "aabb"] = "contract"
    """`contract`: all of space, outer half contracted, with anchors for the backdrop (ours, §1.3,
    §2.16); `aabb`: a box, as in HAC."""
    voxel: NotNegative = 0.0
    """Lattice cell, world units; 0 takes the median nearest-neighbour distance (§1.2)."""

    @property
    def grid_drop(self) -> int:
        """Finest grids that each coarser level reads less (§1.11.2: two of twelve)."""
        return max(1, self.grids // 6)


@dataclass(frozen=True)
class GrowthConfig:
    """Growing and pruning of anchors (§1.9)."""

    cell: Annotated[int, Meta(ge=1, le=65_536)] = 16
    """Coarsest growth cell in voxels, 128 for BungeeNeRF (§1.2)."""
    every: Steps = 100
    """Steps between adjustments."""
    until: Share = 0.5
    """Growth ends after this share of the full training's steps."""
    threshold: NotNegative = 2e-4
    """Mean gradient of the projected centre, NDC units; doubles per growth level."""
    grow_visits: NotNegative = 0.4
    """A slot may grow after this many visits per `every` steps (0.8 · 0.5 in Scaffold-GS)."""
    prune_visits: NotNegative = 0.8
    """An anchor may be pruned after this many visits per `every` steps."""
    max_anchors: Annotated[int, Meta(ge=1, le=2**31 - 1)] = 1_000_000
    """No growth beyond this many anchors (ours: bounds memory)."""
    per_pixel: NotNegative = 0.0
    """No growth beyond this many anchors per pixel of the largest training image; 0: no such bound
    (ours: what one image cannot tell apart need not grow, §1.9)."""


@dataclass(frozen=True)
class TrainConfig:
    """The full model's training (§1.7–§1.10)."""

    steps: Steps = 30_000
    """Steps of the full model; those of levels follow in the preset's proportion unless given."""
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    """Seed of all random numbers."""
    batch: Annotated[int, Meta(ge=1, le=1024)] = 1
    """Views per step, whose gradients are averaged; processes of torchrun share them (ours)."""
    rates: RateTable = "paper"
    """Table of learning rates: those of Scaffold-GS and HAC, or ours, which fall less (§1.8)."""
    opacity_weight: NotNegative = 0.0
    """λ_α on the mean rendered opacity once growth has ended, so that fewer slots show (ours,
    after 3DGS-MCMC)."""
    weight_average: Share = 0.0
    """Last share of a phase's steps over which weights are averaged (ours, §2.5)."""
    dropout: Annotated[float, Meta(ge=0, le=0.9)] = 0.0
    """Share of the Gaussians that each image of a step lacks, at random, against overfitting few
    photos (after DropGaussian, §2.17)."""
    subpixel_jitter: Annotated[int, Meta(ge=1, le=8)] = 1
    """Places along each axis of a pixel at which steps sample photos and renderings; 1: pixel
    centres alone (ours, §2.7). Of use where photos are divided by two or more, and used there."""
    reduced_until: Annotated[tuple[Share, ...], Meta(max_length=4)] = ()
    """Shares of all steps until which photos are divided by 2 once more: (0.3, 0.6) trains at a
    quarter of the width and height until 0.3, at half until 0.6 (ours, after DashGaussian, §2.19).
    """
    exposure: Literal["auto", "on", "off"] = "auto"
    """Solve a gain of each photo and channel, left out of the file (ours, after 3DGS); `auto`:
    where held-back photos prove that it helps (§2.13). One view per step only."""
    growth: GrowthConfig = field(default_factory=GrowthConfig)


@dataclass(frozen=True)
class Joint:
    """All levels trained at once (ours). Level scales are learnt."""

    mode: Literal["joint"] = "joint"
    keep: Keep = (0.7, 0.5, 0.4)
    """Anchors kept from each level to the next coarser one, finest first (§1.11.6)."""
    steps: Steps = 15_000
    """Steps of all levels together, after the full training."""
    level_mib: Annotated[
        tuple[Annotated[float, Meta(gt=0, le=2**33)], ...], Meta(max_length=16)
    ] = ()
    """Size of the file up to each level's end, MiB, coarsest first; empty: by `keep` (§2.9)."""
    prune_share: Annotated[float, Meta(ge=0, lt=1)] = 0.0036
    """Rate–distortion pruning: when levels split off and five times later, the slots and anchors of
    the finest level go that have the least removal effect per byte, together at most this share of
    all; fewer of coarser levels. 0 keeps all (§2.3). Stated for 56 passes over the photos."""
    levels_per_step: Annotated[float, Meta(ge=1, le=16)] = 3.0
    """Levels rendered in a step, on average: the finest and others at random; gradients add up
    (§2.1)."""
    loss_weights: Annotated[
        tuple[Annotated[float, Meta(gt=0, le=1e6)], ...], Meta(max_length=16)
    ] = (0.6, 0.8, 1.1)
    """Factors on the losses of the coarsest levels, coarsest first; 1 for all others (§2.1)."""
    weights: Literal["tied", "separate"] = "tied"
    """`tied`: the heads of all levels share their matrices, which the file holds once; biases are
    each level's own (§2.4). `separate` as in the paper (§1.12)."""
    coding_loss: Annotated[float, Meta(ge=0, le=100)] = 0.1
    """Distortion that quantisation may add to the finest level, about, dB; 0: default steps (§4.3).
    """

    @property
    def count(self) -> int:
        """Levels in all."""
        return len(self.keep) + 1

    @property
    def tied(self) -> bool:
        """True if heads of all levels share their matrices."""
        return self.weights == "tied"

    @property
    def level_bytes(self) -> tuple[int, ...]:
        """`level_mib` in bytes."""
        return tuple(round(mib * 2**20) for mib in self.level_mib)


@dataclass(frozen=True)
class Sequential:
    """The paper's top-down unfolding: one coarser level after the other (§1.11–§1.13)."""

    mode: Literal["sequential"] = "sequential"
    keep: Keep = (0.7, 0.5, 0.4)
    """Anchors kept from each level to the next coarser one, finest first (§1.11.6)."""
    steps: Steps = 10_000
    """Steps of each coarser level."""
    selection: Literal["controller", "lambda"] = "controller"
    """Steer λ_s to the keep ratio (ours), or fixed λ_s (paper)."""
    sparsity: Annotated[
        tuple[Annotated[float, Meta(ge=0, le=1000)], ...], Meta(min_length=1, max_length=16)
    ] = (2e-3, 4e-3, 8e-3)
    """λ_s per step down, finest first, in mean form; start values of the controller (§1.11.5).
    Further steps down take the last."""
    group_weight: NotNegative = 0.01
    """λ_group (paper; nearly inert, §1.11.5). Our presets have 3."""
    ablation: Literal["full", "base", "lad", "cbm", "lad-frozen"] = "full"
    """Parts that adapt per level (§1.12)."""
    resolution: Literal["own", "full"] = "own"
    """Levels train at 1/2, 1/4, 1/8 of the training resolution, or at that itself (§1.11.1)."""

    @property
    def count(self) -> int:
        """Levels in all."""
        return len(self.keep) + 1

    @property
    def tied(self) -> bool:
        """Levels have heads of their own."""
        return False

    @property
    def level_bytes(self) -> tuple[int, ...]:
        """Sizes cannot be ordered."""
        return ()


Levels: TypeAlias = Joint | Sequential
LEVELS: dict[str, type[Joint] | type[Sequential]] = {"joint": Joint, "sequential": Sequential}
"""Ways of making levels, by `mode`."""


@dataclass(frozen=True)
class Config:
    """All settings that decide the result of a training, given a scene."""

    scale: Annotated[float, Meta(ge=1, le=65_536)] = 1.0
    """Photos are divided by this: the training resolution."""
    split: Split = "every8"
    """Rule that chooses the held-out photos."""
    model: ModelConfig = field(default_factory=ModelConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    levels: Levels = field(default_factory=Sequential)


def level_scale(config: Config, level: int) -> float:
    """Photos are divided by this where a level is trained on its own (§1.11.1)."""
    levels = config.levels
    if isinstance(levels, Joint) or levels.resolution == "full":
        return config.scale
    return config.scale * 2 ** (levels.count - 1 - level)


def total_steps(config: Config) -> int:
    """Training steps of all phases."""
    levels = config.levels
    coarser = 1 if isinstance(levels, Joint) else len(levels.keep)
    return config.train.steps + coarser * levels.steps
