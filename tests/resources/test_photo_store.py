"""Trainings whose photos come from files leave the same bytes as those that hold them in memory."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gsynopsis as gs
from gsynopsis.errors import SettingError
from gsynopsis.jobs.train import train
from gsynopsis.resources import photo_store as kept
from gsynopsis.resources.photo_store import PHOTOS
from gsynopsis.scene import photo_files as decoded
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import PhotoCache, Scene
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.observer import Silent

SHORT = {"scale": 2, "train.steps": 30, "levels.steps": 20, "levels.keep": (0.5,)}


class Listener(Silent):
    def __init__(self) -> None:
        self.lines = list[str]()

    def on_message(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kept") / "room"
    make_scene("room", path, views=6, width=64, height=48, points=200)
    masks = path / "masks"
    masks.mkdir()
    for photo in sorted((path / "images").iterdir())[1:3]:
        mask = np.full((48, 64), 255, np.uint8)
        mask[:, :20] = 0
        Image.fromarray(mask).save(masks / f"{photo.stem}.png")
    return path


def run(folder: Path, out: Path, budget: int, cache: Path | None = None) -> tuple[str, list[str]]:
    scene = replace(load_scene(folder), cache=PhotoCache(budget))
    heard = Listener()
    options = {"evaluate": False, "cache": cache}
    found = train(scene, gs.resolve("standard", scene, SHORT), out, heard, **options)
    return hashlib.sha256(found.file.read_bytes()).hexdigest(), heard.lines


@pytest.fixture(scope="module")
def expected(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Of a training that holds its photos in memory."""
    return run(folder, tmp_path_factory.mktemp("memory") / "run", 1 << 30)[0]


def test_the_file_is_the_same_bytes_and_the_photos_go_when_it_is_there(
    folder: Path, tmp_path: Path, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = set[str]()
    remove = decoded.PhotoStore.remove

    def watched(store: decoded.PhotoStore) -> None:
        store.close()
        seen.update(file.name for file in store.folder.iterdir())
        remove(store)

    monkeypatch.setattr(decoded.PhotoStore, "remove", watched)
    found, lines = run(folder, tmp_path / "run", 1000)
    assert found == expected and not [line for line in lines if "decoded" in line]
    # Five training photos at four places each, and their masks.
    assert len(seen) > 4 * 5
    assert not (tmp_path / "run" / PHOTOS).exists()


def test_a_folder_of_its_own_stays_and_is_used_again(
    folder: Path, tmp_path: Path, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "cache"
    assert run(folder, tmp_path / "first", 1 << 30, cache)[0] == expected
    assert len(list(cache.iterdir())) > 4 * 5
    monkeypatch.setattr(decoded, "load_photo", None)
    assert run(folder, tmp_path / "second", 1 << 30, cache)[0] == expected


def test_a_full_disk_is_a_line_and_the_same_file(
    folder: Path, tmp_path: Path, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decoded, "ROOM", 1 << 60)
    found, lines = run(folder, tmp_path / "run", 1000)
    told = [line for line in lines if "decoded" in line]
    assert found == expected and len(told) == 1
    assert "No space left on device" in told[0] and "\n" not in told[0]


def test_a_folder_that_cannot_be_made_is_a_line(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SettingError, match=r"--cache: found .*expected a folder"):
        run(folder, tmp_path / "run", 1000, tmp_path / "file")
    assert not (tmp_path / "run" / "scene.gsyn").exists()


def test_a_stopped_training_keeps_its_photos(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stop(Silent):
        def on_step(self, info: object) -> None:
            raise KeyboardInterrupt

    scene: Scene = replace(load_scene(folder), cache=PhotoCache(1000))
    recipe, options = gs.resolve("standard", scene, SHORT), {"evaluate": False}
    with pytest.raises(KeyboardInterrupt):
        train(scene, recipe, tmp_path / "run", Stop(), **options)
    assert any((tmp_path / "run" / PHOTOS).iterdir())
    assert scene.cache.store is None
    train(scene, recipe, tmp_path / "run", Silent(), **options)
    assert not (tmp_path / "run" / kept.PHOTOS).exists()
