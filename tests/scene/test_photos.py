"""Photos: the pyramid, odd files, the cache."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.photos import expect_size, is_photo, load_photo
from gsynopsis.scene.scene import PhotoCache
from gsynopsis.scene.stored import AVIF, read_header


@pytest.fixture
def photo(tmp_path: Path, rng: np.random.Generator) -> Path:
    pixels = rng.integers(0, 256, (33, 50, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "photo.png")
    return tmp_path / "photo.png"


def save(path: Path, image: Image.Image, **options: object) -> Path:
    image.save(path, **options)
    return path


def test_factor_one_is_the_stored_photo_untouched(photo):
    with Image.open(photo) as image:
        np.testing.assert_array_equal(load_photo(photo, 1), np.asarray(image))


@pytest.mark.parametrize(
    ("factor", "shape"), [(2, (16, 25, 3)), (4, (8, 12, 3)), (8, (4, 6, 3)), (100, (1, 1, 3))]
)
def test_smaller_photos_are_lanczos_of_the_stored_one_at_rounded_sizes(photo, factor, shape):
    pixels = load_photo(photo, factor)
    assert pixels.dtype == np.uint8 and pixels.shape == shape
    with Image.open(photo) as image:
        resized = image.resize((shape[1], shape[0]), Image.Resampling.LANCZOS)
        np.testing.assert_array_equal(pixels, np.asarray(resized))


def test_a_constant_photo_stays_constant_at_every_size(tmp_path):
    path = save(tmp_path / "flat.png", Image.new("RGB", (37, 21), (200, 100, 3)))
    for factor in (1, 1.5, 2, 4, 8):
        assert (load_photo(path, factor) == [200, 100, 3]).all()


def test_a_shifted_photo_has_what_lies_beside_its_usual_pixels(tmp_path):
    y, x = np.mgrid[0:64, 0:96]
    ramp = np.stack([2 * x, 3 * y, x + y], axis=2).astype(np.uint8)
    path = save(tmp_path / "ramp.png", Image.fromarray(ramp))
    usual, shifted = load_photo(path, 4).astype(int), load_photo(path, 4, (0.25, -0.5)).astype(int)
    assert shifted.shape == usual.shape
    # A quarter of a pixel is one stored pixel to the right, a half two up; values are rounded.
    change = (shifted - usual)[4:-4, 4:-4]
    np.testing.assert_allclose(change, np.broadcast_to([2, -6, -1], change.shape), atol=1)
    flat = save(tmp_path / "flat.png", Image.new("RGB", (37, 21), (200, 100, 3)))
    assert (load_photo(flat, 3, (-0.5, 0.5)) == [200, 100, 3]).all()


def test_pixels_cannot_be_changed_by_who_gets_them(photo):
    with pytest.raises(ValueError, match="read-only"):
        load_photo(photo, 2)[0, 0, 0] = 7


def test_transparent_photos_lie_on_black(tmp_path):
    pixels = np.array([[[200, 100, 50, 255], [200, 100, 50, 128], [200, 100, 50, 0]]], np.uint8)
    path = save(tmp_path / "rgba.png", Image.fromarray(pixels))
    # 128 / 255 of each value, rounded.
    expected = [[[200, 100, 50], [100, 50, 25], [0, 0, 0]]]
    np.testing.assert_allclose(load_photo(path, 1), expected, atol=1)
    assert (load_photo(path, 1)[0, [0, 2]] == [[200, 100, 50], [0, 0, 0]]).all()


def test_greyscale_and_palette_photos_become_rgb(tmp_path, rng):
    grey = rng.integers(0, 256, (5, 6)).astype(np.uint8)
    path = save(tmp_path / "grey.png", Image.fromarray(grey))
    np.testing.assert_array_equal(load_photo(path, 1), np.repeat(grey[:, :, None], 3, axis=2))
    flat = save(tmp_path / "flat.gif", Image.new("P", (5, 6), 3))
    assert load_photo(flat, 1).shape == (6, 5, 3)


def test_the_orientation_tag_is_ignored(tmp_path, rng):
    image = Image.fromarray(rng.integers(0, 256, (8, 16, 3)).astype(np.uint8))
    exif = Image.Exif()
    exif[0x0112] = 6
    path = save(tmp_path / "turned.png", image, exif=exif)
    assert read_header(path).size == (16, 8)
    np.testing.assert_array_equal(load_photo(path, 1), np.asarray(image))


def test_a_missing_photo_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"gone\.png: image: found no such file, expected the ph"):
        read_header(tmp_path / "gone.png")


def test_a_photo_of_another_size_says_both(photo):
    with pytest.raises(SceneError, match="image size: found 50x33, expected 33x50 as its camera"):
        expect_size(photo, (33, 50))


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89PNG\r\n\x1a\n" + bytes(30)])
def test_a_file_that_is_no_image_is_refused_by_its_header(tmp_path, content):
    path = tmp_path / "odd.png"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=r"odd\.png: pixels: found .*expected a whole image") as e:
        read_header(path)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("kind", ["png", "tif"])
def test_sixteen_bits_become_eight(tmp_path, kind):
    values = np.array([[0, 128, 129, 257], [40_000, 65_278, 65_407, 65_535]], np.uint16)
    path = save(tmp_path / f"deep.{kind}", Image.fromarray(values))
    assert read_header(path).size == (4, 2)
    found = load_photo(path, 1)
    assert np.array_equal(found[:, :, 0], np.rint(values / 257).astype(np.uint8))
    assert np.array_equal(found[:, :, 1], found[:, :, 2])


def test_sixteen_bits_of_each_colour_become_eight(tmp_path):
    path = tmp_path / "deep.png"
    pixels = np.array([[[0x1234, 0xABCD, 0xFFFF]] * 2], ">u2")
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", 2, 1, 16, 2, 0, 0, 0))]
    chunks += [(b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    ]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    assert load_photo(path, 1)[0, 0].tolist() == [0x12, 0xAB, 0xFF]


def test_numbers_of_32_bits_are_refused(tmp_path):
    path = save(tmp_path / "deep.tif", Image.fromarray(np.full((4, 4), 0.5, np.float32)))
    with pytest.raises(SceneError, match="pixels: found mode F, expected 8 or 16 bits a channel"):
        read_header(path)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_photos_of_200_megapixels_are_opened_and_larger_ones_refused(tmp_path):
    Image.new("1", (16_384, 12_288)).save(tmp_path / "large.png")
    assert read_header(tmp_path / "large.png").size == (16_384, 12_288)
    Image.new("1", (18_000, 16_000)).save(tmp_path / "larger.png")
    with pytest.raises(SceneError, match="18000x16000 pixels, expected at most 268,435,456"):
        read_header(tmp_path / "larger.png")


@pytest.mark.parametrize("kind", ["webp", "tif", "TIFF", "avif"])
def test_other_formats_are_photos_by_their_ending(tmp_path, rng, kind):
    if kind == "avif" and not AVIF:
        pytest.skip("Pillow without AVIF")
    smooth = Image.fromarray(rng.integers(0, 256, (4, 4, 3)).astype(np.uint8)).resize((32, 24))
    path = tmp_path / f"a.{kind}"
    smooth.save(path, "TIFF" if kind.lower().startswith("tif") else kind.upper(), quality=95)
    assert is_photo(path)
    assert np.abs(load_photo(path, 1).astype(int) - np.asarray(smooth)).mean() < 4


@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_pixels_cut_off_are_refused_when_they_are_needed(tmp_path, rng, kind):
    pixels = rng.integers(0, 256, (64, 64, 3)).astype(np.uint8)
    path = save(tmp_path / f"cut.{kind}", Image.fromarray(pixels))
    whole = path.read_bytes()
    for part in (0.2, 0.5, 0.9):
        path.write_bytes(whole[: int(part * len(whole))])
        try:
            assert read_header(path).size == (64, 64)
        except SceneError:
            continue
        with pytest.raises(SceneError, match=rf"cut\.{kind}: pixels: found .*expected a whole im"):
            load_photo(path, 4)


def test_changed_bytes_in_a_photo_never_crash(tmp_path, rng):
    pixels = rng.integers(0, 256, (20, 20, 3)).astype(np.uint8)
    path = save(tmp_path / "bits.png", Image.fromarray(pixels))
    whole = path.read_bytes()
    refused = 0
    for _ in range(150):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            read_header(path)
            load_photo(path, 1)
        except SceneError:
            refused += 1
    # PNG has checksums: nearly every change is noticed.
    assert refused > 100


def test_the_cache_gives_the_same_array_and_forgets_the_least_used(tmp_path):
    paths = [save(tmp_path / f"{i}.png", Image.new("RGB", (10, 10))) for i in range(3)]
    cache = PhotoCache(budget=2 * 300)
    first, second = cache.get(paths[0], 1), cache.get(paths[1], 1)
    assert cache.get(paths[0], 1) is first
    cache.get(paths[2], 1)
    assert cache.held == 600
    assert cache.get(paths[0], 1) is first
    assert cache.get(paths[1], 1) is not second
    beside = cache.get(paths[2], 2, (0.25, 0.25))
    assert cache.get(paths[2], 2, (0.25, 0.25)) is beside is not cache.get(paths[2], 2)


def test_a_photo_larger_than_the_budget_is_kept_alone(tmp_path):
    path = save(tmp_path / "large.png", Image.new("RGB", (10, 10)))
    cache = PhotoCache(budget=10)
    assert cache.get(path, 1) is cache.get(path, 1)
    assert cache.get(path, 2) is cache.get(path, 2)
    assert cache.held == 75
