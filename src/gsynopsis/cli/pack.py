"""`gsynopsis pack`: write a run's levels as one file again, in either coding."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from gsynopsis.cli.run_folder import RESULT_FILE, read_record
from gsynopsis.cli.training import new_trainer, pack_into, recorded_config
from gsynopsis.errors import InputError


@dataclass(frozen=True)
class Pack:
    """Pack a finished run into one progressive file.

    Attributes:
        run_path: Folder of a run.
        out: The file; RUN/scene.gsyn if not given.
        coding: `compact` (8 bit, live slots only), or `raw` (float32, exact).
        licence: What others may do with the scene, as text that the file carries.
    """

    run_path: Positional[Path]
    out: Path | None = None
    coding: Literal["raw", "compact"] = "compact"
    licence: str | None = None

    def run(self) -> int:
        """Load the checkpoint, write the file."""
        from gsynopsis.train.checkpoint import load_checkpoint
        from gsynopsis.train.run import CHECKPOINT, phases_of

        run, config = read_record(self.run_path), recorded_config(read_record(self.run_path))
        checkpoint = self.run_path / CHECKPOINT
        if run.scene is None or not checkpoint.is_file():
            raise InputError(checkpoint, found="nothing", expected="the checkpoint of a run")
        trainer = new_trainer(run.scene, config, "auto")
        load_checkpoint(trainer, checkpoint)
        if trainer.cursor.phase < len(phases_of(config)):
            raise InputError(
                checkpoint, found="an unfinished run", advice="repeat its train command first"
            )
        out = self.out or self.run_path / RESULT_FILE
        path = pack_into(trainer, out, self.coding, self.licence)
        print(f"wrote {path} ({path.stat().st_size / 2**20:.2f} MiB)")
        return 0
