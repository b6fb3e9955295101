"""The small networks: fusion, opacity, covariance and colour, as named weights.

The names and shapes are those of `records.network_shapes`, so a model's networks go into a file
and back without renaming. Letters: V visible anchors, K slots, D input width.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from gsynopsis.records import HEAD_NAMES, network_shapes

Networks = Mapping[str, Tensor]


def init_networks(
    width: int,
    slots: int,
    hidden: int,
    fuse: tuple[int, int] | None,
    generator: torch.Generator,
    opacity: tuple[float, float] = (0.0, 1.0),
) -> dict[str, Tensor]:
    """Fresh weights, uniform ±1/√fan_in as in `torch.nn.Linear`, float32.

    `opacity` is a bias added to the opacity head's output and a factor on its last layer (ours:
    `OPACITY_BIAS`, `ModelConfig.opacity_init_scale`).
    """
    networks: dict[str, Tensor] = {}
    fan_in = 1
    for name, shape in network_shapes(width, slots, hidden, fuse).items():
        fan_in = shape[1] if len(shape) == 2 else fan_in
        bound = max(fan_in, 1) ** -0.5
        networks[name] = (torch.rand(shape, generator=generator) * 2 - 1) * bound
    bias, scale = opacity
    networks["opacity_w2"].mul_(scale)
    networks["opacity_b2"].mul_(scale).add_(bias)
    return networks


def fuse_features(networks: Networks, features: Tensor) -> Tensor:
    """The fusion MLP where there is one, else the features themselves; [V, D] → [V, D']."""
    if "fuse_w1" not in networks:
        return features
    inner = torch.addmm(networks["fuse_b1"], features, networks["fuse_w1"].T).relu()
    return torch.addmm(networks["fuse_b2"], inner, networks["fuse_w2"].T)


def head_outputs(
    networks: Networks, features: Tensor, view: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The three heads, before their activations.

    The first layers run as one product; the view part is added, so that the part of `features`
    can be computed once per level and kept.

    Args:
        networks: Named weights.
        features: [V, D], after fusion.
        view: [V, 4], unit direction and normalised distance.

    Returns:
        opacity [V, K], cov [V, 7K], color [V, 3K].
    """
    first = torch.cat([networks[f"{head}_w1"] for head in HEAD_NAMES])
    bias = torch.cat([networks[f"{head}_b1"] for head in HEAD_NAMES])
    inputs = torch.cat([features, view], dim=1)
    hidden = torch.addmm(bias, inputs, first.T).relu()
    width = networks["opacity_b1"].shape[0]
    opacity, cov, color = (
        torch.addmm(networks[f"{head}_b2"], part, networks[f"{head}_w2"].T)
        for head, part in zip(HEAD_NAMES, hidden.split(width, dim=1), strict=True)
    )
    return opacity, cov, color


def without_columns(networks: Networks, start: int, stop: int) -> dict[str, Tensor]:
    """The same networks for inputs whose columns start..stop are gone (or always zero)."""
    first = ("fuse_w1",) if "fuse_w1" in networks else tuple(f"{h}_w1" for h in HEAD_NAMES)
    result = {name: weight.detach().clone() for name, weight in networks.items()}
    for name in first:
        weight = result[name]
        result[name] = torch.cat([weight[:, :start], weight[:, stop:]], dim=1).contiguous()
    return result
