"""A second, slow renderer from docs/format.md alone, over what `plain_reader` reads: §5 and §6.

NumPy in float64, Gaussian after Gaussian, nothing shared.
"""

import json
import math
from typing import Any

import numpy as np

Array = np.ndarray
NEAR, FILTER, FRUSTUM = 0.01, 0.3, 1.3
ALPHA_LEAST, ALPHA_LARGEST, TRANSMITTANCE_LEAST = 1 / 255, 0.99, 1e-4
TO_32_BITS = 0xFFFFFFFF


def sigmoid(v: Array) -> Array:
    return 1 / (1 + np.exp(-v))


def layer(networks: dict[str, Any], name: str, v: Array) -> Array:
    """Two layers with a ReLU between them, for rows of inputs."""
    b1, b2 = (np.array(networks[f"{name}_b{i}"]) for i in (1, 2))
    w1 = np.array(networks[f"{name}_w1"]).reshape(len(b1), -1)
    w2 = np.array(networks[f"{name}_w2"]).reshape(len(b2), len(b1))
    return np.maximum(v @ w1.T + b1, 0) @ w2.T + b2


# -- Notes ---------------------------------------------------------------------------------------


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def note(scene: dict[str, Any], name: str) -> Any:
    try:
        return json.loads(scene["meta"].get(name, ""))
    except ValueError:
        return None


def seen_of(scene: dict[str, Any]) -> tuple[Any, Any, float, float] | None:
    """Centre and radius of the ball, least and largest distance."""
    values = note(scene, "seen")
    if not isinstance(values, dict):
        return None
    center, radius, distance = (values.get(n, 0) for n in ("center", "radius", "distance"))
    for numbers, count in ((center, 3), ([radius], 1), (distance, 2)):
        if not isinstance(numbers, list) or len(numbers) != count:
            return None
        if not all(is_number(number) for number in numbers):
            return None
    low, high = (float(np.float32(value)) for value in distance)
    if not radius > 0 or not 0 <= low <= high < math.inf:
        return None
    return np.array(center, float), radius, low, high


def focals_of(scene: dict[str, Any], level: int) -> tuple[float, float] | None:
    """Shortest and longest focal length of the level's training images."""
    pairs = note(scene, "focals")
    if not isinstance(pairs, list) or len(pairs) < len(scene["quality"]):
        return None
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or not all(map(is_number, pair)):
            return None
        if not 0 < pair[0] <= pair[1]:
            return None
    return pairs[level][0], pairs[level][1]


# -- From arrays to Gaussians --------------------------------------------------------------------


def positions(scene: dict[str, Any], count: int) -> Array:
    lattice = np.array(scene["lattice"][:count], np.float64).reshape(count, 3)
    return (lattice * scene["head"]["voxel"]).astype(np.float32).astype(np.float64)


def grid_points(head: dict[str, Any], x: Array) -> Array:
    y = (x - np.float32(head["center"]).astype(float)) / float(np.float32(head["radius"]))
    if not head["contract"]:
        return np.clip((y + 1) / 2, 0, 1)
    length = np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1e-30)
    z = np.where(length <= 1, y, (2 - 1 / length) * y / length)
    return np.clip((z + 2) / 4, 0, 1)


def interpolated(u: Array, table: Array, resolution: int) -> Array:
    """Values of one grid at u."""
    rows = len(table)
    p = u * (resolution - 1)
    cell = np.minimum(np.floor(p), resolution - 2)
    part = p - cell
    found = np.zeros((len(u), table.shape[1]))
    for n, (at, f) in enumerate(zip(cell.astype(int).tolist(), part, strict=True)):
        for corner in range(8):
            bits = [corner >> axis & 1 for axis in range(3)]
            x, y, z = (a + b for a, b in zip(at, bits, strict=True))
            if resolution**3 <= rows:
                row = x + resolution * y + resolution**2 * z
            else:
                row = (x ^ y * 2654435761 & TO_32_BITS ^ z * 805459861 & TO_32_BITS) % rows
            w = math.prod(v if b else 1 - v for v, b in zip(f, bits, strict=True))
            found[n] += w * table[row]
    return found


