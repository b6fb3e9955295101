"""Choice of the renderer, and of the device that trains."""

from dataclasses import dataclass
from typing import Literal, cast, get_args

import torch

from gsynopsis.errors import GsynopsisError, MissingExtraError, SettingError
from gsynopsis.render.base import Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.cuda import CudaRenderer
from gsynopsis.render.reference import ReferenceRenderer
from gsynopsis.render.webgpu.adapters import driver_errors, list_adapters
from gsynopsis.render.webgpu.renderer import WebGpuRenderer
from gsynopsis.render.webgpu.start_test import run_start_test

RendererName = Literal["auto", "cpu", "reference", "cuda", "webgpu"]
DEVICES = "auto, cpu, cuda, webgpu or webgpu:NAME"


@dataclass(frozen=True)
class TakenDevice:
    """A renderer whose device trains, and in a few words what it is and why it was taken."""

    renderer: Renderer
    why: str


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
    if name == "auto" and (renderer := _cuda()) is not None:
        return renderer
    return CpuRenderer(budgeted=budgeted)


def fresh(renderer: Renderer) -> Renderer:
    """A renderer of the same device without frames: the CPU's keep the memory of their largest.

    Of millions of splats that is more than the splats take, and more than a training needs.
    """
    return make_renderer("cpu") if renderer.name == "cpu" else renderer


def take_device(asked: str = "auto") -> TakenDevice:
    """The device of a training.

    `auto` takes CUDA where a device and gsplat are, else the CPU, and names a GPU that wgpu finds:
    its kernels ran on no card yet, and the test at start is of the rasterizer alone. A WebGPU
    device that is asked for and fails its test is refused, and the CPU trains.

    Args:
        asked: `auto`, `cpu`, `cuda`, `reference`, `webgpu`, or `webgpu:NAME` for the adapter whose
            name holds NAME.

    Raises:
        MissingExtraError: what was asked for by name needs a package that is not installed.
        SettingError: there is no such device.
    """
    kind, _, adapter = asked.partition(":")
    if kind not in get_args(RendererName) or (adapter and kind != "webgpu"):
        raise SettingError("--device", found=asked, expected=DEVICES)
    if kind == "webgpu":
        return _tested(WebGpuRenderer(adapter))
    if kind != "auto":
        return TakenDevice(make_renderer(cast(RendererName, kind)), f"{kind}, asked for")
    if (renderer := _cuda()) is not None:
        return TakenDevice(renderer, f"cuda, {torch.cuda.get_device_name()}, found")
    try:
        gpus = [adapter.name for adapter in list_adapters() if not adapter.software]
    except (MissingExtraError, RuntimeError):
        return TakenDevice(CpuRenderer(), "cpu, no CUDA device and no wgpu")
    if not gpus:
        return TakenDevice(CpuRenderer(), "cpu, no GPU was found")
    told = f"cpu; {gpus[0]} is there: --device webgpu tries it, which ran on no card yet"
    return TakenDevice(CpuRenderer(), told)


def _cuda() -> Renderer | None:
    """CUDA's renderer, if there are a device and gsplat."""
    if torch.cuda.is_available():
        try:
            return CudaRenderer()
        except MissingExtraError:
            pass
    return None


def _tested(renderer: WebGpuRenderer) -> TakenDevice:
    """A WebGPU device if it passes its test, else the CPU."""
    adapter = renderer.gpu.adapter
    try:
        test = run_start_test(renderer)
    except (*driver_errors(), GsynopsisError) as error:
        told = f"webgpu {adapter.name} failed its test and is refused: {error}"
        return TakenDevice(CpuRenderer(), f"cpu, as {' '.join(told.split())}")
    if not test.passed:
        refused = f"webgpu {adapter.name} failed its test and is refused: {test.text()}"
        return TakenDevice(CpuRenderer(), f"cpu, as {refused}")
    return TakenDevice(renderer, f"webgpu, {adapter.text()}, asked for; its test: {test.text()}")
