"""A .gsyn file that is open: its levels, Gaussians of any of them as plain arrays, and pictures.

Bytes are read as levels are asked for: what a slow server has to send is one level's prefix.
"""

import html
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.cameras.orbit import (
    circle_of_levels,
    default_lens,
    first_camera,
    orbit,
    sized,
)
from gsynopsis.container import Assembler
from gsynopsis.container.index import check_length
from gsynopsis.container.layout import INDEX_BYTES_MAX
from gsynopsis.container.reader import open_gsyn
from gsynopsis.container.writer import publish
from gsynopsis.errors import InputError, MissingExtraError, SourceError
from gsynopsis.evaluation.formatting import size
from gsynopsis.records import LevelSet
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.page import single_page
from gsynopsis.stream.download import is_address
from gsynopsis.stream.local import FileSource
from gsynopsis.stream.source import ByteSource

if TYPE_CHECKING:
    from gsynopsis.model.splats import FileModel
    from gsynopsis.render.choose import RendererName

Float32 = NDArray[np.float32]
EMBEDDED = 8 * 2**20
"""Bytes of a file that a notebook is given for its viewer: notebooks keep their outputs."""
FRAME = "width:100%;height:420px;border:0"


@dataclass(frozen=True)
class Splats:
    """Anisotropic Gaussians as a camera sees them, after all activations.

    Attributes:
        means: World units, float32 [G, 3].
        scales: Standard deviations, world units, > 0, float32 [G, 3].
        quaternions: Unit, w x y z, float32 [G, 4].
        opacities: In [0, 1], float32 [G].
        colours: sRGB, usually in [0, 1], float32 [G, 3].

    Examples:
        >>> with gs.open("runs/room") as file:
        ...     splats = file.gaussians(level=0)
        >>> splats.means.shape == (len(splats), 3), splats.opacities.dtype
        (True, dtype('float32'))
    """

    means: Float32  # [G, 3]
    scales: Float32  # [G, 3]
    quaternions: Float32  # [G, 4]
    opacities: Float32  # [G]
    colours: Float32  # [G, 3]

    def __len__(self) -> int:
        return len(self.means)

    def __repr__(self) -> str:
        """The number; arrays of Gaussians fill pages."""
        names = "means, scales, quaternions, opacities, colours"
        return f"Splats({len(self):,} Gaussians: {names})"


@dataclass(frozen=True)
class LevelFacts:
    """One level of a file.

    Attributes:
        level: 0 is the coarsest.
        anchors: Anchors.
        slots: Live slots: Gaussians before any are hidden by their opacity.
        bytes: Length of the prefix that holds it.
        delta: Bytes that it adds to the level before.
        quality: Measured figures that the file states, by name: `psnr_full` in dB, and others.
    """

    level: int
    anchors: int
    slots: int
    bytes: int
    delta: int
    quality: Mapping[str, float]


