"""`gsynopsis doctor`: installed parts, and remedies for missing ones."""

import importlib
import json
import os
import platform
import shutil
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Annotated

from gsynopsis import __version__
from gsynopsis.cli.defaults import said
from gsynopsis.errors import SettingError
from gsynopsis.files import publish

NATIVE = "gsynopsis._native._core"
EXTRAS = {
    "torch": "train",
    "safetensors": "train",
    "matplotlib": "plots",
    "jinja2": "plots",
    "pycolmap": "sfm",
}
"""Distributions that an extra brings."""
GSPLAT = "1.5.3"
"""The gsplat that the CUDA renderer is written for. It compiles itself for the PyTorch at hand when
first used, with nvcc of that PyTorch's CUDA version; a build for 2.11 with CUDA 13.0 was made."""


@dataclass(frozen=True)
class Finding:
    """One result of an inspection.

    Attributes:
        name: Name of the program, package or device.
        found: Version or description; empty if missing.
        needed: True if training on the CPU is impossible without it.
        advice: Remedy; empty if there is nothing to do.
    """

    name: str
    found: str
    needed: bool = False
    advice: str = ""


@dataclass(frozen=True)
class Doctor:
    """Say what is installed, and what to do about what is not.

    Ends with exit code 0 if training on the CPU is possible, else 1. With --gpu: 0 if the GPU
    passed, 1 if it failed, 2 if there is none.

    Attributes:
        json: Print JSON.
        gpu: Compare the GPU with the CPU instead, in some minutes: rasterizer, training steps at
            three sizes, the demo's training, and milliseconds of each part.
        device: GPU of --gpu: `cuda`, `webgpu`, or `webgpu:NAME` for the adapter whose name holds
            NAME.
        out: Write the result of --gpu as JSON.
    """

    json: bool = False
    gpu: bool = False
    device: str = "cuda"
    out: Annotated[Path | None, said("none")] = None

    def run(self) -> int:
        """Look and print."""
        if self.gpu:
            return self._check_gpu()
        if self.device != "cuda":
            raise SettingError("--device", found="it without --gpu", expected="both or neither")
        if self.out is not None:
            raise SettingError("--out", found="it without --gpu", expected="both or neither")
        findings = examine()
        able = can_train(findings)
        if self.json:
            document = {"can_train": able, "findings": [asdict(f) for f in findings]}
            print(json.dumps(document, indent=2, ensure_ascii=False))
        else:
            print(findings_text(findings))
        return 0 if able else 1

    def _check_gpu(self) -> int:
        from gsynopsis.selftest.check_device import check_device

        document = check_device(self.device, lambda line: print(line, file=sys.stderr, flush=True))
        text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
        if self.out is not None:
            publish(self.out, text)
            print(f"wrote {self.out}", file=sys.stderr)
        if self.json:
            print(text, end="")
        else:
            print("The GPU passed." if document["passed"] else "The GPU FAILED: use --device cpu")
        return 0 if document["passed"] else 1


def can_train(findings: list[Finding]) -> bool:
    """True if training on the CPU lacks nothing."""
    return all(finding.found for finding in findings if finding.needed)


def findings_text(findings: list[Finding]) -> str:
    """A line per finding, marked, and a verdict."""
    width = max(len(finding.name) for finding in findings)
    lines: list[str] = []
    for finding in findings:
        mark = "✓" if finding.found else "✗" if finding.needed else "–"
        what = finding.found or "not there"
        what += f"; {finding.advice}" if finding.advice else ""
        lines.append(f"{mark} {finding.name.ljust(width)}  {what}")
    verdict = "Training on the CPU is possible."
    if not can_train(findings):
        verdict = "Training is not possible until what is marked ✗ is there."
    return "\n".join([*lines, "", verdict])


def examine() -> list[Finding]:
    """Everything there is to know, in the order of importance."""
    torch = module_or_none("torch")
    return [
        Finding("gsynopsis", __version__),
        Finding("python", f"{platform.python_version()} ({sys.executable})", needed=True),
        _package("numpy", needed=True),
        _torch(torch),
        _threads(torch),
        _package("safetensors", needed=True),
        _native(),
        _cuda(torch),
        _gsplat(),
        *_webgpu(torch),
        _package("matplotlib", what="for report.html"),
        _package("jinja2", what="for report.html"),
        _package("pycolmap", what="for photos without poses"),
        Finding(
            "LPIPS weights",
            "",
            advice="reports say n/a without `evaluate --lpips WEIGHTS`",
        ),
        _ffmpeg(),
    ]


