"""Milliseconds per frame: decoding, rasterising, and both."""

import time
from collections.abc import Callable, Sequence

import numpy as np
import torch

from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.evaluation.report import Timing
from gsynopsis.scene.camera import Camera

Clock = Callable[[], float]


def time_levels(
    painter: LevelRenderer, cameras: Sequence[Camera], levels: int, warmup: int, frames: int
) -> list[Timing]:
    """Time all levels, going round the cameras.

    Levels take turns at every frame, so that a slow spell of the machine affects all of them.

    Args:
        painter: Decodes and renders; on a GPU each part is waited for.
        cameras: At the size to time.
        levels: Number of levels.
        warmup: Frames of each level that are not counted.
        frames: Frames of each level that are.
    """
    clock = _clock(painter.renderer.device)
    rows: list[list[tuple[float, float]]] = [[] for _ in range(levels)]
    for frame in range(warmup + frames):
        camera = cameras[frame % len(cameras)]
        for level in range(levels):
            start = clock()
            gaussians = painter.decoder.decode(camera, level)
            decoded = clock()
            painter.renderer.render(gaussians, camera, painter.background)
            rows[level].append((decoded - start, clock() - decoded))
    return [timing_of(row[warmup:], min(frames, len(cameras))) for row in rows]


def timing_of(rows: Sequence[tuple[float, float]], views: int) -> Timing:
    """Medians and 95th percentiles of (decode, raster) seconds."""
    decode, raster = np.array(rows, dtype=np.float64).reshape(-1, 2).T * 1000.0
    total = decode + raster

    def at(values: np.ndarray, percent: float) -> float:
        return round(float(np.percentile(values, percent)), 4)

    return Timing(
        decode_ms=at(decode, 50),
        decode_p95_ms=at(decode, 95),
        raster_ms=at(raster, 50),
        raster_p95_ms=at(raster, 95),
        total_ms=at(total, 50),
        total_p95_ms=at(total, 95),
        frames=len(rows),
        views=views,
    )


def _clock(device: torch.device) -> Clock:
    if device.type != "cuda":
        return time.perf_counter

    def after_the_gpu() -> float:
        torch.cuda.synchronize(device)
        return time.perf_counter()

    return after_the_gpu
