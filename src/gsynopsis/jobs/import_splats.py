"""`gsynopsis import`: Gaussians that another program trained, as a nested file.

Coarse levels are stand-ins (`fit_stand_ins`), trained as seen from cameras, given or found
(`cameras`); then come the quarter and the half of the input that matter most, where these show
more, and the last level is the input.
Quality of each level is measured against pictures of the input, and is a note of the file as that
of trained ones, unless too many of the cameras see nothing.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from gsynopsis import __version__
from gsynopsis._native.runtime import one_torch_thread, release_freed
from gsynopsis.cameras.orbit import circle_of_cameras, circle_text, first_text, first_view
from gsynopsis.cameras.placement import shown
from gsynopsis.cameras.sheet import sheet_path
from gsynopsis.cameras.viewpoints import Viewpoints
from gsynopsis.container.edit import annotated
from gsynopsis.container.reader import decode
from gsynopsis.container.writer import encode_with_account, publish
from gsynopsis.errors import InputError, SettingError
from gsynopsis.evaluation.metrics import Image8, psnr, ssim
from gsynopsis.formats.axes import DOWN, Up, up_text
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.jobs.fit_stand_ins import STEPS, fit_stand_ins
from gsynopsis.jobs.manifest_notes import poster_of, shift_text
from gsynopsis.jobs.splat_views import (
    evenly,
    known_cameras,
    painted,
    sheet_of,
    splat_views,
)
from gsynopsis.model.splat_levels import Steps, levels_with_stand_ins, splat_levels
from gsynopsis.model.splats import SplatModel, SplatPart, decoder_of
from gsynopsis.model.training_focals import focals_text
from gsynopsis.records import (
    FIRST_NOTE,
    FOCALS_NOTE,
    ORBIT_NOTE,
    POSTER_NOTE,
    SHIFT_NOTE,
    LevelSet,
    PlainGaussians,
)
from gsynopsis.render.base import ANTIALIASED, Renderer
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.stream.download import downloaded, is_address
from gsynopsis.teacher.ranking import most_worth, worth_of, worth_of_few
from gsynopsis.teacher.renders import Tick

BASE_SHARE = 0.04
"""Share of the splats in level 0 of a draft: with what else it holds less than 5 % of the bytes."""
STAND_INS = (0.02, 0.15)
"""Stand-ins of the first and the last coarse level, in shares of the splats (ours)."""
OWN_SHARES, STAND_INS_LEAST = (0.25, 0.5), 2
"""Shares of the input's own splats that levels after the stand-ins have, and how many levels of
stand-ins come before any of them (ours)."""
DRAWN = 2**-0.5
"""Share of the splats, those that show most, in images that no figure depends on (ours)."""
PAYS = 1.0
"""dB that such a level shows more than what comes before it, or it is left out."""
STAND_INS_MOST = 300_000
"""Stand-ins at most: renders of this size can not tell more apart."""
ROUNDING = Steps(position=1 / 8, stages=6, books=1 / 10)
"""Rounding steps: half the usual for positions, +2 dB for 4 % of bytes at 1.7 M splats; larger
codebooks of harmonics, +1.4 to 2.9 dB for 6 to 14 % of bytes below 40,000 splats; six codes in
place of four, +0.7 to 2.4 dB for 6 to 12 % (ours)."""
MEMORY, MEMORY_EACH, COPIES = 300 << 20, 500, 5.5
"""Bytes that an import takes, those for each splat, and how often its harmonics beyond the first
are held: 430 (13.6 million splats) to 540 (3.4 million) of degree 0, 0.5 million of degree 2."""
LEVELS, LEVELS_MAX = 6, 8
STEPS_MOST = 100_000
TOUR_VIEWS, RANKING_VIEWS, QUALITY_VIEWS = 12, 32, 8
"""Cameras for the orbit; from which splats are ranked; for figures of the file, none of
these."""
ALL_VIEWS = RANKING_VIEWS + QUALITY_VIEWS
VIEWS_SIDE = 480
"""Longer side of their pictures, pixels."""
GAINS = (1.0, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0)
"""Factors on the scales of a coarse level's splats that are tried."""
GAIN_VIEWS = 3


