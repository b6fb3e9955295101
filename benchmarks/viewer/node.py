"""Node, where it is there, and the viewer that it runs."""

import shutil
from pathlib import Path

import gsynopsis

VIEWER = Path(gsynopsis.__file__).parent / "viewer_dist" / "gsynopsis-viewer.js"
NODE = shutil.which("node")
