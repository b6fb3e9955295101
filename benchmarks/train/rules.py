"""Each rule by which settings follow a scene, where it acts, against the preset's own value.

    python -m benchmarks.train.rules

Trains each scene with all rules, and once more for each rule that changes something there with that
rule undone. All by validation photos; runs go on where they were ended. Rows go into
docs/results/rules.csv, a table into ablations.md.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

import benchmarks.bench as bench
from benchmarks.bench import DATA, RESULTS, Row, machine, metrics_of, put, short_commit, table_of
from benchmarks.unfold.cameras import folder_of
from gsynopsis.config import Recipe, preset_value
from gsynopsis.jobs.resolve import resolve
from gsynopsis.scene.load import load_scene
from research.suites.bdrate import Points, bd_psnr

RUNS = bench.RUNS / "rules"
PAGE, CSV = RESULTS / "ablations.md", RESULTS / "rules.csv"
TEXT = ("key", "rule", "scene", "with", "without", "cpu", "commit")
RULES: dict[str, tuple[str, ...]] = {
    "few photos: fewer slots, more alike": ("model.slots", "model.opacity_init_scale"),
    "few photos: higher growth threshold": ("train.growth.threshold",),
    "few photos: short growth, dropout": ("train.growth.until", "train.dropout"),
    "few points: narrow heads": ("model.hidden",),
    "few points or photos: finer growth": ("train.growth.cell",),
    "few passes: less pruning": ("levels.prune_share",),
    "many passes: finer rounding": ("levels.coding_loss",),
    "many photos: two levels a step": (
        "levels.levels_per_step",
        "levels.loss_weights",
        "levels.steps",
    ),
    "lattice by the photos' pixels": ("model.voxel",),
    "large photos begin reduced, many have more steps": ("train.reduced_until", "train.steps"),
}
"""Settings that each rule moves; together all that can follow a scene."""


@dataclass(frozen=True)
class Options:
    """Options of the comparison.

    Attributes:
        data: Folder that holds the captured scenes.
        scenes: Captured ones as NAME/SCALE, others procedural.
        rules: Rules to undo, by the beginnings of their names; empty: all.
        seed: Of all trainings.
    """

    data: Path = DATA
    scenes: tuple[str, ...] = (
        "fox/4",
        "brighton/4",
        "bonsai/4",
        "indoor",
        "outdoor",
        "object",
        "few",
    )
    rules: tuple[str, ...] = ()
    seed: int = 0


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    for scene in options.scenes:
        name, _, scale = scene.partition("/")
        folder = folder_of(name, options.data, bench.RUNS / "procedural")
        asked = {"scale": float(scale or 1), "split": "validation", "train.seed": options.seed}
        recipe = resolve("standard", load_scene(folder, "validation"), asked)
        for rule, undone in undone_rules(recipe):
            if options.rules and not rule.startswith(options.rules):
                continue
            on = curve_of(folder, RUNS / slug(scene, options.seed, "all rules"), asked)
            off = curve_of(folder, RUNS / slug(scene, options.seed, rule), {**asked, **undone})
            row = row_of(rule, scene, options.seed, on, off)
            bench.put_row(CSV, {"key": f"{rule}, {scene}, {options.seed}"} | row, TEXT)
            print(row)
    rows = bench.stored_rows(CSV, TEXT)
    put(PAGE, __file__, text_of(rows))
    print(f"wrote {CSV} and {PAGE}")


def undone_rules(recipe: Recipe) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Rules that change something in a recipe, with the preset's values of what they move."""
    for rule, names in RULES.items():
        moved = [name for name in names if name in recipe.followed]
        if moved:
            yield rule, {name: preset_value(name, recipe.preset) for name in moved}


def curve_of(folder: Path, out: Path, asked: Mapping[str, Any]) -> Points:
    """Bytes and dB of each level of a training, which is made if it is missing."""
    if not metrics_of(out):
        bench.train(folder, out, {"train.exposure": "off", **asked}, photo_pixels=0)
    levels = metrics_of(out)["levels"]
    return [(level["bytes_compact"], level["psnr_full"]) for level in levels]


def row_of(rule: str, scene: str, seed: int, on: Points, off: Points) -> Row:
    """Both curves as text, and what the rule brings at equal bytes and at the finest level, dB."""
    gain = bd_psnr(off, on)
    return {
        "rule": rule,
        "scene": scene,
        "seed": seed,
        "dB at equal bytes": "" if gain is None else round(gain, 2),
        "dB at the end": round(on[-1][1] - off[-1][1], 2),
        "bytes at the end": round(on[-1][0] / off[-1][0], 3),
        "with": curve_text(on),
        "without": curve_text(off),
        "cpu": machine().cpu,
        "commit": short_commit(),
    }


def curve_text(points: Points) -> str:
    """Curves as `30.35/0.071 33.51/0.253`: dB and MiB of each level."""
    return " ".join(f"{psnr:.2f}/{size / 2**20:.3f}" for size, psnr in points)


def slug(scene: str, seed: int, name: str) -> str:
    """Folder of a run."""
    words = re.findall(r"\w+", f"{scene} {name}")
    return "-".join([*words, str(seed)])


def text_of(rows: list[Row]) -> str:
    """A line for each rule: on which scenes it acts, and what it brought there."""
    lines: list[list[str]] = []
    for rule in dict.fromkeys(row["rule"] for row in rows):
        own = [row for row in rows if row["rule"] == rule]
        cells = [
            f"{row['scene']} {signed(row['dB at equal bytes'])}"
            + f" ({row['bytes at the end']:.2f}×, {row['dB at the end']:+.2f})"
            for row in own
        ]
        lines.append([rule, ", ".join(cells)])
    return table_of(["rule", "dB at equal bytes (the finest level: bytes, dB)"], lines)


def signed(gain: float | str) -> str:
    """A gain with its sign; curves that share no bytes have none."""
    return "n/a" if isinstance(gain, str) else f"{gain:+.2f}"


if __name__ == "__main__":
    main()
