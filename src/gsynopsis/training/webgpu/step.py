"""A view of a training step wholly on the device, and Adam there.

cull, heads, assembly    anchors to Gaussians
rasterizer               Gaussians to an image
loss                     L1 and SSIM against a photo that was uploaded once
backward                 the same in reverse; gradients add up on the device
count                    growth statistics
Adam, averages           parameters stay on the device

Three numbers are read in a view, as sizes of buffers: visible anchors, Gaussians, pairs.
"""

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gsynopsis.render.base import low_pass_filter
from gsynopsis.render.webgpu.device import LANES, Buffer, Gpu
from gsynopsis.render.webgpu.rasterizer import Frame, frame_backward, render_frame
from gsynopsis.training.losses import SSIM_WEIGHT
from gsynopsis.training.optim.adam import BETAS, EPSILON, MOMENTS, Optimizer
from gsynopsis.training.webgpu.decode import DecodedView, decode_backward, decode_view
from gsynopsis.training.webgpu.resident import Resident
from gsynopsis.training.whole_step import ViewJob

LOG_ROWS, LOG_WIDTH = 1024, 8
"""Images whose losses may wait to be read, and words of each."""
PhotoKey = tuple[int, float, tuple[float, float]]


@dataclass(frozen=True)
class _Photo:
    """A photo on the device, four bytes a pixel; its mask, and the share of it that counts."""

    pixels: Buffer
    mask: Buffer | None
    share: float
    size: int


@dataclass(frozen=True)
class _Logged:
    """An image whose sums are on the device; `pixels` counts each channel."""

    job: ViewJob
    values: Tensor
    pixels: int
    share: float
    gaussians: int


