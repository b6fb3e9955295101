"""The evaluator on a scene whose errors are known."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from gsynopsis.container import measure
from gsynopsis.errors import SceneError
from gsynopsis.evaluation.evaluate import evaluate, evenly, mean_quality, own_scale
from gsynopsis.evaluation.metrics import Image8, LearntMeasure, psnr, ssim, to_bytes
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import AtPhotoSize, Provenance, Quality, Report
from gsynopsis.evaluation.timing import timing_of
from tests.stage import LevelDecoder, fake_scene, level_set, pattern, renderer_of

NOISE = (0.2, 0.1, 0.04, 0.0)


@pytest.fixture(scope="module")
def report() -> Report:
    scene = fake_scene()
    options = Options(
        frames=5, warmup=1, pictures=2, provenance=Provenance("standard", 7, 100, 1.5, "every8")
    )
    return evaluate(LevelDecoder(NOISE), level_set(), scene, renderer_of(scene), 2.0, options)


def expected_quality(level: int, factor: float) -> tuple[float, float]:
    """PSNR and SSIM of the known offset, mean over the held-out views of `fake_scene`."""
    scene = fake_scene()
    rows: list[tuple[float, float]] = []
    for view in scene.test:
        truth = pattern(scene.camera(view, factor), view)
        drawn = to_bytes(torch.tensor(truth.astype(np.float32) / 255.0) + NOISE[level])
        rows.append((psnr(drawn, truth), ssim(drawn, truth)))
    first, second = np.mean(np.array(rows), axis=0)
    return float(first), float(second)


@pytest.mark.parametrize("level", range(4))
def test_full_figures_compare_every_level_at_the_scale_of_the_run(
    report: Report, level: int
) -> None:
    quality = report.levels[level].quality
    expected = expected_quality(level, 2.0)
    assert (quality.psnr_full, quality.ssim_full) == pytest.approx(expected)


@pytest.mark.parametrize("level", range(4))
def test_own_figures_halve_the_photo_with_each_coarser_level(report: Report, level: int) -> None:
    quality = report.levels[level].quality
    expected = expected_quality(level, 2.0 * 2 ** (3 - level))
    assert (quality.psnr_own, quality.ssim_own) == pytest.approx(expected)
    assert report.levels[level].own_scale == 2.0 * 2 ** (3 - level)


def test_own_and_full_agree_at_the_finest_level_only(report: Report) -> None:
    assert report.levels[-1].quality.psnr_own == report.levels[-1].quality.psnr_full
    assert report.levels[0].quality.ssim_own != report.levels[0].quality.ssim_full


@pytest.mark.parametrize(("pixels", "views"), [(10**9, 3), (2 * 4 * 96 * 64, 2), (1, 1)])
def test_photo_figures_are_those_at_the_photos_own_size_on_as_many_views_as_fit(
    pixels: int, views: int
) -> None:
    scene = fake_scene()
    options = Options(frames=1, pictures=0, photo_pixels=pixels)
    told: list[tuple[int, int]] = []
    options = replace(options, tick=lambda done, total: told.append((done, total)))
    decoder = LevelDecoder(NOISE)
    report = evaluate(decoder, level_set(), scene, renderer_of(scene), 2.0, options)
    assert report.photo == AtPhotoSize(96, 64, views, 3)
    measured = [score for score in report.views if score.quality.psnr_photo is not None]
    assert len(measured) == 4 * views
    passes = (3, views, 3)  # held out, at the photos' own size, training views
    assert told == [(n + 1, count) for count in passes for n in range(count)]
    if views == 3:
        expected = expected_quality(0, 1.0)[0]
        assert report.levels[0].quality.psnr_photo == pytest.approx(expected)
        assert report.levels[0].quality.psnr_full != pytest.approx(expected, abs=1e-6)


def test_without_a_budget_the_photos_own_size_is_left_out_unless_it_is_that_of_the_run() -> None:
    scene = fake_scene()
    options = Options(frames=1, pictures=0)
    for factor, photo in [(2.0, None), (1.0, AtPhotoSize(96, 64, 3, 3))]:
        report = evaluate(
            LevelDecoder(NOISE), level_set(), scene, renderer_of(scene), factor, options
        )
        assert report.photo == photo
        value = report.levels[1].quality.psnr_photo
        assert value == (report.levels[1].quality.psnr_full if photo else None)


def test_every_level_says_how_large_its_pictures_are(report: Report) -> None:
    assert (report.width, report.height) == (48, 32)
    assert [score.own_size for score in report.levels] == [(6, 4), (12, 8), (24, 16), (48, 32)]


def test_held_out_views_and_as_many_training_views_are_looked_at() -> None:
    scene = fake_scene()
    report = evaluate(
        LevelDecoder(NOISE), level_set(), scene, renderer_of(scene), 1.0, Options(frames=1)
    )
    seen = evenly(scene.train, len(scene.test))
    assert {view for view, _ in scene.loads} == {*scene.test, *seen}
    assert report.train_views == (3, 7) and len(seen) == 3


def test_quality_on_training_views_is_the_mean_over_them_and_inside_their_masks() -> None:
    scene = fake_scene()
    inside = np.zeros((32, 48), bool)
    inside[:, :20] = True
    scene.judged = lambda view, factor: inside if view != 1 else None
    options = Options(frames=1, pictures=0)
    report = evaluate(LevelDecoder(NOISE), level_set(), scene, renderer_of(scene), 2.0, options)
    for level, noise in enumerate(NOISE):
        whole, masked = list[float](), list[float]()
        for view in evenly(scene.train, 3):
            truth = pattern(scene.camera(view, 2.0), view)
            drawn = to_bytes(torch.tensor(truth.astype(np.float32) / 255.0) + noise)
            whole.append(psnr(drawn, truth))
            if view != 1:
                masked.append(psnr(drawn[:, :20], truth[:, :20]))
        score = report.levels[level]
        assert score.psnr_train == pytest.approx(float(np.mean(whole)))
        assert score.psnr_train_masked == pytest.approx(float(np.mean(masked)))


def test_a_scene_that_holds_nothing_out_has_no_figure_of_training_photos() -> None:
    scene = replace(fake_scene(), test=(0, 1, 2), train=(0, 1, 2))
    report = evaluate(
        LevelDecoder(NOISE), level_set(), scene, renderer_of(scene), 1.0, Options(frames=1)
    )
    assert report.levels[0].psnr_train is None and report.train_views == (0, 3)


def test_bytes_and_counts_are_those_of_the_container(report: Report) -> None:
    levels = level_set()
    assert [score.sizes for score in report.levels] == measure(levels)
    assert [score.anchors for score in report.levels] == [v.anchors for v in levels.levels]
    assert [score.slots for score in report.levels] == [v.live for v in levels.levels]


def test_frames_and_cameras_that_were_timed_are_counted(report: Report) -> None:
    timing = report.levels[0].timing
    assert (timing.frames, timing.views) == (5, 3)
    assert 0 < timing.total_ms <= timing.total_p95_ms


def test_warm_up_frames_are_decoded_but_not_counted() -> None:
    scene, decoder = fake_scene(), LevelDecoder(NOISE)
    options = Options(frames=4, warmup=3, pictures=0)
    evaluate(decoder, level_set(), scene, renderer_of(scene), 1.0, options)
    views = len(scene.test)
    # At the run's scale, at the level's own, and on as many training views.
    comparisons = {0: 3 * views, 1: 3 * views, 2: 3 * views, 3: 2 * views}
    for level, compared in comparisons.items():
        assert sum(1 for number, _ in decoder.calls if number == level) == compared + 7


def test_timing_takes_the_median_and_the_95th_percentile_of_the_sum() -> None:
    rows = [(0.001 * i, 0.002 * (21 - i)) for i in range(1, 21)]
    timing = timing_of(rows, views=3)
    total = sorted(1000 * (a + b) for a, b in rows)
    assert timing.decode_ms == pytest.approx(10.5)
    assert timing.raster_ms == pytest.approx(21.0)
    assert timing.total_ms == pytest.approx((total[9] + total[10]) / 2)
    assert timing.total_p95_ms == pytest.approx(np.percentile(total, 95))


def test_pictures_are_spread_over_the_held_out_views(report: Report) -> None:
    assert [p.view for p in report.pictures] == ["view_00.png", "view_08.png"]
    assert all(len(p.levels) == 4 for p in report.pictures)
    assert evenly(tuple(range(10)), 3) == (0, 4, 9)
    assert evenly((5, 6), 1) == (6,)
    assert evenly((5, 6), 0) == ()
    assert evenly((5, 6), 9) == (5, 6)


def test_own_scale_of_the_finest_of_any_number_of_levels_is_the_run_s() -> None:
    assert own_scale(4.0, 0, 1) == own_scale(4.0, 5, 6) == 4.0
    assert own_scale(4.0, 0, 4) == 32.0


def test_a_scene_without_held_out_views_is_refused() -> None:
    scene = replace(fake_scene(), test=())
    with pytest.raises(SceneError, match="no held-out view"):
        evaluate(LevelDecoder(NOISE), level_set(), scene, renderer_of(scene))


def test_without_weights_the_learnt_measure_is_absent_and_never_replaced(report: Report) -> None:
    assert report.lpips is None
    assert report.levels[0].quality.lpips_full is None


def test_a_supplied_learnt_measure_is_averaged_over_views() -> None:
    def distance(image: Image8, truth: Image8) -> float:
        return float(np.abs(image.astype(float) - truth).mean() / 255)

    scene = fake_scene()
    options = Options(frames=1, lpips=LearntMeasure("mean error", distance))
    report = evaluate(LevelDecoder(NOISE), level_set(), scene, renderer_of(scene), 1.0, options)
    assert report.lpips == "mean error"
    assert report.levels[3].quality.lpips_full == 0.0
    assert report.levels[2].quality.lpips_full == pytest.approx(10 / 255, abs=1e-3)


def test_a_mean_over_views_lacks_what_one_view_lacks() -> None:
    whole, partial = Quality(10, 0.5, 20, 0.6, 0.1, 0.2), Quality(30, 0.7, 40, 0.8, None, 0.4)
    mean = mean_quality([whole, partial])
    assert (mean.psnr_full, mean.psnr_own) == (20, 30)
    assert (mean.ssim_full, mean.ssim_own) == pytest.approx((0.6, 0.7))
    assert mean.lpips_full is None
    assert mean.lpips_own == pytest.approx(0.3)


def test_progress_is_told_after_each_view() -> None:
    told: list[tuple[int, int]] = []
    scene = fake_scene()
    options = Options(frames=1, tick=lambda done, total: told.append((done, total)))
    evaluate(LevelDecoder(NOISE), level_set(), scene, renderer_of(scene), 1.0, options)
    assert told == 2 * [(1, 3), (2, 3), (3, 3)]  # those held out, then those of training


def test_a_perfect_level_is_finite_in_the_mean(report: Report) -> None:
    assert report.levels[3].quality.psnr_full == 100.0
    assert all(math.isfinite(score.quality.psnr_full) for score in report.levels)
