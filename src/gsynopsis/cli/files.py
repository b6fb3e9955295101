"""`gsynopsis check` and `cut`: what one does with a packed file."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gsynopsis.cli.defaults import said
from gsynopsis.errors import InputError, SettingError, printable
from gsynopsis.evaluation.formatting import size
from gsynopsis.runs.folder import find_run


@dataclass(frozen=True)
class Check:
    """Check everything that docs/format.md promises of a .gsyn file; exit code 2 if it breaks one.

    Attributes:
        file: A .gsyn file, or the folder of a run.
        json: Print JSON.
    """

    file: Positional[Path]
    json: bool = False

    def run(self) -> int:
        """Decode every byte and print the contents."""
        from gsynopsis.container import check_file

        path = find_run(self.file).file
        levels = check_file(path)
        counts = [{"anchors": v.anchors, "slots": v.live} for v in levels.levels]
        if self.json:
            print(json.dumps({"path": str(path), "valid": True, "levels": counts}, indent=2))
            return 0
        last = levels.levels[-1]
        print(
            f"{printable(str(path))}: valid, {len(counts)} levels, {last.anchors:,} anchors, "
            f"{last.live:,} slots, {size(path.stat().st_size)}"
        )
        return 0


@dataclass(frozen=True)
class CutCommand:
    """Write a shorter file that ends with a level, or a piece for each level.

    Attributes:
        file: A .gsyn file, or the folder of a run.
        level: The last level wanted, 0 is the coarsest.
        all: Write one file per level instead, for hosts that do not serve byte ranges.
        out: The new file, NAME.L<level>.gsyn beside the file if not given; with --all the folder of
            the pieces.
        overwrite: Replace a file that is there.
    """

    file: Positional[Path]
    level: Annotated[int | None, said("none")] = None
    all: bool = False
    out: Annotated[Path | None, said("beside the file")] = None
    overwrite: bool = False

    def run(self) -> int:
        """Check, write the beginning, or all pieces."""
        if self.all == (self.level is not None):
            found = "both" if self.all else "neither"
            raise SettingError("--level or --all", found=found, expected="one of them")
        path = find_run(self.file).file
        if self.level is None:
            self._write_pieces(path)
        else:
            self._write_prefix(path, self.level)
        return 0

    def _write_prefix(self, path: Path, level: int) -> None:
        from gsynopsis.container import cut_file

        out = self.out or path.with_name(f"{path.stem}.L{level}.gsyn")
        if out.exists() and not self.overwrite:
            advice = "choose another --out, or --overwrite"
            raise InputError(out, found="a file", expected="nothing", advice=advice)
        length = cut_file(path, level, out)
        print(f"wrote {printable(str(out))} ({size(length)})")

    def _write_pieces(self, path: Path) -> None:
        from gsynopsis.container import split_file
        from gsynopsis.runs.folder import make_folder

        folder = self.out or path.parent
        make_folder(folder)
        for piece in split_file(path, folder):
            print(f"wrote {printable(str(piece.path))} ({size(piece.stop - piece.start)})")