class File:
    """A .gsyn file, on a disk or a server. Use it in a `with` block, or close it.

    Attributes:
        name: Path or address.
        levels: Facts about every level, coarsest first.
        meta: The writer's notes by name.

    Examples:
        >>> with gs.open("runs/room") as file:
        ...     coarse = file.render(level=0)
        ...     small = file.render(camera=file.first_camera(width=48))
        ...     levels = [level.bytes for level in file.levels]
        >>> coarse.size, small.size
        ((960, 640), (48, 32))
        >>> len(levels), levels == sorted(levels)
        (4, True)
    """

    def __init__(self, source: ByteSource) -> None:
        """Reads index and manifest.

        Raises:
            FormatError: they break a promise of docs/format.md.
            SourceError: the bytes cannot be had.
        """
        self.name = source.name
        self._source = source
        self._data = b""
        self._fetch(INDEX_BYTES_MAX)
        self._assembler = Assembler(self._data, self.name)
        self._models: dict[int, FileModel] = {}
        held = len(self._assembler.index.levels)
        if source.size is not None:
            held = check_length(self._assembler.index, source.size, self.name)
        self._held = held
        self._read_level(0)
        self.meta: Mapping[str, str] = dict(self._assembler.meta)
        self.levels = tuple(self._facts(number) for number in range(held))

    def __enter__(self) -> "File":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the connection back; a second time nothing happens."""
        self._source.close()

    @property
    def bytes_read(self) -> int:
        """Bytes read so far; each is read once."""
        return len(self._data)

    def level_set(self, level: int = -1) -> LevelSet:
        """The decoded arrays up to a level.

        Args:
            level: 0 is the coarsest, -1 the finest.

        Raises:
            InputError: there is no such level.
            FormatError: the file is damaged.
        """
        number = self._number(level)
        self._read_level(number)
        if self._assembler.levels_ready == number + 1:
            return self._assembler.level_set()
        # A finer level was decoded before: what it knows of coarser ones is put together anew.
        assembler = Assembler(self._data, self.name)
        for _ in range(number + 1):
            assembler.add_level(self._data)
        return assembler.level_set()

    def gaussians(self, level: int = -1, camera: Camera | None = None) -> Splats:
        """The Gaussians of a level as a camera sees them.

        Args:
            level: 0 is the coarsest, -1 the finest.
            camera: Colours and shapes depend on it, and only what it may see is there; the first
                view if None.

        Raises:
            InputError: there is no such level.
            MissingExtraError: PyTorch is not installed.
        """
        import torch

        model = self._model(level, "cpu")
        with torch.no_grad():
            g = model.decode(camera or self.first_camera())
            quats = torch.nn.functional.normalize(g.quats, dim=1)
        arrays = (g.means, g.scales, quats, g.opacities, g.colors)
        return Splats(*(t.detach().cpu().numpy().astype(np.float32) for t in arrays))

    def render(
        self, level: int = -1, camera: Camera | None = None, *, renderer: "RendererName" = "auto"
    ) -> Image.Image:
        """A picture of a level, sRGB; notebooks display it.

        Args:
            level: 0 is the coarsest, -1 the finest.
            camera: From where; the first view if None.
            renderer: `auto`, `cpu`, `reference`, `cuda` or `webgpu`.

        Raises:
            InputError: there is no such level.
            MissingExtraError: PyTorch, or the renderer, is not installed.
        """
        import torch

        from gsynopsis.evaluation.protocols import LevelRenderer
        from gsynopsis.render.choose import make_renderer

        chosen = make_renderer(renderer, budgeted=True)
        model = self._model(level, str(chosen.device))
        painter = LevelRenderer(model, chosen)
        with torch.no_grad():
            return Image.fromarray(painter.paint(camera or self.first_camera(), -1))

    def first_camera(self, width: int | None = None, height: int | None = None) -> Camera:
        """The first view: that of a photo, else one of the orbit.

        Args:
            width: Of the picture, pixels; with `height` None the shape is kept.
            height: Likewise.
        """
        camera = first_camera(self.meta) or self.orbit(1)[0]
        return sized(camera, width, height)

    def orbit(self, count: int, *, all_round: bool = False) -> list[Camera]:
        """Cameras on a round of the circle from which the photos were taken.

        Args:
            count: How many.
            all_round: All the way round, also where no photo was taken.
        """
        circle = circle_of_levels(self.level_set(0))
        circle = replace(circle, arc=None) if all_round else circle
        return orbit(circle, default_lens(), count)

    def cut(self, out: Path | str, level: int) -> Path:
        """Write the prefix that ends with a level: a file of fewer levels.

        Raises:
            InputError: there is no such level, or the path cannot be written.
            SpaceError: the disk has no room.
        """
        number = self._number(level)
        self._read_level(number)
        publish(self._data[: self._assembler.index.levels[number].end], Path(out))
        return Path(out)

    def __repr__(self) -> str:
        last = self.levels[-1]
        held = f"{len(self.levels)} levels, {last.slots:,} slots, {size(last.bytes)}"
        return f"File({self.name}: {held})"

    def _repr_html_(self) -> str:
        """The viewer and the table of levels, for notebooks.

        The viewer holds the finest level that fits `EMBEDDED`; it needs no server.
        """
        rows = "".join(
            f"<tr><td>L{f.level}</td><td>{f.anchors:,}</td><td>{f.slots:,}</td>"
            f"<td>{f.bytes:,}</td><td>{_decibels(f.quality)}</td></tr>"
            for f in self.levels
        )
        heads = "".join(f"<th>{h}</th>" for h in ("level", "anchors", "slots", "bytes", "dB"))
        return f"{self._viewer()}<table><tr>{heads}</tr>{rows}</table>"

    def _viewer(self) -> str:
        """The viewer's page as a frame; "" where no level fits."""
        fitting = [facts.level for facts in self.levels if facts.bytes <= EMBEDDED]
        if not fitting:
            return ""
        self._read_level(fitting[-1])
        data = self._data[: self.levels[fitting[-1]].bytes]
        page = html.escape(single_page(Path(self.name).name, data))
        left = len(self.levels) - len(fitting)
        note = f"<p>The viewer holds no more than level {fitting[-1]}.</p>" if left else ""
        return f'<iframe srcdoc="{page}" style="{FRAME}" allowfullscreen></iframe>{note}'

    def _number(self, level: int) -> int:
        number = level + self._held if level < 0 else level
        if not 0 <= number < self._held:
            raise InputError(self.name, "level", found=level, expected=f"0 to {self._held - 1}")
        return number

    def _facts(self, number: int) -> LevelFacts:
        index, quality = self._assembler.index, self._assembler.quality
        entry = index.levels[number]
        before = index.levels[number - 1].end if number else 0
        return LevelFacts(
            number, entry.anchors, entry.live, entry.end, entry.end - before, quality[number]
        )

    def _fetch(self, stop: int) -> None:
        if stop > len(self._data):
            pieces = self._source.read(len(self._data), stop)
            self._data = b"".join([self._data, *pieces])

    def _read_level(self, number: int) -> None:
        end = self._assembler.index.levels[number].end
        self._fetch(end)
        if len(self._data) < end:
            found = f"{len(self._data)} bytes"
            raise SourceError(self.name, found=found, expected=f"{end}")
        while self._assembler.levels_ready <= number:
            self._assembler.add_level(self._data)

    def _model(self, level: int, device: str) -> "FileModel":
        """A model whose last part is the level, kept."""
        try:
            from gsynopsis.model.splats import decoder_of
        except ModuleNotFoundError as error:
            raise MissingExtraError(error.name or "torch", "train") from error
        number = self._number(level)
        if number not in self._models:
            self._models[number] = decoder_of(self.level_set(number))
        return self._models[number].to(device)


def _decibels(quality: Mapping[str, float]) -> str:
    psnr = quality.get("psnr_full")
    return "n/a" if psnr is None else f"{psnr:.2f}"


def open_source(source: Path | str) -> File:
    """Open a .gsyn file, or an http address.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file.
        MissingExtraError: httpx is not installed, and it is an address.
        SourceError: the server does not give it.
    """
    if is_address(source):
        try:
            from gsynopsis.stream.http import HttpSource
        except ModuleNotFoundError as error:
            raise MissingExtraError(error.name or "httpx", "stream") from error
        return File(HttpSource(source))
    path = Path(source)
    with open_gsyn(path):  # refuses what is no regular file before anything waits for it
        return File(FileSource(path))
