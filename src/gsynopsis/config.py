"""Settings, one frozen dataclass per room, and the presets `paper`, `ours` and `fast`.

Each field gives its unit and where its value comes from: a section of docs/methods.md (which cites
the paper and its predecessors) or "ours" and why. A preset is a short difference from the defaults,
which are the paper's values where the paper states one.
"""

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Literal, NamedTuple

from gsynopsis.errors import SettingError

GRID_RESOLUTIONS = (18, 24, 33, 44, 59, 80, 108, 148, 201, 275, 376, 514)
"""Vertices per axis of the twelve grids (§1.3, from HAC)."""


class Range(NamedTuple):
    """Which numbers a setting takes, or each number of a tuple; they are always finite.

    Attributes:
        low: Least value.
        high: Largest value; infinite if there is none.
        open: Which ends do not belong to it: "", "low" or "high".
        counts: How many numbers a tuple has, least and most.
    """

    low: float
    high: float = math.inf
    open: Literal["", "low", "high"] = ""
    counts: tuple[int, int] = (0, 16)


NOT_NEGATIVE = Range(0)
SHARE = Range(0, 1)
STEPS = Range(1, 100_000_000)
RATE = Range(0, 1000, counts=(2, 2))
Rates = Annotated[tuple[float, float], RATE]
"""Initial and final learning rate."""


@dataclass(frozen=True)
class ModelConfig:
    """The anchor model (§1.1–§1.5)."""

    feature: Literal["synopsis", "free"] = "synopsis"
    """`synopsis`: grids, codebook and residual; `free`: 32 plain values per anchor (control)."""
    fusion: Literal["mlp", "none"] = "mlp"
    """`mlp` as in the paper; `none` feeds features straight into the heads (ours, §1.5)."""
    slots: Annotated[int, Range(1, 32)] = 10
    """K, Gaussians per anchor (§1.15; 16 in `ours` and `fast`)."""
    grids: Annotated[int, Range(0, 12)] = 12
    """Hash grids, at most 12; 0 switches them off (§1.3)."""
    table_log2: Annotated[int, Range(4, 22)] = 15
    """log2 of the entries per hashed grid; 13 in `paper` (§1.3)."""
    codebook: Annotated[int, Range(0, 256)] = 256
    """Codebook rows, at most 256; 0 switches the codebook off (§1.4)."""
    codebook_dim: Annotated[int, Range(1, 1024)] = 32
    """Values per codebook row (§1.4)."""
    residual: Annotated[int, Range(0, 1024)] = 0
    """Continuous values per anchor beside grids and codebook (ours; the paper has none)."""
    hidden: Annotated[int, Range(1, 4096)] = 32
    """Hidden width of the three heads (§1.5)."""
    fuse_hidden: Annotated[int, Range(1, 4096)] = 64
    """Hidden width of the fusion MLP (§1.5)."""
    fuse_out: Annotated[int, Range(1, 4096)] = 32
    """Output width of the fusion MLP (§1.5)."""
    opacity_bias: Annotated[float, Range(-3, 3)] = 0.0
    """Added to the first biases of the opacity head, so that most slots show at the start (ours:
    half of them never did, more or less by seed; §2.6)."""
    opacity_spread: Annotated[float, Range(0, 100, "low")] = 1.0
    """Factor on the first weights and biases of the opacity head's output: slots of an anchor start
    more unlike each other (ours, §2.6)."""
    bounds: Literal["contract", "aabb"] = "contract"
    """`contract`: all of space, outer half contracted (ours, §1.3); `aabb` as in HAC."""
    voxel: Annotated[float, Range(0, 1e9)] = 0.0
    """Lattice cell, world units; 0 takes the median nearest-neighbour distance (§1.2)."""
    init_factor: Annotated[int, Range(1, 65_536)] = 16
    """Coarsest growth cell in voxels, 128 for BungeeNeRF (§1.2)."""


