"""Memory that is used again: nobody sees the values of another, nothing depends on them."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

import pytest
import torch

from gsynopsis._native import runtime
from gsynopsis._native.runtime import empty_buffer, empty_buffer_like, reused
from gsynopsis.container import encode
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.model.build import model_to_levels
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from tests.tiny import tiny_config, tiny_scene

LARGE = runtime.SMALLEST // 4
"""Numbers of the smallest tensor that is kept."""


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    yield
    assert not runtime._free and not runtime._reusing


def test_a_block_is_used_again_when_its_last_tensor_is_gone() -> None:
    with reused():
        first = empty_buffer(4, LARGE)
        place, part = first.data_ptr(), first[1:, :9]
        del first
        part.fill_(3)
        other = empty_buffer(4, LARGE)
        assert other.data_ptr() != place, "a view of the first is left"
        other.fill_(5)
        assert bool((part == 3).all())
        del part
        again = empty_buffer_like(other)
        assert again.data_ptr() == place and again.shape == (4, LARGE)
        assert again.is_contiguous() and again.data_ptr() % 64 == 0
        array = again.numpy()
        del again
        assert empty_buffer(4, LARGE).data_ptr() != place, "an array of it is left"
        array[:] = 1


def test_a_block_serves_what_is_somewhat_smaller_and_goes_when_its_kind_has_grown() -> None:
    with reused():
        place = empty_buffer(4 * LARGE).data_ptr()
        assert empty_buffer(3 * LARGE).data_ptr() == place
        assert empty_buffer(LARGE).data_ptr() != place
        assert len(runtime._free) == 2
        empty_buffer(5 * LARGE)
        assert sorted(map(len, runtime._free)) == [LARGE + LARGE // 8, 5 * LARGE + 5 * LARGE // 8]


def test_only_large_tensors_are_kept_and_only_within() -> None:
    late = empty_buffer(LARGE)
    with reused():
        with reused():
            empty_buffer(LARGE - 1)
        assert not runtime._free
        empty_buffer(LARGE)
        assert len(runtime._free) == 1
        late = empty_buffer(LARGE)
    del late
    assert not runtime._free
    assert empty_buffer(0, 7).shape == (0, 7) and empty_buffer(3).dtype == torch.float32


def test_threads_do_not_get_the_same_block() -> None:
    def use(mark: int) -> bool:
        return all(
            bool((empty_buffer(LARGE + 1000 * (turn % 5)).fill_(mark) == mark).all())
            for turn in range(40)
        )

    with reused(), ThreadPoolExecutor(4) as threads:
        assert all(threads.map(use, range(4)))


def result_of(folder: Path) -> str:
    folder.mkdir()
    context = TrainContext(tiny_scene(), tiny_config(), CpuRenderer(), FilePacker())
    state = open_state(context, folder, Silent())
    assert run_training(state, folder, Silent(), lambda: False)
    return sha256(encode(model_to_levels(state.model, {}), "raw")).hexdigest()


def test_a_training_does_not_depend_on_what_was_in_its_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = result_of(tmp_path / "as it is")
    monkeypatch.setattr(runtime, "SMALLEST", 0)
    assert result_of(tmp_path / "used again") == expected
    monkeypatch.setattr(runtime, "empty_buffer", lambda *shape: torch.full(shape, float("nan")))
    assert result_of(tmp_path / "of NaN") == expected
