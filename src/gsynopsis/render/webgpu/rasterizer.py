"""One image of Gaussians on the device, forward and backward.

project      Gaussians to splats, and how many tiles each touches
sort         by depth
list_pairs   a slot for each pair of splat and tile, splat by splat
sort         by tile, near splats first
blend        a tile: front to back
blend_backward    a tile: one row of partial sums per pair, into its slot
project_backward  a Gaussian: its rows in order, then the chain rule

No sum depends on who ran first: one device gives the same bits each time.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.render.webgpu.device import Buffer, Gpu
from gsynopsis.scene.camera import Camera

TILE = 16
"""Pixels along an edge of a tile."""
GAUSSIAN = 14
"""Numbers of a Gaussian: mean 3, quaternion 4, scales 3, opacity, colour 3."""
GRADIENT = 16
"""Numbers of its gradient: the same, then of the projected centre 2."""
SPLAT, SUMS = 12, 9
"""Words of a splat, sums of a pair."""


@dataclass(frozen=True)
class Frame:
    """An image on the device, and what its backward pass needs.

    Attributes:
        image: Red, green, blue and remaining transmittance, float32 [H, W, 4].
        touched: Tiles of each Gaussian, uint32 [G]; 0: not drawn.
        pairs: Of splat and tile, the number.
    """

    view: dict[str, float]
    size: tuple[int, int]
    count: int
    pairs: int
    gaussians: Buffer
    image: Buffer
    splats: Buffer
    touched: Buffer
    first_slots: Buffer
    pair_splats: Buffer
    slots: Buffer
    starts: Buffer


def view_of(camera: Camera, own: float, dilation: float) -> dict[str, float]:
    """A camera as parameters of kernels."""
    w2c: NDArray[np.float32] = np.asarray(camera.w2c, np.float32)
    view = {f"r{i}{j}": float(w2c[i, j]) for i in range(3) for j in range(3)}
    view |= {f"t{axis}": float(w2c[i, 3]) for i, axis in enumerate("xyz")}
    view |= {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
    size = {"width": float(camera.width), "height": float(camera.height)}
    return view | size | {"own": own, "dilation": dilation}


def render_frame(
    gpu: Gpu,
    gaussians: Buffer,
    count: int,
    camera: Camera,
    low_pass: tuple[float, float],
    background: tuple[float, float, float],
) -> Frame:
    """Queue an image; the number of pairs is read on the way.

    Args:
        gpu: The device.
        gaussians: float32 [count, 14].
        count: Gaussians, may be 0.
        camera: Any pinhole camera.
        low_pass: See `render.base.low_pass_filter`.
        background: Behind everything.

    Raises:
        SpaceError: the pairs take more than a buffer.
    """
    width, height = camera.width, camera.height
    across, down = -(-width // TILE), -(-height // TILE)
    tiles, view = across * down, view_of(camera, *low_pass)
    splats, touched = gpu.scratch(count * SPLAT), gpu.scratch(count)
    keys, order, first = gpu.scratch(count), gpu.scratch(count), gpu.scratch(count)
    known = {"tiles_x": across, "tiles_y": down}
    pairs = 0
    places = gpu.scratch(count + 1)
    if count:
        buffers = [gaussians, splats, touched, keys, order]
        gpu.run("project", count, buffers, count=count, **known, **view)
        _, order = gpu.sort(keys, order, count, 32)
        gpu.run("gather_counts", count + 1, [order, touched, places], count=count)
        gpu.scan(places, count + 1)
        pairs = int(gpu.read(places, np.uint32, 1, count)[0])
    what = f"{pairs:,} pairs of Gaussian and tile"
    tile_of, slots, owners = (gpu.scratch(pairs, what) for _ in range(3))
    if pairs:
        buffers = [order, touched, places, splats, tile_of, slots, owners, first]
        gpu.run("list_pairs", count, buffers, count=count, tiles_x=across)
        tile_of, slots = gpu.sort(tile_of, slots, pairs, max(1, (tiles - 1).bit_length()))
    starts = gpu.scratch(tiles + 1)
    gpu.run("tile_starts", pairs + 1, [tile_of, starts], count=pairs, tiles=tiles)
    image = gpu.scratch(4 * width * height)
    red, green, blue = background
    shape = {"width": width, "height": height, "tiles_x": across}
    buffers = [splats, owners, slots, starts, image]
    gpu.run_grid("blend", (across, down), buffers, **shape, red=red, green=green, blue=blue)
    size = (width, height)
    return Frame(
        view, size, count, pairs, gaussians, image, splats, touched, first, owners, slots, starts
    )


def frame_backward(gpu: Gpu, frame: Frame, pulls: Buffer) -> Buffer:
    """Queue the gradients of a frame's Gaussians, float32 [G, 16].

    Args:
        gpu: The device.
        frame: The image.
        pulls: Gradient of the loss on it, float32 [H, W, 3].
    """
    width, height = frame.size
    across, down = -(-width // TILE), -(-height // TILE)
    partials = gpu.scratch(frame.pairs * SUMS, f"{frame.pairs:,} pairs' sums")
    grads = gpu.scratch(frame.count * GRADIENT)
    if frame.pairs:
        gpu.clear(partials)  # a tile ends where all its pixels are opaque
        buffers = [
            *(frame.splats, frame.pair_splats, frame.slots, frame.starts),
            *(frame.image, pulls, partials),
        ]
        shape = {"width": width, "height": height, "tiles_x": across}
        gpu.run_grid("blend_backward", (across, down), buffers, **shape)
    if frame.count:
        buffers = [frame.gaussians, frame.touched, frame.first_slots, partials, grads]
        gpu.run("project_backward", frame.count, buffers, count=frame.count, **frame.view)
    return grads