@dataclass(frozen=True)
class Imported:
    """Result of an import.

    Attributes:
        path: The file.
        kind: Format of the input.
        splats: Splats of each level, coarsest first.
        ends: Bytes up to the end of each level.
        psnr: Of each level against pictures of the input, dB; empty if it would tell little.
        up: World direction away from the ground, unit length.
        notes: What was assumed and what was not used, a line each.
        sheet: The contact sheet of the cameras; None of a draft.
    """

    path: Path
    kind: str
    splats: tuple[int, ...]
    ends: tuple[int, ...]
    psnr: tuple[float, ...]
    up: Up = DOWN
    notes: tuple[str, ...] = ()
    sheet: Path | None = None


@one_torch_thread()
def import_splats(  # noqa: PLR0913 -- a public call with flat keywords
    source: Path | str,
    out: Path | str,
    levels: int = LEVELS,
    *,
    up: Up | None = None,
    cameras: Path | str | None = None,
    overwrite: bool = False,
    steps: int = STEPS,
    draft: bool = False,
    tick: Tick | None = None,
) -> Imported:
    """Write Gaussians of another program as a nested `.gsyn` file.

    Args:
        source: A PLY, compressed PLY, SPZ, SOG, GLB, USD, .splat or .ksplat file, or a
            `lod-meta.json`; or the http address of such a file, which is downloaded and, when it
            has been read, removed.
        out: The file.
        levels: How many at most; 1 to 8. Of a draft as many as the source has, if it has several.
        up: Away from the ground in the axes of the source; None: as the file says, else as found.
        cameras: A cameras.json of 3DGS, a COLMAP model or a transforms.json of the same world;
            None: those beside the source, else such as are found.
        overwrite: Replace a file that is there.
        steps: Of training coarse levels; 0: those are the input's own splats, as many as matter
            most.
        draft: In less than half the time, to look at and not to keep: splats are ranked by size
            and opacity instead of what they show, nothing is trained or measured, no contact sheet
            is made.
        tick: Told of progress.

    Raises:
        InputError: the source holds no Gaussians that can be used or is only fog, `cameras` see
            nothing of it, or `out` is there.
        SpaceError: the disk has no room.
    """
    out = Path(out)
    if not 1 <= levels <= LEVELS_MAX:
        raise SettingError("--levels", found=levels, expected=f"1 to {LEVELS_MAX}")
    if not 0 <= steps <= STEPS_MOST:
        raise SettingError("--steps", found=steps, expected=f"0 to {STEPS_MOST}")
    if out.exists() and not overwrite:
        advice = "choose another --out, or --overwrite"
        raise InputError(out, found="a file", expected="nothing", advice=advice)
    told = tick or (lambda what, done, total: None)
    with ExitStack() as kept:
        if is_address(source):
            folder = Path(kept.enter_context(TemporaryDirectory()))
            source = downloaded(str(source), folder, partial(told, "downloading"))
        source = Path(source)
        known = known_cameras(source, cameras)
        given = read_splats(source)
    release_freed()
    told("reading", 1, 1)
    if line := memory_line(given):
        told(line, 1, 1)
    found = splat_views(given, source, known, up, ALL_VIEWS, VIEWS_SIDE)
    told("finding cameras", 1, 1)
    given = replace(given, up=found.up)
    if steps and not draft and levels > 1:
        given = without_coarse(given)
    return _imported(given, source.name, out, levels, found, None if draft else steps, told)


