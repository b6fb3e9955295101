"""What scenes say of themselves, honest ones and others."""

import base64
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.pack import encode
from gsynopsis.serve import gallery as gallery_module
from gsynopsis.serve.files import Root
from gsynopsis.serve.gallery import POSTER_MAX, Card, Catalogue, gallery, picture_of
from tests.level_sets import make_level_set

JPEG = b"\xff\xd8\xff\xe0" + bytes(100)
WEBP = b"RIFF\x10\0\0\0WEBPVP8 " + bytes(100)


def coded(data: bytes) -> str:
    return base64.b64encode(data).decode()


def scene(poster: bytes | None = None, psnr: bool = True) -> bytes:
    levels = make_level_set(np.random.default_rng(0))
    quality = [{"psnr_full": 20.0 + number} if psnr else {} for number in range(len(levels.levels))]
    measured = [replace(v, quality=q) for v, q in zip(levels.levels, quality, strict=True)]
    meta = dict(levels.meta) | ({"poster": coded(poster)} if poster else {})
    return encode(replace(levels, levels=tuple(measured), meta=meta), "compact")


def looked(folder: Path) -> dict[str, Card]:
    return {card.name: card for card in Catalogue(Root(folder.resolve())).look()[0]}


def page(cards: list[Card]) -> str:
    return gallery(cards, len(cards), viewer=True, frames="'self'").data.decode()


def test_a_card_has_picture_name_sizes_and_quality(tmp_path: Path) -> None:
    data = scene(JPEG)
    (tmp_path / "fox.gsyn").write_bytes(data)
    card = looked(tmp_path)["fox.gsyn"]
    assert card.levels[-1] == (len(data), 20.0 + len(card.levels) - 1)
    assert sorted(size for size, _ in card.levels) == [size for size, _ in card.levels]
    text = page([card])
    assert f'src="data:image/jpeg;base64,{coded(JPEG)}"' in text
    for word in ("<b>fox</b>", "L0", f"{len(data) / 2**20:.2f} MiB", "20.00 dB"):
        assert word in text


def test_what_was_not_measured_is_not_shown(tmp_path: Path) -> None:
    (tmp_path / "a.gsyn").write_bytes(scene(psnr=False))
    text = page([looked(tmp_path)["a.gsyn"]])
    assert "dB" not in text and '<span class="picture"></span>' in text and "L0" in text


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (coded(JPEG), "image/jpeg"),
        (coded(WEBP), "image/webp"),
        (coded(b"\xff\xd8\xff" + bytes(POSTER_MAX - 3)), "image/jpeg"),
        (coded(b"\xff\xd8\xff" + bytes(POSTER_MAX - 2)), ""),
        (coded(b"<svg onload=alert(1)>"), ""),
        (coded(b"RIFF\x10\0\0\0WAVE" + bytes(9)), ""),
        (coded(JPEG) + '"><script>', ""),
        ("no base64 §", ""),
        ("", ""),
    ],
)
def test_a_poster_is_a_small_picture_or_nothing(text: str, shown: str) -> None:
    found = picture_of(text)
    assert found == (f"data:{shown};base64,{text}" if shown else "")


def test_files_that_are_no_scenes_spoil_nothing(tmp_path: Path) -> None:
    good = scene(JPEG)
    contents = {
        "empty": b"",
        "noise": bytes(range(256)) * 100,
        "cut": good[:-1],
        "head": good[:40],
        "manifest": good[:600] + bytes(500) + good[1100:],
        "good": good,
    }
    for name, data in contents.items():
        (tmp_path / f"{name}.gsyn").write_bytes(data)
    cards = looked(tmp_path)
    assert [name for name, card in sorted(cards.items()) if card.levels] == ["good.gsyn"]
    assert page(list(cards.values())).count("not a readable scene") == len(contents) - 1


def test_names_are_text_and_links_lead_to_the_file(tmp_path: Path) -> None:
    name = "<img src=x onerror=alert(1)> & \"#?%'.gsyn"
    text = page([Card(name, 5, 0.0, '"t"')])
    assert "<img src=x" not in text and "&lt;img src=x onerror=alert(1)&gt; &amp;" in text
    # Twice, since the page takes its parameter for an address.
    assert "%2523%253F%2525" in text


def test_a_large_folder_is_looked_at_less_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, looks = [0.0], []

    def names(root: Root) -> list[str]:
        looks.append(now[0])
        now[0] += 3.0
        return []

    monkeypatch.setattr(Root, "names", names)
    catalogue = Catalogue(Root(tmp_path.resolve()), lambda: now[0])
    for _ in range(200):
        catalogue.look()
        now[0] += 1.0
    assert 3.0 * len(looks) <= 0.06 * now[0]


def test_the_folder_is_looked_at_once_a_second_and_a_scene_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    real = gallery_module.card_of
    monkeypatch.setattr(
        gallery_module, "card_of", lambda name, file: (read.append(name), real(name, file))[1]
    )
    now = [0.0]
    catalogue = Catalogue(Root(tmp_path.resolve()), lambda: now[0])
    assert catalogue.look() == ([], 0)
    (tmp_path / "a.gsyn").write_bytes(scene())
    assert catalogue.look() == ([], 0)
    now[0] = 1.5
    assert len(catalogue.look()[0]) == 1
    now[0] = 3.0
    (tmp_path / "b.gsyn").write_bytes(b"")
    assert len(catalogue.look()[0]) == 2
    assert read == ["a.gsyn", "b.gsyn"]


def test_a_page_of_very_many_scenes_says_that_there_are_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery_module, "SCENES_MAX", 3)
    for number in range(5):
        (tmp_path / f"{number}.gsyn").write_bytes(b"")
    cards, count = Catalogue(Root(tmp_path.resolve())).look()
    assert (len(cards), count) == (3, 5)
    asset = gallery(cards, count, viewer=True, frames="'self'")
    assert b"The first 3 of 5 scenes." in asset.data
