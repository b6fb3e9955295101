"""A suite from its file to its table: resumed, on processes and on Ray."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.evaluation.evaluate import evaluate
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import report_json
from gsynopsis.synthetic.make_scene import make_scene
from research.__main__ import main
from research.suites import run_suite as run
from research.suites.experiment import CELL_FILE, ROWS_FILE, rows_of
from research.suites.run_suite import run_suite
from research.suites.suite import Cell, read_suite
from tests.stage import LevelDecoder, fake_scene, level_set, renderer_of

ROOT = Path(__file__).parents[3]
SUITE = """
seeds = [0]
anchor = "plain"
[scenes.room]
path = "room"
split = "validation"
[methods.ours.set]
model = { slots = 2, hidden = 4, residual = 2 }
train.steps = 4
levels.steps = 4
[methods.plain.set]
"model.feature" = "free"
model = { slots = 2, hidden = 4 }
train.steps = 4
levels.steps = 4
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    make_scene("room", folder / "room", views=10, width=24, height=16, points=60)
    (folder / "suite.toml").write_text(SUITE)
    return folder / "suite.toml"


def rows_in(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def command(suite: Path, out: Path, *more: str) -> int:
    words = [str(suite), "--out", str(out), "--scenes", str(out / "scenes"), "--quiet"]
    return main([*words, *more])


def measured(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    """Without what differs from run to run."""
    clocks = ("seconds", "cpu_seconds", "peak_mib", "total_ms")
    return [{k: v for k, v in row.items() if k not in clocks} for row in rows]


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells run here, one after the other: a process for each would import torch for each."""

    def each(
        work: Callable[..., object], jobs: Mapping[str, tuple[object, ...]], processes: int
    ) -> Iterator[tuple[str, object]]:
        for name, arguments in jobs.items():
            yield name, work(*arguments)

    monkeypatch.setattr(run, "on_this_machine", each)


@pytest.fixture(scope="module")
def done(suite: Path) -> Path:
    out = suite.parent / "out"
    assert command(suite, out, "--jobs", "2") == 0
    return out


def test_a_suite_has_a_row_for_each_cell_and_level_and_a_page_without_links(done: Path) -> None:
    rows = rows_in(done)
    assert [(r["method"], r["level"]) for r in rows] == [
        (method, str(level)) for method in ("ours", "plain") for level in range(4)
    ]
    assert {(r["split"], r["test_photos"], r["width"]) for r in rows} == {("validation", "1", "24")}
    for row in rows:
        assert int(row["bytes_paper"]) > int(row["bytes_deflate"]) > 0 < int(row["bytes_raw"])
        assert 0 < float(row["flip_full"]) < 1
        assert float(row["psnr_full"]) > 1
        assert float(row["peak_mib"]) > 50
    page = (done / "results.html").read_text()
    assert page.count("<svg") == 2
    for heading in (
        "Each level at its own size",
        "Each level at the scale of the run",
        "Sizes and",
    ):
        assert heading in page
    assert page.index("<details>") < page.index("<td>igs</td>") < page.index("</details>")
    assert "http" not in page
    assert "24 × 16 pixels, 1 test photos" in page


def test_rows_of_a_scene_with_masks_count_inside_of_them() -> None:
    scene, inside = fake_scene(), np.zeros((64, 96), bool)
    inside[:, :20] = True
    scene.judged = lambda view, factor: inside
    options = Options(frames=1, pictures=0)
    model = LevelDecoder((0.2, 0.1, 0.04, 0.02))
    report = evaluate(model, level_set(), scene, renderer_of(scene), 1.0, options)
    cell = Cell("bust", "ours", 0, "bust", "standard")
    rows = rows_of(cell, json.loads(report_json(report)))
    for row, score in zip(rows, report.levels, strict=True):
        assert row["psnr_full"] == pytest.approx(score.quality.psnr_masked, abs=1e-4)
        assert row["psnr_train"] == pytest.approx(score.psnr_train_masked, abs=1e-4)
        assert row["ssim_full"] == pytest.approx(score.quality.ssim_full, abs=1e-4)


def test_finished_cells_are_not_run_again(
    suite: Path, done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(work: object, jobs: object, processes: int) -> list[object]:
        raise AssertionError("a finished cell was run again")

    before = (done / "results.csv").read_bytes()
    monkeypatch.setattr(run, "on_this_machine", refuse)
    assert command(suite, done) == 0
    assert (done / "results.csv").read_bytes() == before


def test_rows_of_finished_cells_are_there_before_the_others_end(
    suite: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = {
        cell: json.loads((folder / ROWS_FILE).read_text())
        for cell in ("ours", "plain")
        for folder in (done / "cells").glob(f"room-{cell}-0-*")
    }

    def stopped(work: object, jobs: dict[str, object], processes: int) -> Iterator[object]:
        first, _ = jobs
        yield first, kept["ours"]
        assert {row["method"] for row in rows_in(tmp_path)} == {"ours"}
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "on_this_machine", stopped)
    with pytest.raises(KeyboardInterrupt):
        run_suite(read_suite(suite), "suite", run.Places(tmp_path, tmp_path / "scenes"))
    assert rows_in(tmp_path) == [row for row in rows_in(done) if row["method"] == "ours"]


def test_a_half_finished_cell_of_another_version_is_one_line(
    suite: Path, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = next((done / "cells").glob("room-ours-0-*"))
    begun = tmp_path / "cells" / f"{cell.name[:-8]}01234567" / CELL_FILE
    begun.parent.mkdir(parents=True)
    begun.write_text(json.dumps({"version": "0.0.1"}))
    assert command(suite, tmp_path) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "found a half-finished cell of version 0.0.1" in line
    (begun.parent / ROWS_FILE).write_text("[]")  # a finished one is nobody's trouble
    assert not list((tmp_path / "cells").glob("room-plain*"))


def test_a_cell_that_fails_is_named_and_the_others_are_kept(
    suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(work: object, jobs: dict[str, object], processes: int) -> list[tuple[str, object]]:
        first, second = jobs
        return [(first, "SpaceError: full"), (second, [])]

    monkeypatch.setattr(run, "on_this_machine", half)
    assert command(suite, tmp_path) == 2
    assert capsys.readouterr().err == "gsynopsis: room-ours-0: SpaceError: full\n"


@pytest.mark.usefixtures("in_process")
def test_levels_of_another_s_full_model_are_those_of_a_training_of_its_own(
    suite: Path, tmp_path: Path
) -> None:
    head = SUITE[: SUITE.index("[methods.ours")].replace("plain", "full")
    few = "model = { slots = 2, hidden = 4, table_log2 = 4 }, train.steps = 4, levels.steps = 4"
    both = suite.with_name("unfolds.toml")
    both.write_text(
        f"""{head}
        [methods.first]
        unfolds = "full"
        set.levels.ablation = "lad"
        [methods.full]
        preset = "paper"
        set = {{ {few} }}
        [methods.alone]
        preset = "paper"
        set = {{ {few}, levels.ablation = "lad" }}
        """
    )
    assert command(both, tmp_path, "--jobs", "2") == 0
    rows = measured(rows_in(tmp_path))
    assert [row["method"] for row in rows] == ["first"] * 4 + ["full"] * 4 + ["alone"] * 4
    assert [r | {"method": ""} for r in rows[:4]] == [r | {"method": ""} for r in rows[8:]]
    assert rows[4]["bytes_compact"] != rows[0]["bytes_compact"]
    files = {cell.name[:9]: cell / "scene.gsyn" for cell in (tmp_path / "cells").iterdir()}
    assert files["room-firs"].read_bytes() == files["room-alon"].read_bytes()


@pytest.mark.usefixtures("in_process")
def test_baselines_stand_beside_ours_with_as_many_pictures(suite: Path, tmp_path: Path) -> None:
    rivals = suite.with_name("rivals.toml")
    text = SUITE[: SUITE.index("[methods.plain")].replace('"plain"', '"ours"')
    more = '[methods.rival]\nbaseline = { name = "prefix", rates = 4 }\nset = {'
    rivals.write_text(f"{text}{more} train.steps = 4, levels.steps = 4 }}\n")
    assert command(rivals, tmp_path) == 0
    rows = rows_in(tmp_path)
    assert [row["method"] for row in rows] == ["ours"] * 4 + ["rival"] * 4
    for row in rows[4:]:
        assert int(row["bytes_raw"]) == 59 * 4 * int(row["anchors"])
        assert float(row["psnr_full"]) > 5 and row["commit"] == rows[0]["commit"]
    (cell,) = (tmp_path / "cells").glob("room-rival-0-*")
    told = json.loads((cell / "metrics.json").read_text())
    assert told["steps"] == 4 + 3 * 4, "joint levels draw three pictures a step"
    assert told["preset"] == "prefix"


@pytest.mark.usefixtures("in_process")
def test_wide_photos_are_divided_and_other_folders_of_photos_are_read(
    suite: Path, tmp_path: Path
) -> None:
    room = tmp_path / "data" / "room"
    shutil.copytree(suite.parent / "room", room)
    (room / "images").rename(room / "images_1")
    text = SUITE[: SUITE.index("[methods.plain")].replace('"plain"', '"ours"')
    text = text.replace('path = "room"', 'path = "room"\nimages = "images_1"\nmax_width = 12')
    (tmp_path / "wide.toml").write_text(text)
    assert command(tmp_path / "wide.toml", tmp_path / "out", "--data", str(room.parent)) == 0
    assert {(row["width"], row["height"]) for row in rows_in(tmp_path / "out")} == {("12", "8")}


def kill_a_worker(mark: str, deadline: float) -> bool:
    """End a Ray process that runs a cell, of those that have a mark in their environment."""
    while time.monotonic() < deadline:
        for place in Path("/proc").glob("[0-9]*"):
            try:
                # Ray's own agents have names that begin with ray::, too.
                runs = (place / "cmdline").read_bytes().startswith(b"ray::run_cell")
                if runs and mark.encode() in (place / "environ").read_bytes():
                    os.kill(int(place.name), signal.SIGKILL)
                    return True
            except OSError:
                continue
        time.sleep(0.05)
    return False


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
def test_ray_gives_the_same_rows_also_when_a_worker_is_killed(
    suite: Path, done: Path, tmp_path: Path
) -> None:
    pytest.importorskip("ray")
    mark = str(tmp_path)
    words = ["-m", "research", str(suite), "--out", mark, "--ray", "local", "--quiet"]
    environment = {**os.environ, "BENCH_TEST": mark, "RAY_memory_monitor_refresh_ms": "0"}
    with subprocess.Popen([sys.executable, *words], env=environment, cwd=ROOT) as process:
        assert kill_a_worker(mark, time.monotonic() + 120)
        assert process.wait(240) == 0
    assert measured(rows_in(tmp_path)) == measured(rows_in(done))
