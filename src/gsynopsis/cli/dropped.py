"""The process that imports a file for a page of `gsynopsis serve`: `python -m`, no command."""

import os
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from gsynopsis.cli import run_safely
from gsynopsis.cli.bounds import with_training

COMMAND = (sys.executable, "-P", "-W", "ignore", "-m", __name__)
"""Before two names; without the current folder, which may hold modules of anybody."""


@dataclass(frozen=True)
class Dropped:
    """Import a file to look at it.

    Attributes:
        source: Another program's splats.
        out: The new file.
    """

    source: Path
    out: Path

    def run(self) -> int:
        """Import it as a draft."""
        with with_training():
            from gsynopsis.jobs.import_splats import import_splats
        import_splats(self.source, self.out, draft=True)
        return 0


def end_with_input() -> None:
    """End this process when whoever started it has ended, however that came."""
    os.read(0, 1)
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=end_with_input, daemon=True).start()
    sys.exit(run_safely(lambda: Dropped(*map(Path, sys.argv[1:]))))
