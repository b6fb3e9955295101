"""Decoded photos in files: the same images, never stale, cut off or half written ones."""

import errno
import gc
import os
from collections import namedtuple
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene import photo_files as decoded
from gsynopsis.scene import photos
from gsynopsis.scene.camera import STILL
from gsynopsis.scene.colmap.distortion import Lens, Warp
from gsynopsis.scene.photo_files import DRAFT, HEAD, SUFFIX, PhotoStore
from gsynopsis.scene.photos import AS_STORED, PhotoForm, load_photo
from gsynopsis.scene.scene import PhotoCache

SHIFT = (0.25, -0.25)
Disk = namedtuple("Disk", "free")


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    pixels = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
    path = tmp_path / "photo.png"
    Image.fromarray(pixels).save(path)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "kept"


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


@pytest.mark.parametrize("form", [AS_STORED, PhotoForm(size=(30, 30))])
@pytest.mark.parametrize(("factor", "shift"), [(1, STILL), (2, SHIFT), (2.0, STILL), (3.7, SHIFT)])
def test_images_are_those_that_are_decoded(
    photo: Path, folder: Path, factor: float, shift: tuple[float, float], form: PhotoForm
) -> None:
    store = PhotoStore(folder)
    expected = load_photo(photo, factor, shift, form)
    for _ in range(2):
        found = store.get(photo, factor, shift, form)
        assert found.dtype == np.uint8 and not found.flags.writeable
        assert np.array_equal(found, expected)
    assert len(files(folder)) == 1 and store.failure is None


