"""Frames to a moving picture: gif by Pillow, mp4 by the program ffmpeg where there is one."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from gsynopsis.errors import GsynopsisError, SettingError
from gsynopsis.files import published

if TYPE_CHECKING:
    from gsynopsis.evaluation.metrics import Image8

FORMATS = (".gif", ".mp4")


def check_flight(path: Path) -> None:
    """Check that a flight can be written to `path`, before hours are spent on frames.

    Raises:
        SettingError: another format, or mp4 without ffmpeg.
    """
    if path.suffix.lower() not in FORMATS:
        raise SettingError("--flight", found=path.name, expected="a name in .gif or .mp4")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        advice = f"install ffmpeg, or write a gif: --flight {path.with_suffix('.gif')}"
        raise SettingError(
            "--flight", found="no program ffmpeg", expected="one on PATH for mp4", advice=advice
        )


def write_flight(frames: "Sequence[Image8]", path: Path, fps: float) -> None:
    """Write frames of one size as a looping gif or an mp4, whole or not at all."""
    write = _gif if path.suffix.lower() == ".gif" else _mp4
    with published(path) as draft:
        write(frames, draft, fps)


def _gif(frames: "Sequence[Image8]", path: Path, fps: float) -> None:
    pictures = [Image.fromarray(frame).quantize(256) for frame in frames]
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=max(20, round(1000 / fps)),
        loop=0,
        disposal=1,
    )


def _mp4(frames: "Sequence[Image8]", path: Path, fps: float) -> None:
    height, width = frames[0].shape[:2]
    # H.264 in 4:2:0 has even sizes only.
    even = [np.ascontiguousarray(frame[: height // 2 * 2, : width // 2 * 2]) for frame in frames]
    size = f"{width // 2 * 2}x{height // 2 * 2}"
    command = ["ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", size, "-r", f"{fps:g}", "-i", "-", "-an", "-c:v", "libx264"]
    command += ["-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    pixels = b"".join(frame.tobytes() for frame in even)
    done = subprocess.run(command, input=pixels, capture_output=True, check=False)
    if done.returncode:
        reason = done.stderr.decode(errors="replace").strip().splitlines()
        raise GsynopsisError(f"ffmpeg could not write the flight: {(reason or ['no reason'])[-1]}")
