"""The native assembly of slots against its plain twin."""

import pytest
import torch
from torch import Tensor

from gsynopsis._native import _core
from gsynopsis.model.decode import assemble, assemble_reference
from gsynopsis.model.tables import SlotTables
from tests.model.twins import assert_close, variant_of

FIELDS = ("means", "quats", "scales", "opacities", "colors")
variant = variant_of("count_drawn", "assemble", "assemble_backward")


def inputs(anchors: int, visible: int, slots: int) -> dict[str, Tensor]:
    """Heads, tables and rows, float64, seeded."""
    g = torch.Generator().manual_seed(anchors + slots)

    def normal(*shape: int, size: float = 1.0) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64) * size

    return {
        "opacity": normal(visible, slots),
        "cov": normal(visible, 7 * slots, size=2.0),
        "color": normal(visible, 3 * slots, size=3.0),
        "positions": normal(anchors, 3, size=5.0),
        "log_scales": normal(anchors, 6) - 2,
        "offsets": normal(anchors, slots, 3),
        "log_gain": normal(3, size=0.2),
        "live": torch.rand(anchors, slots, generator=g) > 0.2,
        "rows": torch.randperm(anchors, generator=g)[:visible].sort().values,
    }


LEARNT = ("opacity", "cov", "color", "log_scales", "offsets", "log_gain")


def run(values: dict[str, Tensor], function: object, dtype: torch.dtype) -> dict[str, Tensor]:
    """All outputs, and the gradients of a fixed random sum of them."""
    v = {k: t.to(dtype) if t.is_floating_point() else t for k, t in values.items()}
    for name in LEARNT:
        v[name] = v[name].clone().requires_grad_(True)
    tables = SlotTables(v["positions"], v["log_scales"], v["offsets"], v["live"], v["log_gain"])
    assert callable(function)
    made = function((v["opacity"], v["cov"], v["color"]), v["rows"], tables)
    outputs = {name: getattr(made.gaussians, name) for name in FIELDS}
    g = torch.Generator().manual_seed(3)
    total = torch.zeros((), dtype=dtype)
    for t in outputs.values():
        total = total + (t * torch.randn(t.shape, generator=g, dtype=torch.float64).to(dtype)).sum()
    total.backward()
    grads = {f"grad {n}": v[n].grad for n in LEARNT}
    return outputs | {"slots": made.slots, "tanh": made.opacity} | grads


@pytest.mark.parametrize(("anchors", "visible", "slots"), [(700, 600, 10), (9, 8, 1), (5, 5, 32)])
def test_values_and_gradients_equal_the_twin(
    variant: str, anchors: int, visible: int, slots: int
) -> None:
    values = inputs(anchors, visible, slots)
    found = run(values, assemble, torch.float32)
    assert_close(found, run(values, assemble_reference, torch.float64))
    assert len(found["slots"]) > 0


def test_the_twin_passes_finite_differences() -> None:
    values = inputs(4, 3, 2)
    values["opacity"] = values["opacity"].abs() + 0.1

    def drawn(*tensors: Tensor) -> tuple[Tensor, ...]:
        opacity, cov, color, log_scales, offsets, log_gain = tensors
        tables = SlotTables(values["positions"], log_scales, offsets, values["live"], log_gain)
        g = assemble_reference((opacity, cov, color), values["rows"], tables).gaussians
        return g.means, g.quats, g.scales, g.opacities, g.colors

    leaves = tuple(values[n].requires_grad_(True) for n in LEARNT)
    assert torch.autograd.gradcheck(drawn, leaves)


def test_nothing_visible_and_nothing_drawn(variant: str) -> None:
    for values in (inputs(6, 0, 4), inputs(6, 5, 4)):
        values["opacity"] = -values["opacity"].abs()
        found = run(values, assemble, torch.float32)
        assert len(found["means"]) == 0
        assert not any(found[f"grad {n}"].any() for n in LEARNT)


def test_a_nan_opacity_is_not_drawn_and_stays_to_be_noticed(variant: str) -> None:
    values = inputs(20, 20, 4)
    values["opacity"][3, 1] = float("nan")
    values["live"][:] = True
    found = run(values, assemble, torch.float32)
    assert 3 * 4 + 1 not in found["slots"].tolist()
    assert found["tanh"][3, 1].isnan() and found["tanh"].isnan().sum() == 1


def test_a_zero_quaternion_and_huge_values_give_finite_gradients(variant: str) -> None:
    values = inputs(8, 8, 3)
    values["opacity"] = values["opacity"].abs() * 50
    values["cov"] = values["cov"] * 100
    values["cov"].view(8, 3, 7)[2, 1, 3:] = 0
    found = run(values, assemble, torch.float32)
    assert all(t.isfinite().all() for t in found.values())


def test_the_number_of_threads_changes_no_bit() -> None:
    values, before = inputs(1500, 1300, 10), torch.get_num_threads()
    try:
        runs = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            runs.append(run(values, assemble, torch.float32))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(runs[0][k], runs[1][k]) for k in runs[0])


def test_arrays_that_do_not_belong_together_are_refused() -> None:
    values = inputs(6, 5, 4)
    f32 = {k: t.float() if t.is_floating_point() else t for k, t in values.items()}
    names = ("opacity", "cov", "color", "positions", "log_scales", "offsets", "log_gain")
    slots = (f32["rows"].numpy(), f32["live"].view(torch.uint8).numpy(),
             *(f32[n].numpy() for n in names))  # fmt: skip
    activated, starts = torch.zeros(5, 4).numpy(), torch.zeros(6, dtype=torch.int64).numpy()
    count = _core.count_drawn(slots, activated, starts)
    made = tuple(torch.empty(count, n).numpy() for n in (3, 4, 3))
    made = (*made, torch.empty(count).numpy(), torch.empty(count, 3).numpy())
    flat = torch.empty(count, dtype=torch.int64).numpy()
    activated[:] = 0
    with pytest.raises(ValueError, match="starts: not those of count_drawn"):
        _core.assemble(slots, (activated, starts), made, flat)
    rows = f32["rows"].flip(0).contiguous().numpy()
    with pytest.raises(ValueError, match="rows: expected ascending"):
        _core.count_drawn((rows, *slots[1:]), activated, starts)


def test_gradients_add_to_those_that_tables_have_already() -> None:
    values = inputs(40, 30, 6)
    f32 = {k: t.float() if t.is_floating_point() else t for k, t in values.items()}
    leaves = {name: f32[name].requires_grad_(True) for name in LEARNT}
    seen = [f32["rows"], f32["rows"][::3], f32["rows"][:0]]
    sums = {name: torch.zeros_like(leaves[name]) for name in ("log_scales", "offsets")}
    for rows in seen:
        tables = SlotTables(f32["positions"], leaves["log_scales"], leaves["offsets"],
                            f32["live"], leaves["log_gain"])  # fmt: skip
        heads = tuple(leaves[n][: len(rows)] for n in ("opacity", "cov", "color"))
        held = [leaves[name].grad for name in sums]
        for name in sums:
            leaves[name].grad = None
        assemble(heads, rows, tables).gaussians.means.square().sum().backward(retain_graph=True)
        for name, total in sums.items():
            grad = leaves[name].grad
            assert grad is not None and not grad[~torch.isin(torch.arange(40), rows)].any()
            total += grad
        for name, grad in zip(sums, held, strict=True):
            leaves[name].grad = grad
        assemble(heads, rows, tables).gaussians.means.square().sum().backward()
    for name, total in sums.items():
        assert torch.equal(leaves[name].grad, total), name
        assert total.any()
