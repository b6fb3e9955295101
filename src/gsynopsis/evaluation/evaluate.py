"""The evaluator: any decoder of levels, a scene, any renderer → one report."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import fmean
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.container import measure
from gsynopsis.errors import SceneError
from gsynopsis.evaluation.environment import this_build, this_machine
from gsynopsis.evaluation.masked_psnr import psnr_exposed, psnr_inside
from gsynopsis.evaluation.metrics import Image8, LearntMeasure, flip, psnr, ssim
from gsynopsis.evaluation.protocols import Decoder, LevelRenderer, Options
from gsynopsis.evaluation.report import (
    AtPhotoSize,
    LevelScore,
    Pictures,
    Quality,
    Report,
    Timing,
    ViewScore,
)
from gsynopsis.evaluation.timing import time_levels
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Renderer
from gsynopsis.scene.scene import Scene


def evaluate(
    decoder: Decoder,
    levels: LevelSet,
    scene: Scene,
    renderer: Renderer,
    factor: float = 1.0,
    options: Options | None = None,
) -> Report:
    """Measure quality, size and speed of every level on the held-out views.

    Args:
        decoder: Decodes the levels of `levels`.
        levels: Counts and bytes are taken from here.
        scene: Its held-out views are the truth.
        renderer: Renders.
        factor: The scale of the run: photos are divided by this for the `full` figures.
        options: How to evaluate.

    Raises:
        SceneError: the scene holds out no view.
        DivergedError: a rendering is not finite.
    """
    options = options or Options()
    if not scene.test:
        raise SceneError(scene.name, "split", found="no held-out view", expected="at least one")
    painter = LevelRenderer(decoder, renderer)
    count = len(levels.levels)
    with torch.no_grad():
        views, pictures = _compare_views(painter, scene, count, factor, options)
        cameras = [scene.camera(view, factor) for view in scene.test]
        views, photo = _at_photo_size(painter, scene, views, factor, options)
        seen = train_views(scene)
        trained = _on_train(painter, scene, seen, count, factor, options)
        timings = time_levels(painter, cameras, count, options.warmup, options.frames)
    return Report(
        scene=scene.name,
        fingerprint=scene.fingerprint(),
        scale=factor,
        width=cameras[0].width,
        height=cameras[0].height,
        notes=scene.notes,
        account=scene.account,
        provenance=options.provenance,
        renderer=renderer.name,
        lpips=options.lpips.name if options.lpips else None,
        machine=this_machine(renderer.device),
        build=this_build(),
        levels=tuple(_score_levels(levels, scene, factor, views, timings, trained)),
        views=tuple(views),
        pictures=tuple(pictures),
        photo=photo,
        train_views=(len(seen), len(scene.train)),
    )


def measure_quality(
    decoder: Decoder,
    levels: LevelSet,
    scene: Scene,
    renderer: Renderer,
    factor: float,
    tick: Callable[[int, int], None] | None = None,
) -> tuple[tuple[int, int], list[Quality]]:
    """Quality of every level on the held-out views at the training resolution, and nothing else.

    Inside of the photos' masks too, where they have any.

    Args:
        decoder: Decodes the levels of `levels`.
        levels: How many there are.
        scene: Its held-out views are the truth.
        renderer: Renders.
        factor: Photos are divided by this.
        tick: Called after each view with the views done and the views in all.

    Returns:
        Width and height of the first view, pixels, and the mean quality of each level.

    Raises:
        DivergedError: a rendering is not finite.
    """
    options = Options(tick=tick, pictures=0)
    painter = LevelRenderer(decoder, renderer)
    count = len(levels.levels)
    with torch.no_grad():
        views, _ = _compare_views(painter, scene, count, factor, options)
    camera = scene.camera(scene.test[0], factor)
    means = [mean_quality([v.quality for v in views if v.level == k]) for k in range(count)]
    return (camera.width, camera.height), means


class Measured(NamedTuple):
    """One image against one truth."""

    psnr: float
    ssim: float
    lpips: float | None
    flip: float | None


def own_scale(factor: float, level: int, count: int) -> float:
    """The scale at which level `level` of `count` is measured in the `own` protocol."""
    return factor * 2.0 ** (count - 1 - level)


def mean_quality(qualities: Sequence[Quality]) -> Quality:
    """Each measure averaged over views; a learnt one only if all views have it.

    The photos' own size may be measured on some of them, and some have no mask; then the mean is
    over those that have it.
    """
    return Quality(
        psnr_full=fmean(q.psnr_full for q in qualities),
        ssim_full=fmean(q.ssim_full for q in qualities),
        psnr_own=fmean(q.psnr_own for q in qualities),
        ssim_own=fmean(q.ssim_own for q in qualities),
        lpips_full=_mean_of_all([q.lpips_full for q in qualities]),
        lpips_own=_mean_of_all([q.lpips_own for q in qualities]),
        psnr_photo=_mean_of_some([q.psnr_photo for q in qualities]),
        flip_full=_mean_of_all([q.flip_full for q in qualities]),
        flip_own=_mean_of_all([q.flip_own for q in qualities]),
        psnr_masked=_mean_of_some([q.psnr_masked for q in qualities]),
        psnr_exposed=_mean_of_some([q.psnr_exposed for q in qualities]),
    )


def _mean_of_all(values: Sequence[float | None]) -> float | None:
    """The mean; None where one is missing."""
    there = [value for value in values if value is not None]
    return fmean(there) if len(there) == len(values) else None


def _mean_of_some(values: Sequence[float | None]) -> float | None:
    """The mean of those that are there; None without any."""
    there = [value for value in values if value is not None]
    return fmean(there) if there else None


def evenly(items: Sequence[int], count: int) -> tuple[int, ...]:
    """At most `count` of the items, evenly apart, ends included when there are two or more."""
    if count >= len(items):
        return tuple(items)
    if count == 1:
        return (items[len(items) // 2],)
    step = (len(items) - 1) / max(1, count - 1)
    return tuple(items[round(i * step)] for i in range(count))


def _compare_views(
    painter: LevelRenderer, scene: Scene, count: int, factor: float, options: Options
) -> tuple[list[ViewScore], list[Pictures]]:
    scores: list[ViewScore] = []
    pictures: list[Pictures] = []
    device = painter.renderer.device
    chosen = evenly(scene.test, options.pictures)
    for done, view in enumerate(scene.test, start=1):
        name = scene.views[view].name
        truth, inside = scene.image(view, factor), scene.judged(view, factor)
        images = [painter.paint(scene.camera(view, factor), level) for level in range(count)]
        for level, image in enumerate(images):
            full = own = _compare(image, truth, options.lpips, device)
            scale = own_scale(factor, level, count)
            if scale != factor:
                small = painter.paint(scene.camera(view, scale), level)
                own = _compare(small, scene.image(view, scale), options.lpips, device)
            quality = _adjusted(_both(full, own), image, truth, inside, options.exposure)
            scores.append(ViewScore(name, level, quality))
        if view in chosen:
            pictures.append(Pictures(name, truth, tuple(images)))
        if options.tick:
            options.tick(done, len(scene.test))
    return scores, pictures


def _adjusted(
    quality: Quality, image: Image8, truth: Image8, inside: NDArray[np.bool_] | None, exposed: bool
) -> Quality:
    """The figures with those of the part inside a mask, and without the photo's exposure."""
    if inside is not None:
        quality = replace(quality, psnr_masked=psnr_inside(image, truth, inside))
    if exposed:
        quality = replace(quality, psnr_exposed=psnr_exposed(image, truth, inside))
    return quality


