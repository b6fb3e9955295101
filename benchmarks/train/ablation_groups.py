"""What `ablations.py` compares: groups of variants, each a difference from the preset `fast`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Asked = Mapping[str, Any]
"""Settings by dotted name."""
ALL = ("fox", "brighton", "bonsai")


@dataclass(frozen=True)
class Group:
    """Variants that are compared with each other.

    Attributes:
        name: Short, for folders and the CSV.
        title: Heading.
        text: What is compared, Markdown.
        variants: Settings of each variant, beside `common`; empty for runs of an earlier preset,
            which today's settings would not repeat: their rows stay in the CSV with their commit.
        common: Settings of all.
        scenes: Which scenes.
        scale: Photos are divided by this.
        seeds: Which seeds.
        curves: Whether rate and distortion of the levels are drawn.
    """

    name: str
    title: str
    text: str
    variants: Mapping[str, Asked] = field(default_factory=dict[str, Asked])
    common: Asked = field(default_factory=dict[str, Any])
    scenes: tuple[str, ...] = ALL
    scale: float = 4
    seeds: tuple[int, ...] = (0, 1, 2)
    curves: bool = False


def words_of(asked: Asked) -> list[str]:
    """The options of a command line that give these settings."""
    told = [f"{name}={_text(value)}" for name, value in asked.items()]
    return ["--preset", PRESET, *(["--set", *told] if told else [])]


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


PRESET = "fast"
"""Of all runs."""
FREE: Asked = {"model.feature": "free", "levels.prune_share": 0}
SCAFFOLD: Asked = {
    **FREE,
    "train.growth.threshold": 0.0002,
    "train.growth.cell": 16,
    "model.slots": 10,
}
CONTROL: Asked = {**SCAFFOLD, "levels.weights": "separate"}
CONTENDERS: dict[str, Asked] = {
    "ours": {},
    "free, all slots": CONTROL,
    "free, all slots, common networks": SCAFFOLD,
    "free, all slots, more growth": {**FREE, "levels.weights": "separate"},
}
"""Ours and plain features, these as in Scaffold, or with networks or growth as ours."""
SEQUENTIAL: Asked = {"levels.mode": "sequential", "levels.steps": 833, "train.steps": 1500}
"""As many steps as joint: 1,500 and three times 833."""

GROUPS = (
    Group(
        name="control",
        title="Against plain features",
        text="Preset `fast` as is (*ours*: 12 values per anchor, slots pruned by effect per byte)"
        " and with 32 of them and all slots (*free, all slots*: `--feature free`), 4,000 steps in "
        "all, packed the same way. The control has ten slots per anchor and grows as in Scaffold, "
        "in cells of 16 voxels by a threshold of 2e-4, and has networks of each level's own, or "
        "takes the one or the other from the preset (*more growth*, *common networks*).",
        variants=CONTENDERS,
        curves=True,
    ),
    Group(
        name="length",
        title="Training length",
        text="The same for 2,400, 8,000 and 30,000 steps in all, fox.",
        variants={
            f"{name}, {steps}": {"train.steps": full, **asked}
            for steps, full in (("2,400", 900), ("8,000", 3000), ("30,000", 11_250))
            for name, asked in CONTENDERS.items()
        },
        scenes=("fox",),
    ),
    Group(
        name="levels",
        title="How levels are made",
        text="*joint* trains all levels together from the 1,500th step on: in each step the finest "
        "and two others; *alike* draws all three at random; *sequential* is the paper's top-down "
        "unfolding of the full model, each level at its own resolution; *alone* spends all 4,000 "
        "steps on the finest level.",
        variants={
            "joint": {},
            "joint, alike": {"levels.always_finest": False},
            "sequential": SEQUENTIAL,
            "alone": {"levels.keep": []},
        },
        seeds=(0,),
        curves=True,
    ),
    Group(
        name="choices",
        title="What the preset's choices are worth",
        text="Each taken back, 2,400 steps in all.",
        common={"train.steps": 900},
        variants={
            "ours": {},
            "all slots": {"levels.prune_share": 0},
            "levels drawn alike": {"levels.always_finest": False},
            "two levels a step": {"levels.levels_per_step": 2},
            "growth as in Scaffold": {"train.growth.threshold": 0.0002},
            "networks of each level's own": {"levels.weights": "separate"},
            "opacity spread 2": {"model.opacity_init_scale": 2},
            "8 values": {"model.residual": 8},
            "16 values": {"model.residual": 16},
            "four grids": {
                "model.grids": 4,
                "model.table_log2": 11,
                "levels.weights": "separate",
            },
        },
        scenes=("fox",),
    ),
    Group(
        name="control-earlier",
        title="Earlier: against plain features",
        text="With slots and anchors ranked by blend weight, levels drawn alike, growth as in "
        "Scaffold. *Earlier*: with opacity heads that start as all others do, and with the four "
        "coarsest grids beside the values unless it says otherwise; *three* trains three levels a "
        "step instead of two.",
    ),
    Group(
        name="length-earlier",
        title="Earlier: training length",
        text="The same for 2,400, 8,000 and 30,000 steps in all.",
    ),
    Group(
        name="grids",
        title="Earlier: grids or none",
        text="Beside twelve values, 2,400 steps in all.",
    ),
    Group(
        name="levels-earlier",
        title="Earlier: how levels are made",
        text="With four grids and opacity heads that start as all others do; *joint* draws two "
        "levels of each step at random, *joint, three* three.",
        curves=True,
    ),
    Group(
        name="features",
        title="Earlier: where quality comes from",
        text="One part at a time, at an eighth of the photos' size, 1,600 steps in all, with four "
        "grids and opacity heads that start as all others do.",
        scale=8,
    ),
    Group(
        name="rates",
        title="Earlier: learning rates",
        text="*Preset*: rates fall to a fifth or less, that of the values per anchor not at all, "
        "and the last 15 % of the steps are averaged. *Falling* rates end where 3D Gaussian "
        "splatting has them. At an eighth of the photos' size, 1,600 steps in all, four grids.",
        scale=8,
    ),
)
