"""One ray against a height field, for use inside compiled kernels.

A ray is clipped to the box of the field, its stretch inside is shortened by the bounds of the cells
under it, and what is left is walked through the maximum mipmap (Tevs, Ihrke and Seidel 2008) down
to the bilinear patches. Everything before the patches only leaves out what cannot be met, with
margins wider than rounding reaches, so the result is that of testing every patch. The order of
cells follows from comparing the t of grid lines, the same numbers on every level.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.geometry.bilinear_patch import MISS, Ray, patch_hit

RELATIVE_MARGIN = 1e-14
"""Widening of bounds on z, relative to what is compared; the rounding of z(t) is below 1e-15."""

SMALLEST_SHARE = 1e-20
"""A direction's component below this share of the largest counts as 0."""

LEAST, MOST = 1e-100, 1e100
"""Directions whose largest component lies outside are rescaled first."""

FAR = 1e7
"""Origins farther away than this many samples are first moved to the field's edge."""

_HIGHEST_START = 2
"""Walks begin at this level or below; they rise where they find nothing."""

_SLACK = 1e-7
"""Widening of areas, in samples: more than the rounding of a position seen from ``FAR``."""


@njit(cache=True, error_model="numpy")
def first_hit(field, column, row, z, to_column, to_row, to_z, t_max):  # type: ignore[no-untyped-def]
    """Return the smallest t in [0, t_max] at which a ray meets the surface, or infinity.

    Parameters
    ----------
    field
        A ``MaximumMipmap``.
    column, row, z, to_column, to_row, to_z
        Origin and direction in grid units: samples, rows downwards, mm. A zero direction and
        anything that is not finite (but ``t_max``) meets nothing.
    """
    largest = max(max(abs(to_column), abs(to_row)), abs(to_z))
    usable = 0.0 < largest < np.inf and abs(to_column) + abs(to_row) + abs(to_z) < np.inf
    if not (usable and abs(column) + abs(row) + abs(z) < np.inf and t_max >= 0.0):
        return MISS
    scale = 1.0 if LEAST < largest < MOST else largest
    smallest = SMALLEST_SHARE * largest
    to_column = to_column / scale if abs(to_column) > smallest else 0.0
    to_row = to_row / scale if abs(to_row) > smallest else 0.0
    to_z = to_z / scale if abs(to_z) > smallest else 0.0
    t_max *= scale
    skipped = 0.0
    if abs(column) + abs(row) > FAR:
        ray = make_ray(field, column, row, z, to_column, to_row, to_z, 0, 0)
        skipped, end = _over_field(field, ray, t_max)
        if not skipped <= end:
            return MISS
        column, row, z = _nearest(field, ray, skipped)
        t_max -= skipped
    # A ray along a grid line belongs to the patches on both its sides.
    columns_before = 1 + int(to_column == 0.0 and _on_inner_line(column, field.heights.shape[1]))
    rows_before = 1 + int(to_row == 0.0 and _on_inner_line(row, field.heights.shape[0]))
    best = MISS
    for column_before in range(columns_before):
        for row_before in range(rows_before):
            ray = make_ray(
                field, column, row, z, to_column, to_row, to_z, column_before, row_before
            )
            best = min(best, _trace(field, ray, t_max))
    return (skipped + best) / scale


@njit(cache=True, error_model="numpy")
def _on_inner_line(position, count):  # type: ignore[no-untyped-def]
    return position == math.floor(position) and 1.0 <= position <= count - 2.0


