"""`gsynopsis train`: a scene in, one progressive file out."""

import os
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from gsynopsis.cli.bounds import Backend, bounded, with_training
from gsynopsis.cli.defaults import said
from gsynopsis.cli.flags import Overrides, asked_of
from gsynopsis.config import PresetName, Recipe, Split
from gsynopsis.errors import SettingError
from gsynopsis.scene.masks import MaskUse

if TYPE_CHECKING:
    from gsynopsis.evaluation.report import Report
    from gsynopsis.jobs.train import Conduct
    from gsynopsis.scene.scene import Scene
    from gsynopsis.training.distributed.process_group import World
    from gsynopsis.training.observer import Observer
    from gsynopsis.training.state import Setup, TrainState


@dataclass(frozen=True)
class Train:
    """Train a scene into RUN/scene.gsyn; repeat the same command to go on after a stop.

    Attributes:
        scene: Folder with images/ and sparse/0/ (COLMAP), or with transforms.json; of photos alone
            or a video poses are estimated first, into RUN/scene.
        out: Folder of the run: checkpoints, scene.gsyn, metrics, pictures.
        preset: `fast` (CPU, minutes) and `ours` (best quality) have our own anchor model, `paper`
            the paper's model and values.
        scale: Divide the photos' width and height by this: the training resolution.
        split: Rule that chooses the held-out views.
        images: Folder of photos in the scene's, as `images_4`; sizes may differ from the cameras'.
        max_width: Divide wider photos so that they have this many pixels across (1600 in the
            literature); 0: never.
        masks: What masks/NAME.png are for: pixels outside do not count (loss), are trained to be
            empty so that no background is in the file (empty), or nothing (off).
        overrides: What to change of the preset; what is given always wins.
        max_memory: Memory for training, GiB, of the GPU if one trains, per process of torchrun:
            growth stops in time, and what cannot start is refused.
        cache: Folder that keeps decoded photos for other trainings too; else they are in memory,
            or in RUN/photos where they take more than 1 GiB, until training is done.
        checkpoint_seconds: Seconds between checkpoints: at most this is lost on a power cut.
        blocks: Divide a large scene into so many blocks of space, each trained on its own after the
            whole, and join them into one file; 0: one training.
        jobs: Blocks at once, each a process that shares cores and `max_memory` with the others.
        ray: Train the blocks on the Ray cluster of this address instead (extra `ray`), or `local`.
        viewer: Serve a page that shows the training while it runs.
        viewer_port: Port of that page, on this machine only; 0 takes a free one.
        tensorboard: Write loss, held-out PSNR and pictures to RUN/tensorboard while it runs.
        renderer: Rasteriser; auto takes CUDA if it is there, else the CPU one.
        evaluate: Write the report of an evaluation on the held-out views beside the file.
        json: Print metrics.json instead of the table.
        quiet: Say nothing on the way.
    """

    scene: Positional[Path]
    out: Path
    preset: PresetName = "fast"
    scale: float = 1.0
    split: Split = "every8"
    images: str = "images"
    max_width: int = 0
    masks: MaskUse = "loss"
    overrides: Annotated[Overrides, arg(name="")] = field(default_factory=Overrides)
    max_memory: Annotated[float | None, said("no limit")] = None
    cache: Annotated[Path | None, said("memory, or RUN/photos")] = None
    checkpoint_seconds: float = 120.0
    blocks: int = 0
    jobs: int = 1
    ray: Annotated[str | None, said("none, this machine")] = None
    viewer: bool = False
    viewer_port: int = 8000
    tensorboard: bool = False
    renderer: Backend = "auto"
    evaluate: bool = True
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Train, pack, evaluate, print."""
        from gsynopsis.config import resolve_settings

        asked = self.asked()
        self._check_blocks()
        resolve_settings(self.preset, None, asked)  # refuses before anything is read
        with with_training():
            from gsynopsis.jobs.train import Conduct, make_setup, resolve
            from gsynopsis.scene.scene import Reading, load_scene
            from gsynopsis.training.distributed.process_group import joined
        conduct = Conduct(
            renderer=self.renderer,
            evaluate=self.evaluate,
            max_memory=self.max_memory,
            checkpoint_seconds=self.checkpoint_seconds,
            tensorboard=self.tensorboard,
            cache=self.cache,
        )
        with ExitStack() as page, joined() as world:
            reading = Reading("" if self.images == "images" else self.images, self.masks)
            scene = load_scene(self._posed(world), self.split, reading)
            asked["scale"] = max(self.scale, self._width_scale(scene))
            recipe = resolve(self.preset, scene, asked)
            setup = make_setup(scene, recipe.config, conduct, world)
            if self.blocks:
                report = self._train_blocks(setup, recipe, conduct)
            else:
                report = self._train(setup, recipe, conduct, page)
        print_report(report, self.out, as_json=self.json)
        return 0

    def asked(self) -> dict[str, object]:
        """Settings that were given, by dotted name."""
        return {**asked_of(self.overrides), "scale": self.scale, "split": self.split}

    def _width_scale(self, scene: "Scene") -> float:
        """What the widest photo is divided by for `max_width`."""
        bounded("--max-width", self.max_width, 0, 65_536)
        widest = max(view.camera.width for view in scene.views)
        return widest / self.max_width if self.max_width else 1.0

    def _posed(self, world: "World") -> Path:
        """The scene's folder; poses are estimated first where there are none."""
        from gsynopsis.jobs.estimate_poses import POSED, lacks_poses, pose_for
        from gsynopsis.monitor.display import Display

        if not lacks_poses(self.scene):
            return self.scene
        with Display(quiet=self.quiet or not world.leads) as display:
            world.lead(lambda: pose_for(self.scene, self.out, display))
        return self.out / POSED

    def _train(
        self, setup: "Setup", recipe: Recipe, conduct: "Conduct", page: ExitStack
    ) -> "Report | None":
        from gsynopsis.jobs.train import train_into
        from gsynopsis.monitor.display import Display
        from gsynopsis.monitor.live_page import Live, showing

        quiet, pages = self.quiet or not setup.world.leads, list[Live]()

        def watch(state: "TrainState", observer: "Observer") -> "Observer":
            if not (self.viewer and setup.world.leads):
                return observer
            live = page.enter_context(showing(state, recipe.preset, observer, self.viewer_port))
            pages.append(live)
            return live

        with Display(json=False, quiet=quiet) as display:
            self._tell_plan(setup, recipe, display, quiet=quiet)
            report = train_into(setup, recipe, self.out, display, conduct=conduct, watch=watch)
            for live in pages:
                live.finish()
            return report

    def _check_blocks(self) -> None:
        """Refuse what blocks cannot be trained with, before anything is read."""
        bounded("--jobs", self.jobs, 1, 256)
        if not self.blocks and (self.jobs > 1 or self.ray):
            name = "--ray" if self.ray else "--jobs"
            raise SettingError(name, found="no blocks", expected="--blocks N")
        if self.blocks and (self.viewer or self.tensorboard):
            name = "--viewer" if self.viewer else "--tensorboard"
            raise SettingError(name, found="--blocks", expected="one training")
        if self.blocks and os.environ.get("WORLD_SIZE", "1") != "1":
            raise SettingError("--blocks", found="torchrun", expected="one process, see --jobs")

    def _train_blocks(self, setup: "Setup", recipe: Recipe, conduct: "Conduct") -> "Report | None":
        from gsynopsis.jobs.train_blocks import Division, train_in_blocks
        from gsynopsis.monitor.display import Display

        division = Division(self.blocks, self.jobs, self.ray)
        with Display(json=False, quiet=self.quiet) as display:
            self._tell_plan(setup, recipe, display, quiet=self.quiet)
            return train_in_blocks(
                setup.scene, recipe, self.out, display, division, conduct=conduct
            )

    def _tell_plan(
        self, setup: "Setup", recipe: Recipe, display: "Observer", *, quiet: bool
    ) -> None:
        """Say what the training takes: lines on the display, or one JSON object on stderr."""
        import json
        import sys

        from gsynopsis.jobs.train import before_training
        from gsynopsis.resources.report import plan_of

        if self.json and not quiet:
            account, settings = setup.scene.account.document(), recipe.lines()
            plan = asdict(plan_of(setup))
            event = {"event": "plan", **plan, "account": account, "settings": settings}
            print(json.dumps(event), file=sys.stderr, flush=True)
            return
        for line in before_training(setup, recipe):
            display.on_message(line)


def print_report(report: "Report | None", out: Path, *, as_json: bool) -> None:
    """The table of levels and where the report is, or its JSON; nothing if there is none."""
    if report is None:
        return
    from gsynopsis.evaluation.formatting import report_table
    from gsynopsis.evaluation.report import report_json
    from gsynopsis.evaluation.report_files import names_of

    if as_json:
        print(report_json(report), end="")
        return
    print(report_table(report))
    print("\n".join(map(str, names_of(out))))
