"""What scenes say of themselves, honest ones and others."""

import base64
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.container import encode
from gsynopsis.serve import gallery as gallery_module
from gsynopsis.serve.files import Root
from gsynopsis.serve.gallery import Card, Catalogue, gallery
from tests.level_sets import make_level_set


def small_picture() -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (12, 8), (200, 30, 60)).save(buffer, "WEBP", quality=40)
    return buffer.getvalue()


WEBP = small_picture()


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
    data = scene(WEBP)
    (tmp_path / "fox.gsyn").write_bytes(data)
    card = looked(tmp_path)["fox.gsyn"]
    assert card.levels[-1] == (len(data), 20.0 + len(card.levels) - 1)
    assert sorted(size for size, _ in card.levels) == [size for size, _ in card.levels]
    text = page([card])
    assert f'src="data:image/webp;base64,{coded(WEBP)}"' in text
    for word in ("<b>fox</b>", "L0", f"{len(data) / 2**20:.2f} MiB", "20.00 dB"):
        assert word in text


def test_what_was_not_measured_is_not_shown(tmp_path: Path) -> None:
    (tmp_path / "a.gsyn").write_bytes(scene(psnr=False))
    text = page([looked(tmp_path)["a.gsyn"]])
    assert "dB" not in text and '<span class="picture"></span>' in text and "L0" in text


@pytest.mark.parametrize(
    "poster", [b"<svg onload=alert(1)>", b"\xff\xd8\xff" + bytes(99), WEBP + b"x"]
)
def test_a_poster_that_is_no_small_webp_is_not_shown(tmp_path: Path, poster: bytes) -> None:
    (tmp_path / "a.gsyn").write_bytes(scene(poster))
    card = looked(tmp_path)["a.gsyn"]
    assert card.levels and not card.poster
    assert coded(poster) not in page([card])


def test_files_that_are_no_scenes_spoil_nothing(tmp_path: Path) -> None:
    good = scene(WEBP)
    contents = {
        "empty": b"",
        "noise": bytes(range(256)) * 100,
        "longer": good + b"x",
        "head": good[:40],
        "manifest": good[:600] + bytes(500) + good[1100:],
        "good": good,
    }
    for name, data in contents.items():
        (tmp_path / f"{name}.gsyn").write_bytes(data)
    cards = looked(tmp_path)
    assert [name for name, card in sorted(cards.items()) if card.levels] == ["good.gsyn"]
    assert page(list(cards.values())).count("not a readable scene") == len(contents) - 1


def test_a_file_that_was_cut_off_shows_the_levels_that_it_holds(tmp_path: Path) -> None:
    data = scene()
    (tmp_path / "whole.gsyn").write_bytes(data)
    (tmp_path / "cut.gsyn").write_bytes(data[:-1])
    cards = looked(tmp_path)
    assert cards["cut.gsyn"].levels == cards["whole.gsyn"].levels[:-1] != ()


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
        gallery_module, "card_of", lambda card, path: (read.append(card.name), real(card, path))[1]
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