class WebGpuStep:
    """Steps of a training on one device; see `training.whole_step.WholeStep`."""

    def __init__(self, gpu: Gpu, photo_bytes: int) -> None:
        """Nothing is there yet; photos take at most so many bytes, and one is kept at least."""
        self.gpu, self.held = gpu, Resident(gpu)
        self._budget, self._photo_bytes = photo_bytes, 0
        self._photos: OrderedDict[PhotoKey, _Photo] = OrderedDict()
        self._log = gpu.empty(LOG_ROWS * LOG_WIDTH)
        self._logged: list[_Logged] = []

    def train_view(self, job: ViewJob) -> Tensor:
        """See `WholeStep.train_view`."""
        with self.gpu.lending():
            return self._train_view(job)

    def _train_view(self, job: ViewJob) -> Tensor:
        view, factors, frame = self.render(job)
        pulls, totals = self._loss(job, frame)
        values = self._log_sums(job, view, frame, totals)
        grads = frame_backward(self.gpu, frame, pulls)
        if factors is not None:
            buffers = [factors, grads]
            self.gpu.run("drop_out_backward", view.count, buffers, count=view.count)
        share = job.weight / max(1, view.count)
        more = job.volume * share, job.opacity * share
        decode_backward(self.held, job.model, job.part, view, grads, more)
        if job.counters is not None and view.visible:
            self._count(job, view, frame, grads)
        self.gpu.flush()
        return values

    def render(self, job: ViewJob) -> tuple[DecodedView, Buffer | None, Frame]:
        """Queue a view's Gaussians, the factors of dropout if there is any, and the image."""
        view = decode_view(self.held, job.model, job.part, job.camera)
        factors = self._drop_out(job, view)
        low_pass = low_pass_filter(job.part.focals, job.camera.focal_length)
        arguments = (view.gaussians, view.count, job.camera, low_pass, job.background)
        return view, factors, render_frame(self.gpu, *arguments)

    def _drop_out(self, job: ViewJob, view: DecodedView) -> Buffer | None:
        if job.dropout is None or not view.count:
            return None
        share, lots = job.dropout
        factors = self.gpu.upload(lots(view.count).astype(np.float32))
        buffers, most = [factors, view.gaussians], 1 / (1 - share)
        self.gpu.run("drop_out", view.count, buffers, count=view.count, most=most)
        return factors

    def gradient(self, parameter: Tensor) -> Tensor | None:
        """See `WholeStep.gradient`."""
        grad = self.held.take_grad(parameter)
        if grad is None:
            return None
        values = self.gpu.read(grad, np.float32, parameter.numel()).copy()
        return torch.from_numpy(values).view_as(parameter)

    def move(self, optimizer: Optimizer, views: int) -> None:
        """See `WholeStep.move`."""
        for group in optimizer.groups:
            parameter = group["params"][0]
            grad = self.held.take_grad(parameter)
            if grad is None:
                continue
            state = optimizer.begin_step(parameter)
            step, count = float(state["step"]), parameter.numel()
            moved = parameter, *(state[moment] for moment in MOMENTS)
            buffers = [self.held.of(tensor, changed=True) for tensor in moved]
            rate = group["lr"] / (1 - BETAS[0] ** step)
            known = {"rate": rate, "root": 1 / math.sqrt(1 - BETAS[1] ** step), "share": 1 / views}
            self.gpu.run("adam", count, [grad, *buffers], count=count, epsilon=EPSILON, **known)
        self.held.drop_grads()
        self.gpu.flush()

    def average(self, optimizer: Optimizer, share: float) -> None:
        """See `WholeStep.average`."""
        for parameter in optimizer.parameters():
            state = optimizer.state.get(parameter)
            if not state:
                continue
            count, values = parameter.numel(), self.held.of(parameter)
            if "average" not in state:
                state["average"] = torch.empty_like(parameter.detach())
                self.gpu.copy(values, self.held.of(state["average"], changed=True), count)
            average = self.held.of(state["average"], changed=True)
            self.gpu.run("average", count, [values, average], count=count, share=share)

    def settle(self) -> None:
        """See `WholeStep.settle`."""
        logged, self._logged = self._logged, []
        if not logged:
            return
        size = len(logged) * LOG_WIDTH
        rows = self.gpu.read(self._log, np.float32, size).reshape(-1, LOG_WIDTH).astype(np.float64)
        for one, (apart, similar, squares, opacity, volume, bad, *_) in zip(
            logged, rows, strict=True
        ):
            job, drawn = one.job, max(1, one.gaussians)
            loss = (1 - SSIM_WEIGHT) * apart / one.pixels
            loss += SSIM_WEIGHT * (1 - similar / one.pixels)
            loss /= one.share
            loss += (job.volume * volume + job.opacity * opacity) / drawn
            one.values[0] = math.nan if bad else job.weight * loss
            one.values[1] = squares / one.pixels / one.share

    def home(self) -> None:
        """See `WholeStep.home`."""
        self.settle()
        self.held.home()

    def _photo(self, job: ViewJob) -> _Photo:
        key = job.photo
        if key in self._photos:
            self._photos.move_to_end(key)
            return self._photos[key]
        pixels = job.pixels()
        words = np.zeros((*pixels.shape[:2], 4), np.uint8)
        words[..., :3] = pixels
        if job.behind is not None:
            words[..., 3] = job.behind()
        buffer, mask, share = self.gpu.upload(words.view(np.uint32), "a photo"), None, 1.0
        if job.mask is not None:
            weights, share = job.mask()
            mask = self.gpu.upload(weights.astype(np.float32), "a mask")
        photo = _Photo(buffer, mask, share, words.size * (1 if mask is None else 2))
        self._photos[key] = photo
        self._photo_bytes += photo.size
        while self._photo_bytes > self._budget and len(self._photos) > 1:
            self._photo_bytes -= self._photos.popitem(last=False)[1].size
        return photo

    def _loss(self, job: ViewJob, frame: Frame) -> tuple[Buffer, Buffer]:
        """The loss's gradient on the image, and its sums by workgroup."""
        gpu, (width, height) = self.gpu, frame.size
        count, photo = width * height, self._photo(job)
        image, exposing = self._exposed(job, frame, photo)
        sums, slopes, pulls = (
            gpu.scratch(15 * count),
            gpu.scratch(9 * count),
            gpu.scratch(3 * count),
        )
        totals, shape = gpu.scratch(3 * -(-count // LANES)), {"width": width, "height": height}
        gpu.run("loss_rows", count, [image, photo.pixels, sums], **shape)
        gpu.run("loss_columns", count, [image, photo.pixels, sums, slopes, totals], **shape)
        gpu.run("slope_rows", count, [slopes, sums], **shape)
        each = job.weight / (3 * count) / photo.share
        shares = {"l1": (1 - SSIM_WEIGHT) * each, "similar": SSIM_WEIGHT * each}
        gpu.run("loss_gradient", count, [image, photo.pixels, sums, pulls], **shape, **shares)
        if exposing is not None:
            buffers = [frame.image, photo.pixels, self._bound_mask(photo), pulls]
            gpu.run("expose_backward", count, buffers, **exposing)
        return pulls, totals

    def _bound_mask(self, photo: _Photo) -> Buffer:
        """A photo's mask; a buffer must be bound where there is none, too."""
        return self._log if photo.mask is None else photo.mask

    def _exposed(
        self, job: ViewJob, frame: Frame, photo: _Photo
    ) -> tuple[Buffer, dict[str, float] | None]:
        """The image as it is compared, and the parameters of its kernel if there are any."""
        if job.gains is None and photo.mask is None:
            return frame.image, None
        gpu, count = self.gpu, frame.size[0] * frame.size[1]
        mask = self._bound_mask(photo)
        masked = int(photo.mask is not None)
        red = green = blue = 1.0
        if job.gains is not None:
            red, green, blue = job.gains(lambda: self._exposure_sums(frame, photo, mask))
        known = {"count": count, "masked": masked, "exposed": int(job.gains is not None)}
        known |= {"red": red, "green": green, "blue": blue}
        shown = gpu.scratch(4 * count)
        gpu.run("expose", count, [frame.image, photo.pixels, mask, shown], **known)
        return shown, known

    def _exposure_sums(self, frame: Frame, photo: _Photo, mask: Buffer) -> tuple[Tensor, Tensor]:
        """Read the sums by which a photo's gains are solved."""
        gpu, count = self.gpu, frame.size[0] * frame.size[1]
        groups = -(-count // LANES)
        totals, sums = [gpu.scratch(3 * groups) for _ in range(2)], gpu.scratch(LOG_WIDTH)
        known = {"count": count, "masked": int(photo.mask is not None)}
        gpu.run("exposure_sums", count, [frame.image, photo.pixels, mask, *totals], **known)
        gpu.run("log_loss", 1, [*totals, sums], pixel_groups=groups, slot_groups=groups, row=0)
        found = torch.from_numpy(gpu.read(sums, np.float32, 6).copy())
        return found[:3], found[3:]

    def _log_sums(self, job: ViewJob, view: DecodedView, frame: Frame, pixels: Buffer) -> Tensor:
        if len(self._logged) == LOG_ROWS:
            self.settle()
        gpu, slots = self.gpu, job.model.slots
        count = view.visible * slots
        groups = -(-count // LANES)
        totals = gpu.scratch(3 * groups)
        buffers = [view.starts, view.raw, view.gaussians, totals]
        gpu.run("slot_sums", count, buffers, count=view.visible, slots=slots)
        size = frame.size[0] * frame.size[1]
        known = {"pixel_groups": -(-size // LANES), "slot_groups": groups}
        gpu.run("log_loss", 1, [pixels, totals, self._log], row=len(self._logged), **known)
        values = torch.full((2,), math.nan, dtype=torch.float64)
        self._logged.append(_Logged(job, values, 3 * size, self._photo(job).share, view.count))
        return values

    def _count(self, job: ViewJob, view: DecodedView, frame: Frame, grads: Buffer) -> None:
        assert job.counters is not None
        counters = [self.held.of(t, changed=True) for t in job.counters.values()]
        buffers = [view.rows, view.starts, view.raw, grads, frame.touched, *counters]
        known = {"half_width": frame.size[0] / 2, "half_height": frame.size[1] / 2}
        slots = job.model.slots
        self.gpu.run("count_view", view.visible, buffers, count=view.visible, slots=slots, **known)