@njit(cache=True, error_model="numpy")
def make_ray(field, column, row, z, to_column, to_row, to_z, column_before, row_before):  # type: ignore[no-untyped-def]
    """Prepare a ray; one along a grid line may be put on the patches before that line."""
    per_column = 1.0 / to_column if to_column != 0.0 else np.inf
    per_row = 1.0 / to_row if to_row != 0.0 else np.inf
    per_z = 1.0 / to_z if to_z != 0.0 else np.inf
    rows, columns = field.heights.shape
    side_column, side_row = column, row
    if to_column == 0.0:
        side_column = min(max(math.floor(column), 0.0), columns - 2.0) + 0.5 - column_before
    if to_row == 0.0:
        side_row = min(max(math.floor(row), 0.0), rows - 2.0) + 0.5 - row_before
    return Ray(
        column,
        row,
        z,
        to_column,
        to_row,
        to_z,
        per_column,
        per_row,
        per_z,
        side_column,
        side_row,
        1 if to_column >= 0.0 else 0,
        1 if to_row >= 0.0 else 0,
    )


@njit(cache=True, error_model="numpy")
def _over_field(field, ray, t_max):  # type: ignore[no-untyped-def]
    """Return the stretch of [0, t_max] over the field; empty if its end lies before its begin."""
    t0, t1 = 0.0, t_max
    if ray.to_column != 0.0:
        t0, t1 = clip(ray.column, ray.per_column, t0, t1, 0.0, field.last[0])
    elif not 0.0 <= ray.column <= field.last[0]:
        return np.inf, -np.inf
    if ray.to_row != 0.0:
        t0, t1 = clip(ray.row, ray.per_row, t0, t1, 0.0, field.last[1])
    elif not 0.0 <= ray.row <= field.last[1]:
        return np.inf, -np.inf
    return t0, t1


@njit(cache=True, error_model="numpy")
def _nearest(field, ray, t):  # type: ignore[no-untyped-def]
    """Return the ray's point at t, kept over the field against rounding."""
    column = min(max(ray.column + t * ray.to_column, 0.0), field.last[0])
    row = min(max(ray.row + t * ray.to_row, 0.0), field.last[1])
    return column, row, ray.z + t * ray.to_z


@njit(cache=True, error_model="numpy")
def _trace(field, ray, t_max):  # type: ignore[no-untyped-def]
    t_begin, t_end = _over_field(field, ray, t_max)
    high, low = whole_bounds(field)
    margin = RELATIVE_MARGIN * (abs(ray.z) + max(abs(high), abs(low)))
    t_begin, t_end = clip(ray.z, ray.per_z, t_begin, t_end, low - margin, high + margin)
    if not t_begin <= t_end:
        return MISS
    t0, t1, before = t_begin, t_end, np.inf
    while t0 <= t1 and t1 - t0 < 0.5 * before:
        before = t1 - t0
        t0, t1 = shorten(
            field,
            ray.side_column,
            ray.side_row,
            ray.z,
            ray.to_column,
            ray.to_row,
            ray.per_z,
            t0,
            t1,
            margin,
        )
    return walk(field, ray, t_begin, t_end, t0, t1, margin)


@njit(cache=True, error_model="numpy")
def whole_bounds(field):  # type: ignore[no-untyped-def]
    """Return the highest and the lowest height of all."""
    cell = field.bounds[field.bounds.shape[0] - 1]
    return np.float64(cell[0]), np.float64(cell[1])


@njit(cache=True, error_model="numpy")
def clip(origin, per_unit, t0, t1, low, high):  # type: ignore[no-untyped-def]
    """Return what of [t0, t1] lies between two values on one axis; empty if t0 > t1."""
    a, b = (low - origin) * per_unit, (high - origin) * per_unit
    enter, leave = (a, b) if per_unit > 0.0 else (b, a)
    # 0 times infinity is NaN and limits nothing.
    return (enter if enter > t0 else t0), (leave if leave < t1 else t1)


@njit(cache=True, error_model="numpy")
def level_of(size):  # type: ignore[no-untyped-def]
    """Return the smallest level whose cells are wider than ``size`` patches: bit_length(size)."""
    return max((np.float32(size).view(np.int32) >> 23) - 126, 0)


@njit(cache=True, error_model="numpy")
def patch_index(position, last):  # type: ignore[no-untyped-def]
    """Return the patch that holds a position, 0..last; NaN gives 0."""
    position = position if position > 0.0 else 0.0
    return int(position if position < last else last)


