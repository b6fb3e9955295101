"""Training photos and their masks on a GPU, copied there before the step that uses them.

A thread decodes a photo, or maps it from its file, and a CUDA stream of its own copies it from
pinned memory, while the device is busy with other steps. The CPU needs none of this; tests run it
there.
"""

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import torch
from torch import Tensor

from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import Scene

Key = tuple[int, float, Shift]
Mask = tuple[Tensor, float]
"""Shares of pixels that count, [H, W], and their mean."""


class DevicePhotos:
    """Photos by view, factor and jitter, uint8 on a device; the least recently used go first.

    They take at most the budget of the scene's own cache, bytes, and one photo at least. The host
    waits for the thread where a photo comes late, but never for the device.
    """

    def __init__(self, scene: Scene, device: torch.device) -> None:
        """Nothing is loaded yet."""
        self.scene, self.device, self.budget = scene, device, scene.cache.budget
        self.held = 0
        self._photos: OrderedDict[Key, tuple[int, Future[_Photo]]] = OrderedDict()
        self._thread: ThreadPoolExecutor | None = None
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None

    def get(self, view: int, factor: float, jitter: Shift = STILL) -> Tensor:
        """The photo of `Scene.image`, uint8 [H, W, 3], for work that is queued from now on.

        Raises:
            SceneError: The pixel data cannot be decoded.
        """
        return self._asked((view, factor, jitter)).result().ready()[0]

    def mask(self, view: int, factor: float, jitter: Shift = STILL) -> Mask | None:
        """The mask of `Scene.mask`, float32 [H, W], and its mean; None: nothing is masked.

        Raises:
            SceneError: The pixel data cannot be decoded.
        """
        photo = self._asked((view, factor, jitter)).result()
        return (photo.ready()[1], photo.share) if self._masked(view) else None

    def expect(self, view: int, factor: float, jitters: Sequence[Shift]) -> None:
        """These are needed soon; returns at once."""
        for jitter in jitters:
            self._asked((view, factor, jitter))

    def close(self) -> None:
        """End the thread and forget all photos; the next request starts it again."""
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)
        self._thread, self.held = None, 0
        self._photos.clear()

    def _asked(self, key: Key) -> "Future[_Photo]":
        if key in self._photos:
            self._photos.move_to_end(key)
            return self._photos[key][1]
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "device photos")
        camera = self.scene.camera(key[0], key[1])
        each = 3 + 4 * self._masked(key[0])  # bytes of a pixel and of its mask
        size, future = each * camera.width * camera.height, self._thread.submit(self._load, key)
        self._photos[key] = size, future
        self.held += size
        while self.held > self.budget and len(self._photos) > 1:
            self.held -= self._photos.popitem(last=False)[1][0]
        return future

    def _load(self, key: Key) -> "_Photo":
        arrays, share = [self.scene.image(*key)], 1.0
        mask = self.scene.mask(*key) if self._masked(key[0]) else None
        if mask is not None:
            arrays, share = [*arrays, mask], float(mask.mean())
        pixels = [torch.tensor(array) for array in arrays]
        if self._stream is None:
            return _Photo([tensor.to(self.device) for tensor in pixels], share, None)
        with torch.cuda.stream(self._stream):  # in a thread, this also chooses the GPU
            moved = [tensor.pin_memory().to(self.device, non_blocking=True) for tensor in pixels]
            arrival = torch.cuda.Event()
            arrival.record(self._stream)
        return _Photo(moved, share, arrival)

    def _masked(self, view: int) -> bool:
        counted = self.scene.reading.masks in ("loss", "alpha")
        return counted and self.scene.views[view].mask is not None


class _Photo:
    """A photo on its way to the device, with its mask and the event of their arrival."""

    def __init__(
        self, tensors: list[Tensor], share: float, arrival: torch.cuda.Event | None
    ) -> None:
        self.share = share
        self._tensors, self._arrival = tensors, arrival

    def ready(self) -> list[Tensor]:
        """Its pixels and its mask if it has one; the device's work that follows waits for them."""
        if self._arrival is not None:
            stream = torch.cuda.current_stream(self._tensors[0].device)
            stream.wait_event(self._arrival)
            for tensor in self._tensors:
                # Its memory is the other stream's: not to be used again before this one is done.
                tensor.record_stream(stream)
        return self._tensors
