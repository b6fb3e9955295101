"""A made-up city of any number of splats, and its files: one PLY for every viewer, and ours."""

import os
from pathlib import Path

import numpy as np

from gsynopsis.cameras.orbit import Circle, circle_text, default_lens, first_text, orbit
from gsynopsis.formats.readers.base import logits_of
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.jobs.import_splats import import_splats
from gsynopsis.records import (
    FIRST_NOTE,
    HEAD_OUTPUTS,
    ORBIT_NOTE,
    Float32,
    Frame,
    Level,
    LevelSet,
    PlainGaussians,
    Shared,
    morton_order,
)

SIDE, HOUSES, TALLEST = 40.0, 14, 5.0
"""Side of the square, world units; houses along a side; greatest height, world units."""
C0 = 0.28209479177387814
SHARES = (0.02, 0.1, 0.35, 1.0)
"""Anchors of the levels of the anchor model, of all."""
SLOTS, VALUES = 10, 12
BIASES = {"opacity": (1.0,), "cov": (0.5, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0), "color": (0.0, 0.0, 0.0)}
"""Biases of the heads beside an anchor's values: opacity, three scales and w x y z, colour."""


def city(count: int) -> PlainGaussians:
    """Flat splats on ground, walls and roofs, evenly by area; colours do not depend on the view."""
    rng = np.random.default_rng(0)
    origins, firsts, seconds, paints = _faces(rng)
    areas = np.linalg.norm(np.cross(firsts, seconds), axis=1)
    face = np.sort(rng.choice(len(areas), count, p=areas / areas.sum()))
    u, v = rng.random((2, count, 1))
    means = origins[face] + u * firsts[face] + v * seconds[face]
    # So that neighbours overlap: one splat has so much area.
    spread = np.sqrt(areas.sum() / count) * rng.uniform(0.5, 0.9, (count, 3))
    spread[:, 2] = 0.05 * spread[:, 0]
    windows = np.sin(9 * means).prod(1, keepdims=True) > 0.05
    colors = paints[face] * np.where(windows, 1.0, 0.6) + rng.normal(0, 0.04, (count, 3))
    normals = np.cross(firsts, seconds)[face]
    return PlainGaussians(
        means=means.astype(np.float32),
        log_scales=np.log(spread).astype(np.float32),
        quaternions=_turns(normals / np.linalg.norm(normals, axis=1, keepdims=True)),
        logits=rng.uniform(1.0, 4.0, count).astype(np.float32),
        sh=((np.clip(colors, 0, 1) - 0.5) / C0).astype(np.float32)[:, None],
    )


