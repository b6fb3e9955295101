"""What `ablations.py` compares: groups of variants, each a difference from the preset `fast`."""

from dataclasses import dataclass

from gsynopsis.config import preset

ALL = ("fox", "brighton", "bonsai")
FAST = ("--preset", "fast")


@dataclass(frozen=True)
class Group:
    """Variants that are compared with each other.

    Attributes:
        name: Short, for folders and the CSV.
        title: Heading.
        text: What is compared, Markdown.
        variants: Options of each variant, beside `common`.
        common: Options of all.
        scenes: Which scenes.
        scale: Photos are divided by this.
        seeds: Which seeds.
        curves: Whether rate and distortion of the levels are drawn.
    """

    name: str
    title: str
    text: str
    variants: dict[str, str]
    common: tuple[str, ...] = FAST
    scenes: tuple[str, ...] = ALL
    scale: float = 4
    seeds: tuple[int, ...] = (0, 1, 2)
    curves: bool = False


EVEN = "--set model.opacity_bias=0 model.opacity_spread=1"
"""Opacity heads that start as all others do: half of the slots show, more or less by seed."""
FOUR = "--set model.grids=4 model.table_log2=11 levels.grid_drop=1"
"""The four coarsest grids beside the values; every level below the finest drops one."""
EARLIER = f"{EVEN} {FOUR}"
"""What the preset was before; groups that it is common to were run with it."""
SMALL = (*FAST, "--steps", "600")
"""1,600 steps in all."""
EARLIER_SMALL = (*SMALL, *EARLIER.split())
"""The same of the earlier preset."""
ALL_SLOTS = "--set levels.faint_share=0"
"""No slot goes for being faint."""
FREE = f"--feature free {ALL_SLOTS}"
THREE = "--set levels.together=3"
"""Three levels a step instead of two."""
TWELVE = "--set model.grids=12 levels.grid_drop=2"
"""All twelve grids, as in the paper."""
GRIDS = f"{TWELVE} model.residual=0"
PAPER = f"{GRIDS} model.codebook=256"
SEQUENTIAL = "--levels sequential --set levels.steps=833 train.steps=1500"
"""As many steps as joint: 1,500 and three times 833."""
CONTENDERS = {
    "ours": "",
    "free, all slots": FREE,
    "earlier": EARLIER,
    "earlier, no grids": EVEN,
    "earlier, all slots": f"{EARLIER} {ALL_SLOTS}",
    "earlier, free, all slots": f"{FREE} {EVEN}",
}
"""Ours and plain features, of the preset as it is and as it was."""
NO_MEAN = "--set train.average=0"
RATES = preset("fast").train.rates


def ending(**last: float) -> str:
    """Settings by which rates of the preset end elsewhere."""

    def plain(rate: float) -> str:
        return f"{rate:.6f}".rstrip("0")

    first = {name: getattr(RATES, name)[0] for name in last}
    return " ".join(f"train.rates.{n}=[{plain(first[n])},{plain(last[n])}]" for n in last)


FALLING = ending(offset=1e-4, scale=7e-4, grid=2e-4, opacity=2e-5, cov=4e-4, color=5e-5)
SETTLING = ending(residual=0.0015)
CONSTANT = ending(
    **{n: getattr(RATES, n)[0] for n in ("offset", "scale", "grid", "opacity", "cov", "color")}
)

