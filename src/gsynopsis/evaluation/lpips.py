"""LPIPS (Zhang and others, CVPR 2018) from a file of weights that the user supplies.

No package ships the weights, and nothing here downloads. With the package `lpips`,
`torch.save(lpips.LPIPS(net="vgg").state_dict(), "vgg.pt")` writes them; `net="alex"` as well. They
are read as tensors alone, so that a file cannot run code.
"""

import pickle
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gsynopsis.errors import SettingError
from gsynopsis.evaluation.metrics import CPU, Image8, LearntMeasure

Layer = tuple[str, int, int, int]
"""Number of a convolution in the state dict, its edge in pixels, its stride and its padding."""
ALEX: tuple[tuple[Layer, ...], ...] = (
    (("0", 11, 4, 2),),
    (("3", 5, 1, 2),),
    (("6", 3, 1, 1),),
    (("8", 3, 1, 1),),
    (("10", 3, 1, 1),),
)
VGG: tuple[tuple[Layer, ...], ...] = tuple(
    tuple((number, 3, 1, 1) for number in numbers)
    for numbers in (
        ("0", "2"),
        ("5", "7"),
        ("10", "12", "14"),
        ("17", "19", "21"),
        ("24", "26", "28"),
    )
)
POOLED = {"alex": (1, 2), "vgg": (1, 2, 3, 4)}
"""Slices before which the maximum of neighbours is taken: 3 × 3 and 2 × 2, every second pixel."""
SMALLEST = 32
"""Width and height that every layer of both networks leaves something of, pixels."""
ADDED = 1e-10
"""To the length of a feature vector, as in the authors' code."""


def load_lpips(path: Path, device: torch.device = CPU) -> LearntMeasure:
    """The measure of a state dict of `lpips.LPIPS`, network `alex` or `vgg`.

    Args:
        path: Of the file.
        device: Where it is computed.

    Raises:
        SettingError: It cannot be read, or is of something else.
    """
    weights = _read(path)
    kind = "vgg" if "net.slice1.2.weight" in weights else "alex"
    _check(path, weights, kind)
    weights = {name: tensor.to(device) for name, tensor in weights.items()}
    return LearntMeasure(f"lpips {kind} [-1,1]", partial(distance, weights, kind))


def distance(weights: Mapping[str, Tensor], kind: str, image: Image8, truth: Image8) -> float:
    """LPIPS of two images uint8 [H, W, 3] of one size: 0 for identical ones, lower is better.

    Args:
        weights: The state dict, float32, on the device that computes.
        kind: `alex` or `vgg`.
        image: One.
        truth: The other. Images below `SMALLEST` pixels are repeated at their edge.
    """
    pair = torch.tensor(np.stack([image, truth])).to(weights["scaling_layer.shift"].device).float()
    pair = pair.permute(0, 3, 1, 2) / 127.5 - 1
    lacking = [max(0, SMALLEST - size) for size in (pair.shape[3], pair.shape[2])]
    pair = functional.pad(pair, (0, lacking[0], 0, lacking[1]), mode="replicate")
    total = torch.zeros((), dtype=torch.float64, device=pair.device)
    with torch.no_grad():
        features = (pair - weights["scaling_layer.shift"]) / weights["scaling_layer.scale"]
        for number, layers in enumerate(VGG if kind == "vgg" else ALEX):
            if number in POOLED[kind]:
                features = functional.max_pool2d(features, 2 if kind == "vgg" else 3, 2)
            for name, _, stride, padding in layers:
                stem = f"net.slice{number + 1}.{name}"
                convolved = functional.conv2d(
                    features, weights[f"{stem}.weight"], weights[f"{stem}.bias"], stride, padding
                )
                features = convolved.relu()
            unit = features / (features.square().sum(dim=1, keepdim=True).sqrt() + ADDED)
            difference = (unit[0] - unit[1]).square()
            linear = weights[f"lin{number}.model.1.weight"]
            total += (difference * linear[0]).sum(dim=0).mean()
    return float(total)


def _read(path: Path) -> dict[str, Tensor]:
    advice = 'write it by torch.save(lpips.LPIPS(net="vgg").state_dict(), "vgg.pt")'
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        found = error.strerror or "nothing that can be read"
        raise SettingError("--lpips", found=f"{path.name}: {found}", expected="a file") from error
    except (RuntimeError, ValueError, EOFError, pickle.UnpicklingError) as error:
        found = f"{path.name}: no file of tensors"
        raise SettingError(
            "--lpips", found=found, expected="a state dict", advice=advice
        ) from error
    named = cast("dict[object, object]", found) if isinstance(found, dict) else {}
    weights = {str(name): v.float() for name, v in named.items() if isinstance(v, Tensor)}
    if not weights or len(weights) < len(named):
        raise SettingError(
            "--lpips",
            found=f"{path.name}: no tensors by name",
            expected="a state dict",
            advice=advice,
        )
    return weights


def _check(path: Path, weights: Mapping[str, Tensor], kind: str) -> None:
    """All tensors are there, and each convolution takes what the one before gives."""
    channels = 3
    wanted: dict[str, tuple[int, ...]] = {
        f"scaling_layer.{name}": (1, 3, 1, 1) for name in ("shift", "scale")
    }
    for number, layers in enumerate(VGG if kind == "vgg" else ALEX):
        for name, edge, _, _ in layers:
            stem = f"net.slice{number + 1}.{name}"
            made = len(weights.get(f"{stem}.bias", ()))
            wanted |= {f"{stem}.weight": (made, channels, edge, edge), f"{stem}.bias": (made,)}
            channels = made
        wanted[f"lin{number}.model.1.weight"] = (1, channels, 1, 1)
    for name, shape in wanted.items():
        found = tuple(weights[name].shape) if name in weights else None
        if found != shape or 0 in shape:
            # The name alone: of a long path the message would keep too little of the rest.
            shown = f"{path.name}: {name} " + ("missing" if found is None else f"of shape {found}")
            expected = f"lpips.LPIPS(net={kind!r})'s"
            raise SettingError("--lpips", found=shown, expected=expected)
