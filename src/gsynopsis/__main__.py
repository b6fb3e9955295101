"""`python -m gsynopsis` is the command `gsynopsis`."""

import sys

from gsynopsis.cli import main

sys.exit(main())
