"""Choice of the photo pairs to compare: all, neighbours of an ordered capture, or strides."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations, pairwise
from typing import Literal

Pair = tuple[int, int]
"""Two photos by index, the lower one first."""
Matching = Literal["auto", "exhaustive", "sequential", "strides"]
"""Pairs to compare.

Every photo with every other; with its neighbours, if names follow the camera's path; or with some
at growing distances, if there are too many for all.
"""
EXHAUSTIVE = 250
"""Photos up to which all are compared with all."""
EXHAUSTIVE_ORDERED = 60
"""The same, where names say which photos were taken one after the other."""
NEIGHBOURS = 8
"""Photos after each one that an ordered capture compares it with."""
KEYS = 40
"""Photos, evenly apart, that are compared with each other to close loops."""
SPREAD = 30
"""Distances at which strides compare."""
FRIENDS = 20
"""Most new pairs of a photo in the round that follows matches of matches."""
NUMBER = re.compile(r"(\d+)(?=\D*$)")
"""The last number in a file's name."""
GAPS = 3.0
"""Most numbers per photo in the names of an ordered capture, as photos may have been deleted."""


def is_ordered(names: Sequence[str]) -> bool:
    """True if sorted names are numbered as by a camera or a video, with few gaps."""
    found = [NUMBER.search(name) for name in names]
    if len(names) < 3 or not all(found):
        return False
    prefixes = {name[: match.start()] for name, match in zip(names, found, strict=True) if match}
    numbers = [int(match[1]) for match in found if match]
    rising = all(a < b for a, b in pairwise(numbers))
    return len(prefixes) == 1 and rising and numbers[-1] - numbers[0] < GAPS * len(names)


def resolve_matching(names: Sequence[str], matching: Matching = "auto") -> Matching:
    """The way of matching that `auto` stands for with these names, sorted."""
    if matching != "auto":
        return matching
    ordered = is_ordered(names)
    if len(names) <= (EXHAUSTIVE_ORDERED if ordered else EXHAUSTIVE):
        return "exhaustive"
    return "sequential" if ordered else "strides"


def first_pairs(count: int, matching: Matching) -> list[Pair]:
    """The pairs of `count` photos to compare first, ascending; see `transitive_pairs`.

    Args:
        count: How many photos, in the order of their names.
        matching: Not `auto`.
    """
    if matching == "exhaustive":
        return list(combinations(range(count), 2))
    keys = range(0, count, max(1, -(-count // KEYS)))
    if matching == "sequential":
        doubled = [2**power for power in range(count.bit_length()) if 2**power < count // 2]
        steps = sorted({*range(1, NEIGHBOURS + 1), *doubled})
    else:
        steps = sorted({round(1.0 + (count / 2) * (n / SPREAD) ** 2) for n in range(SPREAD)})
    near = ((i, i + step) for step in steps for i in range(count - step))
    return sorted({*near, *combinations(keys, 2)})


def transitive_pairs(verified: Iterable[tuple[Pair, int]], tried: Iterable[Pair]) -> list[Pair]:
    """Pairs of photos that match one and the same third photo and were not compared yet, ascending.

    Args:
        verified: Pairs that show the same thing, with the number of points they share.
        tried: All pairs that were compared.
    """
    links: dict[int, dict[int, int]] = {}
    for (a, b), points in verified:
        links.setdefault(a, {})[b] = points
        links.setdefault(b, {})[a] = points
    done, votes = set(tried), Counter[Pair]()
    for around in links.values():
        strongest = sorted(around, key=lambda other: (-around[other], other))[:FRIENDS]
        for a, b in combinations(sorted(strongest), 2):
            if (a, b) not in done:
                votes[a, b] += min(around[a], around[b])
    taken, chosen = Counter[int](), list[Pair]()
    for pair, _ in sorted(votes.items(), key=lambda item: (-item[1], item[0])):
        if max(taken[pair[0]], taken[pair[1]]) < FRIENDS:
            taken.update(pair)
            chosen.append(pair)
    return sorted(chosen)
