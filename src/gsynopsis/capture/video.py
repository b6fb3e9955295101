"""Frames of a video that make good photos: sharp ones, an even stretch of camera motion apart.

ffmpeg decodes, twice, and no more than a frame is in memory: first small grey copies of all
frames are analysed, then the chosen ones are written.
"""

import importlib
import re
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.capture.photo_set import FEWEST, Tick
from gsynopsis.errors import SceneError

VIDEOS = frozenset(
    {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mts", ".m2ts", ".ts", ".mpg", ".mpeg"}
    | {".3gp", ".wmv", ".ogv", ".flv"}
)
CONTAINERS = "mov,matroska,avi,mpegts,mpeg,asf,ogg,flv"
"""ffmpeg's demuxers of those. Its others read playlists and scripts, which name further files."""
FRAMES = 120
"""Most photos taken from a video, unless it is said otherwise."""
FEW = 24
"""Least number of frames to take, even without visible motion, as in a straight line ahead."""
LOOKED = 640
"""Longer side of the grey copies, pixels: less would hide the blur of a moving camera."""
BLOCK = 4
"""Motion is looked for in copies smaller by this."""
APART = 0.04
"""Motion between two chosen frames, as a share of the image's width."""
KEY = 0.05
"""Motion after which the next frames are compared with a newer one."""
TIMED = 0.1
"""Weight of time beside motion: stretches without motion are not left out wholly."""
BLURRED = 0.5
"""A frame is blurred that has less than this share of the sharpness around it."""
AROUND = 2
"""Chosen frames on either side that sharpness is compared with."""
MOST_PIXELS = 2**27
QUALITY = 95
MARK = ".video"
"""File beside the frames that names their video, and the number that was asked for."""
HEADER = re.compile(rb"P[56]\n(\d+) (\d+)\n255\n")
STREAM = re.compile(r"Stream #.* Video: .*")
TRANSFERS = {"smpte2084": "PQ", "arib-std-b67": "HLG"}
"""Transfer functions of more light than a screen of sRGB shows, as ffmpeg calls them."""
WHITE, PEAK = 203, 1000
"""Luminance of a white sheet in HLG and PQ (ITU-R BT.2408), and the most that is shown, cd/m²."""
LENGTH = re.compile(r"Duration: (\d+):(\d+):([\d.]+)")
RATE = re.compile(r"([\d.]+) fps")
CONVERT = "convert it first: ffmpeg -i {} -c:v libx264 -crf 16 -pix_fmt yuv420p converted.mp4"
INSTALL = "install ffmpeg (apt install ffmpeg, or pip install imageio-ffmpeg), or give photos"


def is_video(path: Path) -> bool:
    """True if a path is a file with the name of a video."""
    return path.suffix.lower() in VIDEOS and path.is_file()


def find_ffmpeg(video: Path) -> str:
    """The program: that on PATH, else the one of the package imageio-ffmpeg.

    Raises:
        SceneError: There is none.
    """
    program = shutil.which("ffmpeg")
    with suppress(ImportError, RuntimeError):
        program = program or str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    if program is None:
        found, wanted = "a video and no program ffmpeg", "one on PATH"
        raise SceneError(video, found=found, expected=wanted, advice=INSTALL)
    return program


def check_video(video: Path) -> None:
    """Decodes the first frame: what has none may be very long, and is not read any further.

    Raises:
        SceneError: There is no ffmpeg, or it finds no image.
    """
    size_of(find_ffmpeg(video), video)


@dataclass(frozen=True)
class Footage:
    """All frames of a video as the first pass sees them.

    Attributes:
        places: How far the camera has moved, in widths of the image, never less than before, [N].
        sharpness: Variance of the Laplacian over that of the frame, [N].
    """

    places: NDArray[np.float64]  # [N]
    sharpness: NDArray[np.float64]  # [N]


def take_frames(video: Path, digest: str, out: Path, most: int, tick: Tick) -> str:
    """Write frames of a video as photos into a folder, whole or not at all.

    Nothing is done if the folder already holds those of the same video.

    Args:
        video: The file.
        digest: Its digest, see `photo_set.digest_of`.
        out: Folder of the photos; replaced.
        most: Frames to take, at most.
        tick: Called with the frames decoded and the approximate number of all.

    Returns:
        A sentence on the frames taken.

    Raises:
        SceneError: There is no ffmpeg, or it finds fewer than three frames.
    """
    program, mark = find_ffmpeg(video), f"{digest} {most}\n"
    with suppress(OSError):
        stored = (out / MARK).read_text("utf-8")
        if stored.startswith(mark):
            return stored.removeprefix(mark)
    size, said = size_of(program, video), description_of(program, video)
    seen = look_at(program, video, size, length_of(said), tick)
    chosen, (tones, told) = choose(seen, most), _tones(program, transfer_of(said))
    taking = (
        f"{len(chosen)} of {len(seen.places):,} frames of {video.name} taken: "
        f"the sharpest of each stretch of camera motion{told}"
    )
    draft = out.with_name(f".{out.name}")
    for folder in (draft, out):
        shutil.rmtree(folder, ignore_errors=True)
    draft.mkdir(parents=True)
    taken = 0
    for taken, frame in enumerate(_chosen_frames(program, video, size, chosen, tones), 1):
        path = draft / f"frame_{taken:04d}.jpg"
        Image.fromarray(frame).save(path, quality=QUALITY, subsampling=0)
        if taken > len(chosen):
            break
    if taken != len(chosen):
        shutil.rmtree(draft)
        found, advice = "other frames when read again", CONVERT.format(shlex.quote(video.name))
        raise SceneError(video, found=found, expected="the same ones", advice=advice)
    (draft / MARK).write_text(mark + taking, "utf-8")
    draft.rename(out)
    return taking


def look_at(program: str, video: Path, full: tuple[int, int], total: int, tick: Tick) -> Footage:
    """Motion and sharpness of all frames.

    Args:
        program: ffmpeg.
        video: The file.
        full: Width and height of its frames, pixels.
        total: Frames that it says it has, about.
        tick: Called with the frames decoded and the approximate number of all.

    Raises:
        SceneError: There are fewer than three.
    """
    width, height = full
    less = min(1.0, LOOKED / max(width, height))
    size = f"scale={max(1, round(less * width))}:{max(1, round(less * height))}:flags=area"
    places, sharpness, way = list[float](), list[float](), MotionTracker()
    for number, frame in enumerate(
        _pictures(program, video, f"{size},format=gray", "pgm"), start=1
    ):
        grey = frame[:, :, 0].astype(np.float32)
        places.append(way.add(grey))
        sharpness.append(sharpness_of(grey))
        tick(number, max(total, number + 1))
    tick(len(places), len(places))
    if len(places) < FEWEST:
        raise SceneError(video, found=f"{len(places)} frames", expected=f"at least {FEWEST}")
    return Footage(np.maximum.accumulate(places), np.array(sharpness))


def choose(seen: Footage, most: int) -> list[int]:
    """Indices of the frames to take, ascending: the sharpest of each stretch.

    A stretch of blurred frames alone, far less sharp than those around it, gives none.

    Args:
        seen: All frames.
        most: To take, at most.
    """
    count, moved = len(seen.places), float(seen.places[-1])
    stretches = min(max(round(moved / APART), FEW), most, count)
    time = np.arange(count) / count
    motion = seen.places / moved if moved else time
    course = (motion + TIMED * time) / (1 + TIMED)
    stretch = np.minimum((course * stretches).astype(int), stretches - 1)
    order = np.lexsort((-seen.sharpness, stretch))
    first = np.unique(stretch[order], return_index=True)[1]
    chosen = np.sort(order[first])
    around = [
        np.median(seen.sharpness[chosen[max(0, n - AROUND) : n + AROUND + 1]])
        for n in range(len(chosen))
    ]
    sharp = seen.sharpness[chosen] >= BLURRED * np.array(around)
    return (chosen[sharp] if sharp.sum() >= FEWEST else chosen).tolist()


class MotionTracker:
    """Motion of a camera, estimated from the shift between its frames."""

    def __init__(self) -> None:
        self._key: NDArray[np.complex64] | None = None
        self._at = 0.0

    def add(self, grey: NDArray[np.float32]) -> float:
        """The place of the next frame [H, W]: shifts so far, in widths of the picture."""
        height, width = (side // BLOCK for side in grey.shape)
        blocks = grey[: height * BLOCK, : width * BLOCK].reshape(height, BLOCK, width, BLOCK)
        small = blocks.mean(axis=(1, 3))
        window = np.outer(np.hanning(height), np.hanning(width))
        spectrum = np.fft.rfft2((small - small.mean()) * window).astype(np.complex64)
        if self._key is None:
            self._key = spectrum
        place = self._at + _shift(self._key, spectrum, (height, width)) / width
        if place - self._at > KEY:
            self._key, self._at = spectrum, place
        return place


def _shift(a: NDArray[np.complex64], b: NDArray[np.complex64], size: tuple[int, int]) -> float:
    """Length of the shift between two images by phase correlation, pixels."""
    cross = a * b.conj()
    peaks = np.fft.irfft2(cross / (np.abs(cross) + 1e-6), s=size)
    y, x = divmod(int(peaks.argmax()), size[1])
    return float(np.hypot(min(y, size[0] - y), min(x, size[1] - x)))


def sharpness_of(grey: NDArray[np.float32]) -> float:
    """Variance of the Laplacian of an image [H, W] over that of the image; exposure cancels."""
    middle = grey[1:-1, 1:-1]
    around = grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:]
    return float((around - 4 * middle).var() / (middle.var() + 1.0))


def _tones(program: str, transfer: str) -> tuple[str, str]:
    """Filters that bring a transfer function to sRGB's, and what to say of them."""
    if not transfer:
        return "", ""
    filters = _said(program, "-filters")
    if not re.search(r"\bzscale\b", filters) or not re.search(r"\btonemap\b", filters):
        return "", (
            f"; it is {transfer} video, and colours stay as stored, pale and dark: this ffmpeg has "
            "no filters zscale and tonemap, those of Debian and of imageio-ffmpeg have"
        )
    stored = next(name for name, short in TRANSFERS.items() if short == transfer)
    linear = f"zscale=tin={stored}:pin=2020:min=2020_ncl:t=linear:npl={WHITE},format=gbrpf32le"
    shown = f"zscale=p=bt709,tonemap=mobius:desat=0:peak={PEAK / WHITE:.3f},zscale=t=bt709:r=full"
    return f",{linear},{shown},format=gbrp", f"; {transfer} video: tone-mapped to sRGB"


def description_of(program: str, video: Path) -> str:
    """All that ffmpeg says of a video: its length, its streams."""
    return _said(program, *_input_of(video))


def transfer_of(said: str) -> str:
    """`HLG` or `PQ` if a video is so by what ffmpeg says of it; else, or if unsaid, empty."""
    stream = STREAM.search(said)
    words = re.findall(r"[\w-]+", stream[0]) if stream else []
    return next((TRANSFERS[word] for word in words if word in TRANSFERS), "")


def _chosen_frames(
    program: str, video: Path, size: tuple[int, int], chosen: Sequence[int], tones: str
) -> Iterator[NDArray[np.uint8]]:
    terms = "+".join(rf"eq(n\,{number})" for number in chosen)
    filters = f"scale={size[0]}:{size[1]},select={terms}{tones},format=rgb24"
    return _pictures(program, video, filters, "ppm")


def size_of(program: str, video: Path) -> tuple[int, int]:
    """Width and height of the first frame as it is shown, pixels.

    Raises:
        SceneError: There is none.
    """
    frames = _pictures(program, video, "format=rgb24", "ppm", "-frames:v", "1")
    height, width = next(frames).shape[:2]
    frames.close()
    return width, height


def _input_of(video: Path) -> list[str]:
    """Options that open one file, which is a video, and no other."""
    only = ["-protocol_whitelist", "file", "-format_whitelist", CONTAINERS]
    return ["-nostdin", "-hide_banner", *only, "-i", f"file:{video}"]


def _said(program: str, *options: str) -> str:
    """All that the program says to some options."""
    done = subprocess.run(
        [program, *options],
        check=False,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    return done.stdout.decode(errors="replace")


@cache
def _once(program: str) -> list[str]:
    """The option that gives each frame once, whatever its time; `-vsync` before ffmpeg 5.1."""
    return ["-fps_mode" if "-fps_mode" in _said(program, "-h", "long") else "-vsync", "passthrough"]


def _pictures(
    program: str, video: Path, filters: str, kind: str, *more: str
) -> Generator[NDArray[np.uint8]]:
    """Frames of a video through filters, uint8 [H, W, C]; the program ends with the generator.

    A video may change its size or form on the way: filters are kept then, and count on, so the
    first of them has to scale.

    Raises:
        SceneError: The program finds no image in it.
    """
    line = [program, "-loglevel", "error", "-reinit_filter", "0", *_input_of(video)]
    line += ["-map", "0:V:0", "-vf", filters, *_once(program), *more]
    line += ["-f", "image2pipe", "-c:v", kind, "-"]
    with (
        tempfile.TemporaryFile() as told,
        subprocess.Popen(line, stdout=subprocess.PIPE, stderr=told) as process,
    ):
        assert process.stdout is not None
        count = 0
        try:
            while (picture := _picture(process.stdout, video)) is not None:
                count += 1
                yield picture
            process.wait()
        finally:
            process.kill()
        if not count:
            told.seek(0)
            lines = told.read().decode(errors="replace").strip().splitlines()
            reason = lines[-1] if lines else "no frame"
            found = f"no picture (ffmpeg: {reason})"
            wanted = "a video that ffmpeg can decode: MP4, MOV, Matroska, WebM, AVI, MPEG, ASF, OGG"
            raise SceneError(video, found=found, expected=wanted)


def _picture(pipe: IO[bytes], video: Path) -> NDArray[np.uint8] | None:
    """The next image of a stream of PGM or PPM; None at its end."""
    header = b"".join(pipe.readline(32) for _ in range(3))
    match = HEADER.fullmatch(header)
    if match is None:
        return None
    width, height = int(match[1]), int(match[2])
    if width * height > MOST_PIXELS:
        raise SceneError(video, found=f"{width}x{height}", expected=f"{MOST_PIXELS:,} pixels")
    channels = 3 if header.startswith(b"P6") else 1
    body = pipe.read(width * height * channels)
    if len(body) < width * height * channels:
        return None
    return np.frombuffer(body, np.uint8).reshape(height, width, channels)


def length_of(said: str) -> int:
    """Frames of a video by what ffmpeg says of it, about; 0 if it does not say."""
    length, rate = LENGTH.search(said), RATE.search(said)
    if length is None or rate is None:
        return 0
    hours, minutes, seconds = int(length[1]), int(length[2]), float(length[3])
    return round((3600 * hours + 60 * minutes + seconds) * float(rate[1]))
