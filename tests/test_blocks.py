"""Code on the pages works: Python runs, commands run on a tiny scene, or their words are parsed."""

import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gsynopsis as gs
from gsynopsis import cli
from gsynopsis.cli.flags import asked_of
from gsynopsis.config import resolve_settings
from gsynopsis.jobs import train as job
from gsynopsis.scene.camera import look_at
from research.suites.suite import read_suite
from tests.blocks import (
    PAGES,
    ROOT,
    SHELL,
    TEXT,
    Block,
    blocks_of,
    commands_of,
    our_words,
    script_of,
    suite_of,
)
from tests.formats.trees import write_tree

# What imports of a page find to look at is not looked at.
pytestmark = pytest.mark.usefixtures("few_tries")
MOST_NOT_RUN = 5
BLOCKS = [block for page in PAGES for block in blocks_of(page)]
RUN = [block for block in BLOCKS if not block.reason and block.language not in TEXT]
PYTHON_PAGES = sorted({block.page for block in RUN if block.language == "python"})
ONLY_PARSED = {"train", "unfold", "serve", "demo"}
"""Commands that take minutes by default, or never end."""
SHORT = {"train.steps": 20, "levels.steps": 20}
LINE = "time_s,mbit_per_s\n0,8\n1,4\n60,8\n"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a tiny scene and a run on it."""
    folder = tmp_path_factory.mktemp("trained")
    size = {"views": 10, "width": 64, "height": 48, "points": 600}
    scene = gs.load_scene(gs.make_scene("room", folder / "scene", **size))
    gs.train(scene, gs.resolve("standard", scene, SHORT), folder / "run")
    return folder


@pytest.fixture
def place(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own, in which the names that pages use are there."""
    for name in ("RUN", "runs/demo/run", "runs/fox"):
        shutil.copytree(trained / "run", tmp_path / name)
        # The record names the scene as seen from the run.
        record = (tmp_path / name / "run.json").read_text()
        scene = os.path.relpath(trained / "scene", tmp_path / name)
        (tmp_path / name / "run.json").write_text(record.replace('"../scene"', f'"{scene}"'))
    shutil.copytree(trained / "scene", tmp_path / "SCENE")
    (tmp_path / "LINE.csv").write_text(LINE)
    names = {"SPLATS.ply": "ply", "scene.ply": "ply", "point_cloud.ply": "ply", "other.spz": "spz4"}
    for name, kind in names.items():
        (tmp_path / name).write_bytes(write_tree(tmp_path / "tree", kind).read_bytes())
    (tmp_path / "cameras.json").write_text(json.dumps(cameras_around()))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def cameras_around() -> list[dict[str, Any]]:
    """A cameras.json of four cameras around the origin."""
    rows = list[dict[str, Any]]()
    for turn in np.arange(4) * np.pi / 2:
        eye = 6 * np.array([np.sin(turn), -0.2, np.cos(turn)])
        w2c = look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0]))
        pose = {"position": eye.tolist(), "rotation": w2c[:3, :3].T.tolist()}
        rows.append({**pose, "width": 96, "height": 64, "fx": 90.0, "fy": 90.0})
    return rows


def run_ours(words: list[str]) -> None:
    """A command for real, or what its words mean."""
    if words[0] in ONLY_PARSED or "--gpu" in words or any("://" in word for word in words):
        parsed: Any = cli.parse(words)
        if words[0] == "train":
            resolve_settings(parsed.quality, 10, asked_of(parsed.overrides))
        return
    if words[0] == "stream":
        words += ["--seconds", "0.5", "--width", "32"]
    if words[0] == "render":
        words += ["--width", "64"]
    if words[0] == "export" and "--fine-tune" not in words:
        words += ["--fine-tune", "20"]
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        assert cli.main(words) == 0, said.getvalue()


def run_script(script: str, options: list[str]) -> None:
    """The help of a script names the options that it is given."""
    command = [sys.executable, str(ROOT / script), "--help"]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert not [option for option in options if option.partition("=")[0] not in told]


def check_others(words: list[str]) -> None:
    """`make` has the target, and `pip` the extras; no other program is on the pages."""
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
        return
    assert words[:2] == ["pip", "install"], words
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = re.fullmatch(r"gsynopsis\[([\w,]+)\]", words[2])
    assert extras and {*extras[1].split(",")} <= {*project["optional-dependencies"]}


def run_shell(block: Block) -> None:
    for words in commands_of(block):
        if (ours := our_words(words)) is not None:
            run_ours(ours)
        elif (script := script_of(words)) is not None:
            run_script(*script)
        elif (suite := suite_of(words)) is not None:
            assert read_suite(ROOT / suite).cells
        else:
            check_others(words)


def shortened(
    preset: str = "standard",
    scene: Any = None,
    asked: Mapping[str, Any] | None = None,
    *,
    full: Any,
) -> gs.Recipe:
    """As `resolve`, with a few steps whatever is asked for."""
    return full(preset, scene, {**(asked or {}), **SHORT})


def small(kind: Any, out: Path, *, full: Any) -> Path:
    """As `make_scene`, with few small photos and points."""
    return full(kind, out, views=10, width=64, height=48, points=600)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_block_is_in_a_language_that_is_run_or_says_why_not(page: Path) -> None:
    known = SHELL | TEXT | {"python"}
    strange = [str(b) for b in blocks_of(page) if b.language not in known and not b.reason]
    assert not strange


def test_few_blocks_are_not_run() -> None:
    assert len([block for block in BLOCKS if block.reason]) <= MOST_NOT_RUN


@pytest.mark.parametrize("block", [b for b in RUN if b.language in SHELL], ids=str)
def test_commands_on_a_page_run(block: Block, place: Path) -> None:
    run_shell(block)


@pytest.mark.parametrize("page", PYTHON_PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_python_on_a_page_runs(page: Path, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gs, "resolve", partial(shortened, full=gs.resolve))
    monkeypatch.setattr(job, "resolve", partial(shortened, full=gs.resolve))
    monkeypatch.setattr(gs, "make_scene", partial(small, full=gs.make_scene))
    shutil.rmtree(place / "RUN")  # trained by other settings than those of the page
    names: dict[str, Any] = {}
    for block in blocks_of(page):
        if block.language == "python" and not block.reason:
            exec(compile("\n" * block.line + block.code, str(page), "exec"), names)


def test_a_command_that_does_not_parse_is_noticed(place: Path) -> None:
    block = Block(ROOT / "README.md", 1, "sh", "gsynopsis train SCENE --out RUN --sacle 4\n", "")
    with pytest.raises(SystemExit):
        run_shell(block)


def test_a_setting_that_is_not_there_is_noticed(place: Path) -> None:
    block = Block(ROOT / "README.md", 1, "sh", "gsynopsis train A --out B --set levels.no=4\n", "")
    with pytest.raises(gs.InputError):
        run_shell(block)


def test_a_mark_belongs_to_the_block_behind_it(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```sh\nmake demo\n```\n\n<!-- not run: why -->\n```html\n<a>\n```\n")
    first, second = blocks_of(page)
    assert (first.language, first.reason) == ("sh", "")
    assert (second.language, second.reason, second.line) == ("html", "why", 6)
