"""The native heads against their plain twin."""

from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from gsynopsis._native import _core
from gsynopsis.model.decode import compute_heads, heads_reference
from gsynopsis.model.encoding import grid_layout
from gsynopsis.model.heads import init_networks
from gsynopsis.model.tables import WEIGHTS, HeadInputs, ViewInput
from tests.model.twins import assert_close, variant_of

LEARNT = ("table", "logits", "codebook", "residual")
variant = variant_of(
    "choose", "heads_forward", "heads_backward", "hashgrid_forward", "hashgrid_backward"
)


@dataclass(frozen=True)
class Size:
    anchors: int = 900
    visible: int = 700
    slots: int = 10
    grids: int = 3
    codes: int = 64
    residual: int = 8
    hidden: int = 32
    frozen: bool = False


SIZES = {
    "ours": Size(codes=256, grids=12),
    "free": Size(grids=0, codes=0, residual=32),
    "no codebook": Size(codes=0),
    "no residual": Size(residual=0),
    "codebook only": Size(grids=0, residual=0, codes=7),
    "odd widths": Size(slots=3, hidden=21, residual=5, codes=37, anchors=60, visible=45),
    "frozen choice": Size(frozen=True),
    "one anchor, one slot": Size(anchors=1, visible=1, slots=1),
    "nothing in view": Size(anchors=5, visible=0),
}


def sources_of(size: Size) -> tuple[HeadInputs, dict[str, Tensor]]:
    """Sources and weights, float64, seeded."""
    g = torch.Generator().manual_seed(size.anchors + size.codes)
    layout = grid_layout((5, 9, 17, 18, 24, 33, 44, 59, 80, 108, 148, 201)[: size.grids], 9)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    width = 32 if size.codes else 0
    sources = HeadInputs(
        rows=torch.randperm(size.anchors, generator=g)[: size.visible].sort().values,
        positions=normal(size.anchors, 3) * 4,
        # Exact in float32, so that both twins read the same cells.
        coordinates=torch.rand(size.anchors, 3, generator=g).double(),
        layout=layout,
        table=normal(layout.rows, layout.features),
        logits=normal(size.anchors, 0 if size.frozen else size.codes),
        codes=torch.randint(max(1, size.codes), (size.anchors,), generator=g),
        codebook=normal(size.codes, width),
        residual=normal(size.anchors, size.residual),
    )
    inputs = size.grids * 4 + width + size.residual
    networks = init_networks(inputs, size.slots, size.hidden, None, g)
    return sources, {name: networks[name].double() for name in WEIGHTS}


VIEW = ViewInput((0.5, -1.0, 2.0), 3.0)


NARROW = replace(VIEW, low=1.0, high=1.5)


def run(
    function: object,
    sources: HeadInputs,
    networks: dict[str, Tensor],
    dtype: torch.dtype,
    view: ViewInput = VIEW,
) -> dict[str, Tensor]:
    """Outputs, and gradients of a fixed random sum of them that leaves some anchors out."""
    moved = {name: t.to(dtype) for name, t in vars(sources).items() if _is_real(t)}
    learnt = {name: moved[name].clone().requires_grad_(True) for name in LEARNT}
    learnt |= {name: w.to(dtype).clone().requires_grad_(True) for name, w in networks.items()}
    used = replace(sources, **(moved | {name: learnt[name] for name in LEARNT}))
    assert callable(function)
    outputs = function(used, view, {name: learnt[name] for name in networks})
    g = torch.Generator().manual_seed(3)
    total = torch.zeros((), dtype=dtype)
    out = torch.rand(len(sources.rows), generator=g) < 0.3
    for t in outputs:
        share = torch.randn(t.shape, generator=g, dtype=torch.float64)
        total = total + (t * share.masked_fill(out[:, None], 0).to(dtype)).sum()
    total.backward()
    found = dict(zip(("opacity", "cov", "color"), (t.detach() for t in outputs), strict=True))
    for name, parameter in learnt.items():
        grad = parameter.grad
        found[f"grad {name}"] = torch.zeros_like(parameter) if grad is None else grad
    return found


def _is_real(value: object) -> bool:
    return isinstance(value, Tensor) and value.is_floating_point()


@pytest.mark.parametrize("name", SIZES)
def test_values_and_gradients_equal_the_twin(variant: str, name: str) -> None:
    sources, networks = sources_of(SIZES[name])
    found = run(compute_heads, sources, networks, torch.float32)
    assert_close(found, run(heads_reference, sources, networks, torch.float64))


def test_no_distance_but_those_known_goes_in() -> None:
    sources, networks = sources_of(SIZES["ours"])
    distances = (sources.positions - torch.tensor(VIEW.position)).norm(dim=1) / VIEW.extent
    assert float(distances.min()) < NARROW.low < NARROW.high < float(distances.max())
    found = run(compute_heads, sources, networks, torch.float32, NARROW)
    assert_close(found, run(heads_reference, sources, networks, torch.float64, NARROW))
    free = run(compute_heads, sources, networks, torch.float32)
    assert not torch.allclose(found["opacity"], free["opacity"], atol=1e-3)


