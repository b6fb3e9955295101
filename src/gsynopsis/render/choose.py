"""Choice of the renderer."""

from typing import Literal

import torch

from gsynopsis.errors import MissingExtraError
from gsynopsis.render.base import Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.cuda import CudaRenderer
from gsynopsis.render.reference import ReferenceRenderer
from gsynopsis.render.webgpu.renderer import WebGpuRenderer

RendererName = Literal["auto", "cpu", "reference", "cuda", "webgpu"]


def make_renderer(name: RendererName = "auto", *, budgeted: bool = False) -> Renderer:
    """The renderer of that name; `auto` takes CUDA where a device and gsplat are, else the CPU.

    `budgeted` is for files from untrusted sources, see `CpuRenderer`.
    """
    if name == "reference":
        return ReferenceRenderer()
    if name == "cuda":
        return CudaRenderer()
    if name == "webgpu":
        return WebGpuRenderer()
    if name == "auto" and torch.cuda.is_available():
        try:
            return CudaRenderer()
        except MissingExtraError:
            pass
    return CpuRenderer(budgeted=budgeted)
