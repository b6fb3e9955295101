import json
from pathlib import Path

import pytest

from gsynopsis.cli import main
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import listen, serving
from tests.stream.scenes import small_file

TRACE = "time_s,mbit_per_s\n0,2\n10,2\n"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "small.gsyn"
    path.write_bytes(small_file())
    (tmp_path / "line.csv").write_text(TRACE)
    return path


def words(scene: Path, *more: str) -> list[str]:
    return ["stream", *more, "--out", str(scene.parent / "out"), "--seconds", "2", "--width", "32"]


@pytest.mark.parametrize("policy", ["ours", "fixed", "throughput", "bola", "mpc"])
def test_a_file_is_played_over_a_recorded_line(
    scene: Path, policy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = str(scene.parent / "line.csv")
    assert main(words(scene, str(scene), "--trace", line, "--policy", policy, "--json")) == 0
    found = json.loads(capsys.readouterr().out)
    assert 0.1 < found["first_picture_s"] < found["finished_s"]
    assert found["wasted_bytes"] == 0
    assert all(Path(path).is_file() for path in found["files"])


def test_an_address_is_played_over_real_sockets(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving(make_app(root_of(scene))) as address:
        assert main(words(scene, f"{address}/small.gsyn")) == 0
    assert "first picture after" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("source", "more", "said"),
    [
        ("small.gsyn", (), "--trace: found none"),
        ("http://127.0.0.1:9/a.gsyn", ("--trace", "line.csv"), "serve it with"),
        ("small.gsyn", ("--trace", "none.csv"), "No such file"),
        ("none.gsyn", ("--trace", "line.csv"), "No such file"),
        ("line.csv", ("--trace", "line.csv"), "no .gsyn file"),
        ("small.gsyn", ("--trace", "line.csv", "--period", "0"), "--period"),
        (
            "small.gsyn",
            ("--trace", "line.csv", "--seconds", "1e9"),
            "--seconds: found 1000000000.0",
        ),
        ("small.gsyn", ("--trace", "line.csv", "--round-trip", "-1"), "--round-trip: found -1.0"),
        ("small.gsyn", ("--trace", "line.csv", "--width", "100000"), "--width: found 100000"),
    ],
)
def test_bad_input_is_one_line(
    scene: Path,
    source: str,
    more: tuple[str, ...],
    said: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(scene.parent)
    assert main(words(scene, source, *more)) == 2
    message = capsys.readouterr().err.strip()
    assert said in message
    assert "\n" not in message
    assert not (scene.parent / "out").exists()


def test_serving_says_what_is_wrong(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with listen("127.0.0.1", 0) as taken:
        port = str(taken.getsockname()[1])
        assert main(["serve", str(scene), "--port", port]) == 2
    assert main(["serve", str(scene.parent / "none")]) == 2
    assert main(["serve", str(scene), "--cuts", "3"]) == 2
    assert main(["serve", str(scene), "--viewer", str(scene.parent)]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 4
    assert "another --port" in said[0]
    assert "needs --trace" in said[2]
