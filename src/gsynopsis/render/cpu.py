"""The fast CPU rasteriser: the native kernels behind the renderer protocol."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from gsynopsis._native import _core
from gsynopsis._native.runtime import empty_buffer, empty_buffer_like, thread_count
from gsynopsis.errors import SpaceError
from gsynopsis.render.base import Gaussians, Rendering, low_pass_filter
from gsynopsis.scene.camera import Camera

TILE = 32
"""Pixels along an edge of a tile."""
PAIRS_MAX = (1 << 31) - 1
PAIRS_BASE, PAIRS_PER_GAUSSIAN, PAIRS_PER_TILE = 1 << 22, 4, 2048
"""Budget of (Gaussian, tile) pairs for an image of an untrusted file, some 36 bytes each (ours).

Trained scenes take at most 5 % of it, close up and in images of 3,840 × 2,160 as well.
"""


def pairs_budget(count: int, width: int, height: int) -> int:
    """Most (Gaussian, tile) pairs that an image of `count` Gaussians may take."""
    tiles = -(-width // TILE) * -(-height // TILE)
    return min(PAIRS_MAX, PAIRS_BASE + PAIRS_PER_GAUSSIAN * count + PAIRS_PER_TILE * tiles)


class CpuRenderer:
    """Rasterises on the CPU, bit for bit the same for any number of threads.

    Computes in float32: other dtypes are converted on the way in, and the image is float32.
    A Gaussian with a value that is not finite, a zero quaternion or a covariance beyond float32 is
    not drawn. The gradient of a Gaussian whose gradient overflows is zero.
    """

    name = "cpu"
    device = torch.device("cpu")

    def __init__(
        self, threads: int | None = None, variant: str = "", *, budgeted: bool = False
    ) -> None:
        """Choose the computation; results are the same up to rounding.

        Args:
            threads: None: `thread_count()` at the time of the call.
            variant: One of `_core.variants()`; empty: the fastest.
            budgeted: Refuse images beyond `pairs_budget` before memory is allocated for them: for
                files from untrusted sources.
        """
        if variant and variant not in _core.variants():
            raise ValueError(f"variant: found {variant}, expected one of {_core.variants()}")
        self._threads = threads
        self._variant = variant
        self._budgeted = budgeted
        self._free_frames: list[_core.Frame] = []

    def render(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        """Rasterise; see `Renderer.render`.

        Raises:
            SpaceError: there are more pairs of Gaussian and tile than the budget.
        """
        job = _Job(self, gaussians, camera)
        image, alpha, visible = _Rasterize.apply(job, *_inputs(gaussians, background))
        return Rendering(image, alpha, visible, job.screen_grad)

    def render_pass(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> "RenderPass":
        """`render` and its gradients without autograd; float32, contiguous, see `Renderer.render`.

        Raises:
            SpaceError: there are more pairs of Gaussian and tile than the budget.
        """
        return RenderPass(_Job(self, gaussians, camera), gaussians, background)

    def removal_effects(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Tensor:
        """Squared change of the image if a Gaussian is left out, float32 [G], exactly.

        Summed over pixels and channels; see `measures.removal_effects`.

        Raises:
            SpaceError: there are more pairs of Gaussian and tile than the budget.
        """
        job, lease = _Job(self, gaussians, camera), self.take_frame()
        assert lease.frame is not None
        image, _, _ = job.forward(lease.frame, _inputs(gaussians, background))
        effects = empty_buffer(len(gaussians))
        lease.frame.removal_effects(_array(image), _array(effects), self.threads())
        lease.end()
        return effects

    def pairs_max(self, count: int, camera: Camera) -> int:
        """The most pairs of Gaussian and tile that an image may take."""
        return pairs_budget(count, camera.width, camera.height) if self._budgeted else PAIRS_MAX

    def threads(self) -> int:
        """The number of threads a call would use now."""
        return self._threads or thread_count()

    def take_frame(self) -> "_Lease":
        """Native memory for one image, given back when the lease ends."""
        return _Lease(self._free_frames, self._variant)


class _Lease:
    """A native frame out of a pool; several forwards may wait for their backward at once."""

    def __init__(self, pool: list[_core.Frame], variant: str) -> None:
        self._pool = pool
        self.frame: _core.Frame | None = pool.pop() if pool else _core.Frame(variant)

    def end(self) -> None:
        if self.frame is not None:
            self._pool.append(self.frame)
            self.frame = None

    def __del__(self) -> None:
        self.end()


class _Job:
    """State of one renderer call between forward and backward, tensors aside."""

    def __init__(self, renderer: CpuRenderer, gaussians: Gaussians, camera: Camera) -> None:
        self.renderer = renderer
        self.size = (camera.height, camera.width)
        self.intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
        self.w2c = np.ascontiguousarray(camera.w2c, dtype=np.float32)
        self.low_pass_filter = low_pass_filter(gaussians.focals, camera.focal_length)
        self._count = gaussians.means.shape[0]
        self.pairs_max = renderer.pairs_max(self._count, camera)
        self._screen: Tensor | None = None

    def forward(self, frame: _core.Frame, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        image = empty_buffer(*self.size, 3)
        alpha = empty_buffer(*self.size)
        visible = torch.empty(inputs[0].shape[0], dtype=torch.uint8)
        means, quats, scales, opacities, colors, background = map(_array, inputs)
        drawn = frame.render(
            means,
            quats,
            scales,
            opacities,
            colors,
            self.w2c,
            self.intrinsics,
            self.low_pass_filter,
            background,
            _array(image),
            _array(alpha),
            _array(visible),
            self.renderer.threads(),
            self.pairs_max,
        )
        if not drawn:
            height, width = self.size
            found = f"over {self.pairs_max:,} pairs of Gaussian and tile"
            advice = "render a smaller picture, if you know where the file comes from"
            picture = f"picture of {width} × {height}"
            raise SpaceError(picture, found=found, expected="those of a scene", advice=advice)
        return image, alpha, visible.view(torch.bool)

    def backward(
        self,
        frame: _core.Frame,
        inputs: tuple[Tensor, ...],
        image: Tensor,
        grad_image: Tensor,
        wanted: Sequence[bool] = (True,) * 5,
    ) -> list[Tensor]:
        """Gradients of the first five inputs, empty where not wanted.

        Keeps that of the projected centres if the centres' own is wanted.
        """
        grads = [
            empty_buffer_like(t if want else t[:0])
            for t, want in zip(inputs[:5], wanted, strict=True)
        ]
        screen = empty_buffer(self._count if wanted[0] else 0, 2)
        means, quats, scales, opacities = map(_array, inputs[:4])
        grad_means, grad_quats, grad_scales, grad_opacities, grad_colors = map(_array, grads)
        frame.backward(
            means,
            quats,
            scales,
            opacities,
            _array(image),
            _array(grad_image.to(torch.float32).contiguous()),
            grad_means,
            grad_quats,
            grad_scales,
            grad_opacities,
            grad_colors,
            _array(screen),
            self.renderer.threads(),
        )
        self._screen = screen if wanted[0] else None
        return grads

    def screen_grad(self) -> Tensor:
        return torch.zeros(self._count, 2) if self._screen is None else self._screen


class RenderPass:
    """One image, and the gradients of its Gaussians from a gradient of the image, once."""

    def __init__(self, job: _Job, gaussians: Gaussians, background: Tensor) -> None:
        """Rasterise; see `CpuRenderer.render_pass`."""
        g = gaussians
        self._job, self._lease = job, job.renderer.take_frame()
        self._inputs = (g.means, g.quats, g.scales, g.opacities, g.colors, background)
        assert self._lease.frame is not None
        self.image, alpha, visible = job.forward(self._lease.frame, self._inputs)
        self.rendering = Rendering(self.image, alpha, visible, job.screen_grad)

    def backward(self, grad_image: Tensor) -> list[Tensor]:
        """Gradients of means, quaternions, scales, opacities and colours."""
        assert self._lease.frame is not None
        grads = self._job.backward(self._lease.frame, self._inputs, self.image, grad_image)
        self._lease.end()
        return grads


class _Rasterize(torch.autograd.Function):
    """Inputs are a job, then means, quats, scales, opacities, colors and background."""

    @staticmethod
    def forward(ctx: Any, job: _Job, *inputs: Tensor) -> tuple[Tensor, ...]:
        lease = job.renderer.take_frame()
        assert lease.frame is not None
        image, alpha, visible = job.forward(lease.frame, inputs)
        ctx.mark_non_differentiable(alpha, visible)
        ctx.save_for_backward(image, alpha, *inputs)
        ctx.job, ctx.lease = job, lease
        return image, alpha, visible

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor | None, ...]:
        grad_image = grad_outputs[0]
        image, alpha, *saved = ctx.saved_tensors
        # The lease ends with the graph: there may be another backward.
        wanted = ctx.needs_input_grad[1:6]
        found = ctx.job.backward(ctx.lease.frame, tuple(saved), image, grad_image, wanted)
        grads = [grad if want else None for grad, want in zip(found, wanted, strict=True)]
        behind = None
        if ctx.needs_input_grad[6]:
            behind = torch.einsum("hwc,hw->c", grad_image, 1 - alpha)
        return None, *grads, behind


def _inputs(gaussians: Gaussians, background: Tensor) -> tuple[Tensor, ...]:
    """Means, quaternions, scales, opacities, colors and background as the kernels take them."""
    g = gaussians
    values = (g.means, g.quats, g.scales, g.opacities, g.colors, background)
    return tuple(value.to(torch.float32).contiguous() for value in values)


def _array(tensor: Tensor) -> NDArray[Any]:
    """The same memory as a NumPy array: cheaper to hand over than a tensor."""
    return tensor.detach().numpy()
