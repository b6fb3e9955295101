"""`gsynopsis unfold`: make the levels anew from a run's full model."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional

from gsynopsis.cli.defaults import said
from gsynopsis.cli.estimate import Estimate, phase_costs
from gsynopsis.cli.opening import Backend
from gsynopsis.cli.progress import Display
from gsynopsis.cli.run_folder import read_record
from gsynopsis.cli.settings import Overrides, apply_overrides, replaced
from gsynopsis.cli.training import (
    evaluate_run,
    new_trainer,
    recorded_config,
    train_into,
    training_world,
)
from gsynopsis.config import Config
from gsynopsis.errors import SettingError

KEPT = said("the run's")


@dataclass(frozen=True)
class Changes(Overrides):
    """What a command line may change of a run; None keeps the run's value.

    Attributes:
        steps: Steps of each coarser level (sequential), or all steps of the levels (joint).
    """

    steps: Annotated[int | None, KEPT] = None
    seed: Annotated[int | None, KEPT] = None
    feature: Annotated[Literal["synopsis", "free"] | None, KEPT] = None
    fusion: Annotated[Literal["mlp", "none"] | None, KEPT] = None
    levels: Annotated[Literal["sequential", "joint"] | None, KEPT] = None
    keep: Annotated[tuple[float, ...] | None, KEPT] = None
    level_mib: Annotated[tuple[float, ...] | None, KEPT] = None
    ablation: Annotated[Literal["full", "base", "lad", "cbm", "lad-frozen"] | None, KEPT] = None
    batch: Annotated[int | None, KEPT] = None
    max_anchors: Annotated[int | None, KEPT] = None


@dataclass(frozen=True)
class Unfold:
    """Make levels another way from the full model of a run, without training that again.

    Attributes:
        run_path: Folder of a finished (or half finished) run.
        out: Folder of the new run.
        overrides: What to change; only settings of levels may differ from the old run's.
        renderer: Rasteriser; auto takes CUDA if it is there, else the CPU one.
        evaluate: Measure the result on the held-out views and write the report.
        json: Print metrics.json instead of the table.
        quiet: Say nothing on the way.
    """

    run_path: Positional[Path]
    out: Path
    overrides: OmitArgPrefixes[Changes] = field(default_factory=Changes)
    renderer: Backend = "auto"
    evaluate: bool = True
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Copy the full model's state, go on from there."""
        from gsynopsis.train.checkpoint import rewrite_config
        from gsynopsis.train.run import CHECKPOINT, FULL

        start = self.run_path / FULL
        if not start.is_file():
            raise SettingError(
                start, found="nothing", expected="a full model", advice="train the run first"
            )
        run = read_record(self.run_path)
        config = self._config(recorded_config(run))
        if run.scene is None:
            raise SettingError(self.run_path, "scene", found="nothing", expected="a scene's path")

        def copy() -> None:
            if not (self.out / CHECKPOINT).exists():
                shutil.copyfile(start, self.out / FULL)
                rewrite_config(start, self.out / CHECKPOINT, config)

        with training_world(config) as world:
            trainer = new_trainer(run.scene, config, self.renderer, world)
            with Display(json=False, quiet=self.quiet or not world.leads) as display:
                observer = Estimate(display, phase_costs(config))
                path = train_into(trainer, run.scene, self.out, observer, copy)
                display.on_message(f"wrote {path} ({path.stat().st_size / 2**20:.2f} MiB)")
        if not (self.evaluate and world.leads):
            return 0
        return evaluate_run(self.out, self.renderer, as_json=self.json, quiet=self.quiet)

    def _config(self, config: Config) -> Config:
        changed = apply_overrides(config, self.overrides)
        if (changed.model, changed.train) != (config.model, config.train):
            advice = "train another run"
            raise SettingError("unfold", found="a change of the full model", advice=advice)
        if self.overrides.steps is not None:
            changed = replaced(changed, "levels.steps", self.overrides.steps)
        return changed
