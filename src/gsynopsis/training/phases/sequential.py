"""The paper's way: one coarser level after the other, shared tensors frozen (§1.11–§1.13)."""

import math
from functools import partial

import torch
from torch import Tensor, nn

from gsynopsis.config import Sequential, level_scale
from gsynopsis.model.anchors import AnchorModel, LearntMask, LevelPart
from gsynopsis.model.build import freeze_codes
from gsynopsis.model.heads import without_columns
from gsynopsis.model.levels import coarser_part
from gsynopsis.model.tables import Decoded
from gsynopsis.training.levels.selection import prune_unseen_slots
from gsynopsis.training.losses import sparsity_loss
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.optim.param_groups import part_parameters, rates_of
from gsynopsis.training.state import TrainState, no_logits
from gsynopsis.training.step import next_views, synced_views
from gsynopsis.training.view_step import train_view

WARM_UP = 0.05
"""Fraction of the steps in which only codebook and heads adapt, because grids were just removed."""
HARDEN = 0.7
"""Fraction of the steps after which the masks are fixed (§1.11.7)."""
CONTROL_EVERY = 0.01
"""Fraction of the steps between corrections of λ_s, 100 of 10,000 (§1.11.6)."""
MASK_STEPS = 10_000
"""Schedule for which the mask's rate is stated; shorter ones move masks faster in proportion."""
MASK_THRESHOLD = 0.01
"""ε: a slot is live where σ(m) > ε (§1.11.4)."""
MASK_START = 1.0
"""Initial mask logit, σ = 0.73 (Compact-3DGS)."""
RESTART = 0.5
"""Heads restart at this share of their initial rates (§1.11.8)."""
TRAINED = {
    "full": ("networks", "codebook"),
    "cbm": ("codebook",),
    "lad": ("networks",),
    "lad-frozen": ("networks",),
    "base": (),
}
"""Parts that adapt, per ablation (§1.12); masks always do."""


