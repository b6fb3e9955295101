"""`python -m research SUITE`: scenes × methods × seeds of a suite, as CSV and one page."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from gsynopsis.cli import run_safely
from gsynopsis.cli.bounds import bounded, with_training
from gsynopsis.cli.defaults import said

PROCESSES = (1, 256)


@dataclass(frozen=True)
class Bench:
    """Train and compare all methods of a suite on all its scenes; finished cells are kept.

    Attributes:
        suite: A TOML file with scenes, methods and seeds, as suites/small.toml.
        out: Folder for the cells, results.csv and results.html.
        jobs: Cells at once, each a process; side by side they say little about time.
        ray: Run the cells on the Ray cluster of this address instead (extra `ray`), or `local`.
        scenes: Folder in which procedural scenes are made once.
        data: Folder that the paths of the suite's other scenes are relative to.
        only: Names of the scenes to take, of all in the suite.
        seeds: Seeds to take, of all in the suite.
        lpips: Weights of LPIPS, which is measured then, see `gsynopsis evaluate --help`.
        quiet: No progress.
    """

    suite: Positional[Path]
    out: Annotated[Path | None, said("runs/NAME of the suite")] = None
    jobs: int = 1
    ray: Annotated[str | None, said("none, this machine")] = None
    scenes: Path = Path("runs/procedural")
    data: Annotated[Path | None, said("the suite's")] = None
    only: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    lpips: Annotated[Path | None, said("none")] = None
    quiet: bool = False

    def run(self) -> int:
        """Check the suite, run its cells, write, name what failed."""
        bounded("--jobs", self.jobs, *PROCESSES)
        with with_training():
            from gsynopsis.monitor.display import ticking
            from research.suites.run_suite import Places, run_suite
            from research.suites.suite import read_suite
        suite = read_suite(self.suite, self.data, self.only, self.seeds, self.lpips)
        places = Places(self.out or Path("runs") / self.suite.stem, self.scenes)
        with ticking("cells", quiet=self.quiet) as tick:
            found = run_suite(
                suite, self.suite.stem, places, jobs=self.jobs, ray=self.ray, tick=tick
            )
        print("\n".join(map(str, found.files)))
        for line in found.failed:
            print(f"gsynopsis: {line}", file=sys.stderr)
        return 2 if found.failed else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a suite; what a user can cause becomes one line and an exit code.

    Args:
        arguments: Words after `python -m research`; those of the process if None.
    """
    return run_safely(lambda: tyro.cli(Bench, prog="python -m research", args=arguments))


if __name__ == "__main__":
    sys.exit(main())