def photo_views(scene: Scene, levels: int, pixels: int) -> tuple[int, ...]:
    """Held-out views to compare at their photos' own size: all, or as many as a budget allows.

    Args:
        scene: Whose.
        levels: Images to render of each.
        pixels: Most pixels of all images together; 0: no view. At least one otherwise.
    """
    if not pixels:
        return ()
    cameras = [scene.camera(view, 1.0) for view in scene.test]
    each = levels * max(camera.width * camera.height for camera in cameras)
    return evenly(scene.test, max(1, pixels // each))


def _at_photo_size(
    painter: LevelRenderer,
    scene: Scene,
    scores: list[ViewScore],
    factor: float,
    options: Options,
) -> tuple[list[ViewScore], AtPhotoSize | None]:
    """The scores with their `photo` figures, and what these were measured on."""
    camera = scene.camera(scene.test[0], 1.0)
    if factor == 1.0:
        size = AtPhotoSize(camera.width, camera.height, len(scene.test), len(scene.test))
        return [_with_photo(score, score.quality.psnr_full) for score in scores], size
    count = 1 + max(score.level for score in scores)
    chosen = photo_views(scene, count, options.photo_pixels)
    if not chosen:
        return scores, None
    found: dict[tuple[str, int], float] = {}
    for done, view in enumerate(chosen, start=1):
        name, camera, truth = (
            scene.views[view].name,
            scene.camera(view, 1.0),
            scene.image(view, 1.0),
        )
        for level in range(count):
            found[name, level] = psnr(painter.paint(camera, level), truth)
        if options.tick:
            options.tick(done, len(chosen))
    camera = scene.camera(chosen[0], 1.0)
    size = AtPhotoSize(camera.width, camera.height, len(chosen), len(scene.test))
    return [_with_photo(score, found.get((score.view, score.level))) for score in scores], size


def train_views(scene: Scene) -> tuple[int, ...]:
    """Training views to compare beside the held-out ones: at most as many, evenly apart.

    None where the held-out views are training views themselves (split `none`).
    """
    return () if set(scene.test) <= set(scene.train) else evenly(scene.train, len(scene.test))


def _on_train(
    painter: LevelRenderer,
    scene: Scene,
    views: Sequence[int],
    count: int,
    factor: float,
    options: Options,
) -> list[tuple[float | None, float | None]]:
    """Each level's mean PSNR on training views, and inside their masks; None where none counts."""
    whole: list[list[float]] = [[] for _ in range(count)]
    masked: list[list[float | None]] = [[] for _ in range(count)]
    for done, view in enumerate(views, start=1):
        truth = scene.image(view, factor)
        inside = scene.judged(view, factor)
        for level in range(count):
            image = painter.paint(scene.camera(view, factor), level)
            whole[level].append(psnr(image, truth))
            masked[level].append(None if inside is None else psnr_inside(image, truth, inside))
        if options.tick:
            options.tick(done, len(views))
    return [(_mean_of_some(whole[k]), _mean_of_some(masked[k])) for k in range(count)]


def _with_photo(score: ViewScore, value: float | None) -> ViewScore:
    return replace(score, quality=replace(score.quality, psnr_photo=value))


def _compare(
    image: Image8, truth: Image8, learnt: LearntMeasure | None, device: torch.device
) -> Measured:
    distance = learnt.distance(image, truth) if learnt else None
    similar = ssim(image, truth, device)
    return Measured(psnr(image, truth), similar, distance, flip(image, truth))


def _both(full: Measured, own: Measured) -> Quality:
    return Quality(
        psnr_full=full.psnr,
        ssim_full=full.ssim,
        psnr_own=own.psnr,
        ssim_own=own.ssim,
        lpips_full=full.lpips,
        lpips_own=own.lpips,
        flip_full=full.flip,
        flip_own=own.flip,
    )


def _score_levels(
    levels: LevelSet,
    scene: Scene,
    factor: float,
    views: Sequence[ViewScore],
    timings: Sequence[Timing],
    trained: Sequence[tuple[float | None, float | None]],
) -> list[LevelScore]:
    sizes, count = measure(levels), len(levels.levels)
    own = [scene.camera(scene.test[0], own_scale(factor, k, count)) for k in range(count)]
    return [
        LevelScore(
            level=number,
            anchors=level.anchors,
            slots=level.live,
            own_scale=own_scale(factor, number, count),
            own_size=(own[number].width, own[number].height),
            quality=mean_quality([v.quality for v in views if v.level == number]),
            sizes=sizes[number],
            timing=timings[number],
            psnr_train=trained[number][0],
            psnr_train_masked=trained[number][1],
        )
        for number, level in enumerate(levels.levels)
    ]
