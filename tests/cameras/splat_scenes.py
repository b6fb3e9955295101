"""Splats made by rule, of scenes that people import, with cameras that a person would choose."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.formats.axes import harmonic_values
from gsynopsis.records import PlainGaussians
from gsynopsis.scene.camera import Camera, look_at

Float64 = NDArray[np.float64]
UP = (0.0, 0.0, 1.0)
WIDTH, HEIGHT, FOCAL = 240, 135, 207.75


@dataclass(frozen=True)
class SplatScene:
    """A scene.

    Attributes:
        gaussians: All of them.
        eyes: Places where a person would stand, by the scene's maker [E, 3].
        targets: What a person there looks at [E, 3].
        whole: Whether a person sees it from outside: all of `box` is then in a first view.
        box: Corners of what the scene is about, low and high [2, 3].
    """

    gaussians: PlainGaussians
    eyes: Float64
    targets: Float64
    whole: bool
    box: Float64

    def cameras(self) -> list[Camera]:
        """A person's cameras."""
        return [
            Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, look_at(a, b, np.array(UP)))
            for a, b in zip(self.eyes, self.targets, strict=True)
        ]


def splats(
    points: Float64, normals: Float64, size: float, opacity: float = 0.95, seed: int = 0
) -> PlainGaussians:
    """Flat discs on a surface, coloured by a pattern of the place."""
    chance = np.random.default_rng(seed)
    count = len(points)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    turns = np.concatenate([1 + normals[:, 2:], -normals[:, 1:2], normals[:, :1]], axis=1)
    turns = np.concatenate([turns, np.zeros((count, 1))], axis=1)
    turns[np.linalg.norm(turns, axis=1) < 1e-6] = (0, 1, 0, 0)
    scale = max(float(np.abs(points).max()), 1e-9)
    waves = np.sin(points / scale @ (9 * chance.standard_normal((3, 3))))
    colors = 0.9 * waves + 0.2 * chance.standard_normal((count, 3))
    return PlainGaussians(
        points.astype(np.float32),
        np.log(np.tile([size, size, 0.15 * size], (count, 1))).astype(np.float32),
        turns.astype(np.float32),
        np.full(count, np.log(opacity / (1 - opacity)), np.float32),
        colors[:, None].astype(np.float32),
    )


