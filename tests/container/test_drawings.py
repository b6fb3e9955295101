"""Two renderers that share nothing agree on the committed vectors, and a wrong one does not."""

import json
import re
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.robust.forge import index_of
from gsynopsis.container import decode
from gsynopsis.render.base import Gaussians
from gsynopsis.render.cpu import CpuRenderer
from tests.container import plain_drawer
from tests.container.drawings import BACKGROUND, FIELDS, camera_of, drawing
from tests.container.plain_reader import read_plain
from tests.container.vectors import FOLDER, VECTORS

CAMERAS = json.loads((FOLDER / "cameras.json").read_text())
TOLERANCE = 1e-4
SOURCE = Path(plain_drawer.__file__).read_text()
MUTANTS = {
    "near plane": ("NEAR, FILTER, FRUSTUM = 0.01", "NEAR, FILTER, FRUSTUM = -9.0"),
    "low-pass filter": ("0.3, 1.3\n", "0.31, 1.3\n"),
    "frustum bound": ("0.3, 1.3\n", "0.3, 1.5\n"),
    "least alpha": ("= 1 / 255, 0.99", "= 1 / 512, 0.99"),
    "largest alpha": ("= 1 / 255, 0.99", "= 1 / 255, 0.995"),
    "least transmittance": ("0.99, 1e-4", "0.99, 1e-3"),
    "no ReLU": ("np.maximum(v @ w1.T + b1, 0)", "(v @ w1.T + b1)"),
    "eye beyond the ball": ("if away > radius:", "if False:"),
    "distances not clamped": ('["extent"], low, high)', '["extent"], 0, math.inf)'),
    "no largest distance": ('["extent"], low, high)', '["extent"], low, math.inf)'),
    "no least distance": ('["extent"], low, high)', '["extent"], 0, high)'),
    "seen of two dimensions": ("len(numbers) != count", "False"),
    "too few focals": ('len(pairs) < len(scene["quality"])', "len(pairs) < 1"),
    "focals of another level": ("pairs[level]", "pairs[-1]"),
    "focals where there are none": ("(here, here)", "(20, 30)"),
    "smaller images not blurred": ("FILTER * max(r * r, 1)", "FILTER * r * r"),
    "larger images not blurred": ("return FILTER * r * r,", "return FILTER,"),
    "opacity not compensated": ("math.sqrt(max(0.0, np.linalg", "1.0 + 0 * (max(0.0, np.linalg"),
    "all of space in the box": ('if not head["contract"]', "if True"),
    "another contraction": ("(2 - 1 / length)", "(2 - 1 / length**2)"),
    "frame not centred": ('float(np.float32(head["radius"]))', "1.0"),
    "grids all hashed": ("if resolution**3 <= rows:", "if False:"),
    "grids all dense": ("if resolution**3 <= rows:", "if True:"),
    "dense rows": ("resolution**2 * z", "resolution**2 * (z - 1)"),
    "first prime": ("2654435761", "2654435763"),
    "second prime": ("805459861", "805459863"),
    "64-bit products": ("TO_32_BITS = 0xFFFFFFFF", "TO_32_BITS = (1 << 64) - 1"),
    "codebook after residual": ("(parts, axis=1)", "(parts[:-2] + parts[:-3:-1], axis=1)"),
    "grids fine to coarse": ('range(level["grids"]):', 'range(level["grids"])[::-1]:'),
    "view before features": ("x, eye)], axis=1)", "x, eye)][::-1], axis=1)"),
    "distance before direction": ("[(x - eye) / d, np", "[(eye - x) / d, np"),
    "slots of another level": ("live & (opacity > 0)", "opacity > 0"),
    "negative opacities": ("live & (opacity > 0)", "live"),
    "opacity by sigmoid": ("np.tanh(opacity[:, :, 0])", "2 * sigmoid(opacity[:, :, 0]) - 1"),
    "scales of offsets": ("base[anchor, 3:]", "base[anchor, :3]"),
    "no gain": (' * level["gain"],', ","),
    "quaternions x first": ("w, x, y, z = q", "x, y, z, w = q"),
    "rotation transposed": ("+ 2 * w * cross", "- 2 * w * cross"),
    "pixel corners": ("np.arange(width) + 0.5", "np.arange(width)"),
    "principal point in the middle": ('+ camera["cx"]', "+ width / 2"),
    "order by distance": ("np.argsort(m[:, 2], ", "np.argsort(np.linalg.norm(m, axis=1), "),
    "back to front": ("np.argsort(m[:, 2], ", "np.argsort(-m[:, 2], "),
    "rotation by a half of the angle": ("[1 - square, 2 * turn]", "[1 + 0 * square, turn]"),
    "splats without gain": (".reshape(-1, 3)) * level", ".reshape(-1, 3)) * 0 + level"),
    "Y, Cg, Co": ("y, orange, green", "y, green, orange"),
    "one stage": ("enumerate(scene[\"codes\"][n])", "enumerate(scene[\"codes\"][n][:1])"),
    "codebook of the last level": ("row = level", "row = scene[\"levels\"][-1]"),
    "colours not clamped": ("np.maximum(0, 0.5 +", "(0.5 +"),
    "degree 3 upside down": ("i * z * (2", "-i * z * (2"),
    "direction to the eye": ("d = (x - eye) / np", "d = (eye - x) / np"),
    "black background": ('np.array(camera["background"])', "0"),
}  # fmt: skip
"""One rule of the page broken each: what stands in the plain renderer, and what instead."""


