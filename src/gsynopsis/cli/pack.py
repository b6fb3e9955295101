"""`gsynopsis pack`: write a run's levels as one file again, in either coding."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gsynopsis.cli.defaults import said
from gsynopsis.cli.run_folder import RESULT_FILE, read_record
from gsynopsis.cli.training import new_trainer, pack_into, recorded_config
from gsynopsis.errors import InputError, SettingError
from gsynopsis.pack.layout import BLOCK_ROWS_MAX


@dataclass(frozen=True)
class Pack:
    """Pack a finished run into one progressive file.

    Attributes:
        run_path: Folder of a run.
        out: The file; RUN/scene.gsyn if not given.
        coding: `compact` (8 bit, live slots only), or `raw` (float32, exact).
        block: Largest number of anchors of a spatial block, 0 for the usual one. Of smaller ones
            (512 to 1024) a stream can choose what to refine first, for 2 to 4 % more bytes. Those
            of level 0 have 2048 at most in any case.
        licence: What others may do with the scene, as text that the file carries.
    """

    run_path: Positional[Path]
    out: Annotated[Path | None, said("the run's scene.gsyn")] = None
    coding: Literal["raw", "compact"] = "compact"
    block: int = 0
    licence: Annotated[str | None, said("none")] = None

    def run(self) -> int:
        """Load the checkpoint, write the file."""
        if self.block and not 2 <= self.block <= BLOCK_ROWS_MAX:
            expected = f"2 to {BLOCK_ROWS_MAX}, or 0"
            raise SettingError("--block", found=self.block, expected=expected)
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
        path = pack_into(trainer, out, self.coding, self.licence, self.block)
        print(f"wrote {path} ({path.stat().st_size / 2**20:.2f} MiB)")
        return 0
