"""Decoded photos in files: memory-mapped, so that memory does not grow with their number.

The name of a file is a digest of the photo's bytes and of its reduction, shift and form. So a
changed photo has another file, and a stale one is never read. Files appear whole or not at all; one
that is damaged, of another photo or of another size is written again.

One file: 16 bytes of magic and version, height, width (2 × uint32 little endian), 32 bytes of
BLAKE2b of the pixels, keyed by the file's name, then height · width · 3 bytes.
"""

import contextlib
import errno
import hashlib
import os
import shutil
import struct
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain
from pathlib import Path

import numpy as np
import PIL
from numpy.typing import NDArray

from gsynopsis.errors import InputError, SceneError
from gsynopsis.files import clear_drafts, drafted, open_regular
from gsynopsis.scene.camera import STILL, Shift, scaled_size
from gsynopsis.scene.photos import AS_STORED, PhotoForm, load_photo, load_shifted
from gsynopsis.scene.stored import QUARTER_TURNS, read_header

MAGIC = b"gsynopsis photo2"
CONVERSION = 3
"""Changes with what `load_photo` makes of the same bytes; 3: distortion is removed exactly."""
HEAD = struct.Struct("<16s2I32s")
SUFFIX, DRAFT = ".photo", ".draft"
CHECK = 32
"""Bytes of a digest of pixels."""
PART = 1 << 20
"""Bytes of a photo that are read at a time for its digest."""
ROOM = 1 << 28
"""Free disk that a photo may not take, bytes."""


