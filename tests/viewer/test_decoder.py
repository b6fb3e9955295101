"""The viewer's decoder against Python: tables bit for bit, Gaussians to a thousandth."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from gsynopsis.model.build import model_from_levels
from gsynopsis.pack import decode, encode
from gsynopsis.records import LevelSet
from gsynopsis.scene.camera import Camera
from tests.level_sets import SHAPES, Shape, make_level_set
from tests.viewer.node import decode_with_viewer, needs_node

pytestmark = needs_node
EYES = ((0.5, -0.2, -1.0), (-3.0, 2.0, 0.4))
CASES = [(name, coding) for name in SHAPES for coding in ("raw", "compact")]
WIDE = Shape(
    anchors=(300, 700, 1500), slots=10, grids=(3, 4, 6), features=4, entries=32, code_width=8,
    residual=4, hidden=30, fuse=(17, 9),
)  # fmt: skip
Arrays = dict[str, NDArray[np.generic]]


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, LevelSet, Arrays, Arrays]]:
    """Each case: name, what Python reads from the file, what both kernels of the viewer read."""
    folder = tmp_path_factory.mktemp("vectors")
    named = [(f"{name} {coding}", SHAPES[name], coding) for name, coding in CASES]
    named.append(("wide", WIDE, "compact"))
    files, levels = [], []
    for number, (_, shape, coding) in enumerate(named):
        data = encode(make_level_set(np.random.default_rng(number), shape), coding)  # type: ignore[arg-type]
        files.append(folder / f"{number}.gsyn")
        files[-1].write_bytes(data)
        levels.append(decode(data, "vector"))
    plain = decode_with_viewer(files, EYES, folder, "plain")
    wasm = decode_with_viewer(files, EYES, folder, "wasm")
    names = [name for name, _, _ in named]
    return list(zip(names, levels, plain, wasm, strict=True))


def test_tables_are_equal_bit_for_bit(sets: list[tuple[str, LevelSet, Arrays, Arrays]]) -> None:
    for name, levels, found, _ in sets:
        shared = levels.shared
        expected: Arrays = {"lattice": shared.lattice, "logScales": shared.log_scales}
        expected |= {"residual": shared.residual}
        if len(shared.codes):
            expected["codes"] = shared.codes
        expected |= {f"grid {k}": grid for k, grid in enumerate(shared.grids)}
        for k, level in enumerate(levels.levels):
            expected |= {f"{net} {k}": w for net, w in level.networks.items()}
            if level.codebook.size:
                expected[f"codebook {k}"] = level.codebook
        for key, array in expected.items():
            assert found[key].tobytes() == np.ascontiguousarray(array).tobytes(), (name, key)


def test_slots_are_those_of_every_level(sets: list[tuple[str, LevelSet, Arrays, Arrays]]) -> None:
    for name, levels, found, _ in sets:
        slots = levels.shared.slots
        flat = found["owner"].astype(np.int64) * slots + found["slot"]
        for level in levels.levels:
            mask = np.zeros(level.anchors * slots, np.bool_)
            mask[flat[: level.live]] = True
            assert (mask.reshape(-1, slots) == level.mask).all(), name
        offsets = levels.shared.offsets.reshape(-1, 3)[flat]
        assert found["offsets"].tobytes() == offsets.tobytes(), name


def test_gaussians_are_those_of_the_model(
    sets: list[tuple[str, LevelSet, Arrays, Arrays]],
) -> None:
    compared = 0
    for name, levels, found, _ in sets:
        if not levels.levels[-1].anchors:
            continue
        model = model_from_levels(levels)
        slots = levels.shared.slots
        flat = found["owner"].astype(np.int64) * slots + found["slot"]
        for number in range(len(levels.levels)):
            for e, eye in enumerate(EYES):
                part = model.part(number)
                with torch.no_grad():
                    seen = everywhere(model, part, np.array(eye))
                values = found[f"values {number} {e}"].reshape(-1, 11)
                rows = found[f"rows {number} {e}"]
                places = {int(s): i for i, s in enumerate(seen.slots)}
                sure = seen.gaussians.opacities >= 1 / 255 + 1e-5
                opaque = set(seen.slots[sure].tolist())
                mine = flat[rows]
                assert opaque <= set(mine.tolist()), name
                order = [places[int(s)] for s in mine]
                g = seen.gaussians
                centers = found["centers"].reshape(-1, 3)[rows]
                for what, a, b in (
                    ("opacity", values[:, 0], g.opacities[order]),
                    ("scales", np.log(values[:, 1:4]), g.scales[order].log()),
                    ("quats", values[:, 4:8], g.quats[order]),
                    ("colors", values[:, 8:], g.colors[order]),
                    ("means", centers, g.means[order]),
                ):  # fmt: skip
                    assert np.allclose(a, b.numpy(), atol=1e-3), (name, number, what)
                compared += len(order)
    assert compared > 5000


def everywhere(model, part, eye):  # type: ignore[no-untyped-def]
    """All Gaussians of a part from one eye point, whatever direction they lie in."""
    camera = Camera(64, 64, 0.01, 0.01, 32.0, 32.0, np.eye(4))
    camera.w2c[:3, 3] = -eye
    rows = part.rows()
    model.visible = lambda _part, _camera: rows
    return model.decode_part(part, camera)


def test_simd_and_plain_arithmetic_agree_bit_for_bit(
    sets: list[tuple[str, LevelSet, Arrays, Arrays]],
) -> None:
    compared = 0
    for name, _, plain, wasm in sets:
        for key in plain:
            assert plain[key].tobytes() == wasm[key].tobytes(), (name, key)
            compared += key.startswith("values")
    assert compared > 100
