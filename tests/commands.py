"""Commands of the command line in the process of the tests, which have imported torch already."""

import contextlib
import io
from pathlib import Path
from subprocess import CompletedProcess

from gsynopsis import cli


def command(*words: str | Path) -> CompletedProcess[str]:
    """A command's exit code and what it prints, as of a process of its own."""
    line = [*map(str, words)]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = cli.main(line)
        except SystemExit as end:  # of words that cannot be read
            code = end.code if isinstance(end.code, int) else 1
    return CompletedProcess(line, code, out.getvalue(), err.getvalue())
