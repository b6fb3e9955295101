"""Coarse levels of an import: few splats that stand for many, trained on renders of the input."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.evaluation.metrics import to_bytes
from gsynopsis.jobs.export_finetune import FineTuning, Shot, fine_tune
from gsynopsis.model.plain import PlainModel
from gsynopsis.model.splats import SplatModel
from gsynopsis.model.stand_ins import nested_stand_ins
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import ANTIALIASED
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.teacher.renders import Tick

Float64 = NDArray[np.float64]
Bytes = NDArray[np.uint8]
STEPS = 500
"""A view each; twice as many bring 0.5 to 1.5 dB (ours, as all that follows)."""
VIEWS = 64
"""Renders that they are trained on."""
AWAY = 0.03
"""Spread of these views' cameras around those that were chosen, in units of the splats' own."""
ZOOM = (0.6, 1.4)
"""Factors on focal lengths: other sizes on the screen are to look right too."""
FINEST = 0.45
"""Share of the steps that train the finest of the levels, which takes longest to become sharp."""
RATES = 2.5
"""Rates in units of those of fine-tuning: there is less to keep and more to find."""
REACH = 3.0
"""Rates of means in units of the splats' spread, likewise."""


def fit_stand_ins(
    gaussians: PlainGaussians,
    truth: SplatModel,
    worth: Float64,
    counts: Sequence[int],
    cameras: Sequence[Camera],
    tick: Tick,
    steps: int = STEPS,
) -> PlainGaussians:
    """Nested levels of splats that look like all of a scene's from wherever it is seen.

    They begin as means of clusters (`nested_stand_ins`). A step trains one level, the finest
    most often, against a render on black or white, so that what is empty stays so.

    Args:
        gaussians: G of them, the scene.
        truth: Its renderer's model, whose coarsest part is drawn.
        worth: Contribution of each to images [G].
        counts: Stand-ins of each level, rising, fewer than G.
        cameras: From which they have to look right, small.
        tick: Told of progress.
        steps: A view each.

    Returns:
        The stand-ins, those of level 0 first.
    """
    renderer = make_renderer("cpu")
    begun = nested_stand_ins(gaussians, worth, counts)
    spread = float(np.linalg.norm(gaussians.means.std(axis=0, dtype=np.float64)))
    chance = np.random.default_rng(0)
    views = [around(cameras[k % len(cameras)], spread, chance) for k in range(VIEWS)]
    renders: dict[int, tuple[Bytes, Bytes]] = {}

    def shot(view: int) -> Shot:
        if view not in renders:
            with torch.no_grad():
                seen = truth.decode(views[view], 0)
                # A frame that goes at once: of millions of splats it is more than they are.
                found = make_renderer("cpu").render(seen, views[view], torch.zeros(3))
            renders[view] = to_bytes(found.image), to_bytes(found.alpha)
        image, alpha = (torch.from_numpy(part).float() / 255 for part in renders[view])
        light = torch.full((3,), float(chance.integers(2)))
        own = int(chance.integers(len(counts))) if chance.random() > FINEST else len(counts) - 1
        return Shot(views[view], image + (1 - alpha[..., None]) * light, light, own)

    tuning = FineTuning(steps, REACH * max(spread, 1e-9), rate_scale=RATES)
    # Drawn as the input is, so that they thicken as it does in small images.
    antialiased = truth.part(-1).focals == ANTIALIASED
    model = PlainModel(begun, antialiased=antialiased, counts=counts)
    return fine_tune(
        model,
        VIEWS,
        shot,
        renderer,
        tuning,
        lambda done, total: tick("fitting levels", done, total),
    )


def around(camera: Camera, spread: float, chance: np.random.Generator) -> Camera:
    """A camera near another, with another focal length."""
    w2c = camera.w2c.copy()
    w2c[:3, 3] -= w2c[:3, :3] @ (AWAY * spread * chance.standard_normal(3))
    zoom = float(np.exp(chance.uniform(*np.log(ZOOM))))
    return replace(camera, w2c=w2c, fx=zoom * camera.fx, fy=zoom * camera.fy)
