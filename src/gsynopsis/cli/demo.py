"""`gsynopsis demo`: the whole road on a scene that the program makes itself."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from gsynopsis.cli.flags import to_set_flags
from gsynopsis.cli.train import Train
from gsynopsis.config import resolve_settings
from gsynopsis.runs.folder import RESULT_FILE, make_folder

WIDTH, HEIGHT = 480, 320
"""Pixels of the photos: enough to look sharp in a browser window."""


@dataclass(frozen=True)
class Demo:
    """Make a procedural scene, train, pack and evaluate it: two minutes on two cores.

    Attributes:
        out: Folder of the demo: the scene, and run/.
        kind: `room` (textured, with a shiny ball) or `outdoor` (far background).
        steps: Steps of the full training; those of the levels scale along.
        seed: Seed of scene and training.
        json: Print metrics.json instead of the table.
        quiet: Say nothing on the way.
    """

    out: Path = field(default=Path("runs/demo"))
    kind: Literal["room", "outdoor"] = "room"
    steps: int = 300
    seed: int = 0
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Make the scene, then do what `train` does."""
        from gsynopsis.monitor.display import ticking
        from gsynopsis.synthetic.make_scene import make_scene

        asked = {"train.steps": self.steps, "train.seed": self.seed}
        resolve_settings("standard", None, asked)  # refuses before the scene is made
        make_folder(self.out)
        folder, seed = self.out / self.kind, self.seed
        with ticking("rendering photos", quiet=self.quiet or self.json) as tick:
            scene = make_scene(self.kind, folder, width=WIDTH, height=HEIGHT, seed=seed, tick=tick)
        train = Train(
            scene=scene,
            out=self.out / "run",
            overrides=to_set_flags(asked),
            json=self.json,
            quiet=self.quiet,
        )
        code = train.run()
        if code == 0 and not (self.json or self.quiet):
            print(f"to see it in a browser: gsynopsis serve {self.out / 'run' / RESULT_FILE}")
        return code
