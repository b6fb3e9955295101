"""The command line: parse, call, print. One file per command; this one only chooses."""

import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any, Protocol

import tyro

from gsynopsis import __version__
from gsynopsis.errors import WHOLE, GsynopsisError, printable, quoted

INTERRUPTED, TERMINATED = 130, 143
"""Exit codes after Ctrl-C and SIGTERM, as shells have them."""
SIGNED_AXIS = re.compile("-[xyz]", re.IGNORECASE)
PIPE_CLOSED = 141
"""Exit code when the reader of our output went away, as shells have it."""


class Command(Protocol):
    """A frozen dataclass whose fields are the options and whose docstring is the help."""

    def run(self) -> int:
        """Do it; the exit code."""
        ...


_PLACES = {
    "demo": "demo:Demo",
    "scene": "scene:SceneCommand",
    "train": "train:Train",
    "unfold": "unfold:Unfold",
    "pack": "pack:Pack",
    "import": "importing:Import",
    "info": "info:Info",
    "check": "files:Check",
    "cut": "files:CutCommand",
    "export": "export:Export",
    "render": "render:Render",
    "serve": "serve:Serve",
    "view": "view:ViewCommand",
    "stream": "stream:Stream",
    "evaluate": "evaluate:Evaluate",
    "doctor": "doctor:Doctor",
}
"""Module and class of each command, in the order of the help. A new command is one entry."""


class Commands(Mapping[str, type[Command]]):
    """Commands by name, each imported when it is asked for: `info` needs nothing of `train`."""

    def __getitem__(self, name: str) -> type[Command]:
        module, _, kind = _PLACES[name].partition(":")
        return getattr(import_module(f"gsynopsis.cli.{module}"), kind)

    def __iter__(self) -> Iterator[str]:
        return iter(_PLACES)

    def __len__(self) -> int:
        return len(_PLACES)


COMMANDS = Commands()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, see `run_safely`.

    Args:
        arguments: Without the program's name; those of the process if None.
    """
    # PyTorch's idle threads spin if this is not set before it loads, and take the processors from
    # all else that runs.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    # Pillow's, on photos of more than 89 megapixels: those of too many are refused in one line.
    warnings.filterwarnings("ignore", r"Image size \(\d+ pixels\) exceeds limit", RuntimeWarning)
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        print(f"gsynopsis {__version__}")
        return 0
    return run_safely(lambda: parse(words))


def run_safely(command: Callable[[], Command]) -> int:
    """Run a command line; errors that a user can cause become one line and an exit code."""
    try:
        code = command().run()
        sys.stdout.flush()
    except GsynopsisError as error:
        return _print_error(str(error), error.exit_code)
    except KeyboardInterrupt as error:
        terminated = error.args == (TERMINATED,)
        return _print_error("interrupted", TERMINATED if terminated else INTERRUPTED)
    except BrokenPipeError:
        # What is still buffered has no reader; a real flush at exit would complain again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
    except OSError as error:
        return _print_error(_reason(error), 2)
    except MemoryError:
        return _print_error("not enough memory for what was asked", 2)
    return code


def parse(words: Sequence[str]) -> Command:
    """The command with its options; prints help or the fault and exits if there is none."""
    options: dict[str, Any] = {"config": (tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone)}
    if words and words[0] in COMMANDS:
        name, *rest = _with_signs(words)
        kind: type[Any] = COMMANDS[name]
        return tyro.cli(kind, prog=f"gsynopsis {name}", args=rest, **options)
    return tyro.extras.subcommand_cli_from_dict(
        dict(COMMANDS),
        prog="gsynopsis",
        description="Photos in, one progressive 3D Gaussian splatting file out.",
        args=list(words),
        **options,
    )


def _with_signs(words: Sequence[str]) -> list[str]:
    """`--up -y` as `--up=-y`: a word that begins with a minus would be taken for an option."""
    found: list[str] = []
    for word in words:
        if found and found[-1] == "--up" and SIGNED_AXIS.fullmatch(word):
            found[-1] = f"--up={word}"
        else:
            found.append(word)
    return found


def _print_error(text: str, code: int) -> int:
    print(f"gsynopsis: {printable(' '.join(text.split()))}", file=sys.stderr)
    return code


def _reason(error: OSError) -> str:
    """Reason and path of a refused system call: `runs/a.png: No space left on device`."""
    what = error.strerror or type(error).__name__
    return f"{quoted(error.filename, WHOLE)}: {what}" if error.filename else what
