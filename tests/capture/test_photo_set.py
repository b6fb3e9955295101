"""Photos as people have them: turned, twice, damaged, with blanks in their names."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.capture.photo_set import gather, prepare
from gsynopsis.errors import SceneError
from gsynopsis.scene.stored import ORIENTATION


def save(path: Path, seed: int, turn: int = 1, size: tuple[int, int] = (16, 8)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    image = Image.fromarray(rng.integers(0, 256, (size[1], size[0], 3)).astype(np.uint8))
    exif = Image.Exif()
    exif[ORIENTATION] = turn
    image.save(path, exif=exif)
    return path


def test_photos_of_subfolders_count_and_masks_and_hidden_files_do_not(tmp_path: Path) -> None:
    for number, name in enumerate(("a/1.png", "b/1.png", "c.jpg", "masks/c.png", ".x.png")):
        save(tmp_path / name, number)
    assert [photo.name for photo in gather(tmp_path).photos] == ["a/1.png", "b/1.png", "c.jpg"]


def test_damaged_photos_and_copies_are_left_out_and_named(tmp_path: Path) -> None:
    for number in range(4):
        save(tmp_path / f"{number}.png", number)
    (tmp_path / "copy.png").write_bytes((tmp_path / "0.png").read_bytes())
    (tmp_path / "2.png").write_bytes((tmp_path / "2.png").read_bytes()[:120])
    gathered = gather(tmp_path)
    assert [photo.name for photo in gathered.photos] == ["0.png", "1.png", "3.png"]
    assert gathered.notes == (
        "1 photos left out, cannot be read: 2.png",
        "1 photos left out, copies of others: copy.png",
    )


def test_endings_of_any_case_are_photos_and_what_is_not_looked_at_is_counted(
    tmp_path: Path,
) -> None:
    for number, name in enumerate(("a.Jpg", "b.pNG", "c.jpeg")):
        save(tmp_path / name.lower(), number).rename(tmp_path / name)
    for name in ("d.HEIC", "e.heic", "sub/f.jxl", "cameras.xml", "way.MOV"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    gathered = gather(tmp_path)
    assert [photo.name for photo in gathered.photos] == ["a.Jpg", "b.pNG", "c.jpeg"]
    assert gathered.account.unread == {".heic": 2, ".jxl": 1, ".mov": 1}
    (tmp_path / "b.pNG").unlink()
    with pytest.raises(SceneError, match=r"2 photos of use \(not looked at: 2 \.heic, 1 \.jxl"):
        gather(tmp_path)


def test_fewer_than_three_photos_are_refused_with_advice(tmp_path: Path) -> None:
    save(tmp_path / "a.png", 0)
    (tmp_path / "b.jpg").write_text("no photo")
    with pytest.raises(SceneError, match=r"found 1 photos of use .*b\.jpg.*at least 3; take 20"):
        gather(tmp_path)
    with pytest.raises(SceneError, match="no such folder, expected a folder of photos, or a video"):
        gather(tmp_path / "nowhere")


def test_a_turned_photo_is_prepared_upright_and_others_are_the_same_bytes(tmp_path: Path) -> None:
    source, out = tmp_path / "photos", tmp_path / "out"
    paths = [save(source / f"{turn} of 8.png", turn, turn) for turn in range(1, 9)]
    gathered = gather(source)
    prepare(gathered, out)
    assert gathered.photos[0].name == "1_of_8.png"
    assert (out / "1_of_8.png").read_bytes() == paths[0].read_bytes()
    for photo in gathered.photos:
        with Image.open(out / photo.name) as image:
            assert image.size == photo.size
            assert image.getexif().get(ORIENTATION, 1) == 1
    pixels = np.asarray(Image.open(paths[5]))  # 6: the right way round after a quarter turn
    assert np.array_equal(np.asarray(Image.open(out / "6_of_8.png")), np.rot90(pixels, -1))


def test_the_digest_is_that_of_the_pixels_and_not_of_the_place(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        for number in range(3):
            save(tmp_path / folder / f"{number}.png", number)
    one, two = gather(tmp_path / "one"), gather(tmp_path / "two")
    assert one.digest == two.digest
    save(tmp_path / "two" / "1.png", 99)
    assert gather(tmp_path / "two").digest != one.digest


def smooth(seed: int) -> Image.Image:
    rng = np.random.default_rng(seed)
    cells = Image.fromarray(rng.integers(0, 256, (4, 6, 3)).astype(np.uint8))
    return cells.resize((48, 32), Image.Resampling.BICUBIC)


@pytest.mark.parametrize("kind", ["WEBP", "TIFF", "grey of 16 bits"])
def test_what_colmap_may_not_read_is_prepared_as_png(kind: str, tmp_path: Path) -> None:
    source, end = tmp_path / "in", {"WEBP": "webp", "TIFF": "tif"}.get(kind, "png")
    source.mkdir()
    for number in range(3):
        image = smooth(number)
        if kind == "grey of 16 bits":
            image = Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257)
        options = {"lossless": True} if kind == "WEBP" else {}
        image.save(source / f"{number}.{end}", **options)
    prepare(gather(source), tmp_path / "out")
    name = "0.png" if end == "png" else f"0.{end}.png"
    with Image.open(tmp_path / "out" / name) as found:
        assert found.format == "PNG" and found.mode in ("L", "RGB")
        wanted = smooth(0).convert(found.mode)
        assert np.abs(np.asarray(found).astype(int) - np.asarray(wanted)).max() <= 1


def test_a_turned_mpo_keeps_its_quality(tmp_path: Path) -> None:
    source, exif = tmp_path / "in", Image.Exif()
    source.mkdir()
    exif[ORIENTATION] = 6
    for number in range(3):
        picture = smooth(number)
        more = {"append_images": [smooth(9)], "save_all": True}
        picture.save(source / f"{number}.jpg", "MPO", exif=exif, quality=97, **more)
    with Image.open(source / "0.jpg") as image:
        assert image.format == "MPO"
        before = np.asarray(image.convert("RGB")).astype(int)
    prepare(gather(source), tmp_path / "out")
    with Image.open(tmp_path / "out" / "0.jpg") as image:
        assert image.format == "JPEG" and image.size == (32, 48)
        assert np.abs(np.asarray(image).astype(int) - np.rot90(before, -1)).mean() < 1.5
