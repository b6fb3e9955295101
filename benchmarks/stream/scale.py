"""Streaming at scale, on paper and by simulation: bytes, caches, costs, and a city of blocks.

    python -m benchmarks.stream.scale

Writes its part of docs/results/scale.md. Nothing is measured on a network; every assumption is a
field of `Assumptions`.
"""

from dataclasses import dataclass, field

import numpy as np
import tyro

from benchmarks.bench import RESULTS, put, short_commit, table_of
from gsynopsis.container.layout import block_entry_bytes, index_bytes

PAGE = RESULTS / "scale.md"
KIB, MIB = 1 << 10, 1 << 20


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of the tables.

    Attributes:
        level_mib: Bytes of a scene up to each level, MiB.
        stops: Share of viewers who leave after each level.
        dollars_per_gib: Price of traffic from a CDN.
        dollars_per_10k: Price of 10,000 requests at a CDN.
        range_kib: Mean bytes of a request, KiB.
        zipf: Exponent of the scenes' popularity.
        scenes: Scenes on the host.
        cache_share: Bytes that an edge holds, as a share of all.
        viewers_day: Viewers a day at one edge.
        blocks: Blocks of the city per side, at each level.
        block_kib: Bytes of a block at each level, KiB.
        radius: Blocks around the camera that are wanted at each level.
        speed: Blocks per second that the camera flies.
        ahead: Seconds of prefetch along the flight.
        seconds: Length of the simulated flight.
        seed: Seed of popularity draws and of the flight.
    """

    level_mib: tuple[float, ...] = (0.05, 0.5, 1.2, 2.0)
    stops: tuple[float, ...] = (0.2, 0.2, 0.2, 0.4)
    dollars_per_gib: float = 0.05
    dollars_per_10k: float = 0.01
    range_kib: float = 48.0
    zipf: float = 0.9
    scenes: int = 10_000
    cache_share: tuple[float, ...] = (0.01, 0.05, 0.2)
    viewers_day: int = 20_000
    blocks: int = 100
    block_kib: tuple[float, ...] = (4.0, 20.0, 40.0, 60.0)
    radius: tuple[float, ...] = (50.0, 16.0, 8.0, 4.0)
    speed: tuple[float, ...] = (0.1, 0.5, 2.0)
    ahead: tuple[float, ...] = (0.0, 2.0, 5.0)
    seconds: int = 300
    seed: int = field(default=0)


def per_viewer(a: Assumptions) -> str:
    """Cost of a viewer, by blocks and by the whole file."""
    mean = float(np.dot(a.level_mib, a.stops))
    requests = 1 + mean * MIB / (a.range_kib * KIB)
    whole = a.level_mib[-1]
    parts: list[str] = []
    for name, size, count in (("by blocks", mean, requests), ("whole finest file", whole, 1.0)):
        cost = 1000 * (size / 1024 * a.dollars_per_gib + count / 1e4 * a.dollars_per_10k)
        many = "request" if round(count) == 1 else "requests"
        parts.append(
            f"{name} {size:.2f} MiB, {count:.0f} {many} and {cost:.3f} dollars per 1,000 viewers"
        )
    return f"A viewer takes {'; '.join(parts)}."


def cache_hits(a: Assumptions) -> str:
    """An edge with least-recently-used eviction, simulated; levels are cached apart."""
    chance = np.random.default_rng(a.seed)
    weights = 1.0 / np.arange(1, a.scenes + 1) ** a.zipf
    scenes = chance.choice(a.scenes, a.viewers_day, p=weights / weights.sum())
    depth = chance.choice(len(a.stops), a.viewers_day, p=a.stops)
    sizes = np.diff(a.level_mib, prepend=0.0)
    total = a.level_mib[-1] * a.scenes
    parts: list[str] = []
    for share in a.cache_share:
        apart = [(int(s), k) for s, d in zip(scenes, depth, strict=True) for k in range(d + 1)]
        got, first = lru(apart, [float(x) for x in sizes], share * total)
        whole, _ = lru([(int(s), 0) for s in scenes], [a.level_mib[-1]], share * total)
        parts.append(f"{share:.0%}: {got:.0%} / {first:.0%} / {whole:.0%}")
    return (
        "Hits by what the edge holds, bytes of levels apart / first pictures / bytes of whole "
        f"files: {'; '.join(parts)}."
    )


def lru(asked: list[tuple[int, int]], sizes: list[float], room: float) -> tuple[float, float]:
    """Shares of bytes, and of level 0 requests, that a cache of `room` MiB answers."""
    held: dict[tuple[int, int], None] = {}
    used = hit = total = 0.0
    first = first_hit = 0
    for key in asked:
        size = sizes[key[1]]
        total += size
        first += key[1] == 0
        if key in held:
            hit += size
            first_hit += key[1] == 0
            del held[key]
            held[key] = None
            continue
        while used + size > room and held:
            oldest = next(iter(held))
            del held[oldest]
            used -= sizes[oldest[1]]
        held[key] = None
        used += size
    return hit / total, first_hit / first


def city(a: Assumptions) -> str:
    """Requests, rates and waste of a flight, for each speed and prefetch."""
    count = a.blocks * a.blocks
    levels = len(a.block_kib)
    chunks = 1 + 3 * levels
    directory = [block_entry_bytes(k) * count for k in range(levels)]
    sizes = ", ".join(f"{size / KIB:.0f}" for size in directory)
    index = index_bytes(levels, chunks) / KIB
    heads = ["speed, blocks/s", "prefetch, s", "requests/s", "Mbit/s", "blocks late"]
    lines: list[list[str]] = []
    for speed in a.speed:
        for ahead in a.ahead:
            rate, mbit, late, unused = fly(a, speed, ahead)
            cells = [f"{speed}", f"{ahead:.0f}", f"{rate:.1f}", f"{mbit:.1f}"]
            lines.append([*cells, f"{late:.1%}", f"{unused:.1%}"])
    return (
        f"{table_of([*heads, 'bytes unused'], lines)}\n\n{count:,} blocks at each of {levels} "
        f"levels: header and index {index:.1f} KiB; directories before deflation {sizes} KiB."
    )


def fly(a: Assumptions, speed: float, ahead: float) -> tuple[float, float, float, float]:
    """Requests/s, Mbit/s, share of wanted blocks not there in time, share of bytes never wanted.

    The camera flies on a smooth random curve; a block takes half a second to come.
    """
    chance = np.random.default_rng(a.seed)
    grid = np.stack(np.meshgrid(np.arange(a.blocks), np.arange(a.blocks)), axis=-1) + 0.5
    place, heading, turn = np.full(2, a.blocks / 2), 0.0, 0.0
    arrives = np.full((len(a.block_kib), a.blocks, a.blocks), np.inf)
    used = np.zeros_like(arrives, dtype=bool)
    requests = size = late = wanted_all = 0.0
    step = 0.5
    for number in range(round(a.seconds / step)):
        now = number * step
        turn = 0.9 * turn + 0.1 * chance.normal()
        heading += turn * step
        direction = np.array([np.cos(heading), np.sin(heading)])
        place = np.clip(place + direction * speed * step, 1, a.blocks - 1)
        if ((place <= 1) | (place >= a.blocks - 1)).any():
            heading += np.pi / 2
        soon = place + direction * speed * ahead
        for level, radius in enumerate(a.radius):
            seen = np.linalg.norm(grid - place, axis=-1) <= radius
            there = arrives[level] <= now
            if now > 5:
                late += float((seen & ~there).sum())
                wanted_all += float(seen.sum())
            used[level] |= seen & there
            fetch = seen | (np.linalg.norm(grid - soon, axis=-1) <= radius)
            new = fetch & np.isinf(arrives[level])
            arrives[level][new] = now + 0.5
            if now > 5:
                requests += float(new.sum())
                size += float(new.sum()) * a.block_kib[level] * KIB
    seconds = a.seconds - 5
    came = ~np.isinf(arrives)
    weight = np.array(a.block_kib)[:, None, None]
    unused = float(((came & ~used) * weight).sum() / (came * weight).sum())
    return requests / seconds, size * 8 / 1e6 / seconds, late / max(1, wanted_all), unused


def main(a: Assumptions) -> None:
    made = f"Seed {a.seed}, commit {short_commit()}."
    text = "\n\n".join([city(a), per_viewer(a), cache_hits(a), made])
    print(f"{a}\n\n{text}")
    put(PAGE, __file__, text)


if __name__ == "__main__":
    main(tyro.cli(Assumptions, description=__doc__))
