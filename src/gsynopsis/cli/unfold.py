"""`gsynopsis unfold`: make the levels anew from a run's full model."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from gsynopsis.cli.bounds import Backend, with_training
from gsynopsis.cli.flags import Changes, asked_of
from gsynopsis.cli.train import print_report


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
        with with_training():
            from gsynopsis.jobs.train import Conduct, unfold_into
            from gsynopsis.monitor.display import Display
        asked = asked_of(self.overrides)
        if "train.steps" in asked:
            asked["levels.steps"] = asked.pop("train.steps")
        conduct = Conduct(renderer=self.renderer, evaluate=self.evaluate)
        with Display(quiet=self.quiet) as display:
            report = unfold_into(self.run_path, self.out, asked, display, conduct=conduct)
        print_report(report, self.out, as_json=self.json)
        return 0
