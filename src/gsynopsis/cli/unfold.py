"""`gsynopsis unfold`: make other levels from a run's full model."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from gsynopsis.cli.bounds import Backend, with_training
from gsynopsis.cli.flags import Changes, asked_of
from gsynopsis.cli.report import print_report


@dataclass(frozen=True)
class Unfold:
    """Make levels another way from the full model of a run, without training that again.

    Attributes:
        run_path: Folder of a run whose full model is trained.
        out: Folder of the new run.
        overrides: What to change; only settings of levels may differ from the old run's. `--steps`
            are those of the levels here.
        renderer: Rasteriser; auto takes CUDA if it is there, else the CPU one.
        evaluate: Write the report of an evaluation on the held-out views beside the file.
        json: Print metrics.json instead of the table.
        quiet: Say nothing on the way.
    """

    run_path: Positional[Path]
    out: Path
    overrides: Annotated[Changes, arg(name="")] = field(default_factory=Changes)
    renderer: Backend = "auto"
    evaluate: bool = True
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Copy the full model's state, go on from there."""
        asked = asked_of(self.overrides)
        if "train.steps" in asked:
            asked["levels.steps"] = asked.pop("train.steps")
        with with_training():
            from gsynopsis.jobs.unfold import unfold
        run = unfold(
            self.run_path,
            self.out,
            asked,
            renderer=self.renderer,
            evaluate=self.evaluate,
            quiet=self.quiet,
        )
        print_report(run.report, self.out, as_json=self.json)
        return 0
