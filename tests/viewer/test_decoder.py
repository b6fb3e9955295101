"""The viewer's decoder against Python: tables bit for bit, Gaussians to a thousandth."""

import json
import shutil
from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmarks.viewer.browser import MISSING, pages, visit
from benchmarks.viewer.node import standalone
from gsynopsis.container import decode, encode
from gsynopsis.model.splats import decoder_of
from gsynopsis.model.view_bounds import ViewBounds, view_bounds_text
from gsynopsis.records import SEEN_NOTE as SEEN
from gsynopsis.records import LevelSet
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.page import FOLDER as BUILT
from tests.container.vectors import FOLDER, VECTORS
from tests.level_sets import SHAPES, Shape, make_level_set
from tests.viewer.node import HERE, TYPES, decode_with_viewer, needs_node

pytestmark = needs_node
EYES = ((0.5, -0.2, -1.0), (-3.0, 2.0, 0.4))
CASES = [(name, coding) for name in SHAPES for coding in ("raw", "compact")]
WIDE = Shape(
    anchors=(300, 700, 1500), slots=10, grids=(3, 4, 6), features=4, entries=32, code_width=8,
    residual=4, hidden=30, fuse=(17, 9),
)  # fmt: skip
SLOTS = Shape(anchors=(2, 4), grids=(1, 1), slots=256)
NOTES = {
    "cameras nearer than the eyes": {
        SEEN: view_bounds_text(ViewBounds((0.1, 0.2, -0.3), 0.4, 0.0, 1e6))
    },
    "few distances known": {SEEN: view_bounds_text(ViewBounds((0.0, 0.0, 0.0), 9.0, 0.53, 0.54))},
    "another note": {SEEN: '{"center":[0,0],"radius":9,"distance":[0.5,0.6]}'},
}
Arrays = dict[str, NDArray[Any]]


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, LevelSet, Arrays, Arrays]]:
    """Each case: name, what Python reads from the file, what both kernels of the viewer read."""
    folder = tmp_path_factory.mktemp("vectors")
    named = [(f"{name} {coding}", SHAPES[name], coding) for name, coding in CASES]
    named += [("wide", WIDE, "compact"), ("slots", SLOTS, "compact")]
    named += [(name, SHAPES["both"], "compact") for name in NOTES]
    files, levels = [], []
    for number, (name, shape, coding) in enumerate(named):
        made = make_level_set(np.random.default_rng(number), shape)
        made = replace(made, meta={**made.meta, **NOTES.get(name, {})})
        data = encode(made, coding)  # type: ignore[arg-type]
        files.append(folder / f"{number}.gsyn")
        files[-1].write_bytes(data)
        levels.append(decode(data, "vector"))
    plain = decode_with_viewer(files, EYES, folder, "plain")
    wasm = decode_with_viewer(files, EYES, folder, "wasm")
    names = [name for name, _, _ in named]
    return list(zip(names, levels, plain, wasm, strict=True))


def test_tables_are_equal_bit_for_bit(sets: list[tuple[str, LevelSet, Arrays, Arrays]]) -> None:
    for name, levels, found, _ in sets:
        assert_tables(name, levels, found)


def test_notes_on_the_cameras_change_what_is_decoded(
    sets: list[tuple[str, LevelSet, Arrays, Arrays]],
) -> None:
    """So that the comparison with the model says something of them."""
    for name, levels, found, _ in sets:
        if name in NOTES:
            with torch.no_grad():
                free = replace(levels, meta={})
                same = [matches(name, lv, found) for lv in (levels, free)]
            assert same == [True, name == "another note"], name


def matches(name: str, levels: LevelSet, found: Arrays) -> bool:
    try:
        return assert_gaussians(name, levels, found) > 0
    except AssertionError:
        return False


def test_gaussians_are_those_of_the_model(
    sets: list[tuple[str, LevelSet, Arrays, Arrays]],
) -> None:
    compared = sum(assert_gaussians(name, levels, found) for name, levels, found, _ in sets)
    assert compared > 5000


@pytest.mark.parametrize("kernel", ["plain", "wasm"])
def test_the_committed_vectors_are_decoded_under_node(kernel: str, tmp_path: Path) -> None:
    files = [FOLDER / f"{name}.gsyn" for name in VECTORS]
    assert_vectors(
        dict(zip(VECTORS, decode_with_viewer(files, EYES, tmp_path, kernel), strict=True))
    )


@pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser")
@pytest.mark.parametrize("kernel", ["plain", "wasm"])
def test_the_committed_vectors_are_decoded_in_the_browser(kernel: str, tmp_path: Path) -> None:
    for name in VECTORS:
        (tmp_path / f"{name}.gsyn").write_bytes((FOLDER / f"{name}.gsyn").read_bytes())
    site = shutil.copytree(BUILT, tmp_path / "site")
    shutil.copy(HERE / "arrays.js", site)
    shutil.copy(standalone(), site / "standalone.js")
    script = f"""(async () => {{
      const {{ arraysOf }} = await import("/arrays.js");
      const viewer = await import("/standalone.js");
      const found = {{}};
      for (const name of {json.dumps(list(VECTORS))}) {{
        const data = new Uint8Array(await (await fetch(`/${{name}}.gsyn`)).arrayBuffer());
        found[name] = {{}};
        const arrays = await arraysOf(viewer, data, {json.dumps(EYES)}, "{kernel}");
        for (const [key, array] of arrays) {{
          const view = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
          found[name][key] = [array.constructor.name, bytes(view)];
        }}
      }}
      return found;
    }})()"""
    steps = [{"wait": "complete"}, {"name": "arrays", "script": script}]
    with pages(tmp_path, site) as address:
        url = f"{address}/?noui&content=small-compact.gsyn"
        found = visit(url, tmp_path, steps).results["arrays"]
    assert_vectors(
        {
            name: {
                k: np.frombuffer(b64decode(text), TYPES[kind]) for k, (kind, text) in sent.items()
            }
            for name, sent in found.items()
        }
    )


def assert_vectors(found: dict[str, Arrays]) -> None:
    """Tables byte for byte, Gaussians to a thousandth, of every committed file."""
    compared = 0
    for name in VECTORS:
        levels = decode((FOLDER / f"{name}.gsyn").read_bytes(), name)
        assert_tables(name, levels, found[name])
        compared += assert_gaussians(name, levels, found[name])
    assert compared > 500


def assert_tables(name: str, levels: LevelSet, found: Arrays) -> None:
    """Every table of the file bit for bit, and the slots of every level."""
    shared = levels.shared
    expected: Arrays = {"lattice": shared.lattice, "logScales": shared.log_scales}
    expected |= {"residual": shared.residual}
    if shared.codes.size:
        expected["codes"] = shared.codes
    expected |= {f"grid {k}": grid for k, grid in enumerate(shared.grids)}
    for k, level in enumerate(levels.levels):
        expected |= {f"{net} {k}": w for net, w in levels.own_networks(k).items()}
        inherited = shared.degree is not None and levels.inherits(k)
        if level.codebook.size and not inherited:
            expected[f"codebook {k}"] = level.codebook
    for key, array in expected.items():
        assert found[key].tobytes() == np.ascontiguousarray(array).tobytes(), (name, key)
    flat = found["owner"].astype(np.int64) * shared.slots + found["slot"]
    for level in levels.levels:
        mask = np.zeros(level.anchors * shared.slots, np.bool_)
        mask[flat[: level.live]] = True
        assert (mask.reshape(-1, shared.slots) == level.mask).all(), name
    offsets = shared.offsets[flat // shared.slots, found["slot"]]
    assert found["offsets"].tobytes() == offsets.tobytes(), name


def assert_gaussians(name: str, levels: LevelSet, found: Arrays) -> int:
    """Every Gaussian that is drawn, as the model gives it; how many were compared."""
    compared = 0
    if not levels.levels[-1].anchors:
        return compared
    model = decoder_of(levels)
    slots = levels.shared.slots
    flat = found["owner"].astype(np.int64) * slots + found["slot"]
    for number in range(len(levels.levels)):
        for e, eye in enumerate(EYES):
            with torch.no_grad():
                seen = everywhere(model, model.part(number), np.array(eye))
            g = seen.gaussians
            values = found[f"values {number} {e}"].reshape(-1, 11)
            rows = found[f"rows {number} {e}"]
            places = {int(s): i for i, s in enumerate(seen.slots)}
            sure = g.opacities >= 1 / 255 + 1e-5
            mine = flat[rows]
            assert set(seen.slots[sure].tolist()) <= set(mine.tolist()), name
            order = [places[int(s)] for s in mine]
            centers = found["centers"].reshape(-1, 3)[rows]
            for what, a, b in (
                ("opacity", values[:, 0], g.opacities[order]),
                ("scales", np.log(values[:, 1:4]), g.scales[order].log()),
                ("quats", values[:, 4:8], g.quats[order]),
                ("colors", values[:, 8:], g.colors[order]),
                ("means", centers, g.means[order]),
            ):
                assert np.allclose(a, b.numpy(), atol=1e-3), (name, number, what)
            compared += len(order)
    return compared


def everywhere(model, part, eye):  # type: ignore[no-untyped-def]
    """All Gaussians of a part from one eye point, whatever direction they lie in."""
    camera = Camera(64, 64, 0.01, 0.01, 32.0, 32.0, np.eye(4))
    camera.w2c[:3, 3] = -eye
    rows = part.mask.any(dim=1).nonzero()[:, 0]
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
