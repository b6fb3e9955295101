import sys

import pytest
import torch

from gsynopsis.errors import MissingExtraError
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import fresh, make_renderer
from gsynopsis.render.cuda import CudaRenderer


@pytest.mark.parametrize("name", ["cpu", "reference"])
def test_a_renderer_has_the_name_it_was_asked_by(name) -> None:
    renderer: Renderer = make_renderer(name)
    assert renderer.name == name
    assert renderer.device == torch.device("cpu")


def test_a_fresh_renderer_of_the_cpu_shares_no_frame() -> None:
    cpu, reference = make_renderer("cpu"), make_renderer("reference")
    assert fresh(cpu) is not cpu and fresh(cpu).name == "cpu"
    assert fresh(reference) is reference


def test_auto_is_the_cpu_without_a_cuda_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert make_renderer("auto").name == "cpu"


def test_cuda_without_gsplat_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(MissingExtraError, match=r"gsplat is not installed.*gsynopsis\[cuda\]"):
        CudaRenderer()
