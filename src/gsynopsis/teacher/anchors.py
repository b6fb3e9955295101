"""An anchor model that already shows about what some splats show, in closed form.

Each slot has a splat; what the heads are to give for all slots of an anchor is a row of a matrix,
whose best approximation with as many columns as an anchor has values is a weighted principal
component analysis with missing values. Pairs of rectified units make the heads' inner layer linear
in those components, so the heads begin as that analysis; the other units begin at random.

Letters: N anchors, K slots, R values of an anchor, D = 11 K outputs of the heads.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from gsynopsis.config import ModelConfig
from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.encoding import grid_layout
from gsynopsis.model.heads import init_networks
from gsynopsis.records import SH_0, Float32, Frame, PlainGaussians, positions
from gsynopsis.teacher.clusters import Clusters

Float64 = NDArray[np.float64]
OPAQUEST, FAINTEST = 0.97, 0.02
"""Opacities that a head's tanh can still be told apart from 1 and 0."""
ROOM = 1.3
"""Base scale of an anchor to its largest splat: sigmoids that learn are not at their end."""
STEEPEST = 4.0
"""Largest logit of a scale's share and of a colour."""
POWER, LEAST = 0.5, 0.3
"""Exponent of removal effects as weights; least share of the largest in an anchor."""
PASSES = 8
"""Rounds of filling in what is missing and analysing again."""
WORTH = {"opacity": 1.0, "scale": 0.6, "turn": 1.0, "color": 0.35}
"""Weights of the heads' errors in the analysis: about what they do to an image."""
SMALL = 0.05
"""Factor on the outer weights of units that begin at random."""
ROWS = 1 << 14
"""Anchors at a time: the matrices of a slot take ten times what is kept of it."""


class Targets(NamedTuple):
    """Outputs wanted of the heads before their activations.

    Attributes:
        outputs: One of opacity for each slot, seven of covariance (three of scales, four of a
            quaternion), three of colour; head after head, float32 [N, D].
        there: Slots that have a splat, bool [N, K].
        log_base: Base scale of each anchor's Gaussians, float64 [N].
    """

    outputs: Float32
    there: NDArray[np.bool_]
    log_base: Float64


def targets_of(splats: PlainGaussians, members: NDArray[np.int64]) -> Targets:
    """The targets of clusters of splats [N, K]; slots of each are in the order of `members`."""
    count, slots = members.shape
    outputs = np.empty((count, 11 * slots), np.float32)
    log_base = np.empty(count)
    for rows in pieces(count):
        outputs[rows], log_base[rows] = _targets_of_some(splats, members[rows])
    return Targets(outputs, members >= 0, log_base)


def _targets_of_some(splats: PlainGaussians, members: NDArray[np.int64]) -> tuple[Float64, Float64]:
    """Outputs [n, D] and base scales [n] of some clusters [n, K]."""
    there = members >= 0
    rows = np.where(there, members, 0)
    log_scales = splats.log_scales[rows].astype(np.float64)
    turned = np.argsort(-log_scales, axis=2, kind="stable")
    log_scales = np.take_along_axis(log_scales, turned, axis=2)
    quats = canonical(splats.quaternions[rows].astype(np.float64), turned)
    largest = np.where(there[:, :, None], log_scales, -np.inf).max(axis=(1, 2))
    log_base = largest + np.log(ROOM)
    share = np.exp(log_scales - log_base[:, None, None])
    opacity = 1 / (1 + np.exp(-splats.logits[rows].astype(np.float64)))
    color = np.clip(splats.sh[rows, 0].astype(np.float64) * SH_0 + 0.5, 0, 1)
    cov = np.concatenate([_logit(share), quats], axis=2)
    outputs = np.concatenate(
        [
            np.arctanh(np.clip(opacity, FAINTEST, OPAQUEST)),
            cov.reshape(len(members), -1),
            _logit(color).reshape(len(members), -1),
        ],
        axis=1,
    )
    return outputs, log_base


def colors_of(splats: PlainGaussians, clusters: Clusters) -> NDArray[np.uint8]:
    """The colour of the first splat of each cluster, uint8 [N, 3]."""
    shades = splats.sh[clusters.members[:, 0], 0].astype(np.float64) * SH_0 + 0.5
    return np.rint(np.clip(shades, 0, 1) * 255).astype(np.uint8)


def by_brightness(splats: PlainGaussians, members: NDArray[np.int64]) -> NDArray[np.int64]:
    """Members [N, K] with those of each cluster from dark to bright, missing ones last."""
    luma = splats.sh[:, 0].astype(np.float64) @ np.array([0.299, 0.587, 0.114])
    keys = np.where(members >= 0, luma[np.maximum(members, 0)], np.inf)
    return np.take_along_axis(members, np.argsort(keys, axis=1, kind="stable"), axis=1)


