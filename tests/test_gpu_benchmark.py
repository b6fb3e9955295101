"""The check that the CUDA backend has to pass, on the CPU's; and what is said without CUDA."""

import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
import torch

from gsynopsis.render.base import Gaussians, Rendering
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "gpu" / "gpu.sh"
QUICK = ("plain", "column", "unseen", "none")


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = importlib.import_module("benchmarks.gpu.check")
    few = [case for case in module.cases() if case.name in QUICK]
    monkeypatch.setattr(module, "cases", lambda: few)
    return module


class Smeared(CpuRenderer):
    """Wrong by a tenth of a pixel, and blind for the first Gaussian."""

    def render(self, gaussians: Gaussians, camera: Camera, background: torch.Tensor) -> Rendering:
        drawn = super().render(gaussians, replace(camera, cx=camera.cx + 0.1), background)
        visible = drawn.visible.clone()
        visible[:1] = False
        return replace(drawn, visible=visible)


def test_the_cpu_backend_passes_and_the_result_is_written(check, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "check.json"
    settings = check.Settings("cpu", out, rounds=1, gaussians=20, commit="abc")
    assert check.main(settings) == 0
    result = json.loads(out.read_text())
    assert result["passed"]
    assert [record["name"] for record in result["checks"]] == [*QUICK, "grid", "loss"]
    assert result["timing"]["ratio"] > 0
    assert result["machine"]["commit"] == "abc"


def test_a_backend_that_is_a_little_wrong_fails(check) -> None:
    _, oracle = check.sides("cpu")
    wrong = check.Side(Smeared(), torch.float32)
    record = check.check_case(wrong, oracle, check.cases()[0])
    assert not record["passed"]
    assert {"image", "means.gradient", "screen.gradient", "weights", "unseen"} <= {
        *record["failed"]
    }


def test_an_error_that_is_no_number_fails(check) -> None:
    bad = check.relative(torch.tensor([float("nan")]), torch.ones(1))
    assert not check.judged("x", {"image": bad})["passed"]
    assert not check.judged("x", {"image": float("nan")})["passed"]


def test_without_cuda_the_check_says_so_in_a_line(check, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    assert check.main(check.Settings("cuda")) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_everything_that_the_machine_may_lack_is_carried() -> None:
    found = re.search(r'^WHEELS="([^"]*)"', SCRIPT.read_text("utf-8"), re.MULTILINE)
    assert found
    carried = {plain_name(name) for name in found[1].split()}
    project = tomllib.loads((SCRIPT.parents[2] / "pyproject.toml").read_text("utf-8"))
    extras = project["project"]["optional-dependencies"]
    tools = [n for n in extras["dev"] if n.startswith(("pytest>", "hypothesis>"))]
    wanted = [*project["build-system"]["requires"], *project["project"]["dependencies"], *tools]
    wanted += [*extras["train"], *extras["plots"]]
    own = {"torch", "numpy", "scipy", "pillow", "matplotlib"}  # the machine's, as the script says
    assert {plain_name(name) for name in wanted} - own <= carried


def plain_name(requirement: str) -> str:
    return re.split("[<>=!~ ]", requirement)[0].lower().replace("_", "-")


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
@pytest.mark.parametrize(
    ("words", "said"),
    [(["run"], "no CUDA device"), (["run", "--fast"], "--fast"), ([], "prepare | run")],
)
def test_the_script_says_in_one_line_why_it_does_not_run(words: list[str], said: str) -> None:
    environment = {**os.environ, "PYTHON": sys.executable, "CUDA_VISIBLE_DEVICES": ""}
    line = ["bash", str(SCRIPT), *words]
    done = subprocess.run(line, capture_output=True, text=True, env=environment)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert said in done.stderr
