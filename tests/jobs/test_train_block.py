"""The steps that a block's process writes down for the one that waits."""

from pathlib import Path

from gsynopsis.jobs.train_block import STEPS_FILE, StepsWritten, steps_written
from gsynopsis.training.observer import StepInfo


def test_a_block_says_how_far_it_is(tmp_path: Path) -> None:
    assert steps_written(tmp_path) == 0
    (tmp_path / STEPS_FILE).write_text("half a num")
    assert steps_written(tmp_path) == 0
    written = StepsWritten(tmp_path)
    step = StepInfo("full", 1, 10, loss=0.1, psnr=20.0, anchors=5, memory=0)
    for _ in range(3):
        written.on_step(step)
    assert written.done == 3 and steps_written(tmp_path) == 1, "at most every two seconds"
