"""What `ablations.py` compares: groups of variants, each a difference from the preset `fast`."""

from dataclasses import dataclass, field

ALL = ("fox", "brighton", "bonsai")


@dataclass(frozen=True)
class Group:
    """Variants that are compared with each other.

    Attributes:
        name: Short, for folders and the CSV.
        title: Heading.
        text: What is compared, Markdown.
        variants: Options of each variant, beside `common`; empty for runs of an earlier preset,
            which today's options would not repeat: their rows stay in the CSV with their commit.
        common: Options of all.
        scenes: Which scenes.
        scale: Photos are divided by this.
        seeds: Which seeds.
        curves: Whether rate and distortion of the levels are drawn.
    """

    name: str
    title: str
    text: str
    variants: dict[str, str] = field(default_factory=dict[str, str])
    common: tuple[str, ...] = ("--preset", "fast")
    scenes: tuple[str, ...] = ALL
    scale: float = 4
    seeds: tuple[int, ...] = (0, 1, 2)
    curves: bool = False


FREE = "--feature free --set levels.faint_share=0"
SCAFFOLD = f"{FREE} train.growth.threshold=0.0002 model.init_factor=16 model.slots=10"
CONTROL = f"{SCAFFOLD} levels.networks=own"
CONTENDERS = {
    "ours": "",
    "free, all slots": CONTROL,
    "free, all slots, common networks": SCAFFOLD,
    "free, all slots, more growth": f"{FREE} levels.networks=own",
}
"""Ours and plain features, these as in Scaffold, or with networks or growth as ours."""
SEQUENTIAL = "--levels sequential --set levels.steps=833 train.steps=1500"
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
            f"{name}, {steps}": f"--steps {full} {options}".strip()
            for steps, full in (("2,400", 900), ("8,000", 3000), ("30,000", 11_250))
            for name, options in CONTENDERS.items()
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
            "joint": "",
            "joint, alike": "--set levels.always_finest=false",
            "sequential": SEQUENTIAL,
            "alone": "--set levels.keep=[]",
        },
        seeds=(0,),
        curves=True,
    ),
    Group(
        name="choices",
        title="What the preset's choices are worth",
        text="Each taken back, 2,400 steps in all.",
        common=("--preset", "fast", "--steps", "900"),
        variants={
            "ours": "",
            "all slots": "--set levels.faint_share=0",
            "levels drawn alike": "--set levels.always_finest=false",
            "two levels a step": "--set levels.together=2",
            "growth as in Scaffold": "--set train.growth.threshold=0.0002",
            "networks of each level's own": "--set levels.networks=own",
            "opacity spread 2": "--set model.opacity_spread=2",
            "8 values": "--set model.residual=8",
            "16 values": "--set model.residual=16",
            "four grids": "--set model.grids=4 model.table_log2=11 levels.grid_drop=1 "
            "levels.networks=own",
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
