"""The native frustum test against its plain twin."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gsynopsis.model.decode import visible_rows_reference
from gsynopsis.model.native_view import native_rows
from gsynopsis.model.tables import SlotTables
from gsynopsis.scene.camera import Camera
from tests.model.twins import variant_of


def tables_of(anchors: int, slots: int) -> SlotTables:
    g = torch.Generator().manual_seed(anchors)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=g)

    live = torch.rand(anchors, slots, generator=g) > 0.6
    shape = (normal(anchors, 3) * 4, normal(anchors, 6) - 2, normal(anchors, slots, 3))
    return SlotTables(*shape, live, normal(3) * 0.3)


def camera() -> Camera:
    w2c = np.eye(4)
    w2c[:3, 3] = (0.3, -0.2, 2.0)
    return Camera(width=40, height=30, fx=35.0, fy=33.0, cx=19.0, cy=16.0, w2c=w2c)


def double(tables: SlotTables) -> SlotTables:
    real = {n: t.double() for n, t in vars(tables).items() if t.is_floating_point()}
    return replace(tables, **real)


variant = variant_of("visible_rows")


@pytest.mark.parametrize(("anchors", "slots"), [(3000, 10), (37, 1), (1, 3), (0, 10)])
def test_the_same_anchors_are_seen_as_by_the_twin(variant: str, anchors: int, slots: int) -> None:
    tables = tables_of(anchors, slots)
    found = native_rows(tables, camera())
    expected = visible_rows_reference(double(tables), camera())
    assert torch.equal(found, expected)
    if anchors > 1000:
        dead = int((~tables.live.any(dim=1)).sum())
        assert 0.1 * anchors < len(found) < 0.9 * anchors - dead


def test_an_anchor_without_a_live_slot_is_never_seen(variant: str) -> None:
    tables = tables_of(50, 4)
    near = replace(tables, positions=tables.positions * 0.01)
    assert len(native_rows(near, camera())) > 0
    assert len(native_rows(replace(near, live=torch.zeros_like(near.live)), camera())) == 0
