"""The script for a machine that has a GPU but no network."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "gpu" / "gpu.sh"


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
