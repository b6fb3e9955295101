"""Photos brought to a device ahead of time: the same pixels, within a budget."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.errors import SceneError
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import PhotoCache, Scene
from gsynopsis.training.context import TrainContext
from gsynopsis.training.device_photos import DevicePhotos
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.regularize.jitter import shift_places
from gsynopsis.training.state import TrainState
from tests.devices import DEVICES
from tests.tiny import Painted, half_size, tiny_config, tiny_scene


class Watched(Painted):
    """Notes which photos were asked for, and by which thread."""

    def __init__(self, size: tuple[int, int]) -> None:
        super().__init__(size)
        self.asked: list[tuple[str, float, Shift]] = []
        self.threads: set[str] = set()

    def get(
        self, path: Path, factor: float, shift: Shift = STILL, form: object = None
    ) -> np.ndarray:
        self.asked.append((path.stem, factor, shift))
        self.threads.add(threading.current_thread().name)
        if path.stem == "005":
            raise SceneError(path, "pixels", found="half of it", expected="a whole image")
        return super().get(path, factor, shift)


def watched() -> tuple[Scene, Watched]:
    cache = Watched((24, 16))
    return replace(tiny_scene(), cache=cache), cache


@pytest.mark.parametrize("device", DEVICES)
def test_pixels_are_those_of_the_scene(device: str) -> None:
    scene = tiny_scene()
    photos = DevicePhotos(scene, torch.device(device))
    for view, factor, jitter in (
        (1, 1, STILL),
        (2, 2, (0.25, -0.25)),
        (1, 1, STILL),
        (3, 1.5, STILL),
    ):
        found = photos.get(view, factor, jitter)
        assert found.device.type == device and found.dtype == torch.uint8
        assert np.array_equal(found.cpu().numpy(), scene.image(view, factor, jitter))
    photos.close()
    assert photos.held == 0 and photos.get(1, 1).shape == (16, 24, 3)
    photos.close()


@pytest.mark.parametrize("device", DEVICES)
def test_an_expected_photo_is_loaded_once_and_by_another_thread(device: str) -> None:
    scene, cache = watched()
    photos = DevicePhotos(scene, torch.device(device))
    photos.expect(2, 2, shift_places(2))
    for _ in range(2):
        for jitter in shift_places(2):
            photos.get(2, 2, jitter)
    photos.close()
    assert sorted(cache.asked) == sorted(("002", 2, jitter) for jitter in shift_places(2))
    assert threading.current_thread().name not in cache.threads


def test_the_least_recently_used_go_first_and_one_always_stays() -> None:
    scene, cache = watched()
    cache.budget = 2 * 24 * 16 * 3
    photos = DevicePhotos(scene, torch.device("cpu"))
    for view in (1, 2, 1, 3, 1, 2):  # 3 takes the place of 2
        photos.get(view, 1)
        assert photos.held <= cache.budget
    assert [name for name, *_ in cache.asked] == ["001", "002", "003", "002"]
    photos.budget = 1
    assert photos.get(4, 1).shape == (16, 24, 3) and photos.held == 24 * 16 * 3
    photos.close()


def test_a_damaged_photo_is_told_to_whoever_asks_for_it() -> None:
    scene, _ = watched()
    photos = DevicePhotos(scene, torch.device("cpu"))
    photos.expect(5, 1, [STILL])
    photos.get(4, 1)
    with pytest.raises(SceneError, match="half of it"):
        photos.get(5, 1)
    photos.close()


@pytest.mark.parametrize("reduced", [False, True])
def test_a_training_on_photos_brought_ahead_is_the_same_bits(reduced: bool, tmp_path: Path) -> None:
    config = half_size(tiny_config()) if reduced else tiny_config()

    def trained(name: str, ahead: bool) -> TrainState:
        out = tmp_path / name
        out.mkdir()
        state = open_state(TrainContext(tiny_scene(), config, make_renderer("cpu")), out, Silent())
        if ahead:
            state.photos = DevicePhotos(state.context.scene, torch.device("cpu"))
        assert run_training(state, out, Silent(), lambda: False)
        return state

    plain, ahead = trained("plain", False), trained("ahead", True)
    assert ahead.photos is not None and ahead.photos.held == 0  # closed at the end
    assert plain.progress.loss == ahead.progress.loss
    for name, value in plain.model.state_dict().items():
        assert torch.equal(ahead.model.state_dict()[name], value), name


def test_a_cache_serves_several_threads(tmp_path: Path) -> None:
    from PIL import Image

    for number in range(4):
        Image.new("RGB", (32, 24), (number, 0, 0)).save(tmp_path / f"{number}.png")
    cache, wrong = PhotoCache(2 * 32 * 24 * 3), []

    def ask(start: int) -> None:
        for k in range(40):
            number = (start + k) % 4
            if cache.get(tmp_path / f"{number}.png", 1)[0, 0, 0] != number:
                wrong.append(number)

    threads = [threading.Thread(target=ask, args=(start,)) for start in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong and cache.held <= cache.budget
