"""The command `gsynopsis`, also as `python -m gsynopsis`.

Imports take a second or more. Ctrl-C within it would end in a traceback through them, or in an
error of a library that does not expect it; so until the command begins it ends the process at once.
"""

import logging
import os
import signal
import sys
import warnings

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


def main() -> int:
    """Import the command line and run it; the exit code."""
    # Where Ctrl-C is ignored, as under nohup, it stays so.
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _end)
    from gsynopsis.cli import TERMINATED
    from gsynopsis.cli import main as run

    def terminate(number: int, frame: object) -> None:
        raise KeyboardInterrupt(TERMINATED)

    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        # What is half written is removed on the way, as after Ctrl-C.
        signal.signal(signal.SIGTERM, terminate)
    if not sys.warnoptions:
        # Those of libraries are for programmers; lines of this program stand alone.
        warnings.simplefilter("ignore")
        logging.getLogger().addHandler(logging.NullHandler())
    return run()


def _end(number: int, frame: object) -> None:
    os.write(2, b"gsynopsis: interrupted\n")
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