def test_a_photo_is_decoded_once_for_all_that_share_a_folder(
    photo: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = PhotoStore(folder).get(photo, 2, SHIFT).copy()
    copy = photo.with_name("copy of another name.png")
    copy.write_bytes(photo.read_bytes())

    def refuse(*_: object) -> None:
        raise AssertionError("decoded again")

    monkeypatch.setattr(decoded, "load_shifted", refuse)
    again = PhotoStore(folder)
    assert np.array_equal(again.get(photo, 2.0, SHIFT), expected)
    assert np.array_equal(again.get(copy, 2, SHIFT), expected)
    for other in ((2, STILL, AS_STORED), (4, SHIFT, AS_STORED), (2, SHIFT, PhotoForm(turned=True))):
        with pytest.raises(AssertionError, match="decoded again"):
            again.get(photo, *other)


def test_a_lens_is_part_of_what_a_file_is(photo: Path, folder: Path) -> None:
    store, found = PhotoStore(folder), set[bytes]()
    for strength in (0.0, 0.1, 0.1 + 1e-12):
        lens = (60, 40, 50.0, 50.0, 30.0, 20.0)
        warp = Warp(Lens(radial=(strength,)), lens, lens)
        found.add(store.get(photo, 1, STILL, PhotoForm(warp=warp)).tobytes())
    assert len(files(folder)) == 3 and len(found) == 2


def test_a_changed_photo_is_another_file_even_while_the_store_is_open(
    photo: Path, folder: Path
) -> None:
    store = PhotoStore(folder)
    before = store.get(photo, 1).copy()
    stat = photo.stat()
    Image.fromarray(255 - before).save(photo)
    os.utime(photo, ns=(stat.st_atime_ns, stat.st_mtime_ns + 1))
    assert np.array_equal(store.get(photo, 1), 255 - before)
    # Of the same size and time: whoever opens the store later reads the bytes.
    Image.fromarray(before).save(photo)
    os.utime(photo, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert np.array_equal(PhotoStore(folder).get(photo, 1), before)


@pytest.mark.parametrize("keep", [0, 5, HEAD.size, HEAD.size + 100, -1])
def test_a_cut_off_file_is_made_anew(photo: Path, folder: Path, keep: int) -> None:
    expected = PhotoStore(folder).get(photo, 1).copy()
    (file,) = files(folder)
    whole = file.read_bytes()
    file.write_bytes(whole[:keep])
    assert np.array_equal(PhotoStore(folder).get(photo, 1), expected)
    assert file.read_bytes() == whole and files(folder) == [file]


@pytest.mark.parametrize("place", [0, 16, 20, 24, HEAD.size, -1])
def test_a_damaged_file_is_made_anew(photo: Path, folder: Path, place: int) -> None:
    expected = PhotoStore(folder).get(photo, 1).copy()
    (file,) = files(folder)
    whole = file.read_bytes()
    broken = bytearray(whole)
    broken[place] ^= 1
    file.write_bytes(broken)
    assert np.array_equal(PhotoStore(folder).get(photo, 1), expected)
    assert file.read_bytes() == whole


def test_a_file_that_is_cut_off_while_the_store_is_open_is_made_anew(
    photo: Path, folder: Path
) -> None:
    store = PhotoStore(folder)
    expected = store.get(photo, 1).copy()
    (file,) = files(folder)
    file.write_bytes(file.read_bytes()[:-1])
    assert np.array_equal(store.get(photo, 1), expected)


def test_a_full_disk_is_said_once_and_leaves_nothing(
    photo: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = list[OSError]()
    store = PhotoStore(folder, told.append)
    monkeypatch.setattr(decoded.shutil, "disk_usage", lambda _: Disk(1000))
    for factor in (1, 2):
        assert np.array_equal(store.get(photo, factor), load_photo(photo, factor))
    assert [error.errno for error in told] == [errno.ENOSPC] == [store.failure.errno]  # type: ignore
    assert files(folder) == []


def test_a_disk_that_fills_up_while_a_file_is_written_leaves_no_part_of_it(
    photo: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = PhotoStore(folder)
    kept = store.get(photo, 4).copy()

    def refuse(*_: object) -> None:
        assert len(files(folder)) == 2
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(decoded.os, "replace", refuse)
    assert np.array_equal(store.get(photo, 1), load_photo(photo, 1))
    assert len(files(folder)) == 1
    # What was kept before is of use still.
    assert np.array_equal(store.get(photo, 4), kept)


def test_a_damaged_photo_is_the_same_error_and_leaves_nothing(photo: Path, folder: Path) -> None:
    photo.write_bytes(photo.read_bytes()[:300])
    store = PhotoStore(folder)
    with pytest.raises(SceneError, match="expected a whole image"):
        store.get(photo, 1)
    photo.unlink()
    with pytest.raises(SceneError):
        store.get(photo, 1)
    assert files(folder) == []


def test_what_is_expected_is_there_before_it_is_asked_for(
    photo: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = PhotoStore(folder)
    store.expect(photo, 2, [STILL, SHIFT])
    store.close()
    assert len(files(folder)) == 2
    expected = load_photo(photo, 2, SHIFT)
    monkeypatch.setattr(decoded, "load_shifted", None)
    assert np.array_equal(store.get(photo, 2, SHIFT), expected)
    store.expect(folder / "missing.png", 2, [STILL])
    store.remove()
    assert not folder.exists()


def test_a_photo_is_decoded_once_for_all_shifts(
    photo: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Mock(wraps=photos.opened_photo)
    monkeypatch.setattr(photos, "opened_photo", opened)
    store = PhotoStore(folder)
    store.expect(photo, 2, [STILL, SHIFT])
    store.close()
    assert opened.call_count == 1
    images = [store.get(photo, factor, shift) for factor in (2, 4) for shift in (STILL, SHIFT)]
    assert opened.call_count == 2, "the second shift of the other size came with the first"
    before = len(files(folder))
    store.get(photo, 4, (0.25, 0.25))
    assert len(files(folder)) == before + 1, "a shift that nobody expects comes alone"
    monkeypatch.undo()
    for (factor, shift), image in zip(
        [(2, STILL), (2, SHIFT), (4, STILL), (4, SHIFT)], images, strict=True
    ):
        assert np.array_equal(image, load_photo(photo, factor, shift))


def test_what_a_kill_left_goes_with_the_rest(photo: Path, folder: Path) -> None:
    store = PhotoStore(folder)
    store.get(photo, 1)
    (folder / f".0123.1.2{DRAFT}").write_bytes(b"half of it")
    store.remove()
    assert not folder.exists()


def test_only_its_own_files_are_removed(photo: Path, folder: Path) -> None:
    store = PhotoStore(folder)
    store.get(photo, 1)
    (folder / "mine.txt").write_text("kept")
    store.remove()
    assert [file.name for file in files(folder)] == ["mine.txt"]


def test_no_file_stays_open_and_no_memory_is_held(photo: Path, folder: Path) -> None:
    store = PhotoStore(folder)
    for factor in np.linspace(1, 3, 50).tolist():
        store.get(photo, factor)
    gc.collect()
    opened = [os.path.realpath(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd")]
    assert not [name for name in opened if name.endswith(SUFFIX)]
    maps = Path("/proc/self/maps").read_text()
    assert SUFFIX not in maps
    cache = PhotoCache()
    cache.store = store
    assert np.array_equal(cache.get(photo, 2), load_photo(photo, 2)) and cache.held == 0


def test_pixels_of_another_photo_or_form_are_made_anew(photo: Path, folder: Path) -> None:
    other = photo.with_name("other.png")
    Image.fromarray(255 - load_photo(photo, 1)).save(other)
    expected = PhotoStore(folder).get(photo, 1).copy()
    (file,) = files(folder)
    PhotoStore(folder).get(other, 1)
    (swapped,) = {*files(folder)} - {file}
    file.write_bytes(swapped.read_bytes())
    assert np.array_equal(PhotoStore(folder).get(photo, 1), expected)
    PhotoStore(folder).get(photo, 1, (0.5, 0.0))
    shifted = next(f for f in files(folder) if f not in (file, swapped))
    shifted.write_bytes(file.read_bytes())
    found = PhotoStore(folder).get(photo, 1, (0.5, 0.0))
    assert np.array_equal(found, load_photo(photo, 1, (0.5, 0.0)))


def test_sides_are_those_of_the_photo(photo: Path, folder: Path) -> None:
    expected = PhotoStore(folder).get(photo, 1).copy()
    (file,) = files(folder)
    for height, width in ((60, 40), (1, 2400), (0, 0), (2**32 - 1, 2**32 - 1)):
        data = bytearray(file.read_bytes())
        data[16:24] = height.to_bytes(4, "little") + width.to_bytes(4, "little")
        file.write_bytes(data)
        assert np.array_equal(PhotoStore(folder).get(photo, 1), expected)


def test_links_and_pipes_in_a_cache_are_replaced(photo: Path, folder: Path, tmp_path: Path) -> None:
    expected = PhotoStore(folder).get(photo, 1).copy()
    (file,) = files(folder)
    secret = tmp_path / "secret"
    secret.write_bytes(file.read_bytes())
    file.unlink()
    file.symlink_to(secret)
    assert np.array_equal(PhotoStore(folder).get(photo, 1), expected)
    file.unlink(missing_ok=True)
    os.mkfifo(file)
    assert np.array_equal(PhotoStore(folder).get(photo, 1), expected)
    assert file.is_file() and not file.is_symlink()
    assert secret.read_bytes() == file.read_bytes()
