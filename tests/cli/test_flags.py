"""Five hundred random command lines: each is done, or refused in one line; no traceback.

Words come from the commands' own fields, so that a new option is tried without a change here. Most
values are odd and refused at once. The others run on a scene and a file so small that they take a
part of a second.
"""

import asyncio
import contextlib
import dataclasses
import io
import random
import shutil
import traceback
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gsynopsis import cli
from gsynopsis.config import LEVELS
from gsynopsis.config.serialize import ALL_NAMES, types_of
from gsynopsis.container import write_gsyn
from gsynopsis.evaluation import report_html
from gsynopsis.playback import plots
from gsynopsis.synthetic import make_scene as synthetic
from gsynopsis.synthetic.make_scene import make_scene
from tests.level_sets import make_level_set

SEED = 20261123
CASES = 500
TINY = ("model.slots=2", "model.hidden=4", "model.residual=2", "model.table_log2=4")
WHOLE = ("-1", "0", "1", "2", "3", "7", "2147483648", "9" * 19, "1" * 31)
"""Nothing in between, for whoever orders ten thousand steps gets them."""
ODD = ("nan", "inf", "-inf", "-0.5", "0.0", ".5", "1e-300", "1e308", "1e999", "1e9", "2", "9" * 400)
TEXTS = ("", " ", "x", "nope", "-", "--", "é", "a=b", "9" * 5000, "\udc80", "0x10", "None")
LISTS = (("1", "1", "1"), ("0.5",), ("0.5", "0.25"), ("1", "0"), ("-1",), ("nan", "1"), ("inf",))
SIZES = (("0.001", "0.002"), ("1", "2", "inf"), ("2", "1"), ("0.002", "0.003", "0.004", "9"))
SHARE_OF_GOOD = 0.75
"""Of the values of an option that are of its kind."""
LEFT_OUT = {"viewer", "viewer_port"}
"""Of train: its page is a server of its own."""


@dataclasses.dataclass(frozen=True)
class Stage:
    """Files to name on a command line."""

    folder: Path
    scene: Path
    file: Path
    run: Path
    trace: Path
    odd: tuple[Path, ...]
    contents: dict[Path, bytes]

    def restore(self) -> None:
        """Files may be named as the output of a command, which then replaces them."""
        for path, content in self.contents.items():
            if not path.is_file() or path.read_bytes() != content:
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
                path.write_bytes(content)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    folder = tmp_path_factory.mktemp("flags")
    scene = make_scene("room", folder / "room", views=4, width=16, height=12, points=40)
    file = folder / "scene.gsyn"
    write_gsyn(make_level_set(np.random.default_rng(1)), file)
    run = folder / "run"
    words = ["train", str(scene), "--out", str(run), "--steps", "1", "--quiet", "--no-evaluate"]
    assert call([*words, *(w for setting in TINY for w in ("--set", setting))]) == 0
    trace = folder / "line.csv"
    trace.write_text("time_s,mbit_per_s\n0,5\n1,5\n")
    empty, text, cut = folder / "empty", folder / "notes.txt", folder / "cut.gsyn"
    empty.mkdir()
    text.write_text("no scene")
    cut.write_bytes(file.read_bytes()[:100])
    odd = (empty, text, cut, folder / "missing", Path("/dev/null"), Path("x" * 300))
    contents = {path: path.read_bytes() for path in (file, trace, text, cut)}
    return Stage(folder, scene, file, run, trace, odd, contents)


