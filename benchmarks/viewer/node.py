"""Node, where it is there, and the viewer that it runs."""

import os
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from gsynopsis.serve.page import FOLDER, VIEWER

NODE = shutil.which("node")
SOURCES = Path(__file__).parents[2] / "viewer"
INSTALLED = NODE is not None and (SOURCES / "node_modules").is_dir()
"""Node and the packages that build the viewer are there (npm ci)."""
SCRIPTS = sorted(FOLDER.glob("*.js"))
"""The modules of the built viewer in the package."""
PAGE_SCRIPT = FOLDER / VIEWER
"""The one that a page names."""


def npx(*words: str) -> str:
    """Standard output of a tool of the viewer's packages; it must succeed."""
    program = SOURCES / "node_modules" / ".bin" / words[0]
    done = subprocess.run([program, *words[1:]], cwd=SOURCES, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    return done.stdout


@cache
def standalone() -> Path:
    """The viewer in one module that exports its parts; built if it is older than its sources."""
    built = SOURCES / "dist" / "gsynopsis-viewer.js"
    sources = [*SOURCES.glob("*.ts"), *(SOURCES / "src").rglob("*.ts")]
    newest = max(path.stat().st_mtime for path in sources)
    if not built.is_file() or built.stat().st_mtime < newest:
        built.parent.mkdir(exist_ok=True)
        # Of several processes that build it each puts a whole file in place.
        with TemporaryDirectory(dir=built.parent) as folder:
            keep = ("--outDir", folder, "--emptyOutDir", "false", "--logLevel", "warn")
            npx("vite", "build", "--mode", "standalone", *keep)
            os.replace(Path(folder) / built.name, built)
    return built
