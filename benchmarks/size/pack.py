"""Speed and memory of packing and decoding on one core, beside zlib's own inflate time.

    OMP_NUM_THREADS=1 python -m benchmarks.size.pack --file runs/fox/scene.gsyn
    OMP_NUM_THREADS=1 python -m benchmarks.size.pack --anchors 300000

Without a file it measures a made-up scene with the statistics of trained ones: anchors on
surfaces, four of ten slots live, eight residual values per anchor.
"""

import json
import resource
import sys
import time
import tracemalloc
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from benchmarks.bench import machine, short_commit
from gsynopsis.container import Assembler, decode, encode, read_gsyn
from gsynopsis.container.layout import Kind
from gsynopsis.records import HEAD_NAMES, Frame, Level, LevelSet, Shared, morton_order


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        file: A .gsyn file; a made-up scene if not given.
        anchors: Anchors of the made-up scene.
        repeats: Number of repeats; the best is reported.
        seed: Seed of the made-up scene.
    """

    file: Path | None = None
    anchors: int = 300_000
    repeats: int = 3
    seed: int = 0


def made_up(count: int, seed: int) -> LevelSet:
    """A level set of one level with the statistics of trained scenes."""
    rng = np.random.default_rng(seed)
    angles = rng.normal(size=(count, 3))
    shells = rng.integers(1, 6, (count, 1)) * 200
    points = angles / np.linalg.norm(angles, axis=1, keepdims=True) * shells
    lattice = np.unique((points + rng.normal(size=(count, 3))).astype(np.int32), axis=0)
    lattice = lattice[morton_order(lattice)]
    n, slots = len(lattice), 10
    mask = rng.random((n, slots)) < 0.4
    mask[np.arange(n), rng.integers(0, slots, n)] = True
    shared = Shared(
        lattice=lattice,
        log_scales=(rng.normal(size=(n, 6)) * 0.8 - 4).astype(np.float32),
        offsets=(rng.normal(size=(n, slots, 3)) * 0.65).astype(np.float32) * mask[:, :, None],
        codes=rng.integers(0, 64, n, np.uint8),
        residual=(rng.normal(size=(n, 8)) * 0.4).astype(np.float32),
        grids=(),
        grid_resolutions=(),
    )
    width, networks = 40 + 4, dict[str, np.ndarray]()
    for head, out in zip(HEAD_NAMES, (1, 7, 3), strict=True):
        networks[f"{head}_w1"] = rng.normal(size=(32, width)).astype(np.float32)
        networks[f"{head}_b1"] = np.zeros(32, np.float32)
        networks[f"{head}_w2"] = rng.normal(size=(out * slots, 32)).astype(np.float32)
        networks[f"{head}_b2"] = np.zeros(out * slots, np.float32)
    codebook = rng.normal(size=(64, 32)).astype(np.float32)
    level = Level(mask, 0, codebook, networks, np.ones(3, np.float32))
    return LevelSet(
        Frame(0.01, np.zeros(3), 5.0, True, 4.0), shared, (level,), {"scene": "made up"}
    )


def best(repeats: int, task: object) -> float:
    """Least wall time of a callable, seconds."""
    times: list[float] = []
    for _ in range(repeats):
        started = time.perf_counter()
        task()  # type: ignore[operator]
        times.append(time.perf_counter() - started)
    return min(times)


def bodies_of(data: bytes) -> list[tuple[bytes, int]]:
    """Stored bytes and inflated length of every block and chunk of values."""
    client = Assembler(data, "file")
    found: list[tuple[bytes, int]] = []
    for chunk in client.index.chunks:
        body = data[chunk.offset : chunk.offset + chunk.stored]
        if chunk.kind != Kind.BLOCKS:
            client.add(chunk, body)
            found.append((body, chunk.raw))
            continue
        directory = client.directories[chunk.level]
        for block in range(len(directory)):
            start, stop = directory.span_of(block)
            found.append((data[start:stop], int(directory.records["raw"][block])))
    return found


def inflate_all(bodies: list[tuple[bytes, int]]) -> None:
    for stored, raw in bodies:
        if len(stored) != raw:
            zlib.decompressobj(-15).decompress(stored, raw)


def decode_blocks(data: bytes) -> None:
    """Do a client's work on a level's chunks: check, inflate, undo the coding, place."""
    client = Assembler(data, "file")
    for _ in client.index.levels:
        client.add_level(data)


def array_bytes(levels: LevelSet) -> int:
    s = levels.shared
    arrays = [s.lattice, s.log_scales, s.offsets, s.codes, s.residual, *s.grids]
    arrays += [level.mask for level in levels.levels]
    return sum(array.nbytes for array in arrays)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if options.file:
        data, levels = options.file.read_bytes(), read_gsyn(options.file)
    else:
        levels = made_up(options.anchors, options.seed)
        data = encode(levels)
    anchors = len(levels.shared.lattice)
    bodies = bodies_of(data)
    floor = best(options.repeats, lambda: inflate_all(bodies))
    blocks = best(options.repeats, lambda: decode_blocks(data))
    whole = best(options.repeats, lambda: decode(data, "file"))
    packing = best(1, lambda: encode(levels))
    tracemalloc.start()
    decoded = decode(data, "file")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    print(
        json.dumps(
            {
                "anchors": anchors,
                "bytes": len(data),
                "inflate_floor_s": round(floor, 4),
                "decode_chunks_s": round(blocks, 4),
                "decode_chunks_anchors_per_s": round(anchors / blocks),
                "decode_to_arrays_s": round(whole, 4),
                "decode_to_arrays_anchors_per_s": round(anchors / whole),
                "pack_s_per_million": round(packing / anchors * 1e6, 2),
                "peak_over_decoded_arrays": round(peak / array_bytes(decoded), 2),
                "max_rss_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10,
                "machine": machine().cpu,
                "commit": short_commit(),
                "seed": options.seed,
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    sys.exit(main())