@dataclass(frozen=True)
class RateConfig:
    """Learning rates, initial → final, log-linear over the schedule (§1.8)."""

    offset: Rates = (0.01, 1e-4)
    """Times the scene extent."""
    scale: Rates = (0.007, 0.007)
    logits: Rates = (0.01, 1e-4)
    codebook: Rates = (0.0075, 7.5e-4)
    residual: Rates = (0.0075, 7.5e-4)
    free: Rates = (0.0075, 0.0075)
    grid: Rates = (0.005, 1e-5)
    fuse: Rates = (0.005, 1e-5)
    opacity: Rates = (0.002, 2e-5)
    cov: Rates = (0.004, 0.004)
    color: Rates = (0.008, 5e-5)
    gain: Rates = (0.005, 5e-4)
    mask: Rates = (0.01, 0.01)


@dataclass(frozen=True)
class GrowthConfig:
    """Growing and pruning (§1.9); times are fractions of the full training's steps."""

    statistics_from: Annotated[float, SHARE] = 1 / 60
    adjust_from: Annotated[float, SHARE] = 1 / 20
    until: Annotated[float, SHARE] = 0.5
    every: Annotated[int, STEPS] = 100
    """Steps between adjustments."""
    threshold: Annotated[float, NOT_NEGATIVE] = 2e-4
    """Mean gradient of the projected centre, NDC units; doubles per growth level."""
    grow_visits: Annotated[float, NOT_NEGATIVE] = 0.4
    """A slot may grow after this many visits per `every` steps (0.8 · 0.5 in Scaffold)."""
    prune_visits: Annotated[float, NOT_NEGATIVE] = 0.8
    """An anchor may be pruned after this many visits per `every` steps."""
    prune_opacity: Annotated[float, NOT_NEGATIVE] = 0.005
    """An anchor goes if its summed positive opacity per visit is below this."""
    levels: Annotated[int, Range(0, 8)] = 3
    """Growth levels with cells of init_factor, /4, /16 voxels."""
    max_anchors: Annotated[int, Range(1, 2**31 - 1)] = 1_000_000
    """No growth beyond this many anchors (ours: bounds memory)."""
    strict_scaffold: bool = False
    """Repeat Scaffold's quirk: finer growth levels only after a coarser one added anchors."""


@dataclass(frozen=True)
class TrainConfig:
    """The full model's training (§1.7–§1.10)."""

    steps: Annotated[int, STEPS] = 30_000
    seed: Annotated[int, Range(0, 2**63 - 1)] = 0
    batch: Annotated[int, Range(1, 1024)] = 1
    """Views per step, whose gradients are averaged; processes of torchrun share them (ours)."""
    ssim_weight: Annotated[float, SHARE] = 0.2
    """λ_SSIM of (1 − λ)·L1 + λ·(1 − SSIM) (paper)."""
    volume_weight: Annotated[float, NOT_NEGATIVE] = 0.001
    """λ_vol on the mean product of scales (paper)."""
    opacity_weight: Annotated[float, NOT_NEGATIVE] = 0.0
    """λ_α on the mean opacity of what is drawn, once growth has ended, so that fewer slots show
    (ours, after 3DGS-MCMC)."""
    average: Annotated[float, SHARE] = 0.0
    """Last fraction of a phase's steps over which all that moves is averaged, so that rates need
    not fall far (ours, §2.5)."""
    subpixels: Annotated[int, Range(1, 8)] = 1
    """Places along each axis of a pixel at which steps sample their photos and draw their views;
    1: their middles alone (ours, §2.7). Counts where `shifts.subpixels_of` says so."""
    checkpoint_seconds: Annotated[float, NOT_NEGATIVE] = 120.0
    """Wall time between checkpoints; at most this is lost on a power cut (ours)."""
    rates: RateConfig = field(default_factory=RateConfig)
    growth: GrowthConfig = field(default_factory=GrowthConfig)