class UnfoldPhase:
    """Makes level `level` out of `level + 1`: drop grids, learn masks, adapt."""

    averages = True

    def __init__(self, level: int, levels: Sequential, last: int) -> None:
        """`last` is the finest level's number."""
        self.level, self.levels, self.last = level, levels, last
        self.name, self.steps = f"unfold L{level}", levels.steps
        self.below = last - 1 - level
        """Steps down before this one."""

    def begin(self, state: TrainState) -> None:
        """The child starts as its parent without the finest grids."""
        model, sparsity = state.model, self.levels.sparsity
        if self.below == 0:
            freeze_codes(model)
            prune_unseen_slots(state)
        parent = model.part(0)
        grids = max(0, parent.grids - state.context.config.model.grid_drop)
        child = coarser_part(model, parent, parent.mask.clone(), grids)
        if self.levels.ablation == "lad":
            _drop_local_branch(model, child)
        model.parts.insert(0, child)
        logits = torch.full((len(model), model.slots), MASK_START, device=model.offsets.device)
        state.mask_logits = nn.Parameter(logits)
        state.progress.sparsity = sparsity[min(self.below, len(sparsity) - 1)]

    def make_optimizer(self, state: TrainState) -> Optimizer:
        """Masks, and what the ablation lets adapt; everything shared stays frozen."""
        model, kinds = state.model, TRAINED[self.levels.ablation]
        own = part_parameters(model.part(0), "", level_scale=False)
        parameters = {
            name: p
            for name, p in own.items()
            if ("codebook" if name == "codebook" else "networks") in kinds
        }
        parameters["mask_logits"] = state.mask_logits
        rates = rates_of(parameters, state.context.rates, model.frame.extent, False)
        scaled = {n: (a * RESTART, min(b, a * RESTART)) for n, (a, b) in rates.items()}
        hurry = max(1.0, MASK_STEPS / self.steps)
        first, final = rates["mask_logits"]
        scaled["mask_logits"] = (first * hurry, final * hurry)
        return Optimizer(parameters, scaled)

    def step(self, state: TrainState) -> None:
        """A batch of views at the level's resolution; masks move until they are hardened."""
        number, child = state.progress.step + 1, state.model.part(0)
        scale = level_scale(state.context.config, self.level)
        learning = WARM_UP * self.steps < number <= math.floor(HARDEN * self.steps)
        mask = LearntMask(state.mask_logits, MASK_THRESHOLD) if learning else None
        for view in synced_views(state, next_views(state)):
            if mask is None:
                train_view(state, child, view, scale)
                continue
            penalty = partial(self._sparsity, state, mask)
            train_view(state, child, view, scale, mask=mask, penalty=penalty)
        state.optimizer.set_progress(number / self.steps)
        state.optimizer.step()
        if learning:
            self._steer(state, number)
        if number == math.floor(HARDEN * self.steps):
            child.mask = self._hardened(state)

    def end(self, state: TrainState) -> None:
        """The mask is part of the child now."""
        state.mask_logits = no_logits(state.mask_logits.device)

    def _sparsity(self, state: TrainState, mask: LearntMask, decoded: Decoded) -> Tensor:
        """Loss [] that drives the masks of the anchors in view towards zero."""
        rows, child = decoded.anchors, state.model.part(0)
        loss = sparsity_loss(mask.logits[rows], child.mask[rows], self.levels.group_weight)
        return state.progress.sparsity * loss

    def _steer(self, state: TrainState, number: int) -> None:
        """Masks fall below ε during training too; λ_s follows the target (§1.11.6)."""
        every = max(1, round(self.steps * CONTROL_EVERY))
        if self.levels.selection != "controller" or number % every:
            return
        kept = float(_live(state).any(dim=1).sum() / _parent_anchors(state))
        target = keep_target(number, self.steps, self.levels.keep[self.below])
        factor = math.exp(2 * (kept - target))
        state.progress.sparsity = min(max(state.progress.sparsity * factor, 1e-6), 1e-1)

    def _hardened(self, state: TrainState) -> Tensor:
        """The child's mask: by the threshold ε (paper), or by rank to the exact keep ratio."""
        child, live = state.model.part(0), _live(state)
        if self.levels.selection == "lambda":
            return live if bool(live.any()) else child.mask
        logits = state.mask_logits.detach().masked_fill(~child.mask, -torch.inf)
        scores = logits.amax(dim=1)
        count = max(1, round(self.levels.keep[self.below] * _parent_anchors(state)))
        best = torch.sort(scores, descending=True, stable=True).indices[:count]
        rows = torch.zeros(len(scores), dtype=torch.bool, device=scores.device)
        rows[best] = True
        # An anchor that is kept by rank keeps its best slot even below the threshold.
        top = torch.nn.functional.one_hot(logits.argmax(dim=1), child.mask.shape[1]).bool()
        return (live | top) & child.mask & rows[:, None]


def _live(state: TrainState) -> Tensor:
    """Slots of the child that are over the threshold, bool [N, K]."""
    return LearntMask(state.mask_logits, MASK_THRESHOLD).live() & state.model.part(0).mask


def _parent_anchors(state: TrainState) -> int:
    return int(state.model.part(1).mask.any(dim=1).sum())


def _drop_local_branch(model: AnchorModel, child: LevelPart) -> None:
    """LAD alone has no local features: its codebook has zero columns (§1.12)."""
    start = child.grids * model.layout.features
    width = child.codebook.shape[1]
    networks = without_columns(dict(child.networks.items()), start, start + width)
    child.networks = nn.ParameterDict({n: nn.Parameter(w) for n, w in networks.items()})
    child.codebook = nn.Parameter(child.codebook.detach()[:, :0].clone())


def keep_target(step: int, steps: int, keep: float) -> float:
    """Share of anchors to be alive: 1 until 5 % of the steps, `keep` from 65 % (§1.11.6)."""
    return cosine(1.0, keep, (step / steps - 0.05) / 0.6)


def cosine(start: float, end: float, progress: float) -> float:
    """From start to end along half a cosine; progress is clamped to [0, 1]."""
    p = min(max(progress, 0.0), 1.0)
    return end + (start - end) * 0.5 * (1 + math.cos(math.pi * p))
