"""The native step of Adam against torch's own, and what becomes of rows without a gradient."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import nn

from gsynopsis._native import _core
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.optim.adam import EPSILON, MOMENTS, Optimizer, log_linear
from tests.model.twins import variant_of

SHAPES = {"table": (5000, 4), "bias": (3,), "one": (1,), "weights": (21, 17), "still": (4, 2)}
RATES = {name: (0.01 * (i + 1), 0.001) for i, name in enumerate(SHAPES)}


variant = variant_of("adam")


def parameters() -> dict[str, nn.Parameter]:
    g = torch.Generator().manual_seed(1)
    return {name: nn.Parameter(torch.randn(shape, generator=g)) for name, shape in SHAPES.items()}


def set_gradients(moved: dict[str, nn.Parameter], step: int) -> None:
    """Some rows have none, as anchors out of view; `still` has never one."""
    g = torch.Generator().manual_seed(step)
    for name, parameter in moved.items():
        if name != "still":
            grad = torch.randn(parameter.shape, generator=g)
            parameter.grad = grad * (torch.rand(len(grad), generator=g) > 0.5).view(
                -1, *[1] * (grad.ndim - 1)
            )


def test_ten_steps_equal_those_of_torch(variant: str) -> None:
    ours, theirs = parameters(), parameters()
    optimizer = Optimizer(ours, RATES)
    groups = [{"params": [p], "lr": RATES[n][0]} for n, p in theirs.items()]
    oracle = torch.optim.Adam(groups, eps=EPSILON)
    for step in range(10):
        set_gradients(ours, step)
        set_gradients(theirs, step)
        optimizer.step()
        oracle.step()
        oracle.zero_grad()
    assert all(p.grad is None for p in ours.values())
    for name, parameter in theirs.items():
        start = parameters()[name]
        assert torch.equal(start, ours[name]) == (name == "still")
        assert torch.allclose(ours[name], parameter, rtol=0, atol=2e-6), name
        for moment in MOMENTS if name != "still" else ():
            expected = oracle.state[parameter][moment]
            found = optimizer.tensors()[f"{name}.{moment}"]
            assert torch.allclose(found, expected, rtol=1e-5, atol=1e-7), f"{name} {moment}"
    assert "still.step" not in optimizer.tensors()


def test_what_is_no_float32_of_the_cpu_is_moved_by_torch_and_goes_on_after_a_pause() -> None:
    ours, theirs = (
        {name: nn.Parameter(p.detach().double()) for name, p in parameters().items()}
        for _ in range(2)
    )
    optimizer = Optimizer(ours, RATES)
    groups = [{"params": [p], "lr": RATES[n][0]} for n, p in theirs.items()]
    oracle = torch.optim.Adam(groups, eps=EPSILON, fused=True)
    for step in range(6):
        if step == 3:  # as a resumed training does
            stored = optimizer.tensors()
            optimizer = Optimizer(ours, RATES)
            optimizer.load(stored)
        single = parameters()
        set_gradients(single, step)
        for name, parameter in single.items():
            grad = parameter.grad
            ours[name].grad = None if grad is None else grad.double()
            theirs[name].grad = None if grad is None else grad.double()
        optimizer.step()
        oracle.step()
        oracle.zero_grad()
    for name, parameter in theirs.items():
        assert torch.equal(ours[name], parameter), name
    assert optimizer.tensors()["table.step"] == 6


def test_a_row_without_a_gradient_goes_on_by_its_momentum() -> None:
    moved = {"table": nn.Parameter(torch.zeros(3, 4))}
    optimizer = Optimizer(moved, {"table": (0.1, 0.1)})
    moved["table"].grad = torch.tensor([[1.0], [1.0], [0.0]]).expand(3, 4).contiguous()
    optimizer.step()
    before = moved["table"].detach().clone()
    moved["table"].grad = torch.tensor([[1.0], [0.0], [0.0]]).expand(3, 4).contiguous()
    optimizer.step()
    change = (moved["table"].detach() - before)[:, 0]
    assert change[0] < change[1] < 0 and change[2] == 0


@pytest.mark.parametrize("threads", [2, 3])
def test_the_step_is_the_same_bits_for_any_number_of_threads(threads: int) -> None:
    results = []
    for count in (1, threads):
        torch.manual_seed(0)
        values, grad = torch.randn(50_001), torch.randn(50_001)
        moments = torch.randn(50_001), torch.rand(50_001)
        arrays = tuple(t.numpy() for t in (values, grad, *moments))
        _core.adam([(*arrays, 0.01, 3.0)], EPSILON, count)
        results.append(torch.stack([values, *moments]))
    assert torch.equal(*results)


def test_a_step_that_cannot_be_is_refused() -> None:
    flat = [torch.zeros(4).numpy() for _ in range(4)]
    with pytest.raises(ValueError, match="step: expected at least 1"):
        _core.adam([(flat[0], flat[1], flat[2], flat[3], 0.1, 0.0)], EPSILON)
    with pytest.raises(ValueError, match=r"mean: found shape \[3\]"):
        _core.adam([(flat[0], flat[1], flat[2][:3], flat[3], 0.1, 1.0)], EPSILON)


def test_means_outlive_a_change_of_rows_and_a_checkpoint() -> None:
    moved = {"table": nn.Parameter(torch.zeros(3, 2))}
    optimizer = Optimizer(moved, {"table": (0.1, 0.1)})
    seen = list[torch.Tensor]()
    for count in (1, 2):
        moved["table"].grad = torch.ones(3, 2)
        optimizer.step()
        optimizer.average(1 / count)
        seen.append(moved["table"].detach().clone())
    keep, new = torch.tensor([True, False, True]), torch.full((1, 2), 5.0)
    rows = nn.Parameter(torch.cat([moved["table"].detach()[keep], new]))
    optimizer.replace("table", rows, keep, 1)
    resumed = Optimizer({"table": rows}, {"table": (0.1, 0.1)})
    resumed.load(optimizer.tensors())
    expected = torch.cat([torch.stack(seen).mean(dim=0)[keep], new])
    assert not torch.equal(expected, rows.detach())
    resumed.take_average()
    assert torch.allclose(rows.detach(), expected)
    assert not any("average" in name for name in resumed.tensors())


def test_a_training_does_not_load_the_compiler_of_torch(tmp_path: Path) -> None:
    scene = make_scene("room", tmp_path / "room", views=6, width=64, height=48, points=60)
    words = ["train", str(scene), "--out", str(tmp_path / "run"), "--steps", "4", "--no-evaluate"]
    script = (
        f"import sys; from gsynopsis import cli; code = cli.main({[*words, '--quiet']!r}); "
        "sys.exit(code or ', '.join({'torch._dynamo', 'sympy'} & set(sys.modules)) or None)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_log_linear_meets_its_ends_and_the_geometric_middle() -> None:
    assert log_linear(1e-2, 1e-4, 0) == 1e-2
    assert math.isclose(log_linear(1e-2, 1e-4, 1), 1e-4)
    assert math.isclose(log_linear(1e-2, 1e-4, 0.5), 1e-3)
    assert math.isclose(log_linear(1e-2, 1e-4, 7), 1e-4)
    assert log_linear(0, 0, 0.5) == 0
