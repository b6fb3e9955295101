"""Bytes that coding with a context would take: a part of docs/results/size.md.

    python -m benchmarks.size.contexts fox=FOX.gsyn bonsai=BONSAI.gsyn outdoor=OUTDOOR.gsyn

No coder is built. Rounded values are symbols, and a column takes the length of an adaptive
arithmetic code: each symbol has the share that it had so far in its context, which begins as a
logistic distribution has it. Contexts are what a decoder knows by then; a column's is the one of a
few with which it takes least.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import expit, gammaln
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, put, short_commit, table_of, write_rows
from gsynopsis.container import decode
from gsynopsis.container.writer import encode_with_account
from gsynopsis.records import LevelSet

PAGE, ROWS = RESULTS / "size.md", RESULTS / "size_contexts.csv"
Int64 = NDArray[np.int64]
BEGINNINGS = (8.0, 64.0)
"""Counts that all symbols of a context begin with, together; a column takes the best."""
LEAST_SHARE = 1e-6
"""Share that any symbol begins with."""
BUCKETS = (4, 12)
"""Numbers of buckets that a known value is told in."""
NEIGHBOURS = 16
"""Nearest anchors among which those that are known already are looked for."""
CHOICE = 64
"""Bits by which a column says its context, its mean and its spread."""
KINDS = ("residual", "offsets", "log_scales")


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        files: Files as NAME=FILE.
    """

    files: Positional[tuple[str, ...]]


def code_length(symbols: Int64, contexts: Int64, start: NDArray[np.floating]) -> float:
    """Bits of an adaptive arithmetic code: symbols by their counts so far in the same context.

    The product of all shares does not depend on the order, so counts at the end are enough.

    Args:
        symbols: From 0 on [N].
        contexts: Of each symbol, from 0 on [N].
        start: Counts that symbols begin with in each context, > 0 [S].
    """
    if not len(symbols):
        return 0.0
    kinds = len(start)
    cells, counts = np.unique(contexts * kinds + symbols, return_counts=True)
    totals = np.bincount(contexts)
    totals = totals[totals > 0]
    begun = start[cells % kinds]
    whole = gammaln(start.sum()) - gammaln(start.sum() + totals)
    own = gammaln(begun + counts) - gammaln(begun)
    return float(-(whole.sum() + own.sum()) / np.log(2))


def symbols_of(column: NDArray[np.floating]) -> tuple[Int64, NDArray[np.float64]]:
    """Numbers of the values in their order, from 0 on, and how likely each is to begin with.

    That is a logistic distribution of the column's mean and spread, between the middles of values.
    """
    values, symbols = np.unique(column.astype(np.float64), return_inverse=True)
    middle, scale = float(np.mean(column)), max(float(np.std(column)) * 3**0.5 / np.pi, 1e-9)
    edges = (values[1:] + values[:-1]) / 2
    below = np.concatenate([[0.0], expit((edges - middle) / scale), [1.0]])
    shares = np.maximum(np.diff(below), LEAST_SHARE)
    return symbols.reshape(-1).astype(np.int64), shares / shares.sum()


def buckets(known: NDArray[np.floating], count: int) -> Int64:
    """Known values in as many parts as evenly filled as ties allow."""
    edges = np.quantile(known, np.arange(1, count) / count)
    return np.searchsorted(np.unique(edges), known, side="right").astype(np.int64)


def best_length(column: NDArray[np.floating], known: Mapping[str, NDArray[np.floating]]) -> float:
    """Bits of a column in the best context: one of the known values, or two of them.

    Args:
        column: Values [N].
        known: By name what is known before each value [N].
    """
    symbols, shares = symbols_of(column)
    told = {name: {n: buckets(values, n) for n in BUCKETS} for name, values in known.items()}
    contexts = [each[count] for each in told.values() for count in BUCKETS]
    few = [each[BUCKETS[0]] for each in told.values()]
    contexts += [one * BUCKETS[0] + other for one, other in combinations(few, 2)]
    least = plain_length(column) - CHOICE
    for context in contexts:
        lengths = (code_length(symbols, context, begin * shares) for begin in BEGINNINGS)
        least = min(least, *lengths)
    return least + CHOICE


def plain_length(column: NDArray[np.floating]) -> float:
    """Bits of a column without a context."""
    symbols, shares = symbols_of(column)
    one = np.zeros_like(symbols)
    return CHOICE + min(code_length(symbols, one, begin * shares) for begin in BEGINNINGS)