@dataclass(frozen=True)
class LevelsConfig:
    """How levels are made (§1.11–§1.13)."""

    mode: Literal["sequential", "joint"] = "sequential"
    """`sequential`: the paper's top-down unfolding; `joint`: all levels at once (ours)."""
    keep: Annotated[tuple[float, ...], Range(0, 1, "low", (0, 7))] = (0.7, 0.5, 0.4)
    """Anchors kept from each level to the next coarser one, finest first (§1.11.6)."""
    grid_drop: Annotated[int, Range(0, 12)] = 2
    """Finest grids dropped per level (§1.11.2)."""
    steps: Annotated[int, Range(1, 10 * STEPS.high)] = 10_000
    """Steps per coarser level (sequential), or all steps after the full training (joint)."""
    selection: Literal["controller", "lambda"] = "controller"
    """Sequential: steer λ to the keep ratio (ours), or fixed λ (paper)."""
    sparsity: Annotated[tuple[float, ...], Range(0, 1000, counts=(1, 16))] = (2e-3, 4e-3, 8e-3)
    """λ_s per step down, finest first, in mean form; start values of the controller (§1.11.5).
    Further steps down take the last."""
    group_weight: Annotated[float, NOT_NEGATIVE] = 0.01
    """λ_group (paper; nearly inert, §1.11.5). Preset `ours` has 3."""
    mask_threshold: Annotated[float, SHARE] = 0.01
    """ε: a slot is live where σ(m) > ε (§1.11.4)."""
    ablation: Literal["full", "base", "lad", "cbm", "lad-frozen"] = "full"
    """Which parts adapt per level (§1.12)."""
    resolution: Literal["own", "full"] = "own"
    """Sequential levels train at 1/2, 1/4, 1/8 resolution, or at full (§1.11.1)."""
    gain: bool = False
    """Learn three scale factors per level (ours, §1.11.11)."""
    joint_rates: Annotated[float, Range(0, 1000)] = 1.0
    """Joint: factor on the rates of shared tensors after the levels split off (ours)."""
    spread: Annotated[float, SHARE] = 0.0
    """Joint: rank the coarsest level's anchors within cells, this many cells per anchor, so that no
    region goes empty; 0 ranks them by their effect alone (ours, §2.2)."""
    faint_share: Annotated[float, Range(0, 1, "high")] = 0.0
    """Joint: when the levels split off, and five times later, slots and anchors of the finest level
    go that are least worth their bytes and together have at most this share of all effect on the
    pictures, fewer of coarser levels' anchors; 0 keeps all (ours, §2.3). That of the
    presets is for 56 passes over the photos or more, see `cli.suit`."""
    together: Annotated[int, Range(1, 16)] = 2
    """Joint: different levels drawn for each step; their gradients add up (ours)."""
    always_finest: bool = False
    """Joint: the finest level is one of them in every step (ours, §2.1)."""
    weights: Annotated[tuple[float, ...], Range(0, open="low")] = ()
    """Joint: factors on the losses of the coarsest levels, coarsest first, so that they pull less
    on what all share, or more; 1 for all others (ours, §2.1)."""
    networks: Literal["own", "common"] = "own"
    """Joint: `common` gives the networks of all levels the same matrices, which the file holds
    once; biases are each level's own (ours, §2.4). `own` as in the paper (§1.12)."""
    adapt: Annotated[float, SHARE] = 0.0
    """Joint: last fraction of the steps in which shared tensors are already frozen (ours)."""

    level_mib: Annotated[tuple[float, ...], Range(0, 2**33, "low")] = ()
    """Joint: size of the file up to each level's end, MiB, coarsest first; empty: by `keep` (ours).
    """
    coding_loss: Annotated[float, Range(0, 100)] = 0.0
    """Joint: what pictures may lose by rounding, about, dB; 0 leaves it to the coding (ours)."""
    finish: Annotated[int, Range(0, STEPS.high)] = 0
    """Steps in which each level's own parts adapt to what the packed file gives back (ours)."""

    @property
    def common_networks(self) -> bool:
        """Whether networks of all levels have the same matrices."""
        return self.mode == "joint" and self.networks == "common"

    @property
    def level_bytes(self) -> tuple[int, ...]:
        """`level_mib` in bytes."""
        return tuple(round(mib * 2**20) for mib in self.level_mib)

    @property
    def count(self) -> int:
        """Levels in all."""
        return len(self.keep) + 1


