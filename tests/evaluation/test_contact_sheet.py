"""The contact sheet: photos, levels and their errors beside each other."""

from dataclasses import replace

import numpy as np

from gsynopsis.evaluation.contact_sheet import RAMP, Grid, contact_sheet, error_image, head_height
from gsynopsis.evaluation.report import Pictures, Report


def test_contact_sheet_shows_truth_levels_and_amplified_errors(report: Report) -> None:
    sheet = np.asarray(contact_sheet(report, Grid(cell=(96, 64))))
    grid, pictures = Grid(cell=(96, 64)), report.pictures[0]
    top = head_height(grid)
    assert np.array_equal(sheet[top : top + 64, grid.margin : grid.margin + 96], pictures.truth)
    below = top + 64 + grid.line + grid.gap // 2
    for level, image in enumerate(pictures.levels):
        left = grid.margin + (level + 1) * (96 + grid.gap)
        assert np.array_equal(sheet[top : top + 64, left : left + 96], image)
        error = sheet[below : below + 64, left : left + 96]
        assert np.array_equal(error, error_image(image, pictures.truth))


def test_error_colours_run_from_none_to_a_quarter_of_the_range() -> None:
    truth = np.zeros((1, 3, 3), np.uint8)
    image = truth.copy()
    image[0, 1, 2], image[0, 2] = 64, 255
    colours = error_image(image, truth)
    assert colours[0, 0].tolist() == RAMP[0].tolist()
    assert colours[0, 1].tolist() == colours[0, 2].tolist() == RAMP[-1].tolist()


def test_contact_sheet_takes_views_of_other_shapes_and_one_level(report: Report) -> None:
    tall = np.zeros((80, 10, 3), np.uint8)
    odd = replace(
        report,
        levels=report.levels[:1],
        pictures=(Pictures("a" * 90, tall, (tall,)), Pictures("b", tall[:, :5], (tall[:, :5],))),
    )
    assert contact_sheet(odd).size[0] >= 640
