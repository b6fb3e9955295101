"""Cameras of imports see what a person would look at, and figures are what a person sees."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.container import check_file
from gsynopsis.evaluation.base import Painter
from gsynopsis.evaluation.metrics import Image8, psnr
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.model.plain import PlainModel
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.pipeline.importing import import_splats
from gsynopsis.pipeline.orbit import first_camera
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from tests.pipeline.splat_scenes import SCENES, UP, SplatScene


def imported(scene: SplatScene, out: Path, monkeypatch: pytest.MonkeyPatch):
    """The scene as a file, and what the import said."""
    given = SplatFile((scene.gaussians,), up=UP)
    monkeypatch.setattr("gsynopsis.pipeline.importing.read_splats", lambda source: given)
    return import_splats("scene.ply", out, 2)


def painted(model: PlainModel | SplatModel, level: int, cameras: list[Camera]) -> list[Image8]:
    painter = Painter(model, CpuRenderer(), torch.zeros(3))
    with torch.no_grad():
        return [painter.paint(camera, level) for camera in cameras]


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_an_import_says_what_a_person_sees(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = SCENES[name]()
    made = imported(scene, tmp_path / "a.gsyn", monkeypatch)
    levels = check_file(tmp_path / "a.gsyn")
    first = first_camera(levels.meta)
    assert first is not None
    model = decoder_of(levels)
    assert isinstance(model, SplatModel)
    truth = PlainModel(scene.gaussians, antialiased=False)
    for level, said in enumerate(made.psnr):
        person, visitor = (
            np.mean([
                psnr(a, b)
                for a, b in zip(
                    painted(model, level, cameras), painted(truth, 0, cameras), strict=True
                )
            ])
            for cameras in (scene.cameras(), [first])
        )
        print(name, level, round(said, 2), round(float(person), 2), round(float(visitor), 2))
