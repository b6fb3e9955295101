"""`gsynopsis train`: a scene in, one progressive file out."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional

from gsynopsis.cli.defaults import said
from gsynopsis.cli.estimate import Estimate, phase_costs, steps_text
from gsynopsis.cli.live import showing
from gsynopsis.cli.opening import Backend
from gsynopsis.cli.plan import plan_training, tell_plan
from gsynopsis.cli.progress import Display
from gsynopsis.cli.settings import Overrides, build_config
from gsynopsis.cli.suit import for_few_views
from gsynopsis.cli.training import evaluate_run, new_trainer, train_into, training_world
from gsynopsis.train.progress import Observer

if TYPE_CHECKING:
    from gsynopsis.train.plan import Plan
    from gsynopsis.train.trainer import Trainer

FEW = "{} training views are few: settings that learn less by heart (docs/methods.md §2.8)"


@dataclass(frozen=True)
class Train:
    """Train a scene into RUN/scene.gsyn; repeat the same command to go on after a stop.

    Attributes:
        scene: Folder with images/ and sparse/0/ (COLMAP), or with transforms.json.
        out: Folder of the run: checkpoints, scene.gsyn, metrics, pictures.
        preset: `fast` (CPU, minutes), `ours` (best quality) or `paper` (the paper's values).
        scale: Divide the photos' width and height by this.
        split: Rule that chooses the held-out views.
        overrides: What to change of the preset.
        max_memory: Memory for training, GiB (of the GPU, if one trains; per process of torchrun):
            growth stops in time, and what cannot start is refused.
        viewer: Serve a page that shows the training while it runs.
        viewer_port: Port of that page, on this machine only; 0 takes a free one.
        renderer: Rasteriser; auto takes CUDA if it is there, else the CPU one.
        evaluate: Measure the result on the held-out views and write the report.
        json: Print metrics.json instead of the table.
        quiet: Say nothing on the way.
    """

    scene: Positional[Path]
    out: Path
    preset: Literal["fast", "ours", "paper"] = "fast"
    scale: float = 1.0
    split: Literal["every8", "bungee", "none"] = "every8"
    overrides: OmitArgPrefixes[Overrides] = field(default_factory=Overrides)
    max_memory: Annotated[float | None, said("no limit")] = None
    viewer: bool = False
    viewer_port: int = 8000
    renderer: Backend = "auto"
    evaluate: bool = True
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Train, pack, evaluate."""
        config = build_config(self.preset, self.scale, self.split, self.overrides)
        with ExitStack() as page:
            with training_world(config) as world:
                trainer = new_trainer(self.scene, config, self.renderer, world)
                plan = plan_training(trainer, self.max_memory)
                with Display(json=False, quiet=self.quiet or not world.leads) as display:
                    views = len(trainer.scene.train)
                    if for_few_views(config, views) != config:
                        display.on_message(FEW.format(views))
                    self._train(trainer, plan, display, page)
            # The page shows the result while it is measured.
            if not (self.evaluate and world.leads):
                return 0
            return evaluate_run(self.out, self.renderer, as_json=self.json, quiet=self.quiet)

    def _train(self, trainer: "Trainer", plan: "Plan", display: Observer, page: ExitStack) -> None:
        for note in trainer.scene.notes:
            display.on_message(note)
        quiet = self.quiet or not trainer.world.leads
        tell_plan(plan, display, steps_text(trainer.config), as_json=self.json, quiet=quiet)
        live = None
        if self.viewer and trainer.world.leads:
            live = page.enter_context(showing(trainer, display, self.viewer_port))
        # Outermost, so that the page hears of the time left too.
        observer = Estimate(live or display, phase_costs(trainer.config))

        def prepare() -> None:
            from gsynopsis.train.longer import go_on_longer

            said = go_on_longer(self.out, trainer.scene.fingerprint(), trainer.config)
            if said:
                display.on_message(said)

        path = train_into(trainer, self.scene, self.out, observer, prepare)
        if live:
            live.finish()
        display.on_message(f"wrote {path} ({path.stat().st_size / 2**20:.2f} MiB)")
