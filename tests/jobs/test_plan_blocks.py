"""Photos of a block, and who has what lies on a face between two."""

import numpy as np
import torch

from gsynopsis.jobs.plan_blocks import views_of
from gsynopsis.training.sub_scene import Region


def test_photos_of_a_block_are_those_that_show_it() -> None:
    shares = np.array([0.0, 0.04, 0.5, 0.06, 0.0, 0.01, 0.02, 0.03, 0.3, 0.049, 0.001])
    # Eight at least, but none that shows nothing of it.
    chosen = views_of(range(100, 111), shares)
    assert chosen == (101, 102, 103, 105, 106, 107, 108, 109), (
        "eight at least, none that shows none"
    )
    assert views_of(range(3), np.zeros(3)) == ()
    assert views_of(range(20), np.full(20, 0.2)) == tuple(range(20))


def test_a_region_s_low_faces_are_its_own() -> None:
    x = torch.tensor([[0.0, 0, 0], [1.0, 0, 0]])
    assert Region(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, 1.0)).holds(x).tolist() == [True, False]