@dataclass(frozen=True)
class Config:
    """Everything that decides what a run produces, given a scene."""

    preset: Literal["fast", "ours", "paper"] = "paper"
    scale: Annotated[float, Range(1, 65_536)] = 1.0
    """Photos are divided by this before anything else."""
    split: Literal["every8", "bungee", "none"] = "every8"
    """Which photos are held out."""
    model: ModelConfig = field(default_factory=ModelConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    levels: LevelsConfig = field(default_factory=LevelsConfig)


def with_steps(config: Config, steps: int) -> Config:
    """The same preset for another number of full-training steps; levels scale along."""
    if not STEPS.low <= steps <= STEPS.high:
        raise SettingError("--steps", found=steps, expected=f"{STEPS.low:,} to {STEPS.high:,}")
    factor = steps / config.train.steps
    levels = replace(config.levels, steps=max(1, round(config.levels.steps * factor)))
    return replace(config, train=replace(config.train, steps=steps), levels=levels)


def level_scale(config: Config, level: int) -> float:
    """Photos are divided by this where a level is trained on its own (§1.11.1)."""
    levels = config.levels
    own = levels.mode == "sequential" and levels.resolution == "own"
    return config.scale * 2 ** (levels.count - 1 - level) if own else config.scale


def total_steps(config: Config) -> int:
    """Training steps of all phases."""
    coarser = 1 if config.levels.mode == "joint" else len(config.levels.keep)
    return config.train.steps + coarser * config.levels.steps + config.levels.finish


def config_to_json(config: Config) -> str:
    """Canonical JSON of all settings; equal text means equal settings."""
    return json.dumps(asdict(config), sort_keys=True)


def config_digest(config: Config) -> str:
    """SHA-256 of `config_to_json`, hex."""
    return hashlib.sha256(config_to_json(config).encode()).hexdigest()


def _paper() -> Config:
    return Config(
        preset="paper",
        model=ModelConfig(table_log2=13, bounds="aabb"),
    )


_OURS_RATES = RateConfig(
    offset=(0.01, 0.002),
    scale=(0.007, 0.0028),
    residual=(0.015, 0.015),
    free=(0.015, 0.015),
    grid=(0.02, 0.006),
    opacity=(0.002, 4e-4),
    cov=(0.004, 0.0016),
    color=(0.008, 8e-4),
)
"""Rates that fall little, for the mean of the last steps settles what they leave, and that of
values per anchor not at all (§2.5). That of grids is for
`--set model.grids`: the presets have none."""
_OURS_MODEL = ModelConfig(
    fusion="none",
    slots=16,
    grids=0,
    codebook=0,
    residual=12,
    hidden=48,
    opacity_bias=0.3,
    opacity_spread=4.0,
)
"""Sixteen slots and twelve values per anchor; with rates that let values learn, neither grids nor a
codebook are worth their bytes (§1.15)."""
_OURS_LEVELS = LevelsConfig(
    mode="joint",
    spread=0.125,
    faint_share=0.0036,
    together=3,
    always_finest=True,
    networks="common",
    weights=(0.6, 0.8, 1.1),
    coding_loss=0.1,
    group_weight=3.0,
    gain=True,
)
_OURS_TRAIN = TrainConfig(rates=_OURS_RATES, opacity_weight=0.01, average=0.15, subpixels=2)


def _ours() -> Config:
    return Config(
        preset="ours",
        model=_OURS_MODEL,
        train=_OURS_TRAIN,
        levels=replace(_OURS_LEVELS, steps=15_000),
    )


def _fast() -> Config:
    growth = GrowthConfig(until=0.7, threshold=3.5e-5, grow_visits=0.1, prune_visits=0.4)
    return Config(
        preset="fast",
        model=replace(_OURS_MODEL, init_factor=40),
        train=replace(_OURS_TRAIN, steps=1_500, growth=growth),
        levels=replace(_OURS_LEVELS, steps=2_500),
    )


PRESETS = {"paper": _paper, "ours": _ours, "fast": _fast}


def preset(name: str) -> Config:
    """A preset by name.

    Raises:
        SettingError: there is no such preset.
    """
    if name not in PRESETS:
        raise SettingError("--preset", found=name, expected=" or ".join(PRESETS))
    return PRESETS[name]()
