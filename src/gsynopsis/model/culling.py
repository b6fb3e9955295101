"""Anchors that a camera could see: native on the CPU, plain PyTorch elsewhere."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from gsynopsis._native import _core
from gsynopsis._native.runtime import thread_count
from gsynopsis.model.assemble import SlotTables
from gsynopsis.render.base import NEAR_PLANE, sent
from gsynopsis.scene.camera import Camera


def visible_rows(tables: SlotTables, camera: Camera) -> Tensor:
    """Anchors whose Gaussians could touch the image, int64 [V] ascending.

    A frustum test on the anchor with the margin 3·max scale + max |offset|·offset scale
    (methods.md §1.6.1); dead slots do not widen the margin, and an anchor without a live one is
    left out.
    """
    t = tables
    if t.offsets.device.type != "cpu" or t.offsets.dtype != torch.float32:
        return visible_rows_reference(tables, camera)
    arrays = (t.positions, t.log_scales, t.offsets, t.live.view(torch.uint8))
    anchors: Any = tuple(a.detach().contiguous().numpy() for a in arrays)
    rows = torch.empty(len(t.positions) + 1, dtype=torch.int64)
    w2c = np.ascontiguousarray(camera.w2c, dtype=np.float32)
    count = _core.visible_rows(
        (*anchors, float(t.log_gain.detach().exp().max())),
        w2c,
        (camera.fx, camera.fy, camera.cx, camera.cy),
        (camera.width, camera.height),
        rows.numpy(),
        thread_count(),
    )
    return rows[:count]


def visible_rows_reference(tables: SlotTables, camera: Camera) -> Tensor:
    """`visible_rows` in plain PyTorch, any dtype and device: the oracle.

    The host waits once, for how many there are.
    """
    t = tables
    with torch.no_grad():
        x = t.positions
        w2c = sent(torch.as_tensor(camera.w2c, dtype=x.dtype), x.device)
        base = t.log_scales.exp()
        live = t.offsets.abs().amax(dim=2) * t.live
        gain = t.log_gain.exp().max()
        margin = 3 * gain * base[:, 3:].amax(dim=1) + live.amax(dim=1) * base[:, :3].amax(dim=1)
        p = x @ w2c[:3, :3].T + w2c[:3, 3]
        z = p[:, 2].clamp(min=5 * NEAR_PLANE)
        px, mx = camera.fx * p[:, 0] / z, camera.fx * margin / z
        py, my = camera.fy * p[:, 1] / z, camera.fy * margin / z
        inside = t.live.any(dim=1) & (p[:, 2] + margin > NEAR_PLANE) & (px + mx > -camera.cx)
        inside &= (px - mx < camera.width - camera.cx) & (py + my > -camera.cy)
        inside &= py - my < camera.height - camera.cy
        return inside.nonzero()[:, 0]