def features(scene: dict[str, Any], number: int, x: Array) -> Array:
    """Inputs of the heads but the last four."""
    head, level, count = scene["head"], scene["levels"][number], len(x)
    u = grid_points(head, x)
    parts: list[Array] = []
    for g in range(level["grids"]):
        table = np.array(scene["grids"][g]).reshape(-1, head["features"])
        parts.append(interpolated(u, table, scene["resolutions"][g]))
    if level["rows"]:
        codebook = np.array(level["codebook"]).reshape(level["rows"], level["columns"])
        parts.append(codebook[scene["codes"][:count]])
    else:
        parts.append(np.zeros((count, level["columns"])))
    parts.append(np.array(scene["residual"][:count], float).reshape(count, head["residual"]))
    v = np.concatenate(parts, axis=1)
    return layer(level["networks"], "fuse", v) if level["fuse_hidden"] else v


def view(scene: dict[str, Any], x: Array, eye: Array) -> Array:
    """The last four inputs of the heads."""
    low, high, seen = 0.0, math.inf, seen_of(scene)
    if seen is not None:
        center, radius, low, high = seen
        away = np.linalg.norm(eye - center)
        if away > radius:
            eye = center + (eye - center) * radius / away
    d = np.maximum(np.linalg.norm(x - eye, axis=1, keepdims=True), 1e-8)
    return np.concatenate([(x - eye) / d, np.clip(d / scene["head"]["extent"], low, high)], axis=1)


def gaussians(scene: dict[str, Any], number: int, eye: Array) -> dict[str, Array]:
    """All Gaussians of a level for a camera's position."""
    level, slots = scene["levels"][number], scene["head"]["slots"]
    count = level["anchors"]
    x = positions(scene, count)
    if scene["head"]["splats"]:
        found, stand_ins = splats(scene, level, x, eye), scene["head"]["stand_ins"]
        # Stand-ins of coarser levels are not drawn once what they stand for is there.
        first = scene["levels"][stand_ins - 1]["anchors"] if 0 < stand_ins <= number else 0
        return {name: values[first:] for name, values in found.items()}
    inputs = np.concatenate([features(scene, number, x), view(scene, x, eye)], axis=1)
    opacity, cov, color = (
        layer(level["networks"], name, inputs).reshape(count, slots, width)
        for name, width in (("opacity", 1), ("cov", 7), ("color", 3))
    )
    opacity = np.tanh(opacity[:, :, 0])
    base = np.exp(np.array(scene["log_scales"][:count]).reshape(count, 6))
    live = np.array(level["mask"], bool).reshape(count, slots)
    anchor, slot = np.nonzero(live & (opacity > 0))
    offsets = [scene["offsets"][at] for at in zip(anchor.tolist(), slot.tolist(), strict=True)]
    turn = cov[anchor, slot, 3:]
    return {
        "slots": anchor * slots + slot,
        "means": x[anchor] + np.array(offsets).reshape(-1, 3) * base[anchor, :3],
        "scales": base[anchor, 3:] * sigmoid(cov[anchor, slot, :3]) * level["gain"],
        "quats": turn / np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-12),
        "opacities": opacity[anchor, slot],
        "colors": sigmoid(color[anchor, slot]),
    }


def splats(scene: dict[str, Any], level: dict[str, Any], x: Array, eye: Array) -> dict[str, Array]:
    """Gaussians with values of their own."""
    values = np.array(scene["residual"][: len(x)], float).reshape(-1, 7)
    turn, (y, orange, green) = values[:, :3], values[:, 4:].T
    square = (turn**2).sum(axis=1, keepdims=True)
    sh = harmonics(scene, len(x))
    sh[:, 0] = np.stack([y - green + orange, y + green, y - green - orange], axis=1)
    d = (x - eye) / np.maximum(np.linalg.norm(x - eye, axis=1, keepdims=True), 1e-8)
    return {
        "slots": np.arange(len(x)),
        "means": x,
        "scales": np.exp(np.array(scene["log_scales"][: len(x)]).reshape(-1, 3)) * level["gain"],
        "quats": np.concatenate([1 - square, 2 * turn], axis=1) / (1 + square),
        "opacities": sigmoid(values[:, 3]),
        "colors": np.maximum(0, 0.5 + (basis(d)[:, : sh.shape[1], None] * sh).sum(axis=1)),
    }


