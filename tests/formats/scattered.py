"""Plain Gaussians at random, for tests of files."""

import numpy as np

from gsynopsis.records import PlainGaussians


def scattered(count: int = 40, degree: int = 3, seed: int = 1) -> PlainGaussians:
    """Gaussians of a plausible scene: all values finite, quaternions of any length."""
    rng = np.random.default_rng(seed)

    def normal(*shape: int, spread: float = 1.0) -> np.ndarray:
        return (rng.standard_normal(shape) * spread).astype(np.float32)

    coefficients = (degree + 1) ** 2
    return PlainGaussians(
        means=normal(count, 3, spread=2.0),
        log_scales=normal(count, 3) - np.float32(4),
        quaternions=normal(count, 4),
        logits=normal(count, spread=2.0),
        sh=normal(count, coefficients, 3, spread=0.3),
    )