def canonical(quats: Float64, turned: NDArray[np.int64]) -> Float64:
    """Quaternions of the same ellipsoids with their axes in another order, nearest to none.

    Args:
        quats: w x y z, not 0, [..., 4].
        turned: New order of the axes [..., 3].

    Returns:
        Unit quaternions, w ≥ 0, of the four that differ by half turns the one with the largest w.
    """
    matrices = _matrices(quats)
    matrices = np.take_along_axis(matrices, turned[..., None, :], axis=-1)
    flip = np.linalg.det(matrices) < 0
    matrices[..., 2] = np.where(flip[..., None], -matrices[..., 2], matrices[..., 2])
    q = _quaternions(matrices)
    w, x, y, z = np.moveaxis(q, -1, 0)
    same = np.stack(
        [
            np.stack([w, x, y, z], -1),
            np.stack([-x, w, z, -y], -1),
            np.stack([-y, -z, w, x], -1),
            np.stack([-z, y, -x, w], -1),
        ],
        axis=-2,
    )
    best = np.abs(same[..., 0]).argmax(axis=-1)
    chosen = np.take_along_axis(same, best[..., None, None], axis=-2)[..., 0, :]
    return np.where(chosen[..., :1] < 0, -chosen, chosen)


def components(
    values: Float32, weights: Float64, weight_of: NDArray[np.int64], count: int
) -> tuple[Float64, Float64, Float64]:
    """The best approximation of a matrix by fewer columns, where weights say what counts.

    Args:
        values: [N, D].
        weights: ≥ 0; 0 where values are missing, [N, W].
        weight_of: Column of `weights` that each column of `values` has [D].
        count: R.

    Returns:
        Scores of unit variance [N, R], loadings [R, D] and means [D].
    """
    total, mean = np.zeros(values.shape[1]), np.zeros(values.shape[1])
    for rows in pieces(len(values)):
        weight = weights[rows][:, weight_of]
        total += weight.sum(axis=0)
        mean += (weight * values[rows]).sum(axis=0)
    mean /= np.maximum(total, 1e-300)
    scores, loadings = np.zeros((len(values), count)), np.zeros((count, values.shape[1]))

    def filled(rows: slice) -> tuple[Float64, Float64]:
        """Some rows less the mean, and the weight of each row.

        What is missing is what the last pass made of it, and in part so what counts little.
        """
        weight = weights[rows][:, weight_of]
        row = weight.max(axis=1, keepdims=True)
        share = weight / np.maximum(row, 1e-300)
        wanted = np.where(weight > 0, values[rows] - mean, 0)
        return share * wanted + (1 - share) * (scores[rows] @ loadings), row

    for _ in range(PASSES):
        products = np.zeros((values.shape[1], values.shape[1]))
        for rows in pieces(len(values)):
            some, row = filled(rows)
            products += some.T @ (row * some)
        _, vectors = np.linalg.eigh(products)
        basis = vectors[:, ::-1][:, :count]
        signs = np.sign(basis[np.abs(basis).argmax(axis=0), np.arange(basis.shape[1])])
        basis = basis * signs
        # Filled once more rather than kept: that would be a matrix as large as all outputs.
        for rows in pieces(len(values)):
            scores[rows, : basis.shape[1]] = filled(rows)[0] @ basis
        loadings[: basis.shape[1]] = basis.T
    spread = np.maximum(scores.std(axis=0), 1e-9)
    return scores / spread, loadings * spread[:, None], mean


def pieces(count: int) -> Iterator[slice]:
    """Slices of `ROWS` rows at most, which have all of so many."""
    for start in range(0, count, ROWS):
        yield slice(start, min(start + ROWS, count))