@njit(cache=True, error_model="numpy")
def area_bounds(field, low_column, high_column, low_row, high_row):  # type: ignore[no-untyped-def]
    """Return highest and lowest height over a rectangle (or a little more), and its size.

    The positions are widened by what rounding may have done to them; at most 2 x 2 cells are read.
    """
    last_column, last_row = field.heights.shape[1] - 2, field.heights.shape[0] - 2
    slack = _SLACK
    i0, i1 = (
        patch_index(low_column - slack, last_column),
        patch_index(high_column + slack, last_column),
    )
    j0, j1 = patch_index(low_row - slack, last_row), patch_index(high_row + slack, last_row)
    size = max(i1 - i0, j1 - j0)
    level = min(max(level_of(size), 1), field.levels.shape[0] - 1)
    first, width = field.levels[level, 0], field.levels[level, 1]
    upper, lower = first + (j0 >> level) * width, first + (j1 >> level) * width
    a, b = np.uintp(upper + (i0 >> level)), np.uintp(upper + (i1 >> level))
    c, d = np.uintp(lower + (i0 >> level)), np.uintp(lower + (i1 >> level))
    cells = field.bounds
    high = max(max(cells[a, 0], cells[b, 0]), max(cells[c, 0], cells[d, 0]))
    low = min(min(cells[a, 1], cells[b, 1]), min(cells[c, 1], cells[d, 1]))
    return np.float64(high), np.float64(low), size


@njit(cache=True, error_model="numpy")
def shorten(field, column, row, z, to_column, to_row, per_z, t0, t1, margin):  # type: ignore[no-untyped-def]
    """Clip [t0, t1] to the heights that lie under it."""
    column_0, column_1 = column + t0 * to_column, column + t1 * to_column
    row_0, row_1 = row + t0 * to_row, row + t1 * to_row
    high, low, _ = area_bounds(
        field,
        min(column_0, column_1),
        max(column_0, column_1),
        min(row_0, row_1),
        max(row_0, row_1),
    )
    return clip(z, per_z, t0, t1, low - margin, high + margin)


@njit(cache=True, error_model="numpy")
def locate(field, ray, t):  # type: ignore[no-untyped-def]
    """Return column and row of the patch that the ray passes over at t, or the one before it."""
    last_column, last_row = field.heights.shape[1] - 2, field.heights.shape[0] - 2
    i = patch_index(ray.side_column + t * ray.to_column, last_column)
    j = patch_index(ray.side_row + t * ray.to_row, last_row)
    # Step back where rounding has put t behind a grid line that it has not crossed yet; a start
    # on a line belongs to both sides.
    enter_column = (float(i + 1 - ray.ahead_column) - ray.side_column) * ray.per_column
    enter_row = (float(j + 1 - ray.ahead_row) - ray.side_row) * ray.per_row
    if t < enter_column or t == 0.0 == enter_column:
        i = min(max(i + 1 - 2 * ray.ahead_column, 0), last_column)
    if t < enter_row or t == 0.0 == enter_row:
        j = min(max(j + 1 - 2 * ray.ahead_row, 0), last_row)
    return i, j


@njit(cache=True, error_model="numpy")
def hit_at(heights, i, j, ray, t_begin, t_end):  # type: ignore[no-untyped-def]
    """Meet the patch at column i and row j; see :func:`patch_hit`."""
    # Unsigned, for numba counts negative indices from the end.
    m, n, m1, n1 = np.uintp(i), np.uintp(j), np.uintp(i + 1), np.uintp(j + 1)
    return patch_hit(
        np.float64(heights[n, m]),
        np.float64(heights[n, m1]),
        np.float64(heights[n1, m]),
        np.float64(heights[n1, m1]),
        i,
        j,
        ray,
        t_begin,
        t_end,
    )


@njit(cache=True, error_model="numpy")
def walk(field, ray, t_begin, t_end, t0, t1, margin):  # type: ignore[no-untyped-def]
    """Walk [t0, t1], which lies in the field's [t_begin, t_end], front to back to the first hit."""
    if not t0 <= t1:
        return MISS
    level, i, j = first_cell(field, ray, t0, t1, field.levels.shape[0] - 1)
    return resume(field, ray, t_begin, t_end, t0, t1, margin, level, i, j)


