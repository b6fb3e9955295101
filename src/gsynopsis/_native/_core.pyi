from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Floats: TypeAlias = NDArray[np.float32] | Tensor
Integers: TypeAlias = NDArray[np.int64] | Tensor
Bytes: TypeAlias = NDArray[np.uint8] | Tensor

def variants() -> list[str]: ...

class Frame:
    def __init__(self, variant: str = "") -> None: ...
    def render(
        self,
        means: Floats,
        quats: Floats,
        scales: Floats,
        opacities: Floats,
        colors: Floats,
        w2c: Floats,
        intrinsics: tuple[float, float, float, float],
        dilations: tuple[float, float],
        background: Floats,
        image: Floats,
        alpha: Floats,
        visible: Bytes,
        threads: int,
        pairs_max: int = ...,
    ) -> bool: ...
    def backward(
        self,
        means: Floats,
        quats: Floats,
        scales: Floats,
        opacities: Floats,
        image: Floats,
        grad_image: Floats,
        grad_means: Floats,
        grad_quats: Floats,
        grad_scales: Floats,
        grad_opacities: Floats,
        grad_colors: Floats,
        grad_screen: Floats,
        threads: int,
    ) -> None: ...
    def removal_effects(self, image: Floats, effects: Floats, threads: int) -> None: ...
    @property
    def pairs(self) -> int: ...
    @property
    def bytes(self) -> int: ...
    @property
    def stage_ms(self) -> dict[str, float]: ...

def hashgrid_forward(
    points: Floats,
    tables: Floats,
    resolutions: Integers,
    offsets: Integers,
    sizes: Integers,
    out: Floats,
    threads: int = 1,
    variant: str = "",
) -> None: ...
def hashgrid_backward(
    points: Floats,
    grad_out: Floats,
    resolutions: Integers,
    offsets: Integers,
    sizes: Integers,
    grad_tables: Floats,
    threads: int = 1,
    variant: str = "",
) -> None: ...

Slots: TypeAlias = tuple[Integers, Bytes, Floats, Floats, Floats, Floats, Floats, Floats, Floats]
Five: TypeAlias = tuple[Floats, Floats, Floats, Floats, Floats]

def visible_rows(
    anchors: tuple[Floats, Floats, Floats, Bytes, float],
    w2c: Floats,
    intrinsics: tuple[float, float, float, float],
    size: tuple[int, int],
    rows: Integers,
    threads: int = 1,
    variant: str = "",
) -> int: ...
def count_drawn(
    slots: Slots, activated: Floats, starts: Integers, threads: int = 1, variant: str = ""
) -> int: ...
def assemble(
    slots: Slots,
    drawn: tuple[Floats, Integers],
    gaussians: Five,
    drawn_slots: Integers,
    threads: int = 1,
    variant: str = "",
) -> None: ...
def assemble_backward(
    slots: Slots,
    drawn: tuple[Floats, Integers],
    grad_gaussians: Five,
    grads: Five,
    gain_shares: Floats,
    grad_log_gain: Floats,
    threads: int = 1,
    variant: str = "",
    add: bool = False,
) -> None: ...
def scatter_rows(
    rows: Integers, source: Floats, first: int, to: Floats, add: bool = False, threads: int = 1
) -> None: ...
def photometric(
    image: Floats,
    target: Floats,
    ssim_weight: float,
    grad: Floats | None = None,
    threads: int = 1,
    variant: str = "",
) -> float: ...

Networks: TypeAlias = tuple[list[Floats], Floats, int, int]
HeadRows: TypeAlias = tuple[Floats, Integers | None, Floats, list[Floats]]

def fill_inputs(
    rows: Integers,
    positions: Floats,
    residual: Floats,
    eye: tuple[float, float, float],
    distances: tuple[float, float, float],
    grids: int,
    x: Floats,
    threads: int = 1,
) -> None: ...
def choose(
    logits: Floats, rows: Integers, codes: Integers, threads: int = 1, variant: str = ""
) -> None: ...
def heads_forward(
    networks: Networks, rows: HeadRows, threads: int = 1, variant: str = ""
) -> None: ...
def heads_backward(
    networks: Networks,
    rows: HeadRows,
    grad_x: Floats,
    grad_weights: list[Floats],
    grad_codebook: Floats,
    choice: tuple[Floats, Integers, Floats, bool] | None = None,
    threads: int = 1,
    variant: str = "",
) -> None: ...
def count_view(
    view: tuple[Integers, Integers, Floats, Bytes, Floats],
    size: tuple[int, int],
    counters: tuple[Floats, Floats, Floats, Floats],
    threads: int = 1,
) -> None: ...
def mean_volume(scales: Floats, grad: Floats | None = None) -> float: ...
def mean_squared(one: Floats, other: Floats, threads: int = 1) -> float: ...
def in_unit(bytes: NDArray[np.uint8], to: Floats, threads: int = 1) -> None: ...
def adam(
    tensors: list[tuple[Floats, Floats, Floats, Floats, float, float]],
    epsilon: float,
    threads: int = 1,
    variant: str = "",
) -> None: ...
def sample_cubic(
    pixels: NDArray[np.uint8], places: NDArray[np.float32], colors: NDArray[np.uint8]
) -> None: ...
def weighted_clusters(points: Floats, weights: Floats, count: int, labels: Integers) -> None: ...
