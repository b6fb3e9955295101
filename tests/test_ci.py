"""CI's command brings what tests would be skipped for, and goes on where it cannot."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.bench import ROOT

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
ALL = ("chromium", "ffmpeg", "nginx")


def commands(
    folder: Path, there: tuple[str, ...], user: int = 0, debian: bool = True, apt: int = 0
) -> list[str]:
    """What `.ci/run` called of `apt-get` and `make` on a machine that has some programs."""
    log = folder / "log"
    bodies = {
        "apt-get": f'echo "apt-get $@" >> {log}; exit {apt}',
        "make": f'echo "make $@" >> {log}',
        "id": f"echo {user}",
        "grep": f"exit {int(not debian)}",
        **dict.fromkeys(there, "exit 1"),
    }
    for name, body in bodies.items():
        path = folder / name
        path.write_text(f"#!/bin/sh\n{body}\n")
        path.chmod(0o755)
    for name in ("bash", "dirname", "env", "timeout"):
        (folder / name).symlink_to(str(shutil.which(name)))
    command = [str(folder / "bash"), str(ROOT / ".ci" / "run")]
    subprocess.run(command, env={"PATH": str(folder)}, check=True, capture_output=True)
    return log.read_text().splitlines()


def test_what_is_missing_is_installed_before_the_tests(tmp_path: Path) -> None:
    update, install, make = commands(tmp_path, there=("ffmpeg",))
    assert update.startswith("apt-get update") and make == "make test"
    assert install.startswith("apt-get install") and install.endswith(" chromium nginx-light")


@pytest.mark.parametrize(
    "machine",
    [
        {"there": ALL},
        {"there": ("google-chrome", "ffmpeg", "nginx")},
        {"there": (), "user": 1000},
        {"there": (), "debian": False},
    ],
    ids=["nothing missing", "another browser", "not root", "not Debian"],
)
def test_else_nothing_is_installed(machine: dict[str, object], tmp_path: Path) -> None:
    assert commands(tmp_path, **machine) == ["make test"]  # type: ignore[arg-type]


def test_without_a_registry_the_tests_run_all_the_same(tmp_path: Path) -> None:
    *_, make = commands(tmp_path, there=(), apt=100)
    assert make == "make test"
