"""A trained whole divided into blocks of space, and photos by the blocks that they show."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gsynopsis.errors import SettingError
from gsynopsis.files import publish
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.render.measures import blend_weights
from gsynopsis.runs.folder import make_folder
from gsynopsis.training.loop import CHECKPOINT
from gsynopsis.training.state import TrainState
from gsynopsis.training.sub_scene import Region, extents, split_space

WHOLE, BLOCKS, PLAN = "whole", "blocks", "plan.json"
"""In a run's folder: the run of the whole, folders of blocks by number, how they were divided."""
MARGIN = 0.1
"""Share of a block's size, on each side, in which it trains anchors that are not its own."""
SHOWN = 0.05
"""A photo is of a block where the block and its margin fill this share of it."""
FEWEST_PHOTOS = 8
"""A block gets as many, those that show most of it, where fewer show enough."""


@dataclass(frozen=True)
class SpaceBlock:
    """A part of a scene.

    Attributes:
        number: From 0.
        own: What of the result is its.
        trained: Its own box with a margin: anchors in there it trains.
        views: Training photos that show it; none: it stays as the whole has it.
    """

    number: int
    own: Region
    trained: Region
    views: tuple[int, ...]

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return f"{self.number:04d}"


def plan_blocks(state: TrainState, count: int) -> list[SpaceBlock]:
    """Divide a trained whole by its anchors, and photos by what they show.

    Raises:
        SettingError: there are fewer anchors than blocks.
    """
    model, scene = state.model, state.context.scene
    placed = model.placed()[0]
    x = placed[alive(model)].cpu().numpy()
    if len(x) < 2 * count:
        raise SettingError("--blocks", found=count, expected=f"at most {len(x) // 2} here")
    own = split_space(x, count)
    trained: list[Region] = []
    for box in own:
        inside = x[box.holds(torch.from_numpy(x)).numpy()]
        trained.append(box.wider((MARGIN * extents(inside)).tolist()))
    member = torch.stack([box.holds(placed) for box in trained], dim=1).float()  # [N, B]
    shares = np.stack([_shares(state, view, member) for view in scene.train])  # [V, B]
    return [
        SpaceBlock(number, box, trained[number], views_of(scene.train, shares[:, number]))
        for number, box in enumerate(own)
    ]


def _shares(state: TrainState, view: int, member: Tensor) -> np.ndarray:
    """Share of a view that each block fills, float64 [B]; `member` [N, B] assigns anchors."""
    camera, model = state.context.scene.camera(view, state.context.config.scale), state.model
    with torch.no_grad():
        decoded = model.decode_level(-1, camera)
    weights = blend_weights(state.context.renderer, decoded.gaussians, camera)
    filled = weights[None] @ member[decoded.slots // model.slots]
    return filled[0].double().cpu().numpy() / (camera.width * camera.height)


def views_of(train: Sequence[int], shares: np.ndarray) -> tuple[int, ...]:
    """Views that show a block, ascending."""
    best = np.argsort(-shares, kind="stable")
    enough = int((shares >= SHOWN).sum())
    chosen = best[: max(enough, min(FEWEST_PHOTOS, int((shares > 0).sum())))]
    return tuple(train[i] for i in sorted(chosen.tolist()))


def alive(model: AnchorModel) -> Tensor:
    """Anchors that any level has, bool [N]."""
    return torch.stack([part.mask for part in model.level_parts()]).any(dim=0).any(dim=1)


def check_plan(out: Path, count: int) -> None:
    """Refuse a folder that holds something else.

    Raises:
        SettingError: it does.
    """
    path, advice = out / BLOCKS / PLAN, "repeat the command as it was, or choose another --out"
    if not path.is_file():
        if (out / CHECKPOINT).exists():
            raise SettingError(out, found="a run without blocks", expected="none", advice=advice)
        return
    try:
        before = len(json.loads(path.read_text("utf-8"))["blocks"])
    except (ValueError, KeyError, TypeError) as error:
        raise SettingError(path, found=error, expected="a plan of blocks", advice=advice) from error
    if before != count:
        raise SettingError(out, "--blocks", found=count, expected=f"{before}", advice=advice)


def write_plan(out: Path, blocks: Sequence[SpaceBlock]) -> None:
    """For people, and to know the number of blocks again; infinite sides are null."""
    make_folder(out / BLOCKS)

    def box(region: Region) -> dict[str, list[float | None]]:
        sides = asdict(region)
        return {k: [x if math.isfinite(x) else None for x in v] for k, v in sides.items()}

    told = [{"own": box(b.own), "trained": box(b.trained), "views": b.views} for b in blocks]
    publish(out / BLOCKS / PLAN, json.dumps({"blocks": told}, indent=1) + "\n")
