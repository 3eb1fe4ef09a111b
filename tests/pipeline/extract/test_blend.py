from __future__ import annotations

import numpy as np
import pytest

from pipeline.extract.blend import Tile, blend, part_of
from pipeline.extract.resample import Grid
from pipeline.geometry.fade import fade


def tile(column, width, height, sigma, common=0.0, rows=20):
    shape = (rows, width)
    return Tile(
        0,
        column,
        np.full(shape, height, np.float32),
        np.full(shape, sigma, np.float32),
        np.full(shape, common),
    )


def test_a_step_becomes_a_slope_without_a_seam():
    heights, _, count = blend(
        [tile(0, 60, 0.0, 0.01, rows=120), tile(40, 60, 1.0, 0.01, rows=120)], (120, 100)
    )
    row = heights[60]
    assert np.array_equal(row[:40], np.zeros(40, np.float32))
    assert np.array_equal(row[60:], np.ones(40, np.float32))
    assert (np.diff(row) >= 0).all()
    # The step where the second begins is a tiny part of the difference.
    assert row[40] < 0.05
    assert np.diff(row).max() < 0.15
    assert np.array_equal(count[60], [1] * 40 + [2] * 20 + [1] * 40)


def test_noise_averages_out_and_shared_errors_do_not():
    middle = np.s_[10, 5:15]
    both = [tile(0, 20, 0.0, 0.04), tile(0, 20, 0.0, 0.04)]
    assert blend(both, (20, 20))[1][middle] == pytest.approx(0.04 / np.sqrt(2))
    both = [tile(0, 20, 0.0, 0.0001, 0.03**2), tile(0, 20, 0.0, 0.0001, 0.03**2)]
    assert blend(both, (20, 20))[1][middle] == pytest.approx(0.03, rel=1e-3)


def test_what_is_known_better_weighs_more():
    heights, sigma, _ = blend([tile(0, 20, 0.0, 0.01), tile(0, 20, 1.0, 0.1)], (20, 20))
    assert heights[10, 10] == pytest.approx(0.01 / 1.01, rel=1e-4)
    assert sigma[10, 10] < 0.01


def test_holes_are_filled_by_the_other_and_stay_where_both_have_one():
    one, other = tile(0, 20, 1.0, 0.01), tile(0, 20, 2.0, 0.01)
    one.heights[5:9, 5:9] = np.nan
    other.heights[5:7, 5:7] = np.nan
    heights, sigma, count = blend([one, other], (20, 20))
    assert heights[8, 8] == 2
    assert np.isnan(heights[5:7, 5:7]).all()
    assert np.array_equal(np.isnan(heights), np.isnan(sigma))
    assert np.array_equal(np.isnan(heights), count == 0)


def test_parts_lie_on_the_common_grid():
    grid = Grid(-10.0, 5.0, 21, 41, 0.5)
    row, column, part = part_of(grid, np.array([[0.2, 1.1], [3.9, -2.3]]))
    assert (row, column) == (7, 20)
    assert (part.left_mm, part.top_mm) == (0.0, 1.5)
    assert part.left_mm + (part.columns - 1) * 0.5 >= 3.9
    assert part.top_mm - (part.rows - 1) * 0.5 <= -2.3
    assert part_of(grid, np.array([[-99.0, 99.0], [99, -99]]))[2] == grid


def test_fading():
    known = np.zeros((40, 50), bool)
    known[5:35, 5:45] = True
    known[20, 20] = False
    weight = fade(known)
    assert np.array_equal(weight > 0, known)
    assert weight[12, 30] == 1
    assert weight[5, 30] < 0.2
    assert weight[20, 21] < 0.2
    assert not fade(np.zeros((3, 3), bool)).any()
    assert (fade(np.ones((1, 1), bool)) > 0).all()
