"""Kills a training at random moments, repeats the command, and compares the files' SHA-256.

    OMP_NUM_THREADS=1 python -m benchmarks.robust.kills --kills 20

One run is never interrupted; the other is killed (SIGKILL, no chance to save) until it has been
killed often enough, then left to finish. Both write checkpoints every 0.3 seconds.
"""

import hashlib
import json
import random
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import tyro

from gsynopsis.synthetic.make_scene import make_scene

OPTIONS = ("--checkpoint-seconds", "0.3", "--no-evaluate", "--quiet")


@dataclass(frozen=True)
class Settings:
    """Number and length of the trials.

    Attributes:
        kills: Times that the second run is killed.
        steps: Steps of the full training; those of the levels scale along.
        seed: Seed of the moments.
    """

    kills: int = 20
    steps: int = 150
    seed: int = 0


def main() -> None:
    settings = tyro.cli(Settings, description=__doc__)
    moments = random.Random(settings.seed)
    with tempfile.TemporaryDirectory() as folder:
        scene = make_scene("room", Path(folder) / "room", seed=0)
        whole, killed = Path(folder) / "whole", Path(folder) / "killed"
        subprocess.run(command(scene, whole, settings.steps), check=True)
        done = finished_early = 0
        while done < settings.kills:
            child = subprocess.Popen(command(scene, killed, settings.steps))
            try:
                child.wait(timeout=moments.uniform(1.5, 6.0))
                finished_early += 1  # start again: what is complete cannot be interrupted
                for path in killed.iterdir():
                    path.unlink()
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
                done += 1
        subprocess.run(command(scene, killed, settings.steps), check=True)
        digests = [hashlib.sha256((p / "scene.gsyn").read_bytes()).hexdigest() for p in
                   (whole, killed)]  # fmt: skip
        left = sorted(p.name for p in killed.iterdir() if p.suffix == ".tmp")
    result = {
        "kills": done,
        "finished_before_a_kill": finished_early,
        "uninterrupted": digests[0],
        "killed": digests[1],
        "equal": digests[0] == digests[1],
        "temporary_files_left": left,
    }
    print(json.dumps(result, indent=1))
    sys.exit(0 if result["equal"] else 1)


def command(scene: Path, out: Path, steps: int) -> list[str]:
    """One training."""
    line = ["-m", "gsynopsis", "train", str(scene), "--out", str(out), "--steps", str(steps)]
    return [sys.executable, *line, *OPTIONS]


if __name__ == "__main__":
    main()
