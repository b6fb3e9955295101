"""The paper's preset at length on one scene: docs/results/quality.md.

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

from benchmarks.bench import RESULTS, Row, put, stored_rows, write_rows
from benchmarks.train.cells import MIB, made_by

PAGE, ROWS = RESULTS / "quality.md", RESULTS / "paper.csv"
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


def text_of(rows: Sequence[Row]) -> str:
    """Levels side by side."""

    def each(form: str, name: str, unit: float = 1) -> str:
        return " / ".join(f"{row[name] / unit:{form}}" for row in rows)

    total = sum(r["minutes"] for r in rows)
    share = sum(r["minutes"] for r in rows[:-1]) / total
    last = rows[-1]
    return (
        f"{last['scene']}, {last['width_own']} × {last['height_own']}, levels 0 to 3: "
        f"{each('.2f', 'psnr_own')} dB at their own sizes, {each('.2f', 'psnr_full')} dB at full "
        f"size, in {each('.2f', 'bytes_compact', MIB)} MiB packed "
        f"({each('.2f', 'bytes_paper', MIB)} MiB as the paper counts). "
        f"{last['test_photos']} test photos, seed {last['seed']}; unfolding takes {share:.0%} of "
        f"{total:.0f} minutes, on one core beside other work. "
        f"{made_by(rows)}."
    )


def main() -> None:
    """Gather, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.run is not None:
        write_rows(ROWS, levels_of(options.run))
    put(PAGE, __file__, text_of(stored_rows(ROWS, TEXT)))
    print(PAGE)


if __name__ == "__main__":
    main()
