"""The rasterizer on a GPU behind the renderer protocol: tensors stay on the CPU."""

from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gsynopsis.render.base import Gaussians, Rendering, low_pass_filter
from gsynopsis.render.webgpu.adapters import find_adapter
from gsynopsis.render.webgpu.device import Gpu
from gsynopsis.render.webgpu.rasterizer import GAUSSIAN, GRADIENT, frame_backward, render_frame
from gsynopsis.scene.camera import Camera

WIDTHS = (3, 4, 3, 1, 3)
"""Numbers of a Gaussian's mean, quaternion, scales, opacity and colour."""


@cache
def open_gpu(name: str = "") -> Gpu:
    """The device of an adapter, opened once.

    Raises:
        MissingExtraError: wgpu is not installed.
        SettingError: there is no such adapter.
    """
    return Gpu(find_adapter(name))


class WebGpuRenderer:
    """Rasterises by WGSL kernels; Gaussians and images are the CPU's, float32."""

    name = "webgpu"
    device = torch.device("cpu")

    def __init__(self, adapter: str = "") -> None:
        """Open the adapter whose name holds `adapter`.

        Raises:
            MissingExtraError: wgpu is not installed.
            SettingError: there is no such adapter.
        """
        self.gpu = open_gpu(adapter)

    def render(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        """Rasterise; see `Renderer.render`.

        Raises:
            SpaceError: the image takes more memory than a buffer of the device.
        """
        g = gaussians
        job = _Job(
            self.gpu, camera, low_pass_filter(gaussians.focals, camera.focal_length), len(gaussians)
        )
        inputs = (g.means, g.quats, g.scales, g.opacities, g.colors, background)
        image, alpha, visible = _Rasterize.apply(job, *(t.to(torch.float32) for t in inputs))
        return Rendering(image, alpha, visible, job.screen_grad)


class _Job:
    """One image between forward and backward."""

    def __init__(self, gpu: Gpu, camera: Camera, low_pass: tuple[float, float], count: int) -> None:
        self.gpu, self.camera, self.low_pass, self.count = gpu, camera, low_pass, count
        self.screen = torch.zeros(count, 2)

    def forward(self, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        gpu, camera = self.gpu, self.camera
        *parts, background = (t.detach() for t in inputs)
        sized = zip(parts, WIDTHS, strict=True)
        rows = torch.cat([p.reshape(self.count, width) for p, width in sized], dim=1).numpy()
        red, green, blue = background.tolist()
        packed = gpu.upload(rows, f"{self.count:,} Gaussians")
        behind = (red, green, blue)
        self.frame = render_frame(gpu, packed, self.count, camera, self.low_pass, behind)
        shape = (camera.height, camera.width)
        pixels = gpu.read(self.frame.image, np.float32, 4 * shape[0] * shape[1])
        touched = gpu.read(self.frame.touched, np.uint32, self.count)
        image = torch.from_numpy(pixels.reshape(*shape, 4).copy())
        return image[..., :3].contiguous(), 1 - image[..., 3], torch.from_numpy(touched > 0)

    def backward(self, pull: Tensor) -> tuple[Tensor, ...]:
        gpu = self.gpu
        pulls = gpu.upload(pull.detach().contiguous().numpy())
        grads = gpu.read(frame_backward(gpu, self.frame, pulls), np.float32, GRADIENT * self.count)
        rows = torch.from_numpy(grads.reshape(-1, GRADIENT).copy())
        self.screen = rows[:, GAUSSIAN:]
        return rows.split((*WIDTHS, 2), dim=1)[:5]

    def screen_grad(self) -> Tensor:
        return self.screen


class _Rasterize(torch.autograd.Function):
    """Inputs are a job, then means, quats, scales, opacities, colors and background."""

    @staticmethod
    def forward(ctx: Any, job: _Job, *inputs: Tensor) -> tuple[Tensor, ...]:
        image, alpha, visible = job.forward(inputs)
        ctx.mark_non_differentiable(alpha, visible)
        ctx.save_for_backward(alpha)
        ctx.job = job
        return image, alpha, visible

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor | None, ...]:
        pull = grad_outputs[0].to(torch.float32)
        means, quats, scales, opacities, colors = ctx.job.backward(pull)
        behind = None
        if ctx.needs_input_grad[6]:
            (alpha,) = ctx.saved_tensors
            behind = torch.einsum("hwc,hw->c", pull, 1 - alpha)
        return None, means, quats, scales, opacities[:, 0], colors, behind