def fitted_model(
    splats: PlainGaussians,
    clusters: Clusters,
    weights: Float64,
    frame: Frame,
    config: ModelConfig,
    generator: torch.Generator,
) -> AnchorModel:
    """The model of one level whose slots are about the splats.

    Args:
        splats: G of them.
        clusters: On the lattice of `frame`.
        weights: How much each splat counts, [G] ≥ 0.
        frame: Of the model.
        config: Without grids, codebook and fusion MLP.
        generator: Of what begins at random.
    """
    members = by_brightness(splats, clusters.members)
    targets = targets_of(splats, members)
    count, slots = members.shape
    model = AnchorModel(frame, grid_layout((), config.table_log2))
    model.set_lattice(torch.from_numpy(clusters.lattice))
    scores, networks = _fitted_heads(targets, weights, members, config, generator)
    model.residual = nn.Parameter(_tensor(scores))
    offsets, log_spread = np.empty((count, slots, 3), np.float32), np.empty(count)
    for rows in pieces(count):
        places = positions(frame, clusters.lattice[rows].astype(np.int32)).astype(np.float64)
        away = splats.means[np.maximum(members[rows], 0)].astype(np.float64) - places[:, None]
        away *= targets.there[rows, :, None]
        spread = np.sqrt((away**2).sum(axis=2).max(axis=1))
        own = np.maximum(np.log(np.maximum(spread, 1e-300)), np.log(frame.voxel))
        offsets[rows], log_spread[rows] = away / np.exp(own)[:, None, None], own
    model.offsets = nn.Parameter(torch.from_numpy(offsets))
    scales = [np.repeat(column[:, None], 3, axis=1) for column in (log_spread, targets.log_base)]
    model.log_scales = nn.Parameter(_tensor(np.concatenate(scales, axis=1)))
    model.logits = nn.Parameter(torch.zeros(count, 0))
    model.table = nn.Parameter(torch.zeros(0, model.layout.features))
    mask = torch.from_numpy(targets.there.copy())
    assert mask.shape == (count, slots)
    model.parts.append(LevelPart(mask, 0, torch.zeros(0, 0), networks))
    return model


def _fitted_heads(
    targets: Targets,
    weights: Float64,
    members: NDArray[np.int64],
    config: ModelConfig,
    generator: torch.Generator,
) -> tuple[Float64, dict[str, torch.Tensor]]:
    count, slots = targets.there.shape
    width = config.residual
    networks = init_networks(width, slots, config.hidden, None, generator)
    worth = np.concatenate(
        [
            np.full(slots, WORTH["opacity"]),
            np.tile([WORTH["scale"]] * 3 + [WORTH["turn"]] * 4, slots),
            np.full(3 * slots, WORTH["color"]),
        ]
    )
    slot_of = np.concatenate([np.repeat(np.arange(slots), each) for each in (1, 7, 3)])
    counts = np.where(targets.there, weights[np.maximum(members, 0)], 0.0) ** POWER
    # Beside few that count very much, the rest is not to be forgotten.
    counts = np.maximum(counts, LEAST * counts.max(axis=1, keepdims=True)) * targets.there
    counts /= max(float(counts.mean()), 1e-300)
    pairs = min(width, config.hidden // 2)
    outputs = targets.outputs * worth.astype(np.float32)
    scores, loadings, mean = components(outputs, counts, slot_of, pairs)
    loadings, mean = loadings / worth, mean / worth
    parts = np.split(loadings, [slots, 8 * slots], axis=1)
    means = np.split(mean, [slots, 8 * slots])
    for head, loading, middle in zip(("opacity", "cov", "color"), parts, means, strict=True):
        inner, outer = networks[f"{head}_w1"], networks[f"{head}_w2"]
        outer.mul_(SMALL)
        inner[: 2 * pairs] = 0
        networks[f"{head}_b1"][: 2 * pairs] = 0
        for place in range(pairs):
            inner[2 * place, place], inner[2 * place + 1, place] = 1, -1
            column = _tensor(loading[place])
            outer[:, 2 * place], outer[:, 2 * place + 1] = column, -column
        networks[f"{head}_b2"][:] = _tensor(middle)
    full = np.zeros((count, width))
    full[:, :pairs] = scores
    return full, networks


def _logit(share: Float64) -> Float64:
    share = np.clip(share, 1e-9, 1 - 1e-9)
    return np.clip(np.log(share) - np.log1p(-share), -STEEPEST, STEEPEST)


def _matrices(quats: Float64) -> Float64:
    q = quats / np.linalg.norm(quats, axis=-1, keepdims=True)
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _quaternions(matrices: Float64) -> Float64:
    """Unit quaternions of rotations [..., 3, 3], of either sign."""
    m = matrices
    a, b, c = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    squares = np.stack([1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c], axis=-1)
    x = m[..., 2, 1] - m[..., 1, 2]
    y = m[..., 0, 2] - m[..., 2, 0]
    z = m[..., 1, 0] - m[..., 0, 1]
    xy = m[..., 0, 1] + m[..., 1, 0]
    xz = m[..., 0, 2] + m[..., 2, 0]
    yz = m[..., 1, 2] + m[..., 2, 1]
    w2, x2, y2, z2 = np.moveaxis(squares, -1, 0)
    every = np.stack(
        [
            np.stack([w2, x, y, z], -1),
            np.stack([x, x2, xy, xz], -1),
            np.stack([y, xy, y2, yz], -1),
            np.stack([z, xz, yz, z2], -1),
        ],
        axis=-2,
    )
    best = squares.argmax(axis=-1)
    q = np.take_along_axis(every, best[..., None, None], axis=-2)[..., 0, :]
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def _tensor(values: Float64) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