def known_before(places: NDArray[np.floating]) -> Int64:
    """For each row the nearest of the earlier ones among its neighbours, else the row before it.

    Args:
        places: Positions in the order of decoding [N, 3].

    Returns:
        [N]; the first row has itself.
    """
    near = KDTree(places).query(places, k=min(NEIGHBOURS, len(places)))[1].reshape(len(places), -1)
    rows = np.arange(len(places))
    earlier = near < rows[:, None]
    first = near[rows, earlier.argmax(axis=1)]
    return np.where(earlier.any(axis=1), first, np.maximum(rows - 1, 0)).astype(np.int64)


def lengths(levels: LevelSet) -> dict[str, tuple[float, float]]:
    """Bytes of each kind by an adaptive code without a context, and in the best one.

    Each level's part of a column is coded by itself, as its values have steps of their own.
    """
    shared = levels.shared
    count = len(shared.lattice)
    rows = np.arange(count)
    before, near = np.maximum(rows - 1, 0), known_before(shared.lattice.astype(np.float64))
    size = shared.log_scales[:, 3:].mean(axis=1)
    found = {kind: [0.0, 0.0] for kind in KINDS}
    first = 0
    for number, level in enumerate(levels.levels):
        end = level.anchors

        def add(
            kind: str,
            column: NDArray[np.floating],
            known: Mapping[str, NDArray[np.floating]],
            which: Int64,
        ) -> None:
            if len(which):
                told = {name: values[which] for name, values in known.items()}
                found[kind][0] += plain_length(column[which])
                found[kind][1] += best_length(column[which], told)

        for kind in ("log_scales", "residual"):
            values = getattr(shared, kind)
            for place, column in enumerate(values.T):
                known = {"before": column[before], "near": column[near], "size": size}
                if kind == "log_scales":
                    del known["size"]  # of which it is a part
                if place:
                    known["other"] = values[:, place - 1]
                add(kind, column, known, rows[first:end])
        shown = np.zeros((count, shared.slots), np.bool_)
        shown[:end] = level.mask
        anchor, slot = shown.nonzero()
        fresh = (~levels.before(number)[anchor, slot]).nonzero()[0]
        at = np.full(shown.shape, -1)
        at[anchor, slot] = np.arange(len(anchor))
        values = shared.offsets[anchor, slot]
        parent = at[near[anchor], slot]
        for axis, column in enumerate(values.T):
            same = np.where((parent >= 0) & (near[anchor] < anchor), column[parent], 0)
            last = np.concatenate([[0], np.where(anchor[1:] == anchor[:-1], column[:-1], 0)])
            known = {"near": same, "last": last, "slot": slot}
            known |= {"scale": shared.log_scales[anchor, 0], "size": size[anchor]}
            known |= {"residual": shared.residual[anchor, 0]}
            if axis:
                known["other"] = values[:, axis - 1]
            add("offsets", column, known, fresh)
        first = end
    return {kind: (plain / 8, best / 8) for kind, (plain, best) in found.items()}


def rows_of(name: str, data: bytes) -> list[Row]:
    """A row a kind of values: bytes in the file, and of either code."""
    levels = decode(data, name)
    account = encode_with_account(levels, "compact")[1]
    return [
        {
            "file": name,
            "bytes": len(data),
            "kind": kind,
            "deflate": sum(part.stored for part in account.parts if part.kind == kind),
            "adaptive": round(plain),
            "context": round(best),
        }
        for kind, (plain, best) in lengths(levels).items()
    ]


def table(rows: Sequence[Row]) -> str:
    """A line a file: what each kind, and the whole file, would lose."""
    lines: list[list[str]] = []
    for name in dict.fromkeys(row["file"] for row in rows):
        own = [row for row in rows if row["file"] == name]
        cells = [f"{_less(row['context'], row['deflate'])}" for row in own]
        saved = sum(row["deflate"] - row["context"] for row in own)
        plain = sum(row["deflate"] - row["adaptive"] for row in own)
        total = own[0]["bytes"]
        whole = [_less(total - plain, total), _less(total - saved, total)]
        lines.append([name, f"{total:,}", *cells, *whole])
    heads = ["file", "bytes", *(row["kind"] for row in rows[: len(KINDS)])]
    return table_of([*heads, "file, no context", "file, best context"], lines)


def _less(now: float, before: float) -> str:
    return f"{100 * (now / before - 1):+.1f} %"


def main() -> None:
    """Measure, write."""
    options = tyro.cli(Options, description=__doc__)
    named = [text.split("=", 1) for text in options.files]
    if not named or any(len(pair) < 2 for pair in named):
        sys.exit("files: expected NAME=FILE of each")
    rows = [row for name, file in named for row in rows_of(name, Path(file).read_bytes())]
    write_rows(ROWS, rows)
    put(PAGE, __file__, f"{table(rows)}\n\nEstimated at commit {short_commit()}.")
    print(PAGE, ROWS, sep="\n")


if __name__ == "__main__":
    main()
