"""LPIPS from a state dict, against plain loops; weights here are random and small."""

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.errors import SettingError
from gsynopsis.evaluation.lpips import ADDED, ALEX, POOLED, VGG, load_lpips
from tests.devices import DEVICES

WIDTHS = {"alex": (3, 4, 3, 4, 2), "vgg": (2, 3, 4, 3, 2)}
SHIFT, SCALE = (-0.03, -0.088, -0.188), (0.458, 0.448, 0.45)
Array = NDArray[np.float64]


def made_up(kind: str) -> dict[str, Tensor]:
    """Tensors by the names that lpips.LPIPS(net=kind) gives them."""
    g = torch.Generator().manual_seed(0)
    weights = {
        "scaling_layer.shift": torch.tensor(SHIFT).view(1, 3, 1, 1),
        "scaling_layer.scale": torch.tensor(SCALE).view(1, 3, 1, 1),
    }
    before = 3
    for number, layers in enumerate(VGG if kind == "vgg" else ALEX):
        now = WIDTHS[kind][number]
        for name, edge, _, _ in layers:
            stem = f"net.slice{number + 1}.{name}"
            weights[f"{stem}.weight"] = torch.randn((now, before, edge, edge), generator=g) / edge
            weights[f"{stem}.bias"] = torch.randn(now, generator=g) / 4
            before = now
        weights[f"lin{number}.model.1.weight"] = torch.rand((1, now, 1, 1), generator=g)
        weights[f"lins.{number}.model.1.weight"] = weights[f"lin{number}.model.1.weight"]
    return weights


def convolved(x: Array, weight: Array, bias: Array, stride: int, padding: int) -> Array:
    x = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
    edge = weight.shape[2]
    rows, columns = ((size - edge) // stride + 1 for size in x.shape[1:])
    out = np.zeros((len(weight), rows, columns))
    for i in range(rows):
        for j in range(columns):
            window = x[:, i * stride : i * stride + edge, j * stride : j * stride + edge]
            out[:, i, j] = (weight * window).sum(axis=(1, 2, 3)) + bias
    return np.maximum(out, 0)


def pooled(x: Array, edge: int) -> Array:
    rows, columns = ((size - edge) // 2 + 1 for size in x.shape[1:])
    out = np.zeros((len(x), rows, columns))
    for i in range(rows):
        for j in range(columns):
            out[:, i, j] = x[:, 2 * i : 2 * i + edge, 2 * j : 2 * j + edge].max(axis=(1, 2))
    return out


def plain(weights: dict[str, Tensor], kind: str, image: Array, truth: Array) -> float:
    w = {name: value.double().numpy() for name, value in weights.items()}
    both = [
        (picture.transpose(2, 0, 1) / 127.5 - 1 - w["scaling_layer.shift"][0])
        / w["scaling_layer.scale"][0]
        for picture in (image, truth)
    ]
    total = 0.0
    for number, layers in enumerate(VGG if kind == "vgg" else ALEX):
        if number in POOLED[kind]:
            both = [pooled(x, 2 if kind == "vgg" else 3) for x in both]
        for name, _, stride, padding in layers:
            stem = f"net.slice{number + 1}.{name}"
            both = [
                convolved(x, w[f"{stem}.weight"], w[f"{stem}.bias"], stride, padding) for x in both
            ]
        a, b = (x / (np.sqrt((x**2).sum(axis=0)) + ADDED) for x in both)
        linear = w[f"lin{number}.model.1.weight"][0]
        total += float((linear * (a - b) ** 2).sum(axis=0).mean())
    return total


def pictures(height: int, width: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    rng = np.random.default_rng(0)
    a, b = (rng.integers(0, 256, (height, width, 3)).astype(np.uint8) for _ in range(2))
    return a, b


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("kind", ["alex", "vgg"])
def test_the_distance_is_that_of_plain_loops(kind: str, device: str, tmp_path: Path) -> None:
    weights = made_up(kind)
    torch.save(weights, tmp_path / "weights.pt")
    measure = load_lpips(tmp_path / "weights.pt", torch.device(device))
    image, truth = pictures(35, 40)
    expected = plain(weights, kind, image.astype(float), truth.astype(float))
    assert expected > 0.01
    assert measure.distance(image, truth) == pytest.approx(expected, rel=1e-4)
    assert measure.distance(image, image) == 0
    assert measure.name == f"lpips {kind} [-1,1]"


def test_an_image_smaller_than_the_network_sees_is_measured(tmp_path: Path) -> None:
    torch.save(made_up("alex"), tmp_path / "weights.pt")
    image, truth = pictures(9, 13)
    assert load_lpips(tmp_path / "weights.pt").distance(image, truth) > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lin2.model.1.weight": None}, "lin2.model.1.weight missing"),
        ({"net.slice3.6.weight": torch.zeros(3, 9, 3, 3)}, r"net.slice3.6.weight of shape \(3, 9"),
        ({"net.slice5.10.bias": torch.zeros(0)}, "net.slice5.10.weight of shape"),
    ],
)
def test_weights_of_something_else_are_refused_by_name(
    change: dict[str, Tensor | None], message: str, tmp_path: Path
) -> None:
    weights = {k: v for k, v in (made_up("alex") | change).items() if v is not None}
    torch.save(weights, tmp_path / "weights.pt")
    with pytest.raises(SettingError, match=message):
        load_lpips(tmp_path / "weights.pt")


def test_files_that_are_no_tensors_by_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="No such file"):
        load_lpips(tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("weights")
    with pytest.raises(SettingError, match="no file of tensors"):
        load_lpips(tmp_path / "text.pt")
    torch.save([1, 2], tmp_path / "list.pt")
    with pytest.raises(SettingError, match="no tensors by name"):
        load_lpips(tmp_path / "list.pt")
    torch.save({"a": Path("b")}, tmp_path / "code.pt")
    with pytest.raises(SettingError, match="no file of tensors"):
        load_lpips(tmp_path / "code.pt")
