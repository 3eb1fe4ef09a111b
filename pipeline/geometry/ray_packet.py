"""Packets of rays against a height field: the kernels of :mod:`pipeline.geometry.raycast`.

Each step is done for a whole packet before the next step, in loops without branches over flat rows,
which the compiler turns into vector instructions; neighbours share the first looks at the bounds of
the surface below them. A ray's result depends on no other ray.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.geometry.bilinear_patch import MISS, Ray, patch_hit
from pipeline.geometry.ray_walk import (
    FAR,
    LEAST,
    MOST,
    RELATIVE_MARGIN,
    SMALLEST_SHARE,
    area_bounds,
    clip,
    first_cell,
    first_hit,
    pass_cell,
    pass_on,
    resume,
    shorten,
    whole_bounds,
)

PACKET = 32
_GLANCES = 3
_SMALL = 2 * PACKET
GROUP = 8  # rays that approach the surface together
_STRIDE = 2.0  # least length of their steps, in samples
_MOST_STEPS = 64.0
_FEW = 4  # rays for which a round of the whole packet does not pay

# Where a packet's values begin, each for PACKET rays.
_COLUMN = 0 * PACKET
_ROW = 1 * PACKET
_Z = 2 * PACKET
_TO_COLUMN = 3 * PACKET
_TO_ROW = 4 * PACKET
_TO_Z = 5 * PACKET
_PER_COLUMN = 6 * PACKET
_PER_ROW = 7 * PACKET
_PER_Z = 8 * PACKET
_BEGIN = 9 * PACKET
_END = 10 * PACKET
_T0 = 11 * PACKET
_T1 = 12 * PACKET
_MARGIN = 13 * PACKET
_A = 14 * PACKET
_B = 15 * PACKET
_C = 16 * PACKET
_D = 17 * PACKET
_HIT = 18 * PACKET
_LEVEL = 0 * PACKET
_I = 1 * PACKET
_J = 2 * PACKET


@njit(cache=True, error_model="numpy")
def on_grid(position):  # type: ignore[no-untyped-def]
    """Undo the rounding that keeps a multiple of the spacing from being a whole number."""
    nearest = np.floor(position + 0.5)
    return nearest if abs(position - nearest) <= 1e-15 * abs(nearest) else position


@njit(cache=True, error_model="numpy")
def load(field, per_mm, origins, ends, t_max, margin_mm, start, size, packet, result):  # type: ignore[no-untyped-def]
    """Bring rays to grid units and clip them to the field's box; cast the awkward ones singly.

    BEGIN and END bound the stretch inside the box, T0 and T1 what is left of it.
    """
    high, low = whole_bounds(field)
    last_column, last_row = field.last[0], field.last[1]
    awkward = 0
    for k in range(size):
        n = np.uintp(start + k)
        m = n if ends.shape[0] > 1 else np.uintp(0)
        o = n if origins.shape[0] > 1 else np.uintp(0)
        x, y, z = origins[o, 0], origins[o, 1], origins[o, 2]
        to_x, to_y, to_z = ends[m, 0], ends[m, 1], ends[m, 2]
        limit = t_max
        if margin_mm >= 0.0:
            to_x, to_y, to_z = to_x - x, to_y - y, to_z - z
            skipped = margin_mm / math.sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
            x, y, z = x + skipped * to_x, y + skipped * to_y, z + skipped * to_z
            limit = 1.0 - skipped
        column, row = on_grid(x * per_mm), on_grid(-y * per_mm)
        to_column, to_row = to_x * per_mm, -to_y * per_mm
        per_column, per_row, per_z = 1.0 / to_column, 1.0 / to_row, 1.0 / to_z
        margin = RELATIVE_MARGIN * (abs(z) + max(abs(high), abs(low)))
        a, b = (0.0 - column) * per_column, (last_column - column) * per_column
        t0, t1 = max(0.0, min(a, b)), min(limit, max(a, b))
        a, b = (0.0 - row) * per_row, (last_row - row) * per_row
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        a, b = (low - margin - z) * per_z, (high + margin - z) * per_z
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        largest = max(max(abs(to_column), abs(to_row)), abs(to_z))
        smallest = min(min(abs(to_column), abs(to_row)), abs(to_z))
        plain = (largest > LEAST) & (largest < MOST) & (smallest > SMALLEST_SHARE * largest)
        plain &= (abs(column) + abs(row) < FAR) & (abs(z) < MOST) & (t1 < np.inf)
        packet[_COLUMN + k], packet[_ROW + k], packet[_Z + k] = column, row, z
        packet[_TO_COLUMN + k], packet[_TO_ROW + k], packet[_TO_Z + k] = to_column, to_row, to_z
        packet[_PER_COLUMN + k], packet[_PER_ROW + k], packet[_PER_Z + k] = (
            per_column,
            per_row,
            per_z,
        )
        packet[_BEGIN + k], packet[_END + k] = t0, t1
        packet[_T0 + k], packet[_T1 + k] = t0 if plain else np.inf, t1 if plain else limit
        packet[_MARGIN + k] = margin
        result[n] = MISS
        awkward += 0 if plain else 1
    if awkward > 0:
        for k in range(size):
            if packet[_T0 + k] == np.inf:
                result[start + k] = first_hit(
                    field,
                    packet[_COLUMN + k],
                    packet[_ROW + k],
                    packet[_Z + k],
                    packet[_TO_COLUMN + k],
                    packet[_TO_ROW + k],
                    packet[_TO_Z + k],
                    packet[_T1 + k],
                )
                packet[_T1 + k] = -np.inf


@njit(cache=True, error_model="numpy")
def glance(field, packet, size):  # type: ignore[no-untyped-def]
    """Shorten all rays by the bounds of the surface under the whole packet; say if any is left."""
    for _ in range(_GLANCES):
        low_column, high_column, low_row, high_row = np.inf, -np.inf, np.inf, -np.inf
        left = 0
        for k in range(size):
            t0, t1 = packet[_T0 + k], packet[_T1 + k]
            if t0 <= t1:
                left += 1
                a, b = (
                    packet[_COLUMN + k] + t0 * packet[_TO_COLUMN + k],
                    packet[_COLUMN + k] + t1 * packet[_TO_COLUMN + k],
                )
                low_column, high_column = min(low_column, min(a, b)), max(high_column, max(a, b))
                a, b = (
                    packet[_ROW + k] + t0 * packet[_TO_ROW + k],
                    packet[_ROW + k] + t1 * packet[_TO_ROW + k],
                )
                low_row, high_row = min(low_row, min(a, b)), max(high_row, max(a, b))
        if left == 0:
            return False
        high, low, extent = area_bounds(field, low_column, high_column, low_row, high_row)
        for k in range(size):
            margin = packet[_MARGIN + k]
            packet[_T0 + k], packet[_T1 + k] = clip(
                packet[_Z + k],
                packet[_PER_Z + k],
                packet[_T0 + k],
                packet[_T1 + k],
                low - margin,
                high + margin,
            )
        if extent < _SMALL:
            break
    return True


@njit(cache=True, error_model="numpy")
def approach(field, packet, first, end):  # type: ignore[no-untyped-def]
    """Move a group of rays forward together for as long as they are clear of the surface.

    The box around the group's positions at t is held by the one interpolated between the boxes at
    both ends of the stretch, for the least of linear functions is concave, the largest convex.
    """
    t_first, t_last, margin = np.inf, -np.inf, 0.0
    for k in range(first, end):
        if packet[_T0 + k] <= packet[_T1 + k]:
            t_first, t_last = min(t_first, packet[_T0 + k]), max(t_last, packet[_T1 + k])
            margin = max(margin, packet[_MARGIN + k])
    if not 0.0 < t_first < t_last:
        return
    c0, c1, r0, r1, z0, z1 = np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf
    C0, C1, R0, R1, Z0, Z1 = np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf
    for k in range(first, end):
        if packet[_T0 + k] <= packet[_T1 + k]:
            a, b = (
                packet[_COLUMN + k] + t_first * packet[_TO_COLUMN + k],
                packet[_COLUMN + k] + t_last * packet[_TO_COLUMN + k],
            )
            c0, c1, C0, C1 = min(c0, a), max(c1, a), min(C0, b), max(C1, b)
            a, b = (
                packet[_ROW + k] + t_first * packet[_TO_ROW + k],
                packet[_ROW + k] + t_last * packet[_TO_ROW + k],
            )
            r0, r1, R0, R1 = min(r0, a), max(r1, a), min(R0, b), max(R1, b)
            a, b = (
                packet[_Z + k] + t_first * packet[_TO_Z + k],
                packet[_Z + k] + t_last * packet[_TO_Z + k],
            )
            z0, z1, Z0, Z1 = min(z0, a), max(z1, a), min(Z0, b), max(Z1, b)
    farthest = max(max(-c0, c1), max(-r0, r1)) + max(max(-C0, C1), max(-R0, R1))
    if not farthest < FAR:  # rounding would reach farther than the slack of the areas
        return
    margin += RELATIVE_MARGIN * (max(abs(z0), abs(z1)) + max(abs(Z0), abs(Z1)))
    width = max(max(c1 - c0, r1 - r0), _STRIDE)
    reach = max(abs(C0 - c0), abs(R0 - r0))
    steps = int(min(reach / width, _MOST_STEPS))
    per_step = 1.0 / max(steps, 1)
    clear = 0
    a, b, c, d, z, Z = c0, c1, r0, r1, z0, z1
    for step in range(1, steps):
        f = step * per_step
        g = 1.0 - f
        a1, b1, d0, d1 = g * c0 + f * C0, g * c1 + f * C1, g * r0 + f * R0, g * r1 + f * R1
        y0, y1 = g * z0 + f * Z0, g * z1 + f * Z1
        high, low, _ = area_bounds(field, min(a, a1), max(b, b1), min(c, d0), max(d, d1))
        if not (min(z, y0) > high + margin or max(Z, y1) < low - margin):
            break
        a, b, c, d, z, Z = a1, b1, d0, d1, y0, y1
        clear = step
    if clear > 0:
        t = t_first + (t_last - t_first) * (clear * per_step * (1.0 - 1e-12))
        for k in range(first, end):
            t0 = packet[_T0 + k]
            packet[_T0 + k] = t if t0 < t else t0  # NaN, of no ray, stays


@njit(cache=True, error_model="numpy")
def finish(field, packet, cells, size, start, result):  # type: ignore[no-untyped-def]
    """Shorten each ray by the surface under itself, then walk all of them in step.

    The steps of a ray are those of :func:`pipeline.geometry.ray_walk.walk`, in the same order.
    """
    for k in range(size):
        packet[_T0 + k], packet[_T1 + k] = shorten(
            field,
            packet[_COLUMN + k],
            packet[_ROW + k],
            packet[_Z + k],
            packet[_TO_COLUMN + k],
            packet[_TO_ROW + k],
            packet[_PER_Z + k],
            packet[_T0 + k],
            packet[_T1 + k],
            packet[_MARGIN + k],
        )
    for k in range(size, PACKET):
        packet[_T1 + k] = -np.inf
    for k in range(PACKET):
        packet[_HIT + k] = MISS
    _place(field, packet, cells)
    left = PACKET
    while left > _FEW:
        waiting = _enter_cells(field, packet, cells)
        while waiting > _FEW:
            waiting = _enter_cells(field, packet, cells)
        left = _meet_patches(field, packet, cells)
    for k in range(size):
        hit = packet[_HIT + k]
        if packet[_T0 + k] <= packet[_T1 + k]:
            hit = resume(
                field,
                _unpack(packet, k),
                packet[_BEGIN + k],
                packet[_END + k],
                packet[_T0 + k],
                packet[_T1 + k],
                packet[_MARGIN + k],
                cells[_LEVEL + k],
                cells[_I + k],
                cells[_J + k],
            )
        if hit < MISS:
            result[start + k] = hit


@njit(cache=True, error_model="numpy")
def _place(field, packet, cells):  # type: ignore[no-untyped-def]
    """Put each ray on the first cell of its walk."""
    top_level = field.levels.shape[0] - 1
    for k in range(PACKET):
        cells[_LEVEL + k], cells[_I + k], cells[_J + k] = first_cell(
            field, _unpack(packet, k), packet[_T0 + k], packet[_T1 + k], top_level
        )


@njit(cache=True, error_model="numpy")
def _enter_cells(field, packet, cells):  # type: ignore[no-untyped-def]
    """Enter or pass the cells of all rays not at a patch; return how many still are not at one."""
    bounds, levels = field.bounds, field.levels
    top_level = levels.shape[0] - 1
    for k in range(PACKET):
        level = cells[_LEVEL + k]
        if packet[_T0 + k] <= packet[_T1 + k] and level > 0:
            cell = np.uintp(levels[level, 0] + cells[_J + k] * levels[level, 1] + cells[_I + k])
            packet[_A + k], packet[_B + k] = bounds[cell, 0], bounds[cell, 1]
    waiting = 0
    for k in range(PACKET):
        level, i, j, t = cells[_LEVEL + k], cells[_I + k], cells[_J + k], packet[_T0 + k]
        t1, margin = packet[_T1 + k], packet[_MARGIN + k]
        at_cell = (level > 0) & (t <= t1)
        new_level, new_i, new_j, new_t = pass_cell(
            _unpack(packet, k),
            level,
            i,
            j,
            t,
            t1,
            packet[_A + k] + margin,
            packet[_B + k] - margin,
            top_level,
        )
        level = new_level if at_cell else level
        t = new_t if at_cell else t
        cells[_LEVEL + k] = level
        cells[_I + k] = new_i if at_cell else i
        cells[_J + k] = new_j if at_cell else j
        packet[_T0 + k] = t
        waiting += 1 if (level > 0) & (t <= t1) else 0
    return waiting


@njit(cache=True, error_model="numpy")
def _meet_patches(field, packet, cells):  # type: ignore[no-untyped-def]
    """Meet the patches of all rays that are at one; return how many rays are left."""
    heights = field.heights
    top_level = field.levels.shape[0] - 1
    for k in range(PACKET):
        if packet[_T0 + k] <= packet[_T1 + k] and cells[_LEVEL + k] == 0:
            i, j = np.uintp(cells[_I + k]), np.uintp(cells[_J + k])
            i1, j1 = i + np.uintp(1), j + np.uintp(1)
            packet[_A + k], packet[_B + k] = heights[j, i], heights[j, i1]
            packet[_C + k], packet[_D + k] = heights[j1, i], heights[j1, i1]
    left = 0
    for k in range(PACKET):
        level, i, j, t = cells[_LEVEL + k], cells[_I + k], cells[_J + k], packet[_T0 + k]
        t1 = packet[_T1 + k]
        at_patch = (level == 0) & (t <= t1)
        ray = _unpack(packet, k)
        hit = patch_hit(
            packet[_A + k],
            packet[_B + k],
            packet[_C + k],
            packet[_D + k],
            i,
            j,
            ray,
            packet[_BEGIN + k],
            packet[_END + k],
        )
        new_level, new_i, new_j, new_t = pass_on(ray, level, i, j, t1, top_level)
        new_t = np.nan if hit < MISS else new_t
        t = new_t if at_patch else t
        cells[_LEVEL + k] = new_level if at_patch else level
        cells[_I + k] = new_i if at_patch else i
        cells[_J + k] = new_j if at_patch else j
        packet[_T0 + k] = t
        packet[_HIT + k] = hit if at_patch else packet[_HIT + k]
        left += 1 if t <= t1 else 0
    return left


@njit(cache=True, error_model="numpy", forceinline=True)
def _unpack(packet, k):  # type: ignore[no-untyped-def]
    column, row = packet[_COLUMN + k], packet[_ROW + k]
    to_column, to_row = packet[_TO_COLUMN + k], packet[_TO_ROW + k]
    return Ray(
        column,
        row,
        packet[_Z + k],
        to_column,
        to_row,
        packet[_TO_Z + k],
        packet[_PER_COLUMN + k],
        packet[_PER_ROW + k],
        packet[_PER_Z + k],
        column,
        row,
        1 if to_column >= 0.0 else 0,
        1 if to_row >= 0.0 else 0,
    )
