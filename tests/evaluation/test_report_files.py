"""The files of a report: their promises to scripts and to readers."""

import csv
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import MissingExtraError
from gsynopsis.evaluation.evaluate import evaluate
from gsynopsis.evaluation.formatting import duration, size, text_table
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Provenance, Report, report_json, report_table
from gsynopsis.evaluation.report_curves import quality_curves
from gsynopsis.evaluation.report_files import write_report
from gsynopsis.files import publish, published
from tests.stage import LevelDecoder, fake_scene, level_set, renderer_of

TOP = ["scene", "scale", "preset", "seed", "steps", "train_seconds", "anchors", "levels"]
LEVEL = [
    *("level", "anchors", "slots", "psnr_full", "ssim_full", "psnr_own", "ssim_own"),
    *("bytes_raw", "bytes_deflate", "bytes_compact", "delta_compact", "render_ms"),
]
SIZES = ("full", "photo", "own")
RAY_OFFSET = [
    *("protocol", "split", "machine", "gsynopsis", "commit", "pyramid", "per_view"),
    *("fingerprint", "size", "notes", "renderer", "lpips"),
]


@pytest.fixture(scope="module")
def folder(report: Report, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "new" / "folder"
    written = write_report(report, path)
    assert written.notes == ()
    assert sorted(p.name for p in written.files) == sorted(p.name for p in path.iterdir())
    return path


@pytest.fixture(scope="module")
def metrics(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text("utf-8"))


def test_metrics_json_has_every_promised_key_in_order(metrics: dict[str, Any]) -> None:
    assert list(metrics)[: len(TOP)] == TOP
    assert set(RAY_OFFSET) <= set(metrics)
    for number, level in enumerate(metrics["levels"]):
        assert set(LEVEL) <= set(level)
        assert level["level"] == number


def test_metrics_json_holds_the_values_of_the_report(
    metrics: dict[str, Any], report: Report
) -> None:
    assert [metrics[k] for k in TOP[:6]] == ["pattern", 1.0, "standard", 7, 2400, 83.25]
    assert metrics["anchors"] == report.levels[-1].anchors
    for level, score in zip(metrics["levels"], report.levels, strict=True):
        assert level["psnr_full"] == score.quality.psnr_full
        assert level["bytes_compact"] == score.sizes.bytes_compact
        assert level["delta_compact"] == score.sizes.delta_compact
        assert level["render_ms"] == score.timing.total_ms
    assert len(metrics["per_view"]) == len(report.views) == 12


def test_deltas_add_up_to_the_cumulative_bytes(metrics: dict[str, Any]) -> None:
    for form in ("raw", "deflate", "compact"):
        total = 0
        for level in metrics["levels"]:
            total += level[f"delta_{form}"]
            assert level[f"bytes_{form}"] == total


def test_metrics_json_is_strict_json_even_for_identical_images(report: Report) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    assert report.levels[-1].quality.psnr_full == 100.0
    json.loads(report_json(report), parse_constant=refuse)


def test_an_unknown_origin_is_null_and_n_a(report: Report) -> None:
    unknown = json.loads(report_json(replace(report, provenance=Provenance())))
    assert [unknown[k] for k in ("preset", "seed", "steps", "train_seconds")] == [None] * 4
    assert unknown["lpips"] == "n/a"


def test_csv_holds_the_rows_of_the_json(folder: Path, metrics: dict[str, Any]) -> None:
    for name, rows in {"metrics.csv": metrics["levels"], "views.csv": metrics["per_view"]}.items():
        table = list(csv.DictReader(io.StringIO((folder / name).read_text("utf-8"))))
        assert table == [{k: "" if v is None else str(v) for k, v in row.items()} for row in rows]


class Links(HTMLParser):
    """Collects everything in a page that could fetch something."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [v for k, v in attrs if v and k.split(":")[-1] in {"src", "href", "srcset"}]


def test_the_page_needs_nothing_from_elsewhere(folder: Path) -> None:
    page = (folder / "report.html").read_text("utf-8")
    parser = Links()
    parser.feed(page)
    assert parser.links
    assert all(link.startswith(("data:image/", "#")) for link in parser.links)
    assert "http://" not in page
    assert "https://" not in page
    assert "@import" not in page
    assert not {"script", "link", "iframe"} & set(parser.tags)
    assert all(u.startswith("#") for u in re.findall(r"url\(([^)]*)\)", page))


def test_the_page_shows_two_separate_curves_the_table_and_every_picture(
    folder: Path, report: Report
) -> None:
    page = (folder / "report.html").read_text("utf-8")
    parser = Links()
    parser.feed(page)
    assert parser.tags.count("svg") == 2
    assert parser.tags.count("img") == 2 * (1 + 2 * 4)
    for score in report.levels:
        assert f"{score.quality.psnr_own:.2f}" in page
    for word in ("standard", "2,400", "1 min 23 s", "every8", "a scene made by hand"):
        assert word in page
    assert "prefers-color-scheme: dark" in page


def test_a_hostile_name_is_text_in_the_page(report: Report, tmp_path: Path) -> None:
    hostile = replace(report, scene="<script>alert(1)</script>", pictures=())
    write_report(hostile, tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert not (tmp_path / "contact.png").exists()


def test_curves_have_no_ink_but_the_page_s_and_own_marker_names(report: Report) -> None:
    full, own = (quality_curves(report.levels, p) for p in ("full", "own"))
    for svg in (full, own):
        assert "<style" not in svg
        assert not re.findall(r"(?:fill|stroke): #", svg)
    names = [set(re.findall(r' id="([^"]*)"', svg)) for svg in (full, own)]
    assert not names[0] & names[1]


def test_without_the_plots_extra_there_is_a_note_instead_of_a_page(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "jinja2", None)
    monkeypatch.delitem(
        __import__("sys").modules, "gsynopsis.evaluation.report_html", raising=False
    )
    written = write_report(report, tmp_path)
    assert "report.html" not in {p.name for p in written.files}
    assert "gsynopsis[plots]" in written.notes[0]
    with pytest.raises(MissingExtraError):
        import gsynopsis.evaluation.report_html  # noqa: F401


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    target = publish(tmp_path / "a" / "b.json", "old")
    with pytest.raises(RuntimeError), published(target) as draft:
        draft.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert [p.name for p in target.parent.iterdir()] == ["b.json"]
    publish(target, b"new")
    assert target.read_text() == "new"


def test_an_interrupt_leaves_the_older_report(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(tmp_path / "contact.png", b"older")

    def interrupted(*_args: object, **_options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Image.Image, "save", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_report(report, tmp_path)
    assert (tmp_path / "contact.png").read_bytes() == b"older"
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_the_printed_table_has_a_line_per_level_and_aligned_columns(report: Report) -> None:
    lines = report_table(report).splitlines()
    assert len(lines) == 2 + 4 + 2
    assert len({len(line) for line in lines[:6]}) == 1
    assert lines[0].split() == ["level", "anchors", "MiB", "dB", "ms"]
    assert lines[-2] == "dB: PSNR of 3 held-out views of 96 × 64, the photos' own size"
    assert lines[-1].endswith(" dB on 3 of 7 training photos")
    assert lines[-1].split()[:4] == [f"{score.psnr_train:.2f}" for score in report.levels]
    assert text_table(["a", "bb"], [["ccc", "d"]]) == "a    bb\n───  ──\nccc   d"


def test_photos_with_masks_are_judged_inside_of_them_wherever_decibels_stand(
    tmp_path: Path,
) -> None:
    """Outside nothing is trained: finer levels may be farther from a photo's surroundings."""
    scene, inside = fake_scene(), np.zeros((64, 96), bool)
    inside[:, :20] = True
    scene.judged = lambda view, factor: inside
    options = Options(frames=1, pictures=1)
    report = evaluate(
        LevelDecoder((0.2, 0.1, 0.04, 0.02)), level_set(), scene, renderer_of(scene), 1.0, options
    )
    qualities = [score.quality for score in report.levels]
    assert all(each.psnr == each.psnr_masked for each in qualities)
    assert qualities[0].psnr != qualities[0].psnr_full
    said = report_table(report)
    assert "dB: PSNR inside the masks of 3 held-out views" in said
    for line, quality in zip(said.splitlines()[2:6], qualities, strict=True):
        assert line.split()[3] == f"{quality.psnr:.2f}"
    whole = " ".join(f"{each.psnr_full:.2f}" for each in qualities)
    assert f"{whole} dB of whole photos" in said
    write_report(report, tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "inside the masks" in page and f"{qualities[-1].psnr:.2f}" in page
    figures = qualities[0].figures()
    assert figures["psnr_full"] == figures["psnr_masked"] == round(qualities[0].psnr, 5)
    assert "psnr_photo" not in figures


@pytest.fixture(scope="module")
def half() -> Report:
    scene = fake_scene()
    options = Options(frames=1, warmup=0, pictures=1, photo_pixels=2 * 4 * 96 * 64)
    decoder = LevelDecoder((0.2, 0.1, 0.04, 0.02))
    return evaluate(decoder, level_set(), scene, renderer_of(scene), 2.0, options)


def test_every_figure_names_the_size_of_its_pictures(half: Report, tmp_path: Path) -> None:
    write_report(half, tmp_path)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["size"] == [48, 32]
    assert metrics["photo_size"] == [96, 64]
    assert (metrics["photo_views"], metrics["held_out_views"]) == (2, 3)
    for row in metrics["levels"]:
        sizes = [[row[f"{side}_{kind}"] for side in ("width", "height")] for kind in SIZES]
        assert sizes == [[48, 32], metrics["photo_size"], list(half.levels[row["level"]].own_size)]
        assert row["psnr_photo"] > 0
    page = (tmp_path / "report.html").read_text("utf-8").replace("\u00a0", " ")
    assert "full resolution" not in page
    for words in (
        "PSNR, 48 × 32",
        "PSNR, 96 × 64",
        "PSNR, training photos",
        "2 of 3 compared at that size",
    ):
        assert words in page
    said = report_table(half).splitlines()[-3:]
    assert said[0] == "dB: PSNR of 3 held-out views of 48 × 32"
    assert said[1].endswith("dB at the photos' own size, 96 × 64 (2, evenly chosen, of 3)")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.4, "0 s"), (59.6, "1 min 00 s"), (200, "3 min 20 s"), (7500, "2 h 05 min")],
)
def test_durations_read_well(value: float, text: str) -> None:
    assert duration(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(12, "12 B"), (2048, "2.0 KiB"), (3 * 2**20, "3.00 MiB")]
)
def test_sizes_take_the_unit_that_fits(value: int, text: str) -> None:
    assert size(value) == text
