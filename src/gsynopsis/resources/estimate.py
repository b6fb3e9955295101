"""Estimate of a run's photos, steps, anchors and memory.

Memory is a model with a few constants that `benchmarks/robust/memory.py` measures on the CPU. On a
GPU the same sum without the process stands for the device; it was not measured there.
"""

from dataclasses import dataclass

import torch

from gsynopsis.config import Config, ModelConfig, total_steps
from gsynopsis.model.build import FREE_WIDTH, grid_resolutions, initial_points, make_frame
from gsynopsis.model.encoding import grid_layout
from gsynopsis.model.lattice import beyond_lattice, initial_lattice
from gsynopsis.scene.scene import Scene
from gsynopsis.training.distributed.process_group import ProcessGroup
from gsynopsis.training.growth import growth_limit
from gsynopsis.training.regularize.jitter import photo_bytes

PROCESS_BYTES = 305 * 2**20
"""Python, PyTorch and our code before anything is loaded."""
PARAMETER_COPIES = 5
"""Copies of every parameter: itself, its gradient, Adam's two moments, its average at the end."""
SLOT_BYTES = 250
"""Held per slot while a view is learnt, if every anchor is in view: decoding, rendering, back."""
CODE_BYTES = 6
"""Held per anchor and codebook row in the same time: the soft index and its gradient."""
ANCHOR_BYTES = 1400
"""Held per anchor in the same time: features and hidden layers."""
PIXEL_BYTES = 265
"""Held per pixel of a view: image, gradient, the loss and lists of who covers it."""
DECODING_BYTES = 24
"""Held per stored pixel while two photos are decoded, one ahead: stored, padded and reduced."""
DECODED_BYTES = DECODING_BYTES // 2
"""Held per stored pixel while one photo is decoded, as where decoded ones stay in memory."""
SLACK = 1.25
"""A promise asks for this much more than the model says: its misses are smaller."""


@dataclass(frozen=True)
class TrainPlan:
    """Photos, steps, anchors and memory of a training.

    Attributes:
        photos: Training views.
        width: Width of the largest photo at the training resolution, pixels.
        height: Its height, pixels.
        steps: Training steps of all phases.
        batch: Views per step.
        processes: Number that train together.
        anchors: At the start, one per occupied cell.
        beyond: Points too many cells away from the origin to count.
        max_anchors: Limit of growth.
        start_bytes: Peak memory of a process with the anchors of the start, estimated.
        most_bytes: With the most anchors.
        free_bytes: Free memory of the machine or GPU now; None if unknown.
    """

    photos: int
    width: int
    height: int
    steps: int
    batch: int
    processes: int
    anchors: int
    beyond: int
    max_anchors: int
    start_bytes: int
    most_bytes: int
    free_bytes: int | None


def make_plan(scene: Scene, config: Config, device: torch.device, group: ProcessGroup) -> TrainPlan:
    """Look at the scene's points and at photo headers; nothing is decoded."""
    voxel = make_frame(scene, config.model).voxel
    anchors = len(initial_lattice(initial_points(scene, config.model), voxel))
    cameras = [scene.camera(view, config.scale) for view in scene.train]
    largest = max(cameras, key=lambda camera: camera.width * camera.height)
    most = max(anchors, growth_limit(scene, config))
    return TrainPlan(
        photos=len(cameras),
        width=largest.width,
        height=largest.height,
        steps=total_steps(config),
        batch=config.train.batch,
        processes=group.size,
        anchors=anchors,
        beyond=beyond_lattice(scene.points, voxel),
        max_anchors=most,
        start_bytes=peak_bytes(scene, config, anchors, device),
        most_bytes=peak_bytes(scene, config, most, device),
        free_bytes=free_memory(device),
    )


def peak_bytes(scene: Scene, config: Config, anchors: int, device: torch.device) -> int:
    """Peak memory of one process, bytes, with `anchors` anchors on the whole scene."""
    fixed = _fixed_bytes(scene, config, device)
    return round(fixed + anchors * anchor_bytes(config))


def needed_bytes(scene: Scene, config: Config, anchors: int, device: torch.device) -> int:
    """A memory limit, bytes, under which `anchors` anchors are sure to train."""
    return round(SLACK * peak_bytes(scene, config, anchors, device))


def most_anchors(limit: int, scene: Scene, config: Config, device: torch.device) -> int:
    """The most anchors that can be promised to train within `limit` bytes; may be 0."""
    room = limit / SLACK - _fixed_bytes(scene, config, device)
    return max(0, int(room / anchor_bytes(config)))


def anchor_bytes(config: Config) -> float:
    """Peak memory that one more anchor costs one process, bytes."""
    model = config.model
    held = 4 * PARAMETER_COPIES * row_values(model)
    if config.train.batch > 1:
        # Flat gradients of each view, their sum, and its mean; several processes need less.
        held += 4 * row_values(model) * (config.train.batch + 2)
    codes = 0 if model.feature == "free" else model.codebook
    learning = ANCHOR_BYTES + SLOT_BYTES * model.slots + CODE_BYTES * codes
    return held + learning


def row_values(model: ModelConfig) -> int:
    """Trained float32 values per anchor: offsets, scales, soft index, residual."""
    own = FREE_WIDTH if model.feature == "free" else model.codebook + model.residual
    return 3 * model.slots + 6 + own


def free_memory(device: torch.device) -> int | None:
    """Bytes free for us on the machine or GPU now; None where the system does not tell."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    try:
        with open("/proc/meminfo", encoding="ascii") as table:
            for line in table:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass
    return None


def _fixed_bytes(scene: Scene, config: Config, device: torch.device) -> int:
    """Memory independent of the anchors: process, photos, grids, one image."""
    cameras = [scene.camera(view, config.scale) for view in scene.train]
    layout = grid_layout(grid_resolutions(config.model), config.model.table_log2)
    table = 4 * PARAMETER_COPIES * layout.rows * layout.features
    image = PIXEL_BYTES * max(camera.width * camera.height for camera in cameras)
    if device.type == "cuda":
        return table + image + min(photo_bytes(scene, config), scene.cache.budget)
    return PROCESS_BYTES + held_photos(scene, config) + table + image


def held_photos(scene: Scene, config: Config) -> int:
    """Memory for photos, bytes: decoding, and all of them where they are not too many."""
    photos = photo_bytes(scene, config)
    stored = max(
        scene.views[view].camera.width * scene.views[view].camera.height for view in scene.train
    )
    if photos <= scene.cache.budget:
        # Smaller ones of the first steps stay until there is no room for them.
        sizes = sum(0.25**halvings for halvings in range(len(config.train.reduced_until) + 1))
        return min(round(sizes * photos), scene.cache.budget) + DECODED_BYTES * stored
    return DECODING_BYTES * stored
