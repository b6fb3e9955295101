"""`export` from the outside: files, records, and one clear line for what cannot be."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsynopsis import cli
from gsynopsis.container import write_gsyn
from gsynopsis.formats.readers.ply import read_ply
from gsynopsis.jobs import export as exporting
from gsynopsis.jobs.manifest_notes import circle_of_cameras, circle_text
from gsynopsis.model.build import model_to_levels
from gsynopsis.records import ORBIT_NOTE
from tests.level_sets import SPLATS, make_level_set
from tests.tiny import tiny_model, tiny_scene


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(exporting, "ORBIT", 4)
    scene = tiny_scene()
    circle = circle_of_cameras([scene.camera(view) for view in scene.train])
    notes = {ORBIT_NOTE: circle_text(circle)}
    write_gsyn(model_to_levels(tiny_model(), notes), tmp_path / "tiny.gsyn")
    return tmp_path / "tiny.gsyn"


def test_a_file_without_photos_is_baked_from_what_it_knows(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["export", str(file), "--quiet"]) == 0
    text = capsys.readouterr().out
    assert "no photos are known" in text and "tiny_L0.ply" in text
    ply = file.with_name("tiny_L0.ply")
    assert ply.read_bytes().startswith(b"ply\n")
    record = json.loads(file.with_name("tiny_L0.ply.json").read_text())
    assert record["files"][0]["bytes"] == ply.stat().st_size
    assert record["files"][0]["stages"] is None


def test_json_says_what_was_written(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = file.with_name("a.glb")
    words = ["export", str(file), "--format", "glb", "--out", str(out), "--json", "--quiet"]
    assert cli.main([*words, "--sh-degree", "1"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)
    assert entry["path"] == str(out) and entry["bytes"] == out.stat().st_size


def test_splats_are_not_baked_but_written_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "splats.gsyn", tmp_path / "splats.ply"
    levels = make_level_set(np.random.default_rng(1), SPLATS)
    write_gsyn(levels, file)
    words = ["export", str(file), "--out", str(out), "--sh-degree", "1", "--quiet"]
    assert cli.main(words) == 0
    (found,) = read_ply(out).levels
    assert (len(found), found.degree) == (levels.levels[-1].anchors, 1)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--level", "7"], "--level"),
        (["--level", "0", "--all-levels"], "--level"),
        (["--sh-degree", "4"], "--sh-degree"),
        (["--fine-tune", "5"], "--fine-tune"),
    ],
)
def test_what_cannot_be_is_one_line(
    words: list[str], told: str, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["export", str(file), "--quiet", *words]) == 2
    line = capsys.readouterr().err
    assert told in line and line.count("\n") == 1
    assert not [*file.parent.glob("*.ply*")]


def test_a_file_that_is_there_stays_without_overwrite(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = file.with_name("tiny_L0.ply")
    there.write_bytes(b"mine")
    assert cli.main(["export", str(file), "--quiet"]) == 2
    assert "--overwrite" in capsys.readouterr().err and there.read_bytes() == b"mine"
    assert cli.main(["export", str(file), "--quiet", "--overwrite"]) == 0
    assert there.read_bytes() != b"mine"


def test_a_full_disk_leaves_nothing(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from gsynopsis.container import writer

    monkeypatch.setattr(
        writer.shutil, "disk_usage", lambda path: type("Usage", (), {"free": 10, "total": 0})
    )
    assert cli.main(["export", str(file), "--quiet"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert [path.name for path in file.parent.iterdir()] == ["tiny.gsyn"]
