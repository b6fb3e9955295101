"""Training photos on a GPU, brought there before the step that looks at them.

A thread decodes a photo, or maps it from its file, and a stream of its own copies it from pinned
memory, while the device is busy with other steps. The CPU needs none of this; tests run it there.
"""

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import torch
from torch import Tensor

from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import Scene

Key = tuple[int, float, Shift]


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
        return self._asked((view, factor, jitter)).result().ready()

    def expect(self, view: int, factor: float, jitters: Sequence[Shift]) -> None:
        """These are needed soon; returns at once."""
        for jitter in jitters:
            self._asked((view, factor, jitter))

    def close(self) -> None:
        """Ends the thread and forgets all photos; whoever asks for one again starts anew."""
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
        size, future = 3 * camera.width * camera.height, self._thread.submit(self._load, key)
        self._photos[key] = size, future
        self.held += size
        while self.held > self.budget and len(self._photos) > 1:
            self.held -= self._photos.popitem(last=False)[1][0]
        return future

    def _load(self, key: Key) -> "_Photo":
        image = self.scene.image(*key)
        if self._stream is None:
            return _Photo(torch.from_numpy(image.copy()).to(self.device), None)
        with torch.cuda.stream(self._stream):  # in a thread, this also chooses the GPU
            pixels = torch.empty(image.shape, dtype=torch.uint8, pin_memory=True)
            pixels.numpy()[:] = image
            moved = pixels.to(self.device, non_blocking=True)
            arrival = torch.cuda.Event()
            arrival.record(self._stream)
        return _Photo(moved, arrival)


class _Photo:
    """A photo on its way to the device, and the event of its arrival."""

    def __init__(self, pixels: Tensor, arrival: torch.cuda.Event | None) -> None:
        self._pixels, self._arrival = pixels, arrival

    def ready(self) -> Tensor:
        """Its pixels; the device's work that follows waits for them."""
        if self._arrival is not None:
            stream = torch.cuda.current_stream(self._pixels.device)
            stream.wait_event(self._arrival)
            # Its memory is the other stream's: not to be used again before this one is done.
            self._pixels.record_stream(stream)
        return self._pixels
