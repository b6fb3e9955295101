"""The check that a device has to pass: the CPU passes it, what is a little wrong does not."""

import json
from pathlib import Path

import pytest
import torch

from gsynopsis import cli
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.reference import ReferenceRenderer
from gsynopsis.selftest.check_device import Effort, check_device, compare_trainings
from gsynopsis.selftest.findings import judged, relative
from gsynopsis.selftest.raster_cases import cases
from gsynopsis.selftest.rasterizer import Side, check_case, check_rasterizer
from tests.selftest.smeared import Smeared

QUICK = ("plain", "column", "unseen", "none")
FEW = [case for case in cases() if case.name in QUICK]
ORACLE = Side(ReferenceRenderer(), torch.float64)


def test_the_cpu_rasterizer_passes() -> None:
    found = check_rasterizer(Side(CpuRenderer(), torch.float32), ORACLE, FEW)
    assert [one.name for one in found] == list(QUICK)
    assert [one.failed for one in found] == 4 * [[]]


def test_a_rasterizer_that_is_a_little_wrong_fails() -> None:
    finding = check_case(Side(Smeared(), torch.float32), ORACLE, cases()[0])
    wrong = {"image", "means.gradient", "screen.gradient", "weights", "unseen"}
    assert wrong <= set(finding.failed)
    assert "FAILED: image" in finding.text()


def test_an_error_that_is_no_number_fails() -> None:
    bad = relative(torch.tensor([float("nan")]), torch.ones(1))
    for value in (bad, float("nan")):
        assert judged("x", {"image": value}, {"image": 1.0}).failed == ["image"]


def test_trainings_may_differ_by_little() -> None:
    curve = {"full 50": 10.0, "full 100": 15.0, "full 150": 20.0}
    oracle = {"curve": curve, "levels": [20.0, 21.0]}
    better = {"curve": curve | {"full 50": 14.0}, "levels": [25.0, 20.8]}
    assert compare_trainings(better, oracle).failed == []
    worse = {"curve": curve | {"full 150": 18.0}, "levels": [19.0, 21.0]}
    assert compare_trainings(worse, oracle).failed == ["full 150.curve", "L0.level"]


def test_a_whole_check_is_told_line_by_line_and_fits_json() -> None:
    told: list[str] = []
    effort = Effort(width=24, views=6, scales=(2.0, 1.0), grow=3, steps=3, rounds=1)
    document = check_device("cpu", told.append, effort)
    assert document["passed"] and json.loads(json.dumps(document)) == document
    assert {"step 12 × 8", "step 24 × 16", "training"} <= {c["name"] for c in document["checks"]}
    for times in document["times"].values():
        assert times["cpu"]["whole"] > 0 and times["cpu"]["parts"]["rasterizer, backward"] > 0
    assert len(document["trainings"]["cpu"]["levels"]) == 4
    assert any("ms a step" in line for line in told) and told[-1].endswith("ok")


def test_without_cuda_the_doctor_says_so_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "gsplat", None)
    assert cli.main(["doctor", "--gpu", "--out", str(tmp_path / "gpu.json")]) == 2
    said = capsys.readouterr()
    assert len(said.err.splitlines()) == 1 and "gsplat is not installed" in said.err
    assert said.out == "" and not list(tmp_path.iterdir())
