"""The native heads against their plain twin."""

from dataclasses import dataclass, replace
from functools import partial

import pytest
import torch
from torch import Tensor

from gsynopsis._native import _core
from gsynopsis.model.encoding import grid_layout
from gsynopsis.model.fused import WEIGHTS, Eye, Sources, heads_of, heads_reference
from gsynopsis.model.heads import init_networks

LEARNT = ("table", "logits", "codebook", "residual")
NATIVE = ("choose", "heads_forward", "heads_backward", "hashgrid_forward", "hashgrid_backward")


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


def sources_of(size: Size) -> tuple[Sources, dict[str, Tensor]]:
    """Sources and weights, float64, seeded."""
    g = torch.Generator().manual_seed(size.anchors + size.codes)
    layout = grid_layout((5, 9, 17, 18, 24, 33, 44, 59, 80, 108, 148, 201)[: size.grids], 9)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    width = 32 if size.codes else 0
    sources = Sources(
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


EYE = Eye((0.5, -1.0, 2.0), 3.0)


def run(
    function: object, sources: Sources, networks: dict[str, Tensor], dtype: torch.dtype
) -> dict[str, Tensor]:
    """Outputs, and gradients of a fixed random sum of them that leaves some anchors out."""
    moved = {name: t.to(dtype) for name, t in vars(sources).items() if _is_real(t)}
    learnt = {name: moved[name].clone().requires_grad_(True) for name in LEARNT}
    learnt |= {name: w.to(dtype).clone().requires_grad_(True) for name, w in networks.items()}
    used = replace(sources, **(moved | {name: learnt[name] for name in LEARNT}))
    assert callable(function)
    outputs = function(used, EYE, {name: learnt[name] for name in networks})
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


def assert_close(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    for name, value in expected.items():
        assert found[name].shape == value.shape, name
        scale = value.abs().max().item() if value.numel() else 1.0
        error = (found[name].double() - value.double()).abs().max().item() if value.numel() else 0.0
        assert error <= 1e-5 * max(scale, 1e-3), f"{name}: {error} of {scale}"


@pytest.fixture(params=_core.variants())
def variant(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    for name in NATIVE:
        monkeypatch.setattr(_core, name, partial(getattr(_core, name), variant=request.param))
    return request.param


@pytest.mark.parametrize("name", SIZES)
def test_values_and_gradients_equal_the_twin(variant: str, name: str) -> None:
    sources, networks = sources_of(SIZES[name])
    found = run(heads_of, sources, networks, torch.float32)
    assert_close(found, run(heads_reference, sources, networks, torch.float64))
