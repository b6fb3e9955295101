"""Milliseconds per frame: decoding, rasterising, and both."""

import time
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from gsynopsis.evaluate.base import Decoder
from gsynopsis.evaluate.report import Timing
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import Camera

Clock = Callable[[], float]


def time_level(
    decoder: Decoder,
    renderer: Renderer,
    cameras: Sequence[Camera],
    level: int,
    background: Tensor,  # [3]
    frames: tuple[int, int] = (3, 20),
) -> Timing:
    """Time one level, going round the cameras.

    Args:
        decoder: Decodes the level.
        renderer: Draws; on a GPU each part is waited for.
        cameras: At the size that counts.
        level: Which level.
        background: On the renderer's device.
        frames: How many to skip first, and how many to count.
    """
    warmup, counted = frames
    clock = _clock(renderer.device)
    rows: list[tuple[float, float]] = []
    for frame in range(warmup + counted):
        camera = cameras[frame % len(cameras)]
        start = clock()
        gaussians = decoder.decode(camera, level)
        decoded = clock()
        renderer.render(gaussians, camera, background)
        rows.append((decoded - start, clock() - decoded))
    return timing_of(rows[warmup:], min(counted, len(cameras)))


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