def module_or_none(name: str) -> ModuleType | None:
    """A module if it can be imported; a broken one counts as missing."""
    try:
        return importlib.import_module(name)
    except (ImportError, OSError):
        return None


def _package(name: str, *, needed: bool = False, what: str = "") -> Finding:
    try:
        found = version(name)
    except PackageNotFoundError:
        extra = EXTRAS.get(name)
        source = f"gsynopsis[{extra}]" if extra else name
        purpose = f"{what}: " if what else ""
        return Finding(name, "", needed, f"{purpose}pip install '{source}'")
    return Finding(name, found, needed)


def _torch(torch: ModuleType | None) -> Finding:
    if torch is None:
        return Finding("torch", "", needed=True, advice="pip install 'gsynopsis[train]'")
    return Finding("torch", torch.__version__, needed=True)


def _threads(torch: ModuleType | None) -> Finding:
    """Finding of the thread count, the processors, and PyTorch's behaviour while idle."""
    if torch is None:
        return Finding("threads", "", advice="torch chooses how many")
    from gsynopsis._native.runtime import cpu_quota, thread_count
    from gsynopsis.evaluation.environment import usable_cores

    quota, policy = cpu_quota(), os.environ.get("OMP_WAIT_POLICY", "")
    granted = "no CPU quota" if quota is None else f"CPU quota {quota:g}"
    sleep = policy.upper() == "PASSIVE"
    idle = "sleep while idle" if sleep else f"spin while idle (OMP_WAIT_POLICY={policy or 'unset'})"
    found = f"{thread_count()} for {usable_cores()} cores, {granted}; PyTorch's {idle}"
    advice = "" if "OMP_NUM_THREADS" in os.environ else "OMP_NUM_THREADS chooses another number"
    return Finding("threads", found, advice=advice)


def _native() -> Finding:
    core = module_or_none(NATIVE)
    name = "native extension"
    if core is None:
        advice = "install a C++ compiler (g++), then: pip install --force-reinstall gsynopsis"
        return Finding(name, "", needed=True, advice=advice)
    variants: Callable[[], Iterable[str]] | None = getattr(core, "variants", None)
    found = ", ".join(variants()) if variants else "loaded"
    return Finding(name, found, needed=True)


def _cuda(torch: ModuleType | None) -> Finding:
    if torch is None or not torch.cuda.is_available():
        return Finding("CUDA device", "", advice="optional: the CPU rasteriser is used")
    if torch.version.hip:
        # AMD's cards are `cuda` to PyTorch; gsplat's own sources are NVIDIA's.
        advice = "not tried on ROCm; gsplat has to be AMD's fork, github.com/ROCm/gsplat"
        return Finding("CUDA device", f"{torch.cuda.get_device_name()} (ROCm)", advice=advice)
    advice = "check it: gsynopsis doctor --gpu"
    return Finding("CUDA device", str(torch.cuda.get_device_name()), advice=advice)


def _gsplat() -> Finding:
    finding = _package("gsplat")
    if finding.found and not finding.found.startswith(GSPLAT):
        advice = f"written for {GSPLAT}, others were not looked at: pip install 'gsplat=={GSPLAT}'"
        return replace(finding, advice=advice)
    if finding.found:
        return finding
    return Finding("gsplat", "", advice="optional, for CUDA: pip install 'gsynopsis[cuda]'")


def _webgpu(torch: ModuleType | None) -> list[Finding]:
    """A finding for each graphics adapter, with its test against the CPU."""
    if module_or_none("wgpu") is None or torch is None or module_or_none(NATIVE) is None:
        advice = "optional, for GPUs of any maker: pip install 'gsynopsis[webgpu]'"
        return [Finding("WebGPU", "", advice=advice)]
    from gsynopsis.render.webgpu.adapters import list_adapters

    adapters = list_adapters()
    if not adapters:
        advice = "optional: a driver for Vulkan (Debian: mesa-vulkan-drivers), Metal or DX12"
        return [Finding("WebGPU", "", advice=advice)]
    return [Finding("WebGPU", a.text(), advice=_webgpu_test(a.name)) for a in adapters]


def _webgpu_test(adapter: str) -> str:
    from gsynopsis.render.choose import take_device

    taken = take_device(f"webgpu:{adapter}")
    return taken.why.rsplit("; ", 1)[-1] if taken.renderer.name == "webgpu" else taken.why


def _ffmpeg() -> Finding:
    program = shutil.which("ffmpeg")
    advice = "" if program else "optional, to read videos and write mp4 flights (gif needs nothing)"
    return Finding("ffmpeg", program or "", advice=advice)
