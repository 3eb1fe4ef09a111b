"""Height fields on regular grids: normals, and sampling between the samples.

Rows go down while y goes up: sample (row, column) lies at (column, -row) * spacing.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray


def normals(heights_mm: NDArray[np.floating], spacing_mm: float) -> NDArray[np.float32]:
    """Return the unit normals of the surface, in the canvas frame.

    The sum of the area-weighted normals of the eight triangles around a sample; on a regular grid
    that is Sobel's gradient. A neighbour that is missing, or lies beyond the border, is
    extrapolated through the sample from the one opposite, and level if that is missing too.

    Parameters
    ----------
    heights_mm
        (rows, columns), NaN where there is no surface.
    spacing_mm
        > 0.

    Returns
    -------
    (rows, columns, 3) float32, n_z > 0; NaN where the height is.
    """
    return _normals(np.ascontiguousarray(heights_mm, dtype=np.float64), spacing_mm)  # type: ignore[no-any-return]


@njit(cache=True)
def _neighbour(heights, row, column, down, right):  # type: ignore[no-untyped-def]
    """Return a neighbour's height above the sample's."""
    rows, columns = heights.shape
    here = heights[row, column]
    for sign in (1, -1):
        r, c = row + sign * down, column + sign * right
        if 0 <= r < rows and 0 <= c < columns and np.isfinite(heights[r, c]):
            return sign * (heights[r, c] - here)
    return 0.0


@njit(cache=True, parallel=True)
def _normals(heights, spacing):  # type: ignore[no-untyped-def]
    rows, columns = heights.shape
    result = np.full((rows, columns, 3), np.nan, np.float32)
    for row in prange(rows):
        for column in range(columns):
            if not np.isfinite(heights[row, column]):
                continue
            by_x = by_y = 0.0
            for side in (-1, 1):
                for other in (-1, 0, 1):
                    weight = 2.0 - abs(other)
                    by_x += side * weight * _neighbour(heights, row, column, other, side)
                    by_y -= side * weight * _neighbour(heights, row, column, side, other)
            by_x, by_y = by_x / (8.0 * spacing), by_y / (8.0 * spacing)
            length = np.sqrt(1.0 + by_x * by_x + by_y * by_y)
            result[row, column, 0] = -by_x / length
            result[row, column, 1] = -by_y / length
            result[row, column, 2] = 1.0 / length
    return result


def sample_bilinear(
    image: NDArray[np.floating], columns: NDArray[np.floating], rows: NDArray[np.floating]
) -> NDArray[np.floating]:
    """Sample an image between its samples; NaN outside, and wherever a NaN would weigh in.

    Parameters
    ----------
    image
        (rows, columns) or (rows, columns, channels).
    columns, rows
        Positions in samples, any one shape.

    Returns
    -------
    Values of the positions' shape (and channels), in the image's own precision.
    """
    height, width = image.shape[:2]
    inside = (columns >= 0) & (columns <= width - 1) & (rows >= 0) & (rows <= height - 1)
    x, y = np.where(inside, columns, 0), np.where(inside, rows, 0)
    left, top = x.astype(np.intp), y.astype(np.intp)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    shape = (...,) + (None,) * (image.ndim - 2)
    fx, fy = (x - left).astype(image.dtype)[shape], (y - top).astype(image.dtype)[shape]
    # On a grid line the far side has weight 0 and must not spread its NaN.
    right, bottom = np.where(x == left, left, right), np.where(y == top, top, bottom)
    upper = (1 - fx) * image[top, left] + fx * image[top, right]
    lower = (1 - fx) * image[bottom, left] + fx * image[bottom, right]
    return np.where(inside[shape], (1 - fy) * upper + fy * lower, np.nan).astype(image.dtype)
