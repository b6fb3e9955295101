"""What is no scene, or wants too much, and where commands may not write."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.robust.commands import commands, outcome
from benchmarks.robust.forge import with_header
from benchmarks.robust.mutants import seeds
from gsynopsis.cli import main
from gsynopsis.container import encode, layout, write_gsyn
from gsynopsis.records import Frame, Level, LevelSet, Shared, morton_order, network_shapes
from tests.level_sets import Shape, make_level_set

NAMES = list(commands(Path(), Path(), Path()))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.gsyn"
    write_gsyn(make_level_set(np.random.default_rng(0)), path)
    return path


@pytest.fixture
def strange(tmp_path: Path) -> dict[str, Path]:
    """What stands where a file is expected."""
    zeros, forged, fifo = tmp_path / "zeros", tmp_path / "forged", tmp_path / "fifo"
    with zeros.open("wb") as file:
        file.truncate(20 << 30)
    with forged.open("wb") as file:
        file.write(seeds()[0])
        file.truncate(20 << 30)
    os.mkfifo(fifo)
    device = Path("/dev/zero")
    return {"zeros": zeros, "forged": forged, "fifo": fifo, "device": device, "folder": tmp_path}


def run(name: str, file: Path, folder: Path) -> None:
    """A command refuses a file with one line."""
    trace = folder / "line.csv"
    trace.write_text("time_s,mbit_per_s\n0,20\n100,20\n")
    found = outcome(commands(file, folder, trace)[name])
    assert (found.code, found.trouble) == (2, "")


@pytest.mark.parametrize("kind", ["zeros", "forged", "fifo", "device", "folder"])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_scene_is_refused_before_it_is_read(
    name: str, kind: str, strange: dict[str, Path], tmp_path: Path
) -> None:
    """20 GiB would not fit, a device never ends, and nobody writes to the FIFO."""
    run(name, strange[kind], tmp_path)


def crowd(anchors: int, slots: int) -> LevelSet:
    """Gaussians that each fill the picture, in very few bytes."""
    side = np.arange(anchors)
    lattice = np.stack([side % 40, side // 40 % 40, side // 1600], axis=1).astype(np.int32) - 20
    shapes = network_shapes(1, slots, 1, None)
    networks = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    networks["opacity_b2"] += 3
    networks["cov_b2"] += 1
    mask = np.ones((anchors, slots), np.bool_)
    level = Level(mask, 0, np.zeros((0, 0), np.float32), networks, np.ones(3, np.float32))
    shared = Shared(
        lattice=lattice[morton_order(lattice)],
        log_scales=np.full((anchors, 6), 3, np.float32),
        offsets=np.zeros((anchors, slots, 3), np.float32),
        codes=np.zeros(0, np.uint8),
        residual=np.zeros((anchors, 1), np.float32),
        grids=(),
        grid_resolutions=(),
    )
    return LevelSet(Frame(0.01, np.zeros(3), 1.0, False, 3.0), shared, (level,))


def test_a_small_file_of_huge_gaussians_is_refused_in_little_memory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """671 bytes once took 1.2 GiB: each Gaussian lies over every tile of the picture."""
    path = tmp_path / "crowd.gsyn"
    path.write_bytes(encode(crowd(1000, 32), "compact"))
    assert path.stat().st_size < 1000
    assert main(["check", str(path)]) == 0
    assert main(["render", str(path), "--out", str(tmp_path), "--orbit", "1", "--quiet"]) == 2
    error = capsys.readouterr().err
    assert "pairs of Gaussian and tile" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("slots", [33, int(layout.fields_of(layout.Header)["slots"].high)])
def test_all_slots_that_the_format_allows_are_rendered(slots: int, tmp_path: Path) -> None:
    path = tmp_path / "slots.gsyn"
    path.write_bytes(
        encode(make_level_set(np.random.default_rng(1), Shape(slots=slots)), "compact")
    )
    line = ["render", str(path), "--out", str(tmp_path / "out"), "--orbit", "1", "--width", "32"]
    assert main([*line, "--quiet"]) == 0
    assert list((tmp_path / "out").iterdir())


def test_what_a_file_says_of_itself_cannot_steer_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    levels = make_level_set(np.random.default_rng(0))
    named = replace(levels.levels[0], quality={"\x1b[31mpsnr\x9b": 1.0})
    notes = {"scene": "\x1b]0;title\x07", "\x9b2J": "é", "lost": "\ud800"}
    path = tmp_path / "scene.gsyn"
    write_gsyn(replace(levels, meta=notes, levels=(named, *levels.levels[1:])), path)
    for words in (["info"], ["info", "--json"], ["check"]):
        assert main([*words, str(path)]) == 0
        said = capsys.readouterr().out
        assert said.encode().decode() == said
        assert all(line.isprintable() for line in said.splitlines())
    # A name from elsewhere may be no UTF-8, and steer as well.
    odd = path.rename(tmp_path / os.fsdecode(b"caf\xe9\x1b[31m.gsyn"))
    for words in (["check"], ["info"], ["cut", "--level", "0"], ["cut", "--all"], ["view"]):
        assert main([words[0], str(odd), *words[1:]]) == 0
        said = capsys.readouterr().out
        assert "caf\\udce9\\x1b" in said
        assert all(line.isprintable() for line in said.splitlines())
    assert main(["check", str(tmp_path / "\x1b[31m.gsyn")]) == 2
    assert "\\x1b[31m" in capsys.readouterr().err


def positions_far_away(data: bytes) -> Iterator[bytes]:
    """Headers whose positions, or their distances, would be infinite in float32."""
    for field in ("voxel", "radius", "extent"):
        yield with_header(data, **{field: 1e300})
        yield with_header(data, **{field: 1e-300})
    yield with_header(data, center_y=-1e300)


def test_a_frame_whose_positions_would_not_be_finite_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "far.gsyn"
    for data in positions_far_away(seeds()[0]):
        path.write_bytes(data)
        run("check", path, tmp_path)


def test_cut_replaces_no_file_unasked_and_never_its_source(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, line = scene.read_bytes(), ["cut", str(scene), "--level", "0"]
    for target in (scene, scene.parent / "link.gsyn"):
        if target != scene:
            target.hardlink_to(scene)
        assert main([*line, "--out", str(target)]) == 2
        assert main([*line, "--out", str(target), "--overwrite"]) == 2
        assert "expected another name" in capsys.readouterr().err
        assert scene.read_bytes() == before
    assert main(line) == 0
    assert main(line) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*line, "--overwrite"]) == 0
