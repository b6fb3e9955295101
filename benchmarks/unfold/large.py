"""A file of more than ten million splats from its input to a browser: time and memory of each step.

    python -m benchmarks.unfold.large OUT lod-meta.json

`gsynopsis import` in a process of its own (not again where OUT/large.gsyn is there); then the page
of `gsynopsis serve` in a new Chromium over a recorded 4G line until its first picture
(benchmarks/viewer/first_picture.py), and over a fast one until nothing changes any more
(benchmarks/viewer/size.mjs), with the viewer's own budget of splats, and then along a spiral
through the scene, where blocks have to make room for others. Writes large.json into OUT.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from statistics import median

import numpy as np
import torch

from benchmarks.bench import TRACES
from benchmarks.viewer.browser import MISSING
from benchmarks.viewer.first_picture import Options as Newcomer
from benchmarks.viewer.first_picture import look
from benchmarks.viewer.size import Options as Visit
from benchmarks.viewer.size import visited
from gsynopsis.container.info import describe
from gsynopsis.container.reader import read_gsyn
from gsynopsis.evaluation.environment import this_build, this_machine, usable_cores
from gsynopsis.formats.axes import parse_up
from gsynopsis.model.splats import plain_level
from gsynopsis.scene.camera import across

NAME, DONE = "large.gsyn", "import.json"
BUDGET = 2_000_000
"""Splats that the viewer draws at most: of it, without a word of the page."""
STOPS = 16
"""Stops of the flight."""


def imported(source: Path, out: Path) -> dict[str, object]:
    """Figures of the import, made anew or as they were noted."""
    done = out / DONE
    if not done.exists():
        before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        words = [
            "import",
            str(source),
            "--out",
            str(out / NAME),
            "--json",
            "--quiet",
            "--overwrite",
        ]
        said = subprocess.run(
            [sys.executable, "-m", "gsynopsis", *words], check=True, stdout=subprocess.PIPE
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        done.write_text(
            json.dumps(
                {
                    "seconds": round(time.monotonic() - started),
                    "processor_seconds": round(processor),
                    "peak_mib": round(after.ru_maxrss / 1024),
                    "commit": this_build().commit,
                    "said": json.loads(said.stdout),
                }
            )
        )
    return json.loads(done.read_text())


def spiral(file: Path) -> list[list[list[float]]]:
    """Positions and targets of a flight from the middle outwards, a little above the ground."""
    levels = read_gsyn(file, 0)
    base = plain_level(levels, 0).means.astype(np.float64)
    up = np.array(parse_up(levels.meta["up"]))
    side = np.cross(up, across(np.zeros(3), up))
    axes = np.stack([side, np.cross(up, side)])
    low, middle, high = (np.quantile(base @ axes.T, q, axis=0) for q in (0.1, 0.5, 0.9))
    height = np.quantile(base @ up, 0.7) * up
    angles = np.linspace(0, 4 * np.pi, STOPS)
    reach = np.linspace(0.1, 0.9, STOPS)[:, None] * (high - low) / 2
    flat = middle + reach * np.stack([np.cos(angles), np.sin(angles)], 1)
    places = flat @ axes + height
    ahead = np.vstack([places[1:], 2 * places[-1:] - places[-2:-1]])
    return [[place.tolist(), target.tolist()] for place, target in zip(places, ahead, strict=True)]


def main() -> None:
    """Import, then visit."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("source", type=Path)
    parser.add_argument("--trace", type=Path, default=TRACES / "4g_slow.csv")
    parser.add_argument("--visits", type=int, default=3)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, object] = {"import": imported(args.source, args.out)}
    file = args.out / NAME
    found["levels"] = [asdict(level) for level in describe(file).levels]
    if MISSING:
        sys.exit(f"no {MISSING}: no browser was measured")
    newcomer = Newcomer([], trace=args.trace, whole=False)
    with tempfile.TemporaryDirectory() as folder:
        looks = [look(file, newcomer, Path(folder)) for _ in range(args.visits)]
    found["trace"] = args.trace.name
    # A base that is on the screen before a first picture was looked for is one.
    found["first picture, ms"] = [
        round(each["first picture"] or each["base on screen"]) for each in looks
    ]
    stops = spiral(file)
    found["visit"] = visited(Visit(budget=BUDGET, out=args.out), "ours", file, (), stops)
    found["machine"] = f"{this_machine(torch.device('cpu')).cpu}, {usable_cores()} cores"
    found["commit"] = this_build().commit
    (args.out / "large.json").write_text(json.dumps(found, indent=1))
    first = median(found["first picture, ms"])  # type: ignore[arg-type]
    print(f"first picture after {first / 1000:.1f} s; all is in {args.out / 'large.json'}")


if __name__ == "__main__":
    main()