def _faces(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Parallelograms: corner, two edges, colour, each [F, 3]."""
    half, step = SIDE / 2, SIDE / HOUSES
    faces = [((-half, 0, -half), (SIDE, 0, 0), (0, 0, SIDE), (0.35, 0.4, 0.3))]
    for number in range(HOUSES**2):
        wide, deep = step * rng.uniform(0.4, 0.7, 2)
        tall = TALLEST * rng.uniform(0.1, 1) ** 2
        x, z = np.array(divmod(number, HOUSES)) * step - half + 0.15 * step
        paint, top = tuple(rng.uniform(0.3, 0.9, 3)), -tall
        faces += [
            ((x, 0, z), (wide, 0, 0), (0, top, 0), paint),
            ((x, 0, z + deep), (wide, 0, 0), (0, top, 0), paint),
            ((x, 0, z), (0, 0, deep), (0, top, 0), paint),
            ((x + wide, 0, z), (0, 0, deep), (0, top, 0), paint),
            ((x, top, z), (wide, 0, 0), (0, 0, deep), (0.6, 0.25, 0.2)),
        ]
    found = np.array(faces, np.float64)
    return found[:, 0], found[:, 1], found[:, 2], found[:, 3]


def _turns(normals: np.ndarray) -> Float32:
    """Rotations that take z to unit vectors, w x y z [G, 4]."""
    x, y, z = normals.T
    turns = np.stack((1 + z, -y, x, np.zeros_like(x)), axis=1)
    turns[turns[:, 0] < 1e-6] = (0, 1, 0, 0)
    return (turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32)


def files_of(count: int, folder: Path, steps: int = 0) -> tuple[Path, Path]:
    """The city as PLY and as ours, coarse levels trained for `steps`; existing files are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    trained = f"_{steps}" if steps else ""
    plain, ours = folder / f"city_{count}.ply", folder / f"city_{count}{trained}.gsyn"
    if not plain.exists():
        partial = plain.with_suffix(".part")
        partial.write_bytes(ply_bytes(city(count)))
        os.replace(partial, plain)
    if not ours.exists():
        import_splats(plain, ours, steps=steps)
    return plain, ours


def anchored(count: int) -> LevelSet:
    """The city as an anchor model of four levels, with the statistics of trained ones.

    Four of ten slots of an anchor are live, values have as many bits as in trained files, and the
    heads pass on the colours of the anchors' values, so that renders of it show the city.
    """
    rng = np.random.default_rng(1)
    given = city(count + count // 8)
    voxel = float(np.exp(np.median(given.log_scales[:, 0])))
    cells, first = np.unique(
        np.round(given.means / voxel).astype(np.int32), axis=0, return_index=True
    )
    chosen = rng.permutation(len(cells))[:count]
    counts = [round(len(chosen) * share) for share in SHARES]
    order = np.concatenate(
        [part[morton_order(cells[part])] for part in np.split(chosen, counts[:-1])]
    )
    cells, first = cells[order], first[order]
    mask = rng.random((len(cells), SLOTS)) < 0.4
    mask[np.arange(len(cells)), rng.integers(0, SLOTS, len(cells))] = True
    own = rng.normal(0, 0.3, (len(cells), VALUES)).astype(np.float32)
    own[:, :3] = logits_of(np.clip(given.sh[first, 0] * C0 + 0.5, 0.02, 0.98))
    sizes = rng.normal(np.log(voxel), 0.3, (len(cells), 6)).astype(np.float32)
    shared = Shared(
        lattice=cells,
        log_scales=sizes,
        offsets=(rng.normal(0, 0.6, (len(cells), SLOTS, 3)) * mask[:, :, None]).astype(np.float32),
        codes=np.zeros(0, np.uint8),
        residual=own,
        grids=(),
        grid_resolutions=(),
    )
    networks = _heads(rng)
    levels = tuple(
        Level(
            mask[:n], 0, np.zeros((0, 0), np.float32), networks,
            np.full(3, np.sqrt(len(cells) / n), np.float32),
        )
        for n in counts
    )  # fmt: skip
    frame = Frame(voxel, np.zeros(3), SIDE / 2, True, SIDE)
    up, ahead = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])
    circle = Circle(np.zeros(3), up, ahead, radius=0.45 * SIDE, height=TALLEST)
    notes = {
        "scene": f"city of {len(cells):,} anchors",
        "up": "0 -1 0",
        ORBIT_NOTE: circle_text(circle),
        FIRST_NOTE: first_text(orbit(circle, default_lens(), 1)[0]),
    }
    return LevelSet(frame, shared, levels, notes)


def _heads(rng: np.random.Generator) -> dict[str, Float32]:
    """Colours are an anchor's first three values, with a little of the others in each slot."""
    networks: dict[str, Float32] = {}
    # Two units of each value, relu(v) and relu(-v), whose difference is the value.
    both = np.zeros((2 * VALUES, VALUES + 4), np.float32)
    both[:VALUES, :VALUES], both[VALUES:, :VALUES] = np.eye(VALUES), -np.eye(VALUES)
    for head, outputs in HEAD_OUTPUTS.items():
        mixed = 0.1 * rng.normal(size=(SLOTS, outputs, VALUES))
        if head == "color":
            mixed[:, range(3), range(3)] = 1
        flat = mixed.reshape(SLOTS * outputs, VALUES).astype(np.float32)
        networks |= {
            f"{head}_w1": both,
            f"{head}_b1": np.zeros(2 * VALUES, np.float32),
            f"{head}_w2": np.hstack([flat, -flat]),
            f"{head}_b2": np.tile(BIASES[head], SLOTS).astype(np.float32),
        }
    return networks
