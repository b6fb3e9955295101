"""Native kernels beside their plain twins: each variant of a kernel, how close it has to be."""

from functools import partial
from typing import Any

import pytest
from torch import Tensor

from gsynopsis._native import _core


def variant_of(*kernels: str) -> Any:
    """A fixture that runs a test with each variant of some kernels, by name."""

    @pytest.fixture(params=_core.variants())
    def variant(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
        for name in kernels:
            native = partial(getattr(_core, name), variant=request.param)
            monkeypatch.setattr(_core, name, native)
        return request.param

    return variant


def assert_close(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    for name, value in expected.items():
        assert found[name].shape == value.shape, name
        scale = value.abs().max().item() if value.numel() else 1.0
        error = (found[name].double() - value.double()).abs().max().item() if value.numel() else 0.0
        assert error <= 1e-5 * max(scale, 1e-3), f"{name}: {error} of {scale}"
