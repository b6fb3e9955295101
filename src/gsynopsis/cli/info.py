"""`gsynopsis info`: contents of a file."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from gsynopsis.errors import printable
from gsynopsis.evaluation.formatting import size, text_table
from gsynopsis.runs.folder import find_run

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gsynopsis.container import FileInfo, LevelInfo

NOTE_WIDTH = 72
"""Longer notes of a writer are cut when printed; `--json` has them whole."""


@dataclass(frozen=True)
class Info:
    """Say what a .gsyn file holds: per level its anchors, Gaussians, bytes by part, and quality.

    Attributes:
        file: A .gsyn file, or the folder of a run.
        json: Print JSON.
    """

    file: Positional[Path]
    json: bool = False

    def run(self) -> int:
        """Describe and print."""
        from gsynopsis.container import describe

        info = describe(find_run(self.file).file)
        if self.json:
            print(json.dumps(asdict(info), indent=2, allow_nan=False))
        else:
            print(info_text(info))
        return 0


def info_text(info: "FileInfo") -> str:
    """A file in words and two tables: its levels, and the parts of each."""
    held = len(info.levels)
    levels = f"{held} levels" if held == info.levels_total else f"{held} of {info.levels_total}"
    space = "contracted space" if info.contract else "a box"
    lines = [
        f"{printable(info.path)}: .gsyn version {info.version}, {levels}, {size(info.bytes)}",
        f"{info.slots_per_anchor} slots per anchor, voxel {info.voxel:.4g}, {space}, "
        f"index {size(info.index_bytes)}, all before the first level {size(info.head_bytes)}",
        *stand_ins_line(info),
        # What a file says of itself goes through `plain`, names of figures as well.
        *(f"{plain(key)}: {plain(value)}" for key, value in info.meta.items()),
        "",
        levels_table(info.levels),
        "",
        parts_table(info.levels),
    ]
    return "\n".join(lines)


def stand_ins_line(info: "FileInfo") -> list[str]:
    """A word on splats that are counted at finer levels and not drawn there, where there are."""
    if not info.stand_ins:
        return []
    if info.stand_ins >= len(info.levels):
        return [f"all splats are stand-ins, until level {info.stand_ins} comes"]
    last = info.levels[info.stand_ins - 1]
    return [f"{last.anchors:,} splats are stand-ins: level {info.stand_ins} and finer drop them"]


def plain(text: str) -> str:
    """A writer's note as one short line that cannot steer a terminal."""
    line = "".join(c if c.isprintable() else "?" for c in text)
    return line if len(line) <= NOTE_WIDTH else line[: NOTE_WIDTH - 1] + "…"


def levels_table(levels: "Sequence[LevelInfo]") -> str:
    """One row per level, with a column for each quality that the file states."""
    names = list(dict.fromkeys(name for level in levels for name in level.quality))
    header = ["level", "anchors", "slots", "blocks", "grids", "bytes", "delta", *map(plain, names)]
    rows = [
        [
            f"L{level.level}",
            f"{level.anchors:,}",
            f"{level.slots:,}",
            f"{level.blocks:,}",
            str(level.grids),
            f"{level.bytes:,}",
            f"{level.delta:,}",
            *(_figure(level.quality.get(name)) for name in names),
        ]
        for level in levels
    ]
    return text_table(header, rows)


def parts_table(levels: "Sequence[LevelInfo]") -> str:
    """One row per kind of content: the bytes each level adds, and bits per value overall."""
    kinds = list(dict.fromkeys(part.kind for level in levels for part in level.parts))
    header = ["delta bytes", "coding", *(f"L{k.level}" for k in levels), "sum", "bits/value"]
    rows: list[list[str]] = []
    for kind in kinds:
        parts = [next((p for p in level.parts if p.kind == kind), None) for level in levels]
        there = [part for part in parts if part]
        stored, values = sum(p.stored for p in there), sum(p.values for p in there)
        cells = [f"{part.stored:,}" if part else "-" for part in parts]
        coding = "+".join(dict.fromkeys(part.coding for part in there if part.coding)) or "-"
        rows.append([kind, coding, *cells, f"{stored:,}", f"{8 * stored / max(1, values):.2f}"])
    return text_table(header, rows)


def _figure(value: float | None) -> str:
    """A quality: decibels with two decimals, what lies in [0, 1] with four."""
    if value is None:
        return "n/a"
    return f"{value:.2f}" if abs(value) > 1 else f"{value:.4f}"