def _imported(
    given: SplatFile,
    name: str,
    out: Path,
    levels: int,
    found: Viewpoints,
    steps: int | None,
    tick: Tick,
) -> Imported:
    """Write the file from cameras that are found; without `steps` as a draft."""
    # Each stage has a renderer of its own, as a frame's memory is more than the input's.
    finest = given.levels[-1]
    truth = splat_model(given)
    cameras, views = ranking_and_quality(found)
    counts, notes = counts_of(given, levels, fitted=bool(steps))
    coarse = [n for n in counts if n < own_counts(len(finest), levels)[0]] if steps else []
    worth = among = shown(finest)
    if steps is not None:
        among, worth = ranked(truth, among, counts[len(coarse)], cameras, tick)
        # Level 0 of the input from here on, which stand-ins, poster and sheet are drawn of.
        truth.parts.insert(0, most_showing(truth, worth))
    seen = [] if steps is None else views
    pictures = [painted(truth, -1, camera, make_renderer("cpu")) for camera in seen]
    meta = notes_of(given, name, truth, found, make_renderer("cpu"))
    if steps and coarse:
        fitted = fit_stand_ins(finest, truth, among, coarse, cameras, tick, steps)
        own, lines = that_pay(truth, worth, fitted, counts[len(coarse) :], views, pictures, tick)
        notes = [*notes, *lines]
        made = levels_with_stand_ins(finest, worth, fitted, coarse, own, meta, ROUNDING)
    else:
        made = splat_levels(finest, worth, counts, meta, ROUNDING, given.environment)
        made = with_gains(
            made, cameras[:: -(-len(cameras) // GAIN_VIEWS)], truth, make_renderer("cpu"), tick
        )
    release_freed()
    data, account = encode_with_account(made, where=str(out))
    splats = tuple(level.anchors - made.first_shown(k) for k, level in enumerate(made.levels))
    del made  # as much memory as the input
    decoder = decoder_of(decode(data, str(out)))
    assert isinstance(decoder, SplatModel)
    reason = "a draft" if steps is None else found.doubt
    if reason:
        figures, protocol = [{} for _ in splats], {"protocol": f"not measured: {reason}"}
    else:
        figures = measured(decoder, pictures, views, make_renderer("cpu"), tick)
        protocol = _protocol(found, views)
    doubt = [f"no dB: {found.doubt}"] if found.doubt and steps is not None else []
    told = (*given.notes, *found.lines, *notes, *doubt)
    publish(annotated(data, protocol, figures, str(out)), out)
    sheet = None if steps is None else sheet_path(out)
    if sheet is not None:
        publish(sheet_of(truth, found, make_renderer("cpu")), sheet)
    psnrs = tuple(figure["psnr_full"] for figure in figures if figure)
    return Imported(out, given.kind, splats, account.ends, psnrs, given.up, told, sheet)


def ranked(
    truth: SplatModel, prior: np.ndarray, least: int, cameras: Sequence[Camera], tick: Tick
) -> tuple[np.ndarray, np.ndarray]:
    """Contribution of each splat among all others, and among fewer down to `least`, [G] each."""
    among = worth_of(truth, prior, cameras, make_renderer("cpu"), tick)
    worth = worth_of_few(truth, among, least, cameras, make_renderer("cpu"), tick)
    release_freed()
    return among, worth


def most_showing(truth: SplatModel, worth: np.ndarray) -> SplatPart:
    """The part of a model that shows most, to be drawn in less time."""
    return most_worth(truth.part(-1), worth, max(1, round(DRAWN * len(worth))))


def memory_needed(given: SplatFile) -> int:
    """Bytes of memory that an import takes at most, about, with what is read already."""
    finest = given.levels[-1]
    return MEMORY + round(MEMORY_EACH * len(finest) + COPIES * finest.sh[:, 1:].nbytes)


def memory_line(given: SplatFile) -> str:
    """The memory that splats take, for people; "" where it is less than 1 GiB."""
    needed = memory_needed(given)
    if needed < 1 << 30:
        return ""
    return f"{len(given.levels[-1]):,} splats, about {needed / (1 << 30):.1f} GiB of memory"


def without_coarse(given: SplatFile) -> SplatFile:
    """The finest level alone, with a line on the others."""
    if len(given.levels) == 1:
        return given
    line = "coarser levels of the file's own: not used, ours are trained"
    return replace(given, levels=given.levels[-1:], notes=(*given.notes, line))


def ranking_and_quality(found: Viewpoints) -> tuple[list[Camera], list[Camera]]:
    """Cameras from which splats are ranked, and others for figures, their pictures small enough."""
    cameras = [camera.within(VIEWS_SIDE) for camera in found.cameras]
    if len(cameras) == 1:
        return cameras, cameras
    every = max(2, ALL_VIEWS // QUALITY_VIEWS)
    held = cameras[every - 1 :: every] or cameras[-1:]
    rest = [camera for number, camera in enumerate(cameras) if (number + 1) % every] or cameras
    return evenly(rest, RANKING_VIEWS), evenly(held, QUALITY_VIEWS)


def counts_of(given: SplatFile, levels: int, *, fitted: bool) -> tuple[list[int], list[str]]:
    """Splats of each level, and lines where these are not the levels of the file or asked for.

    Each has more than the last. Where nothing is fitted they are those of the file's own levels.
    """
    total, lines = len(given.levels[-1]), list[str]()
    if fitted and levels > 1:
        own = own_counts(total, levels)
        counts = [*stand_in_counts(total, levels - len(own)), *own]
    elif len(given.levels) > 1:
        levels = len(given.levels)
        counts = [min(len(level), total) for level in given.levels]
    elif levels == 1:
        counts = [total]
    else:
        shares = BASE_SHARE ** (1 - np.arange(levels) / (levels - 1))
        counts = [max(1, given.environment, round(total * float(share))) for share in shares]
    rising: list[int] = np.unique(np.maximum.accumulate(counts)).tolist()
    if len(rising) < levels:
        lines += [f"{len(rising)} of {levels} levels: the others would have no splats of their own"]
    return rising, lines


def own_counts(total: int, levels: int) -> list[int]:
    """Splats of the input in each of the last of so many levels, where the first are stand-ins."""
    most = max(0, levels - 1 - STAND_INS_LEAST)
    shares = OWN_SHARES[len(OWN_SHARES) - min(most, len(OWN_SHARES)) :]
    return [*(max(1, round(share * total)) for share in shares), total]


def that_pay(
    truth: SplatModel,
    worth: np.ndarray,
    stand_ins: PlainGaussians,
    counts: Sequence[int],
    views: Sequence[Camera],
    pictures: Sequence[Image8],
    tick: Tick,
) -> tuple[list[int], list[str]]:
    """Those of some numbers of own splats that show more than what comes before, and lines.

    Args:
        truth: The input's model.
        worth: Of each of its splats [G].
        stand_ins: What comes before the first.
        counts: Splats of each level, rising; the last is G, and is kept.
        views: Cameras, of none of which `worth` is.
        pictures: Of the input from there.
        tick: Told of progress.
    """
    renderer, whole = make_renderer("cpu"), truth.part(-1)
    every = torch.ones(len(stand_ins), 1, dtype=torch.bool)
    drawn = SplatModel(stand_ins, [SplatPart(every, whole.gain, whole.focals)])
    before = _mean_psnr([painted(drawn, 0, camera, renderer) for camera in views], pictures)
    kept, lines = list[int](), list[str]()
    for number, count in enumerate(counts[:-1], start=1):
        truth.parts.append(most_worth(whole, worth, count))
        own = _mean_psnr([painted(truth, -1, camera, renderer) for camera in views], pictures)
        del truth.parts[-1]
        tick("choosing levels", number, len(counts) - 1)
        if own < before + PAYS:
            lines += [
                f"no level of the {count:,} splats that show most: they have {own:.1f} dB, "
                f"the level before {before:.1f}"
            ]
            continue
        kept, before = [*kept, count], own
    return [*kept, counts[-1]], lines


def stand_in_counts(total: int, levels: int) -> list[int]:
    """Stand-ins of each coarse level for so many splats, a geometric row."""
    bound = min(1.0, STAND_INS_MOST / (STAND_INS[1] * total))
    first, last = (bound * share for share in STAND_INS)
    shares = np.geomspace(first, last, levels) if levels > 1 else np.sqrt([first * last])
    return [max(1, round(total * float(share))) for share in shares]


def with_gains(
    made: LevelSet,
    cameras: Sequence[Camera],
    truth: SplatModel,
    renderer: Renderer,
    tick: Tick,
) -> LevelSet:
    """Levels whose splats are as much larger as covers best what is not there yet."""
    pictures = [painted(truth, -1, camera, renderer) for camera in cameras]
    model = decoder_of(made)
    assert isinstance(model, SplatModel)
    levels = list(made.levels)
    for number in range(len(levels) - 1):
        part = model.part(number)
        scores: list[float] = []
        for gain in GAINS:
            part.gain = torch.full((3,), gain)
            own = [painted(model, number, camera, renderer) for camera in cameras]
            scores.append(_mean_psnr(own, pictures))
            if scores[-1] < max(scores) - 0.5:
                break
        best = GAINS[int(np.argmax(scores))]
        levels[number] = replace(levels[number], gain=np.full(3, best, np.float32))
        tick("fitting levels", number + 1, len(levels) - 1)
    return replace(made, levels=tuple(levels))


def notes_of(
    given: SplatFile, name: str, model: SplatModel, found: Viewpoints, renderer: Renderer
) -> dict[str, str]:
    """Notes of the file on itself, its first view and its orbit."""
    tour = list(found.cameras) if found.given else list(found.cameras[:TOUR_VIEWS])
    circle = circle_of_cameras(tour, given.up)
    # Of found cameras the first is that which shows most, well.
    first = (first_view(tour, circle) if found.given else tour[0]).within(VIEWS_SIDE)
    poster = poster_of(painted(model, 0, first, renderer))
    focals = focals_text([ANTIALIASED] * LEVELS_MAX)
    return {
        "scene": Path(name).stem,
        "generator": f"gsynopsis {__version__}",
        "units": f"those of the {given.kind} file",
        "up": up_text(given.up),
        ORBIT_NOTE: circle_text(circle),
        FIRST_NOTE: first_text(first),
        **({FOCALS_NOTE: focals} if given.antialiased else {}),
        **({POSTER_NOTE: poster} if poster else {}),
        **({SHIFT_NOTE: shift_text(given.shift)} if any(given.shift) else {}),
    }


def splat_model(given: SplatFile) -> SplatModel:
    """The finest level of an input, to be rendered."""
    finest = given.levels[-1]
    mask = torch.ones(len(finest), 1, dtype=torch.bool)
    part = SplatPart(mask, torch.ones(3), ANTIALIASED if given.antialiased else None)
    return SplatModel(finest, [part])


def measured(
    decoder: SplatModel,
    pictures: Sequence[Image8],
    views: Sequence[Camera],
    renderer: Renderer,
    tick: Tick,
) -> list[dict[str, float]]:
    """Figures of each level against pictures of the input from the same views."""
    figures: list[dict[str, float]] = []
    for level in range(len(decoder.parts)):
        tick("measuring levels", level + 1, len(decoder.parts))
        own = [painted(decoder, level, camera, renderer) for camera in views]
        figures.append(_figures(own, pictures))
    return figures


def _figures(own: Sequence[Image8], truth: Sequence[Image8]) -> dict[str, float]:
    similar = [ssim(a, b) for a, b in zip(own, truth, strict=True)]
    return {"psnr_full": _mean_psnr(own, truth), "ssim_full": float(np.mean(similar))}


def _mean_psnr(own: Sequence[Image8], truth: Sequence[Image8]) -> float:
    return float(np.mean([psnr(a, b) for a, b in zip(own, truth, strict=True)]))


def _protocol(found: Viewpoints, views: Sequence[Camera]) -> dict[str, str]:
    size, kind = f"{views[0].width} x {views[0].height}", "given" if found.given else "made-up"
    text = (
        f"against pictures of the input from {len(views)} {kind} views, {size}, 8 bits, "
        "black background"
    )
    return {"protocol": text, "pictures": size}
