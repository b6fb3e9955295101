import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.cameras.orbit import Circle, circle_text
from gsynopsis.cli import main
from gsynopsis.jobs.simulate_stream import flight_around
from gsynopsis.records import ORBIT_NOTE, Frame
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
    out = str(scene.parent / "out")
    return ["stream", "--out", out, "--seconds", "2", "--width", "32", *more]


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


@pytest.mark.parametrize("level", [0, 2])
@pytest.mark.parametrize("block", [128, 8])
def test_a_prefix_is_played_to_its_end_from_a_file_and_an_address(
    scene: Path, level: int, block: int, capsys: pytest.CaptureFixture[str]
) -> None:
    (scene.parent / "small.gsyn").write_bytes(small_file(block))
    cut, line = scene.parent / "cut.gsyn", str(scene.parent / "line.csv")
    assert main(["cut", str(scene), "--level", str(level), "--out", str(cut)]) == 0
    assert main(words(scene, str(cut), "--trace", line, "--policy", "fixed")) == 0
    with serving(make_app(root_of(cut))) as address:
        assert main(words(scene, f"{address}/cut.gsyn", "--policy", "fixed")) == 0
    said = capsys.readouterr().out
    assert said.count(f"{level + 1} of 4 levels, the file is a prefix") == 2


def test_a_truncated_file_is_refused_from_a_file_and_an_address(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = str(scene.parent / "line.csv")
    for length in (100, 5000, 40_000, len(small_file()) - 1, len(small_file()) + 1):
        data = (small_file() + b"x")[:length]
        scene.write_bytes(data)
        assert main(words(scene, str(scene), "--trace", line)) == 2
        with serving(make_app(root_of(scene))) as address:
            assert main(words(scene, f"{address}/small.gsyn")) == 2
        said = capsys.readouterr().err.strip().splitlines()
        assert len(said) == 2
        assert f"found {length} bytes" in said[0] or "index" in said[0]
    assert not (scene.parent / "out").exists()


def test_the_folder_of_a_run_is_played(scene: Path) -> None:
    scene.rename(scene.parent / "scene.gsyn")
    line = str(scene.parent / "line.csv")
    assert main(words(scene, str(scene.parent), "--trace", line)) == 0


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
    line = ("--trace", str(scene.parent / "line.csv"))
    assert main(["serve", str(scene), *line, "--cuts", "2147483648"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 5 and "--cuts: found 2147483648, expected 0 to 10,000" in said[4]
    assert "another --port" in said[0]
    assert "needs --trace" in said[2]


def test_the_flight_of_a_play_stays_on_the_captured_arc() -> None:
    circle = Circle(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), 2.0, 0.5)
    frame = Frame(0.01, np.zeros(3), 1.0, True, 3.0)
    sides = []
    for arc in (None, (-0.4, 0.2)):
        meta = {ORBIT_NOTE: circle_text(replace(circle, arc=arc))}
        eyes = [camera.position for camera in flight_around(meta, frame, 40.0, 32).cameras]
        sides.append(np.arctan2([eye[1] for eye in eyes], [eye[0] for eye in eyes]))
    assert np.ptp(sides[0]) > 6
    assert (sides[1].min(), sides[1].max()) == pytest.approx((-0.4, 0.2), abs=1e-6)