class PhotoStore:
    """Images of `load_photo` in files of a folder.

    Where the disk is full, or cannot be written, nothing is kept any more and images are decoded
    each time; `failure` says why then. For use from several threads and processes.
    """

    def __init__(self, folder: Path, failed: Callable[[OSError], None] | None = None) -> None:
        """Create the folder if it is missing.

        Args:
            folder: Folder of the files; stores of other scenes may share it.
            failed: Called once, from any thread, when files cannot be written.

        Raises:
            OSError: it cannot be made.
        """
        folder.mkdir(parents=True, exist_ok=True)
        clear_drafts(folder)
        self.folder = folder
        self.failure: OSError | None = None
        self._failed = failed
        self._digests: dict[Path, tuple[int, int, str]] = {}
        self._whole: dict[str, tuple[int, int]] = {}
        self._shifts: tuple[Shift, ...] = ()
        self._lock = threading.Lock()
        self._reader: ThreadPoolExecutor | None = None
        self._ahead: Future[None] | None = None

    def get(
        self, path: Path, factor: float, shift: Shift = STILL, form: PhotoForm = AS_STORED
    ) -> NDArray[np.uint8]:
        """The image of `load_photo`, mapped from its file, which is made if it is not there.

        Raises:
            SceneError: The pixel data cannot be decoded.
        """
        try:
            kept = self._kept(path, factor, shift, form)
            return self._made(path, factor, shift, form) if kept is None else kept
        except OSError:  # the photo is gone: to say so is the decoder's business
            return load_photo(path, factor, shift, form)

    def _made(self, path: Path, factor: float, shift: Shift, form: PhotoForm) -> NDArray[np.uint8]:
        """The image, now in its file; with one of the expected shifts, those at the others too.

        They are made of one decoding, which for a large photo, or one with distortion, takes most
        of the time.
        """
        together = self._shifts if shift in self._shifts and self.failure is None else ()
        others = [other for other in together if other != shift]
        shifts = [shift, *(o for o in others if self._kept(path, factor, o, form) is None)]
        images = load_shifted(path, factor, shifts, form)
        asked = next(images)
        for own, pixels in zip(shifts, chain([asked], images), strict=True):
            if self.failure is None:
                self._write(self.folder / self._name(path, factor, own, form), pixels)
        kept = self._kept(path, factor, shift, form)
        return asked if kept is None else kept

    def expect(
        self, path: Path, factor: float, shifts: Sequence[Shift], form: PhotoForm = AS_STORED
    ) -> None:
        """Make a photo's files and read them, in a thread of its own, before they are asked for.

        Returns at once; while the thread is busy with another photo nothing is done, but that
        from now on each photo is made at all of these shifts together.
        """
        self._shifts = tuple(shifts)
        if self.failure is not None or (self._ahead is not None and not self._ahead.done()):
            return
        if self._reader is None:
            self._reader = ThreadPoolExecutor(1, "photos")
        self._ahead = self._reader.submit(self._warm, path, factor, tuple(shifts), form)

    def close(self) -> None:
        """Ends the thread."""
        if self._reader is not None:
            self._reader.shutdown()
            self._reader = None

    def remove(self) -> None:
        """Close, and delete the files, unfinished ones too, and the folder if it is empty."""
        self.close()
        with contextlib.suppress(OSError):
            clear_drafts(self.folder)
            for file in self.folder.iterdir():
                if file.suffix in (SUFFIX, DRAFT) and not file.is_dir():
                    file.unlink(missing_ok=True)
            self.folder.rmdir()

    def _warm(self, path: Path, factor: float, shifts: Sequence[Shift], form: PhotoForm) -> None:
        for shift in shifts:
            try:
                pixels = self.get(path, factor, shift, form)
            except SceneError:  # whoever asks for it is told
                return
            # A byte of each page brings it into memory.
            int(pixels.reshape(-1)[::4096].sum(dtype=np.int64))

    def _name(self, path: Path, factor: float, shift: Shift, form: PhotoForm) -> str:
        shift = float(shift[0]), float(shift[1])
        told = repr((CONVERSION, PIL.__version__, self._digest(path), float(factor), shift, form))
        return hashlib.blake2b(told.encode(), digest_size=16).hexdigest() + SUFFIX

    def _digest(self, path: Path) -> str:
        """Digest of a photo's bytes; read again only if its size or time differs."""
        now = path.stat()
        known = self._digests.get(path)
        if known is not None and known[:2] == (now.st_size, now.st_mtime_ns):
            return known[2]
        digest = hashlib.blake2b(digest_size=16)
        with path.open("rb") as file:
            while part := file.read(PART):
                digest.update(part)
        found = digest.hexdigest()
        self._digests[path] = now.st_size, now.st_mtime_ns, found
        return found

    def _kept(
        self, path: Path, factor: float, shift: Shift, form: PhotoForm
    ) -> NDArray[np.uint8] | None:
        """The image mapped from its file; None without a whole one.

        Raises:
            OSError: The photo is gone.
        """
        file = self.folder / self._name(path, factor, shift, form)
        return self._mapped(file, self._whole.get(file.name) or _sides(path, factor, form))

    def _mapped(self, file: Path, sides: tuple[int, int]) -> NDArray[np.uint8] | None:
        """A file's pixels, so wide and high; None if there is none, or if it is not whole."""
        width, height = sides
        try:
            with open_regular(file, links=False) as opened:
                head = opened.read(HEAD.size)
                if head[:-CHECK] != HEAD.pack(MAGIC, height, width, b"")[:-CHECK]:
                    return None
                if os.fstat(opened.fileno()).st_size != HEAD.size + 3 * height * width:
                    return None
                mapped = np.memmap(opened, np.uint8, "r", HEAD.size, (height, width, 3))
        except (OSError, InputError):
            return None
        pixels: NDArray[np.uint8] = np.asarray(mapped)
        if file.name not in self._whole:
            if _check(file, pixels) != head[-CHECK:]:
                return None
            self._whole[file.name] = sides
        return pixels

    def _write(self, file: Path, pixels: NDArray[np.uint8]) -> None:
        """Write a photo's file; where that fails, no other is written."""
        height, width = pixels.shape[:2]
        try:
            if shutil.disk_usage(self.folder).free < pixels.nbytes + ROOM:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.folder))
            with drafted(file, durable=False) as draft, draft.open("wb") as opened:
                opened.write(HEAD.pack(MAGIC, height, width, _check(file, pixels)))
                opened.write(pixels.data)
        except OSError as error:
            self._fail(error)
        else:
            self._whole[file.name] = (width, height)

    def _fail(self, error: OSError) -> None:
        with self._lock:
            first, self.failure = self.failure is None, self.failure or error
        if first and self._failed is not None:
            self._failed(error)


def _check(file: Path, pixels: NDArray[np.uint8]) -> bytes:
    """Checksum of pixels, keyed by photo and form: a file under another's name is refused."""
    key = file.stem.encode()
    return hashlib.blake2b(pixels.data, digest_size=CHECK, key=key).digest()


def _sides(path: Path, factor: float, form: PhotoForm) -> tuple[int, int]:
    """Width and height of what `load_photo` gives."""
    size = form.size
    if form.warp is not None:
        size = form.warp.pinhole[:2]
    if size is None:
        header = read_header(path)
        width, height = header.size
        swapped = form.turned and header.orientation in QUARTER_TURNS
        size = (height, width) if swapped else (width, height)
    return scaled_size(*size, factor)
