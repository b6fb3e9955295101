"""The scenes of a root: what each says of itself, as a page and as a list."""

import html
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from email.utils import formatdate
from pathlib import Path

from starlette.responses import FileResponse

from gsynopsis.container.assembler import Assembler
from gsynopsis.container.layout import INDEX_BYTES_MAX, MANIFEST_BYTES_MAX, Kind
from gsynopsis.container.notes.poster import parse_poster
from gsynopsis.errors import GsynopsisError
from gsynopsis.records import POSTER_NOTE
from gsynopsis.serve.assets import Asset, asset_of, plain_policy
from gsynopsis.serve.files import Root, address_of, shown_name

LOOK_SECONDS = 1.0
"""Between two looks at the folder, at least."""
LOOK_SHARE = 0.05
"""Largest share of the time that goes into listing a large folder."""
SCENES_MAX = 500
"""On the page and in the list; the page says if there are more."""
STYLE = """
:root { color-scheme: light dark; font: 16px/1.4 system-ui, sans-serif; }
body { margin: 2rem auto; padding: 0 1rem; max-width: 72rem; }
ul { list-style: none; padding: 0; display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); }
li { border: 1px solid #8886; border-radius: 8px; overflow: hidden; }
li a { display: block; color: inherit; text-decoration: none; }
li a:hover b, li a:focus-visible b { text-decoration: underline; }
.picture { display: block; width: 100%; aspect-ratio: 3 / 2; object-fit: cover; background:
  radial-gradient(circle at 35% 45%, #8a94a8 0 12%, transparent 13%),
  radial-gradient(circle at 62% 58%, #6b7a96 0 18%, transparent 19%), #c3cad6; }
b { display: block; padding: .6rem .8rem 0; overflow-wrap: anywhere; }
p, table { margin: .2rem .8rem .8rem; font-size: .85rem; }
td { padding-right: 1rem; text-align: right; font-variant-numeric: tabular-nums; }
"""


@dataclass(frozen=True)
class Card:
    """Facts of a scene, from its own manifest.

    Attributes:
        name: Below the root, as the system has it.
        size: Bytes.
        modified: Seconds since the epoch.
        tag: ETag of the file.
        levels: Bytes that a client holds at each level, and PSNR, dB, None where not measured;
            empty if the file cannot be read.
        poster: A picture as a `data:` address, empty if there is none.
    """

    name: str
    size: int
    modified: float
    tag: str
    levels: tuple[tuple[int, float | None], ...] = ()
    poster: str = ""


def blank_card(name: str, path: Path) -> Card:
    """A card with what the file system says alone.

    Raises:
        OSError: there is no such file.
    """
    state = path.stat()
    tag = FileResponse(path, stat_result=state).headers["etag"]
    return Card(name, state.st_size, state.st_mtime, tag)


def card_of(card: Card, path: Path) -> Card:
    """The card with a scene's index and manifest, never more than 150 KiB of it."""
    try:
        with path.open("rb") as file:
            assembler = Assembler(file.read(INDEX_BYTES_MAX), card.name)
            index = assembler.index
            first = index.chunks[0]
            if first.kind == Kind.MANIFEST and first.stored <= 2 * MANIFEST_BYTES_MAX:
                file.seek(first.offset)
                assembler.add(first, file.read(first.stored))
    except (GsynopsisError, ValueError, OSError):
        return card
    figures = assembler.quality or [{} for _ in index.levels]
    # A file that was cut off somewhere is shown as far as it holds whole levels.
    levels = tuple(
        (level.end, known.get("psnr_full"))
        for level, known in zip(index.levels, figures, strict=False)
        if level.end <= card.size <= index.levels[-1].end
    )
    text = assembler.meta.get(POSTER_NOTE, "")
    poster = "" if parse_poster(text) is None else f"data:image/webp;base64,{text}"
    return replace(card, levels=levels, poster=poster)


class Catalogue:
    """The cards of a root; looks again when it is asked, but not too often. For one thread."""

    def __init__(self, root: Root, clock: Callable[[], float] = time.monotonic) -> None:
        """Nothing is looked at yet."""
        self._root, self._clock = root, clock
        self._cards: dict[str, Card] = {}
        self._count = 0
        self._due = -1.0

    def look(self) -> tuple[list[Card], int]:
        """The cards by name, and how many scenes there are; blocks."""
        begun = self._clock()
        if begun >= self._due:
            names = self._root.names()
            cards = [self._card(name) for name in names[:SCENES_MAX]]
            self._cards = {card.name: card for card in cards if card is not None}
            self._count = len(names)
            ended = self._clock()
            self._due = ended + max(LOOK_SECONDS, (ended - begun) / LOOK_SHARE)
        return list(self._cards.values()), self._count

    def _card(self, name: str) -> Card | None:
        path, known = self._root.find(name), self._cards.get(name)
        if path is None:
            return None
        try:
            card = blank_card(name, path)
        except OSError:  # it has just been removed
            return None
        return known if known is not None and known.tag == card.tag else card_of(card, path)


def listing(cards: Sequence[Card]) -> dict[str, object]:
    """List of the scenes for a page; addresses are relative to the root."""
    return {
        "files": [
            {
                "name": shown_name(card.name),
                "bytes": card.size,
                "modified": formatdate(card.modified, usegmt=True),
                "etag": card.tag,
                "url": address_of(card.name),
            }
            for card in cards
        ]
    }


def gallery(cards: Sequence[Card], count: int, *, viewer: bool, frames: str) -> Asset:
    """The page of all scenes.

    Args:
        cards: Of the scenes that are shown.
        count: How many scenes there are.
        viewer: There is a viewer to show them; else links lead to the files.
        frames: Who may show the page in a frame.
    """
    rows = "\n".join(_item(card, viewer) for card in cards)
    more = f"<p>The first {len(cards)} of {count} scenes.</p>" if count > len(cards) else ""
    none = "" if cards else "<p>There is no .gsyn file here yet.</p>"
    page = (
        '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>gsynopsis: scenes</title>\n<link rel="icon" href="data:,">\n<style>{STYLE}</style>'
        f"\n<h1>Scenes</h1>\n<ul>\n{rows}\n</ul>\n{more}{none}"
        '<p>As JSON: <a href="listing.json">listing.json</a></p>\n'
    )
    return asset_of(page.encode(), ".html", f"{plain_policy(page)}; frame-ancestors {frames}")


def _item(card: Card, viewer: bool) -> str:
    address = address_of(card.name)
    # The page takes its parameter for an address, so the name is quoted twice.
    link = f"?content={address_of(address)}" if viewer else address
    picture = f'<img class="picture" alt="" src="{card.poster}">'
    if not card.poster:
        picture = '<span class="picture"></span>'
    rows = "".join(_row(level, *known) for level, known in enumerate(card.levels))
    about = f"<table>{rows}</table>" if rows else f"<p>{_mib(card.size)}, not a readable scene</p>"
    name = html.escape(shown_name(card.name).removesuffix(".gsyn"))
    return f'<li><a href="{html.escape(link)}">{picture}<b>{name}</b></a>{about}</li>'


def _row(level: int, size: int, psnr: float | None) -> str:
    quality = "" if psnr is None else f"{psnr:.2f} dB"
    return f"<tr><td>L{level}<td>{_mib(size)}<td>{quality}</tr>"


def _mib(size: int) -> str:
    return f"{size / 2**20:.2f} MiB"
