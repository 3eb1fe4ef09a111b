"""Every cell's bounds against the patches it covers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.geometry.maximum_mipmap import build_maximum_mipmap


def patch_extremes(heights):
    """Return highest and lowest corner of each whole patch; -inf, inf for the others."""
    corners = np.stack([heights[:-1, :-1], heights[:-1, 1:], heights[1:, :-1], heights[1:, 1:]])
    whole = np.isfinite(corners).all(axis=0)
    with np.errstate(invalid="ignore"):
        high, low = corners.max(axis=0), corners.min(axis=0)
    return np.where(whole, high, -np.inf), np.where(whole, low, np.inf)


def assert_bounds(heights):
    """Check all levels: as tight as float32 allows, and never inside the true bounds."""
    mipmap = build_maximum_mipmap(heights)
    padded = np.asarray(mipmap.heights, np.float64)
    high, low = patch_extremes(padded)
    sizes = high.shape
    end = 0
    for level in range(1, len(mipmap.levels)):
        first, columns = mipmap.levels[level]
        assert first == end
        rows = -(-sizes[0] // 2**level)
        assert columns == -(-sizes[1] // 2**level)
        end = first + rows * columns
        cells = mipmap.bounds[first:end].reshape(rows, columns, 2)
        for (row, column), _ in np.ndenumerate(cells[..., 0]):
            part = np.s_[row << level : (row + 1) << level, column << level : (column + 1) << level]
            highest, lowest = high[part].max(), low[part].min()
            upper, lower = cells[row, column]
            assert upper >= highest
            assert lower <= lowest
            if np.isfinite(highest):
                assert upper <= np.nextafter(np.float32(highest), np.float32(np.inf))
                assert lower >= np.nextafter(np.float32(lowest), np.float32(-np.inf))
            else:
                assert (upper, lower) == (-np.inf, np.inf)
    assert end == len(mipmap.bounds)
    assert mipmap.bounds.dtype == np.float32
    assert rows == columns == 1


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 7), (9, 1), (2, 2), (3, 3), (17, 16), (16, 33), (5, 64)]
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_bounds_hold_all_patches(shape, dtype):
    random = np.random.default_rng(1)
    heights = random.normal(size=shape).astype(dtype)
    assert_bounds(heights)
    heights[random.random(shape) < 0.1] = np.nan
    assert_bounds(heights)


@settings(deadline=None)  # the first call compiles
@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.lists(
        st.one_of(st.floats(-1e30, 1e30), st.sampled_from([np.nan, np.inf, -np.inf])),
        min_size=81,
        max_size=81,
    ),
)
def test_bounds_hold_whatever_the_heights(rows, columns, values):
    assert_bounds(np.array(values[: rows * columns]).reshape(rows, columns))


def test_a_missing_sample_takes_its_four_patches_only():
    heights = np.zeros((9, 9), np.float32)
    heights[4, 4] = np.nan
    heights[3, 4] = 5.0
    mipmap = build_maximum_mipmap(heights)
    level_1 = mipmap.bounds[mipmap.levels[1, 0] :][:16].reshape(4, 4, 2)
    assert level_1[1, 1, 0] == 5.0  # patches above row 3 still reach the peak
    assert level_1[2, 2, 0] == 0.0
    assert tuple(mipmap.bounds[-1]) == (5.0, 0.0)


def test_memory_stays_below_two_thirds_of_the_heights():
    heights = np.zeros((500, 700), np.float32)
    mipmap = build_maximum_mipmap(heights)
    assert mipmap.bounds.nbytes < 0.68 * heights.nbytes


def test_the_field_given_is_left_alone():
    heights = np.array([[0.0, np.inf], [1.0, 2.0]])
    mipmap = build_maximum_mipmap(heights)
    assert heights[0, 1] == np.inf
    assert np.isnan(mipmap.heights[0, 1])