@njit(cache=True, error_model="numpy", forceinline=True)
def first_cell(field, ray, t0, t1, top_level):  # type: ignore[no-untyped-def]
    """Return level, column and row of the cell where a walk from t0 to t1 begins."""
    i, j = locate(field, ray, t0)
    reach = max(abs(ray.to_column), abs(ray.to_row)) * (t1 - t0)
    level = min(min(level_of(0.25 * reach), top_level), _HIGHEST_START)
    # A ray that starts at 0 is close to the surface, where small cells serve it better.
    level = level if t0 > 0.0 else 0
    return level, i >> level, j >> level


@njit(cache=True, error_model="numpy")
def resume(field, ray, t_begin, t_end, t, t1, margin, level, i, j):  # type: ignore[no-untyped-def]
    """Walk on from t, where the ray enters cell (i, j) of a level; see :func:`walk`."""
    heights, bounds, levels = field.heights, field.bounds, field.levels
    top_level = levels.shape[0] - 1
    while t <= t1:
        if level == 0:
            hit = hit_at(heights, i, j, ray, t_begin, t_end)
            if hit < MISS:
                return hit
            level, i, j, t = pass_on(ray, level, i, j, t1, top_level)
        else:
            cell = np.uintp(levels[level, 0] + j * levels[level, 1] + i)
            high, low = np.float64(bounds[cell, 0]) + margin, np.float64(bounds[cell, 1]) - margin
            level, i, j, t = pass_cell(ray, level, i, j, t, t1, high, low, top_level)
    return MISS


@njit(cache=True, error_model="numpy", forceinline=True)
def pass_cell(ray, level, i, j, t, t1, high, low, top_level):  # type: ignore[no-untyped-def]
    """Go into a cell of a level above 0 where the ray may meet its heights, else past it.

    Returns the next level, column, row and t (NaN: the walk is at its end).
    """
    leave_x = (float((i + ray.ahead_column) << level) - ray.side_column) * ray.per_column
    leave_y = (float((j + ray.ahead_row) << level) - ray.side_row) * ray.per_row
    enter, end = clip(ray.z, ray.per_z, t, min(leave_x, leave_y), low, high)
    below = max(level - 1, 0)
    middle_x = (float((2 * i + 1) << below) - ray.side_column) * ray.per_column
    middle_y = (float((2 * j + 1) << below) - ray.side_row) * ray.per_row
    in_i = 2 * i + int((enter > middle_x) if ray.ahead_column else (enter < middle_x))
    in_j = 2 * j + int((enter > middle_y) if ray.ahead_row else (enter < middle_y))
    past_level, past_i, past_j, past_t = pass_on(ray, level, i, j, t1, top_level)
    goes_in = enter <= end
    return (
        below if goes_in else past_level,
        in_i if goes_in else past_i,
        in_j if goes_in else past_j,
        enter if goes_in else past_t,
    )


@njit(cache=True, error_model="numpy", forceinline=True)
def pass_on(ray, level, i, j, t1, top_level):  # type: ignore[no-untyped-def]
    """Go to the next cell, a larger one where that begins; return as :func:`pass_cell`."""
    leave_x = (float((i + ray.ahead_column) << level) - ray.side_column) * ray.per_column
    leave_y = (float((j + ray.ahead_row) << level) - ray.side_row) * ray.per_row
    across = leave_x <= leave_y
    leave = leave_x if across else leave_y
    i += (2 * ray.ahead_column - 1) if across else 0
    j += 0 if across else (2 * ray.ahead_row - 1)
    begins = ((i & 1) != ray.ahead_column) if across else ((j & 1) != ray.ahead_row)
    rise = int(begins & (level < top_level))
    return level + rise, i >> rise, j >> rise, np.nan if leave >= t1 else leave
