"""The paper's preset at length on one scene: docs/results/paper.md.

    gsynopsis train SCENE --preset paper --scale 2 --out RUN
    python -m benchmarks.train.paper RUN

Copies the levels of the run into docs/results/paper.csv. Without a run the page is written again
from the CSV.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, put, stored_rows, table_of, write_rows
from benchmarks.train.cells import MIB, made_by

PAGE, ROWS = (RESULTS / f"paper.{kind}" for kind in ("md", "csv"))
TEXT = ("scene", "commit", "machine")


@dataclass(frozen=True)
class Options:
    """Options of the page.

    Attributes:
        run: Folder of the run; none: the page alone.
    """

    run: Positional[Path | None] = None


def levels_of(run: Path) -> list[Row]:
    """Levels of one run, with the minutes of the phase that made each."""
    metrics, state = (
        json.loads((run / f"{n}.json").read_text("utf-8")) for n in ("metrics", "run")
    )
    seconds, last = state["phase_seconds"], len(metrics["levels"]) - 1
    names = ("anchors", "slots", "psnr_own", "psnr_full", "ssim_own", "flip_own")
    return [
        {
            "scene": metrics["scene"],
            "level": level["level"],
            **{name: level[name] for name in names},
            "bytes_paper": level["bytes_paper"],
            "bytes_compact": level["bytes_compact"],
            "width_own": level["width_own"],
            "height_own": level["height_own"],
            "minutes": round(
                seconds["full" if level["level"] == last else f"unfold L{level['level']}"] / 60, 1
            ),
            "test_photos": metrics["held_out_views"],
            "seed": metrics["seed"],
            "machine": metrics["machine"]["cpu"],
            "commit": metrics["commit"][:12],
        }
        for level in metrics["levels"]
    ]


def table(rows: Sequence[Row]) -> str:
    """Level by level."""
    heads = ["level", "its size", "dB at it", "dB at full size", "MiB as the paper counts"]
    heads += ["packed, MiB", "anchors", "minutes"]
    lines = [
        [
            *(f"{r['level']}", f"{r['width_own']} × {r['height_own']}"),
            *(f"{r['psnr_own']:.2f}", f"{r['psnr_full']:.2f}"),
            *(f"{r['bytes_paper'] / MIB:.2f}", f"{r['bytes_compact'] / MIB:.2f}"),
            *(f"{r['anchors']:,}", f"{r['minutes']:.0f}"),
        ]
        for r in rows
    ]
    total = sum(r["minutes"] for r in rows)
    share = sum(r["minutes"] for r in rows[:-1]) / total
    photos, seed = rows[0]["test_photos"], rows[0]["seed"]
    return (
        f"{table_of(heads, lines)}\n\n"
        f"{photos} test photos, seed {seed}; unfolding takes {share:.0%} of {total:.0f} minutes,\n"
        "on one core of a machine whose other one worked too.\n\n"
        f"{made_by(rows)}."
    )


def main() -> None:
    """Gather, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.run is not None:
        write_rows(ROWS, levels_of(options.run))
    put(PAGE, __file__, table(stored_rows(ROWS, TEXT)))
    print(PAGE)


if __name__ == "__main__":
    main()