def harmonics(scene: dict[str, Any], count: int) -> Array:
    """Coefficients by splat, the first of each colour 0: each a sum of rows of codebooks."""
    width = scene["head"]["features"]
    sh, first = np.zeros((count, width + 3)), 0
    for level in scene["levels"]:
        for n in range(first, min(level["anchors"], count)):
            for stage, code in enumerate(scene["codes"][n]):
                row = level["codebook"][code]
                sh[n, 3:] += row[stage * width : (stage + 1) * width]
        first = level["anchors"]
    return sh.reshape(count, 1 + width // 3, 3)


def basis(d: Array) -> Array:
    """The 16 spherical harmonics of the page's table, [N, 16]."""
    x, y, z = d.T
    a, b, c, e = 0.4886025119029199, 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
    f, g, h = 0.5900435899266435, 2.890611442640554, 0.4570457994644658
    i, j = 0.3731763325901154, 1.445305721320277
    four = 4 * z**2 - x**2 - y**2
    rows = [0 * x + 0.28209479177387814, -a * y, a * z, -a * x, b * x * y, -b * y * z]
    rows += [c * (2 * z**2 - x**2 - y**2), -b * x * z, e * (x**2 - y**2)]
    rows += [-f * y * (3 * x**2 - y**2), g * x * y * z, -h * y * four]
    rows += [i * z * (2 * z**2 - 3 * x**2 - 3 * y**2), -h * x * four, j * z * (x**2 - y**2)]
    return np.stack([*rows, -f * x * (x**2 - 3 * y**2)], axis=1)


# -- Rendering -----------------------------------------------------------------------------------


def rotation(q: Array) -> Array:
    """The matrix of v ↦ q·v·q⁻¹."""
    w, x, y, z = q / np.linalg.norm(q)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def filters(camera: dict[str, Any], focals: tuple[float, float] | None) -> tuple[float, float]:
    """What is added to the diagonals: the Gaussians' own, and all, px²."""
    here = math.sqrt(camera["fx"] * camera["fy"])
    low, high = focals or (here, here)
    r = here / min(max(here, low), high)
    return FILTER * r * r, FILTER * max(r * r, 1)


def alphas(
    camera: dict[str, Any], m: Array, shape: Array, opacity: float, added: tuple[float, float]
) -> Array:
    """Of one Gaussian at all pixels; `shape` is Q·diag(S)."""
    width, height, fx, fy = (camera[name] for name in ("width", "height", "fx", "fy"))
    turn = np.array(camera["w2c"]).reshape(3, 4)[:, :3]
    most = FRUSTUM * width / (2 * fx), FRUSTUM * height / (2 * fy)
    a, b = (min(max(m[i] / m[2], -most[i]), most[i]) for i in (0, 1))
    j = np.array([[fx / m[2], 0, -a * fx / m[2]], [0, fy / m[2], -b * fy / m[2]]])
    spread = j @ turn @ shape
    own, whole = (spread @ spread.T + v * np.eye(2) for v in added)
    opacity *= math.sqrt(max(0.0, np.linalg.det(own) / np.linalg.det(whole)))
    dx = np.arange(width) + 0.5 - (fx * m[0] / m[2] + camera["cx"])
    dy = np.arange(height) + 0.5 - (fy * m[1] / m[2] + camera["cy"])
    (xx, xy), (_, yy) = np.linalg.inv(whole)
    squared = xx * dx**2 + 2 * xy * dx * dy[:, None] + yy * dy[:, None] ** 2
    found = np.minimum(ALPHA_LARGEST, opacity * np.exp(-0.5 * squared))
    return np.where(found >= ALPHA_LEAST, found, 0)


def image(g: dict[str, Array], camera: dict[str, Any], focals: tuple[float, float] | None) -> Array:
    """[H, W, 3]."""
    w2c = np.array(camera["w2c"]).reshape(3, 4)
    m = g["means"] @ w2c[:, :3].T + w2c[:, 3]
    added = filters(camera, focals)
    size = camera["height"], camera["width"]
    pixels, left, goes_on = np.zeros((*size, 3)), np.ones(size), np.ones(size, bool)
    for n in np.argsort(m[:, 2], kind="stable"):
        if m[n, 2] < NEAR or g["opacities"][n] < ALPHA_LEAST or not g["quats"][n].any():
            continue
        shape = rotation(g["quats"][n]) @ np.diag(g["scales"][n])
        alpha = alphas(camera, m[n], shape, float(g["opacities"][n]), added)
        goes_on &= left * (1 - alpha) >= TRANSMITTANCE_LEAST
        alpha = np.where(goes_on, alpha, 0)
        pixels += (left * alpha)[:, :, None] * g["colors"][n]
        left *= 1 - alpha
    return pixels + left[:, :, None] * np.array(camera["background"])


def eye_of(camera: dict[str, Any]) -> Array:
    w2c = np.array(camera["w2c"]).reshape(3, 4)
    return -w2c[:, :3].T @ w2c[:, 3]