@cache
def plain_of(name: str) -> dict[str, Any]:
    return read_plain((FOLDER / f"{name}.gsyn").read_bytes())


@cache
def expected_of(name: str) -> dict[str, np.ndarray]:
    with np.load(FOLDER / f"{name}.npz") as arrays:
        return dict(arrays)


def assert_gaussians(found: dict[str, Any], expected: dict[str, np.ndarray], level: int) -> None:
    assert found["slots"].tolist() == expected[f"slots_{level}"].tolist()
    for field in FIELDS:
        wanted = expected[f"{field}_{level}"]
        assert found[field].shape == wanted.shape
        assert np.allclose(found[field], wanted, rtol=0, atol=TOLERANCE), field
    # Many are smaller than the tolerance.
    scales = expected[f"scales_{level}"]
    assert np.allclose(found["scales"], scales, rtol=TOLERANCE, atol=0)


def assert_plain_draws(drawer: Any, scene: dict[str, Any], name: str, level: int) -> None:
    """A renderer made from the page gives a vector's Gaussians, and its image if there is one."""
    camera, expected = CAMERAS[name], expected_of(name)
    found = drawer.gaussians(scene, level, drawer.eye_of(camera))
    assert_gaussians(found, expected, level)
    wanted = expected.get(f"image_{level}")
    if wanted is not None:
        image = drawer.image(found, camera, drawer.focals_of(scene, level))
        assert np.allclose(image, wanted, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("name", VECTORS)
def test_the_plain_renderer_gives_every_level_of_the_whole_file(name: str) -> None:
    scene = plain_of(name)
    for level in range(len(scene["levels"])):
        assert_plain_draws(plain_drawer, scene, name, level)


@pytest.mark.parametrize("name", VECTORS)
def test_the_plain_renderer_gives_the_last_level_of_every_prefix(name: str) -> None:
    data = (FOLDER / f"{name}.gsyn").read_bytes()
    for level, entry in enumerate(index_of(data).levels):
        assert_plain_draws(plain_drawer, read_plain(data[: entry.end]), name, level)


@pytest.mark.parametrize("name", VECTORS)
def test_the_model_and_the_reference_still_make_the_vectors(name: str) -> None:
    found = drawing(decode((FOLDER / f"{name}.gsyn").read_bytes(), name), camera_of(name))
    expected = expected_of(name)
    assert list(found) == list(expected)
    for key, wanted in expected.items():
        if key.startswith("slots"):
            assert found[key].tolist() == wanted.tolist()
        else:
            assert (found[key].dtype, found[key].shape) == (np.float32, wanted.shape), key
            assert np.allclose(found[key], wanted, rtol=0, atol=TOLERANCE), key


@pytest.mark.parametrize("name", VECTORS)
def test_the_fast_renderer_gives_the_images(name: str) -> None:
    expected, scene = expected_of(name), plain_of(name)
    for level in (0, len(scene["levels"]) - 1):
        tensors = [torch.from_numpy(expected[f"{field}_{level}"]) for field in FIELDS]
        focals = plain_drawer.focals_of(scene, level)
        gaussians = Gaussians(*tensors, focals=focals)
        image = CpuRenderer().render(gaussians, camera_of(name), torch.tensor(BACKGROUND)).image
        assert np.allclose(image.numpy(), expected[f"image_{level}"], rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("name", VECTORS)
def test_cameras_are_those_that_the_script_makes(name: str) -> None:
    camera, made = CAMERAS[name], camera_of(name)
    for key in ("width", "height", "fx", "fy", "cx", "cy"):
        assert camera[key] == getattr(made, key)
    assert np.allclose(camera["w2c"], made.w2c[:3].ravel(), rtol=0, atol=1e-15)
    assert camera["background"] == list(BACKGROUND)


@pytest.mark.parametrize("name", VECTORS)
def test_rounding_decides_nothing_in_the_vectors(name: str) -> None:
    """No alpha, transmittance or opacity is so near to a limit that arithmetic decides."""
    rng, scene, camera = np.random.default_rng(0), plain_of(name), CAMERAS[name]
    for level in (0, len(scene["levels"]) - 1):
        expected = expected_of(name)
        found = {field: expected[f"{field}_{level}"].astype(float) for field in FIELDS}
        for field in FIELDS:
            found[field] *= 1 + 1e-6 * rng.standard_normal(found[field].shape)
        image = plain_drawer.image(found, camera, plain_drawer.focals_of(scene, level))
        assert np.allclose(image, expected[f"image_{level}"], rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("rule", MUTANTS)
def test_a_renderer_that_breaks_a_rule_is_seen(rule: str) -> None:
    old, new = MUTANTS[rule]
    assert SOURCE.count(old) >= 1
    mutant = ModuleType(rule)
    exec(compile(SOURCE.replace(old, new), rule, "exec"), mutant.__dict__)
    assert any(is_refused(mutant, name) for name in reversed(VECTORS))


def is_refused(drawer: ModuleType, name: str) -> bool:
    scene = plain_of(name)
    try:
        for level in range(len(scene["levels"])):
            assert_plain_draws(drawer, scene, name, level)
    except (AssertionError, LookupError, ValueError):
        return True
    return False


def test_the_plain_renderer_shares_nothing() -> None:
    code = SOURCE.split('"""')[2]
    assert "gsynopsis" not in code
    assert "torch" not in code
    lines = [line for line in SOURCE.splitlines() if line.startswith(("import", "from"))]
    assert lines == ["import json", "import math", "from typing import Any", "import numpy as np"]
    assert len(SOURCE.splitlines()) < 350


def test_the_page_names_every_vector_and_every_constant() -> None:
    page = (Path(__file__).parents[2] / "docs" / "format.md").read_text()
    vectors = page.split("## 7. Test vectors")[1].split("## 8.")[0]
    named = set(re.findall(r"`([a-z]+-[a-z]+)`", vectors))
    assert named == set(VECTORS)
    for constant in ("2654435761", "805459861", "| 0.01 |", "| 0.3 |", "| 1.3 |", "| 1/255 |"):
        assert constant in page
