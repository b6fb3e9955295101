"""The scene that rasterisers are timed on: Gaussians all over the image, of a given mean size."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.render.base import DILATION
from gsynopsis.scene.camera import Camera

Array = NDArray[np.float32]


@dataclass(frozen=True)
class ArrayScene:
    """Gaussians and the gradient of an image as float32 arrays; the camera is at the origin."""

    means: Array  # [G, 3]
    quats: Array  # [G, 4]
    scales: Array  # [G, 3]
    opacities: Array  # [G]
    colors: Array  # [G, 3]
    width: int
    height: int
    focal: float  # pixels
    background: Array  # [3]
    grad_image: Array  # [H, W, 3]

    def shape_arrays(self) -> tuple[Array, Array, Array, Array]:
        """All that decides where and how much, in the order of the kernels."""
        return self.means, self.quats, self.scales, self.opacities

    def camera(self) -> Camera:
        """The camera that the scene was made for."""
        return Camera(
            self.width,
            self.height,
            self.focal,
            self.focal,
            self.width / 2,
            self.height / 2,
            np.eye(4),
        )


def bench_scene(count: int, width: int, height: int, radius: float, seed: int = 0) -> ArrayScene:
    """Seeded Gaussians whose mean radius (three standard deviations) is `radius` pixels."""
    rng = np.random.default_rng(seed)
    focal = 0.9 * width
    depths = rng.uniform(2, 10, count)
    x = (rng.uniform(0, width, count) - width / 2) / focal * depths
    y = (rng.uniform(0, height, count) - height / 2) / focal * depths
    sizes = np.exp(rng.normal(0, 0.6, (count, 1)) + rng.normal(0, 0.45, (count, 3)))
    scene = ArrayScene(
        np.stack([x, y, depths], axis=1).astype(np.float32),
        rng.normal(size=(count, 4)).astype(np.float32),
        (sizes * (depths / focal)[:, None]).astype(np.float32),
        rng.uniform(0.3, 0.6, count).astype(np.float32),
        rng.uniform(0, 1, (count, 3)).astype(np.float32),
        width,
        height,
        focal,
        np.array([0.1, 0.2, 0.3], np.float32),
        rng.normal(size=(height, width, 3)).astype(np.float32),
    )
    return _with_mean_radius(scene, radius)


def _with_mean_radius(scene: ArrayScene, radius: float) -> ArrayScene:
    # The dilation makes radii not quite proportional to scales: a few fixed-point steps.
    factor = 1.0
    for _ in range(12):
        found = radii(replace(scene, scales=(scene.scales * factor).astype(np.float32)))
        factor *= radius / float(found.mean())
    return replace(scene, scales=(scene.scales * factor).astype(np.float32))


def radii(scene: ArrayScene) -> NDArray[np.float64]:
    """Three standard deviations along the longer axis on the image, pixels."""
    w, x, y, z = (scene.quats / np.linalg.norm(scene.quats, axis=1, keepdims=True)).T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    px, py, pz = scene.means.astype(np.float64).T
    jacobian = np.zeros((len(pz), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = scene.focal / pz
    jacobian[:, 0, 2] = -scene.focal * px / pz**2
    jacobian[:, 1, 2] = -scene.focal * py / pz**2
    spread = jacobian @ (rotation * scene.scales[:, None, :])
    covariance = spread @ spread.transpose(0, 2, 1) + DILATION * np.eye(2)
    return 3 * np.sqrt(np.linalg.eigvalsh(covariance)[:, -1])