def call(words: list[str]) -> int:
    """The exit code of a command line; what it prints is thrown away."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            return cli.main(words)
        except SystemExit as end:  # what argparse says of words it cannot read
            return end.code if isinstance(end.code, int) else -1


def copy_of(scene: Path, kind: str, out: Path, **recipe: int) -> Path:
    """What the demo trains on: its own scene takes seconds to make."""
    return Path(shutil.copytree(scene, out, dirs_exist_ok=True))


class Lines:
    """Random command lines."""

    def __init__(self, stage: Stage, seed: int) -> None:
        self.stage, self.chance, self.count = stage, random.Random(seed), 0
        self.settings = {"set": "tuple[tuple[str"} | {
            name: str(hint) for mode in LEVELS for name, hint in types_of(mode).items()
        }

    def line(self) -> list[str]:
        """One command line."""
        name = self.chance.choice(list(cli.COMMANDS))
        self.count += 1
        kind: Any = cli.COMMANDS[name]
        words, options = [name], dict[str, Any]()
        for field in dataclasses.fields(kind):
            hint = str(field.type)
            if "Positional" in hint:
                words.append(self.place(field.name))
            elif field.name == "overrides":
                options |= self.settings
            elif field.name not in LEFT_OUT:
                options[field.name] = hint
        words += self.base(name)
        wanted = self.chance.choices((0, 1, 2, 3), (1, 3, 3, 2))[0]
        for option in self.chance.sample(sorted(options), min(wanted, len(options))):
            words += self.option(option, options[option])
        if self.chance.random() < 0.02:
            words.insert(self.chance.randrange(len(words)), self.chance.choice(TEXTS))
        return words

    def base(self, name: str) -> list[str]:
        """What makes a command run, and run quickly."""
        out = str(self.stage.folder / f"out{self.count}")
        words = {"render": ["--width", "16", "--orbit", "1"], "evaluate": ["--frames", "1"]}
        words |= {"stream": ["--trace", str(self.stage.trace), "--seconds", "0.2", "--width", "8"]}
        words |= {"serve": ["--port", "0"], "unfold": ["--steps", "1"], "demo": ["--steps", "0"]}
        words |= {"export": ["--fine-tune", "2"]}
        words |= {"train": ["--steps", "1", "--scale", "2"], "cut": ["--level", "0"]}
        found = words.get(name, [])
        if name in {"train", "unfold"}:
            found += ["--no-evaluate"] * (self.chance.random() < 0.9)
        if name == "train":
            found += [word for setting in TINY for word in ("--set", setting)]
        if name in {"render", "stream", "train", "unfold", "evaluate", "demo", "cut"}:
            found = [*found, "--out", out]
        return found

    def place(self, name: str) -> str:
        """A path for a positional argument: of the kind that the command wants, or not."""
        stage = self.stage
        if self.chance.random() < SHARE_OF_GOOD:
            file = self.chance.choice((stage.file, stage.run))
            return str({"scene": stage.scene, "run_path": stage.run, "source": stage.file}.get(
                name, file
            ))  # fmt: skip
        return str(self.chance.choice((*stage.odd, stage.scene, stage.run, stage.file)))

    def option(self, name: str, hint: str) -> list[str]:
        """An option with a value of its kind, or with something else."""
        flag = "--" + name.replace("_", "-")
        if "bool" in hint:
            return [flag] * ("." not in name) or [flag, self.chance.choice(("True", "False"))]
        if self.chance.random() > SHARE_OF_GOOD:
            return [flag, self.chance.choice((*TEXTS, *WHOLE, *ODD))]
        if name == "set":
            return [flag, f"{self.chance.choice(SETTINGS)}={self.chance.choice((*WHOLE, *ODD))}"]
        if name == "levels.level_mib":
            return [flag, *self.chance.choice(SIZES)]
        kinds: dict[str, Callable[[], list[str]]] = {
            "tuple": lambda: list(self.chance.choice(LISTS)),
            "int": lambda: [self.chance.choice(WHOLE)],
            "float": lambda: [self.chance.choice(ODD)],
            "Path": lambda: [self.path()],
        }
        for kind, values in kinds.items():
            if kind in hint:
                return [flag, *values()]
        return [flag, self.chance.choice(CHOICES)]

    def path(self) -> str:
        stage = self.stage
        fresh = stage.folder / f"new{self.count}"
        return str(self.chance.choice((fresh, stage.scene, stage.file, stage.trace, *stage.odd)))


SETTINGS = ALL_NAMES
CHOICES = (
    "standard",
    "paper",
    "none",
    "every8",
    "joint",
    "sequential",
    "cpu",
    "cuda",
    "raw",
    "free",
)


@pytest.mark.slow
def test_random_command_lines_end_with_0_or_2_and_never_in_a_traceback(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(stage.folder)
    monkeypatch.setattr(asyncio, "run", lambda served: served.close())
    # No option is about the curves of a report or of a stream, which take longer than all else that
    # is done here; the file of the latter is written all the same.
    monkeypatch.setattr(report_html, "quality_curves", lambda levels, protocol: "<svg></svg>")
    blank = SimpleNamespace(savefig=lambda draft, **options: draft.write_bytes(b""))
    monkeypatch.setattr(plots, "timelines_figure", lambda plays: blank)
    monkeypatch.setattr(synthetic, "make_scene", partial(copy_of, stage.scene))
    lines, found, done = Lines(stage, SEED), list[str](), Counter[str]()
    for _ in range(CASES):
        words = lines.line()
        try:
            code = call(words)
        except BaseException:
            found.append(f"{words}\n{traceback.format_exc(limit=-3)}")
            continue
        if code not in (0, 2):
            found.append(f"{words}: exit code {code}")
        done[f"{words[0]} {code}"] += 1
        stage.restore()
        shutil.rmtree(stage.folder / f"out{lines.count}", ignore_errors=True)
    assert not found, f"{len(found)} of {CASES}:\n" + "\n".join(found[:10])
    accepted = sum(count for name, count in done.items() if name.endswith(" 0"))
    assert accepted >= CASES // 10, done
