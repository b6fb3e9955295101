"""Shared parts of benchmarks: paths, marked parts of pages, rows of CSV, facts, trainings.

Benchmarks run as modules from the repository's root: `python -m benchmarks.size.pack`.
"""

import csv
import json
from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import torch

from gsynopsis.evaluation.environment import Machine, this_build, this_machine
from gsynopsis.jobs import train as training
from gsynopsis.runs.folder import Run
from gsynopsis.scene.load import load_scene
from gsynopsis.training.observer import Observer, Silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parent.parent
"""The repository."""
DATA = ROOT.parent / "shared" / "data"
"""Scenes as folders of their names, and recorded lines in `traces`: not part of the repository."""
TRACES = DATA / "traces"
RESULTS = ROOT / "docs" / "results"
RUNS = ROOT / "runs"
END = "<!-- end -->"
CPU = torch.device("cpu")
Row = dict[str, Any]


def put(page: Path, script: str, text: str, part: str = "") -> None:
    """Replace what stands between a script's marks, `<!-- begin: benchmarks/… -->` and `END`.

    Args:
        page: A Markdown page that holds the marks.
        script: The script's `__file__`.
        text: Markdown; blank lines around it are ours.
        part: Name behind the script's, where a page has several parts of one script.
    """
    name = Path(script).resolve().relative_to(ROOT).as_posix()
    begin = f"<!-- begin: {name} {part} -->" if part else f"<!-- begin: {name} -->"
    old = page.read_text("utf-8")
    before, rest = old.split(begin, 1)
    after = rest.split(END, 1)[1]
    page.write_text(f"{before}{begin}\n\n{text.rstrip()}\n\n{END}{after}", "utf-8")


def stored_rows(path: Path, text: Collection[str]) -> list[Row]:
    """The rows of a CSV as they were written: numbers, but for the columns of text."""
    with path.open(newline="", encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    return [{n: v if n in text else _number(v) for n, v in row.items()} for row in rows]


def _number(text: str) -> int | float | str:
    if not text:
        return text  # a column that was not measured yet
    try:
        return int(text)
    except ValueError:
        return float(text)


def write_rows(
    path: Path, rows: Sequence[Mapping[str, object]], columns: Sequence[str] = ()
) -> None:
    """A CSV of these columns; of those of the first row if none are named."""
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.DictWriter(handle, columns or list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def put_row(path: Path, row: Row, text: Collection[str]) -> None:
    """Put a row into a CSV, in the place of the one with the same first cell if there is one."""
    stored = stored_rows(path, text) if path.exists() else []
    key = next(iter(row))
    rows = {old[key]: old for old in stored} | {row[key]: row}
    write_rows(path, list(rows.values()))


def table_of(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown; rows of fewer cells are filled up."""
    lines = [
        f"| {' | '.join(cells)} |{' |' * (len(heads) - len(cells))}" for cells in (heads, *rows)
    ]
    return "\n".join([lines[0], "|---" * len(heads) + "|", *lines[1:]])


@contextmanager
def figure_at(path: Path, width: float, height: float) -> Generator["Figure"]:
    """A figure of `width` × `height` inches, written as SVG; the same bytes for the same values."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": path.stem, "svg.fonttype": "none"}):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        figure.savefig(path, metadata={"Date": None})


def machine(device: torch.device = CPU) -> Machine:
    """Facts that timings depend on; `device` is the device of the renderer's tensors."""
    return this_machine(device)


def memory_of(process: int | Literal["self"] = "self") -> dict[str, int]:
    """Bytes of a process by Linux's names, `VmHWM` and so on; empty if it is gone.

    Unlike `getrusage` this counts no parent's.
    """
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return {}
    pairs = (line.partition(":")[::2] for line in lines if line.endswith(" kB"))
    return {name: int(value.split()[0]) * 1024 for name, value in pairs}


def short_commit() -> str:
    """The commit that measured, twelve digits; `unknown` outside of a checkout."""
    return (this_build().commit or "unknown")[:12]


def train(
    folder: Path,
    out: Path,
    asked: Mapping[str, Any],
    preset: str = "standard",
    observer: Observer | None = None,
    **options: Any,
) -> Run:
    """Train a scene's folder into a run's, or go on from its checkpoint; prints nothing itself.

    Args:
        folder: The scene's.
        out: The run's.
        asked: Settings by dotted name, as `{"train.steps": 300}`.
        preset: Preset of all others.
        observer: Receives all events.
        options: Renderer, evaluation, limits, as `gs.train` has them.
    """
    scene = load_scene(folder, asked.get("split", "every8"))
    recipe = training.resolve(preset, scene, asked)
    return training.train(scene, recipe, out, observer or Silent(), **options)


def metrics_of(run: Path) -> Row:
    """Metrics that an evaluation wrote into a run's folder; empty if there are none."""
    path = run / "metrics.json"
    return json.loads(path.read_text("utf-8")) if path.is_file() else {}
