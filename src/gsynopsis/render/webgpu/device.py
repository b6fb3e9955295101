"""A device that runs kernels in the order they are queued, and memory on it.

Nothing is computed before something is read, or `flush` is called: what was queued then goes to the
device as one command buffer.
"""

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SpaceError
from gsynopsis.render.webgpu.adapters import Adapter, asked_limits, load_wgpu
from gsynopsis.render.webgpu.kernels import load_kernel

Buffer: TypeAlias = Any
"""wgpu's buffer: 32-bit words on the device."""
LANES = 256
"""Invocations of a workgroup."""
BLOCK = 1024
"""Numbers that a workgroup scans or sorts."""
ROW_MOST = 65_535
"""Workgroups along one axis of a dispatch."""
UNIFORM = 256
"""Alignment of parameters, bytes."""
ARENA = 1 << 20
"""Bytes of parameters after which the queue is flushed."""

USAGE = ("STORAGE", "COPY_SRC", "COPY_DST")


def size_class(size: int) -> int:
    """The least of 4, 5, 6 or 7 times a power of two that is not below a size."""
    step = 1 << max(4, (size - 1).bit_length() - 3)
    return -(-size // step) * step


class Gpu:
    """One opened adapter: buffers, queued kernels, reads; not for several threads.

    Attributes:
        adapter: What was opened.
        limit: Largest buffer, bytes.
        counts: Since it was opened: bytes `up` to the device and `down` from it, `reads` that
            waited for it, `dispatches`, `submits`, and bytes of buffers that were `made`.
    """

    def __init__(self, adapter: Adapter) -> None:
        """Open it with the limits of `asked_limits`."""
        wgpu = load_wgpu()
        self.adapter = adapter
        self.limit = adapter.buffer
        self.counts = dict.fromkeys(("up", "down", "reads", "dispatches", "submits", "made"), 0)
        self._device = adapter.handle.request_device_sync(required_limits=asked_limits(adapter))
        self._usage = 0
        for name in USAGE:
            self._usage |= getattr(wgpu.BufferUsage, name)
        self._uniform = wgpu.BufferUsage.UNIFORM | wgpu.BufferUsage.COPY_DST
        self._pipelines: dict[str, Any] = {}
        self._layouts: dict[str, Any] = {}
        self._waiting: dict[int, list[Buffer]] = {}
        self._lent: list[Buffer] | None = None
        self._queued: list[tuple[Any, ...]] = []
        self._arena = bytearray()

    def empty(self, words: int, what: str = "an image") -> Buffer:
        """A buffer of 32-bit words, zeros.

        Raises:
            SpaceError: it is larger than this device's buffers.
        """
        return self._create(max(64, -(-words * 4 // 16) * 16), what)

    def scratch(self, words: int, what: str = "an image") -> Buffer:
        """A buffer of at least so many 32-bit words, with anything in them.

        Within `lending` it is one that was used before, where there is one of its size.
        """
        size = size_class(max(64, 4 * words))
        size = size if size <= self.limit else max(64, -(-words * 4 // 16) * 16)
        waiting = self._waiting.get(size)
        buffer = waiting.pop() if waiting else self._create(size, what)
        if self._lent is not None:
            self._lent.append(buffer)
        return buffer

    @contextmanager
    def lending(self) -> Generator[None]:
        """Take back every `scratch` of the block at its end, for other blocks to use.

        New ones would be filled with zeros. What this block had no use for is given up, where it is
        more than the block used.
        """
        self._lent = []
        try:
            yield
        finally:
            lent, self._lent = self._lent, None
            idle = sum(size * len(buffers) for size, buffers in self._waiting.items())
            if idle > sum(buffer.size for buffer in lent):
                self._waiting.clear()
            for buffer in lent:
                self._waiting.setdefault(buffer.size, []).append(buffer)

    def _create(self, size: int, what: str) -> Buffer:
        if size > self.limit:
            found = f"a buffer of {size >> 20:,} MiB"
            expected = f"at most {self.limit >> 20:,} MiB on {self.adapter.name}"
            advice = "train smaller photos, or on the CPU: --device cpu"
            raise SpaceError("webgpu", what, found=found, expected=expected, advice=advice)
        self.counts["made"] += size
        return self._device.create_buffer(size=size, usage=self._usage)

    def upload(self, array: NDArray[Any], what: str = "an array") -> Buffer:
        """A new buffer that holds an array of 32-bit numbers."""
        buffer = self.empty(array.size, what)
        self.write(buffer, array)
        return buffer

    def write(self, buffer: Buffer, array: NDArray[Any]) -> None:
        """Replace a buffer's first words, in order with what was queued."""
        if array.size == 0:
            return
        self.flush()
        raw = np.ascontiguousarray(array).view(np.uint8).reshape(-1)
        self.counts["up"] += raw.size
        self._device.queue.write_buffer(buffer, 0, raw)

    def read(self, buffer: Buffer, dtype: Any, count: int, offset: int = 0) -> NDArray[Any]:
        """Words of a buffer once all that is queued is done."""
        self.flush()
        if count == 0:
            return np.zeros(0, dtype)
        self.counts["down"] += 4 * count
        self.counts["reads"] += 1
        raw = self._device.queue.read_buffer(buffer, 4 * offset, 4 * count)
        return np.frombuffer(raw, dtype)

    def clear(self, buffer: Buffer) -> None:
        """Queue zeros for a whole buffer."""
        self._queued.append(("clear", buffer))

    def copy(self, source: Buffer, target: Buffer, words: int) -> None:
        """Queue a copy of a buffer's first words to those of another."""
        if words:
            self._queued.append(("copy", source, target, 4 * words))

    def run(self, name: str, count: int, buffers: Sequence[Buffer], /, **values: float) -> None:
        """Queue a kernel for `count` invocations in workgroups of `LANES`."""
        self.run_groups(name, -(-count // LANES), buffers, **values)

    def run_groups(
        self, name: str, count: int, buffers: Sequence[Buffer], /, **values: float
    ) -> None:
        """Queue a kernel for `count` workgroups, in rows where they are many."""
        down = max(1, -(-count // ROW_MOST))
        self.run_grid(name, (-(-count // down), down), buffers, **values)

    def run_grid(
        self, name: str, groups: tuple[int, int], buffers: Sequence[Buffer], /, **values: float
    ) -> None:
        """Queue a kernel for workgroups across and down."""
        if not groups[0] * groups[1]:
            return
        kernel = load_kernel(name)
        if len(buffers) != kernel.buffers:
            raise ValueError(f"kernel {name}: {len(buffers)} buffers of {kernel.buffers}")
        raw = kernel.packed(**values)
        offset = len(self._arena)
        self._arena += raw + bytes(-len(raw) % UNIFORM)
        self._queued.append(("run", name, groups, list(buffers), offset, len(raw)))
        if len(self._arena) > ARENA:
            self.flush()

    def flush(self) -> None:
        """Send all that is queued to the device."""
        queued, self._queued = self._queued, []
        if not queued:
            return
        arena = None
        if self._arena:
            arena = self._device.create_buffer(size=len(self._arena), usage=self._uniform)
            self._device.queue.write_buffer(arena, 0, bytes(self._arena))
            self.counts["up"] += len(self._arena)
            self._arena = bytearray()
        encoder, open_pass = self._device.create_command_encoder(), None
        for kind, *rest in queued:
            if kind == "run":
                open_pass = open_pass or encoder.begin_compute_pass()
                self._encode(open_pass, arena, *rest)
                continue
            if open_pass is not None:
                open_pass.end()
                open_pass = None
            if kind == "clear":
                encoder.clear_buffer(rest[0])
            else:
                source, target, size = rest
                encoder.copy_buffer_to_buffer(source, 0, target, 0, size)
        if open_pass is not None:
            open_pass.end()
        self._device.queue.submit([encoder.finish()])
        self.counts["submits"] += 1

    def scan(self, values: Buffer, count: int) -> None:
        """Queue exclusive prefix sums of the first `count` words, in place."""
        blocks = -(-count // BLOCK)
        sums = self.scratch(blocks)
        self.run_groups("scan", blocks, [values, sums], count=count)
        if blocks > 1:
            self.scan(sums, blocks)
            self.run("scan_add", count, [values, sums], count=count)

    def sort(self, keys: Buffer, values: Buffer, count: int, bits: int) -> tuple[Buffer, Buffer]:
        """Queue a stable sort by the low bits of keys; the buffers given are used up."""
        blocks = -(-count // BLOCK)
        counts = self.scratch(256 * blocks)
        other = self.scratch(count), self.scratch(count)
        sides = (keys, values), other
        for shift in range(0, bits, 8):
            (keys, values), (to_keys, to_values) = sides
            known = {"count": count, "shift": shift, "blocks": blocks}
            self.run_groups("radix_count", blocks, [keys, counts], **known)
            self.scan(counts, 256 * blocks)
            buffers = [keys, values, counts, to_keys, to_values]
            self.run_groups("radix_scatter", blocks, buffers, **known)
            sides = sides[1], sides[0]
        return sides[0]

    def _encode(
        self,
        compute: Any,
        arena: Any,
        name: str,
        groups: tuple[int, int],
        buffers: list[Buffer],
        offset: int,
        size: int,
    ) -> None:
        pipeline, layout = self._pipeline(name)
        entries: list[dict[str, Any]] = []
        if size:
            whole = {"buffer": arena, "offset": offset, "size": size}
            entries.append({"binding": 0, "resource": whole})
        for number, buffer in enumerate(buffers, start=1):
            whole = {"buffer": buffer, "offset": 0, "size": buffer.size}
            entries.append({"binding": number, "resource": whole})
        group = self._device.create_bind_group(layout=layout, entries=entries)
        compute.set_pipeline(pipeline)
        compute.set_bind_group(0, group)
        compute.dispatch_workgroups(*groups)
        self.counts["dispatches"] += 1

    def _pipeline(self, name: str) -> tuple[Any, Any]:
        if name not in self._pipelines:
            module = self._device.create_shader_module(code=load_kernel(name).source)
            stage = {"module": module, "entry_point": "main"}
            made = self._device.create_compute_pipeline(layout="auto", compute=stage)
            self._pipelines[name] = made
            self._layouts[name] = made.get_bind_group_layout(0)
        return self._pipelines[name], self._layouts[name]
