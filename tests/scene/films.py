"""Videos of our own making, for tests: frames through ffmpeg."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

FFMPEG = shutil.which("ffmpeg")
needs_ffmpeg = pytest.mark.skipif(FFMPEG is None, reason="no ffmpeg: video NOT tested")


def film(
    frames: Sequence[NDArray[np.uint8]], path: Path, rate: str = "30", more: Sequence[str] = ()
) -> Path:
    """A video of frames [H, W, 3] of one even size, `rate` a second; `more` options of ffmpeg."""
    height, width = frames[0].shape[:2]
    line = [str(FFMPEG), "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    line += ["-s", f"{width}x{height}", "-r", rate, "-i", "-", "-c:v", "mpeg4", "-q:v", "2"]
    pixels = b"".join(frame.tobytes() for frame in frames)
    subprocess.run([*line, *more, str(path)], input=pixels, check=True, timeout=120)
    return path
