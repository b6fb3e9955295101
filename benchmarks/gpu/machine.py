"""Facts that a result on a GPU depends on, for the files that hold one."""

import importlib
from dataclasses import asdict
from typing import Any

import torch

from benchmarks.bench import machine, short_commit


def machine_record(device: torch.device, commit: str) -> dict[str, Any]:
    """Machine, versions and commit; `commit` is for a copy of the tree that has no history."""
    record: dict[str, Any] = asdict(machine(device))
    record["commit"] = commit or short_commit()
    if device.type == "cuda":
        properties = torch.cuda.get_device_properties(device)
        record |= {
            "gpu_bytes": properties.total_memory,
            "gpu_capability": f"{properties.major}.{properties.minor}",
            "cuda": torch.version.cuda,
            "gsplat": importlib.import_module("gsplat").__version__,
            "gsplat_binary": _gsplat_binary(),
        }
    return record


def _gsplat_binary() -> str:
    """File name of the compiled part: `csrc…` came ready built, `gsplat_cuda…` was built here."""
    backend = importlib.import_module("gsplat.cuda._backend")
    return str(getattr(backend._C, "__file__", backend._C)).rsplit("/", 1)[-1]
