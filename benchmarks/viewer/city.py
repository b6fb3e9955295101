"""A made-up city of any number of splats, and its files: one PLY for every viewer, and ours."""

import os
from pathlib import Path

import numpy as np

from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.pipeline.importing import import_splats
from gsynopsis.records import Float32, PlainGaussians

SIDE, HOUSES, TALLEST = 40.0, 14, 5.0
"""Of the square, world units; houses along a side; height, world units. y points down."""
C0 = 0.28209479177387814


def city(count: int) -> PlainGaussians:
    """Flat splats on ground, walls and roofs, evenly by area; colours are alike from every side."""
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


def files_of(count: int, folder: Path) -> tuple[Path, Path]:
    """The city as PLY and as ours; what is in the folder already is not made again."""
    folder.mkdir(parents=True, exist_ok=True)
    plain, ours = folder / f"city_{count}.ply", folder / f"city_{count}.gsyn"
    if not plain.exists():
        partial = plain.with_suffix(".part")
        partial.write_bytes(ply_bytes(city(count)))
        os.replace(partial, plain)
    if not ours.exists():
        import_splats(plain, ours)
    return plain, ours