def test_outputs_and_gradients_are_the_same_bits_for_any_number_of_threads() -> None:
    sources, networks = sources_of(replace(SIZES["ours"], anchors=3000, visible=2500))
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            found.append(run(compute_heads, sources, networks, torch.float32))
    finally:
        torch.set_num_threads(before)
    for name, value in found[0].items():
        assert all(torch.equal(value, other[name]) for other in found[1:]), name


def test_what_is_not_learnt_gets_no_gradient_and_the_rest_keeps_its_own() -> None:
    sources, networks = sources_of(SIZES["ours"])
    whole = run(compute_heads, sources, networks, torch.float32)
    weights = {name: w.float() for name, w in networks.items()}
    moved = {n: t.float() for n, t in vars(sources).items() if _is_real(t)}
    table = moved["table"].clone().requires_grad_(True)
    outputs = compute_heads(replace(sources, **(moved | {"table": table})), VIEW, weights)
    assert torch.equal(outputs[0].detach(), whole["opacity"])
    sum(t.sum() for t in outputs).backward()  # type: ignore[union-attr]
    assert table.grad is not None and float(table.grad.abs().sum()) > 0
    assert moved["logits"].grad is None and weights["cov_w1"].grad is None


@pytest.mark.parametrize("name", ["ours", "odd widths", "free"])
def test_a_second_pass_adds_its_gradients(name: str) -> None:
    """As the levels of one step do: another view of other anchors with the same leaves."""
    sources, networks = sources_of(SIZES[name])
    other = replace(sources, rows=sources.rows[::3].contiguous())
    moved = {n: t.float() for n, t in vars(sources).items() if _is_real(t)}
    weights = {n: w.float() for n, w in networks.items()}

    def gradients(*passes: HeadInputs) -> dict[str, Tensor]:
        leaves = {n: moved[n].clone().requires_grad_(True) for n in LEARNT}
        for one in passes:
            outputs = compute_heads(replace(one, **(moved | leaves)), VIEW, weights)
            torch.stack([t.square().sum() for t in outputs]).sum().backward()
        zero = {n: torch.zeros_like(t) for n, t in leaves.items()}
        return {n: zero[n] if t.grad is None else t.grad for n, t in leaves.items()}

    first, second = gradients(sources), gradients(other)
    together = gradients(sources, other)
    assert_close(together, {n: first[n] + second[n] for n in LEARNT})
    assert float(second["residual" if name == "free" else "table"].abs().sum()) > 0


def test_arrays_that_do_not_fit_are_refused() -> None:
    rows = torch.tensor([0, 0]).numpy()
    with pytest.raises(ValueError, match="rows: expected ascending rows"):
        _core.choose(torch.zeros(3, 4).numpy(), rows, torch.zeros(2, dtype=torch.int64).numpy())
    with pytest.raises(ValueError, match="weights: expected twelve"):
        x = torch.zeros(2, 16).numpy()
        _core.heads_forward(([], x, 0, 0), (x, None, x, []))


def test_a_codebook_of_no_rows_reads_as_zeros_in_both() -> None:
    """A valid file may have columns for it all the same."""
    sources, networks = sources_of(SIZES["no codebook"])
    empty = replace(sources, codebook=sources.codebook.new_zeros(0, 3))
    after = SIZES["no codebook"].residual + 4  # columns behind it: residual and view

    def wider(weight: Tensor) -> Tensor:
        ones = weight.new_ones(len(weight), 3)
        return torch.cat([weight[:, :-after], ones, weight[:, -after:]], dim=1)

    more = {n: wider(w) if n.endswith("w1") else w for n, w in networks.items()}
    expected = run(heads_reference, sources, networks, torch.float64)
    for heads, dtype in ((compute_heads, torch.float32), (heads_reference, torch.float64)):
        found = run(heads, empty, more, dtype)
        for name in ("opacity", "cov", "color"):
            assert torch.allclose(found[name].double(), expected[name].double(), atol=1e-4)


@pytest.mark.parametrize("visible", [0, 1, 700])
def test_rows_are_scattered_into_whole_tables_or_added_to_them(visible: int) -> None:
    g = torch.Generator().manual_seed(visible)
    rows = torch.randperm(900, generator=g)[:visible].sort().values
    source = torch.randn(visible, 16, generator=g)
    expected = torch.zeros(900, 5)
    expected[rows] = source[:, 3:8]
    for threads in (1, 2, 3):
        found = torch.full((900, 5), torch.nan)
        _core.scatter_rows(rows.numpy(), source.numpy(), 3, found.numpy(), threads=threads)
        assert torch.equal(found, expected)
        _core.scatter_rows(rows.numpy(), source.numpy(), 3, found.numpy(), True, threads)
        assert torch.equal(found, 2 * expected)


def test_rows_beyond_a_table_are_refused() -> None:
    source, to = torch.zeros(2, 8).numpy(), torch.zeros(4, 5).numpy()
    for rows, first in (([0, 4], 0), ([1, 1], 0), ([0, 1], 4), ([0, 1], -1)):
        with pytest.raises(ValueError, match=r"rows: expected ascending|source: too narrow"):
            _core.scatter_rows(torch.tensor(rows).numpy(), source, first, to)
