"""All that a device has to show before trainings are left to it; what `doctor --gpu` runs."""

import importlib
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from gsynopsis.config import resolve_settings
from gsynopsis.evaluation.environment import this_build, this_machine
from gsynopsis.jobs.train import train
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import take_device
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.webgpu.renderer import WebGpuRenderer
from gsynopsis.runs.folder import Run
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.selftest.findings import Finding, judged
from gsynopsis.selftest.rasterizer import Side, check_rasterizer
from gsynopsis.selftest.training_step import (
    StepTimes,
    check_step,
    time_step,
    trained_state,
    twin_of,
)
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.observer import Silent, StepInfo

EVERY = 50
"""Steps between two readings of a training's curve."""
LIMITS = {"curve": 1.0, "level": 0.3}
"""dB by which a device's training may differ from the CPU's: smoothed training PSNR at any reading
after the first two, and each level's held-out PSNR, where it is lower."""


@dataclass(frozen=True)
class Effort:
    """Sizes of a check.

    Attributes:
        width: Of the demo's photos, pixels; their height is two thirds.
        views: Photos of the demo.
        scales: Divisors of their size at which a step is compared and timed.
        grow: Steps that models are trained for before that.
        steps: Steps of the full training of the demo; its levels take 5/3 as many.
        rounds: Steps that are timed.
    """

    width: int = 960
    views: int = 40
    scales: tuple[float, ...] = (8.0, 2.0, 1.0)
    grow: int = 200
    steps: int = 300
    rounds: int = 10


class Curve(Silent):
    """Smoothed training PSNR, dB, after every so many steps of each phase."""

    def __init__(self) -> None:
        self.points: dict[str, float] = {}

    def on_step(self, info: StepInfo) -> None:
        """Reads every `EVERY` steps."""
        if info.step % EVERY == 0:
            self.points[f"{info.phase} {info.step}"] = round(info.psnr, 3)


def check_device(
    name: str, tell: Callable[[str], None], effort: Effort | None = None
) -> dict[str, Any]:
    """Compare a device with the CPU, and time it.

    Args:
        name: As `--device` takes it, but for `auto`.
        tell: Hears a line as each part ends.
        effort: Sizes; minutes on a GPU by default.

    Returns:
        A document for JSON: `passed`, `checks` with their errors, `times` in milliseconds by the
        pixels of a photo, `trainings` with curve, levels and seconds, `machine`.

    Raises:
        MissingExtraError: the device or what drives it is not there.
        SettingError: there is no such device.
    """
    renderer, effort = _renderer(name), effort or Effort()
    cpu = CpuRenderer()
    found = check_rasterizer(Side(renderer, torch.float32), Side(cpu, torch.float32))
    for one in found:
        tell(one.text())
    with tempfile.TemporaryDirectory(prefix="gsynopsis-check-") as folder:
        views, width, height = effort.views, effort.width, effort.width * 2 // 3
        made = make_scene("room", Path(folder) / "room", views=views, width=width, height=height)
        scene = load_scene(made)
        times: dict[str, dict[str, StepTimes]] = {}
        for scale in effort.scales:
            own, own_times = _check_steps(scene, renderer, cpu, scale, effort)
            found.append(own)
            times[own.name] = own_times
            tell(own.text())
            for device, one in own_times.items():
                parts = ", ".join(f"{part} {ms:.2f}" for part, ms in one.parts.items())
                tell(f"  {device}: {one.whole:.1f} ms a step of {one.anchors:,} anchors; {parts}")
        scale = effort.scales[len(effort.scales) // 2]
        trainings = {
            side: _trained(scene, Path(folder) / side, side, scale, effort)
            for side in dict.fromkeys((name, "cpu"))
        }
        for side, training in trainings.items():
            tell(f"{side}: demo in {training['seconds']:.0f} s, levels {training['levels']} dB")
        found.append(compare_trainings(trainings[name], trainings["cpu"]))
        tell(found[-1].text())
    return {
        "device": name,
        "passed": not any(one.failed for one in found),
        "checks": [asdict(one) for one in found],
        "times": {key: {k: asdict(v) for k, v in own.items()} for key, own in times.items()},
        "trainings": trainings,
        "machine": machine_record(renderer.device),
    }


def _renderer(name: str) -> Renderer:
    kind, _, adapter = name.partition(":")
    return WebGpuRenderer(adapter) if kind == "webgpu" else take_device(name).renderer


def compare_trainings(found: Mapping[str, Any], oracle: Mapping[str, Any]) -> Finding:
    """Differences of two trainings, dB: their curves after two readings, and lower levels."""
    late = list(oracle["curve"])[2:]
    errors = {f"{at}.curve": abs(found["curve"][at] - oracle["curve"][at]) for at in late}
    pairs = zip(found["levels"], oracle["levels"], strict=True)
    errors |= {f"L{k}.level": max(0.0, b - a) for k, (a, b) in enumerate(pairs)}
    return judged("training", errors, LIMITS)


def machine_record(device: torch.device) -> dict[str, Any]:
    """Facts that a result depends on."""
    record: dict[str, Any] = asdict(this_machine(device)) | {"commit": this_build().commit}
    if device.type == "cuda":
        properties = torch.cuda.get_device_properties(device)
        record |= {
            "gpu_bytes": properties.total_memory,
            "gpu_capability": f"{properties.major}.{properties.minor}",
            "cuda": torch.version.cuda,
            "hip": torch.version.hip,
            "gsplat": importlib.import_module("gsplat").__version__,
            "gsplat_binary": _gsplat_binary(),
        }
    return record


def _gsplat_binary() -> str:
    """File name of the compiled part: `csrc…` came ready built, `gsplat_cuda…` was built here."""
    backend = importlib.import_module("gsplat.cuda._backend")
    return str(getattr(backend._C, "__file__", backend._C)).rsplit("/", 1)[-1]


def _check_steps(
    scene: Scene, renderer: Renderer, cpu: Renderer, scale: float, effort: Effort
) -> tuple[Finding, dict[str, StepTimes]]:
    """One size: errors of a step, and its times on either device."""
    asked = {"scale": scale, "train.steps": 2 * effort.grow}
    config = resolve_settings("standard", len(scene.train), asked).config
    state = trained_state(scene, config, renderer, effort.grow)
    twin, camera = twin_of(state, cpu), scene.camera(0, scale)
    finding = check_step(f"step {camera.width} × {camera.height}", state, twin)
    times = {renderer.name: time_step(state, effort.rounds)}
    if renderer.name != cpu.name:
        times[cpu.name] = time_step(twin, max(2, effort.rounds // 5))
    if state.photos is not None:
        state.photos.close()
    return finding, times


def _trained(scene: Scene, out: Path, device: str, scale: float, effort: Effort) -> dict[str, Any]:
    """A whole training: its curve, held-out PSNR of its levels, bytes and seconds."""
    curve = Curve()
    settings = {"scale": scale, "train.steps": effort.steps}
    run: Run = train(
        scene, "standard", out, curve, settings=settings, device=device, photo_pixels=0
    )
    report = run.report
    assert report is not None  # evaluation was ordered
    return {
        "pixels": [report.width, report.height],
        "curve": curve.points,
        "levels": [round(level.quality.psnr_full, 3) for level in report.levels],
        "bytes": [level.sizes.bytes_compact for level in report.levels],
        "anchors": report.levels[-1].anchors,
        "seconds": round(report.provenance.train_seconds or 0.0, 1),
    }
