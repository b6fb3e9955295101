"""Graphics adapters of this machine, and the limits that the kernels ask of them."""

import importlib
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from gsynopsis.errors import MissingExtraError, SettingError

LIMITS: Mapping[str, int] = {
    "max-storage-buffers-per-shader-stage": 10,
    "max-compute-invocations-per-workgroup": 256,
    "max-compute-workgroup-size-x": 256,
    "max-compute-workgroup-storage-size": 32768,
    "max-compute-workgroups-per-dimension": 65535,
}
"""The least that an adapter must have; the kernels assume no subgroups and no float atomics."""
BUFFER_MOST = 1 << 30
"""Bytes of one buffer that are asked for where an adapter has more: drivers are weak beyond."""
BACKENDS = ("Vulkan", "Metal", "DX12")
SIZES = ("max-buffer-size", "max-storage-buffer-binding-size")


@dataclass(frozen=True)
class Adapter:
    """A graphics adapter.

    Attributes:
        name: As its driver calls it.
        driver: The driver's own words.
        backend: `Vulkan`, `Metal`, `D3D12`.
        software: It computes on the CPU.
        buffer: Largest buffer that a kernel may read, bytes, at most `BUFFER_MOST`.
        lacks: Limits that are too low, with figures; empty if it can be used.
        handle: wgpu's object.
    """

    name: str
    driver: str
    backend: str
    software: bool
    buffer: int
    lacks: str
    handle: Any

    def text(self) -> str:
        """One line."""
        kind = "software" if self.software else "GPU"
        size = f"buffers up to {self.buffer >> 20:,} MiB"
        return f"{self.name} ({self.backend}, {kind}, {size})"


@cache
def load_wgpu() -> Any:
    """The package wgpu, looking for adapters by Vulkan, Metal and DX12 alone.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        wgpu = importlib.import_module("wgpu")
        extras = importlib.import_module("wgpu.backends.wgpu_native.extras")
    except (ImportError, OSError) as error:
        raise MissingExtraError("wgpu", "webgpu") from error
    # Without a desktop Mesa asks for its windows all the same, and complains for each adapter.
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
    extras.set_instance_extras(backends=BACKENDS)  # OpenGL shows every adapter a second time
    return wgpu


def driver_errors() -> tuple[type[Exception], ...]:
    """Errors by which wgpu tells that a driver refused something."""
    return load_wgpu().GPUError, RuntimeError


def list_adapters() -> list[Adapter]:
    """All adapters, real GPUs first.

    Raises:
        MissingExtraError: wgpu is not installed.
    """
    wgpu = load_wgpu()
    found = [_adapter(handle) for handle in wgpu.gpu.enumerate_adapters_sync()]
    return sorted(found, key=lambda adapter: adapter.software)


def find_adapter(name: str = "") -> Adapter:
    """The first adapter whose name or driver holds `name`, in any case.

    Args:
        name: Part of it; empty: any, GPUs before software drivers.

    Raises:
        MissingExtraError: wgpu is not installed.
        SettingError: there is none, or it lacks what the kernels need.
    """
    adapters = list_adapters()
    fitting = [a for a in adapters if name.lower() in f"{a.name} {a.driver}".lower()]
    if not fitting:
        there = ", ".join(a.name for a in adapters) or "no adapter"
        asked = f"an adapter called {name}" if name else "an adapter"
        raise SettingError("webgpu", found=there, expected=asked, advice="see: gsynopsis doctor")
    if fitting[0].lacks:
        raise SettingError(f"webgpu {fitting[0].name}", found=fitting[0].lacks, expected="more")
    return fitting[0]


def asked_limits(adapter: Adapter) -> dict[str, int]:
    """The limits that a device is opened with."""
    return {**LIMITS, **{name: min(adapter.handle.limits[name], BUFFER_MOST) for name in SIZES}}


def _adapter(handle: Any) -> Adapter:
    info, limits = handle.info, handle.limits
    low = [f"{name} {limits[name]}" for name, least in LIMITS.items() if limits[name] < least]
    return Adapter(
        name=str(info["device"]),
        driver=str(info["description"]),
        backend=str(info["backend_type"]),
        software=str(info["adapter_type"]).upper() == "CPU",
        buffer=min(BUFFER_MOST, *(limits[name] for name in SIZES)),
        lacks=", ".join(low),
        handle=handle,
    )
