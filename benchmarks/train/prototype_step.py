"""Builds a prototype's trainer (`race.py`) and steps it on demand (`step.py`)."""

import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

STEP_DONE = "tt=tick('adam',tt)"
"""What the prototype's loop says at the end of a step."""


def build_trainer(folder: Path, data: Path, root: Path) -> Path:
    """Copy the prototype and build it where it finds its scenes; the folder to run it in.

    Args:
        folder: Holds `train.py`, `model.py`, `build.sh` and their sources.
        data: Holds the folder `fox`.
        root: An empty folder.
    """
    here = root / "reference" / "prototype"
    here.mkdir(parents=True)
    (root / "data").symlink_to(data.resolve())
    for source in folder.iterdir():
        if source.is_file():
            (here / source.name).write_bytes(source.read_bytes())
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(["bash", str(here / "build.sh")], check=True, env={**os.environ, "PATH": path})
    return here


class PrototypeSteps:
    """Its `train.py` in a thread of its own, which waits at the end of every step."""

    def __init__(self, folder: Path, data: Path, scale: float, steps: int) -> None:
        """Build it and read the scene; the first call of `step` begins to train.

        Args:
            folder: Holds `train.py`, `model.py`, `build.sh` and their sources.
            data: Holds the folder `fox`.
            scale: Photos are divided by this.
            steps: Length of its schedule; it must not be stepped to the end.
        """
        self._turn, self._done = threading.Semaphore(0), threading.Semaphore(0)
        self._failure: BaseException | None = None
        self._spare = tempfile.TemporaryDirectory()
        here = build_trainer(folder, data, Path(self._spare.name))
        source = (here / "train.py").read_text()
        assert source.count(STEP_DONE) == 1
        source = source.replace(STEP_DONE, f"{STEP_DONE}; step_done()")
        options = ["train.py", "--feat", "igs", "--factor", str(scale), "--its", str(steps)]
        self.names: dict[str, object] = {"step_done": self._wait, "__name__": "prototype"}
        threading.Thread(target=self._train, args=(source, here, options), daemon=True).start()

    def step(self) -> None:
        """One step."""
        self._turn.release()
        self._done.acquire()
        if self._failure is not None:
            raise self._failure

    def size(self) -> tuple[int, int, int]:
        """Anchors, visible anchors and Gaussians of the last step."""
        x, vis, sel = (self.names[name] for name in ("x", "vis", "sel"))
        return len(x), len(vis), len(sel)  # type: ignore[arg-type]

    def _wait(self) -> None:
        self._done.release()
        self._turn.acquire()

    def _train(self, source: str, here: Path, options: list[str]) -> None:
        self._turn.acquire()
        before, arguments = Path.cwd(), sys.argv
        sys.path.insert(0, str(here))
        sys.argv = options
        os.chdir(here)  # it finds its scenes from there, before its first step
        try:
            exec(compile(source, "train.py", "exec"), self.names)
        except BaseException as error:
            self._failure = error
        finally:
            os.chdir(before)
            sys.argv = arguments
            sys.path.remove(str(here))
            self._done.release()
