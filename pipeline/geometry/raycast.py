"""Exact ray casting against a height field, many rays at a time.

Rays next to one another in the batch are taken as packets: each step is done for a whole packet
before the next step, so that the processor works on several rays at once, and neighbours share the
first look at the bounds of the surface below them.

Canvas coordinates: x = column * spacing, y = -row * spacing, z = height, mm.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.geometry.bilinear_patch import MISS, Ray
from pipeline.geometry.maximum_mipmap import build_maximum_mipmap
from pipeline.geometry.ray_walk import (
    FAR,
    LEAST,
    MOST,
    RELATIVE_MARGIN,
    SMALLEST_SHARE,
    area_bounds,
    clip,
    first_hit,
    hit_at,
    locate,
    shorten,
    walk,
    whole_bounds,
)

Array = NDArray[np.float64]

PACKET = 32
_BLOCK = 128 * PACKET
_GLANCES = 3
_SMALL = 2 * PACKET
_SHORT = 1.0


class RayCaster:
    """The surface between the samples of a height field, made ready for rays.

    Between four samples the surface is bilinear; it is met from either side. A patch with a
    corner that is not finite is a hole. The surface ends at the outermost samples, so that a field
    of one row (or column) is a ribbon of no width: a ray that lies in its plane meets its edges
    like any surface, one that passes through the plane meets it only at a point of it.

    Parameters
    ----------
    heights_mm
        (rows, columns), any size, also none.
    spacing_mm
        Distance between samples, > 0.
    """

    def __init__(self, heights_mm: NDArray[np.floating], spacing_mm: float) -> None:
        if not 0 < spacing_mm < np.inf:
            raise ValueError(f"a spacing of {spacing_mm} mm; expected a positive number")
        self.spacing_mm = float(spacing_mm)
        self.field = build_maximum_mipmap(heights_mm)
        """For :func:`pipeline.geometry.ray_walk.first_hit` inside other kernels."""

    def first_hit(
        self,
        origins: NDArray[np.floating],
        directions: NDArray[np.floating],
        t_max: float = np.inf,
    ) -> Array:
        """Return where rays meet the surface first.

        Parameters
        ----------
        origins, directions
            (N, 3) or (3,) canvas coordinates, mm. Directions need no unit length; one that is
            zero or not finite meets nothing.
        t_max
            Hits count for 0 <= t <= t_max.

        Returns
        -------
        (N,) t of origin + t * direction; infinity where nothing is met.
        """
        return self._cast(origins, directions, float(t_max), -1.0)

    def occluded(
        self, points: NDArray[np.floating], targets: NDArray[np.floating], margin_mm: float
    ) -> NDArray[np.bool_]:
        """Return whether the surface stands between points and targets.

        Parameters
        ----------
        points, targets
            (N, 3) or (3,) canvas coordinates, mm.
        margin_mm
            Length of the way's beginning that is not tested, >= 0: a point of the surface must
            not shade itself.

        Returns
        -------
        (N,) bool; False where a point or target is not finite, or they are nearer than the margin.
        """
        if not margin_mm >= 0:
            raise ValueError(f"a margin of {margin_mm} mm; expected 0 or more")
        return np.isfinite(self._cast(points, targets, 1.0, float(margin_mm)))

    def _cast(
        self,
        origins: NDArray[np.floating],
        ends: NDArray[np.floating],
        t_max: float,
        margin_mm: float,
    ) -> Array:
        first, second = _rows(origins), _rows(ends)
        result = np.empty(np.broadcast_shapes((len(first),), (len(second),)))
        _cast(self.field, 1.0 / self.spacing_mm, first, second, t_max, margin_mm, result)
        return result


def _rows(vectors: NDArray[np.floating]) -> Array:
    """Return (N, 3) or (1, 3) float64; one vector broadcast to many is kept as one."""
    array = np.asarray(vectors)
    if array.ndim == 1:
        array = array[None]
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"vectors of shape {np.shape(vectors)}; expected (N, 3) or (3,)")
    if len(array) > 1 and array.strides[0] == 0:
        array = array[:1]
    return np.ascontiguousarray(array, dtype=np.float64)


@njit(cache=True, error_model="numpy")
def _on_grid(position):  # type: ignore[no-untyped-def]
    """Undo the rounding that keeps a multiple of the spacing from being a whole number."""
    nearest = np.floor(position + 0.5)
    return nearest if abs(position - nearest) <= 1e-15 * abs(nearest) else position


@njit(cache=True, error_model="numpy", parallel=True)
def _cast(field, per_mm, origins, ends, t_max, margin_mm, result):  # type: ignore[no-untyped-def]
    """Cast rays (``margin_mm`` < 0: ``ends`` are directions) or test ways to targets."""
    count = len(result)
    for block in prange((count + _BLOCK - 1) // _BLOCK):
        packet = np.empty((14, PACKET))
        for start in range(block * _BLOCK, min(count, (block + 1) * _BLOCK), PACKET):
            size = min(count - start, PACKET)
            _load(field, per_mm, origins, ends, t_max, margin_mm, start, size, packet, result)
            if _glance(field, packet, size):
                _finish(field, packet, size, start, result)


@njit(cache=True, error_model="numpy")
def _load(field, per_mm, origins, ends, t_max, margin_mm, start, size, packet, result):  # type: ignore[no-untyped-def]
    """Bring rays to grid units and clip them to the field's box; cast the awkward ones singly.

    A packet's rows: origin (0-2), direction (3-5), reciprocal direction (6-8), the stretch inside
    the box (9, 10), what is left of it (11, 12), margin in z (13).
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
        column, row = _on_grid(x * per_mm), _on_grid(-y * per_mm)
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
        plain &= (abs(column) + abs(row) < FAR) & (abs(z) < MOST)
        packet[0, k], packet[1, k], packet[2, k] = column, row, z
        packet[3, k], packet[4, k], packet[5, k] = to_column, to_row, to_z
        packet[6, k], packet[7, k], packet[8, k] = per_column, per_row, per_z
        packet[9, k], packet[10, k] = t0, t1
        packet[11, k], packet[12, k] = t0 if plain else np.inf, t1 if plain else limit
        packet[13, k] = margin
        result[n] = MISS
        awkward += 0 if plain else 1
    if awkward > 0:
        for k in range(size):
            if packet[11, k] == np.inf:
                result[start + k] = first_hit(
                    field,
                    packet[0, k],
                    packet[1, k],
                    packet[2, k],
                    packet[3, k],
                    packet[4, k],
                    packet[5, k],
                    packet[12, k],
                )
                packet[12, k] = -np.inf