GROUPS = (
    Group(
        name="control",
        title="Against plain features",
        text="Preset `fast` as it is (*ours*: 12 values per anchor, faint slots dropped) and with "
        "32 of them (*free*: `--feature free`), 4,000 steps in all, packed the same way. *All "
        "slots* keeps faint ones. *Earlier*: with opacity heads that start as all others do, so "
        "that half of the slots show at first, and with the four coarsest grids beside the values "
        "unless it says otherwise; *three* trains three levels a step instead of two (preset "
        "`ours`).",
        variants={
            **CONTENDERS,
            "earlier, twelve grids": f"{EARLIER} {TWELVE}",
            "earlier, three": f"{EARLIER} {THREE}",
        },
    ),
    Group(
        name="length",
        title="Training length",
        text="The same for 2,400, 8,000 and 30,000 steps in all, fox.",
        variants={
            f"{name}, {steps}": f"--steps {full} {options}".strip()
            for steps, full in (("2,400", 900), ("8,000", 3000), ("30,000", 11_250))
            for name, options in {
                **CONTENDERS,
                "earlier, no grids, all slots": f"{EVEN} {ALL_SLOTS}",
                "earlier, 24 values": f"{EARLIER} model.residual=24",
            }.items()
        },
        scenes=("fox",),
    ),
    Group(
        name="grids",
        title="Grids or none",
        text="Beside twelve values, 2,400 steps in all.",
        common=(*FAST, "--steps", "900"),
        variants={"ours": "", "four grids": FOUR},
    ),
    Group(
        name="levels",
        title="How levels are made",
        text="*joint* trains all levels together from the 1,500th step on, two of them, drawn at "
        "random, in each step; *joint, three* three of them; *sequential* is the "
        "paper's top-down unfolding of the full model, each level at its own resolution; "
        "*sequential, full* the same at full resolution; *alone* spends all 4,000 steps on the "
        "finest level. With the earlier preset.",
        common=(*FAST, *EARLIER.split()),
        variants={
            "joint": "",
            "sequential": SEQUENTIAL,
            "sequential, full": SEQUENTIAL + ' levels.resolution="full"',
            "joint, three": THREE,
            "joint, all slots": ALL_SLOTS,
            "alone": "--set levels.keep=[]",
            "alone, all slots": f"{ALL_SLOTS} levels.keep=[]",
        },
        seeds=(0,),
        curves=True,
    ),
    Group(
        name="features",
        title="Where quality comes from",
        text="One part at a time, at an eighth of the photos' size, 1,600 steps in all, with "
        "the earlier preset.",
        common=EARLIER_SMALL,
        scale=8,
        variants={
            "free": "--feature free",
            "earlier": "",
            "values alone": "--set model.grids=0",
            "twelve grids": TWELVE,
            "16 values, twelve grids": f"{TWELVE} model.residual=16",
            "four grids alone": "--set model.residual=0",
            "twelve grids alone": GRIDS,
            "codebook alone": "--set model.residual=0 model.grids=0 model.codebook=256",
            "grids and codebook": PAPER,
            "grids and codebook, fusion": f"--fusion mlp {PAPER}",
            "earlier and codebook": "--set model.codebook=256",
        },
    ),
    Group(
        name="tables",
        title="Size of the grids",
        text="Rows of every hashed grid, and no values beside them.",
        common=SMALL,
        scale=8,
        scenes=("fox",),
        variants={
            f"2^{power}": f"{GRIDS} model.table_log2={power}" for power in (9, 11, 13, 15, 17, 19)
        },
    ),
    Group(
        name="widths",
        title="Values per anchor and width of the heads",
        text="Everything else as in the preset.",
        common=SMALL,
        scale=8,
        scenes=("fox", "bonsai"),
        variants={
            f"{values} values, {width} wide": f"--set model.residual={values} model.hidden={width}"
            for values in (4, 8, 16)
            for width in (32, 64)
        },
    ),
    Group(
        name="rates",
        title="Learning rates",
        text="*Preset*: rates fall to a fifth or less, that of the values per anchor not at all, "
        "and the last 15 % of the steps are averaged. *Falling* rates end where 3D Gaussian "
        "splatting has them. With the earlier preset.",
        common=EARLIER_SMALL,
        scale=8,
        scenes=("fox",),
        variants={
            "preset": "",
            "preset, no mean": NO_MEAN,
            "falling": f"--set {FALLING}",
            "falling, no mean": f"{NO_MEAN} {FALLING}",
            "falling, values too, no mean": f"{NO_MEAN} {FALLING} {SETTLING}",
            "values 0.0075": "--set train.rates.residual=[0.0075,0.0075]",
            "values 0.03": "--set train.rates.residual=[0.03,0.03]",
            "nothing falls": f"--set {CONSTANT}",
        },
    ),
    Group(
        name="slots",
        title="Slots that show",
        text="A push on opacity once growth has ended, and the share of blend weight whose "
        "faintest slots go, three times.",
        common=SMALL,
        scale=8,
        scenes=("fox", "bonsai"),
        variants={
            **{
                f"λ = {weight:g}": f"--set train.opacity_weight={weight:g}"
                for weight in (0.0, 0.01, 0.03, 0.1)
            },
            **{
                f"{share:.0%}": f"--set levels.faint_share={share:g}"
                for share in (0.0, 0.01, 0.02, 0.05)
            },
        },
    ),
)
