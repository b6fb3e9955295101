"""Trainings below a limit of memory: the same file, nothing left behind, full disks in one line."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gsynopsis._native import spill
from gsynopsis.config import replaced
from gsynopsis.errors import SpaceError
from gsynopsis.pipeline import planning, spilling
from gsynopsis.pipeline.planning import bounded_setup, plan_of
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.synthetic import make_scene
from gsynopsis.training.state import Setup
from tests.tiny import tiny_config, tiny_scene

needs_library = pytest.mark.skipif(spill.library() is None, reason="memory does not spill here")
CPU = torch.device("cpu")
SHORT = ["--set", "train.steps=60", "levels.steps=20", "--no-evaluate", "--quiet"]
SPILLED_EARLY = """
import os, sys
from gsynopsis import __main__
from gsynopsis._native import spill
spill.SMALLEST = 4096
code = __main__.main()
print(os.environ.get("LD_PRELOAD", "none"), spill.held() > 0)
sys.exit(code)
"""


def run(*words: str, script: str = SPILLED_EARLY) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-c", script, *words]
    return subprocess.run(line, capture_output=True, text=True, timeout=500)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room") / "scene"
    return make_scene("room", folder, views=10, width=48, height=32, points=600)


@needs_library
@pytest.mark.parametrize("blocks", [(), ("--blocks", "2", "--jobs", "2")])
def test_a_limit_changes_no_byte_and_leaves_no_file(
    blocks: tuple[str, ...], room: Path, tmp_path: Path
) -> None:
    plain, below = tmp_path / "plain", tmp_path / "below"
    words = "train", str(room), *SHORT, *blocks
    assert run(*words, "--out", str(plain)).stdout.split() == ["none", "False"]
    done = run(*words, "--out", str(below), "--max-memory=1.5")
    assert done.stdout.split() == ["none", "True"], done.stderr
    assert (below / "scene.gsyn").read_bytes() == (plain / "scene.gsyn").read_bytes()
    names = [{path.relative_to(out) for path in out.rglob("*")} for out in (plain, below)]
    assert names[0] == names[1]


@needs_library
def test_only_a_training_with_a_limit_begins_anew(room: Path, tmp_path: Path) -> None:
    script = SPILLED_EARLY.replace("spill.held() > 0", "spill.is_loaded()")
    assert run("--version", script=script).stdout.split()[-2:] == ["none", "False"]
    words = "train", str(room), "--out", str(tmp_path / "run")
    refused = run(*words, "--max_memory", "0.1", script=script)
    assert refused.returncode == 2 and refused.stdout.split() == ["none", "True"]
    assert "--max-memory: found 0.1 GiB, expected at least 0.30 GiB" in refused.stderr
    assert not (tmp_path / "run").exists()


def test_a_limit_bounds_photos_and_leaves_anchors_alone_where_memory_spills(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    setup = Setup(tiny_scene(), tiny_config(), make_renderer("cpu"))
    monkeypatch.setattr(planning, "spills", lambda device: True)
    limited = bounded_setup(setup, 0.6)
    assert limited.config == setup.config and limited.lazy
    assert setup.scene.cache.budget == round(0.075 * 2**30)
    few = replace(setup, config=replaced(setup.config, {"train.growth.max_anchors": 130}))
    assert plan_of(few).most_bytes < 0.6 * 2**30 and bounded_setup(few, 0.6) == few


def test_a_gpu_does_not_spill(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spilling, "is_loaded", lambda: True)
    assert spilling.spills(CPU) and not spilling.spills(torch.device("cuda"))


def test_a_full_disk_is_one_line_and_other_errors_are_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits: list[int] = []
    monkeypatch.setattr(spilling, "is_loaded", lambda: True)
    monkeypatch.setattr(spilling, "begin", lambda folder, limit: limits.append(limit))
    kinds = MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried")
    for error in kinds:
        with (
            pytest.raises(SpaceError, match=r"room for memory beyond the 0\.5 GiB of --max-memory"),
            spilling.spilling(tmp_path, CPU, 0.5),
        ):
            raise error
    assert limits == [2**29, 2**29]
    with pytest.raises(RuntimeError, match="shapes"), spilling.spilling(tmp_path, CPU, 0.5):
        raise RuntimeError("shapes")
    with pytest.raises(MemoryError), spilling.spilling(tmp_path, CPU, None):
        raise MemoryError
    assert limits == [2**29] * 3


def test_a_folder_that_cannot_have_the_file_is_named(tmp_path: Path) -> None:
    if spill.library() is None:
        pytest.skip("memory does not spill here")
    script = "import sys\nfrom pathlib import Path\nfrom gsynopsis._native import spill\n"
    script += "try: spill.begin(Path(sys.argv[1]), 1 << 30)\nexcept Exception as e: print(e)"
    environment = os.environ | {"LD_PRELOAD": str(spill.library())}
    line = [sys.executable, "-c", script, str(tmp_path / "missing")]
    done = subprocess.run(line, capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.startswith(f"{tmp_path / 'missing'}: memory: found No such file")
