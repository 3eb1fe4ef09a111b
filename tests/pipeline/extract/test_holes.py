from __future__ import annotations

import numpy as np
import pytest

from pipeline.extract.holes import fill_holes, small_holes


def test_only_small_enclosed_holes_are_small() -> None:
    known = np.ones((40, 60), bool)
    known[10:13, 10:13] = False  # 3 wide
    known[20:21, 5:40] = False  # a slit
    known[25:38, 45:58] = False  # 13 wide
    known[0:3, 30:33] = False  # open to the border
    holes, left = small_holes(known, 4)
    assert holes.sum() == 9 + 35
    assert left == 1
    assert not small_holes(np.ones((5, 5), bool), 4)[0].any()


def test_a_plane_is_continued_through_a_hole() -> None:
    row, column = np.mgrid[0:20, 0:30].astype(np.float32)
    heights = 0.1 * row - 0.05 * column
    sigma = np.full_like(heights, 0.02)
    holes = np.zeros(heights.shape, bool)
    holes[6:12, 8:15] = True
    holes[15, 20] = True
    torn = np.where(holes, np.nan, heights).astype(np.float32)
    torn_sigma = np.where(holes, np.nan, sigma).astype(np.float32)
    filled, deviation = fill_holes(torn, torn_sigma, holes)
    assert filled == pytest.approx(heights, abs=1e-5)
    assert deviation[~holes] == pytest.approx(0.02)
    assert (deviation[holes] > 0.02).all()
    assert deviation[9, 11] > deviation[6, 11]  # less is known in the middle
    assert np.isnan(torn[9, 11])  # the input is untouched


def test_a_filled_hole_stays_within_its_rim() -> None:
    rng = np.random.default_rng(0)
    heights = rng.normal(size=(30, 30)).astype(np.float32)
    holes = np.zeros(heights.shape, bool)
    holes[10:20, 10:20] = True
    torn = np.where(holes, np.nan, heights).astype(np.float32)
    filled, _ = fill_holes(torn, np.abs(torn), holes)
    rim = filled[9:21, 9:21][~holes[9:21, 9:21]]
    assert rim.min() <= filled[holes].min()
    assert filled[holes].max() <= rim.max()


def test_nothing_to_fill() -> None:
    heights = np.ones((3, 4), np.float32)
    filled, sigma = fill_holes(heights, heights, np.zeros((3, 4), bool))
    assert np.array_equal(filled, heights)
    assert np.array_equal(sigma, heights)
