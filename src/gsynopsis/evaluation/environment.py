"""Machine and build that made a measurement."""

import os
import platform
import subprocess
from dataclasses import dataclass
from pathlib import Path

import torch

import gsynopsis
from gsynopsis._native.runtime import thread_count


@dataclass(frozen=True)
class Machine:
    """Facts that timings depend on.

    Attributes:
        cpu: Model name of the processor.
        cores: Cores this process may use.
        threads: Threads of the native kernels.
        gpu: Name of the GPU that rendered, or None.
        python: Version.
        torch: Version.
        system: Operating system and architecture.
    """

    cpu: str
    cores: int
    threads: int
    gpu: str | None
    python: str
    torch: str
    system: str


@dataclass(frozen=True)
class Build:
    """Build of gsynopsis: version, and the commit if it runs from a git checkout."""

    version: str
    commit: str | None


def this_machine(device: torch.device) -> Machine:
    """The machine this process runs on; `device` is where the renderer's tensors are."""
    return Machine(
        cpu=_cpu_model(),
        cores=usable_cores(),
        threads=thread_count(),
        gpu=torch.cuda.get_device_name(device) if device.type == "cuda" else None,
        python=platform.python_version(),
        torch=torch.__version__,
        system=f"{platform.system()} {platform.machine()}",
    )


def this_build() -> Build:
    """The version of this package, and its commit if it runs from its own checkout."""
    return Build(version=gsynopsis.__version__, commit=_commit(Path(__file__).parents[3]))


def usable_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _cpu_model() -> str:
    table = Path("/proc/cpuinfo")
    if table.is_file():
        for line in table.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _commit(root: Path) -> str | None:
    """The commit of the checkout at `root`; a repository that merely contains it is not ours."""
    try:
        answer = subprocess.run(
            ["git", "-C", str(root), "rev-parse", "--show-toplevel", "HEAD"],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    top, _, commit = answer.stdout.strip().partition("\n")
    return commit if Path(top).resolve() == root.resolve() else None
