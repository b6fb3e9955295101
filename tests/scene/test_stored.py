"""Photos as they are stored: by content, from regular files, in bounded memory."""

import ast
import os
import shutil
import struct
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import pytest
from PIL import Image, ImageFile

from gsynopsis.capture.photo_set import gather
from gsynopsis.errors import SceneError
from gsynopsis.scene.panoramas import has_panorama_tag
from gsynopsis.scene.photos import check_photos, load_photo
from gsynopsis.scene.stored import Decoding, exif_of, opened_photo, read_header

SOURCE = Path(__file__).parent.parent.parent / "src" / "gsynopsis"
POSTSCRIPT = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 64 48
%%EndComments
(started) print quit
"""
FITS = b"SIMPLE  =                    T".ljust(80) + b"BITPIX  =                    8".ljust(80)


def black(path: Path, width: int, height: int, channels: int = 3) -> Path:
    """A black PNG, in pieces: its bytes are a thousandth of its pixels."""
    kind = {1: 0, 3: 2, 4: 6}[channels]
    packed, squeeze = b"", zlib.compressobj(1)
    for _ in range(height // 100):
        packed += squeeze.compress(bytes(100 * (1 + width * channels)))
    packed += squeeze.flush()
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        head = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
        for name, body in ((b"IHDR", head), (b"IDAT", packed), (b"IEND", b"")):
            file.write(struct.pack(">I", len(body)) + name + body)
            file.write(struct.pack(">I", zlib.crc32(name + body)))
    return path


def test_pillow_opens_files_of_others_in_one_place_with_formats_named() -> None:
    calls = {
        path.relative_to(SOURCE).as_posix(): {word.arg for word in node.keywords}
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Image.open"
    }
    assert calls == {"scene/stored.py": {"formats"}, "formats/readers/sog.py": {"formats"}}


def with_tags(path: Path, behind: bool) -> Path:
    """A PNG whose EXIF says that it lies on its side, before its pixels or behind them."""
    image = Image.new("RGB", (60, 40), (9, 8, 7))
    exif = image.getexif()
    exif[0x0112] = 6
    image.save(path, exif=exif)
    if behind:
        content = path.read_bytes()
        start = content.index(b"eXIf") - 4
        chunk = content[start : start + 12 + int.from_bytes(content[start : start + 4], "big")]
        path.write_bytes(content.replace(chunk, b"")[:-12] + chunk + content[-12:])
    return path


@pytest.mark.parametrize("behind", [False, True])
def test_headers_of_png_files_are_read_without_their_pixels(
    tmp_path: Path, behind: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = with_tags(tmp_path / "a.png", behind)

    def decodes(image: ImageFile.ImageFile) -> None:
        raise AssertionError("pixels are decoded")

    with monkeypatch.context() as patched:
        patched.setattr(ImageFile.ImageFile, "load", decodes)
        header = read_header(path)
        plain = read_header(black(tmp_path / "b.png", 200, 100))
        with opened_photo(path) as image:
            assert not has_panorama_tag(image)
    assert (header.size, header.orientation, plain.orientation) == ((60, 40), 6, 1)
    with opened_photo(path) as image:
        assert exif_of(image)[0x0112] == 6
        assert image.getpixel((30, 20)) == (9, 8, 7)  # its place in the file is as it was


def test_a_png_that_breaks_off_has_no_tags(tmp_path: Path) -> None:
    path = with_tags(tmp_path / "a.png", behind=True)
    path.write_bytes(path.read_bytes()[:-40])
    assert read_header(path).orientation == 1


@pytest.mark.parametrize("content", [POSTSCRIPT, FITS + bytes(2800)], ids=["eps", "fits"])
def test_a_picture_of_another_format_starts_nothing(
    tmp_path: Path, content: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pillow gives PostScript to Ghostscript, whatever the file is called."""
    mark, program = tmp_path / "started", tmp_path / "bin" / "gs"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ntouch {mark}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    path = tmp_path / "photos" / "p0.png"
    path.parent.mkdir()
    path.write_bytes(content)
    for read in (read_header, lambda p: load_photo(p, 1), lambda p: list(check_photos([p]))):
        with pytest.raises(SceneError, match=r"p0\.png: pixels: found .*JPEG, PNG") as caught:
            read(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(SceneError, match=r"1 photos left out, cannot be read: p0\.png"):
        gather(path.parent)
    assert not mark.exists()


def test_what_a_file_is_counts_and_not_its_name(tmp_path: Path) -> None:
    Image.new("RGB", (6, 4), "red").save(tmp_path / "a.jpg", "PNG")
    Image.new("RGB", (6, 4), "red").save(tmp_path / "b.png", "TIFF")
    for name in ("a.jpg", "b.png"):
        assert (load_photo(tmp_path / name, 1) == [255, 0, 0]).all()


def test_pipes_and_devices_in_place_of_photos_are_one_line_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "zero.png").symlink_to("/dev/zero")
    for name, kind in (("pipe.png", "a pipe"), ("zero.png", "a device")):
        with pytest.raises(SceneError, match=rf"{name}: found {kind}, expected a photo"):
            load_photo(tmp_path / name, 1)
        with pytest.raises(SceneError, match=rf"{name}: found {kind}, expected a photo"):
            read_header(tmp_path / name)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("size", [(17_000, 16_000), (30_000, 30_000)])
def test_a_photo_of_too_many_pixels_is_one_line(tmp_path: Path, size: tuple[int, int]) -> None:
    path = tmp_path / "bomb.png"
    head = struct.pack(">IIBBBBB", *size, 8, 2, 0, 0, 0)
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", len(head)) + b"IHDR" + head)
        file.write(struct.pack(">I", zlib.crc32(b"IHDR" + head)) + b"\0\0\0\0IDAT")
    with pytest.raises(SceneError, match=r"found .*pixels\)?, expected at most 268,435,456 pix"):
        read_header(path)


def test_large_photos_are_decoded_one_at_a_time() -> None:
    gate, held, most = Decoding(100), list[int](), list[int]()
    lock = threading.Lock()

    def decode(side: int) -> None:
        with gate.of(Image.new("1", (side, side))):
            with lock:
                held.append(side * side)
                most.append(sum(min(size, 100) for size in held))
            time.sleep(0.002)
            with lock:
                held.remove(side * side)

    threads = [threading.Thread(target=decode, args=(side,)) for side in (3, 30, 7, 9, 30, 5) * 4]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert len(most) == 24 and max(most) <= 100 and not held


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc: memory NOT tested")
def test_small_files_of_many_pixels_stay_below_a_gibibyte(tmp_path: Path) -> None:
    """81 megapixels in 1 MB, read by several threads, and as training does."""
    paths = [black(tmp_path / "a.png", 9000, 9000), black(tmp_path / "b.png", 9000, 9000, 4)]
    paths += [Path(shutil.copy(paths[0], tmp_path / name)) for name in ("c.png",)]
    assert all(path.stat().st_size < 3e6 for path in paths)
    code = """if True:
        import sys
        from pathlib import Path
        from gsynopsis.scene.photos import check_photos, load_photo
        a, b, c = map(Path, sys.argv[1:])
        list(check_photos([a, c]))
        for path in (a, b):
            load_photo(path, 1)
        print(next(line for line in open("/proc/self/status") if "VmHWM" in line).split()[1])
    """
    line = [sys.executable, "-c", code, *map(str, paths)]
    done = subprocess.run(line, capture_output=True, check=True, timeout=120)
    assert int(done.stdout) < 1 << 20, "KiB of memory at most"