def joined(*parts: PlainGaussians) -> PlainGaussians:
    """All splats of some scenes."""
    names = ("means", "log_scales", "quaternions", "logits", "sh")
    return PlainGaussians(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def scaled(scene: SplatScene, factor: float) -> SplatScene:
    """The same scene in another unit."""
    g = scene.gaussians
    means = (g.means * factor).astype(np.float32)
    log_scales = (g.log_scales + np.log(factor)).astype(np.float32)
    gaussians = PlainGaussians(means, log_scales, g.quaternions, g.logits, g.sh)
    places = (scene.eyes * factor, scene.targets * factor)
    return SplatScene(gaussians, *places, scene.whole, scene.box * factor)


def sphere(count: int, radius: float, seed: int) -> tuple[Float64, Float64]:
    """Points on a sphere around zero, and normals."""
    normals = np.random.default_rng(seed).standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius * normals, normals


def box(
    count: int, low: Sequence[float], high: Sequence[float], seed: int, without: str = ""
) -> tuple[Float64, Float64]:
    """Points on a box's faces by their area, and normals; `without` names faces, as in "+z"."""
    chance = np.random.default_rng(seed)
    lows, sides = np.array(low, float), np.array(high, float) - np.array(low, float)
    faces = [(a, s) for a in range(3) for s in (0, 1) if f"{'-+'[s]}{'xyz'[a]}" not in without]
    areas = np.array([np.prod(np.delete(sides, axis)) for axis, _ in faces])
    chosen = chance.choice(len(faces), count, p=areas / areas.sum())
    axes, signs = np.array(faces)[chosen].T
    inside = chance.random((count, 3))
    inside[np.arange(count), axes] = signs
    normals = np.zeros((count, 3))
    normals[np.arange(count), axes] = 2 * signs - 1
    return lows + inside * sides, normals


def ring(
    middle: Sequence[float], distance: float, tilt: float, count: int = 6
) -> tuple[Float64, Float64]:
    """Places around a middle, and the middle as what is looked at."""
    turns = 2 * np.pi * (np.arange(count) + 0.4) / count
    flat = np.stack([np.cos(turns), np.sin(turns), np.full(count, np.tan(tilt))], axis=1)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return np.array(middle) + distance * flat, np.tile(np.array(middle, float), (count, 1))


def hollow_sphere(seed: int = 0) -> SplatScene:
    """A closed sphere with a spike."""
    spike = box(90, (-0.1, -0.1, 1.0), (0.1, 0.1, 2.2), seed)
    gaussians = joined(splats(*sphere(900, 1, seed), 0.07), splats(*spike, 0.04))
    return SplatScene(
        gaussians, *ring((0, 0, 0.6), 5, 0.3), True, np.array([[-1, -1, -1], [1, 1, 2.2]])
    )


def hollow_box(seed: int = 0) -> SplatScene:
    """A closed parcel."""
    gaussians = splats(*box(1200, (-1, -0.7, -0.5), (1, 0.7, 0.5), seed), 0.06)
    return SplatScene(
        gaussians, *ring((0, 0, 0), 4, 0.35), True, np.array([[-1, -0.7, -0.5], [1, 0.7, 0.5]])
    )


def with_floaters(seed: int = 0) -> SplatScene:
    """An object and faint splats a hundred times as far away."""
    scene, chance = hollow_box(seed), np.random.default_rng(seed + 9)
    away = chance.standard_normal((30, 3))
    away *= 100 / np.linalg.norm(away, axis=1, keepdims=True)
    faint = splats(away, away, 3.0, 0.05)
    return SplatScene(joined(scene.gaussians, faint), scene.eyes, scene.targets, True, scene.box)


def with_specks(seed: int = 0) -> SplatScene:
    """An object and opaque specks all around it, few and near, some far."""
    scene, chance = hollow_sphere(seed), np.random.default_rng(seed + 9)
    away = chance.standard_normal((25, 3))
    away *= 10 ** (0.6 + 1.5 * chance.random((25, 1))) / np.linalg.norm(away, axis=1, keepdims=True)
    specks = splats(away, away, 0.05, 0.9)
    return SplatScene(joined(scene.gaussians, specks), scene.eyes, scene.targets, True, scene.box)


def with_dome(seed: int = 0, times: float = 40, count: int = 900) -> SplatScene:
    """An object under a sky."""
    scene = hollow_sphere(seed)
    sky = splats(*sphere(count, times, seed + 3), 2.5 * times / np.sqrt(count))
    return SplatScene(joined(scene.gaussians, sky), scene.eyes, scene.targets, True, scene.box)


def room(seed: int = 0, without: str = "") -> SplatScene:
    """A furnished room, seen from inside."""
    walls = splats(*box(2600, (-3, -2.5, 0), (3, 2.5, 2.6), seed, without), 0.13)
    table = splats(*box(500, (-0.6, -0.4, 0.7), (0.6, 0.4, 0.8), seed + 1), 0.05)
    shelf = splats(*box(700, (-2.9, 0.5, 0), (-2.4, 2, 1.9), seed + 2), 0.07)
    sofa = splats(*box(700, (1.6, -2.2, 0.1), (2.7, -0.4, 0.8), seed + 3), 0.07)
    eyes, _ = ring((0.2, 0.3, 1.4), 1.5, 0.0, 6)
    targets = 2 * np.array([0.1, 0.1, 1.1]) - eyes * (1, 1, 1)
    targets[:, 2] = 1.0
    return SplatScene(
        joined(walls, table, shelf, sofa),
        eyes,
        targets,
        False,
        np.array([[-3, -2.5, 0], [3, 2.5, 2.6]]),
    )


def open_room(seed: int = 0) -> SplatScene:
    """A room whose ceiling nobody photographed: seen from above, as a doll's house is."""
    scene = room(seed, "+z")
    return SplatScene(scene.gaussians, *ring((0, 0, 1), 11, 0.6), True, scene.box)


def terrain(seed: int = 0) -> SplatScene:
    """Flat land with low hills, as drones see it."""
    chance = np.random.default_rng(seed)
    flat = 100 * (chance.random((3000, 2)) - 0.5)
    height = 1.5 * np.sin(flat[:, :1] / 9) * np.cos(flat[:, 1:] / 7)
    points = np.concatenate([flat, height], axis=1)
    gaussians = splats(points, np.tile([0.0, 0.0, 1.0], (3000, 1)), 1.4)
    return SplatScene(
        gaussians, *ring((0, 0, 0), 115, 0.8), True, np.array([[-50, -50, -1.5], [50, 50, 1.5]])
    )


def street(seed: int = 0) -> SplatScene:
    """A long street between houses, as a drone sees it."""
    parts = [splats(*box(2500, (-100, -5, -0.1), (100, 5, 0), seed, "-z"), 0.6)]
    for number in range(20):
        x = -100 + 10 * number
        height = 6 + 3 * np.sin(7 * number)
        for y in (-15, 5):
            corners = (x + 0.5, y, 0), (x + 9.5, y + 10, height)
            parts.append(splats(*box(200, *corners, seed + number), 0.9, seed=number))
        car = (x + 1, 2.5, 0.2), (x + 5, 4.3, 1.6)
        parts.append(splats(*box(120, *car, seed + 50 + number), 0.25, seed=number))
    eyes, targets = ring((0, 0, 0), 150, 0.5)
    return SplatScene(joined(*parts), eyes, targets, True, np.array([[-100, -15, 0], [100, 15, 9]]))


def thin_wall(seed: int = 0) -> SplatScene:
    """One upright wall, as a painting is."""
    gaussians = splats(*box(1200, (-2, -0.02, 0), (2, 0.02, 3), seed), 0.08)
    eyes = np.array([[x, y, 1.7] for x in (-1.5, 0.2, 1.7) for y in (-6, 6)], float)
    targets = np.tile([0.0, 0.0, 1.5], (6, 1))
    return SplatScene(gaussians, eyes, targets, True, np.array([[-2, -0.02, 0], [2, 0.02, 3]]))


def pole(seed: int = 0) -> SplatScene:
    """A thing thirty times as high as wide."""
    gaussians = splats(*box(900, (-0.1, -0.1, 0), (0.1, 0.1, 6), seed), 0.03)
    return SplatScene(
        gaussians, *ring((0, 0, 3), 10, 0.1), True, np.array([[-0.1, -0.1, 0], [0.1, 0.1, 6]])
    )


def thick_shell(seed: int = 0) -> SplatScene:
    """A closed sphere whose splats lie in layers, with a few more of them inside."""
    chance = np.random.default_rng(seed)
    places, normals = sphere(3000, 1, seed)
    shell = splats(places * (1 + 0.05 * chance.standard_normal((3000, 1))), normals, 0.06)
    within, _ = sphere(250, 0.8, seed + 1)
    inner = splats(within * chance.random((250, 1)), within, 0.04, 0.5)
    gaussians = joined(shell, inner)
    low, high = gaussians.means.min(axis=0), gaussians.means.max(axis=0)
    return SplatScene(gaussians, *ring((0, 0, 0), 4, 0.3), True, np.array([low, high], float))


def tree(seed: int = 0) -> SplatScene:
    """A crown full of leaves over a lawn: there is room under it."""
    chance = np.random.default_rng(seed)
    away, _ = sphere(2500, 1.5, seed)
    leaves = splats(away * chance.random((2500, 1)) ** (1 / 3) + (0, 0, 3.5), away, 0.09)
    flat = np.concatenate([8 * chance.random((1200, 2)) - 4, np.zeros((1200, 1))], axis=1)
    lawn = splats(flat, np.tile([0.0, 0.0, 1.0], (1200, 1)), 0.16)
    trunk = splats(*box(300, (-0.15, -0.15, 0), (0.15, 0.15, 2.5), seed), 0.05)
    corners = np.array([[-4, -4, 0], [4, 4, 5]])
    return SplatScene(joined(leaves, lawn, trunk), *ring((0, 0, 2.2), 12, 0.3), True, corners)


def park(seed: int = 0) -> PlainGaussians:
    """Ground of grass that faces anywhere, under trees and haze that hide it from above."""
    chance = np.random.default_rng(seed)
    flat = 60 * (chance.random((4000, 2)) - 0.5)
    grass = np.concatenate([flat, 0.15 * chance.standard_normal((4000, 1))], axis=1)
    parts = [splats(grass, chance.standard_normal((4000, 3)), 0.45)]
    for number in range(60):
        away, _ = sphere(80, 2.5, seed + number)
        middle = np.array([*(54 * (chance.random(2) - 0.5)), 4 + 2 * chance.random()])
        leaves = middle + away * chance.random((80, 1)) ** (1 / 3)
        parts.append(splats(leaves, chance.standard_normal((80, 3)), 0.9, seed=number))
    haze = 60 * (chance.random((300, 3)) - 0.5) * (1, 1, 0.3) + (0, 0, 18)
    return joined(*parts, splats(haze, chance.standard_normal((300, 3)), 5.0, 0.5))


SCENES: dict[str, Callable[[], SplatScene]] = {
    "hollow sphere": hollow_sphere,
    "hollow box": hollow_box,
    "faint floaters": with_floaters,
    "opaque specks": with_specks,
    "sky dome": with_dome,
    "far dome of more splats": lambda: with_dome(times=100, count=2500),
    "room": room,
    "room without ceiling": open_room,
    "terrain": terrain,
    "street": street,
    "thin wall": thin_wall,
    "pole": pole,
    "thick shell": thick_shell,
    "tree": tree,
    "box in millimetres": lambda: scaled(hollow_box(), 1000),
    "street in kilometres": lambda: scaled(street(), 0.001),
    "room in centimetres": lambda: scaled(room(), 100),
}


def after_a_step(points: int, to: Float64, chance: np.random.Generator) -> NDArray[np.float32]:
    """Harmonics [P, 15, 3] a step from zero towards colors by chance, of photos at `to` [D, 3]."""
    along = -to / np.linalg.norm(to, axis=1, keepdims=True)
    values = harmonic_values(along, 16)[:, 1:]
    harmonics = 0.01 * values.T @ chance.standard_normal((points, len(to), 3))
    return harmonics.astype(np.float32)
