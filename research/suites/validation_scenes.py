"""Procedural scenes by name, to choose settings by: each made once into a folder that is kept."""

import json
from dataclasses import asdict
from pathlib import Path

from gsynopsis.errors import SettingError
from gsynopsis.synthetic.make_scene import MARK, SyntheticScene, make_scene

PROCEDURAL: dict[str, SyntheticScene] = {
    "indoor": SyntheticScene("room", 48, 240, 160, 1, 6000),
    "outdoor": SyntheticScene("outdoor", 48, 240, 160, 1, 6000),
    "object": SyntheticScene("object", 119, 228, 228, 1, 6000),
    "city": SyntheticScene("city", 400, 240, 160, 1, 40_000),
    "garden": SyntheticScene("outdoor", 96, 640, 480, 2, 20_000),
    "few": SyntheticScene("room", 16, 240, 160, 2, 3000),
    "tiny": SyntheticScene("room", 16, 96, 64, 3, 1500),
}
"""`garden` has the size of a small photo; `few` has as few views as people take who are in a hurry;
`tiny` is for tests and first tries."""


def procedural_scene(name: str, cache: Path) -> Path:
    """The folder of a procedural scene, in `cache`; made there if it is missing.

    Raises:
        SettingError: there is no such scene, or the cache holds something else of its name.
        SpaceError: the disk is full.
    """
    if name not in PROCEDURAL:
        raise SettingError("procedural", found=name, expected=" or ".join(PROCEDURAL))
    recipe, folder = PROCEDURAL[name], cache / name
    mark = folder / MARK
    if mark.is_file() and mark.read_text("utf-8") == mark_text(recipe):
        return folder
    return make_scene(out=folder, **asdict(recipe))


def mark_text(recipe: SyntheticScene) -> str:
    """Text of the file that `make_scene` writes beside the photos."""
    return json.dumps(asdict(recipe), indent=2) + "\n"
