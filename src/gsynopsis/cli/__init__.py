"""The command line: parse, call, print."""

import sys

from gsynopsis.errors import GsynopsisError


def main() -> int:
    """Run one command; errors of ours become one line and their exit code."""
    try:
        return 0
    except GsynopsisError as error:
        print(f"gsynopsis: {error}", file=sys.stderr)
        return error.exit_code
