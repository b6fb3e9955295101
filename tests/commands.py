"""Every command that reads a .gsyn file, as one call in this process, and what came of it."""

import io
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

from gsynopsis.cli import Command, guarded
from gsynopsis.cli.files import Check, CutCommand, Split
from gsynopsis.cli.info import Info
from gsynopsis.cli.render import Render
from gsynopsis.cli.stream import Stream
from gsynopsis.cli.view import ViewCommand

STOPPED = "still at work"
WIDTH = 32
"""Pictures are small: it is files that are tried."""


class Hang(BaseException):
    """A command took longer than it may; raise it from the handler of an alarm."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended; `trouble` is what is wrong with that, empty if nothing is."""

    code: int
    trouble: str


def commands(file: Path, out: Path, trace: Path) -> dict[str, Callable[[], Command]]:
    """By name; what they write goes to the folder `out`, `trace` is a recorded line."""
    return {
        "check": lambda: Check(file),
        "info": lambda: Info(file),
        "info --json": lambda: Info(file, json=True),
        "cut": lambda: CutCommand(file, level=0, out=out / "cut.gsyn", overwrite=True),
        "split": lambda: Split(file, out=out),
        "view": lambda: ViewCommand(file, html=out / "page.html"),
        "render": lambda: Render(file, out=out, orbit=1, width=WIDTH, quiet=True, renderer="cpu"),
        "stream": lambda: Stream(
            str(file), out, trace=trace, seconds=0.2, width=WIDTH, quiet=True, renderer="cpu"
        ),
    }


def outcome(command: Callable[[], Command]) -> Outcome:
    """Run a command. It ends with 0 and words, or with 2 and one line; all of it can be printed.

    Anything else that it raises is trouble, but for what is raised to stop it (`Hang`).
    """
    said, complained = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(complained):
            code = guarded(command)
    except Hang:
        return Outcome(1, STOPPED)
    except Exception as error:
        return Outcome(1, f"{type(error).__name__}: {error}")
    lines = complained.getvalue().splitlines()
    words = [*said.getvalue().splitlines(), *lines]
    trouble = ""
    if code not in (0, 2) or len(lines) != code // 2:
        trouble = f"code {code}, complaints {lines}"
    elif not all(line.isprintable() for line in words):
        trouble = "something that can not be printed"
    return Outcome(code, trouble)
