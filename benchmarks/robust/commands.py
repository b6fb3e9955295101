"""Every command line that reads a .gsyn file, run in this process, and what came of it."""

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from gsynopsis.__main__ import main

STOPPED = "still at work"
WIDTH = "32"
"""Width of images: small, for it is files that are tested."""
Words = tuple[str, ...]


class Hang(BaseException):
    """A command took longer than it may; raise it from the handler of an alarm."""


@dataclass(frozen=True)
class ViewResult:
    """End of a command; `trouble` is its fault, empty if there is none."""

    code: int
    trouble: str


def commands(file: Path, out: Path, trace: Path) -> dict[str, Words]:
    """By name; what they write goes to the folder `out`, `trace` is a recorded line."""
    name, folder = str(file), str(out)
    small = ("--width", WIDTH, "--quiet", "--renderer", "cpu")
    return {
        "check": ("check", name),
        "info": ("info", name),
        "info --json": ("info", name, "--json"),
        "cut": ("cut", name, "--level", "0", "--out", str(out / "cut.gsyn"), "--overwrite"),
        "cut --all": ("cut", name, "--all", "--out", folder),
        "view": ("view", name, "--html", str(out / "page.html")),
        "render": ("render", name, "--out", folder, "--orbit", "1", *small),
        "export": (
            *("export", name, "--level", "0", "--out", str(out / "level.ply"), "--overwrite"),
            *("--renderer", "cpu", "--quiet"),
        ),
        "stream": (
            *("stream", name, "--out", folder, "--trace", str(trace), "--seconds", "0.2"),
            *small,
        ),
    }


def outcome(words: Words) -> ViewResult:
    """Run a command. It ends with 0 and output, or with 2 and one line; all of it can be printed.

    Anything else that it raises is trouble, but for what is raised to stop it (`Hang`).
    """
    said, complained = io.StringIO(), io.StringIO()
    try:
        with (
            patch.object(sys, "argv", ["gsynopsis", *words]),
            redirect_stdout(said),
            redirect_stderr(complained),
        ):
            code = main()
    except Hang:
        return ViewResult(1, STOPPED)
    except (Exception, SystemExit) as error:
        return ViewResult(1, f"{type(error).__name__}: {error}")
    lines = complained.getvalue().splitlines()
    printed = [*said.getvalue().splitlines(), *lines]
    trouble = ""
    if code not in (0, 2) or len(lines) != code // 2:
        trouble = f"code {code}, complaints {lines}"
    elif not all(line.isprintable() for line in printed):
        trouble = "something that can not be printed"
    return ViewResult(code, trouble)
