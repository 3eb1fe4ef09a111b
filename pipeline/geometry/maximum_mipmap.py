"""Bounds of a height field over cells of 2, 4, 8... patches a side (maximum mipmap).

A *patch* is the bilinear surface between four neighbouring samples; its extremes are those of its
four corners. A cell of level k covers 2^k x 2^k patches; level 0, the patches themselves, is not
stored, for the heights say it all. Source: Tevs, Ihrke and Seidel (2008), with the minimum kept
beside the maximum so that rays under the surface skip cells too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray


class MaximumMipmap(NamedTuple):
    """A height field with its bounds, in the form that compiled kernels take.

    Parameters
    ----------
    heights
        (max(rows, 2), max(columns, 2)) float32 or float64; NaN where there is no surface. A field
        of one row or column is repeated, so that it has patches.
    bounds
        (cells, 2) float32: highest and lowest height of the cells of level 1, level 2...,
        rounded outwards; (-inf, inf) where no patch is whole.
    levels
        (count, 2) int64: first cell of level k and its cells per row, in row k; row 0 is unused.
        The last level is one cell.
    last
        (2,) float64: largest column and row of the field as given (0 for a single one).
    """

    heights: NDArray[Any]
    bounds: NDArray[np.float32]
    levels: NDArray[np.int64]
    last: NDArray[np.float64]


def build_maximum_mipmap(heights_mm: NDArray[np.floating]) -> MaximumMipmap:
    """Build the mipmap of heights (rows, columns); a third of their memory, twice.

    Heights that are not finite are holes: a patch with such a corner is no surface.
    """
    if heights_mm.ndim != 2:
        raise ValueError(f"heights of shape {heights_mm.shape}; expected (rows, columns)")
    rows, columns = heights_mm.shape
    dtype = np.float32 if heights_mm.dtype in (np.float16, np.float32) else np.float64
    heights = np.full((max(rows, 2), max(columns, 2)), np.nan, dtype)
    if heights_mm.size:
        heights[:rows, :columns] = np.where(np.isfinite(heights_mm), heights_mm, np.nan)
        if rows == 1:
            heights[1] = heights[0]
        if columns == 1:
            heights[:, 1] = heights[:, 0]
    sizes = _level_sizes(heights.shape[0] - 1, heights.shape[1] - 1)
    counts = [0] + [r * c for r, c in sizes[1:]]
    first = np.cumsum([0, *counts])[:-1]
    levels = np.array([(f, c) for f, (_, c) in zip(first, sizes, strict=True)], np.int64)
    bounds = np.empty((sum(counts), 2), np.float32)
    below: NDArray[np.float32] | None = None
    for (begin, _), (r, c) in zip(levels[1:], sizes[1:], strict=True):
        level = bounds[begin : begin + r * c].reshape(r, c, 2)
        if below is None:
            _bound_patches(heights, level)
        else:
            _bound_cells(below, level)
        below = level
    return MaximumMipmap(heights, bounds, levels, np.array([columns - 1.0, rows - 1.0]))


def _level_sizes(rows: int, columns: int) -> list[tuple[int, int]]:
    """Return rows and columns of each level, from the patches to one cell (at least level 1)."""
    sizes = [(rows, columns)]
    while len(sizes) < 2 or sizes[-1] != (1, 1):
        rows, columns = (rows + 1) // 2, (columns + 1) // 2
        sizes.append((rows, columns))
    return sizes


@njit(cache=True, parallel=True)
def _bound_patches(heights, level):  # type: ignore[no-untyped-def]
    """Fill level 1 from the corners of its whole patches."""
    rows, columns = heights.shape
    for row in prange(level.shape[0]):
        for column in range(level.shape[1]):
            high, low = -np.inf, np.inf
            for i in range(2 * row, min(2 * row + 2, rows - 1)):
                for j in range(2 * column, min(2 * column + 2, columns - 1)):
                    a, b = heights[i, j], heights[i, j + 1]
                    c, d = heights[i + 1, j], heights[i + 1, j + 1]
                    if np.isfinite(a) and np.isfinite(b) and np.isfinite(c) and np.isfinite(d):
                        high = max(high, a, b, c, d)
                        low = min(low, a, b, c, d)
            upper, lower = np.float32(high), np.float32(low)
            if upper < high:
                upper = np.nextafter(upper, np.float32(np.inf))
            if lower > low:
                lower = np.nextafter(lower, np.float32(-np.inf))
            level[row, column, 0] = upper
            level[row, column, 1] = lower


@njit(cache=True, parallel=True)
def _bound_cells(below, level):  # type: ignore[no-untyped-def]
    """Fill a level from the up to four cells of the level below."""
    rows, columns, _ = below.shape
    for row in prange(level.shape[0]):
        for column in range(level.shape[1]):
            high, low = np.float32(-np.inf), np.float32(np.inf)
            for i in range(2 * row, min(2 * row + 2, rows)):
                for j in range(2 * column, min(2 * column + 2, columns)):
                    high = max(high, below[i, j, 0])
                    low = min(low, below[i, j, 1])
            level[row, column, 0] = high
            level[row, column, 1] = low
