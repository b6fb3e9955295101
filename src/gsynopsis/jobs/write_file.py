"""Trained levels as one file: coded, measured as a reader gets them, and only then written.

Quality of every level and utility of every block are notes of the file itself, so they are measured
before it is written: streaming policies need them, and no later command changes a file.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from gsynopsis.container import Assembler, describe
from gsynopsis.container.coding import Coding
from gsynopsis.container.edit import annotated
from gsynopsis.container.layout import BLOCK_ROWS_MAX
from gsynopsis.container.notes.block_utility import utility_text
from gsynopsis.container.reader import assembled
from gsynopsis.container.rounding import rounded
from gsynopsis.container.sizes import trained_bytes, trained_text
from gsynopsis.container.spatial import BLOCK_ANCHORS
from gsynopsis.container.writer import encode_with_account, publish
from gsynopsis.errors import SettingError
from gsynopsis.evaluation.block_utility import cameras_of, measure_utilities
from gsynopsis.evaluation.evaluate import evaluate, measure_quality
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Provenance, Report
from gsynopsis.jobs.manifest_notes import Up, quality_notes, training_notes
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.records import TRAINED_NOTE, UTILITY_NOTE, LevelSet, Sensitivity
from gsynopsis.teacher.renders import Tick
from gsynopsis.training.state import TrainState, bring_home

Box = tuple[float, float, float, float, float, float]
"""Low corner, then high corner, world units."""


class FilePacker:
    """File format as the training's size model, in the coding of the result."""

    def sizes(self, levels: LevelSet) -> tuple[int, ...]:
        """Bytes of the file up to the end of each level."""
        return encode_with_account(levels)[1].ends

    def rounded(self, levels: LevelSet, sensitivity: Sensitivity, loss: float) -> LevelSet:
        """These levels with values that a file holds exactly; pictures lose about `loss` dB."""
        return rounded(levels, sensitivity, loss)

    def trained(self, levels: LevelSet) -> list[list[int]]:
        """Bytes of each level in float32: rows as in the paper, the same deflated, a raw file."""
        return trained_bytes(levels)


@dataclass(frozen=True)
class Packing:
    """Options of writing a file.

    Attributes:
        coding: `compact` (few bits, live slots only), or `raw` (float32, exact).
        block: Largest number of anchors of a spatial block; 0 for the default.
        licence: What others may do with the scene, as text that the file carries; "" for none.
        crop: Corners of a box, world units: what lies outside is left out; None: nothing is.
        up: Away from the ground, not zero; None: as the cameras have it.
    """

    coding: Coding = "compact"
    block: int = 0
    licence: str = ""
    crop: Box | None = None
    up: Up | None = None

    def __post_init__(self) -> None:
        if self.block and not 2 <= self.block <= BLOCK_ROWS_MAX:
            expected = f"2 to {BLOCK_ROWS_MAX}, or 0"
            raise SettingError("--block", found=self.block, expected=expected)
        numbers = [*(self.crop or ()), *(self.up or ())]
        if not all(map(math.isfinite, numbers)):
            raise SettingError("--crop, --up", found=numbers, expected="finite numbers")
        if self.up is not None and not any(self.up):
            raise SettingError("--up", found="0 0 0", expected="a direction")
        if self.crop and not all(a < b for a, b in zip(self.crop[:3], self.crop[3:], strict=True)):
            expected = "x y z of the low corner, then of the high one"
            raise SettingError("--crop", found=" ".join(map(str, self.crop)), expected=expected)


def write_draft(state: TrainState, preset: str, path: Path) -> None:
    """Write the present levels of a training, unmeasured, for a page that shows it."""
    publish(_encoded(state, preset, Packing(), path), path)


