"""The paper's way: one coarser level after the other, shared tensors frozen (§1.11–§1.13)."""

import math

import torch
from torch import Tensor, nn

from gsynopsis.config import level_scale
from gsynopsis.model.anchors import AnchorModel, LearntMask, LevelPart
from gsynopsis.model.build import freeze_codes
from gsynopsis.model.heads import without_columns
from gsynopsis.model.levels import child_part
from gsynopsis.train.joint import drop_dead_slots
from gsynopsis.train.losses import sparsity_loss
from gsynopsis.train.optimiser import Optimiser
from gsynopsis.train.schedule import keep_target
from gsynopsis.train.trainer import Trainer, part_parameters, rates_of

WARM_UP = 0.05
"""Fraction of the steps in which only codebook and heads adapt: grids have just vanished."""
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
"""What adapts per ablation (§1.12); masks always do."""


class UnfoldPhase:
    """Makes level `level` out of `level + 1`: drop grids, learn masks, adapt."""

    settles = True

    def __init__(self, level: int, steps: int, last: int) -> None:
        """`last` is the finest level's number."""
        self.level, self.steps, self.last = level, steps, last
        self.name = f"unfold L{level}"

    def begin(self, trainer: Trainer) -> None:
        """The child starts as its parent without the finest grids."""
        model, settings = _model(trainer), trainer.config.levels
        if self.level == self.last - 1:
            freeze_codes(model)
            drop_dead_slots(trainer)
        parent = model.part(0)
        grids = max(0, parent.grids - trainer.config.model.grid_drop)
        child = child_part(model, parent, parent.mask.clone(), grids)
        if settings.ablation == "lad":
            _drop_local_branch(model, child)
        model.parts.insert(0, child)
        trainer.mask_logits = _fresh_logits(model)
        below = self.last - 1 - self.level
        trainer.cursor.sparsity = settings.sparsity[min(below, len(settings.sparsity) - 1)]

    def make_optimiser(self, trainer: Trainer) -> Optimiser:
        """Masks, and what the ablation lets adapt; everything shared stays frozen."""
        model, settings = _model(trainer), trainer.config.levels
        if trainer.mask_logits is None:
            trainer.mask_logits = _fresh_logits(model)
        kinds = TRAINED[settings.ablation]
        own = part_parameters(model.part(0), "", settings.learns_scale and "networks" in kinds)
        parameters = {
            name: p
            for name, p in own.items()
            if ("codebook" if name == "codebook" else "networks") in kinds
        }
        parameters["mask_logits"] = trainer.mask_logits
        rates = rates_of(parameters, trainer.rates, model.frame.extent, False)
        scaled = {n: (a * RESTART, min(b, a * RESTART)) for n, (a, b) in rates.items()}
        hurry = max(1.0, MASK_STEPS / self.steps)
        first, final = rates["mask_logits"]
        scaled["mask_logits"] = (first * hurry, final * hurry)
        return Optimiser(parameters, scaled)

    def step(self, trainer: Trainer) -> None:
        """A batch of views at the level's resolution; masks move until they are hardened."""
        assert trainer.optimiser is not None and trainer.mask_logits is not None
        model, settings = _model(trainer), trainer.config.levels
        number, child = trainer.cursor.step + 1, model.part(0)
        scale = level_scale(trainer.config, self.level)
        learning = WARM_UP * self.steps < number <= math.floor(HARDEN * self.steps)
        learnt = None
        if learning:
            learnt = LearntMask(trainer.mask_logits, MASK_THRESHOLD)
        for view in trainer.batch(trainer.next_views()):
            outcome = trainer.forward(child, view, scale, learnt)
            loss = outcome.loss
            if learnt is not None:
                rows = outcome.decoded.anchors
                push = sparsity_loss(learnt.logits[rows], child.mask[rows], settings.group_weight)
                loss = loss + trainer.cursor.sparsity * push
            trainer.learn(loss, outcome, view)
        trainer.optimiser.set_progress(number / self.steps)
        trainer.optimiser.step()
        if learning:
            self._steer(trainer, number)
        if number == math.floor(HARDEN * self.steps):
            child.mask = self._hardened(trainer)

    def end(self, trainer: Trainer) -> None:
        """The mask is part of the child now."""
        trainer.mask_logits = None

    def _steer(self, trainer: Trainer, number: int) -> None:
        """Masks fall below ε during training too; λ_s follows the target (§1.11.6)."""
        every = max(1, round(self.steps * CONTROL_EVERY))
        if trainer.config.levels.selection != "controller" or number % every:
            return
        kept = float(self._live(trainer).any(dim=1).sum() / self._parent_anchors(trainer))
        target = keep_target(number, self.steps, self._ratio(trainer))
        factor = math.exp(2 * (kept - target))
        trainer.cursor.sparsity = min(max(trainer.cursor.sparsity * factor, 1e-6), 1e-1)

    def _hardened(self, trainer: Trainer) -> Tensor:
        """The child's mask: by the threshold ε (paper), or by rank to the exact keep ratio."""
        settings, child = trainer.config.levels, _model(trainer).part(0)
        live = self._live(trainer)
        if settings.selection == "lambda":
            return live if bool(live.any()) else child.mask
        assert trainer.mask_logits is not None
        scores = trainer.mask_logits.detach().masked_fill(~child.mask, -torch.inf).amax(dim=1)
        count = max(1, round(self._ratio(trainer) * self._parent_anchors(trainer)))
        best = torch.sort(scores, descending=True, stable=True).indices[:count]
        rows = torch.zeros(len(scores), dtype=torch.bool, device=scores.device)
        rows[best] = True
        # An anchor that is kept by rank keeps its best slot even below the threshold.
        top = torch.nn.functional.one_hot(
            trainer.mask_logits.detach().masked_fill(~child.mask, -torch.inf).argmax(dim=1),
            child.mask.shape[1],
        ).bool()
        return (live | top) & child.mask & rows[:, None]

    def _live(self, trainer: Trainer) -> Tensor:
        assert trainer.mask_logits is not None
        learnt = LearntMask(trainer.mask_logits, MASK_THRESHOLD)
        return learnt.live() & _model(trainer).part(0).mask

    def _ratio(self, trainer: Trainer) -> float:
        return trainer.config.levels.keep[self.last - 1 - self.level]

    def _parent_anchors(self, trainer: Trainer) -> int:
        return int(_model(trainer).part(1).mask.any(dim=1).sum())


def _fresh_logits(model: AnchorModel) -> nn.Parameter:
    logits = torch.full((len(model), model.slots), MASK_START, device=model.offsets.device)
    return nn.Parameter(logits)


def _drop_local_branch(model: AnchorModel, child: LevelPart) -> None:
    """LAD alone has no local features: its codebook has zero columns (§1.12)."""
    start = child.grids * model.layout.features
    width = child.codebook.shape[1]
    networks = without_columns(dict(child.networks.items()), start, start + width)
    child.networks = nn.ParameterDict({n: nn.Parameter(w) for n, w in networks.items()})
    child.codebook = nn.Parameter(child.codebook.detach()[:, :0].clone())


def _model(trainer: Trainer) -> AnchorModel:
    assert trainer.model is not None
    return trainer.model
