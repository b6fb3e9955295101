import json
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.cli import main
from gsynopsis.container import describe, read_gsyn, write_gsyn
from tests.level_sets import BOTH, assert_same, make_level_set


@pytest.fixture
def path(tmp_path: Path) -> Path:
    found = tmp_path / "scene.gsyn"
    write_gsyn(make_level_set(np.random.default_rng(0), BOTH), found)
    return found


def test_check_says_what_a_good_file_holds(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(path)]) == 0
    assert "valid, 4 levels, 40 anchors" in capsys.readouterr().out
    assert main(["check", str(path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["valid"] is True
    assert [level["anchors"] for level in said["levels"]] == [4, 11, 23, 40]


def test_check_refuses_a_damaged_file_in_one_line(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert main(["check", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "level 3 block 0: found CRC-32" in error


def test_cut_says_where_it_wrote(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cut", str(path), "--level", "1"]) == 0
    cut = path.with_name("scene.L1.gsyn")
    assert f"wrote {cut}" in capsys.readouterr().out
    assert_same(read_gsyn(cut), read_gsyn(path, 1))
    folder = path.parent / "pieces"
    assert main(["cut", str(path), "--all", "--out", str(folder)]) == 0
    assert capsys.readouterr().out.count("wrote ") == 4
    joined = b"".join(
        sorted((p.name, p.read_bytes()) for p in folder.iterdir())[k][1] for k in range(4)
    )
    assert joined == path.read_bytes()
    assert main(["cut", str(path), "--level", "9"]) == 2
    assert "level: found 9, expected 0 to 3" in capsys.readouterr().err
    for words, found in (([], "neither"), (["--all", "--level", "1"], "both")):
        assert main(["cut", str(path), *words]) == 2
        said = f"--level or --all: found {found}, expected one of them"
        assert said in capsys.readouterr().err


def test_info_shows_blocks_and_codings(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(path)]) == 0
    text = capsys.readouterr().out
    assert "blocks" in text
    assert "curve8" in text
    assert main(["info", str(path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["head_bytes"] == describe(path).head_bytes


@pytest.mark.parametrize("words", [["cut", "--level", "0", "--overwrite", "--out"]])
@pytest.mark.parametrize("folder", ["", ".", "pieces"])
def test_a_folder_in_place_of_a_file_is_one_line(
    path: Path, words: list[str], folder: str, capsys: pytest.CaptureFixture[str], monkeypatch
) -> None:
    monkeypatch.chdir(path.parent)
    (path.parent / "pieces").mkdir()
    for line in ([words[0], str(path), *words[1:], folder], ["view", str(path), "--html", folder]):
        assert main(line) == 2
        error = capsys.readouterr().err
        assert "found a folder, expected the name of a file" in error and error.count("\n") == 1
    assert sorted(p.name for p in path.parent.iterdir()) == ["pieces", "scene.gsyn"]
