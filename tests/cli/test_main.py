"""The command line as a user meets it: messages, exit codes, no traceback."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from gsynopsis import __version__, cli
from gsynopsis.container import write_gsyn
from gsynopsis.errors import MissingExtraError, SettingError
from tests.stage import level_set


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "scene.gsyn"
    write_gsyn(level_set(), path)
    return path


class Fails:
    """A command that raises."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def run(self) -> int:
        raise self.error


def code_and_line(
    error: BaseException, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[int, str]:
    monkeypatch.setattr(cli, "parse", lambda words: Fails(error))
    code = cli.main(["info"])
    return code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (SettingError("--level", found=9, expected="0 to 3"), 2, "--level: found 9"),
        (SettingError("a", advice="two\nlines"), 2, "two lines"),
        (MissingExtraError("matplotlib", "plots"), 2, "gsynopsis[plots]"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (OSError(errno.ENOSPC, "No space left on device", "a.png"), 2, "a.png: No space left"),
    ],
)
def test_what_a_user_can_cause_is_one_line_and_an_exit_code(
    error: BaseException,
    code: int,
    text: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found, line = code_and_line(error, monkeypatch, capsys)
    assert found == code
    assert line.startswith("gsynopsis: ")
    assert line.count("\n") == 1
    assert text in line


def test_our_own_mistakes_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "parse", lambda words: Fails(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        cli.main(["info"])


@pytest.mark.parametrize("words", [[], ["inform"], ["info"], ["info", "a.gsyn", "--jsn"]])
def test_a_wrong_command_line_exits_with_2(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(words)
    assert caught.value.code == 2
    captured = capsys.readouterr()
    assert not captured.out
    assert "Traceback" not in captured.err


@pytest.mark.parametrize("name", list(cli.COMMANDS))
def test_every_command_explains_itself_and_its_options(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main([name, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert f"usage: gsynopsis {name}" in text
    assert "None}" not in text


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"gsynopsis {__version__}\n"


def test_info_prints_levels_parts_and_quality(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["info", str(file)]) == 0
    text = capsys.readouterr().out
    for level in level_set().levels:
        assert f"{level.anchors}" in text
        assert f"{level.quality['psnr_full']:.2f}" in text
    for part in ("lattice", "offsets", "networks", "mask", "bits/value"):
        assert part in text


def test_info_prints_notes_of_a_writer_as_harmless_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hostile = replace(level_set(), meta={"scene": "\x1b[2J\nroom", "long": "x" * 500})
    write_gsyn(hostile, tmp_path / "a.gsyn")
    assert cli.main(["info", str(tmp_path / "a.gsyn")]) == 0
    text = capsys.readouterr().out
    assert "scene: ?[2J?room\n" in text
    assert max(map(len, text.splitlines())) < 200


def test_info_json_adds_up_to_the_file(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(file.parent), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (
        sum(level["delta"] for level in info["levels"]) == info["bytes"] == len(file.read_bytes())
    )


def test_a_truncated_file_is_one_line(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.gsyn"
    broken.write_bytes(file.read_bytes()[:-7])
    assert cli.main(["info", str(broken)]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "broken.gsyn" in captured.err


def test_the_module_runs_as_a_program_and_a_closed_pipe_is_quiet(file: Path) -> None:
    """`gsynopsis info FILE | head -c 0`: the reader is gone before the first byte."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "gsynopsis", "info", str(file)]
    source = str(Path(cli.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": source}
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, env=environment)
    os.close(writing)
    assert done.stderr == b""
    assert done.returncode == 141


def test_info_loads_neither_torch_nor_what_only_another_command_needs(file: Path) -> None:
    script = (
        "import sys; from gsynopsis.cli import main; "
        f"main(['info', {str(file)!r}]); "
        "sys.exit(bool({'torch', 'gsynopsis.cli.flags', 'gsynopsis.stream'} & set(sys.modules)))"
    )
    source = str(Path(cli.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": source}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr


def test_idle_threads_of_torch_sleep_unless_the_user_said_otherwise() -> None:
    script = (
        "import os, sys; from gsynopsis import cli; assert 'torch' not in sys.modules;"
        "cli.main(['--version']); print(os.environ['OMP_WAIT_POLICY'])"
    )
    words = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    for given, expected in (({}, "PASSIVE"), ({"OMP_WAIT_POLICY": "ACTIVE"}, "ACTIVE")):
        done = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, env=words | given
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.split()[-1] == expected


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_during_imports_ends_with_one_line_and_130(tmp_path: Path) -> None:
    """A library that is being imported when Ctrl-C comes; it must not see an exception."""
    (tmp_path / "tyro.py").write_text(
        "import os, signal\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    for _ in range(10**6): pass\n"
        "except BaseException as error: raise ImportError('half imported') from error\n"
    )
    source = str(Path(cli.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{source}"}
    command = [sys.executable, "-m", "gsynopsis", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (130, "gsynopsis: interrupted\n")