def write_file(
    state: TrainState,
    preset: str,
    path: Path,
    packing: Packing | None = None,
    *,
    options: Options | None = None,
    tick: Tick | None = None,
) -> Report | None:
    """Write the trained levels with quality and block utilities among their notes.

    Args:
        state: Holds the levels; trained to the end.
        preset: Name of the preset they were trained with.
        path: The file; complete, or as it was.
        packing: How.
        options: Evaluate whole, with these; None measures the quality of levels alone.
        tick: Told of progress.

    Returns:
        The report, if one was ordered.

    Raises:
        SpaceError: the disk has no room.
        DivergedError: a rendering is not finite.
    """
    packing, context = packing or Packing(), state.context
    if packing.crop:
        crop_to(state.model, packing.crop)
    data = _encoded(state, preset, packing, path)
    assembler = assembled(data, str(path))
    levels = assembler.level_set()
    trained = None if packing.crop else state.progress.trained_bytes
    trained = trained or trained_bytes(model_to_levels(state.model, {}))
    sizes = {TRAINED_NOTE: trained_text(trained)}
    levels = replace(levels, meta={**levels.meta, **sizes})
    model = model_from_levels(levels).to(context.renderer.device)
    scale, report = context.config.scale, None
    told = (lambda done, total: tick("evaluating views", done, total)) if tick else None
    if options is None:
        size, quality = measure_quality(model, levels, context.scene, context.renderer, scale, told)
        photo = None
    else:
        options = replace(options, tick=told)
        report = evaluate(model, levels, context.scene, context.renderer, scale, options)
        quality = [score.quality for score in report.levels]
        size, photo = (report.width, report.height), report.photo
    figures = [each.figures() for each in quality]
    split = context.config.split
    notes = quality_notes(split, scale, size, photo, masked=quality[-1].masked)
    utility = block_utilities(assembler, state, tick)
    notes |= sizes | ({UTILITY_NOTE: utility} if utility else {})
    publish(annotated(data, notes, figures, str(path)), path)
    return report and with_sizes(report, path)


def crop_to(model: AnchorModel, box: Box) -> None:
    """Switch off the slots of all levels whose centres lie outside of a box.

    Raises:
        SettingError: nothing lies inside.
    """
    with torch.no_grad():
        places = model.placed()[0][:, None] + model.offsets * model.log_scales[:, None, :3].exp()
        low, high = places.new_tensor(box[:3]), places.new_tensor(box[3:])
        inside = ((places >= low) & (places <= high)).all(dim=2)  # [N, K]
    parts = model.level_parts()
    shown = places[parts[-1].mask]
    for part in parts:
        part.mask = part.mask & inside
    if not parts[-1].mask.any():
        ends = [f"{value:.3g}" for row in shown.aminmax(dim=0) for value in row.tolist()]
        wanted = f"part of {' '.join(ends)}, where the scene is"
        raise SettingError("--crop", found="a box with nothing in it", expected=wanted)


def block_utilities(assembler: Assembler, state: TrainState, tick: Tick | None = None) -> str:
    """The note of what each block improves; empty where there is no choice of blocks.

    Args:
        assembler: Holds all levels of the file.
        state: Its training: scene, scale and renderer.
        tick: Told of progress.
    """
    if max(level.blocks for level in assembler.index.levels) == 1:
        return ""
    context = state.context
    cameras = cameras_of(context.scene, context.config.scale)
    told = (lambda done, total: tick("measuring blocks", done, total)) if tick else None
    return utility_text(measure_utilities(assembler, cameras, context.renderer, told))


def with_sizes(report: Report, path: Path) -> Report:
    """A report with the sizes that the file itself has, if it is packed compactly."""
    if path.stat().st_size >= report.levels[-1].sizes.bytes_raw:
        return report
    infos = describe(path).levels
    if len(infos) != len(report.levels):
        return report
    levels = tuple(
        replace(score, sizes=replace(score.sizes, bytes_compact=now.bytes, delta_compact=now.delta))
        for score, now in zip(report.levels, infos, strict=True)
    )
    return replace(report, levels=levels)


def _encoded(state: TrainState, preset: str, packing: Packing, path: Path) -> bytes:
    bring_home(state)
    meta = training_notes(state, preset, packing.up)
    if packing.licence:
        meta["licence"] = packing.licence
    levels = model_to_levels(state.model, meta)
    block = packing.block or BLOCK_ANCHORS
    return encode_with_account(levels, packing.coding, str(path), block)[0]


def provenance_of(state: TrainState, preset: str, steps: int) -> Provenance:
    """Provenance of a file, for its report."""
    config = state.context.config
    return Provenance(preset, config.train.seed, steps, state.progress.seconds, config.split)