@njit(cache=True, error_model="numpy")
def _glance(field, packet, size):  # type: ignore[no-untyped-def]
    """Shorten all rays by the bounds of the surface under the whole packet; say if any is left."""
    for _ in range(_GLANCES):
        low_column, high_column, low_row, high_row = np.inf, -np.inf, np.inf, -np.inf
        left = 0
        for k in range(size):
            t0, t1 = packet[11, k], packet[12, k]
            if t0 <= t1:
                left += 1
                a, b = packet[0, k] + t0 * packet[3, k], packet[0, k] + t1 * packet[3, k]
                low_column, high_column = min(low_column, min(a, b)), max(high_column, max(a, b))
                a, b = packet[1, k] + t0 * packet[4, k], packet[1, k] + t1 * packet[4, k]
                low_row, high_row = min(low_row, min(a, b)), max(high_row, max(a, b))
        if left == 0:
            return False
        high, low, extent = area_bounds(field, low_column, high_column, low_row, high_row)
        for k in range(size):
            margin = packet[13, k]
            packet[11, k], packet[12, k] = clip(
                packet[2, k],
                packet[8, k],
                packet[11, k],
                packet[12, k],
                low - margin,
                high + margin,
            )
        if extent < _SMALL:
            break
    return True


@njit(cache=True, error_model="numpy")
def _finish(field, packet, size, start, result):  # type: ignore[no-untyped-def]
    """Shorten each ray by the surface under itself, then walk it."""
    for k in range(size):
        packet[11, k], packet[12, k] = shorten(
            field,
            packet[0, k],
            packet[1, k],
            packet[2, k],
            packet[3, k],
            packet[4, k],
            packet[8, k],
            packet[11, k],
            packet[12, k],
            packet[13, k],
        )
    for k in range(size):
        t0, t1 = packet[11, k], packet[12, k]
        reach = max(abs(packet[3, k]), abs(packet[4, k])) * (t1 - t0)
        if 0.0 < t0 <= t1 and reach < _SHORT:
            ray = _unpack(packet, k)
            i, j = locate(field, ray, t0)
            hit = hit_at(field.heights, i, j, ray, packet[9, k], packet[10, k])
            result[start + k] = hit
            leave_column = (float(i + ray.ahead_column) - ray.column) * ray.per_column
            leave_row = (float(j + ray.ahead_row) - ray.row) * ray.per_row
            leave = min(leave_column, leave_row)
            packet[11, k] = leave if hit == MISS and leave < t1 else np.inf
    for k in range(size):
        if packet[11, k] <= packet[12, k]:
            result[start + k] = walk(
                field,
                _unpack(packet, k),
                packet[9, k],
                packet[10, k],
                packet[11, k],
                packet[12, k],
                packet[13, k],
            )


@njit(cache=True, error_model="numpy")
def _unpack(packet, k):  # type: ignore[no-untyped-def]
    return Ray(
        packet[0, k],
        packet[1, k],
        packet[2, k],
        packet[3, k],
        packet[4, k],
        packet[5, k],
        packet[6, k],
        packet[7, k],
        packet[8, k],
        packet[0, k],
        packet[1, k],
        1 if packet[3, k] >= 0.0 else 0,
        1 if packet[4, k] >= 0.0 else 0,
    )
