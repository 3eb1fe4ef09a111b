"""Height fields on regular grids: normals, and sampling between the samples.

Rows go down while y goes up: sample (row, column) lies at (column, -row) * spacing.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray


def normals(heights_mm: NDArray[np.floating], spacing_mm: float) -> NDArray[np.float32]:
    """Return the unit normals of the surface, in the canvas frame.

    The area-weighted mean of the normals of the up to eight triangles around a sample, those
    with a missing corner left out; with all eight that is Sobel's gradient. The normals of a plane
    are exact up to its borders and holes. Where there is no triangle (a single row, say) a slope
    comes from the neighbours along its axis, and is 0 without any.

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
def _height(heights, row, column):  # type: ignore[no-untyped-def]
    """Return a height, NaN outside the field."""
    rows, columns = heights.shape
    return heights[row, column] if 0 <= row < rows and 0 <= column < columns else np.nan


@njit(cache=True, parallel=True)
def _normals(heights, spacing):  # type: ignore[no-untyped-def]
    rows, columns = heights.shape
    result = np.full((rows, columns, 3), np.nan, np.float32)
    for row in prange(rows):
        for column in range(columns):
            here = heights[row, column]
            if not np.isfinite(here):
                continue
            # Slopes towards greater columns and rows, summed over triangles and along the axes.
            triangles, by_column, by_row = 0, 0.0, 0.0
            beside, along, above, down = 0, 0.0, 0, 0.0
            for i in (-1, 1):
                rise = i * (_height(heights, row, column + i) - here)
                fall = i * (_height(heights, row + i, column) - here)
                if np.isfinite(rise):
                    beside, along = beside + 1, along + rise
                if np.isfinite(fall):
                    above, down = above + 1, down + fall
                for j in (-1, 1):
                    corner = _height(heights, row + j, column + i)
                    # The triangle over the neighbour in the row, and that over the one below.
                    rest = j * (corner - here - i * rise)
                    if np.isfinite(rest):
                        triangles, by_column, by_row = (
                            triangles + 1,
                            by_column + rise,
                            by_row + rest,
                        )
                    side = j * (_height(heights, row + j, column) - here)
                    rest = i * (corner - here - j * side)
                    if np.isfinite(rest):
                        triangles, by_column, by_row = (
                            triangles + 1,
                            by_column + rest,
                            by_row + side,
                        )
            if triangles == 0:
                triangles, by_column, by_row = 1, along / max(beside, 1), down / max(above, 1)
            x, y = -by_column / (triangles * spacing), by_row / (triangles * spacing)
            length = np.sqrt(1.0 + x * x + y * y)
            result[row, column, 0] = x / length
            result[row, column, 1] = y / length
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
